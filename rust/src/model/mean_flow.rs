//! The mean-flow expansion of orders 1 and 2: equations.md (8)–(13).
//!
//! `X = Y + a₁ + a₂`, `Y' = F + f₁ + f₂` with `F = Q − ΛY`. Every mean and antiderivative over the
//! tidal phase is a closed form in the harmonics; nothing is integrated over the phase.

use num_complex::Complex64;
use smallvec::{SmallVec, smallvec};

use super::{
    OnPiece, Piece, Problem, Reach, Solver, WindIntegrals, harmonics, mean_drift, require_periodic,
};
use crate::dopri5::{Step, Work};
use crate::error::DriftError;
use crate::field::{
    CMat2, CVec2, Harmonic, Harmonics, SeaField, Vec2, complex, conj, in_phase, real, scaled,
};

/// Longest step in tide periods: about two synoptic steps of the wind.
pub(super) const MAX_STEP: f64 = 1.0;
/// Amplitudes by harmonic; as many as the usual field has need no allocation.
type Amplitudes = SmallVec<[CVec2; 4]>;
const MAX_ITERATIONS: usize = 100;

/// The expansion at one time and slow position.
pub(super) struct Expansion {
    /// `f₁ + f₂`: tidal Stokes drift, residual current and their corrections.
    pub(super) drift: Vec2,
    /// Frequencies and amplitudes of `a₁ + a₂`.
    oscillation: SmallVec<[(f64, CVec2); 4]>,
}

impl Expansion {
    pub(super) fn new(
        order: u8,
        at: &Harmonics,
        t: f64,
        omega: f64,
        drag: f64,
        forcing: Vec2,
    ) -> Self {
        let mut oscillation: SmallVec<_> =
            at.tide.iter().map(|h| (h.omega, h.excursion())).collect();
        let mut drift = mean_drift(at, t);
        if order == 2 {
            let first: Amplitudes = at.tide.iter().map(Harmonic::excursion).collect();
            let second = second_oscillation(at, &first, omega, drag, forcing);
            drift += second_drift(at, &first, &second);
            oscillation.extend((1..).zip(second).map(|(l, a)| (f64::from(l) * omega, a)));
        }
        Self { drift, oscillation }
    }

    pub(super) fn displacement(&self, t: f64) -> Vec2 {
        self.oscillation.iter().map(|(omega, a)| in_phase(*a, Complex64::cis(omega * t))).sum()
    }
}

/// Amplitudes of `a₂`: the zero-mean antiderivative of
/// `∇M a₁ − ⟨∇M a₁⟩ − Λa₁ + n − ⟨n⟩ − ∂ₜa₁ − (∇a₁)F`.
fn second_oscillation(
    at: &Harmonics,
    first: &[CVec2],
    omega: f64,
    drag: f64,
    forcing: Vec2,
) -> Amplitudes {
    let highest = (2 * first.len()).max(at.residual.len().saturating_sub(1));
    let mut rate: Amplitudes = smallvec![CVec2::zeros(); highest];
    for (j, tide) in (1..).zip(&at.tide) {
        for (k, a) in (1..).zip(first) {
            rate[j + k - 1] += (tide.gradient * a) * Complex64::from(0.5);
            if j > k {
                rate[j - k - 1] += (tide.gradient * conj(*a)) * Complex64::from(0.5);
            } else if k > j {
                rate[k - j - 1] += (tide.gradient.map(|g| g.conj()) * a) * Complex64::from(0.5);
            }
        }
        let slow = tide.rate + tide.gradient * complex(forcing);
        rate[j - 1] -= scaled(first[j - 1], drag.into()) + scaled(slow, tide.antiderivative());
    }
    for (j, residual) in (1..).zip(at.residual.iter().skip(1)) {
        rate[j - 1] += residual.amplitude;
    }
    (1..)
        .zip(rate)
        .map(|(l, rate)| scaled(rate, Harmonic::multiple(l, omega).antiderivative()))
        .collect()
}

