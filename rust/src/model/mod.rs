//! The three models of a drifting body, each as a chain of pieces of trajectory.
//!
//! All integrate in any consistent units, with the tide period as a parameter: [`full`] resolves
//! the tide, [`paper`] is the paper's stroboscopic expansion, [`mean_flow`] the expansion that
//! production runs use.

pub mod body;
pub mod full;
pub mod lanes;
pub mod mean_flow;
pub mod paper;
mod second_order;

use std::ops::ControlFlow;

use nalgebra::SVector;
use num_complex::Complex64;

use crate::dopri5::{Options, Step, Work, euler, integrate};
use crate::error::DriftError;
use crate::field::{CVec2, Harmonic, Harmonics, SeaField, Vec2, conj, real, scaled};
use crate::wind::path::WindPath;

/// What is to be followed: a body released at time 0.
#[derive(Clone, Copy)]
pub struct Problem<'a> {
    /// The sea.
    pub sea: &'a dyn SeaField,
    /// The wind, uniform in space.
    pub wind: &'a WindPath,
    /// Drag rate `Λ` [1/time].
    pub drag: f64,
    /// Length of the run [time].
    pub duration: f64,
    /// Position at time 0.
    pub position: Vec2,
    /// Velocity at time 0.
    pub velocity: Vec2,
}

impl Problem<'_> {
    /// `Q(0) = V − m + ΛX` at the release: equations.md (5).
    fn invariant(&self) -> Result<Vec2, DriftError> {
        let sea = self.sea.velocity(0.0, self.position)?;
        Ok(self.velocity - sea + self.position * self.drag)
    }
}

/// `S = ∫₀ᵗ W` and `∫₀ᵗ S`, counted from the release.
struct WindIntegrals<'a> {
    path: &'a WindPath,
    at_release: (Vec2, Vec2),
    max_speed: f64,
}

impl<'a> WindIntegrals<'a> {
    fn new(path: &'a WindPath) -> Self {
        Self { path, at_release: path.integrals(0.0), max_speed: path.max_speed() }
    }

    /// Those of a stretch of a path whose integrals are counted from the release already.
    fn of_stretch(path: &'a WindPath) -> Self {
        Self { path, at_release: Default::default(), max_speed: path.max_speed() }
    }

    fn at(&self, t: f64) -> (Vec2, Vec2) {
        let (single, double) = self.path.integrals(t);
        (single - self.at_release.0, self.since_release(t, double))
    }

    /// The second of them alone.
    fn double(&self, t: f64) -> Vec2 {
        self.since_release(t, self.path.double_integral(t))
    }

    fn since_release(&self, t: f64, double: Vec2) -> Vec2 {
        let (single0, double0) = self.at_release;
        double - double0 - single0 * t
    }

    /// Bounds, over `h` from `t`, of the change of `∫S` and of `|S|`.
    fn reach(&self, t: f64, h: f64) -> (f64, f64) {
        let speed = self.at(t).0.norm() + self.max_speed * h;
        (speed * h, speed)
    }
}

/// A ball that holds a piece of trajectory, and a bound of the speed in it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// Centre of the ball.
    pub center: Vec2,
    /// Radius of the ball.
    pub radius: f64,
    /// Bound of the speed along the reconstructed trajectory.
    pub speed: f64,
}

/// A body's motion over one step of an integrator.
pub trait Piece {
    /// First and last time.
    fn span(&self) -> (f64, f64);
    /// Position `X`, tidal oscillation included.
    fn position(&self, t: f64) -> Result<Vec2, DriftError>;
    /// Velocity `V`, tidal oscillation included.
    fn velocity(&self, t: f64) -> Result<Vec2, DriftError>;
    /// Slow position and velocity, where the model has them.
    fn mean(&self, t: f64) -> Result<Option<(Vec2, Vec2)>, DriftError>;
    /// Where the piece can be: a bound, so that a coast beyond it need not be looked for.
    fn reach(&self) -> Reach;
}

/// Receives the pieces of a trajectory in the order of time and may stop it.
pub type OnPiece<'a> = &'a mut dyn FnMut(&dyn Piece) -> Result<ControlFlow<()>, DriftError>;

/// How the full model is written; both are exact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Formulation {
    /// Rewrite A: four unknowns, for any body and wind.
    A,
    /// Rewrite B: two unknowns, for the paper's body in a uniform wind.
    B,
}

/// A model with its own parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Model {
    /// The full system.
    Full(Formulation),
    /// The paper's averaged system of order 0 or 1.
    Paper {
        /// Order of the expansion.
        order: u8,
        /// Length of the wind's averaging window [time].
        window: f64,
        /// Whether the terms `B_W` are kept.
        wind_terms: bool,
    },
    /// The mean-flow expansion of order 1 or 2.
    MeanFlow {
        /// Order of the expansion.
        order: u8,
    },
}

/// A model with the tolerances of its integration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solver {
    /// The model.
    pub model: Model,
    /// Relative tolerance.
    pub rtol: f64,
    /// Absolute tolerance [length and velocity].
    pub atol: f64,
    /// Step of the explicit Euler method [time], to compare; Dormand–Prince if none is given.
    pub euler_step: Option<f64>,
}

