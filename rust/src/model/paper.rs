//! The paper's averaged system: stroboscopic expansion of orders 0 and 1, (3.4)–(3.11) with the
//! misprints corrected, for any drag rate: equations.md (14)–(17).
//!
//! `X = Y⁰ + y₁ + a(θ)`, where `a = ∫₀^θ M` vanishes at the start of each tide and `y₁ = εY¹`,
//! `u₁ = εU¹` carry the paper's first order in consistent units.

use std::ops::ControlFlow;

use nalgebra::SVector;

use super::{OnPiece, Piece, Problem, Reach, Solver, harmonics, require_periodic, stokes_drift};
use crate::dopri5::{Step, Work};
use crate::error::{DriftError, positive};
use crate::field::{CVec2, Harmonic, Harmonics, Vec2, complex, in_phase, phasors, real, scaled};

/// Longest step in tide periods.
const MAX_STEP: f64 = 1.0;

/// `Y⁰, U⁰, y₁, u₁`.
type State = SVector<f64, 8>;

fn part(state: &State, i: usize) -> Vec2 {
    Vec2::new(state[2 * i], state[2 * i + 1])
}

struct Stroboscopic<'a> {
    problem: Problem<'a>,
    order: u8,
    window: f64,
    wind_terms: bool,
}

impl Stroboscopic<'_> {
    /// `T·B_W(t)` inside tide `n`: the wind's cumulated action about its mean, (16).
    fn wind_action(&self, n: f64, t: f64) -> Vec2 {
        if !self.wind_terms {
            return Vec2::zeros();
        }
        let (wind, start) = (self.problem.wind, n * self.problem.sea.period());
        wind.integral(t) - wind.integral(start) - wind.mean(t, self.window) * (t - start)
    }

    /// `∫ T·B_W` from `a` to `b`, both in tide `n`.
    fn wind_action_integral(&self, n: f64, a: f64, b: f64) -> Vec2 {
        let (wind, start) = (self.problem.wind, n * self.problem.sea.period());
        let direct =
            wind.double_integral(b) - wind.double_integral(a) - wind.integral(start) * (b - a);
        // ∫ (s − start) F(s + c) ds by parts.
        let ramp = |c: f64| {
            wind.double_integral(b + c) * (b - start)
                - wind.double_integral(a + c) * (a - start)
                - (wind.triple_integral(b + c) - wind.triple_integral(a + c))
        };
        direct - (ramp(self.window / 2.0) - ramp(-self.window / 2.0)) / self.window
    }

    /// `T⟨B_W⟩` and `T⟨∂ₜB_W⟩` at a time in the half-tides around the start of tide `n`.
    fn mean_wind_action(&self, n: f64, t: f64) -> (Vec2, Vec2) {
        if !self.wind_terms {
            return (Vec2::zeros(), Vec2::zeros());
        }
        let period = self.problem.sea.period();
        let (before, after) = (t - period / 2.0, t + period / 2.0);
        let mean = self.wind_action_integral(n - 1.0, before, n * period)
            + self.wind_action_integral(n, n * period, after);
        let change = self.wind_action(n, after) - self.wind_action(n - 1.0, before);
        (mean / period, change / period)
    }

    /// Right-hand side in the half-tides around the start of tide `n`.
    fn rates(&self, n: f64, t: f64, state: &State) -> Result<State, DriftError> {
        let Problem { sea, wind, drag, .. } = self.problem;
        let (y0, u0, u1) = (part(state, 0), part(state, 1), part(state, 3));
        let u0_rate = (wind.mean(t, self.window) - u0) * drag;
        let (mut y1_rate, mut u1_rate) = (Vec2::zeros(), Vec2::zeros());
        if self.order == 1 {
            let at = harmonics(sea, t, y0)?;
            let stokes = stokes_drift(&at.tide, t, Harmonic::excursion);
            let mean = mean_excursion(&at);
            let slow_change = mean_excursion_change(&at, u0);
            let residual_mean = at.residual.first().map_or(Vec2::zeros(), |r| real(r.amplitude));
            let residual_start: Vec2 = at.residual.iter().map(|r| real(r.amplitude)).sum();
            let residual_change: Vec2 =
                at.residual.iter().map(|r| real(r.rate + r.gradient * complex(u0))).sum();
            let (action, action_change) = self.mean_wind_action(n, t);
            let first = residual_mean - residual_start + (action - mean) * drag;
            y1_rate = stokes + u1 + first - slow_change;
            u1_rate = residual_change + (slow_change - action_change - stokes - u1 - first) * drag;
        }
        let rates = [u0, u0_rate, y1_rate, u1_rate];
        Ok(State::from_fn(|i, _| rates[i / 2][i % 2]))
    }

    /// `a(θ) = ∫₀^θ M` in consistent units.
    fn displacement(&self, at: &Harmonics, t: f64) -> Vec2 {
        at.tide.iter().map(|h| in_phase(h.excursion(), h.phasor(t) - 1.0)).sum()
    }
}

/// `⟨a⟩`: the excursion counted from the start of the tide has a mean.
fn mean_excursion(at: &Harmonics) -> Vec2 {
    -at.tide.iter().map(|h| real(h.excursion())).sum::<Vec2>()
}

