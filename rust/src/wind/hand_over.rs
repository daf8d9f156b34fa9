//! The synoptic wind of the first steps, by a forecast and its errors: docs/equations.md (43)–(44).

use nalgebra::Matrix2;
use rand::Rng;

use super::small_scale::normals;
use crate::error::DriftError;
use crate::field::Vec2;

/// The winds that members begin with, before a bootstrap goes on from their last states.
#[derive(Debug, Clone)]
pub struct HandOver {
    /// Calibrated forecasts, as anomalies [m/s], forecasts × steps.
    forecasts: Vec<Vec2>,
    /// Standard deviation of the errors as a share of the climate's, by step.
    spread: Vec<f64>,
    /// Lag-one matrix `Φ` of the errors before they are scaled.
    memory: Matrix2<f64>,
    /// Root `N` of their innovations' covariance.
    innovation: Matrix2<f64>,
    /// Root `L` of their covariance, the climate's.
    scale: Matrix2<f64>,
}

impl HandOver {
    /// `forecasts` are indexed `[forecast][step]`; the matrices are `[Φ, N, L]`.
    pub fn new(
        forecasts: Vec<Vec2>,
        spread: Vec<f64>,
        [memory, innovation, scale]: [Matrix2<f64>; 3],
    ) -> Result<Self, DriftError> {
        if forecasts.is_empty() || !forecasts.len().is_multiple_of(spread.len().max(1)) {
            return Err(DriftError::invalid(
                "forecasts",
                format!("{} values", forecasts.len()),
                format!("{} for each forecast", spread.len()),
            ));
        }
        let numbers = (forecasts.iter().flat_map(|w| [w.x, w.y])).chain(spread.iter().copied());
        let mut numbers = numbers.chain([memory, innovation, scale].into_iter().flat_map(matrix));
        if let Some(bad) = numbers.find(|value| !value.is_finite()) {
            return Err(DriftError::invalid("forecasts", bad, "every value must be finite"));
        }
        Ok(Self { forecasts, spread, memory, innovation, scale })
    }

    /// Number of steps that are handed over.
    pub fn steps(&self) -> usize {
        self.spread.len()
    }

    /// An error drawn from the climate's law, before it is scaled.
    pub(super) fn start<R: Rng>(&self, rng: &mut R) -> Vec2 {
        self.scale * normals(rng)
    }

    /// The error one step after `error`.
    pub(super) fn advance<R: Rng>(&self, error: Vec2, rng: &mut R) -> Vec2 {
        self.memory * error + self.innovation * normals(rng)
    }

    /// Anomaly of a member at a step; the forecasts are dealt in turn.
    pub(super) fn anomaly(&self, member: u64, step: usize, error: Vec2) -> Vec2 {
        let count = (self.forecasts.len() / self.steps()) as u64;
        let place = (member % count) as usize * self.steps() + step;
        self.forecasts[place] + error * self.spread[step]
    }
}

fn matrix(values: Matrix2<f64>) -> [f64; 4] {
    [values.m11, values.m12, values.m21, values.m22]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(forecasts: usize, spread: Vec<f64>, memory: f64) -> String {
        let matrices = [Matrix2::new(memory, 0.0, 0.0, 1.0), Matrix2::zeros(), Matrix2::zeros()];
        let made = HandOver::new(vec![Vec2::new(1.0, 2.0); forecasts], spread, matrices);
        made.err().map_or_else(String::new, |error| error.to_string())
    }

    #[test]
    fn what_makes_no_forecast_is_refused() {
        assert_eq!(told(6, vec![0.1, 0.2, 0.3], 0.5), "");
        let each = "forecasts: 5 values is not accepted; 3 for each forecast";
        assert_eq!(told(5, vec![0.1, 0.2, 0.3], 0.5), each);
        assert!(told(0, vec![0.1], 0.5).contains("0 values is not accepted"));
        for (spread, memory) in [(f64::NAN, 0.5), (0.1, f64::INFINITY)] {
            assert!(told(2, vec![0.1, spread], memory).ends_with("every value must be finite"));
        }
    }

    #[test]
    fn forecasts_are_dealt_in_turn() -> Result<(), DriftError> {
        let forecasts = (0..6).map(|k| Vec2::new(f64::from(k), 0.0)).collect();
        let one = Matrix2::identity();
        let hand_over = HandOver::new(forecasts, vec![0.0, 1.0, 2.0], [one; 3])?;
        assert_eq!(hand_over.steps(), 3);
        let error = Vec2::new(0.0, 10.0);
        for (member, step, expected) in
            [(0, 0, [0.0, 0.0]), (1, 2, [5.0, 20.0]), (4, 1, [1.0, 10.0])]
        {
            assert_eq!(hand_over.anomaly(member, step, error), Vec2::from(expected));
        }
        Ok(())
    }
}
