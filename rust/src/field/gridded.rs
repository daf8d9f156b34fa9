//! Harmonics on a regular grid, interpolated by cubic B-splines.
//!
//! The splines are twice continuously differentiable, so gradients and second derivatives of the
//! coefficients are continuous where order 2 needs them; and a spline lies within the convex hull
//! of its coefficients, which gives the bounds of [`SeaField::bounds`] without sampling.

use num_complex::Complex64;

use smallvec::{SmallVec, smallvec};

use super::{
    CMat2, FieldBounds, Harmonic, Harmonics, SeaField, Vec2, in_phase, phasors, slow_enough,
};
use crate::error::{DriftError, finite, positive, product};

/// Regular axis of `count` grid points; an axis of one point is constant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// First grid point.
    pub start: f64,
    /// Spacing, above 0.
    pub step: f64,
    /// Number of grid points: 1, or at least 4.
    pub count: usize,
}

/// Weights of the spline coefficients around one point of an axis: value, first, second derivative.
pub(crate) struct Stencil {
    pub(crate) first: usize,
    pub(crate) value: [f64; 4],
    pub(crate) slope: [f64; 4],
    pub(crate) curvature: [f64; 4],
}

impl Axis {
    pub(crate) fn validated(self, name: &'static str) -> Result<Self, DriftError> {
        positive(name, self.step)?;
        finite(name, &[self.start])?;
        if self.count != 1 && self.count < 4 {
            return Err(DriftError::invalid(
                name,
                format!("{} grid points", self.count),
                "cubic splines need 1 (constant) or at least 4",
            ));
        }
        Ok(self)
    }

    /// Number of spline coefficients.
    pub(crate) fn coefficients(&self) -> usize {
        if self.count == 1 { 1 } else { self.count.saturating_add(2) }
    }

    fn end(&self) -> f64 {
        self.start + (self.count - 1) as f64 * self.step
    }

    pub(crate) fn contains(&self, at: f64) -> bool {
        self.count == 1
            || (0.0..=(self.count - 1) as f64).contains(&((at - self.start) / self.step))
    }

    /// Cell of `at` and the place inside it, 0…1; beyond the axis the end cells are continued.
    fn cell(&self, at: f64) -> (usize, f64) {
        let place = (at - self.start) / self.step;
        let cell = place.floor().clamp(0.0, (self.count - 2) as f64);
        (cell as usize, place - cell)
    }

