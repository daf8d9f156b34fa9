//! Any floating body, from the paper's to search-and-rescue leeway, in full and averaged to order
//! 1: equations.md (25)–(28).
//!
//! A body of response time `τ` and slip `α` moves with `X' = m + U`, `U' = (F(W) − αm − U)/τ`;
//! for `τ = 0` it is `X' = (1 − α)m + F(W)`. `F` is the velocity that the wind alone would give
//! it. The paper's body is `α = 1`, `F = W`, `τ = 1/Λ`; leeway tables measure drift through the
//! water, so there `α = 0`. On the sphere everything is in the rates of the coordinates.

use std::ops::ControlFlow;

use nalgebra::SVector;
use num_complex::Complex64;

use super::{
    Model, OnPiece, Piece, Reach, Solver, full, harmonics, mean_flow, mean_residual, second_order,
    stokes_drift,
};
use crate::dopri5::{Step, Work};
use crate::error::DriftError;
use crate::field::{CVec2, Harmonic, SeaField, Vec2, in_phase, scaled};
use crate::geometry::Geometry;
use crate::wind::Wind;

/// Speed as a straight line in the wind's speed.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Line {
    /// Share of the wind's speed.
    pub slope: f64,
    /// Speed at the lightest wind.
    pub offset: f64,
}

impl Line {
    fn at(self, speed: f64) -> f64 {
        self.slope * speed + self.offset
    }
}

/// A floating body: what wind and water do to it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Body {
    /// Response time `τ` [time], 0 for a body that follows at once.
    pub response: f64,
    /// Share `α` of the water's own motion that the body resists.
    pub slip: f64,
    /// Leeway along the wind.
    pub downwind: Line,
    /// Leeway to the right of the wind, and to its left where negative, before each second jibe.
    pub crosswind: Line,
    /// The same between the jibes.
    pub jibed: Line,
    /// Surface current that the wind drives: parts of it along the wind and to its right.
    pub surface_current: [f64; 2],
}

impl Body {
    /// Velocity `F(W)` that the wind alone gives.
    fn leeway(&self, wind: Vec2, jibed: bool) -> Vec2 {
        let speed = wind.norm();
        if speed == 0.0 {
            return Vec2::zeros();
        }
        let along = wind / speed;
        let across = if jibed { self.jibed } else { self.crosswind };
        along * self.downwind.at(speed) + right_of(along) * across.at(speed)
    }

    fn current(&self, wind: Vec2) -> Vec2 {
        wind * self.surface_current[0] + right_of(wind) * self.surface_current[1]
    }

    /// Factor `r = 1 − α/(1 + iωτ)` with which it answers the water's oscillation.
    fn response_to(&self, omega: f64) -> Complex64 {
        1.0 - self.slip / Complex64::new(1.0, omega * self.response)
    }

    /// Amplitude of its tidal excursion.
    fn excursion(&self, tide: &Harmonic) -> CVec2 {
        scaled(tide.excursion(), self.response_to(tide.omega))
    }
}

fn right_of(v: Vec2) -> Vec2 {
    Vec2::new(v.y, -v.x)
}

/// A body released at some time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Release {
    /// Time of the release.
    pub time: f64,
    /// Where.
    pub position: Vec2,
    /// Velocity in units of speed; that of the water, if none is given.
    pub velocity: Option<Vec2>,
}

/// What is to be followed.
#[derive(Clone, Copy)]
pub struct Drift<'a> {
    /// The sea; its velocities are rates of the coordinates.
    pub sea: &'a dyn SeaField,
    /// The wind, in units of speed.
    pub wind: &'a dyn Wind,
    /// The coordinates.
    pub geometry: Geometry,
    /// The body.
    pub body: Body,
    /// Its release.
    pub release: Release,
    /// End of the run.
    pub end: f64,
    /// Times at which the body jibes, in order.
    pub jibes: &'a [f64],
}

/// How the sea enters the motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum View {
    Full,
    Averaged,
}

/// What acts on the body at one time and place, as rates of the coordinates.
struct Action {
    /// The sea, or its mean drift, with the surface current that the wind drives.
    water: Vec2,
    /// `F(W)`.
    leeway: Vec2,
}

