//! Steps of several members side by side: Dormand–Prince on a time grid that all share.
//!
//! Both the full model in rewrite B and the mean-flow expansion of order 1 have the form
//! `X' = g(t, X) + Q(0) + Λ∫W − ΛX` (the sea's velocity, or its mean drift, for `g`): equations.md
//! (5), (8). As in [`super::full`] the integrator works on `P = X − Λ∬W`, so that only `∬W` enters.
//! The sea's factors of time are worked out once for all lanes.

use std::ops::Range;

use nalgebra::Matrix2;
use pulp::{Simd, WithSimd};

use super::{Formulation, Model, Piece, Problem, Reach, mean_drift};
use crate::dopri5::{A, B, C, D, E, Step, powers};
use crate::error::DriftError;
use crate::field::{Harmonics, SeaField, Vec2};
use crate::lanes::{LaneVec2, Lanes, WIDTH, dispatch, dispatch_narrow, lane, set_lane};
use crate::wind::lanes::{Knot, LaneWind, View, WindView};

/// What carries the body in a model that steps side by side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carrier {
    /// The sea's velocity: the full model.
    Velocity,
    /// The mean drift of order 1: tidal Stokes drift and mean residual current.
    MeanDrift,
}

impl Carrier {
    /// The carrier of a model, if it can step side by side.
    pub fn of(model: Model) -> Option<Self> {
        match model {
            Model::Full(Formulation::B) => Some(Self::Velocity),
            Model::MeanFlow { order: 1 } => Some(Self::MeanDrift),
            _ => None,
        }
    }

    /// Longest step as a share of the tide period.
    pub fn max_step(self) -> f64 {
        match self {
            Self::Velocity => super::full::MAX_STEP,
            // The wind's integrals are exact within a step; whose error is above the tolerance goes
            // alone.
            Self::MeanDrift => 2.0 * super::mean_flow::MAX_STEP,
        }
    }

    /// Where the integration of this carrier starts: the release, or the slow position there.
    pub fn start(self, problem: Problem) -> Result<Vec2, DriftError> {
        match self {
            Self::Velocity => Ok(problem.position),
            Self::MeanDrift => super::mean_flow::slow_start(problem),
        }
    }

    /// Hands the piece of one member's trajectory over a step to `visit`; `problem.wind` need only
    /// cover the step, its integrals counted from the release.
    pub fn with_piece<T>(
        self,
        problem: Problem,
        step: &Step<2>,
        visit: impl FnOnce(&dyn Piece) -> T,
    ) -> Result<T, DriftError> {
        match self {
            Self::Velocity => super::full::with_piece(problem, step, visit),
            Self::MeanDrift => super::mean_flow::with_piece(problem, step, visit),
        }
    }

    /// The reach of a member, its tidal oscillation included.
    pub fn oscillating(self, problem: &Problem, reach: Reach) -> Reach {
        match self {
            Self::Velocity => reach,
            Self::MeanDrift => super::mean_flow::oscillating(problem.sea, problem.drag, 1, reach),
        }
    }

    /// `g(t, x)`.
    fn at(self, sea: &dyn SeaField, t: f64, x: Vec2) -> Result<Vec2, DriftError> {
        match self {
            Self::Velocity => sea.velocity(t, x),
            Self::MeanDrift => {
                let mut at = Harmonics::default();
                sea.gradients(t, x, &mut at)?;
                Ok(mean_drift(&at, t))
            }
        }
    }
}

/// Times of the stages of a step; the last is that of the next step's first.
fn stage_times(t: f64, h: f64) -> [f64; 6] {
    [t, t + C[0] * h, t + C[1] * h, t + C[2] * h, t + C[3] * h, t + C[4] * h]
}

/// Most steps of a common grid: what is kept for each takes some two hundred bytes.
const MOST_STEPS: f64 = 1e6;

/// The common time grid, with what depends on time alone.
pub struct Grid {
    carrier: Carrier,
    steps: usize,
    h: f64,
    duration: f64,
    drag: f64,
    /// For a sea linear in the position, `∇g − Λ` at the stages of each step, row by row.
    linear: Vec<[[f64; 4]; 6]>,
}