    pub(crate) fn stencil(&self, at: f64) -> Stencil {
        if self.count == 1 {
            let constant = [1.0, 0.0, 0.0, 0.0];
            return Stencil { first: 0, value: constant, slope: [0.0; 4], curvature: [0.0; 4] };
        }
        let (first, u) = self.cell(at);
        let v = 1.0 - u;
        let (h, hh) = (1.0 / self.step, 1.0 / (self.step * self.step));
        Stencil {
            first,
            value: [
                v * v * v / 6.0,
                (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0,
                (3.0 * v * v * v - 6.0 * v * v + 4.0) / 6.0,
                u * u * u / 6.0,
            ],
            slope: [
                -h * v * v / 2.0,
                h * (3.0 * u * u - 4.0 * u) / 2.0,
                -h * (3.0 * v * v - 4.0 * v) / 2.0,
                h * u * u / 2.0,
            ],
            curvature: [hh * v, hh * (3.0 * u - 2.0), hh * (3.0 * v - 2.0), hh * u],
        }
    }

    /// Coefficients that can matter within `radius` of `at`, as a half-open range.
    fn reach(&self, at: f64, radius: f64) -> std::ops::Range<usize> {
        if self.count == 1 {
            return 0..1;
        }
        self.cell(at - radius).0..self.cell(at + radius).0 + 4
    }
}

/// How the harmonics of a tide on a grid oscillate.
#[derive(Debug, Clone)]
pub enum Tide {
    /// So many multiples of its frequency.
    Harmonics(usize),
    /// Constituents of frequencies and species of their own; amplitudes are not read.
    Constituents(Vec<Harmonic>),
}

/// A sea given by its harmonics on a regular grid in x, y and (slow) time.
#[derive(Debug, Clone)]
pub struct GriddedSea {
    period: f64,
    x: Axis,
    y: Axis,
    time: Axis,
    /// Frequency and species of each harmonic: the tide's, then the residual's from its mean on.
    lines: Vec<Harmonic>,
    tide_harmonics: usize,
    periodic: bool,
    /// Complex channels per grid point: two components for each tide, then residual, harmonic.
    channels: usize,
    /// Spline coefficients, indexed `[time][y][x][channel]`.
    coefficients: Vec<Complex64>,
    /// For each spatial coefficient, the largest sums over the harmonics and all times.
    node_bounds: Vec<FieldBounds>,
}

impl GriddedSea {
    /// Takes spline coefficients indexed `[time][y][x][channel]`, where each axis of `n > 1` grid
    /// points has `n + 2` coefficients; channels are (u, v) of each tide harmonic, then (u, v) of
    /// the residual's mean and of its harmonics. The tide's harmonics are multiples of its
    /// frequency, or `constituents` with frequencies and species of their own.
    pub fn new(
        period: f64,
        [x, y, time]: [Axis; 3],
        tide: Tide,
        channels: usize,
        coefficients: Vec<Complex64>,
    ) -> Result<Self, DriftError> {
        positive("period", period)?;
        let (x, y) = (x.validated("x axis")?, y.validated("y axis")?);
        let time = time.validated("time axis")?;
        let (tide_harmonics, periodic) = match &tide {
            Tide::Harmonics(count) => (*count, true),
            Tide::Constituents(constituents) => (constituents.len(), false),
        };
        let counts = [x.coefficients(), y.coefficients(), time.coefficients(), channels];
        let expected = product("coefficients", &counts)?;
        if !channels.is_multiple_of(2) || channels / 2 < tide_harmonics {
            return Err(DriftError::invalid(
                "channels",
                channels,
                "it must be even and hold two components for each tide harmonic",
            ));
        }
        if coefficients.len() != expected {
            return Err(DriftError::invalid(
                "coefficients",
                format!("{} values", coefficients.len()),
                format!("the axes and channels need {expected}"),
            ));
        }
        if let Some(bad) = coefficients.iter().find(|c| !c.is_finite()) {
            return Err(DriftError::invalid("coefficients", bad, "they must be finite"));
        }
        let omega = positive("period", std::f64::consts::TAU / period)?;
        let mut lines = match tide {
            Tide::Harmonics(count) => (1..=count).map(|j| Harmonic::multiple(j, omega)).collect(),
            Tide::Constituents(constituents) => constituents,
        };
        if let Some(bad) = lines.iter().find(|line| !(line.omega.is_finite() && line.omega > 0.0)) {
            return Err(DriftError::invalid(
                "constituent",
                bad.omega,
                "it needs a frequency above 0",
            ));
        }
        for line in &lines {
            slow_enough("constituent", line.omega, line.omega / omega)?;
        }
        let residuals = channels / 2 - tide_harmonics;
        lines.extend((0..residuals).map(|j| Harmonic::multiple(j, omega)));
        let mut sea = Self {
            period,
            x,
            y,
            time,
            lines,
            tide_harmonics,
            periodic,
            channels,
            coefficients,
            node_bounds: Vec::new(),
        };
        sea.node_bounds = sea.bounds_at_nodes();
        Ok(sea)
    }

    fn node(&self, time: usize, y: usize, x: usize) -> &[Complex64] {
        let row = (time * self.y.coefficients() + y) * self.x.coefficients() + x;
        &self.coefficients[row * self.channels..(row + 1) * self.channels]
    }