impl Drift<'_> {
    fn action(&self, view: View, t: f64, x: Vec2, jibed: bool) -> Result<Action, DriftError> {
        let wind = self.wind.at(t, x)?;
        let metric = self.geometry.metric(x)?;
        let sea = match view {
            View::Full => self.sea.velocity(t, x)?,
            View::Averaged => {
                let at = harmonics(self.sea, t, x)?;
                stokes_drift(&at.tide, t, |tide| self.body.excursion(tide)) + mean_residual(&at)
            }
        };
        let water = sea + self.body.current(wind).component_mul(&metric);
        let leeway = self.body.leeway(wind, jibed).component_mul(&metric);
        Ok(Action { water, leeway })
    }

    /// `Σ_k Re[factor(ω_k) Z_k e^{iω_k t}]`.
    fn tidal_sum(
        &self,
        t: f64,
        x: Vec2,
        amplitude: impl Fn(&Harmonic) -> CVec2,
    ) -> Result<Vec2, DriftError> {
        let at = harmonics(self.sea, t, x)?;
        Ok(at.tide.iter().map(|tide| in_phase(amplitude(tide), tide.phasor(t))).sum())
    }

    fn excursion(&self, t: f64, y: Vec2) -> Result<Vec2, DriftError> {
        self.tidal_sum(t, y, |tide| self.body.excursion(tide))
    }

    /// What the tide adds to the slow velocity through the water: `−Σ Re[α c/(1 + iωτ) e^{iωt}]`.
    fn oscillating_slip(&self, t: f64, y: Vec2) -> Result<Vec2, DriftError> {
        self.tidal_sum(t, y, |tide| scaled(tide.amplitude, self.body.response_to(tide.omega) - 1.0))
    }

    /// Slow position at the release: `Y + a₁(Y) = x`, by iteration.
    fn slow_start(&self) -> Result<Vec2, DriftError> {
        let Release { time, position, .. } = self.release;
        mean_flow::slow_position(position, |y| self.excursion(time, y))
    }

    /// Times between which wind and jibes are smooth.
    pub(super) fn corners(&self) -> Vec<f64> {
        let (start, end) = (self.release.time, self.end);
        let inside = |t: &&f64| **t > start && **t < end;
        let mut corners: Vec<f64> =
            self.wind.knots().iter().chain(self.jibes).filter(inside).copied().collect();
        corners.sort_unstable_by(f64::total_cmp);
        corners.push(end);
        // Steps shorter than the rounding of time cannot be made.
        let shortest = 1e-12 * (end - start);
        corners.dedup_by(|later, earlier| *later - *earlier <= shortest);
        if let Some(last) = corners.last_mut() {
            *last = end;
        }
        corners
    }

    /// Follows the body by the full or the averaged model.
    pub fn follow(&self, solver: &Solver, on_piece: OnPiece) -> Result<Work, DriftError> {
        self.wind.require(self.release.time, self.end)?;
        let view = match solver.model {
            Model::Full(_) => View::Full,
            Model::MeanFlow { order: 1 } => View::Averaged,
            Model::MeanFlow { order: 2 } => {
                return second_order::follow(self, solver, on_piece);
            }
            _ => {
                return Err(DriftError::invalid(
                    "model",
                    "an expansion of the paper's body",
                    "other bodies have the full model and mean-flow order 1",
                ));
            }
        };
        let Release { time, position, velocity } = self.release;
        let start = match view {
            View::Full => position,
            View::Averaged => self.slow_start()?,
        };
        if self.body.response == 0.0 {
            return self.follow_in(view, solver, start, on_piece);
        }
        let mut relative = match velocity {
            None => Vec2::zeros(),
            Some(velocity) => {
                let water = self.action(View::Full, time, position, false)?.water;
                velocity.component_mul(&self.geometry.metric(position)?) - water
            }
        };
        if view == View::Averaged {
            relative -= self.oscillating_slip(time, start)?;
        }
        let state = SVector::<f64, 4>::new(start.x, start.y, relative.x, relative.y);
        self.follow_in(view, solver, state, on_piece)
    }

    fn follow_in<const N: usize>(
        &self,
        view: View,
        solver: &Solver,
        mut state: SVector<f64, N>,
        on_piece: OnPiece,
    ) -> Result<Work, DriftError> {
        let max_step = self.sea.period()
            * match view {
                View::Full => full::MAX_STEP,
                View::Averaged => mean_flow::MAX_STEP,
            };
        let mut work = Work::default();
        let (mut first_step, mut stopped) = (None, false);
        let mut t = self.release.time;
        for corner in self.corners() {
            let jibed = self.jibes.partition_point(|jibe| *jibe <= t) % 2 == 1;
            let done = solver.integrate(
                |t, state| self.rates(view, t, state, jibed),
                (t, corner),
                state,
                max_step,
                &mut first_step,
                |step| {
                    state = step.y_end;
                    let flow = on_piece(&BodyPiece { drift: self, view, step, jibed })?;
                    stopped = flow.is_break();
                    Ok(if stopped { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
                },
            )?;
            work += done;
            if stopped {
                break;
            }
            t = corner;
        }
        Ok(work)
    }

    fn rates<const N: usize>(
        &self,
        view: View,
        t: f64,
        state: &SVector<f64, N>,
        jibed: bool,
    ) -> Result<SVector<f64, N>, DriftError> {
        let Action { water, leeway } = self.action(view, t, place(state), jibed)?;
        let mut rates = SVector::zeros();
        let driven = leeway - water * self.body.slip;
        for i in 0..2 {
            rates[i] = water[i] + if N == 4 { state[N - 2 + i] } else { driven[i] };
            if N == 4 {
                rates[N - 2 + i] = (driven[i] - state[N - 2 + i]) / self.body.response;
            }
        }
        Ok(rates)
    }
}

fn place<const N: usize>(state: &SVector<f64, N>) -> Vec2 {
    Vec2::new(state[0], state[1])
}

struct BodyPiece<'a, const N: usize> {
    drift: &'a Drift<'a>,
    view: View,
    step: &'a Step<N>,
    jibed: bool,
}