impl Grid {
    /// As many equal steps as bring them to `longest` tide periods or below, and as many in each of
    /// some `parts` of the run.
    pub fn new(
        carrier: Carrier,
        sea: &dyn SeaField,
        duration: f64,
        drag: f64,
        (longest, parts): (f64, usize),
    ) -> Result<Self, DriftError> {
        let parts = parts as f64;
        let steps = (duration / (parts * longest * sea.period()) - 1e-9).ceil().max(1.0) * parts;
        if steps.is_nan() || steps > MOST_STEPS {
            return Err(DriftError::invalid(
                "steps_per_tide",
                format!("{:.3e}", 1.0 / longest),
                format!("a run may have at most {MOST_STEPS} steps of one length"),
            ));
        }
        let h = duration / steps;
        let steps = steps as usize;
        let mut linear = Vec::new();
        if sea.is_linear() {
            let matrix = |t: f64| -> Result<[f64; 4], DriftError> {
                let (x, y) = (Vec2::new(1.0, 0.0), Vec2::new(0.0, 1.0));
                let columns = [carrier.at(sea, t, x)?, carrier.at(sea, t, y)?];
                let m = Matrix2::from_columns(&columns) - Matrix2::identity() * drag;
                Ok([m.m11, m.m12, m.m21, m.m22])
            };
            for n in 0..steps {
                let mut stages = [[0.0; 4]; 6];
                for (m, t) in stages.iter_mut().zip(stage_times(n as f64 * h, h)) {
                    *m = matrix(t)?;
                }
                linear.push(stages);
            }
        }
        Ok(Self { carrier, steps, h, duration, drag, linear })
    }

    /// Number of steps.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Start and end of step `n`.
    pub fn span(&self, n: usize) -> (f64, f64) {
        // The last ends with the run: the sum of the steps may fall short of it by rounding.
        let end = if n + 1 == self.steps { self.duration } else { (n + 1) as f64 * self.h };
        (n as f64 * self.h, end)
    }
}

/// A group of members at one time.
pub struct State {
    /// `P = X − Λ∬W`, or the same of the slow position.
    pub p: LaneVec2,
    /// `Q(0)`.
    invariant: LaneVec2,
    /// Slopes of `P` at the stages of the last step; the last is the first of the next.
    pub stages: [LaneVec2; 7],
    /// Above 0 where the error of a step was estimated above the tolerance, or is not a number.
    excess_error: Lanes,
    /// Where the sea was asked beyond its data.
    lost: [bool; WIDTH],
}

/// How far the members of a group can have moved within a step, without the tidal oscillation.
pub struct LaneReach {
    center: LaneVec2,
    radius: Lanes,
    speed: Lanes,
}

impl LaneReach {
    /// That of one member.
    pub fn of(&self, place: usize) -> Reach {
        Reach {
            center: lane(&self.center, place),
            radius: self.radius.0[place],
            speed: self.speed.0[place],
        }
    }
}

impl State {
    /// All members at one place.
    pub fn new(grid: &Grid, problem: &Problem, start: Vec2) -> Result<Self, DriftError> {
        let invariant = problem.invariant()?;
        let first = grid.carrier.at(problem.sea, 0.0, start)? + invariant - start * grid.drag;
        let mut stages = [[Lanes::ZERO; 2]; 7];
        stages[6] = crate::lanes::splat(first);
        Ok(Self {
            p: crate::lanes::splat(start),
            invariant: crate::lanes::splat(invariant),
            stages,
            excess_error: Lanes::ZERO,
            lost: [false; WIDTH],
        })
    }

    /// Where one member is: `P`, and its slope.
    pub fn place(&self, place: usize) -> [Vec2; 2] {
        [lane(&self.p, place), lane(&self.stages[6], place)]
    }

    /// Puts one member to where it, or another, was at this step.
    pub fn put(&mut self, place: usize, [p, slope]: [Vec2; 2]) {
        set_lane(&mut self.p, place, p);
        set_lane(&mut self.stages[6], place, slope);
        self.excess_error.0[place] = 0.0;
        self.lost[place] = false;
    }

    /// Whether a member's steps up to now cannot be relied on.
    pub fn failed(&self, place: usize) -> bool {
        let sound = self.excess_error.0[place] <= 0.0
            && self.p[0].0[place].is_finite()
            && self.p[1].0[place].is_finite();
        self.lost[place] || !sound
    }

