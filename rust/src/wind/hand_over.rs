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
