//! Sea-surface velocity in one representation, two views.
//!
//! The sea moves with `m = M + n`: the tide `M = Σ_k Re[Z_k(t, x) e^{iω_k t}]`, of zero mean over
//! a tide, and the weaker residual current `n = R(t, x) + Σ_j Re[P_j(t, x) e^{ijωt}]` (the paper's
//! `εN`). `ω = 2π/T`; the tide's frequencies `ω_k` are its multiples, or those of the constituents
//! of a real tide. The full model asks for the instantaneous velocity, the averaged models for the
//! slowly varying coefficients: equations.md (2), (3).

pub mod academic;
pub mod gridded;
pub mod sum;

use nalgebra::{Matrix2, Vector2};
use num_complex::Complex64;
use smallvec::SmallVec;

use crate::error::DriftError;

/// A position or velocity in the plane.
pub type Vec2 = Vector2<f64>;
/// A complex amplitude of a plane vector.
pub type CVec2 = Vector2<Complex64>;
/// A complex Jacobian: row = component, column = direction of the derivative.
pub type CMat2 = Matrix2<Complex64>;

/// One complex amplitude with the derivatives that the averaged models need.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Harmonic {
    /// Angular frequency `ω_k` [1/time]; 0 for a mean.
    pub omega: f64,
    /// About how many cycles a day (or a tide) it has: the constituents of one species beat slowly.
    pub species: u32,
    /// Amplitude `Z_j` [length/time].
    pub amplitude: CVec2,
    /// Jacobian `∇Z_j` [1/time].
    pub gradient: CMat2,
    /// Slow time derivative `∂ₜZ_j` [length/time²].
    pub rate: CVec2,
    /// `∂²Z_j/∂x_k∂x_l` of each component [1/(length·time)]; zero where a field is linear.
    pub hessian: [CMat2; 2],
}

/// The slowly varying coefficients of a sea field at one time and place; the usual number of
/// harmonics needs no allocation.
#[derive(Debug, Clone, Default)]
pub struct Harmonics {
    /// Tide: one entry for each constituent; where the tide is periodic, entry `j − 1` is harmonic
    /// `j` of its frequency.
    pub tide: SmallVec<[Harmonic; 4]>,
    /// Residual current: entry 0 is the mean (real), entry `j` harmonic `j`.
    pub residual: SmallVec<[Harmonic; 4]>,
}

/// Upper bounds over a ball of positions and all times of the run; they make it provable that a
/// coast is out of reach.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct FieldBounds {
    /// `Σ_k |Z_k|`.
    pub tide: f64,
    /// `Σ_j ‖∇Z_j‖`.
    pub gradient: f64,
    /// `Σ_j |∂ₜZ_j|`.
    pub rate: f64,
    /// `|R| + Σ_j |P_j|`.
    pub residual: f64,
}

/// Cycles in a tide of what a field is made of: of more, a unit is wrong.
const MOST_CYCLES: f64 = 100.0;

/// Fails unless a field may change with so many cycles in a tide.
fn slow_enough(field: &'static str, value: f64, cycles: f64) -> Result<(), DriftError> {
    if cycles.abs() <= MOST_CYCLES {
        return Ok(());
    }
    let accepted = format!("a tide has at most {MOST_CYCLES} of its cycles");
    Err(DriftError::invalid(field, value, accepted))
}

/// Sea-surface velocity, equations.md (2).
pub trait SeaField: Send + Sync {
    /// Tide period `T` [time].
    fn period(&self) -> f64;

    /// Velocity `m` [length/time] at time `t`, position `x`; `OutsideDomain` beyond the data.
    fn velocity(&self, t: f64, x: Vec2) -> Result<Vec2, DriftError>;

    /// Slowly varying harmonics of the tidal phase, with gradients and time derivatives.
    fn harmonics(&self, t: f64, x: Vec2, out: &mut Harmonics) -> Result<(), DriftError>;

    /// The same without time and second derivatives, which may be left 0: what order 1 needs at
    /// every stage of every step.
    fn gradients(&self, t: f64, x: Vec2, out: &mut Harmonics) -> Result<(), DriftError> {
        self.harmonics(t, x, out)
    }

    /// The tide's excursion `∫~ M dt`, `a₁` of equations.md (9): asked for at every output and
    /// every look at a coast.
    fn excursion(&self, t: f64, x: Vec2) -> Result<Vec2, DriftError> {
        let mut at = Harmonics::default();
        self.gradients(t, x, &mut at)?;
        Ok(at.tide.iter().map(|h| in_phase(h.excursion(), h.phasor(t))).sum())
    }

    /// Bounds that hold in the ball around `center` at every time of the run.
    fn bounds(&self, center: Vec2, radius: f64) -> FieldBounds;

    /// Whether velocity and harmonics are linear in the position.
    fn is_linear(&self) -> bool {
        false
    }

    /// Whether the tide's frequencies are the multiples `jω`, in their order, so that one period
    /// holds it all.
    fn is_periodic(&self) -> bool {
        true
    }

    /// Lowest frequency [1/time] of the tide: what bounds its excursion.
    fn slowest(&self) -> f64 {
        self.omega()
    }

    /// Angular frequency `ω` [1/time] of the tide.
    fn omega(&self) -> f64 {
        std::f64::consts::TAU / self.period()
    }
}

impl Harmonic {
    /// Harmonic `j` of the frequency `omega`, of amplitude 0.
    pub fn multiple(j: usize, omega: f64) -> Self {
        Self { omega: j as f64 * omega, species: j as u32, ..Self::default() }
    }

    /// Adds the amplitude and derivatives of another of the same frequency.
    pub(crate) fn add(&mut self, other: &Self) {
        self.omega = other.omega;
        self.species = other.species;
        self.amplitude += other.amplitude;
        self.gradient += other.gradient;
        self.rate += other.rate;
        for (sum, term) in self.hessian.iter_mut().zip(&other.hessian) {
            *sum += term;
        }
    }

    /// `e^{iω_k t}`.
    pub fn phasor(&self, t: f64) -> Complex64 {
        Complex64::cis(self.omega * t)
    }

    /// `1/(iω_k)`: turns the amplitude into that of the zero-mean antiderivative.
    pub fn antiderivative(&self) -> Complex64 {
        Complex64::new(0.0, -1.0 / self.omega)
    }

    /// Amplitude of the excursion `∫~ dt`.
    pub fn excursion(&self) -> CVec2 {
        scaled(self.amplitude, self.antiderivative())
    }
}

/// `e^{ijωt}` for `j = 1, 2, …` by repeated multiplication.
pub fn phasors(omega_t: f64) -> impl Iterator<Item = Complex64> {
    let first = Complex64::cis(omega_t);
    std::iter::successors(Some(first), move |phasor| Some(phasor * first))
}

/// `c` times the complex vector `v`.
pub fn scaled(v: CVec2, c: Complex64) -> CVec2 {
    CVec2::new(v.x * c, v.y * c)
}

/// Real part of `v e^{ijωt}`, given the phasor.
pub fn in_phase(v: CVec2, phasor: Complex64) -> Vec2 {
    Vec2::new((v.x * phasor).re, (v.y * phasor).re)
}

/// Real part, by component.
pub fn real(v: CVec2) -> Vec2 {
    Vec2::new(v.x.re, v.y.re)
}

/// Complex conjugate, by component.
pub fn conj(v: CVec2) -> CVec2 {
    CVec2::new(v.x.conj(), v.y.conj())
}

/// A real vector with zero imaginary parts.
pub fn complex(v: Vec2) -> CVec2 {
    CVec2::new(v.x.into(), v.y.into())
}
