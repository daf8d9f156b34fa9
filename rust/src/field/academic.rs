//! The paper's academic sea: a separable tide and residual current, linear in position.

use num_complex::Complex64;

use super::{CMat2, FieldBounds, Harmonic, Harmonics, SeaField, Vec2, slow_enough};
use crate::error::{DriftError, finite, positive};

/// `x_k · (mean + modulation · wave(2π·cycles·t)) · Σ_j s_j sin(jωt)`: one of the two
/// parts of the academic sea, paper section 4.1.
#[derive(Debug, Clone, PartialEq)]
pub struct SeparableCurrent {
    /// Mean strength.
    pub mean: f64,
    /// Strength of the slow modulation.
    pub modulation: f64,
    /// Cycles of the slow modulation in one unit of time.
    pub cycles: f64,
    /// Phase of the modulation: 0 for a sine, π/2 for a cosine.
    pub phase: f64,
    /// Component of the position that the current is proportional to: 0 or 1.
    pub axis: usize,
    /// Sine amplitudes `s_j` of the harmonics `j = 1, 2, …`.
    pub sines: Vec<Vec2>,
}

impl SeparableCurrent {
    fn strength(&self, t: f64) -> (f64, f64) {
        let rate = std::f64::consts::TAU * self.cycles;
        let (sin, cos) = (rate * t + self.phase).sin_cos();
        (self.mean + self.modulation * sin, self.modulation * rate * cos)
    }

    fn velocity(&self, t: f64, omega_t: f64, x: Vec2) -> Vec2 {
        let wave: Vec2 =
            super::phasors(omega_t).zip(&self.sines).map(|(phasor, s)| s * phasor.im).sum();
        wave * (self.strength(t).0 * x[self.axis])
    }

    /// Amplitude of harmonic `j`: `−i s_j x_k strength(t)`, since `sin φ = Re[−i e^{iφ}]`.
    fn harmonics(&self, t: f64, omega: f64, x: Vec2) -> impl Iterator<Item = Harmonic> {
        let (strength, rate) = self.strength(t);
        let (axis, position) = (self.axis, x[self.axis]);
        (1..).zip(&self.sines).map(move |(j, s)| {
            let unit = s.map(|component| Complex64::new(0.0, -component));
            let mut gradient = CMat2::zeros();
            gradient.set_column(axis, &super::scaled(unit, strength.into()));
            Harmonic {
                amplitude: super::scaled(unit, (strength * position).into()),
                gradient,
                rate: super::scaled(unit, (rate * position).into()),
                ..Harmonic::multiple(j, omega)
            }
        })
    }

    /// Largest (Σ|Z_j|, Σ‖∇Z_j‖, Σ|∂ₜZ_j|) in a ball, for the sum `waves` of all |s_j|.
    fn bounds(&self, waves: f64, center: Vec2, radius: f64) -> (f64, f64, f64) {
        let strength = self.mean.abs() + self.modulation.abs();
        let rate = std::f64::consts::TAU * self.cycles.abs() * self.modulation.abs();
        let position = center[self.axis].abs() + radius;
        (waves * strength * position, waves * strength, waves * rate * position)
    }
}

/// The sea of the paper's numerical experiments: `M` and `N` of section 4.1.
#[derive(Debug, Clone, PartialEq)]
pub struct AcademicSea {
    period: f64,
    tide: SeparableCurrent,
    residual: SeparableCurrent,
    /// `Σ|s_j|` of both.
    waves: [f64; 2],
    /// Cosine amplitudes `−s_j/(jω)` of the tide's excursion.
    cosines: Vec<Vec2>,
}

impl AcademicSea {
    /// Builds the sea from its tide `M` and its residual current, which is multiplied by
    /// `residual_scale` (the paper's ε).
    pub fn new(
        period: f64,
        tide: SeparableCurrent,
        mut residual: SeparableCurrent,
        residual_scale: f64,
    ) -> Result<Self, DriftError> {
        positive("period", period)?;
        positive("period", std::f64::consts::TAU / period)?;
        finite("residual scale", &[residual_scale])?;
        for current in [&tide, &residual] {
            let SeparableCurrent { mean, modulation, cycles, phase, sines, .. } = current;
            finite("current", &[*mean, *modulation, *cycles, *phase])?;
            slow_enough("cycles", *cycles, cycles * period)?;
            finite("harmonics", &sines.iter().flat_map(|s| [s.x, s.y]).collect::<Vec<_>>())?;
            if current.axis > 1 {
                return Err(DriftError::invalid("axis", current.axis, "it must be 0 or 1"));
            }
        }
        for s in &mut residual.sines {
            *s *= residual_scale;
        }
        let waves = [&tide, &residual].map(|of| of.sines.iter().map(|s| s.norm()).sum());
        let omega = std::f64::consts::TAU / period;
        let cosines = (1..).zip(&tide.sines).map(|(j, s)| s / (-f64::from(j) * omega)).collect();
        Ok(Self { period, tide, residual, waves, cosines })
    }