    fn bounds_at_nodes(&self) -> Vec<FieldBounds> {
        let (nt, ny, nx) = (self.time.coefficients(), self.y.coefficients(), self.x.coefficients());
        let tide = ..2 * self.tide_harmonics;
        let size = |channels: &[Complex64]| -> f64 {
            channels.chunks_exact(2).map(|c| (c[0].norm_sqr() + c[1].norm_sqr()).sqrt()).sum()
        };
        let change = |a: &[Complex64], b: &[Complex64], step: f64| -> f64 {
            let difference: Vec<_> = a.iter().zip(b).map(|(a, b)| a - b).collect();
            size(&difference) / step
        };
        let mut bounds = vec![FieldBounds::default(); ny * nx];
        for t in 0..nt {
            for iy in 0..ny {
                for ix in 0..nx {
                    let here = self.node(t, iy, ix);
                    let east = self.node(t, iy, (ix + 1).min(nx - 1));
                    let north = self.node(t, (iy + 1).min(ny - 1), ix);
                    let later = self.node((t + 1).min(nt - 1), iy, ix);
                    let gradient = change(&here[tide], &east[tide], self.x.step)
                        + change(&here[tide], &north[tide], self.y.step);
                    let rate = change(&here[tide], &later[tide], self.time.step);
                    let node = &mut bounds[iy * nx + ix];
                    node.tide = node.tide.max(size(&here[tide]));
                    node.residual = node.residual.max(size(&here[2 * self.tide_harmonics..]));
                    node.gradient = node.gradient.max(gradient);
                    node.rate = node.rate.max(rate);
                }
            }
        }
        bounds
    }

    fn stencils(&self, t: f64, x: Vec2) -> Result<[Stencil; 3], DriftError> {
        if !self.x.contains(x.x) || !self.y.contains(x.y) {
            return Err(DriftError::OutsideDomain { x: x.x, y: x.y });
        }
        // Before the first time and after the last the sea is as it is then.
        let held = t.clamp(self.time.start, self.time.end());
        Ok([self.x.stencil(x.x), self.y.stencil(x.y), self.time.stencil(held)])
    }

    /// Rows of nodes under the stencils that carry weight, with their (y, time) places in them; the
    /// channels of a row's nodes follow each other.
    fn rows<'a>(
        &'a self,
        [sx, sy, st]: &'a [Stencil; 3],
    ) -> impl Iterator<Item = ((usize, usize), std::slice::ChunksExact<'a, Complex64>)> {
        let width = |axis: &Axis| axis.coefficients().min(4);
        let (wx, wy, wt) = (width(&self.x), width(&self.y), width(&self.time));
        (0..wt * wy).map(move |row| {
            let (j, k) = (row % wy, row / wy);
            let row = (st.first + k) * self.y.coefficients() + sy.first + j;
            let first = (row * self.x.coefficients() + sx.first) * self.channels;
            let nodes = &self.coefficients[first..first + wx * self.channels];
            ((j, k), nodes.chunks_exact(self.channels))
        })
    }

    /// The harmonics with their gradients; with `ALL` also with their other derivatives.
    ///
    /// First along x, so that each derivative there serves several along y and time.
    fn sum<const ALL: bool>(&self, t: f64, x: Vec2, out: &mut Harmonics) -> Result<(), DriftError> {
        let stencils = self.stencils(t, x)?;
        let [sx, sy, st] = &stencils;
        let (tide, residual) = self.lines.split_at(self.tide_harmonics);
        out.tide = SmallVec::from_slice(tide);
        out.residual = SmallVec::from_slice(residual);
        for ((j, k), nodes) in self.rows(&stencils) {
            let (value, slope) = (sy.value[j] * st.value[k], sy.slope[j] * st.value[k]);
            let (curvature, rate) = (sy.curvature[j] * st.value[k], sy.value[j] * st.slope[k]);
            let harmonics = out.tide.iter_mut().chain(out.residual.iter_mut());
            for (first, harmonic) in (0..).step_by(2).zip(harmonics) {
                for component in 0..2 {
                    let mut along = [Complex64::ZERO; 3];
                    for (i, node) in nodes.clone().enumerate() {
                        let c = node[first + component];
                        along[0] += c * sx.value[i];
                        along[1] += c * sx.slope[i];
                        if ALL {
                            along[2] += c * sx.curvature[i];
                        }
                    }
                    let [here, east, bend] = along;
                    harmonic.amplitude[component] += here * value;
                    harmonic.gradient[(component, 0)] += east * value;
                    harmonic.gradient[(component, 1)] += here * slope;
                    if ALL {
                        harmonic.rate[component] += here * rate;
                        let cross = east * slope;
                        harmonic.hessian[component] +=
                            CMat2::new(bend * value, cross, cross, here * curvature);
                    }
                }
            }
        }
        if let Some(mean) = out.residual.first_mut() {
            mean.amplitude = mean.amplitude.map(|c| c.re.into());
        }
        Ok(())
    }