/// `⟨∂ₜa⟩ + ⟨∇a⟩U⁰`.
fn mean_excursion_change(at: &Harmonics, u0: Vec2) -> Vec2 {
    let change =
        |h: &Harmonic| -> CVec2 { scaled(h.rate + h.gradient * complex(u0), h.antiderivative()) };
    -at.tide.iter().map(change).map(real).sum::<Vec2>()
}

struct PaperPiece<'a> {
    model: &'a Stroboscopic<'a>,
    step: &'a Step<8>,
}

impl Piece for PaperPiece<'_> {
    fn span(&self) -> (f64, f64) {
        (self.step.t, self.step.end)
    }

    fn position(&self, t: f64) -> Result<Vec2, DriftError> {
        let state = self.step.state(t);
        let y0 = part(&state, 0);
        if self.model.order == 0 {
            return Ok(y0);
        }
        let at = harmonics(self.model.problem.sea, t, y0)?;
        Ok(y0 + part(&state, 2) + self.model.displacement(&at, t))
    }

    fn velocity(&self, t: f64) -> Result<Vec2, DriftError> {
        let Problem { sea, drag, .. } = self.model.problem;
        let state = self.step.state(t);
        let at = harmonics(sea, t, part(&state, 0))?;
        let phase: Vec<_> =
            phasors(sea.omega() * t).take(at.tide.len().max(at.residual.len())).collect();
        let tide: Vec2 =
            at.tide.iter().zip(&phase).map(|(h, phasor)| in_phase(h.amplitude, *phasor)).sum();
        let mut velocity = tide + part(&state, 1);
        if self.model.order == 1 {
            let displacement = self.model.displacement(&at, t);
            let shift = complex(part(&state, 2) + displacement);
            for (h, phasor) in at.tide.iter().zip(&phase) {
                velocity += in_phase(h.gradient * shift, *phasor);
            }
            for (h, phasor) in at.residual.iter().skip(1).zip(&phase) {
                velocity += in_phase(h.amplitude, *phasor - 1.0);
            }
            // Rounding must not put the start of a tide at the end of the tide before.
            let n = (t / sea.period() + 1e-9).floor();
            velocity += part(&state, 3) + (self.model.wind_action(n, t) - displacement) * drag;
        }
        Ok(velocity)
    }

    fn mean(&self, t: f64) -> Result<Option<(Vec2, Vec2)>, DriftError> {
        let state = self.step.state(t);
        Ok(Some((part(&state, 0) + part(&state, 2), part(&state, 1) + part(&state, 3))))
    }

    fn reach(&self) -> Reach {
        let Problem { sea, .. } = self.model.problem;
        let (slow, slow_speed) = self.step.reach(0);
        let (first, first_speed) = self.step.reach(4);
        let (y0, y1) = (part(&self.step.y, 0), part(&self.step.y, 2));
        let bounds = sea.bounds(y0, slow);
        let (excursion, rate) = match self.model.order {
            0 => (0.0, 0.0),
            _ => {
                let change = bounds.rate + bounds.gradient * slow_speed;
                (2.0 * bounds.tide / sea.omega(), bounds.tide + 2.0 * change / sea.omega())
            }
        };
        Reach {
            center: y0 + y1,
            radius: slow + first + excursion,
            speed: slow_speed + first_speed + rate,
        }
    }
}

/// Integrates the paper's averaged system of order 0 or 1 over the run.
pub fn follow(
    solver: &Solver,
    order: u8,
    window: f64,
    wind_terms: bool,
    problem: Problem,
    on_piece: OnPiece,
) -> Result<Work, DriftError> {
    if order > 1 {
        return Err(DriftError::invalid("order", order, "the paper's model has orders 0 and 1"));
    }
    positive("window", window)?;
    require_periodic(problem.sea, "the paper's model")?;
    let period = problem.sea.period();
    let (need_start, need_end) = solver.wind_needed(problem.duration, period);
    problem.wind.require(need_start, need_end)?;
    let model = Stroboscopic { problem, order, window, wind_terms };
    let tide = in_phase_tide(&problem)?;
    let slow_velocity = problem.velocity - tide;
    let mut state = State::zeros();
    for i in 0..2 {
        state[i] = problem.position[i];
        state[2 + i] = slow_velocity[i];
    }
    let mut work = Work::default();
    let mut first_step = None;
    let mut stopped = false;
    // ⟨∂ₜB_W⟩ jumps at every half-tide: each piece between jumps is integrated on its own.
    let (mut t, mut n) = (0.0, 0.0);
    while t < problem.duration && !stopped {
        let end = if wind_terms && order == 1 {
            problem.duration.min((n + 0.5) * period)
        } else {
            problem.duration
        };
        let done = solver.integrate(
            |t, state| model.rates(n, t, state),
            (t, end),
            state,
            MAX_STEP * period,
            &mut first_step,
            |step| {
                state = step.y_end;
                let flow = on_piece(&PaperPiece { model: &model, step })?;
                stopped = flow.is_break();
                Ok(if stopped { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
            },
        )?;
        work += done;
        (t, n) = (end, n + 1.0);
    }
    Ok(work)
}

/// `M(0, 0, x)`: the tide alone at the release.
fn in_phase_tide(problem: &Problem) -> Result<Vec2, DriftError> {
    let at = harmonics(problem.sea, 0.0, problem.position)?;
    Ok(at.tide.iter().map(|h| real(h.amplitude)).sum())
}