/// `f₂ = ⟨∇M a₂⟩ + ½⟨∇²M(a₁, a₁)⟩ + ⟨∇n a₁⟩`.
fn second_drift(at: &Harmonics, first: &[CVec2], second: &[CVec2]) -> Vec2 {
    let mut drift = Vec2::zeros();
    for (tide, a) in at.tide.iter().zip(second) {
        drift += real(tide.gradient * conj(*a)) * 0.5;
    }
    for (residual, a) in at.residual.iter().skip(1).zip(first) {
        drift += real(residual.gradient * conj(*a)) * 0.5;
    }
    // a₁ ⊗ a₁ has harmonics j = k + l (half of A_k A_l) and j = k − l (A_k conj A_l).
    for (j, tide) in (1..).zip(&at.tide) {
        let mut square = CMat2::zeros();
        for (k, a) in (1..).zip(first) {
            for (l, b) in (1..).zip(first) {
                if k + l == j {
                    square += a * b.transpose() * Complex64::from(0.5);
                } else if k == j + l {
                    square += a * conj(*b).transpose();
                }
            }
        }
        for component in 0..2 {
            let sum: Complex64 = (tide.hessian[component].iter().zip(square.iter()))
                .map(|(h, s)| h * s.conj())
                .sum();
            drift[component] += 0.25 * sum.re;
        }
    }
    drift
}

struct MeanFlow<'a> {
    problem: Problem<'a>,
    wind: WindIntegrals<'a>,
    order: u8,
    /// `Q(0)`.
    invariant: Vec2,
}

impl MeanFlow<'_> {
    /// The expansion at slow position `y`, with `F = Q − ΛY`.
    fn expansion(&self, t: f64, y: Vec2, single: Vec2) -> Result<(Expansion, Vec2), DriftError> {
        let Problem { sea, drag, .. } = self.problem;
        let forcing = self.invariant + (single - y) * drag;
        let at = harmonics(sea, t, y)?;
        Ok((Expansion::new(self.order, &at, t, sea.omega(), drag, forcing), forcing))
    }

    /// Solves `Y + a(0, Y) = x` by iteration.
    fn start(&self) -> Result<Vec2, DriftError> {
        slow_position(self.problem.position, |y| {
            Ok(self.expansion(0.0, y, Vec2::zeros())?.0.displacement(0.0))
        })
    }
}

/// Solves `Y + a(Y) = x` by iteration.
pub(super) fn slow_position(
    x: Vec2,
    displacement: impl Fn(Vec2) -> Result<Vec2, DriftError>,
) -> Result<Vec2, DriftError> {
    let mut y = x;
    for _ in 0..MAX_ITERATIONS {
        let displacement = displacement(y)?;
        let next = x - displacement;
        let moved = (next - y).norm();
        y = next;
        // The displacement counts as well: near the origin it is the largest of the three.
        if moved <= 4.0 * f64::EPSILON * (x.norm() + y.norm() + displacement.norm()) {
            return Ok(y);
        }
    }
    Err(DriftError::Integration { t: 0.0, reason: "the slow initial position did not converge" })
}

/// Adds bounds of `a₁`, at most `answer` times the water's excursion, and of its rate of change to
/// the reach of the slow position.
pub(super) fn oscillating_first(sea: &dyn SeaField, slow: Reach, answer: f64) -> Reach {
    let Reach { center, radius, speed } = slow;
    let bounds = sea.bounds(center, radius);
    let slowest = sea.slowest();
    let excursion = answer * bounds.tide / slowest;
    let rate = answer * (bounds.tide + (bounds.rate + bounds.gradient * speed) / slowest);
    Reach { center, radius: radius + excursion, speed: speed + rate }
}

/// Adds bounds of `a₁ + a₂` and of its rate of change to the reach of the slow position.
pub(super) fn oscillating(sea: &dyn SeaField, drag: f64, order: u8, slow: Reach) -> Reach {
    if order == 1 {
        return oscillating_first(sea, slow, 1.0);
    }
    let Reach { center, radius, speed } = slow;
    let omega = sea.omega();
    let bounds = sea.bounds(center, radius);
    let first = bounds.tide / omega;
    let first_rate = bounds.tide + (bounds.rate + bounds.gradient * speed) / omega;
    let forcing = speed + bounds.gradient * first / 2.0 + bounds.residual;
    let rate = (bounds.rate + bounds.gradient * forcing) / omega;
    let second = ((bounds.gradient + drag) * first + bounds.residual + rate) / omega;
    // `ω·second` bounds the fast rate, since 1/l is in each amplitude; the factor covers the slow
    // change and what f₂ adds to the forcing, both a further order smaller.
    let second_rate = first_rate + 8.0 * omega * second;
    Reach { center, radius: radius + first + second, speed: speed + second_rate }
}

struct MeanFlowPiece<'a> {
    flow: &'a MeanFlow<'a>,
    step: &'a Step<2>,
}

