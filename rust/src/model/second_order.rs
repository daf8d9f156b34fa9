//! Mean-flow order 2 of the paper's body in a wind that varies in space, on the plane:
//! equations.md (45)–(46).
//!
//! Where the wind is uniform `Q` is known exactly ([`super::mean_flow`]). Here it is a second
//! unknown, `Q = Q̄ + q₂`: the wind's own second-order mean over the tidal excursion goes to `Q̄`,
//! its first-order oscillation to `q₂`. Without them the order falls back to 2.

use nalgebra::Vector4;
use num_complex::Complex64;

use super::body::{Drift, Line};
use super::mean_flow::{self, Expansion};
use super::{OnPiece, Piece, Reach, Solver, harmonics, require_periodic};
use crate::dopri5::{Step, Work};
use crate::error::DriftError;
use crate::field::{Harmonics, Vec2, in_phase, scaled};
use crate::geometry::Geometry;

type State = Vector4<f64>;

fn parts(state: &State) -> (Vec2, Vec2) {
    (Vec2::new(state[0], state[1]), Vec2::new(state[2], state[3]))
}

struct SecondOrder<'a> {
    drift: &'a Drift<'a>,
    /// `Λ = 1/τ`.
    drag: f64,
    /// `Q(0)`.
    invariant: Vec2,
}

impl SecondOrder<'_> {
    /// The expansion at slow position `y` and slow `Q̄`, with `F = Q̄ − ΛY`.
    fn expansion(
        &self,
        t: f64,
        y: Vec2,
        q: Vec2,
    ) -> Result<(Expansion, Harmonics, Vec2), DriftError> {
        let forcing = q - y * self.drag;
        let sea = self.drift.sea;
        let at = harmonics(sea, t, y)?;
        let expansion = Expansion::new(2, &at, t, sea.omega(), self.drag, forcing);
        Ok((expansion, at, forcing))
    }

    /// `q₂ = Λ∫~∇W a₁`.
    fn oscillation_of_q(&self, at: &Harmonics, t: f64, y: Vec2) -> Result<Vec2, DriftError> {
        let (gradient, _) = self.drift.wind.derivatives(t, y)?;
        let gradient = gradient.map(Complex64::from);
        let of = |tide: &crate::field::Harmonic| {
            let amplitude = scaled(gradient * tide.excursion(), tide.antiderivative());
            in_phase(amplitude, tide.phasor(t))
        };
        Ok(at.tide.iter().map(of).sum::<Vec2>() * self.drag)
    }

    /// `Y + a₁ + a₂ = x`, `Q̄ + q₂ = Q(0)` at the release.
    fn start(&self) -> Result<(Vec2, Vec2), DriftError> {
        let t = self.drift.release.time;
        let slow_q = |y: Vec2| -> Result<Vec2, DriftError> {
            let at = harmonics(self.drift.sea, t, y)?;
            Ok(self.invariant - self.oscillation_of_q(&at, t, y)?)
        };
        let y = mean_flow::slow_position(self.drift.release.position, |y| {
            Ok(self.expansion(t, y, slow_q(y)?)?.0.displacement(t))
        })?;
        Ok((y, slow_q(y)?))
    }

    fn rates(&self, t: f64, state: &State) -> Result<State, DriftError> {
        let (y, q) = parts(state);
        let (expansion, at, forcing) = self.expansion(t, y, q)?;
        let mut wind = self.drift.wind.at(t, y)?;
        let (_, hessian) = self.drift.wind.derivatives(t, y)?;
        // ½⟨∇²W(a₁, a₁)⟩.
        for tide in &at.tide {
            let a = tide.excursion();
            for component in 0..2 {
                for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    let product = (a[i] * a[j].conj()).re;
                    wind[component] += 0.25 * hessian[component][(i, j)] * product;
                }
            }
        }
        let (y_rate, q_rate) = (forcing + expansion.drift, wind * self.drag);
        Ok(State::new(y_rate.x, y_rate.y, q_rate.x, q_rate.y))
    }
}

struct SecondOrderPiece<'a> {
    flow: &'a SecondOrder<'a>,
    step: &'a Step<4>,
}

impl Piece for SecondOrderPiece<'_> {
    fn span(&self) -> (f64, f64) {
        (self.step.t, self.step.end)
    }

    fn position(&self, t: f64) -> Result<Vec2, DriftError> {
        let (y, q) = parts(&self.step.state(t));
        Ok(y + self.flow.expansion(t, y, q)?.0.displacement(t))
    }

    fn velocity(&self, t: f64) -> Result<Vec2, DriftError> {
        let (y, q) = parts(&self.step.state(t));
        let (expansion, at, _) = self.flow.expansion(t, y, q)?;
        let x = y + expansion.displacement(t);
        let q = q + self.flow.oscillation_of_q(&at, t, y)?;
        Ok(self.flow.drift.sea.velocity(t, x)? + q - x * self.flow.drag)
    }

    fn mean(&self, t: f64) -> Result<Option<(Vec2, Vec2)>, DriftError> {
        let state = self.step.state(t);
        let (rate, _) = parts(&self.flow.rates(t, &state)?);
        Ok(Some((parts(&state).0, rate)))
    }

    fn reach(&self) -> Reach {
        let center = parts(&self.step.y).0;
        let (radius, speed) = self.step.reach(0);
        let slow = Reach { center, radius, speed };
        mean_flow::oscillating(self.flow.drift.sea, self.flow.drag, 2, slow)
    }
}

/// Integrates the expansion over the run; only the paper's body on the plane has it.
pub(super) fn follow(
    drift: &Drift,
    solver: &Solver,
    on_piece: OnPiece,
) -> Result<Work, DriftError> {
    let body = &drift.body;
    let still = Line::default();
    let papers = body.slip == 1.0
        && body.response > 0.0
        && body.downwind == Line { slope: 1.0, offset: 0.0 }
        && [body.crosswind, body.jibed] == [still; 2]
        && body.surface_current == [0.0; 2]
        && drift.geometry == Geometry::Plane;
    if !papers {
        return Err(DriftError::invalid(
            "order",
            2,
            "only the paper's body (wind factor 1) on the plane has order 2; others have order 1",
        ));
    }
    require_periodic(drift.sea, "mean-flow order 2")?;
    let (position, t) = (drift.release.position, drift.release.time);
    let drag = 1.0 / body.response;
    let relative = match drift.release.velocity {
        Some(velocity) => velocity - drift.sea.velocity(t, position)?,
        None => Vec2::zeros(),
    };
    let flow = SecondOrder { drift, drag, invariant: relative + position * drag };
    let (y, q) = flow.start()?;
    drift.walk(
        solver,
        mean_flow::MAX_STEP,
        State::new(y.x, y.y, q.x, q.y),
        |_, t, state| flow.rates(t, state),
        |_, step| on_piece(&SecondOrderPiece { flow: &flow, step }),
    )
}
