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
