//! The paper's full system in its four-dimensional form by RK4 on the wind's knots, sixteen members
//! at a time: what SIMD lanes alone give, the equations and the method being those of the peers.
//!
//! `rustc --edition 2024 -O -C target-cpu=native --crate-type cdylib rk4_lanes.rs`, for
//! `solvers.py` to call through ctypes.

use std::array::from_fn;
use std::f64::consts::{PI, TAU};

const LANES: usize = 16;
/// One number of each of sixteen members.
type Lanes = [f64; LANES];
/// Both components of the wind at a knot, or of a position.
type Pair = [Lanes; 2];
/// x, y, u, v of one member.
type State = [f64; 4];

/// What (2.8)–(2.9) takes from the time alone: the same for every member.
#[derive(Clone, Copy)]
struct Forcing {
    a: f64,
    a_rate: f64,
    wave: [f64; 2],
    wave_rate: [f64; 2],
    residual: f64,
    residual_rate: f64,
}

impl Forcing {
    fn new(t: f64, epsilon: f64) -> Self {
        let omega = TAU / epsilon;
        let (sin, cos) = (omega * t).sin_cos();
        let (sin_slow, cos_slow) = (6.0 * PI * t).sin_cos();
        let (b, b_rate) = (2.0 + cos_slow, -6.0 * PI * sin_slow);
        Self {
            a: 2.0 + sin_slow,
            a_rate: 6.0 * PI * cos_slow,
            wave: [sin + sin * cos / 2.0, sin / 2.0],
            wave_rate: [omega * (cos + 0.5 - sin * sin), omega * cos / 2.0],
            residual: epsilon * b * sin,
            residual_rate: epsilon * (omega * b * cos + b_rate * sin),
        }
    }

    #[inline(always)]
    fn rate(&self, [x, y, u, v]: State, wind: [f64; 2]) -> State {
        let tide = self.a * x;
        let change = self.a_rate.mul_add(x, self.a * u);
        let residual = self.residual_rate.mul_add(y, self.residual * v);
        let push = |i: usize, speed: f64| {
            let blown = residual + (wind[i] - speed);
            self.wave_rate[i].mul_add(tide, self.wave[i].mul_add(change, blown))
        };
        [u, v, push(0, u), push(1, v)]
    }
}

/// `a + h b`.
#[inline(always)]
fn add(a: State, h: f64, b: State) -> State {
    from_fn(|i| h.mul_add(b[i], a[i]))
}

/// Follows sixteen members under the wind at their knots from `t = 0` to 1.
fn follow(forcing: &[Forcing], wind: &[Pair]) -> Pair {
    let step = 1.0 / (wind.len() - 1) as f64;
    let mut states = [[1.0; LANES], [1.0; LANES], [0.0; LANES], [0.0; LANES]];
    for (ends, stages) in wind.windows(2).zip(forcing.windows(3).step_by(2)) {
        // The members do the same: the compiler takes vector registers for all of them.
        for lane in 0..LANES {
            let state = from_fn(|i| states[i][lane]);
            let [start, end]: [[f64; 2]; 2] = from_fn(|k| from_fn(|i| ends[k][i][lane]));
            let middle = from_fn(|i| 0.5 * (start[i] + end[i]));
            let k1 = stages[0].rate(state, start);
            let k2 = stages[1].rate(add(state, step / 2.0, k1), middle);
            let k3 = stages[1].rate(add(state, step / 2.0, k2), middle);
            let k4 = stages[2].rate(add(state, step, k3), end);
            for i in 0..4 {
                let sum = (k2[i] + k3[i]).mul_add(2.0, k1[i] + k4[i]);
                states[i][lane] = sum.mul_add(step / 6.0, states[i][lane]);
            }
        }
    }
    [states[0], states[1]]
}

/// Winds (blocks, knots, 2, 16) to positions (blocks, 2, 16) at `t = 1`.
///
/// # Safety
///
/// `winds` and `positions` point to arrays of these shapes, and no other thread writes to them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn solve(
    epsilon: f64,
    winds: *const Pair,
    blocks: usize,
    knots: usize,
    positions: *mut Pair,
) {
    // SAFETY: the caller's promise above.
    let (winds, positions) = unsafe {
        (
            std::slice::from_raw_parts(winds, blocks * knots),
            std::slice::from_raw_parts_mut(positions, blocks),
        )
    };
    let half_step = 0.5 / (knots - 1) as f64;
    let forcing: Vec<_> =
        (0..2 * knots - 1).map(|k| Forcing::new(k as f64 * half_step, epsilon)).collect();
    for (wind, position) in winds.chunks_exact(knots).zip(positions) {
        *position = follow(&forcing, wind);
    }
}
