//! Any floating body, from the paper's to search-and-rescue leeway, in full and averaged to order
//! 1: equations.md (35)–(42).
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
    fn corners(&self) -> Vec<f64> {
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
        state: SVector<f64, N>,
        on_piece: OnPiece,
    ) -> Result<Work, DriftError> {
        let longest = match view {
            View::Full => full::MAX_STEP,
            View::Averaged => mean_flow::MAX_STEP,
        };
        self.walk(
            solver,
            longest,
            state,
            |jibed, t, state| self.rates(view, t, state, jibed),
            |jibed, step| on_piece(&BodyPiece { drift: self, view, step, jibed }),
        )
    }

    /// Integrates from corner to corner, by steps of `longest` tides at most; `rates` and `on_step`
    /// are told whether the body has jibed.
    pub(super) fn walk<const N: usize>(
        &self,
        solver: &Solver,
        longest: f64,
        mut state: SVector<f64, N>,
        rates: impl Fn(bool, f64, &SVector<f64, N>) -> Result<SVector<f64, N>, DriftError>,
        mut on_step: impl FnMut(bool, &Step<N>) -> Result<ControlFlow<()>, DriftError>,
    ) -> Result<Work, DriftError> {
        let mut work = Work::default();
        let (mut first_step, mut stopped) = (None, false);
        let mut t = self.release.time;
        for corner in self.corners() {
            let jibed = self.jibes.partition_point(|jibe| *jibe <= t) % 2 == 1;
            work += solver.integrate(
                |t, state| rates(jibed, t, state),
                (t, corner),
                state,
                longest * self.sea.period(),
                &mut first_step,
                |step| {
                    state = step.y_end;
                    let flow = on_step(jibed, step)?;
                    stopped = flow.is_break();
                    Ok(flow)
                },
            )?;
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

#[cfg(test)]
mod tests {
    use crate::field::gridded::{Axis, GriddedSea, Tide};
    use crate::model::Formulation;
    use crate::wind::path::WindPath;

    use super::*;

    /// Two constituents of one species and a current with a harmonic, of no special form.
    fn sea() -> Result<GriddedSea, DriftError> {
        let axis = |start, step, count| Axis { start, step, count };
        let axes = [axis(-6.0, 1.0, 13), axis(-6.0, 1.0, 13), axis(-1.0, 1.0, 4)];
        let channels = 6;
        let value = |k: usize| 0.7 * (0.37 * k as f64).sin();
        let values = (0..15 * 15 * 6 * channels)
            .map(|k| Complex64::new(value(k), value(k * k % 1009)))
            .collect();
        let line = |omega, species| Harmonic { omega, species, ..Harmonic::default() };
        let tide = Tide::Constituents(vec![line(62.8, 2), line(65.0, 2)]);
        GriddedSea::new(0.1, axes, tide, channels, values)
    }

    fn bodies() -> [Body; 4] {
        let line = |slope, offset| Line { slope, offset };
        let leeway = Body {
            downwind: line(0.4, 0.1),
            crosswind: line(0.1, 0.2),
            jibed: line(-0.3, -0.1),
            surface_current: [0.1, 0.05],
            ..Body::default()
        };
        let late = Body { response: 0.05, slip: 0.5, ..leeway };
        // Above 2 a body would answer with more than the water's own motion.
        [leeway, Body { slip: 0.3, ..leeway }, late, Body { slip: 3.0, ..late }]
    }

    fn gusts() -> Result<WindPath, DriftError> {
        let times: Vec<f64> = (0..21).map(|k| 0.05 * f64::from(k)).collect();
        let gust = |t: &f64| Vec2::new((9.0 * t).cos(), (13.0 * t).sin());
        WindPath::new(times.clone(), times.iter().map(gust).collect())
    }

    const MODELS: [Model; 2] = [Model::Full(Formulation::A), Model::MeanFlow { order: 1 }];

    fn solver(model: Model) -> Solver {
        Solver { model, rtol: 1e-7, atol: 1e-7, euler_step: None }
    }

    fn drift<'a>(sea: &'a GriddedSea, wind: &'a WindPath, body: Body) -> Drift<'a> {
        let release = Release { time: 0.0, position: Vec2::new(0.2, -0.3), velocity: None };
        let geometry = Geometry::Plane;
        Drift { sea, wind, geometry, body, release, end: 1.0, jibes: &[] }
    }

    /// Wherever a piece is asked, it is inside its ball and no faster than its bound.
    #[test]
    fn pieces_stay_within_their_reach() -> Result<(), DriftError> {
        let (sea, wind) = (sea()?, gusts()?);
        for geometry in [Geometry::Plane, Geometry::Sphere { latitude: 70.0 }] {
            for body in bodies() {
                for model in MODELS {
                    let drift = Drift { geometry, ..drift(&sea, &wind, body) };
                    let mut largest: f64 = 0.0;
                    drift.follow(&solver(model), &mut |piece| {
                        let (t, end) = piece.span();
                        let Reach { center, radius, speed } = piece.reach();
                        let places = (0..=40)
                            .map(|k| piece.position(t + (end - t) * f64::from(k) / 40.0))
                            .collect::<Result<Vec<_>, _>>()?;
                        for x in &places {
                            assert!((x - center).norm() <= radius * (1.0 + 1e-12));
                            largest = largest.max((x - center).norm() / radius);
                        }
                        for pair in places.windows(2) {
                            let moved = (pair[1] - pair[0]).norm() / ((end - t) / 40.0);
                            assert!(moved <= speed * (1.0 + 1e-9), "{moved} {speed}");
                        }
                        Ok(ControlFlow::Continue(()))
                    })?;
                    // A ball a hundred times too large would be a bound as well, but of no use.
                    assert!(largest > 0.05, "{model:?} {body:?}: {largest}");
                }
            }
        }
        Ok(())
    }

    /// The wind's speed at a bend or a jibe is that of the piece after it; none spans a corner.
    #[test]
    fn pieces_end_at_knots_and_jibes() -> Result<(), DriftError> {
        let (sea, wind) = (sea()?, gusts()?);
        let release = Release { time: 0.12, ..drift(&sea, &wind, bodies()[0]).release };
        // Before the release, on a knot, a rounding error from one, and inside.
        let jibes = [0.07, 0.2, 0.25 + 1e-15, 0.61, 0.62];
        let drift = Drift { release, jibes: &jibes, ..drift(&sea, &wind, bodies()[0]) };
        let corners = drift.corners();
        assert!(corners.windows(2).all(|pair| pair[1] - pair[0] > 1e-12));
        assert_eq!(corners.len(), 18 + 2); // knots 0.15 … 1, and 0.61 and 0.62
        assert!(corners[0] > 0.14 && corners[corners.len() - 1] == 1.0);
        for model in MODELS {
            let mut ends = Vec::new();
            drift.follow(&solver(model), &mut |piece| {
                let (t, end) = piece.span();
                assert!(!corners.iter().any(|corner| *corner > t && *corner < end));
                ends.push(end);
                Ok(ControlFlow::Continue(()))
            })?;
            assert!(corners.iter().all(|corner| ends.contains(corner)), "{model:?}");
        }
        Ok(())
    }

    /// In still water and a steady wind the velocity is the leeway of the side of the time.
    #[test]
    fn jibes_change_the_side_and_change_it_back() -> Result<(), DriftError> {
        let axis = Axis { start: 0.0, step: 1.0, count: 1 };
        let still = GriddedSea::new(0.1, [axis; 3], Tide::Harmonics(0), 2, vec![0.0.into(); 2])?;
        let wind = WindPath::new(vec![0.0, 1.0], vec![Vec2::new(0.0, 2.0); 2])?;
        let body = Body { surface_current: [0.0; 2], ..bodies()[0] };
        let drift = Drift { jibes: &[0.25, 0.5, 0.8], ..drift(&still, &wind, body) };
        // 0.4·2 + 0.1 ahead, which is north; 0.1·2 + 0.2 to the right, or 0.3·2 + 0.1 to the left.
        let (right, left) = (Vec2::new(0.4, 0.9), Vec2::new(-0.7, 0.9));
        for model in MODELS {
            let mut last = Vec2::zeros();
            drift.follow(&solver(model), &mut |piece| {
                let (t, end) = piece.span();
                let side = if (0.25..0.5).contains(&t) || t >= 0.8 { left } else { right };
                for at in [t, (t + end) / 2.0, end] {
                    assert!((piece.velocity(at)? - side).norm() < 1e-12, "{model:?} at {at}");
                }
                last = piece.position(end)?;
                Ok(ControlFlow::Continue(()))
            })?;
            let expected = drift.release.position + right * 0.55 + left * 0.45;
            assert!((last - expected).norm() < 1e-12, "{model:?}");
        }
        Ok(())
    }

    /// What a piece calls velocity is the rate of its position, in units of speed.
    #[test]
    fn velocity_is_the_rate_of_the_position() -> Result<(), DriftError> {
        let (sea, wind) = (sea()?, gusts()?);
        let geometry = Geometry::Sphere { latitude: 60.0 };
        for body in bodies() {
            let drift = Drift { geometry, ..drift(&sea, &wind, body) };
            let precise = Solver { rtol: 1e-11, atol: 1e-11, ..solver(MODELS[0]) };
            drift.follow(&precise, &mut |piece| {
                let (t, end) = piece.span();
                let (middle, h) = ((t + end) / 2.0, (end - t) / 20.0);
                let rate = (piece.position(middle + h)? - piece.position(middle - h)?) / (2.0 * h);
                let metric = geometry.metric(piece.position(middle)?)?;
                let found = piece.velocity(middle)?.component_mul(&metric);
                assert!((found - rate).norm() < 1e-3 * (1.0 + rate.norm()), "{found} {rate}");
                Ok(ControlFlow::Continue(()))
            })?;
        }
        Ok(())
    }

    /// A velocity at the release counts for a body that has a response time, and for no other.
    #[test]
    fn the_release_s_velocity_is_that_of_the_first_piece() -> Result<(), DriftError> {
        let (sea, wind) = (sea()?, gusts()?);
        let given = Vec2::new(0.3, -2.0);
        for body in bodies() {
            for model in MODELS {
                let mut drift = drift(&sea, &wind, body);
                drift.release.velocity = Some(given);
                let mut first = None;
                drift.follow(&solver(model), &mut |piece| {
                    first = Some(piece.velocity(0.0)?);
                    Ok(ControlFlow::Break(()))
                })?;
                let off = first.map_or(f64::NAN, |velocity| (velocity - given).norm());
                assert_eq!(off < 1e-9, body.response > 0.0, "{model:?} {body:?}: {off}");
            }
        }
        Ok(())
    }
}
