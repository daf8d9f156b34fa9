//! Winds that vary in space: patterns on a grid, added up in proportions that change with time.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::Matrix2;
use rand_chacha::ChaCha8Rng;

use super::path::{WindPath, require_cover};
use super::{Sampling, SmallScale, Stream, Wind, stream};
use crate::error::{DriftError, finite, positive, product};
use crate::field::Vec2;
use crate::field::gridded::{Axis, Stencil};

/// Wind patterns on a regular grid, interpolated by cubic B-splines.
#[derive(Debug, Clone)]
pub struct WindPatterns {
    x: Axis,
    y: Axis,
    count: usize,
    /// Spline coefficients, indexed `[y][x][pattern]`.
    coefficients: Vec<Vec2>,
}

impl WindPatterns {
    /// Takes spline coefficients indexed `[y][x][pattern]`; an axis of `n > 1` grid points has
    /// `n + 2` coefficients.
    pub fn new(
        [x, y]: [Axis; 2],
        count: usize,
        coefficients: Vec<Vec2>,
    ) -> Result<Self, DriftError> {
        let (x, y) = (x.validated("x axis")?, y.validated("y axis")?);
        let expected = product("wind patterns", &[x.coefficients(), y.coefficients(), count])?;
        if count == 0 || coefficients.len() != expected {
            return Err(DriftError::invalid(
                "wind patterns",
                format!("{} values", coefficients.len()),
                format!("the axes and {count} patterns need {expected}, at least 1"),
            ));
        }
        if let Some(bad) = coefficients.iter().find(|c| !(c.x.is_finite() && c.y.is_finite())) {
            return Err(DriftError::invalid("wind patterns", bad, "they must be finite"));
        }
        Ok(Self { x, y, count, coefficients })
    }

    /// Sum of the patterns at `x`, each by its amplitude and the nodes by `weight` of the stencils
    /// of x and y and the places in them.
    fn sum(
        &self,
        x: Vec2,
        amplitude: impl Fn(usize) -> f64,
        mut add: impl FnMut(Vec2, [&Stencil; 2], [usize; 2]),
    ) -> Result<(), DriftError> {
        if !self.x.contains(x.x) || !self.y.contains(x.y) {
            return Err(DriftError::OutsideDomain { x: x.x, y: x.y });
        }
        let (sx, sy) = (self.x.stencil(x.x), self.y.stencil(x.y));
        let (wx, wy) = (self.x.coefficients().min(4), self.y.coefficients().min(4));
        for pattern in 0..self.count {
            let amplitude = amplitude(pattern);
            // Of the hours of the mean day only two count at a time.
            if amplitude == 0.0 {
                continue;
            }
            for j in 0..wy {
                let row = (sy.first + j) * self.x.coefficients() + sx.first;
                for i in 0..wx {
                    let node = self.coefficients[(row + i) * self.count + pattern];
                    add(node * amplitude, [&sx, &sy], [i, j]);
                }
            }
        }
        Ok(())
    }
}

/// Winds of some members: amplitudes of the patterns at regular times, linear between.
#[derive(Debug, Clone)]
pub struct FieldWinds {
    patterns: Arc<WindPatterns>,
    start: f64,
    step: f64,
    steps: usize,
    /// The member that the first amplitudes belong to.
    first: u64,
    /// Indexed `[member][step][pattern]`; one member's serve all.
    amplitudes: Vec<f64>,
    /// The small scale, uniform in space, and the seed that names it.
    small_scale: Option<(SmallScale, u64)>,
}

impl FieldWinds {
    /// `amplitudes` are indexed `[member][step][pattern]`, from the member `first` on, at
    /// `start + step·k`; those of one member are every member's.
    pub fn new(
        patterns: Arc<WindPatterns>,
        (start, step, steps): (f64, f64, usize),
        first: u64,
        amplitudes: Vec<f64>,
        small_scale: Option<(SmallScale, u64)>,
    ) -> Result<Self, DriftError> {
        positive("wind step", step)?;
        finite("wind start", &[start, start + step * steps as f64])?;
        let each = product("wind amplitudes", &[steps, patterns.count])?;
        if steps < 2 || amplitudes.is_empty() || !amplitudes.len().is_multiple_of(each) {
            return Err(DriftError::invalid(
                "wind amplitudes",
                format!("{} values, {steps} steps", amplitudes.len()),
                format!("at least 2 steps, {each} values for each member"),
            ));
        }
        if let Some(bad) = amplitudes.iter().find(|a| !a.is_finite()) {
            return Err(DriftError::invalid("wind amplitudes", bad, "they must be finite"));
        }
        Ok(Self { patterns, start, step, steps, first, amplitudes, small_scale })
    }