impl<const N: usize> BodyPiece<'_, N> {
    /// Rates of the coordinates as units of speed.
    fn speed(&self, x: Vec2, rate: Vec2) -> Result<Vec2, DriftError> {
        Ok(rate.component_div(&self.drift.geometry.metric(x)?))
    }

    /// The body's velocity through the water, where its slow position and state are known.
    fn relative(&self, t: f64, water: Vec2, leeway: Vec2) -> Result<Vec2, DriftError> {
        if N == 2 {
            return Ok(leeway - water * self.drift.body.slip);
        }
        let state = self.step.state(t);
        let slow = Vec2::new(state[N - 2], state[N - 1]);
        match self.view {
            View::Full => Ok(slow),
            View::Averaged => Ok(slow + self.drift.oscillating_slip(t, place(&state))?),
        }
    }
}

impl<const N: usize> Piece for BodyPiece<'_, N> {
    fn span(&self) -> (f64, f64) {
        (self.step.t, self.step.end)
    }

    fn position(&self, t: f64) -> Result<Vec2, DriftError> {
        let y = place(&self.step.state(t));
        match self.view {
            View::Full => Ok(y),
            View::Averaged => Ok(y + self.drift.excursion(t, y)?),
        }
    }

    fn velocity(&self, t: f64) -> Result<Vec2, DriftError> {
        let x = self.position(t)?;
        let Action { water, leeway } = self.drift.action(View::Full, t, x, self.jibed)?;
        self.speed(x, water + self.relative(t, water, leeway)?)
    }

    fn mean(&self, t: f64) -> Result<Option<(Vec2, Vec2)>, DriftError> {
        if self.view == View::Full {
            return Ok(None);
        }
        let state = self.step.state(t);
        let rates = self.drift.rates(self.view, t, &state, self.jibed)?;
        let y = place(&state);
        Ok(Some((y, self.speed(y, place(&rates))?)))
    }

    fn reach(&self) -> Reach {
        let center = place(&self.step.y);
        let (radius, speed) = self.step.reach(0);
        let slow = Reach { center, radius, speed };
        match self.view {
            View::Full => slow,
            View::Averaged => {
                let answer = 1.0_f64.max((1.0 - self.drift.body.slip).abs());
                mean_flow::oscillating_first(self.drift.sea, slow, answer)
            }
        }
    }
}