    /// One member's last step, from `t` on, where it began at `p`.
    pub fn one_step(&self, grid: &Grid, n: usize, p: &LaneVec2, place: usize) -> Step<2> {
        let (t, end) = grid.span(n);
        let stages = std::array::from_fn(|n| lane(&self.stages[n], place));
        Step {
            t,
            h: end - t,
            end,
            y: lane(p, place),
            y_end: lane(&self.p, place),
            powers: powers(&stages, grid.h),
        }
    }

    /// Goes through some steps; `tolerance` is (relative, absolute), none to take every step as it
    /// is. With `bounded`, tells how far the members can have moved within the last of them.
    pub fn advance(
        &mut self,
        grid: &Grid,
        sea: &dyn SeaField,
        wind: &LaneWind,
        steps: Range<usize>,
        tolerance: Option<(f64, f64)>,
        bounded: bool,
    ) -> Stepped {
        match wind.view() {
            View::Double(wind) => self.go(grid, sea, wind, steps, tolerance, bounded),
            View::Single(wind) => self.go(grid, sea, wind, steps, tolerance, bounded),
        }
    }

    fn go<K: Knot>(
        &mut self,
        grid: &Grid,
        sea: &dyn SeaField,
        wind: WindView<K>,
        steps: Range<usize>,
        tolerance: Option<(f64, f64)>,
        bounded: bool,
    ) -> Stepped {
        let (q, drawn) = (self.invariant, wind.drawn);
        let linear = grid.linear.get(steps.clone());
        let common = Common { grid, wind, steps, tolerance, bounded, state: &mut *self };
        if let Some(matrices) = linear {
            return run(StepKernel { field: Linear { matrices, q }, common }, drawn);
        }
        let (carrier, drag) = (grid.carrier, grid.drag);
        let field = Anywhere { sea, carrier, drag, q, lost: [false; WIDTH] };
        let (stepped, lost) = run(WithLost(StepKernel { field, common }), drawn);
        for (all, lost) in self.lost.iter_mut().zip(lost) {
            *all |= lost;
        }
        stepped
    }
}

/// Runs a kernel of steps: where the wind is drawn, that is what takes the time.
fn run<K: WithSimd>(kernel: K, drawn: bool) -> K::Output {
    if drawn { dispatch_narrow(kernel) } else { dispatch(kernel) }
}

/// What steps give beside the state.
pub struct Stepped {
    /// The wind's integrals at the end, to be given to [`LaneWind::go_on`].
    pub wind: (usize, [LaneVec2; 2]),
    /// Bounds of the last step, if they were asked for.
    pub reach: Option<LaneReach>,
}

/// The right-hand side without the wind.
trait StageField {
    /// At a stage, which is at time `t`, of the `step`-th step from the first of these.
    fn rate(&mut self, step: usize, stage: usize, t: f64, x: LaneVec2) -> LaneVec2;
}

/// A sea linear in the position.
struct Linear<'a> {
    matrices: &'a [[[f64; 4]; 6]],
    q: LaneVec2,
}

impl StageField for Linear<'_> {
    #[inline(always)]
    fn rate(&mut self, step: usize, stage: usize, _: f64, x: LaneVec2) -> LaneVec2 {
        let [xx, xy, yx, yy] = self.matrices[step][stage];
        [
            x[0].mul_add(xx, x[1].mul_add(xy, self.q[0])),
            x[0].mul_add(yx, x[1].mul_add(yy, self.q[1])),
        ]
    }
}

/// Any sea, asked member by member.
struct Anywhere<'a> {
    sea: &'a dyn SeaField,
    carrier: Carrier,
    drag: f64,
    q: LaneVec2,
    lost: [bool; WIDTH],
}

impl StageField for Anywhere<'_> {
    #[inline(always)]
    fn rate(&mut self, _: usize, _: usize, t: f64, x: LaneVec2) -> LaneVec2 {
        let mut rate = [Lanes::ZERO; 2];
        for place in 0..WIDTH {
            match self.carrier.at(self.sea, t, lane(&x, place)) {
                Ok(velocity) => set_lane(&mut rate, place, velocity),
                Err(_) => self.lost[place] = true,
            }
        }
        for k in 0..2 {
            rate[k] = x[k].mul_add(-self.drag, rate[k] + self.q[k]);
        }
        rate
    }
}