    /// The members that have a wind.
    pub fn members(&self) -> Range<u64> {
        match self.amplitudes.len() / (self.steps * self.patterns.count) {
            1 => 0..u64::MAX,
            count => self.first..self.first.saturating_add(count as u64),
        }
    }

    /// The wind of one member.
    pub fn member(&self, index: u64, sampling: Sampling) -> Result<FieldPath<'_>, DriftError> {
        if !self.members().contains(&index) {
            return Err(DriftError::invalid("member", index, "it has no wind"));
        }
        let each = self.steps * self.patterns.count;
        let place = if each == self.amplitudes.len() { 0 } else { index - self.first } as usize;
        let amplitudes = &self.amplitudes[place * each..(place + 1) * each];
        let small_scale = (self.small_scale.as_ref())
            .map(|(small, seed)| self.small_scale_path(small, *seed, index, sampling))
            .transpose()?;
        let knots = match &small_scale {
            Some(path) => path.times().to_vec(),
            None => (0..self.steps).map(|k| self.start + k as f64 * self.step).collect(),
        };
        Ok(FieldPath { winds: self, amplitudes, small_scale, knots })
    }

    fn small_scale_path(
        &self,
        small: &SmallScale,
        seed: u64,
        member: u64,
        sampling: Sampling,
    ) -> Result<WindPath, DriftError> {
        let mut coarse = stream(seed, member, Stream::SmallScale);
        let mut fine: ChaCha8Rng = stream(seed, member, Stream::FinePath);
        let mut now = small.start(&mut coarse);
        let (mut velocity, mut integrals) = (Vec::new(), Vec::new());
        for _ in 1..self.steps {
            let (next, integral) = small.advance(now, &mut coarse);
            velocity.push(now);
            match sampling {
                Sampling::Coarse => integrals.push(integral),
                Sampling::Fine => small.fill(now, (next, integral), &mut fine, &mut velocity),
            }
            now = next;
        }
        velocity.push(now);
        if sampling == Sampling::Coarse {
            return WindPath::from_coarse(self.start, self.step, velocity, &integrals);
        }
        let spacing = self.step / small.substeps() as f64;
        let times = (0..velocity.len()).map(|k| self.start + k as f64 * spacing).collect();
        WindPath::new(times, velocity)
    }
}

/// The wind of one member, everywhere on the grid.
pub struct FieldPath<'a> {
    winds: &'a FieldWinds,
    amplitudes: &'a [f64],
    small_scale: Option<WindPath>,
    knots: Vec<f64>,
}

impl FieldPath<'_> {
    /// Amplitude of each pattern at time `t`.
    fn amplitudes_at(&self, t: f64) -> impl Fn(usize) -> f64 {
        let FieldWinds { patterns, start, step, steps, .. } = self.winds;
        let place = ((t - start) / step).max(0.0);
        let before = (place as usize).min(steps - 2);
        let share = place - before as f64;
        let count = patterns.count;
        let (now, next) = self.amplitudes[before * count..(before + 2) * count].split_at(count);
        move |k| now[k] + (next[k] - now[k]) * share
    }
}

