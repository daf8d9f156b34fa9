//! Several seas at once: a tide and the currents beside it, each with its own grid.

use std::sync::Arc;

use super::{FieldBounds, Harmonic, Harmonics, SeaField, Vec2};
use crate::error::DriftError;

/// The sum of some seas. Only one may have a tide that is not of its period, and the first says
/// what the period is.
pub struct SumOfSeas {
    parts: Vec<Arc<dyn SeaField>>,
}

impl SumOfSeas {
    /// Adds up at least one sea.
    pub fn new(parts: Vec<Arc<dyn SeaField>>) -> Result<Self, DriftError> {
        if parts.is_empty() {
            return Err(DriftError::invalid("seas", "none", "a sum needs at least one"));
        }
        Ok(Self { parts })
    }

    /// The harmonics of all, as `of` asks one of them.
    fn gather(
        &self,
        out: &mut Harmonics,
        of: impl Fn(&dyn SeaField, &mut Harmonics) -> Result<(), DriftError>,
    ) -> Result<(), DriftError> {
        let mut one = Harmonics::default();
        out.tide.clear();
        out.residual.clear();
        for part in &self.parts {
            of(part.as_ref(), &mut one)?;
            out.tide.extend(one.tide.drain(..));
            let have = out.residual.len().max(one.residual.len());
            out.residual.resize(have, Harmonic::default());
            for (sum, term) in out.residual.iter_mut().zip(&one.residual) {
                sum.add(term);
            }
        }
        Ok(())
    }
}

impl SeaField for SumOfSeas {
    fn period(&self) -> f64 {
        self.parts[0].period()
    }

    fn slowest(&self) -> f64 {
        self.parts.iter().map(|part| part.slowest()).fold(f64::INFINITY, f64::min)
    }

    /// The tides of two seas are not put together by harmonic: together they are no longer in order.
    fn is_periodic(&self) -> bool {
        self.parts.len() == 1 && self.parts[0].is_periodic()
    }

    fn velocity(&self, t: f64, x: Vec2) -> Result<Vec2, DriftError> {
        self.parts.iter().map(|part| part.velocity(t, x)).sum()
    }

    fn harmonics(&self, t: f64, x: Vec2, out: &mut Harmonics) -> Result<(), DriftError> {
        self.gather(out, |part, one| part.harmonics(t, x, one))
    }

    fn gradients(&self, t: f64, x: Vec2, out: &mut Harmonics) -> Result<(), DriftError> {
        self.gather(out, |part, one| part.gradients(t, x, one))
    }

