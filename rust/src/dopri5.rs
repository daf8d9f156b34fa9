//! Adaptive Dormand–Prince 5(4) with dense output.
//!
//! Tableau: Dormand & Prince (1980), J. Comput. Appl. Math. 6, 19–26, RK5(4)7M. Dense output of
//! order 4: Shampine (1986), Math. Comp. 46, 135–150. Step control: the PI controller of Hairer,
//! Nørsett & Wanner, Solving Ordinary Differential Equations I, section II.4 and IV.2.

use std::ops::ControlFlow;

use nalgebra::SVector;

use crate::error::{DriftError, positive};

pub(crate) const C: [f64; 5] = [1.0 / 5.0, 3.0 / 10.0, 4.0 / 5.0, 8.0 / 9.0, 1.0];
pub(crate) const A: [&[f64]; 5] = [
    &[1.0 / 5.0],
    &[3.0 / 40.0, 9.0 / 40.0],
    &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0],
    &[19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0],
    &[9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0],
];
/// Weights of order 5; the stage at the end of the step is the first of the next.
pub(crate) const B: [f64; 6] =
    [35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0];
/// Order-5 weights less the embedded order-4 weights.
pub(crate) const E: [f64; 7] = [
    71.0 / 57600.0,
    0.0,
    -71.0 / 16695.0,
    71.0 / 1920.0,
    -17253.0 / 339200.0,
    22.0 / 525.0,
    -1.0 / 40.0,
];
/// Weight of each stage in the powers `u, u², u³, u⁴` of the place in the step.
pub(crate) const D: [[f64; 4]; 7] = [
    [
        1.0,
        -8048581381.0 / 2820520608.0,
        8663915743.0 / 2820520608.0,
        -12715105075.0 / 11282082432.0,
    ],
    [0.0; 4],
    [
        0.0,
        131558114200.0 / 32700410799.0,
        -68118460800.0 / 10900136933.0,
        87487479700.0 / 32700410799.0,
    ],
    [0.0, -1754552775.0 / 470086768.0, 14199869525.0 / 1410260304.0, -10690763975.0 / 1880347072.0],
    [
        0.0,
        127303824393.0 / 49829197408.0,
        -318862633887.0 / 49829197408.0,
        701980252875.0 / 199316789632.0,
    ],
    [0.0, -282668133.0 / 205662961.0, 2019193451.0 / 616988883.0, -1453857185.0 / 822651844.0],
    [0.0, 40617522.0 / 29380423.0, -110615467.0 / 29380423.0, 69997945.0 / 29380423.0],
];

/// Tolerances and step limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Relative tolerance on the local error.
    pub rtol: f64,
    /// Absolute tolerance on the local error, in the units of the state.
    pub atol: f64,
    /// Largest step [time].
    pub max_step: f64,
    /// First step [time]; estimated from the slope if none is given.
    pub first_step: Option<f64>,
}

impl Options {
    /// Fails unless each number is finite and above 0.
    pub fn validated(self) -> Result<Self, DriftError> {
        positive("rtol", self.rtol)?;
        positive("atol", self.atol)?;
        positive("max_step", self.max_step)?;
        if let Some(step) = self.first_step {
            positive("first_step", step)?;
        }
        Ok(self)
    }
}

/// One accepted step with its interpolant.
#[derive(Debug, Clone)]
pub struct Step<const N: usize> {
    /// Start of the step.
    pub t: f64,
    /// Length of the step.
    pub h: f64,
    /// End of the step: exactly that of the integration at the last one, where `t + h` may differ
    /// by rounding.
    pub end: f64,
    /// State at the start.
    pub y: SVector<f64, N>,
    /// State at the end.
    pub y_end: SVector<f64, N>,
    /// Change of the state as a polynomial in the place `u` in the step: powers 1 to 4.
    pub powers: [SVector<f64, N>; 4],
}

impl<const N: usize> Step<N> {
    /// State at a time inside the step.
    pub fn state(&self, t: f64) -> SVector<f64, N> {
        let u = (t - self.t) / self.h;
        let [p1, p2, p3, p4] = self.powers;
        self.y + (p1 + (p2 + (p3 + p4 * u) * u) * u) * u
    }