impl Wind for FieldPath<'_> {
    fn at(&self, t: f64, x: Vec2) -> Result<Vec2, DriftError> {
        let mut wind = self.small_scale.as_ref().map_or(Vec2::zeros(), |path| path.velocity(t));
        self.winds.patterns.sum(x, self.amplitudes_at(t), |node, [sx, sy], [i, j]| {
            wind += node * (sx.value[i] * sy.value[j]);
        })?;
        Ok(wind)
    }

    fn derivatives(
        &self,
        t: f64,
        x: Vec2,
    ) -> Result<(Matrix2<f64>, [Matrix2<f64>; 2]), DriftError> {
        let mut gradient = Matrix2::zeros();
        let mut hessian = [Matrix2::zeros(); 2];
        self.winds.patterns.sum(x, self.amplitudes_at(t), |node, [sx, sy], [i, j]| {
            let slope = Vec2::new(sx.slope[i] * sy.value[j], sx.value[i] * sy.slope[j]);
            gradient += node * slope.transpose();
            let cross = sx.slope[i] * sy.slope[j];
            let curvature = Matrix2::new(
                sx.curvature[i] * sy.value[j],
                cross,
                cross,
                sx.value[i] * sy.curvature[j],
            );
            for (hessian, node) in hessian.iter_mut().zip(&node) {
                *hessian += curvature * *node;
            }
        })?;
        Ok((gradient, hessian))
    }

    fn knots(&self) -> &[f64] {
        &self.knots
    }

    fn require(&self, start: f64, end: f64) -> Result<(), DriftError> {
        let FieldWinds { start: first, step, steps, .. } = self.winds;
        require_cover((*first, first + step * (steps - 1) as f64), (start, end))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `(1, x)` and `(y, 0)` on four by four points, exact for splines.
    fn patterns() -> Result<Arc<WindPatterns>, DriftError> {
        let axis = Axis { start: 0.0, step: 1.0, count: 4 };
        let nodes = (0..36).flat_map(|k| {
            // The coefficients of a linear function are its values, from one step before on.
            let (x, y) = (f64::from(k % 6) - 1.0, f64::from(k / 6) - 1.0);
            [Vec2::new(1.0, x), Vec2::new(y, 0.0)]
        });
        Ok(Arc::new(WindPatterns::new([axis, axis], 2, nodes.collect())?))
    }

    fn told<T>(made: Result<T, DriftError>) -> String {
        made.err().map_or_else(String::new, |error| error.to_string())
    }

    #[test]
    fn patterns_and_amplitudes_that_do_not_fit_are_refused() -> Result<(), DriftError> {
        let axis = Axis { start: 0.0, step: 1.0, count: 4 };
        let made = |count, nodes| WindPatterns::new([axis, axis], count, nodes);
        let short = "71 values is not accepted; the axes and 2 patterns need 72, at least 1";
        assert!(told(made(2, vec![Vec2::zeros(); 71])).contains(short));
        assert!(told(made(0, vec![])).contains("0 patterns need 0, at least 1"));
        for bad in [Vec2::new(f64::NAN, 0.0), Vec2::new(0.0, f64::INFINITY)] {
            assert!(told(made(1, vec![bad; 36])).ends_with("they must be finite"));
        }
        let winds = |grid, amplitudes| FieldWinds::new(patterns()?, grid, 0, amplitudes, None);
        assert!(winds((0.0, 2.0, 3), vec![0.0; 12]).is_ok());
        let few = "wind amplitudes: 7 values, 3 steps is not accepted; at least 2 steps, 6 values";
        assert!(told(winds((0.0, 2.0, 3), vec![0.0; 7])).starts_with(few));
        assert!(told(winds((0.0, 2.0, 1), vec![0.0; 2])).contains("2 values, 1 steps"));
        assert!(told(winds((0.0, 2.0, 3), vec![])).contains("0 values, 3 steps"));
        assert!(told(winds((0.0, 2.0, 3), vec![f64::NAN; 6])).ends_with("they must be finite"));
        assert!(told(winds((0.0, 0.0, 3), vec![0.0; 6])).starts_with("wind step: 0"));
        Ok(())
    }

    #[test]
    fn patterns_are_added_linearly_in_time() -> Result<(), DriftError> {
        let amplitudes = vec![1.0, 0.0, 3.0, 2.0, 5.0, 0.0];
        let winds = FieldWinds::new(patterns()?, (0.0, 2.0, 3), 0, amplitudes, None)?;
        let path = winds.member(7, Sampling::Coarse)?;
        let x = Vec2::new(1.5, 0.5);
        for (t, a, b) in [(0.0, 1.0, 0.0), (1.0, 2.0, 1.0), (3.5, 4.5, 0.5), (4.0, 5.0, 0.0)] {
            let expected = Vec2::new(a + b * x.y, a * x.x);
            assert!((path.at(t, x)? - expected).norm() < 1e-13);
        }
        assert!(path.at(0.0, Vec2::new(3.1, 0.0)).is_err());
        assert!(path.require(0.0, 4.1).is_err());
        Ok(())
    }

    #[test]
    fn both_samplings_are_one_small_scale() -> Result<(), DriftError> {
        let small = SmallScale::new(0.7, 3.0, 2.0, 8)?;
        let winds = FieldWinds::new(patterns()?, (0.0, 2.0, 4), 0, vec![0.0; 8], Some((small, 5)))?;
        let (coarse, fine) = (winds.member(3, Sampling::Coarse)?, winds.member(3, Sampling::Fine)?);
        assert_eq!((coarse.knots.len(), fine.knots.len()), (4, 25));
        for k in 0..4 {
            let t = 2.0 * f64::from(k);
            assert!((coarse.at(t, Vec2::zeros())? - fine.at(t, Vec2::zeros())?).norm() < 1e-13);
        }
        let integral = |path: &FieldPath| path.small_scale.as_ref().map(|s| s.integral(6.0));
        let (a, b) = (integral(&coarse).unwrap_or_default(), integral(&fine).unwrap_or_default());
        assert!(a.norm() > 0.0 && (a - b).norm() < 1e-12);
        Ok(())
    }
}