    fn bounds(&self, center: Vec2, radius: f64) -> FieldBounds {
        let mut sum = FieldBounds::default();
        for part in &self.parts {
            let FieldBounds { tide, gradient, rate, residual } = part.bounds(center, radius);
            sum.tide += tide;
            sum.gradient += gradient;
            sum.rate += rate;
            sum.residual += residual;
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use num_complex::Complex64;

    use super::super::gridded::{Axis, GriddedSea, Tide};
    use super::super::{CVec2, in_phase, real};
    use super::*;

    /// A sea of no special form: constituents of two species, or a current alone.
    fn part(period: f64, seed: f64, tide: Tide, channels: usize) -> Arc<dyn SeaField> {
        let axis = |start, count| Axis { start, step: 0.5, count };
        let axes = [axis(-1.0, 7), axis(-1.5, 8), axis(-1.0, 6)];
        let value = |k: usize| (seed * k as f64).sin();
        let values =
            (0..9 * 10 * 8 * channels).map(|k| Complex64::new(value(k), value(k * k % 1009)));
        match GriddedSea::new(period, axes, tide, channels, values.collect()) {
            Ok(sea) => Arc::new(sea),
            Err(error) => unreachable!("{error}"),
        }
    }

    fn constituents() -> Tide {
        let line = |omega, species| Harmonic { omega, species, ..Harmonic::default() };
        Tide::Constituents(vec![line(62.0, 2), line(65.0, 2), line(31.0, 1)])
    }

    /// A tide with a mean beside it, a current with a harmonic, and a mean.
    fn sum() -> Result<(SumOfSeas, Vec<Arc<dyn SeaField>>), DriftError> {
        let parts = vec![
            part(0.1, 0.37, constituents(), 8),
            part(0.1, 0.53, Tide::Harmonics(0), 4),
            part(0.1, 0.71, Tide::Harmonics(0), 2),
        ];
        Ok((SumOfSeas::new(parts.clone())?, parts))
    }

    fn size(v: CVec2) -> f64 {
        v.x.norm().hypot(v.y.norm())
    }

    #[test]
    fn velocity_is_the_sum_of_the_harmonics_and_of_the_parts() -> Result<(), DriftError> {
        let (sea, parts) = sum()?;
        let (mut all, mut first_order) = (Harmonics::default(), Harmonics::default());
        for k in 0..50 {
            let (t, s) = (0.013 * k as f64, 0.7 * k as f64);
            let x = Vec2::new(0.5 + s.cos(), 0.25 + s.sin());
            sea.harmonics(t, x, &mut all)?;
            sea.gradients(t, x, &mut first_order)?;
            assert_eq!((all.tide.len(), all.residual.len()), (3, 2));
            let mut velocity = real(all.residual[0].amplitude);
            for harmonic in all.tide.iter().chain(&all.residual[1..]) {
                velocity += in_phase(harmonic.amplitude, harmonic.phasor(t));
            }
            let direct = sea.velocity(t, x)?;
            assert!((velocity - direct).norm() < 1e-11);
            let mut by_part = Vec2::zeros();
            for part in &parts {
                by_part += part.velocity(t, x)?;
            }
            assert!((by_part - direct).norm() < 1e-14);
            for (a, b) in all.tide.iter().zip(&first_order.tide) {
                assert!(a.amplitude == b.amplitude && a.gradient == b.gradient);
            }
        }
        Ok(())
    }

    #[test]
    fn its_bounds_hold() -> Result<(), DriftError> {
        let (sea, _) = sum()?;
        let (center, radius) = (Vec2::new(0.3, 0.4), 0.6);
        let bounds = sea.bounds(center, radius);
        let mut at = Harmonics::default();
        for k in 0..300 {
            let (t, s) = (0.005 * k as f64, 2.4 * k as f64);
            let r = radius * (k as f64 / 299.0).sqrt();
            sea.harmonics(t, center + Vec2::new(s.cos(), s.sin()) * r, &mut at)?;
            let total = |f: fn(&Harmonic) -> f64| -> f64 { at.tide.iter().map(f).sum() };
            assert!(total(|h| size(h.amplitude)) <= bounds.tide);
            assert!(total(|h| size(h.rate)) <= bounds.rate);
            assert!(total(|h| h.gradient.map(|g| g.norm()).norm()) <= bounds.gradient);
            let residual: f64 = at.residual.iter().map(|h| size(h.amplitude)).sum();
            assert!(residual <= bounds.residual);
        }
        Ok(())
    }

    #[test]
    fn the_first_says_the_period_and_any_may_be_slowest() -> Result<(), DriftError> {
        let (sea, parts) = sum()?;
        assert_eq!((sea.period(), sea.slowest(), sea.is_periodic()), (0.1, 31.0, false));
        let alone = SumOfSeas::new(vec![parts[1].clone()])?;
        assert!(alone.is_periodic() && (alone.slowest() - alone.omega()).abs() < 1e-12);
        assert!(SumOfSeas::new(Vec::new()).is_err());
        Ok(())
    }

    #[test]
    fn outside_of_one_is_outside() -> Result<(), DriftError> {
        let (sea, _) = sum()?;
        assert!(sea.velocity(0.0, Vec2::new(2.1, 0.0)).is_err());
        assert!(sea.harmonics(0.0, Vec2::new(2.1, 0.0), &mut Harmonics::default()).is_err());
        Ok(())
    }
}