    /// Bounds of |y(u) − y(0)| and of |dy/dt| over the step, of the components `i` and `i + 1`.
    pub fn reach(&self, i: usize) -> (f64, f64) {
        let size = |p: &SVector<f64, N>| p.fixed_rows::<2>(i).norm();
        let distance = self.powers.iter().map(size).sum();
        let speed: f64 = (1..=4).zip(&self.powers).map(|(k, p)| f64::from(k) * size(p)).sum();
        (distance, speed / self.h)
    }
}

/// Steps from `t0` to `t1` by the explicit Euler method, as many equal ones as bring them to
/// `step` or below: what the paper counts, for comparison.
pub fn euler<const N: usize>(
    mut rhs: impl FnMut(f64, &SVector<f64, N>) -> Result<SVector<f64, N>, DriftError>,
    (t0, t1): (f64, f64),
    y0: SVector<f64, N>,
    step: f64,
    mut on_step: impl FnMut(&Step<N>) -> Result<ControlFlow<()>, DriftError>,
) -> Result<Work, DriftError> {
    let count = ((t1 - t0) / positive("euler_step", step)? - 1e-9).ceil().max(1.0);
    if count > MAX_STEPS as f64 {
        return Err(DriftError::Integration { t: t0, reason: "too many steps" });
    }
    let h = (t1 - t0) / count;
    let mut y = y0;
    let mut work = Work::default();
    for k in 0..count as usize {
        let t = t0 + k as f64 * h;
        let end = if k + 1 == count as usize { t1 } else { t0 + (k + 1) as f64 * h };
        let change = rhs(t, &y)? * h;
        let y_end = y + change;
        if y_end.iter().any(|value| !value.is_finite()) {
            return Err(DriftError::Integration { t, reason: "the state is not finite" });
        }
        let zero = SVector::zeros();
        work.accepted += 1;
        work.evaluations += 1;
        let flow = on_step(&Step { t, h, end, y, y_end, powers: [change, zero, zero, zero] })?;
        y = y_end;
        if flow.is_break() {
            break;
        }
    }
    Ok(work)
}

/// Work done by an integration.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
    /// Steps accepted.
    pub accepted: usize,
    /// Steps rejected.
    pub rejected: usize,
    /// Evaluations of the right-hand side.
    pub evaluations: usize,
}

impl std::ops::AddAssign for Work {
    fn add_assign(&mut self, other: Self) {
        self.accepted += other.accepted;
        self.rejected += other.rejected;
        self.evaluations += other.evaluations;
    }
}

const SAFETY: f64 = 0.9;
const MIN_FACTOR: f64 = 0.2;
const MAX_FACTOR: f64 = 5.0;
/// Weight of the integral and the proportional part of the controller.
const INTEGRAL: f64 = 0.17;
const PROPORTIONAL: f64 = 0.04;
const MAX_STEPS: usize = 20_000_000;

