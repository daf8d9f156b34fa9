//! A wind uniform in space, known at knots, with its exact integrals in time.

use std::sync::LazyLock;

use crate::error::{DriftError, positive};
use crate::field::Vec2;

/// Wind path: linear between knots, or (for coarse sampling of a finer wind) the parabola that
/// has the given integral over each interval.
///
/// With `u = (t − t_i)/h`, `D = W_{i+1} − W_i` and the excess `e` of the mean over that of
/// the chord, `W = W_i + Du + 6e u(1 − u)`; the integrals below follow, equations.md (21).
#[derive(Debug, Clone)]
pub struct WindPath {
    times: Vec<f64>,
    velocity: Vec<Vec2>,
    /// Excess of each interval's mean over the chord's; empty where the path is linear.
    excess: Vec<Vec2>,
    /// ∫W and ∬W from the first knot to each knot.
    integrals: Vec<[Vec2; 2]>,
    /// ∭W likewise; none of a stretch.
    triple_integrals: Vec<Vec2>,
    /// Spacing, where the knots are regular.
    spacing: Option<f64>,
}

impl WindPath {
    /// Piecewise linear path through `velocity` [length/time] at strictly increasing `times`.
    pub fn new(times: Vec<f64>, velocity: Vec<Vec2>) -> Result<Self, DriftError> {
        if times.len() != velocity.len() || times.len() < 2 {
            return Err(DriftError::invalid(
                "wind path",
                format!("{} times and {} velocities", times.len(), velocity.len()),
                "it needs as many velocities as times, at least 2",
            ));
        }
        if let Some(bad) = times.iter().find(|t| !t.is_finite()) {
            return Err(DriftError::invalid("wind path times", bad, "they must be finite"));
        }
        if let Some(pair) = times.windows(2).find(|pair| pair[1] <= pair[0]) {
            return Err(DriftError::invalid(
                "wind path times",
                format!("{} followed by {}", pair[0], pair[1]),
                "they must increase strictly",
            ));
        }
        if let Some(k) = velocity.iter().position(|w| !(w.x.is_finite() && w.y.is_finite())) {
            return Err(DriftError::invalid(
                "wind path velocity",
                format!("{:?} at knot {k}", velocity[k].as_slice()),
                "it must be finite",
            ));
        }
        let step = (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64;
        let regular = (times.iter().enumerate())
            .all(|(k, t)| (t - times[0] - k as f64 * step).abs() <= 1e-9 * step);
        let spacing = regular.then_some(step);
        Ok(Self::whole(times, velocity, Vec::new(), spacing))
    }

    /// Path through `velocity` at `start + k·step`, whose integral over interval `k` is
    /// `integrals[k]`: the coarse view of a finer wind.
    pub fn from_coarse(
        start: f64,
        step: f64,
        velocity: Vec<Vec2>,
        integrals: &[Vec2],
    ) -> Result<Self, DriftError> {
        positive("step", step)?;
        let excess = (velocity.windows(2).zip(integrals))
            .map(|(pair, integral)| integral / step - (pair[0] + pair[1]) / 2.0)
            .collect();
        let times = (0..velocity.len()).map(|k| start + k as f64 * step).collect();
        Ok(Self::whole(times, velocity, excess, Some(step)))
    }

    /// No wind at any time.
    pub fn calm() -> &'static Self {
        static CALM: LazyLock<WindPath> = LazyLock::new(|| {
            WindPath::stretch(0.0, 1.0, vec![Vec2::zeros(); 2], Vec::new(), [Vec2::zeros(); 2])
        });
        &CALM
    }

    /// A stretch of a path at `start + k·step`, with the excess of each interval's mean over its
    /// chord's (none where it is linear), that had the integrals `before` at its first knot.
    pub(crate) fn stretch(
        start: f64,
        step: f64,
        velocity: Vec<Vec2>,
        excess: Vec<Vec2>,
        before: [Vec2; 2],
    ) -> Self {
        let times = (0..velocity.len()).map(|k| start + k as f64 * step).collect();
        Self::with_integrals(times, velocity, excess, Some(step), before)
    }