    /// `e^{iωt}` of each line.
    fn phasors(&self, t: f64) -> SmallVec<[Complex64; 8]> {
        if !self.periodic {
            return self.lines.iter().map(|line| line.phasor(t)).collect();
        }
        // Multiples of one frequency need one sine and cosine.
        let powers = phasors(self.omega() * t);
        let (tide, residual) = self.lines.split_at(self.tide_harmonics);
        let powers: SmallVec<[Complex64; 8]> = std::iter::once(Complex64::ONE)
            .chain(powers)
            .take((tide.len() + 1).max(residual.len()))
            .collect();
        powers[1..=tide.len()].iter().chain(&powers[..residual.len()]).copied().collect()
    }
}

impl SeaField for GriddedSea {
    fn period(&self) -> f64 {
        self.period
    }

    fn slowest(&self) -> f64 {
        let tide = self.lines[..self.tide_harmonics].iter();
        tide.map(|line| line.omega).fold(self.omega(), f64::min)
    }

    fn is_periodic(&self) -> bool {
        self.periodic
    }

    fn velocity(&self, t: f64, x: Vec2) -> Result<Vec2, DriftError> {
        let stencils = self.stencils(t, x)?;
        let [sx, sy, st] = &stencils;
        let mut amplitudes: SmallVec<[Complex64; 16]> = smallvec![Complex64::ZERO; self.channels];
        for ((j, k), nodes) in self.rows(&stencils) {
            for (node, weight) in nodes.zip(sx.value) {
                let weight = weight * sy.value[j] * st.value[k];
                for (amplitude, c) in amplitudes.iter_mut().zip(node) {
                    *amplitude += c * weight;
                }
            }
        }
        let pairs = amplitudes.chunks_exact(2).zip(self.phasors(t));
        Ok(pairs.map(|(pair, phasor)| in_phase([pair[0], pair[1]].into(), phasor)).sum())
    }

    fn harmonics(&self, t: f64, x: Vec2, out: &mut Harmonics) -> Result<(), DriftError> {
        self.sum::<true>(t, x, out)
    }

    fn gradients(&self, t: f64, x: Vec2, out: &mut Harmonics) -> Result<(), DriftError> {
        self.sum::<false>(t, x, out)
    }

    fn bounds(&self, center: Vec2, radius: f64) -> FieldBounds {
        let mut largest = FieldBounds::default();
        for iy in self.y.reach(center.y, radius) {
            for ix in self.x.reach(center.x, radius) {
                let node = &self.node_bounds[iy * self.x.coefficients() + ix];
                largest.tide = largest.tide.max(node.tide);
                largest.gradient = largest.gradient.max(node.gradient);
                largest.rate = largest.rate.max(node.rate);
                largest.residual = largest.residual.max(node.residual);
            }
        }
        largest
    }
}

#[cfg(test)]
mod tests {
    use super::super::real;
    use super::*;

    /// Two tide harmonics and a residual with one harmonic, coefficients of no special form.
    fn sea() -> Result<GriddedSea, DriftError> {
        let axis = |count| Axis { start: -1.0, step: 0.5, count };
        let channels = 8;
        let count = 9 * 8 * 7 * channels;
        let value = |k: usize| (0.37 * k as f64).sin();
        let coefficients =
            (0..count).map(|k| Complex64::new(value(k), value(k * k % 1009))).collect();
        GriddedSea::new(
            0.1,
            [axis(7), axis(6), axis(5)],
            Tide::Harmonics(2),
            channels,
            coefficients,
        )
    }

    #[test]
    fn a_constituent_needs_a_frequency() {
        let axis = Axis { start: 0.0, step: 1.0, count: 1 };
        for (omega, good) in [(1e-9, true), (0.0, false), (-1.0, false), (f64::NAN, false)] {
            let tide = Tide::Constituents(vec![Harmonic { omega, ..Harmonic::default() }]);
            let made = GriddedSea::new(0.1, [axis; 3], tide, 2, vec![0.0.into(); 2]);
            let told = made.err().map_or_else(String::new, |error| error.to_string());
            let refusal = format!("constituent: {omega} is not accepted; it needs a frequency");
            assert_eq!(told.starts_with(&refusal), !good, "{told}");
            assert_eq!(told.is_empty(), good, "{told}");
        }
    }