/// Integrates `y' = rhs(t, y)` from `t0` to `t1`, handing every accepted step to `on_step`, which
/// may stop the integration. Returns the work done and the step the controller would take next.
pub fn integrate<const N: usize>(
    mut rhs: impl FnMut(f64, &SVector<f64, N>) -> Result<SVector<f64, N>, DriftError>,
    (t0, t1): (f64, f64),
    y0: SVector<f64, N>,
    options: Options,
    mut on_step: impl FnMut(&Step<N>) -> Result<ControlFlow<()>, DriftError>,
) -> Result<(Work, f64), DriftError> {
    let options = options.validated()?;
    let (mut t, mut y) = (t0, y0);
    let mut k = [SVector::<f64, N>::zeros(); 7];
    k[0] = rhs(t, &y)?;
    let mut work = Work { evaluations: 1, ..Work::default() };
    let mut h = options.first_step.unwrap_or_else(|| first_step(&k[0], &y, options, t1 - t0));
    let mut last_error: f64 = 1e-4;
    while t < t1 {
        if work.accepted + work.rejected >= MAX_STEPS {
            return Err(DriftError::Integration { t, reason: "too many steps" });
        }
        h = h.min(options.max_step);
        let left = t1 - t;
        let lands = h >= left * (1.0 - 1e-12);
        // Halve what is left rather than leave a sliver behind.
        let trial = if lands {
            left
        } else if 2.0 * h > left {
            left / 2.0
        } else {
            h
        };
        if !lands && trial <= 8.0 * f64::EPSILON * t.abs().max(t1.abs()) {
            return Err(DriftError::Integration { t, reason: "the step fell below rounding" });
        }
        let end = if lands { t1 } else { t + trial };
        for stage in 1..6 {
            let at = t + C[stage - 1] * trial;
            k[stage] = rhs(at, &(y + weighted(A[stage - 1], &k) * trial))?;
        }
        let y_end = y + weighted(&B, &k) * trial;
        k[6] = rhs(end, &y_end)?;
        work.evaluations += 6;
        let estimate = weighted(&E, &k) * trial;
        // Looked for here, because the norm's maximum passes over what is not a number.
        if estimate.iter().chain(&y_end).any(|value| !value.is_finite()) {
            return Err(DriftError::Integration { t, reason: "the state is not finite" });
        }
        let error = scaled_norm(&estimate, &y, &y_end, options);
        if error > 1.0 {
            work.rejected += 1;
            h = trial * (SAFETY * error.powf(-0.2)).max(MIN_FACTOR);
            continue;
        }
        work.accepted += 1;
        let step = Step { t, h: end - t, end, y, y_end, powers: powers(&k, trial) };
        let error = error.max(1e-10);
        let factor = SAFETY * error.powf(-INTEGRAL) * last_error.powf(PROPORTIONAL);
        let proposal = trial * factor.clamp(MIN_FACTOR, MAX_FACTOR);
        // A step cut short at the end says little about the step that could have been taken.
        h = if trial < h { h.max(proposal) } else { proposal };
        last_error = error;
        (t, y) = (end, y_end);
        k[0] = k[6];
        if on_step(&step)?.is_break() {
            break;
        }
    }
    Ok((work, h))
}

/// Powers of the dense output of a step of length `h` with the stages `k`.
pub(crate) fn powers<const N: usize>(k: &[SVector<f64, N>; 7], h: f64) -> [SVector<f64, N>; 4] {
    std::array::from_fn(|power| weighted(&D.map(|weights| weights[power]), k) * h)
}

fn weighted<const N: usize>(weights: &[f64], k: &[SVector<f64, N>; 7]) -> SVector<f64, N> {
    let mut sum = SVector::<f64, N>::zeros();
    for (weight, k) in weights.iter().zip(k) {
        sum += k * *weight;
    }
    sum
}

fn scaled_norm<const N: usize>(
    error: &SVector<f64, N>,
    y: &SVector<f64, N>,
    y_end: &SVector<f64, N>,
    options: Options,
) -> f64 {
    (0..N)
        .map(|i| {
            let scale = options.atol + options.rtol * y[i].abs().max(y_end[i].abs());
            (error[i] / scale).abs()
        })
        .fold(0.0, f64::max)
}