/// Hands the piece of an order-1 trajectory over one step to `visit`; the integrals of the wind are
/// counted from the release.
pub(super) fn with_piece<T>(
    problem: Problem,
    step: &Step<2>,
    visit: impl FnOnce(&dyn Piece) -> T,
) -> Result<T, DriftError> {
    let wind = WindIntegrals::of_stretch(problem.wind);
    let flow = MeanFlow { problem, wind, order: 1, invariant: problem.invariant()? };
    Ok(visit(&MeanFlowPiece { flow: &flow, step }))
}

/// The slow position at the release, of order 1; the wind does not enter.
pub(super) fn slow_start(problem: Problem) -> Result<Vec2, DriftError> {
    let wind = WindIntegrals::of_stretch(problem.wind);
    MeanFlow { problem, wind, order: 1, invariant: problem.invariant()? }.start()
}

impl MeanFlowPiece<'_> {
    fn slow(&self, t: f64) -> (Vec2, Vec2) {
        let (single, double) = self.flow.wind.at(t);
        (self.blown(t, double), single)
    }

    /// Slow position where `∬W` is known.
    fn blown(&self, t: f64, double: Vec2) -> Vec2 {
        self.step.state(t) + double * self.flow.problem.drag
    }
}

impl Piece for MeanFlowPiece<'_> {
    fn span(&self) -> (f64, f64) {
        (self.step.t, self.step.end)
    }

    fn position(&self, t: f64) -> Result<Vec2, DriftError> {
        if self.flow.order == 1 {
            let y = self.blown(t, self.flow.wind.double(t));
            return Ok(y + self.flow.problem.sea.excursion(t, y)?);
        }
        let (y, single) = self.slow(t);
        let (expansion, _) = self.flow.expansion(t, y, single)?;
        Ok(y + expansion.displacement(t))
    }

    fn velocity(&self, t: f64) -> Result<Vec2, DriftError> {
        let x = self.position(t)?;
        let Problem { sea, drag, .. } = self.flow.problem;
        Ok(sea.velocity(t, x)? + self.flow.invariant + (self.slow(t).1 - x) * drag)
    }

    fn mean(&self, t: f64) -> Result<Option<(Vec2, Vec2)>, DriftError> {
        let (y, single) = self.slow(t);
        let (expansion, forcing) = self.flow.expansion(t, y, single)?;
        Ok(Some((y, forcing + expansion.drift)))
    }

    fn reach(&self) -> Reach {
        let drag = self.flow.problem.drag;
        let (distance, speed) = self.step.reach(0);
        let (wind_distance, wind_speed) = self.flow.wind.reach(self.step.t, self.step.h);
        let center = self.slow(self.step.t).0;
        let (radius, speed) = (distance + wind_distance * drag, speed + wind_speed * drag);
        oscillating(self.flow.problem.sea, drag, self.flow.order, Reach { center, radius, speed })
    }
}

/// Integrates the mean-flow expansion of order 1 or 2 over the run.
pub fn follow(
    solver: &Solver,
    order: u8,
    problem: Problem,
    on_piece: OnPiece,
) -> Result<Work, DriftError> {
    if order != 1 && order != 2 {
        return Err(DriftError::invalid("order", order, "mean-flow has orders 1 and 2"));
    }
    if order == 2 {
        require_periodic(problem.sea, "mean-flow order 2")?;
    }
    problem.wind.require(0.0, problem.duration)?;
    let flow = MeanFlow {
        problem,
        wind: WindIntegrals::new(problem.wind),
        order,
        invariant: problem.invariant()?,
    };
    solver.integrate(
        |t, p: &Vec2| {
            let (single, double) = flow.wind.at(t);
            let (expansion, forcing) = flow.expansion(t, p + double * problem.drag, single)?;
            Ok(forcing + expansion.drift - single * problem.drag)
        },
        (0.0, problem.duration),
        flow.start()?,
        MAX_STEP * problem.sea.period(),
        &mut None,
        |step| on_piece(&MeanFlowPiece { flow: &flow, step }),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_positions_near_the_origin_are_found() -> Result<(), DriftError> {
        for k in 0..1000 {
            let x = Vec2::new(1e-9 * f64::from(k), 0.0);
            let a = |y: Vec2| Vec2::new(0.03, 0.02) + Vec2::new(y.y, -y.x) * 0.1;
            let y = slow_position(x, |y| Ok(a(y)))?;
            assert!((y + a(y) - x).norm() < 1e-16);
        }
        Ok(())
    }
}