    /// A path whose integrals are all counted from its first knot.
    fn whole(
        times: Vec<f64>,
        velocity: Vec<Vec2>,
        excess: Vec<Vec2>,
        spacing: Option<f64>,
    ) -> Self {
        let before = [Vec2::zeros(); 2];
        let mut path = Self::with_integrals(times, velocity, excess, spacing, before);
        path.triple_integrals.reserve(path.times.len());
        path.triple_integrals.push(Vec2::zeros());
        for i in 0..path.times.len() - 1 {
            path.triple_integrals.push(path.triple(i, 1.0));
        }
        path
    }

    fn with_integrals(
        times: Vec<f64>,
        velocity: Vec<Vec2>,
        excess: Vec<Vec2>,
        spacing: Option<f64>,
        before: [Vec2; 2],
    ) -> Self {
        let (integrals, triple_integrals) = (Vec::new(), Vec::new());
        let mut path = Self { times, velocity, excess, integrals, triple_integrals, spacing };
        path.integrals.reserve(path.times.len());
        path.integrals.push(before);
        for i in 0..path.times.len() - 1 {
            path.integrals.push([path.single(i, 1.0), path.double(i, 1.0)]);
        }
        path
    }

    /// Times of the knots.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// Wind at the knots.
    pub fn knots(&self) -> &[Vec2] {
        &self.velocity
    }

    /// First knot.
    pub fn start(&self) -> f64 {
        self.times[0]
    }

    /// Last knot.
    pub fn end(&self) -> f64 {
        self.times[self.times.len() - 1]
    }

    /// Fails unless the path covers `[start, end]`, up to rounding.
    pub fn require(&self, start: f64, end: f64) -> Result<(), DriftError> {
        require_cover((self.start(), self.end()), (start, end))
    }

    /// Interval of `t` and the place in it, from 0 to 1; the end intervals are continued.
    fn locate(&self, t: f64) -> (usize, f64) {
        let last = self.times.len() - 2;
        if let Some(step) = self.spacing {
            let place = (t - self.times[0]) / step;
            let i = (place.max(0.0) as usize).min(last);
            return (i, place - i as f64);
        }
        let i = self.times.partition_point(|knot| *knot <= t).clamp(1, last + 1) - 1;
        (i, (t - self.times[i]) / self.length(i))
    }

    fn length(&self, i: usize) -> f64 {
        self.times[i + 1] - self.times[i]
    }

    /// Wind at the first knot of an interval, what it changes by, and the excess.
    fn interval(&self, i: usize) -> (Vec2, Vec2, Vec2) {
        let first = self.velocity[i];
        let excess = self.excess.get(i).copied().unwrap_or_default();
        (first, self.velocity[i + 1] - first, excess)
    }

    fn single(&self, i: usize, u: f64) -> Vec2 {
        let (w, d, e) = self.interval(i);
        let inner = w * u + d * (u * u / 2.0) + e * (u * u * (3.0 - 2.0 * u));
        self.integrals[i][0] + inner * self.length(i)
    }

    fn double(&self, i: usize, u: f64) -> Vec2 {
        let (w, d, e) = self.interval(i);
        let [first, second] = self.integrals[i];
        let s = u * self.length(i);
        let inner = w / 2.0 + d * (u / 6.0) + e * (u * (1.0 - u / 2.0));
        second + first * s + inner * (s * s)
    }

    fn triple(&self, i: usize, u: f64) -> Vec2 {
        let (w, d, e) = self.interval(i);
        let [first, second] = self.integrals[i];
        let third = self.triple_integrals.get(i).copied().unwrap_or_default();
        let s = u * self.length(i);
        let inner = w / 6.0 + d * (u / 24.0) + e * (u * (0.25 - u / 10.0));
        third + second * s + first * (s * s / 2.0) + inner * (s * s * s)
    }

    /// Wind `W(t)` [length/time].
    pub fn velocity(&self, t: f64) -> Vec2 {
        let (i, u) = self.locate(t);
        let (w, d, e) = self.interval(i);
        w + d * u + e * (6.0 * u * (1.0 - u))
    }

    /// `∫W` from the first knot to `t` [length].
    pub fn integral(&self, t: f64) -> Vec2 {
        let (i, u) = self.locate(t);
        self.single(i, u)
    }

    /// `∬W` from the first knot to `t` [length·time].
    pub fn double_integral(&self, t: f64) -> Vec2 {
        let (i, u) = self.locate(t);
        self.double(i, u)
    }

    /// `∭W` from the first knot to `t` [length·time²].
    pub fn triple_integral(&self, t: f64) -> Vec2 {
        let (i, u) = self.locate(t);
        self.triple(i, u)
    }