    /// The splines, continued, would grow with the cube of the time.
    #[test]
    fn before_and_after_its_times_a_sea_is_held() -> Result<(), DriftError> {
        let (sea, x) = (sea()?, Vec2::new(0.31, 0.12));
        let at = |t: f64| -> Result<Harmonics, DriftError> {
            let mut out = Harmonics::default();
            sea.harmonics(t, x, &mut out).map(|()| out)
        };
        for (end, beyond) in [(-1.0, -1e6), (1.0, 1e6)] {
            assert_eq!(format!("{:?}", at(end)?), format!("{:?}", at(beyond)?));
        }
        Ok(())
    }

    #[test]
    fn derivatives_match_differences() -> Result<(), DriftError> {
        let sea = sea()?;
        let (t, x, d) = (0.23, Vec2::new(0.31, 0.12), 1e-5);
        let at = |t: f64, x: Vec2| -> Result<Harmonics, DriftError> {
            let mut out = Harmonics::default();
            sea.harmonics(t, x, &mut out).map(|()| out)
        };
        let here = at(t, x)?;
        for a in 0..2 {
            let mut shift = Vec2::zeros();
            shift[a] = d;
            let (ahead, behind) = (at(t, x + shift)?, at(t, x - shift)?);
            for j in 0..2 {
                for c in 0..2 {
                    let slope =
                        (ahead.tide[j].amplitude[c] - behind.tide[j].amplitude[c]) / (2.0 * d);
                    assert!((slope - here.tide[j].gradient[(c, a)]).norm() < 1e-8);
                    for b in 0..2 {
                        let curvature = (ahead.tide[j].gradient[(c, b)]
                            - behind.tide[j].gradient[(c, b)])
                            / (2.0 * d);
                        assert!((curvature - here.tide[j].hessian[c][(a, b)]).norm() < 1e-6);
                    }
                }
            }
        }
        let rate = (at(t + d, x)?.tide[0].amplitude - at(t - d, x)?.tide[0].amplitude)
            .map(|c| c / (2.0 * d));
        assert!((rate - here.tide[0].rate).map(|c| c.norm()).max() < 1e-8);
        Ok(())
    }

    #[test]
    fn both_views_agree_and_bounds_hold() -> Result<(), DriftError> {
        let sea = sea()?;
        let center = Vec2::new(0.3, 0.2);
        let bounds = sea.bounds(center, 0.4);
        let mut out = Harmonics::default();
        for k in 0..200 {
            let angle = 0.7 * k as f64;
            let (t, x) = (0.004 * k as f64, center + 0.4 * Vec2::new(angle.cos(), angle.sin()));
            sea.harmonics(t, x, &mut out)?;
            let mut sum = real(out.residual[0].amplitude);
            for (j, phasor) in phasors(sea.omega() * t).take(2).enumerate() {
                sum += in_phase(out.tide[j].amplitude, phasor);
                if let Some(residual) = out.residual.get(j + 1) {
                    sum += in_phase(residual.amplitude, phasor);
                }
            }
            assert!((sum - sea.velocity(t, x)?).norm() < 1e-12);
            let total = |f: fn(&Harmonic) -> f64| -> f64 { out.tide.iter().map(f).sum() };
            let size = |v: super::super::CVec2| (v.x.norm_sqr() + v.y.norm_sqr()).sqrt();
            assert!(out.tide.iter().map(|h| size(h.amplitude)).sum::<f64>() <= bounds.tide);
            assert!(out.tide.iter().map(|h| size(h.rate)).sum::<f64>() <= bounds.rate);
            assert!(
                total(|h| h.gradient.iter().map(|g| g.norm_sqr()).sum::<f64>().sqrt())
                    <= bounds.gradient
            );
            assert!(out.residual.iter().map(|h| size(h.amplitude)).sum::<f64>() <= bounds.residual);
        }
        Ok(())
    }

    #[test]
    fn leaving_the_grid_is_an_error() -> Result<(), DriftError> {
        assert!(sea()?.velocity(0.0, Vec2::new(2.1, 0.0)).is_err());
        assert!(sea()?.velocity(0.0, Vec2::new(2.0, 0.0)).is_ok());
        Ok(())
    }
}
