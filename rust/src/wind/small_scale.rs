//! The small-scale wind: an AR(1) process, sampled coarsely and exactly in law first, then filled
//! in by conditional sampling where a model needs its path: docs/equations.md (22)–(24).

use nalgebra::{Matrix2, Vector2};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::error::{DriftError, positive};
use crate::field::Vec2;

/// AR(1) process `w_{k+1} = a w_k + E_k` on a fine grid, independent in the two components,
/// linear between its knots; one coarse step is `substeps` fine ones.
#[derive(Debug, Clone)]
pub struct SmallScale {
    sd: f64,
    /// Lag-one coefficient of a fine step.
    a: f64,
    innovation_sd: f64,
    fine_step: f64,
    substeps: usize,
    /// Mean of (value, integral) after one coarse step, per unit of the value now.
    mean: Vector2<f64>,
    /// Lower Cholesky factor of the covariance of (value, integral).
    factor: Matrix2<f64>,
    /// For each interior fine knot, the gain on the discrepancy of (value, integral).
    gain: Vec<Vector2<f64>>,
}

/// What is worked out beforehand takes a time that grows with the square of them: a second.
const MOST_SUBSTEPS: usize = 4096;

impl SmallScale {
    /// Process of standard deviation `sd` and memory `memory` (the time in which the correlation
    /// falls to 1/e), with `substeps` fine steps in one coarse step of length `step`.
    pub fn new(sd: f64, memory: f64, step: f64, substeps: usize) -> Result<Self, DriftError> {
        if !(sd.is_finite() && sd >= 0.0) {
            return Err(DriftError::invalid("small-scale sd", sd, "it must be finite and ≥ 0"));
        }
        positive("small-scale memory", memory)?;
        positive("synoptic step", step)?;
        if !(1..=MOST_SUBSTEPS).contains(&substeps) {
            let accepted = format!("it must be from 1 to {MOST_SUBSTEPS}");
            return Err(DriftError::invalid("substeps", substeps, accepted));
        }
        let fine_step = step / substeps as f64;
        let a = (-fine_step / memory).exp();
        let innovation_sd = sd * (1.0 - a * a).sqrt();
        let (mean, covariance) = moments(a, innovation_sd, fine_step, substeps);
        let l00 = covariance[(0, 0)].sqrt();
        let l10 = if l00 > 0.0 { covariance[(0, 1)] / l00 } else { 0.0 };
        let l11 = (covariance[(1, 1)] - l10 * l10).max(0.0).sqrt();
        let factor = Matrix2::new(l00, 0.0, l10, l11);
        let gain = gains(a, innovation_sd, fine_step, substeps, covariance);
        Ok(Self { sd, a, innovation_sd, fine_step, substeps, mean, factor, gain })
    }

    /// Number of fine steps in a coarse one.
    pub fn substeps(&self) -> usize {
        self.substeps
    }

    /// A value drawn from the stationary law.
    pub fn start<R: Rng>(&self, rng: &mut R) -> Vec2 {
        normals(rng) * self.sd
    }

    /// (value, integral) after one coarse step from the value `now`.
    pub fn advance<R: Rng>(&self, now: Vec2, rng: &mut R) -> (Vec2, Vec2) {
        let (first, second) = (normals(rng), normals(rng));
        let value = now * self.mean.x + first * self.factor[(0, 0)];
        let integral =
            now * self.mean.y + first * self.factor[(1, 0)] + second * self.factor[(1, 1)];
        (value, integral)
    }

    /// The interior fine knots of a coarse step, given its ends and its integral, appended to
    /// `out`: an unconditional path is drawn, then moved by the gain times what it misses.
    pub fn fill<R: Rng>(
        &self,
        now: Vec2,
        (value, integral): (Vec2, Vec2),
        rng: &mut R,
        out: &mut Vec<Vec2>,
    ) {
        if self.substeps == 1 {
            return;
        }
        let first = out.len();
        let mut w = now;
        let mut sum = now / 2.0;
        for _ in 1..self.substeps {
            w = w * self.a + normals(rng) * self.innovation_sd;
            sum += w;
            out.push(w);
        }
        w = w * self.a + normals(rng) * self.innovation_sd;
        let missed_value = value - w;
        let missed_integral = integral - (sum + w / 2.0) * self.fine_step;
        for (w, gain) in out[first..].iter_mut().zip(&self.gain) {
            *w += missed_value * gain.x + missed_integral * gain.y;
        }
    }
}