struct Common<'a, K> {
    grid: &'a Grid,
    wind: WindView<'a, K>,
    steps: Range<usize>,
    tolerance: Option<(f64, f64)>,
    bounded: bool,
    state: &'a mut State,
}

struct StepKernel<'a, F, K> {
    field: F,
    common: Common<'a, K>,
}

/// Gives back what the field noted as well.
struct WithLost<'a, K>(StepKernel<'a, Anywhere<'a>, K>);

impl<K: Knot> WithSimd for WithLost<'_, K> {
    type Output = (Stepped, [bool; WIDTH]);
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> Self::Output {
        let stepped = self.0.go();
        (stepped, self.0.field.lost)
    }
}

impl<K: Knot> WithSimd for StepKernel<'_, Linear<'_>, K> {
    type Output = Stepped;
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> Stepped {
        self.go()
    }
}

/// `onto + h Σ weight·k` of the stages that count.
#[inline(always)]
fn weighted(weights: &[f64], k: &[LaneVec2; 7], h: f64, c: usize, onto: Lanes) -> Lanes {
    let mut sum = onto;
    for (weight, k) in weights.iter().zip(k) {
        if *weight != 0.0 {
            sum = k[c].mul_add(*weight * h, sum);
        }
    }
    sum
}

impl<F: StageField, K: Knot> StepKernel<'_, F, K> {
    #[inline(always)]
    fn go(&mut self) -> Stepped {
        let Common { grid, wind, steps, tolerance, bounded, state } = &mut self.common;
        let (h, drag) = (grid.h, grid.drag);
        let mut walk = wind.walk();
        let mut reach = None;
        for (step, n) in steps.clone().enumerate() {
            let times = stage_times(n as f64 * h, h);
            let p = state.p;
            let mut blown = None;
            if *bounded && n + 1 == steps.end {
                blown = Some((walk.integral(times[0]), walk.double_integral(times[0], drag, p)));
            }
            // The position of each stage but for its slopes.
            let mut forced = [p; 5];
            for (forced, t) in forced.iter_mut().zip(&times[1..]) {
                *forced = walk.double_integral(*t, drag, p);
            }
            let k = &mut state.stages;
            k[0] = k[6];
            macro_rules! stage {
                ($stage:literal) => {{
                    let mut x = [Lanes::ZERO; 2];
                    for c in 0..2 {
                        x[c] = weighted(A[$stage - 1], k, h, c, forced[$stage - 1][c]);
                    }
                    k[$stage] = self.field.rate(step, $stage, times[$stage], x);
                }};
            }
            stage!(1);
            stage!(2);
            stage!(3);
            stage!(4);
            stage!(5);
            let (mut end, mut x) = ([Lanes::ZERO; 2], [Lanes::ZERO; 2]);
            for c in 0..2 {
                let moved = weighted(&B, k, h, c, Lanes::ZERO);
                end[c] = p[c] + moved;
                x[c] = forced[4][c] + moved;
            }
            k[6] = self.field.rate(step, 5, times[5], x);
            if let Some((rtol, atol)) = tolerance {
                for c in 0..2 {
                    let error = weighted(&E, k, h, c, Lanes::ZERO).abs();
                    let size = p[c].abs().max(end[c].abs());
                    let allowed = size.mul_add(*rtol, Lanes::splat(*atol));
                    state.excess_error = state.excess_error.max(error - allowed);
                }
            }
            // No closures here: they would be compiled without the instructions of the lanes.
            if let Some((single, center)) = blown {
                let (mut distance, mut speed) = (Lanes::ZERO, Lanes::ZERO);
                for power in 0..4 {
                    let mut weights = [0.0; 7];
                    for (weight, of_stage) in weights.iter_mut().zip(&D) {
                        *weight = of_stage[power];
                    }
                    let size = weighted(&weights, k, h, 0, Lanes::ZERO).abs()
                        + weighted(&weights, k, h, 1, Lanes::ZERO).abs();
                    distance += size;
                    speed += size * ((power + 1) as f64 / h);
                }
                let blown = single[0].abs() + single[1].abs() + wind.max_speed(times[5]) * h;
                reach = Some(LaneReach {
                    center,
                    radius: distance + blown * (h * drag),
                    speed: speed + blown * drag,
                });
            }
            state.p = end;
        }
        Stepped { wind: walk.end(), reach }
    }
}