impl Solver {
    /// The same for a body of some drag in a run of some length. What is integrated, `X − Λ∬W`, is
    /// larger than the position by their product, and so must a relative tolerance be smaller.
    #[must_use]
    pub fn tightened(self, drag: f64, duration: f64) -> Self {
        Self { rtol: self.rtol / (drag * duration).max(1.0), ..self }
    }

    /// Follows one body, handing each piece of its trajectory to `on_piece`.
    pub fn follow(&self, problem: Problem, on_piece: OnPiece) -> Result<Work, DriftError> {
        match self.model {
            Model::Full(formulation) => full::follow(self, formulation, problem, on_piece),
            Model::Paper { order, window, wind_terms } => {
                paper::follow(self, order, window, wind_terms, problem, on_piece)
            }
            Model::MeanFlow { order } => mean_flow::follow(self, order, problem, on_piece),
        }
    }

    /// Interval of time that a wind path must cover.
    pub fn wind_needed(&self, duration: f64, period: f64) -> (f64, f64) {
        match self.model {
            Model::Full(_) | Model::MeanFlow { .. } => (0.0, duration),
            Model::Paper { order, window, wind_terms } => {
                let tide = if wind_terms && order == 1 { period } else { 0.0 };
                (-tide - window / 2.0, duration + tide / 2.0 + window / 2.0)
            }
        }
    }

    /// Integrates by the method chosen; `first_step` goes in as a proposal and comes out as the
    /// next one.
    fn integrate<const N: usize>(
        &self,
        rhs: impl FnMut(f64, &SVector<f64, N>) -> Result<SVector<f64, N>, DriftError>,
        span: (f64, f64),
        start: SVector<f64, N>,
        max_step: f64,
        first_step: &mut Option<f64>,
        on_step: impl FnMut(&Step<N>) -> Result<ControlFlow<()>, DriftError>,
    ) -> Result<Work, DriftError> {
        if let Some(step) = self.euler_step {
            return euler(rhs, span, start, step, on_step);
        }
        let options =
            Options { rtol: self.rtol, atol: self.atol, max_step, first_step: *first_step };
        let (work, next) = integrate(rhs, span, start, options, on_step)?;
        *first_step = Some(next);
        Ok(work)
    }
}

/// Tidal Stokes drift `⟨∇M a⟩` of a body whose excursion in each constituent is `excursion` of it;
/// constituents of one species beat with each other: equations.md (10), (40).
fn stokes_drift(tide: &[Harmonic], t: f64, excursion: impl Fn(&Harmonic) -> CVec2) -> Vec2 {
    let mut drift = Vec2::zeros();
    for (k, moving) in tide.iter().enumerate() {
        let excursion = excursion(moving);
        for (l, carrying) in tide.iter().enumerate() {
            if k == l {
                drift += real(carrying.gradient * conj(excursion)) * 0.5;
            } else if moving.species == carrying.species {
                let beat = Complex64::cis((carrying.omega - moving.omega) * t);
                drift += real(scaled(carrying.gradient * conj(excursion), beat)) * 0.5;
            }
        }
    }
    drift
}

/// Mean of the residual current.
fn mean_residual(at: &Harmonics) -> Vec2 {
    at.residual.first().map_or(Vec2::zeros(), |mean| real(mean.amplitude))
}

/// Mean drift of order 1, `f₁`: tidal Stokes drift and mean residual current, equations.md (10).
fn mean_drift(at: &Harmonics, t: f64) -> Vec2 {
    stokes_drift(&at.tide, t, Harmonic::excursion) + mean_residual(at)
}

/// Fails unless one period holds the tide: what expansions in its phase need.
fn require_periodic(sea: &dyn SeaField, model: &'static str) -> Result<(), DriftError> {
    if sea.is_periodic() {
        return Ok(());
    }
    let what = "a tide of several constituents of one species";
    Err(DriftError::invalid(
        model,
        what,
        "it needs a tide of one period; mean-flow order 1 does not",
    ))
}

/// Harmonics at one time and place.
fn harmonics(sea: &dyn SeaField, t: f64, x: Vec2) -> Result<Harmonics, DriftError> {
    let mut out = Harmonics::default();
    sea.harmonics(t, x, &mut out)?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use crate::field::gridded::{Axis, GriddedSea, Tide};

    use super::*;

    #[test]
    fn several_constituents_have_no_common_period() -> Result<(), DriftError> {
        let sea = |tide, channels| {
            let axis = Axis { start: 0.0, step: 1.0, count: 1 };
            GriddedSea::new(0.1, [axis; 3], tide, channels, vec![0.0.into(); channels])
        };
        assert!(require_periodic(&sea(Tide::Harmonics(2), 4)?, "mean-flow order 2").is_ok());
        let lines = [61.0, 63.0].map(|omega| Harmonic { omega, species: 2, ..Harmonic::default() });
        let several = sea(Tide::Constituents(lines.to_vec()), 4)?;
        let told = require_periodic(&several, "mean-flow order 2").map_err(|e| e.to_string());
        let beginning = "mean-flow order 2: a tide of several constituents of one species is not";
        assert!(told.is_err_and(|words| words.starts_with(beginning)));
        Ok(())
    }
}
