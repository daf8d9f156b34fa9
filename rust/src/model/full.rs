//! The full system, exactly rewritten so that no derivative of the sea is needed.
//!
//! With `U = V − m` the paper's (2.8)–(2.9) become rewrite A, `X' = m + U`,
//! `U' = Λ(W − m − U)`; with `Q = U + ΛX`, rewrite B, `Q' = ΛW`, `X' = m + Q − ΛX`. The wind's
//! integrals are known exactly, so the integrator works on `P = X − Λ∫S`, whose third derivative is
//! continuous however rough the wind: equations.md (4)–(6).

use nalgebra::{SVector, Vector4};

use super::{Formulation, OnPiece, Piece, Problem, Reach, Solver, WindIntegrals};
use crate::dopri5::{Step, Work};
use crate::error::DriftError;
use crate::field::Vec2;

/// Longest step as a share of the tide period: beyond it the error estimate is blind.
pub(super) const MAX_STEP: f64 = 0.1;

struct FullPiece<'a, const N: usize> {
    problem: &'a Problem<'a>,
    wind: &'a WindIntegrals<'a>,
    step: &'a Step<N>,
    /// `Q(0)`.
    invariant: Vec2,
}

/// Hands the piece of a trajectory by rewrite B over one step to `visit`; the integrals of the wind
/// are counted from the release.
pub(super) fn with_piece<T>(
    problem: Problem,
    step: &Step<2>,
    visit: impl FnOnce(&dyn Piece) -> T,
) -> Result<T, DriftError> {
    let wind = WindIntegrals::of_stretch(problem.wind);
    let invariant = problem.invariant()?;
    Ok(visit(&FullPiece { problem: &problem, wind: &wind, step, invariant }))
}

fn place<const N: usize>(state: &SVector<f64, N>) -> Vec2 {
    Vec2::new(state[0], state[1])
}

impl<const N: usize> Piece for FullPiece<'_, N> {
    fn span(&self) -> (f64, f64) {
        (self.step.t, self.step.end)
    }

    fn position(&self, t: f64) -> Result<Vec2, DriftError> {
        Ok(place(&self.step.state(t)) + self.wind.at(t).1 * self.problem.drag)
    }

    fn velocity(&self, t: f64) -> Result<Vec2, DriftError> {
        let state = self.step.state(t);
        let (single, double) = self.wind.at(t);
        let Problem { sea, drag, .. } = self.problem;
        let x = place(&state) + double * *drag;
        let relative = match N {
            4 => Vec2::new(state[2], state[3]),
            _ => self.invariant - x * *drag,
        };
        Ok(sea.velocity(t, x)? + relative + single * *drag)
    }

    fn mean(&self, _: f64) -> Result<Option<(Vec2, Vec2)>, DriftError> {
        Ok(None)
    }

    fn reach(&self) -> Reach {
        let (distance, speed) = self.step.reach(0);
        let (wind_distance, wind_speed) = self.wind.reach(self.step.t, self.step.h);
        let drag = self.problem.drag;
        Reach {
            center: place(&self.step.y) + self.wind.at(self.step.t).1 * drag,
            radius: distance + wind_distance * drag,
            speed: speed + wind_speed * drag,
        }
    }
}

/// Integrates the full system over the run.
pub fn follow(
    solver: &Solver,
    formulation: Formulation,
    problem: Problem,
    on_piece: OnPiece,
) -> Result<Work, DriftError> {
    problem.wind.require(0.0, problem.duration)?;
    let wind = WindIntegrals::new(problem.wind);
    let invariant = problem.invariant()?;
    let max_step = MAX_STEP * problem.sea.period();
    let Problem { sea, drag, duration, position, .. } = problem;
    let span = (0.0, duration);
    let problem = &problem;
    match formulation {
        Formulation::B => solver.integrate(
            |t, p: &Vec2| {
                let x = p + wind.at(t).1 * drag;
                Ok(sea.velocity(t, x)? + invariant - x * drag)
            },
            span,
            position,
            max_step,
            &mut None,
            |step| on_piece(&FullPiece { problem, wind: &wind, step, invariant }),
        ),
        Formulation::A => {
            // State (P, U − ΛS): the wind's rough part is taken out of both.
            let relative = invariant - position * drag;
            let start = Vector4::new(position.x, position.y, relative.x, relative.y);
            solver.integrate(
                |t, state: &Vector4<f64>| {
                    let (single, double) = wind.at(t);
                    let relative = Vec2::new(state[2], state[3]);
                    let rate = sea.velocity(t, place(state) + double * drag)? + relative;
                    let slowing = -(rate + single * drag) * drag;
                    Ok(Vector4::new(rate.x, rate.y, slowing.x, slowing.y))
                },
                span,
                start,
                max_step,
                &mut None,
                |step| on_piece(&FullPiece { problem, wind: &wind, step, invariant }),
            )
        }
    }
}