    /// The paper's numbers at a given `ε` (time unit: the run).
    pub fn paper(epsilon: f64) -> Result<Self, DriftError> {
        let tide = SeparableCurrent {
            mean: 2.0,
            modulation: 1.0,
            cycles: 3.0,
            phase: 0.0,
            axis: 0,
            sines: vec![Vec2::new(1.0, 0.5), Vec2::new(0.25, 0.0)],
        };
        let residual = SeparableCurrent {
            phase: std::f64::consts::FRAC_PI_2,
            axis: 1,
            sines: vec![Vec2::new(1.0, 1.0)],
            ..tide.clone()
        };
        Self::new(epsilon, tide, residual, epsilon)
    }
}

impl SeaField for AcademicSea {
    fn period(&self) -> f64 {
        self.period
    }

    fn velocity(&self, t: f64, x: Vec2) -> Result<Vec2, DriftError> {
        let omega_t = self.omega() * t;
        Ok(self.tide.velocity(t, omega_t, x) + self.residual.velocity(t, omega_t, x))
    }

    fn harmonics(&self, t: f64, x: Vec2, out: &mut Harmonics) -> Result<(), DriftError> {
        out.tide.clear();
        out.tide.extend(self.tide.harmonics(t, self.omega(), x));
        out.residual.clear();
        out.residual.push(Harmonic::default());
        out.residual.extend(self.residual.harmonics(t, self.omega(), x));
        Ok(())
    }

    fn excursion(&self, t: f64, x: Vec2) -> Result<Vec2, DriftError> {
        let phasors = super::phasors(self.omega() * t);
        let wave: Vec2 = phasors.zip(&self.cosines).map(|(phasor, c)| c * phasor.re).sum();
        Ok(wave * (self.tide.strength(t).0 * x[self.tide.axis]))
    }

    fn is_linear(&self) -> bool {
        true
    }

    fn bounds(&self, center: Vec2, radius: f64) -> FieldBounds {
        let (tide, gradient, rate) = self.tide.bounds(self.waves[0], center, radius);
        let (residual, _, _) = self.residual.bounds(self.waves[1], center, radius);
        FieldBounds { tide, gradient, rate, residual }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_views_agree() -> Result<(), DriftError> {
        let sea = AcademicSea::paper(0.02)?;
        let mut harmonics = Harmonics::default();
        for k in 0..50 {
            let (t, x) = (0.0137 * k as f64, Vec2::new(1.0 - 0.01 * k as f64, 0.5));
            sea.harmonics(t, x, &mut harmonics)?;
            let mut sum = super::super::real(harmonics.residual[0].amplitude);
            for (j, phasor) in super::super::phasors(sea.omega() * t).take(2).enumerate() {
                sum += super::super::in_phase(harmonics.tide[j].amplitude, phasor);
                if let Some(residual) = harmonics.residual.get(j + 1) {
                    sum += super::super::in_phase(residual.amplitude, phasor);
                }
            }
            assert!((sum - sea.velocity(t, x)?).norm() < 1e-13);
            let tide = harmonics.tide.iter();
            let excursion: Vec2 =
                tide.map(|h| super::super::in_phase(h.excursion(), h.phasor(t))).sum();
            assert!((excursion - sea.excursion(t, x)?).norm() < 1e-16);
        }
        Ok(())
    }

    #[test]
    fn bounds_hold() -> Result<(), DriftError> {
        let sea = AcademicSea::paper(0.02)?;
        let bounds = sea.bounds(Vec2::new(1.0, 1.0), 0.3);
        for k in 0..1000 {
            let angle = 0.1 * k as f64;
            let x = Vec2::new(1.0 + 0.3 * angle.cos(), 1.0 + 0.3 * angle.sin());
            assert!(sea.velocity(0.001 * k as f64, x)?.norm() <= bounds.tide + bounds.residual);
        }
        Ok(())
    }
}