pub(super) fn normals<R: Rng>(rng: &mut R) -> Vec2 {
    Vec2::new(StandardNormal.sample(rng), StandardNormal.sample(rng))
}

/// Mean per unit of the value now, and covariance, of (value, integral) after `n` fine steps.
fn moments(a: f64, sigma: f64, step: f64, n: usize) -> (Vector2<f64>, Matrix2<f64>) {
    let n = n as i32;
    let (an, a2n) = (a.powi(n), a.powi(2 * n));
    let mean = Vector2::new(an, step * (0.5 + a * (1.0 - a.powi(n - 1)) / (1.0 - a) + an / 2.0));
    let alpha = 1.0 / (1.0 - a);
    let beta = alpha - 0.5;
    let (p, q) = ((1.0 - an) / (1.0 - a), (1.0 - a2n) / (1.0 - a * a));
    let variance = sigma * sigma;
    let cross = variance * step * (alpha * p - beta * q);
    let integral = variance
        * step
        * step
        * (f64::from(n) * alpha * alpha - 2.0 * alpha * beta * p + beta * beta * q);
    (mean, Matrix2::new(variance * q, cross, cross, integral))
}

/// Regression of each interior fine knot on (value, integral), given the value now.
fn gains(a: f64, sigma: f64, step: f64, n: usize, covariance: Matrix2<f64>) -> Vec<Vector2<f64>> {
    let Some(precision) = covariance.try_inverse() else {
        return vec![Vector2::zeros(); n - 1];
    };
    let variance = |k: usize| sigma * sigma * (1.0 - a.powi(2 * k as i32)) / (1.0 - a * a);
    let covariance_of = |k: usize, m: usize| a.powi(k.abs_diff(m) as i32) * variance(k.min(m));
    (1..n)
        .map(|k| {
            let inside: f64 = (1..n).map(|m| covariance_of(k, m)).sum();
            let with_value = covariance_of(k, n);
            precision * Vector2::new(with_value, step * (inside + with_value / 2.0))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    /// The filled path has the integral and the end value that were drawn coarsely.
    #[test]
    fn fill_meets_its_conditions() -> Result<(), DriftError> {
        let process = SmallScale::new(0.3, 0.24, 0.48, 48)?;
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let now = process.start(&mut rng);
        let (value, integral) = process.advance(now, &mut rng);
        let mut path = vec![now];
        process.fill(now, (value, integral), &mut rng, &mut path);
        path.push(value);
        let trapezoid: Vec2 =
            path.windows(2).map(|pair| (pair[0] + pair[1]) * (0.48 / 48.0 / 2.0)).sum();
        assert!((trapezoid - integral).norm() < 1e-14);
        Ok(())
    }

    /// Variance and lag-one covariance of the filled path are those of the AR(1) process.
    /// 40,000 paths, two components: relative standard error of a variance 0.5 %, threshold 4 sd.
    #[test]
    fn filled_path_has_the_law_of_the_process() -> Result<(), DriftError> {
        let process = SmallScale::new(1.0, 0.3, 1.0, 8)?;
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let (mut square, mut lagged) = ([0.0; 9], [0.0; 8]);
        let paths = 40_000;
        for _ in 0..paths {
            let now = process.start(&mut rng);
            let (value, integral) = process.advance(now, &mut rng);
            let mut path = vec![now];
            process.fill(now, (value, integral), &mut rng, &mut path);
            path.push(value);
            for k in 0..9 {
                square[k] += path[k].norm_squared() / (2.0 * f64::from(paths));
            }
            for k in 0..8 {
                lagged[k] += path[k].dot(&path[k + 1]) / (2.0 * f64::from(paths));
            }
        }
        assert!(square.iter().all(|v| (v - 1.0).abs() < 0.02), "{square:?}");
        assert!(lagged.iter().all(|c| (c - process.a).abs() < 0.02), "{lagged:?}");
        Ok(())
    }
}