    /// `(∫W, ∬W)` from the first knot to `t`, at the price of one look-up.
    pub fn integrals(&self, t: f64) -> (Vec2, Vec2) {
        let (i, u) = self.locate(t);
        (self.single(i, u), self.double(i, u))
    }

    /// Mean over the window of length `window` centred at `t`: the paper's `⟨W⟩_p`.
    pub fn mean(&self, t: f64, window: f64) -> Vec2 {
        (self.integral(t + window / 2.0) - self.integral(t - window / 2.0)) / window
    }

    /// Upper bound of the wind's speed.
    pub fn max_speed(&self) -> f64 {
        let knots = self.velocity.iter().map(|w| w.norm()).fold(0.0, f64::max);
        knots + 1.5 * self.excess.iter().map(|e| e.norm()).fold(0.0, f64::max)
    }
}

/// Fails unless a wind known on `[start, end]` covers the times needed, up to rounding.
pub(super) fn require_cover(
    (start, end): (f64, f64),
    (need_start, need_end): (f64, f64),
) -> Result<(), DriftError> {
    let slack = 1e-9 * (need_end - need_start);
    if start <= need_start + slack && end >= need_end - slack {
        return Ok(());
    }
    Err(DriftError::WindTooShort { start, end, need_start, need_end })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn irregular() -> Result<WindPath, DriftError> {
        let times = vec![-0.3, 0.0, 0.1, 0.45, 0.5, 1.2];
        let velocity = (0..6).map(|k| Vec2::new((k as f64).sin(), (2.0 * k as f64).cos()));
        WindPath::new(times, velocity.collect())
    }

    /// Each integral is the derivative of the next, and all vanish at the first knot.
    #[test]
    fn integrals_chain() -> Result<(), DriftError> {
        let coarse = WindPath::from_coarse(
            -0.3,
            0.5,
            vec![Vec2::new(1.0, 0.0), Vec2::new(-1.0, 2.0), Vec2::new(0.5, 0.5), Vec2::zeros()],
            &[Vec2::new(0.2, 0.1), Vec2::new(-0.4, 0.9), Vec2::new(0.0, 0.3)],
        )?;
        for path in [irregular()?, coarse] {
            let d = 1e-5;
            for k in 0..140 {
                let t = -0.29 + 0.01 * k as f64 + 0.0012;
                let slope = |f: &dyn Fn(f64) -> Vec2| (f(t + d) - f(t - d)) / (2.0 * d);
                assert!((slope(&|t| path.integral(t)) - path.velocity(t)).norm() < 1e-8);
                assert!((slope(&|t| path.double_integral(t)) - path.integral(t)).norm() < 1e-8);
                assert!(
                    (slope(&|t| path.triple_integral(t)) - path.double_integral(t)).norm() < 1e-8
                );
                assert!(path.velocity(t).norm() <= path.max_speed());
            }
            assert_eq!(path.integral(path.start()), Vec2::zeros());
        }
        Ok(())
    }

    #[test]
    fn coarse_path_keeps_the_integrals() -> Result<(), DriftError> {
        let integrals = [Vec2::new(0.2, 0.1), Vec2::new(-0.4, 0.9)];
        let knots = vec![Vec2::new(1.0, 0.0), Vec2::new(-1.0, 2.0), Vec2::new(0.5, 0.5)];
        let path = WindPath::from_coarse(0.0, 0.5, knots, &integrals)?;
        assert!((path.integral(0.5) - integrals[0]).norm() < 1e-15);
        assert!((path.integral(1.0) - integrals[0] - integrals[1]).norm() < 1e-15);
        Ok(())
    }

    #[test]
    fn refuses_bad_knots() {
        let w = |n| vec![Vec2::zeros(); n];
        assert!(WindPath::new(vec![0.0], w(1)).is_err());
        assert!(WindPath::new(vec![0.0, 1.0], w(3)).is_err());
        assert!(WindPath::new(vec![0.0, 1.0, 1.0], w(3)).is_err());
        assert!(WindPath::new(vec![0.0, f64::NAN], w(2)).is_err());
        assert!(
            WindPath::new(vec![0.0, 1.0], vec![Vec2::zeros(), Vec2::new(f64::INFINITY, 0.0)])
                .is_err()
        );
        assert!(irregular().is_ok_and(|path| path.require(0.0, 1.3).is_err()));
    }
}