/// A first step whose change of the state is a hundredth of the tolerance's reach.
fn first_step<const N: usize>(
    slope: &SVector<f64, N>,
    y: &SVector<f64, N>,
    options: Options,
    span: f64,
) -> f64 {
    let size = scaled_norm(slope, y, y, options) * options.rtol.powf(0.8);
    let guess = if size > 0.0 { 0.01 / size } else { span };
    guess.min(options.max_step).min(span)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    /// x'' = −x: exact solution (cos t, −sin t).
    fn oscillator(_: f64, y: &Vector2<f64>) -> Result<Vector2<f64>, DriftError> {
        Ok(Vector2::new(y.y, -y.x))
    }

    /// The same at an uneven pace: exact solution (cos sin t, −sin sin t).
    fn uneven(t: f64, y: &Vector2<f64>) -> Result<Vector2<f64>, DriftError> {
        Ok(Vector2::new(y.y, -y.x) * t.cos())
    }

    /// One step of length `h`: errors of the method, of the embedded one, and of the interpolant.
    fn one_step(h: f64) -> Result<[f64; 3], DriftError> {
        let exact = |t: f64| Vector2::new(t.sin().cos(), -t.sin().sin());
        let wide = Options { rtol: 1.0, atol: 1.0, max_step: h, first_step: Some(h) };
        let (mut slopes, mut end, mut inside) = (Vec::new(), Vector2::zeros(), 0.0);
        let slope = |t: f64, y: &Vector2<f64>| {
            slopes.push(uneven(t, y)?);
            uneven(t, y)
        };
        integrate(slope, (0.0, h), exact(0.0), wide, |step| {
            end = step.y_end;
            // Five accepted places, so that no accidental zero of the interpolant's error counts.
            inside = (1..=5)
                .map(|k| f64::from(k) * h / 6.0)
                .map(|t| (step.state(t) - exact(t)).norm())
                .fold(0.0, f64::max);
            assert!((step.powers[0] / h - uneven(0.0, &step.y)?).norm() < 1e-14);
            Ok(ControlFlow::Continue(()))
        })?;
        let mut stages = [Vector2::zeros(); 7];
        stages.copy_from_slice(&slopes);
        let embedded = end - weighted(&E, &stages) * h;
        Ok([(end - exact(h)).norm(), (embedded - exact(h)).norm(), inside])
    }

    /// Exponent of `x` in `y` by regression.
    fn exponent(x: &[f64], y: &[f64]) -> f64 {
        let mean = |values: &[f64]| values.iter().map(|v| v.ln()).sum::<f64>() / x.len() as f64;
        let (x_mean, y_mean) = (mean(x), mean(y));
        let sum = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
            x.iter().zip(y).map(|(x, y)| f(x.ln() - x_mean, y.ln() - y_mean)).sum()
        };
        sum(&|x, y| x * y) / sum(&|x, _| x * x)
    }

    #[test]
    fn tableau_is_consistent() {
        for (c, a) in C.iter().zip(A) {
            assert!((a.iter().sum::<f64>() - c).abs() < 1e-15);
        }
        assert!((B.iter().sum::<f64>() - 1.0).abs() < 1e-15);
        assert!(E.iter().sum::<f64>().abs() < 1e-15);
        // The interpolant ends at the step's end: the powers of each stage sum to its weight.
        for (stage, d) in D.iter().enumerate() {
            let weight = B.get(stage).copied().unwrap_or(0.0);
            assert!((d.iter().sum::<f64>() - weight).abs() < 1e-13, "stage {stage}");
        }
    }

    /// Local orders, one above those of a whole integration: the method has order 5, the embedded
    /// one and the interpolant have order 4.
    #[test]
    fn local_orders() -> Result<(), DriftError> {
        let steps: Vec<f64> = (0..7).map(|k| 0.4 * 0.5_f64.powf(f64::from(k) / 2.0)).collect();
        let errors = steps.iter().map(|&h| one_step(h)).collect::<Result<Vec<_>, _>>()?;
        for (kind, order) in [5.0, 4.0, 4.0].into_iter().enumerate() {
            let of_kind: Vec<f64> = errors.iter().map(|error| error[kind]).collect();
            let found = exponent(&steps, &of_kind);
            assert!((found - (order + 1.0)).abs() < 0.2, "{kind}: {found}");
        }
        Ok(())
    }

    #[test]
    fn meets_its_tolerance() -> Result<(), DriftError> {
        for rtol in [1e-6, 1e-9, 1e-12] {
            let options = Options { rtol, atol: rtol, max_step: 10.0, first_step: None };
            let mut last = Vector2::zeros();
            integrate(oscillator, (0.0, 20.0), Vector2::new(1.0, 0.0), options, |step| {
                last = step.y_end;
                Ok(ControlFlow::Continue(()))
            })?;
            let error = (last - Vector2::new(20f64.cos(), -20f64.sin())).norm();
            assert!(error < 100.0 * rtol, "rtol {rtol}: error {error}");
        }
        Ok(())
    }

    #[test]
    fn blow_up_is_an_error() {
        let options = Options { rtol: 1e-6, atol: 1e-6, max_step: 1.0, first_step: None };
        let run = integrate(
            |_, y: &Vector2<f64>| Ok(y.component_mul(y)),
            (0.0, 2.0),
            Vector2::new(1.0, 1.0),
            options,
            |_| Ok(ControlFlow::Continue(())),
        );
        assert!(matches!(run, Err(DriftError::Integration { .. })));
    }
}
