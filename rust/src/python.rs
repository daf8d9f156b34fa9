//! The doorway to Python: checks shapes, copies in, releases the interpreter while it computes,
//! moves arrays out. The only file that knows pyo3 and numpy.

use std::sync::Arc;
use std::time::{Duration, Instant};

use nalgebra::Matrix2;
use numpy::{
    Complex64, Element, IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods,
    PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyReadonlyArray4, PyReadwriteArray1,
    PyReadwriteArray2, PyReadwriteArray3, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use crate::coast::{Coast as CoreCoast, Side};
use crate::ensemble::{self, Ensemble, Member, Trajectory, Winds};
use crate::error::{DriftError, finite, product, room};
use crate::field::academic::{AcademicSea, SeparableCurrent};
use crate::field::gridded::{Axis, GriddedSea, Tide};
use crate::field::sum::SumOfSeas;
use crate::field::{Harmonic, SeaField, Vec2};
use crate::fleet::{Fleet as CoreFleet, Watched};
use crate::geometry::Geometry;
use crate::model::body::{Body, Line, Release};
use crate::model::{Formulation, Model, Solver as CoreSolver};
use crate::particles::Particle;
use crate::statistics::{Cells, MapGrid, Maps as CoreMaps};
use crate::wind::bootstrap::{Bootstrap as CoreBootstrap, Catalogue};
use crate::wind::fields::{FieldWinds as CoreFieldWinds, WindPatterns};
use crate::wind::hand_over::HandOver as CoreHandOver;
use crate::wind::lanes::WindPaths as CorePaths;
use crate::wind::path::WindPath as CorePath;
use crate::wind::small_scale::SmallScale;
use crate::wind::{self, Beginning, Sampling};

impl From<DriftError> for PyErr {
    fn from(error: DriftError) -> Self {
        match error {
            DriftError::Invalid { .. }
            | DriftError::WindTooShort { .. }
            | DriftError::OutsideDomain { .. } => PyValueError::new_err(error.to_string()),
            DriftError::Integration { .. } => PyRuntimeError::new_err(error.to_string()),
        }
    }
}

/// Rows of a two-column array.
fn points(name: &'static str, array: &PyReadonlyArray2<f64>) -> Result<Vec<Vec2>, DriftError> {
    let [rows, columns] = [array.shape()[0], array.shape()[1]];
    if columns != 2 {
        return Err(DriftError::invalid(
            name,
            format!("shape ({rows}, {columns})"),
            "it needs two columns",
        ));
    }
    Ok(array.as_array().rows().into_iter().map(|row| Vec2::new(row[0], row[1])).collect())
}

/// Members and knots of winds of either precision.
fn members_of<T: Element>(velocity: &PyReadonlyArray3<T>) -> Result<[usize; 2], DriftError> {
    let (members, knots, components) = velocity.as_array().dim();
    if components != 2 {
        let given = format!("shape ({members}, {knots}, {components})");
        return Err(DriftError::invalid("wind paths' velocity", given, "it needs two components"));
    }
    Ok([members, knots])
}

/// Wind of a member at a knot.
fn winds_of<T: Element + Copy + Into<f64>>(
    velocity: &PyReadonlyArray3<T>,
) -> impl Fn(usize, usize) -> Vec2 {
    let values = velocity.as_array();
    move |member, knot| [0, 1].map(|k| values[[member, knot, k]].into()).into()
}

fn flat(array: &PyReadonlyArray2<f64>) -> Vec<f64> {
    array.as_array().iter().copied().collect()
}

fn indices(name: &'static str, array: &PyReadonlyArray1<i64>) -> Result<Vec<usize>, DriftError> {
    (array.as_array().iter())
        .map(|value| {
            usize::try_from(*value)
                .map_err(|_| DriftError::invalid(name, value, "it must not be negative"))
        })
        .collect()
}

/// (n, 2) array from points.
fn columns<'py>(py: Python<'py>, points: &[Vec2]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let values: Vec<f64> = points.iter().flat_map(|x| [x.x, x.y]).collect();
    values.into_pyarray(py).reshape([points.len(), 2])
}

/// (n, m, 2) array from points.
fn layers<'py>(
    py: Python<'py>,
    [rows, length]: [usize; 2],
    points: &[Vec2],
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let values: Vec<f64> = points.iter().flat_map(|x| [x.x, x.y]).collect();
    values.into_pyarray(py).reshape([rows, length, 2])
}

/// Wind path in scenario units.
#[pyclass(frozen)]
struct WindPath(CorePath);

#[pymethods]
impl WindPath {
    #[new]
    fn new(times: PyReadonlyArray1<f64>, velocity: PyReadonlyArray2<f64>) -> PyResult<Self> {
        let times = times.as_array().to_vec();
        Ok(Self(CorePath::new(times, points("wind path velocity", &velocity)?)?))
    }

    #[getter]
    fn start(&self) -> f64 {
        self.0.start()
    }

    #[getter]
    fn end(&self) -> f64 {
        self.0.end()
    }

    fn velocity<'py>(
        &self,
        py: Python<'py>,
        times: PyReadonlyArray1<f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.sampled(py, &times, |t| self.0.velocity(t))
    }

    fn integral<'py>(
        &self,
        py: Python<'py>,
        times: PyReadonlyArray1<f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.sampled(py, &times, |t| self.0.integral(t))
    }

    fn mean<'py>(
        &self,
        py: Python<'py>,
        times: PyReadonlyArray1<f64>,
        window: f64,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        self.sampled(py, &times, |t| self.0.mean(t, window))
    }
}

impl WindPath {
    fn sampled<'py>(
        &self,
        py: Python<'py>,
        times: &PyReadonlyArray1<f64>,
        value: impl Fn(f64) -> Vec2,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let mut values = room("times", times.len())?;
        values.extend(times.as_array().iter().map(|t| value(*t)));
        columns(py, &values)
    }
}

/// Winds of an ensemble on common regular knots.
#[pyclass(frozen)]
struct WindPaths(CorePaths);

/// Winds in either precision, (members, knots, 2).
#[derive(FromPyObject)]
enum Velocity<'py> {
    Double(PyReadonlyArray3<'py, f64>),
    Single(PyReadonlyArray3<'py, f32>),
}

#[pymethods]
impl WindPaths {
    /// Keeps the winds in the precision that they come in.
    #[new]
    fn new(py: Python, start: f64, spacing: f64, velocity: Velocity) -> PyResult<Self> {
        let paths = match velocity {
            Velocity::Double(velocity) => {
                let (shape, at) = (members_of(&velocity)?, winds_of(&velocity));
                py.detach(|| CorePaths::new(start, spacing, shape, at))
            }
            Velocity::Single(velocity) => {
                let (shape, at) = (members_of(&velocity)?, winds_of(&velocity));
                py.detach(|| CorePaths::single(start, spacing, shape, at))
            }
        };
        Ok(Self(paths?))
    }

    /// Wind of the first `members` members at some times.
    fn velocity<'py>(
        &self,
        py: Python<'py>,
        members: usize,
        times: PyReadonlyArray1<f64>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        if members > self.0.members() {
            return Err(DriftError::invalid("members", members, "there are fewer").into());
        }
        let times = times.as_array();
        let mut values = room("times", product("times", &[members, times.len()])?)?;
        values.extend(
            (0..members).flat_map(|member| times.iter().map(move |t| self.0.velocity(member, *t))),
        );
        layers(py, [members, times.len()], &values)
    }
}

/// Fitted bootstrap of a wind record.
#[pyclass(frozen)]
struct Bootstrap(Arc<CoreBootstrap>);

#[pymethods]
impl Bootstrap {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "one argument for each fitted array")]
    fn new(
        py: Python,
        states: PyReadonlyArray2<f64>,
        whitening: PyReadonlyArray2<f64>,
        target: PyReadonlyArray2<f64>,
        predictor: PyReadonlyArray2<f64>,
        noise: PyReadonlyArray2<f64>,
        row: PyReadonlyArray1<i64>,
        phase: PyReadonlyArray1<i64>,
        start: PyReadonlyArray1<bool>,
        cycle: PyReadonlyArray2<f64>,
        bandwidth: f64,
    ) -> PyResult<Self> {
        let catalogue = Catalogue {
            order: states.shape()[1] / 2,
            states: flat(&states),
            whitening: flat(&whitening),
            target: flat(&target),
            predictor: flat(&predictor),
            noise: flat(&noise),
            row: indices("row", &row)?,
            phase: indices("phase", &phase)?,
            start: start.as_array().to_vec(),
            cycle: flat(&cycle),
            bandwidth,
        };
        Ok(Self(Arc::new(py.detach(|| CoreBootstrap::new(catalogue))?)))
    }

    /// Winds and, of each, the record row whose successor it is: −1 where it was handed over.
    #[pyo3(signature = (members, steps, seed, first_member=0, phase=None, hand_over=None))]
    #[expect(clippy::type_complexity, reason = "two arrays")]
    #[expect(clippy::too_many_arguments, reason = "what names a sample")]
    fn sample<'py>(
        &self,
        py: Python<'py>,
        members: usize,
        steps: usize,
        seed: u64,
        first_member: u64,
        phase: Option<usize>,
        hand_over: Option<&HandOver>,
    ) -> PyResult<(Bound<'py, PyArray3<f64>>, Bound<'py, PyArray2<i64>>)> {
        let end = member_range(first_member, members)?.end;
        let count = product("members", &[members, steps, 2])? / 2;
        let mut wind = room("members", count)?;
        let mut predecessor = room("members", count)?;
        let beginning = Beginning { phase, hand_over: hand_over.map(|over| over.0.clone()) };
        let mut member = first_member;
        while member < end {
            let batch = member..(member + BATCH).min(end);
            member = batch.end;
            let sample =
                py.detach(|| wind::sample(&self.0, seed, batch, steps, beginning.clone()))?;
            wind.extend(sample.wind);
            predecessor
                .extend(sample.predecessor.into_iter().map(|row| row.map_or(-1, |row| row as i64)));
            py.check_signals()?;
        }
        let wind = layers(py, [members, steps], &wind)?;
        Ok((wind, predecessor.into_pyarray(py).reshape([members, steps])?))
    }

    #[pyo3(signature = (state, count, seed, weigh_all=false))]
    fn draws_at<'py>(
        &self,
        py: Python<'py>,
        state: PyReadonlyArray1<f64>,
        count: usize,
        seed: u64,
        weigh_all: bool,
    ) -> PyResult<Bound<'py, PyArray1<i64>>> {
        use rand::SeedableRng;
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let state = state.as_array().to_vec();
        let rows = py.detach(|| self.0.draws_at(&state, weigh_all, count, &mut rng))?;
        Ok(rows.into_iter().map(|row| row as i64).collect::<Vec<_>>().into_pyarray(py))
    }
}

/// A forecast and its errors, from which a bootstrap goes on.
#[pyclass(frozen)]
struct HandOver(Arc<CoreHandOver>);

#[pymethods]
impl HandOver {
    /// Calibrated anomalies [forecast, step, component] and the spread at each step; the errors'
    /// lag-one matrix and the roots of the covariances of their innovations and of themselves.
    #[new]
    fn new(
        forecasts: PyReadonlyArray3<f64>,
        spread: PyReadonlyArray1<f64>,
        memory: [[f64; 2]; 2],
        innovation: [[f64; 2]; 2],
        scale: [[f64; 2]; 2],
    ) -> PyResult<Self> {
        if forecasts.shape()[2] != 2 || forecasts.shape()[1] != spread.len() {
            let found = format!("shape {:?}", forecasts.shape());
            let accepted = format!("(forecasts, {}, 2)", spread.len());
            return Err(DriftError::invalid("forecasts", found, accepted).into());
        }
        let values = forecasts.as_array();
        let values = values.rows().into_iter().map(|row| Vec2::new(row[0], row[1])).collect();
        let matrices = [memory, innovation, scale]
            .map(|[first, second]| Matrix2::new(first[0], first[1], second[0], second[1]));
        let spread = spread.as_array().to_vec();
        Ok(Self(Arc::new(CoreHandOver::new(values, spread, matrices)?)))
    }
}

/// Draws the wind of any member in scenario units.
#[pyclass(frozen)]
struct WindGenerator(wind::WindGenerator);

#[pymethods]
impl WindGenerator {
    #[new]
    #[pyo3(signature = (
        bootstrap, step, unit, small_scale_sd, memory, substeps, lead_in, phase=None, hand_over=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "one argument for each physical quantity")]
    fn new(
        bootstrap: &Bootstrap,
        step: f64,
        unit: f64,
        small_scale_sd: f64,
        memory: f64,
        substeps: usize,
        lead_in: usize,
        phase: Option<usize>,
        hand_over: Option<&HandOver>,
    ) -> PyResult<Self> {
        let small_scale = SmallScale::new(small_scale_sd, memory, step, substeps)?;
        let generator =
            wind::WindGenerator::new(bootstrap.0.clone(), small_scale, step, unit, lead_in, phase)?;
        Ok(Self(match hand_over {
            Some(hand_over) => generator.handed_over(hand_over.0.clone()),
            None => generator,
        }))
    }

    /// Times and velocities of one member's fine path, up to `end`.
    #[expect(clippy::type_complexity, reason = "two arrays")]
    fn path<'py>(
        &self,
        py: Python<'py>,
        seed: u64,
        member: u64,
        end: f64,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>)> {
        let path = py.detach(|| self.0.path(seed, member, end, Sampling::Fine))?;
        Ok((path.times().to_vec().into_pyarray(py), columns(py, path.knots())?))
    }
}

/// A part is about a tide: these are more than a century.
const MOST_PARTS: usize = 100_000;

/// Members that may be branched, and the parts of a run that they may be branched between.
#[pyclass(frozen)]
struct Particles {
    particles: Vec<Arc<Particle>>,
    parts: usize,
}

#[pymethods]
impl Particles {
    #[new]
    fn new(members: PyReadonlyArray1<u64>, parts: usize) -> PyResult<Self> {
        if parts == 0 || parts > MOST_PARTS {
            let accepted = format!("a run has from 1 to {MOST_PARTS}");
            return Err(DriftError::invalid("parts", parts, accepted).into());
        }
        let particles = (members.as_array().iter())
            .map(|member| Ok(Arc::new(Particle::new(*member)?)))
            .collect::<Result<_, DriftError>>()?;
        Ok(Self { particles, parts })
    }

    /// Branches of particles: each takes the random numbers of a member from a synoptic step on.
    fn branched(
        &self,
        parents: PyReadonlyArray1<i64>,
        steps: PyReadonlyArray1<i64>,
        members: PyReadonlyArray1<u64>,
    ) -> PyResult<Self> {
        let (parents, steps) = (indices("parents", &parents)?, indices("steps", &steps)?);
        if parents.len() != steps.len() || parents.len() != members.len() {
            let found = [parents.len(), steps.len(), members.len()];
            let accepted = "a parent, a step and a member for each branch";
            return Err(DriftError::invalid("branches", format!("{found:?}"), accepted).into());
        }
        let particles = (parents.iter().zip(steps).zip(members.as_array()))
            .map(|((parent, step), member)| {
                Ok(Arc::new(self.particle(*parent)?.branched(step, *member)?))
            })
            .collect::<Result<_, DriftError>>()?;
        Ok(Self { particles, parts: self.parts })
    }

    /// The same with others at some places.
    fn replaced(&self, places: PyReadonlyArray1<i64>, others: &Self) -> PyResult<Self> {
        let places = indices("places", &places)?;
        let mut particles = self.particles.clone();
        for (k, place) in places.iter().enumerate() {
            self.particle(*place)?;
            particles[*place] = others.particle(k)?.clone();
        }
        Ok(Self { particles, parts: self.parts })
    }

    /// Position, `∫W` and wind at the end of each part they were followed in and adrift at, NaN
    /// elsewhere: shape (parts, particles, 6).
    fn seen<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let (parts, count) = (self.parts, self.particles.len());
        let size = product("parts", &[parts, count, 6])?;
        let mut values = room("parts", size)?;
        values.resize(size, f64::NAN);
        for (place, particle) in self.particles.iter().enumerate() {
            let (first, seen) = particle.seen();
            for (part, seen) in (first..parts).zip(seen) {
                let row = 6 * (part * count + place);
                for (k, of) in seen.iter().enumerate() {
                    values[row + 2 * k..row + 2 * k + 2].copy_from_slice(of.as_slice());
                }
            }
        }
        values.into_pyarray(py).reshape([parts, count, 6])
    }

    /// Steps that they were followed for, in whole runs.
    fn followed(&self) -> f64 {
        self.particles.iter().map(|particle| particle.share()).sum()
    }
}

impl Particles {
    fn particle(&self, place: usize) -> Result<&Arc<Particle>, DriftError> {
        let count = self.particles.len();
        (self.particles.get(place))
            .ok_or_else(|| DriftError::invalid("particle", place, format!("there are {count}")))
    }
}

/// Sea-surface velocity field.
#[pyclass(frozen)]
struct Sea(Arc<dyn SeaField>);

/// (mean, modulation, cycles, phase, axis) and sine amplitudes of a separable current.
type Current<'py> = ((f64, f64, f64, f64, usize), PyReadonlyArray2<'py, f64>);

fn separable(
    ((mean, modulation, cycles, phase, axis), sines): &Current,
) -> PyResult<SeparableCurrent> {
    Ok(SeparableCurrent {
        mean: *mean,
        modulation: *modulation,
        cycles: *cycles,
        phase: *phase,
        axis: *axis,
        sines: points("harmonics", sines)?,
    })
}

fn gridded_sea(
    period: f64,
    axes: [(f64, f64, usize); 3],
    tide: Tide,
    coefficients: &PyReadonlyArray4<Complex64>,
) -> PyResult<Sea> {
    let channels = coefficients.shape()[3];
    let values = coefficients.as_array().iter().copied().collect();
    let axes = axes.map(|(start, step, count)| Axis { start, step, count });
    Ok(Sea(Arc::new(GriddedSea::new(period, axes, tide, channels, values)?)))
}

#[pymethods]
impl Sea {
    #[staticmethod]
    fn academic(
        period: f64,
        tide: Current,
        residual: Current,
        residual_scale: f64,
    ) -> PyResult<Self> {
        let sea =
            AcademicSea::new(period, separable(&tide)?, separable(&residual)?, residual_scale)?;
        Ok(Self(Arc::new(sea)))
    }

    /// Axes (start, step, count) of x, y and time; spline coefficients [time, y, x, channel].
    #[staticmethod]
    fn gridded(
        period: f64,
        axes: [(f64, f64, usize); 3],
        tide_harmonics: usize,
        coefficients: PyReadonlyArray4<Complex64>,
    ) -> PyResult<Self> {
        gridded_sea(period, axes, Tide::Harmonics(tide_harmonics), &coefficients)
    }

    /// The same, the tide's channels being those of constituents (frequency, species).
    #[staticmethod]
    fn constituents(
        period: f64,
        axes: [(f64, f64, usize); 3],
        constituents: Vec<(f64, u32)>,
        coefficients: PyReadonlyArray4<Complex64>,
    ) -> PyResult<Self> {
        let lines = (constituents.into_iter())
            .map(|(omega, species)| Harmonic { omega, species, ..Harmonic::default() })
            .collect();
        gridded_sea(period, axes, Tide::Constituents(lines), &coefficients)
    }

    /// Several seas at once; the first has the tide's period.
    #[staticmethod]
    fn sum(seas: Vec<Py<Sea>>) -> PyResult<Self> {
        let parts = seas.iter().map(|sea| sea.get().0.clone()).collect();
        Ok(Self(Arc::new(SumOfSeas::new(parts)?)))
    }

    fn velocity<'py>(
        &self,
        py: Python<'py>,
        times: PyReadonlyArray1<f64>,
        positions: PyReadonlyArray2<f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let positions = points("positions", &positions)?;
        if times.len() != positions.len() {
            return Err(DriftError::invalid("times", times.len(), "one for each position").into());
        }
        let values: Vec<Vec2> = (times.as_array().iter().zip(positions))
            .map(|(t, x)| self.0.velocity(*t, x))
            .collect::<Result<_, _>>()?;
        columns(py, &values)
    }
}

/// Coast line.
#[pyclass(frozen)]
struct Coast(CoreCoast);

fn side(inside: bool) -> Side {
    if inside { Side::Inside } else { Side::Outside }
}

#[pymethods]
impl Coast {
    #[staticmethod]
    fn circle(center: (f64, f64), radius: f64, inside: bool) -> PyResult<Self> {
        Ok(Self(CoreCoast::circle(Vec2::new(center.0, center.1), radius, side(inside))?))
    }

    #[staticmethod]
    fn polygons(rings: Vec<PyReadonlyArray2<f64>>, inside: bool) -> PyResult<Self> {
        let rings: Vec<Vec<Vec2>> =
            rings.iter().map(|ring| points("coast ring", ring)).collect::<Result<_, _>>()?;
        Ok(Self(CoreCoast::polygons(&rings, side(inside))?))
    }

    /// Distance to the coast line, above 0 where the body floats.
    fn clearance(&self, x: f64, y: f64) -> f64 {
        self.0.clearance(Vec2::new(x, y))
    }

    /// The same of many positions.
    fn clearances<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let positions = points("positions", &positions)?;
        let clearances: Vec<f64> =
            py.detach(|| positions.iter().map(|x| self.0.clearance(*x)).collect());
        Ok(clearances.into_pyarray(py))
    }
}

/// Maps being counted.
#[pyclass(frozen)]
struct Maps(CoreMaps);

/// Present, arrived (of one more interval than map times), outside, stranded.
type Counted<'py> = [Bound<'py, PyArray1<u32>>; 4];

#[pymethods]
impl Maps {
    /// Cells (start, size, count) of x and y; `times` are among the `samples`.
    #[new]
    fn new(
        py: Python,
        x: (f64, f64, usize),
        y: (f64, f64, usize),
        times: PyReadonlyArray1<f64>,
        samples: PyReadonlyArray1<f64>,
        threads: usize,
    ) -> PyResult<Self> {
        let [x, y] = [x, y].map(|(start, size, count)| Cells { start, size, count });
        let [times, samples] = [times, samples].map(|times| times.as_array().to_vec());
        let threads = checked_threads(threads)?;
        Ok(Self(py.detach(|| CoreMaps::new(MapGrid::new(x, y, times, samples)?, threads))?))
    }

    /// Numbers of members up to now, flat.
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Counted<'py>> {
        let counts = py.detach(|| self.0.total())?;
        Ok([counts.present, counts.arrived, counts.outside, counts.stranded]
            .map(|values| values.into_pyarray(py)))
    }
}

/// Model with its parameters and tolerances.
#[pyclass(frozen)]
struct Solver(CoreSolver);

#[pymethods]
impl Solver {
    #[staticmethod]
    fn full(general: bool, rtol: f64, atol: f64, euler_step: Option<f64>) -> Self {
        let formulation = if general { Formulation::A } else { Formulation::B };
        Self(CoreSolver { model: Model::Full(formulation), rtol, atol, euler_step })
    }

    #[staticmethod]
    fn paper(
        order: u8,
        window: f64,
        wind_terms: bool,
        rtol: f64,
        atol: f64,
        euler_step: Option<f64>,
    ) -> Self {
        Self(CoreSolver {
            model: Model::Paper { order, window, wind_terms },
            rtol,
            atol,
            euler_step,
        })
    }

    #[staticmethod]
    fn mean_flow(order: u8, rtol: f64, atol: f64, euler_step: Option<f64>) -> Self {
        Self(CoreSolver { model: Model::MeanFlow { order }, rtol, atol, euler_step })
    }

    /// Interval of time that a wind path must cover.
    fn wind_needed(&self, duration: f64, period: f64) -> (f64, f64) {
        self.0.wind_needed(duration, period)
    }
}

/// Body, sea and coast.
#[pyclass(frozen)]
struct Scenario(ensemble::Scenario);

/// Members followed before the first look at Python's signals, for each thread; more where they
/// take less time than there is between two looks.
const BATCH: u64 = 64;
const SIGNALS_LOOKED_FOR: Duration = Duration::from_millis(50);

#[pymethods]
impl Scenario {
    #[new]
    fn new(
        sea: &Sea,
        coast: Option<&Coast>,
        drag: f64,
        duration: f64,
        position: (f64, f64),
        velocity: (f64, f64),
    ) -> PyResult<Self> {
        let scenario = ensemble::Scenario {
            sea: sea.0.clone(),
            coast: coast.map(|coast| coast.0.clone()),
            drag,
            duration,
            position: Vec2::new(position.0, position.1),
            velocity: Vec2::new(velocity.0, velocity.1),
        };
        Ok(Self(scenario.validated()?))
    }

    /// Position, velocity and (empty where the model has none) slow position and velocity; steps
    /// accepted, rejected, and evaluations of the right-hand side.
    fn trajectory<'py>(
        &self,
        py: Python<'py>,
        wind: &WindPath,
        solver: &Solver,
        times: PyReadonlyArray1<f64>,
    ) -> PyResult<Followed<'py>> {
        let times = output_times(&times, self.0.duration)?;
        let out = py.detach(|| self.0.trajectory(&wind.0, &solver.0, &times))?;
        trajectory_arrays(py, out)
    }

    /// Members from `first` on under winds drawn for (seed, member), under the paths of those
    /// indices, or under paths on common knots: as many as `into` has rows. Gives the first
    /// failure.
    #[pyo3(signature = (
        winds, solver, first, times, keep, into, threads, targets, steps_per_tide=None, maps=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "what names a run")]
    fn run(
        &self,
        py: Python,
        winds: GivenWinds,
        solver: &Solver,
        first: u64,
        times: PyReadonlyArray1<f64>,
        keep: u64,
        into: Fates,
        threads: usize,
        targets: Vec<Py<Coast>>,
        steps_per_tide: Option<f64>,
        maps: Option<&Maps>,
    ) -> PyResult<Option<String>> {
        let times = output_times(&times, self.0.duration)?;
        let paths = winds.paths();
        let winds = winds.core(&paths);
        let targets: Vec<&CoreCoast> = targets.iter().map(|target| &target.get().0).collect();
        let outputs = (times.as_slice(), keep);
        let range = checked_rows(first, keep, &into, times.len(), targets.len())?;
        winds.require(&range)?;
        let ensemble = py
            .detach(|| Ensemble::new(&self.0, &winds, solver.0, steps_per_tide, outputs))?
            .observed(maps.map(|maps| &maps.0), &targets);
        run_batches(py, range, into, threads, |batch| ensemble.follow(batch))
    }
}

/// Winds that vary in space, of some members.
#[pyclass(frozen)]
struct FieldWinds(CoreFieldWinds);

#[pymethods]
impl FieldWinds {
    /// Patterns by their spline coefficients [y, x, pattern, component] on axes (start, step,
    /// count) of x and y; their amplitudes [member, step, pattern], from the member `first` on, at
    /// `times` = (start, step); and a small scale (standard deviation, memory, substeps, seed).
    #[new]
    #[pyo3(signature = (axes, patterns, times, first, amplitudes, small_scale=None))]
    fn new(
        axes: [(f64, f64, usize); 2],
        patterns: PyReadonlyArray4<f64>,
        times: (f64, f64),
        first: u64,
        amplitudes: PyReadonlyArray3<f64>,
        small_scale: Option<(f64, f64, usize, u64)>,
    ) -> PyResult<Self> {
        if patterns.shape()[3] != 2 || amplitudes.shape()[2] != patterns.shape()[2] {
            let found = format!("{:?} and {:?}", patterns.shape(), amplitudes.shape());
            return Err(DriftError::invalid("wind patterns", found, "two components each").into());
        }
        let values = patterns.as_array();
        let values = values.rows().into_iter().map(|row| Vec2::new(row[0], row[1])).collect();
        let axes = axes.map(|(start, step, count)| Axis { start, step, count });
        let (start, step) = times;
        let small_scale = small_scale
            .map(|(sd, memory, substeps, seed)| {
                SmallScale::new(sd, memory, step, substeps).map(|small| (small, seed))
            })
            .transpose()?;
        let patterns = Arc::new(WindPatterns::new(axes, patterns.shape()[2], values)?);
        let steps = amplitudes.shape()[1];
        let amplitudes = amplitudes.as_array().iter().copied().collect();
        let times = (start, step, steps);
        Ok(Self(CoreFieldWinds::new(patterns, times, first, amplitudes, small_scale)?))
    }
}

/// Bodies of any kind, each with its release.
#[pyclass(frozen)]
struct Fleet(CoreFleet);

#[pymethods]
impl Fleet {
    /// On the plane, or on the sphere about a reference point of some latitude. Member `first + k`
    /// is released at `times[k]` from `positions[k]`, with the water's velocity if none is given.
    /// A row of `bodies`: response time, slip; slope and offset of the leeway downwind, crosswind
    /// and crosswind when jibed; wind-driven current along the wind and to its right.
    #[new]
    #[pyo3(signature = (sea, coast, latitude, end, first, times, positions, velocities, bodies, jibing_rate, seed))]
    #[expect(clippy::too_many_arguments, reason = "what names a fleet")]
    fn new(
        sea: &Sea,
        coast: Option<&Coast>,
        latitude: Option<f64>,
        end: f64,
        first: u64,
        times: PyReadonlyArray1<f64>,
        positions: PyReadonlyArray2<f64>,
        velocities: Option<PyReadonlyArray2<f64>>,
        bodies: PyReadonlyArray2<f64>,
        jibing_rate: f64,
        seed: u64,
    ) -> PyResult<Self> {
        let positions = points("positions", &positions)?;
        let velocities = velocities.map(|v| points("velocities", &v)).transpose()?;
        let count = positions.len();
        if times.len() != count || velocities.as_ref().is_some_and(|v| v.len() != count) {
            let accepted = format!("one for each of the {count} positions");
            return Err(DriftError::invalid("times", times.len(), accepted).into());
        }
        if bodies.shape()[1] != 10 {
            return Err(DriftError::invalid("bodies", bodies.shape()[1], "10 columns").into());
        }
        let releases = (times.as_array().iter().zip(positions).enumerate())
            .map(|(k, (time, position))| Release {
                time: *time,
                position,
                velocity: velocities.as_ref().map(|v| v[k]),
            })
            .collect();
        let bodies = (bodies.as_array().outer_iter())
            .map(|row| {
                let line = |k: usize| Line { slope: row[k], offset: row[k + 1] };
                Body {
                    response: row[0],
                    slip: row[1],
                    downwind: line(2),
                    crosswind: line(4),
                    jibed: line(6),
                    surface_current: [row[8], row[9]],
                }
            })
            .collect();
        let fleet = CoreFleet {
            sea: sea.0.clone(),
            coast: coast.map(|coast| coast.0.clone()),
            geometry: latitude.map_or(Geometry::Plane, |latitude| Geometry::Sphere { latitude }),
            end: crate::error::positive("end", end)?,
            first,
            releases,
            bodies,
            jibing_rate,
            seed,
        };
        Ok(Self(fleet.validated()?))
    }

    /// As `Scenario.trajectory`, of the first body.
    fn trajectory<'py>(
        &self,
        py: Python<'py>,
        winds: GivenWinds,
        solver: &Solver,
        times: PyReadonlyArray1<f64>,
    ) -> PyResult<Followed<'py>> {
        let times = output_times(&times, self.0.end)?;
        let paths = winds.paths();
        let winds = winds.core(&paths);
        let out = py.detach(|| self.0.trajectory(&winds, &solver.0, &times))?;
        trajectory_arrays(py, out)
    }

    /// As `Scenario.run`.
    #[pyo3(signature = (winds, solver, first, times, keep, into, threads, targets, maps=None))]
    #[expect(clippy::too_many_arguments, reason = "what names a run")]
    fn run(
        &self,
        py: Python,
        winds: GivenWinds,
        solver: &Solver,
        first: u64,
        times: PyReadonlyArray1<f64>,
        keep: u64,
        into: Fates,
        threads: usize,
        targets: Vec<Py<Coast>>,
        maps: Option<&Maps>,
    ) -> PyResult<Option<String>> {
        let times = output_times(&times, self.0.end)?;
        let paths = winds.paths();
        let winds = winds.core(&paths);
        let targets: Vec<&CoreCoast> = targets.iter().map(|target| &target.get().0).collect();
        let range = checked_rows(first, keep, &into, times.len(), targets.len())?;
        winds.require(&range)?;
        let watched =
            Watched { outputs: &times, keep, maps: maps.map(|maps| &maps.0), targets: &targets };
        run_batches(py, range, into, threads, |batch| {
            self.0.follow(&winds, &solver.0, watched, batch)
        })
    }
}

/// More threads than any machine has processors.
const MOST_THREADS: usize = 1024;

fn checked_threads(threads: usize) -> Result<usize, DriftError> {
    if (1..=MOST_THREADS).contains(&threads) {
        return Ok(threads);
    }
    Err(DriftError::invalid("threads", threads, format!("it must be from 1 to {MOST_THREADS}")))
}

fn member_range(first: u64, members: usize) -> Result<std::ops::Range<u64>, DriftError> {
    match first.checked_add(members as u64) {
        Some(end) if end <= wind::MOST_MEMBERS => Ok(first..end),
        _ => Err(DriftError::invalid("member", first, "members are numbered to 2⁶²")),
    }
}

/// Output times, which must lie within the run and not decrease.
fn output_times(times: &PyReadonlyArray1<f64>, end: f64) -> Result<Vec<f64>, DriftError> {
    let times = times.as_array().to_vec();
    finite("times", &times)?;
    if let Some(pair) = times.windows(2).find(|pair| pair[1] < pair[0]) {
        return Err(DriftError::invalid("times", pair[1], "they must not decrease"));
    }
    if let Some(bad) = times.iter().find(|t| !(0.0..=end).contains(*t)) {
        return Err(DriftError::invalid("times", bad, format!("the run covers [0, {end}]")));
    }
    Ok(times)
}

/// The members that `into` has rows for; fails unless what is written down fits.
fn checked_rows(
    first: u64,
    keep: u64,
    into: &Fates,
    outputs: usize,
    targets: usize,
) -> Result<std::ops::Range<u64>, DriftError> {
    let (status, stranding_time, place, position, entry_time) = into;
    let members = status.len();
    let range = member_range(first, members)?;
    let kept = keep.saturating_sub(first).min(members as u64) as usize;
    let fits = stranding_time.len() == members
        && place.shape() == [members, 2]
        && (position.shape()[0] >= kept && position.shape()[1..] == [outputs, 2])
        && entry_time.shape() == [members, targets];
    if fits {
        return Ok(range);
    }
    let accepted = format!("{members} members, {kept} kept at {outputs} times, {targets} targets");
    let shapes = [place.shape(), position.shape(), entry_time.shape()];
    Err(DriftError::invalid("into", format!("{shapes:?}"), accepted))
}

/// Follows members in batches, with a look at Python's signals between them, and
/// writes down what became of them. Gives the first failure.
fn run_batches(
    py: Python,
    members: std::ops::Range<u64>,
    into: Fates,
    threads: usize,
    follow: impl Fn(std::ops::Range<u64>) -> Vec<Member> + Sync,
) -> PyResult<Option<String>> {
    let threads = checked_threads(threads)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
    let (mut status, mut stranding_time, mut place, mut position, mut entry_time) = into;
    let (status, stranding_time) = (status.as_slice_mut()?, stranding_time.as_slice_mut()?);
    let mut place = place.as_array_mut();
    let mut position = position.as_array_mut();
    let mut entry_time = entry_time.as_array_mut();
    let mut size = BATCH * threads as u64;
    let mut failure = None;
    let mut row = 0;
    let mut at = members.start;
    while at < members.end {
        let batch = at..(at + size).min(members.end);
        at = batch.end;
        let began = Instant::now();
        for member in py.detach(|| pool.install(|| follow(batch))) {
            status[row] = member.status as i8;
            let (t, x) = member.stranding.unwrap_or((f64::NAN, Vec2::repeat(f64::NAN)));
            stranding_time[row] = t;
            (place[[row, 0]], place[[row, 1]]) = (x.x, x.y);
            for (k, x) in member.positions.iter().enumerate() {
                (position[[row, k, 0]], position[[row, k, 1]]) = (x.x, x.y);
            }
            for (k, t) in member.entries.iter().enumerate() {
                entry_time[[row, k]] = *t;
            }
            failure = failure.or(member.failure.map(|error| error.to_string()));
            row += 1;
        }
        py.check_signals()?;
        if began.elapsed() < SIGNALS_LOOKED_FOR {
            size *= 2;
        }
    }
    Ok(failure)
}

fn trajectory_arrays(py: Python<'_>, out: Trajectory) -> PyResult<Followed<'_>> {
    let (mean_position, mean_velocity): (Vec<_>, Vec<_>) = out.mean.into_iter().unzip();
    let arrays = [
        columns(py, &out.position)?,
        columns(py, &out.velocity)?,
        columns(py, &mean_position)?,
        columns(py, &mean_velocity)?,
    ];
    Ok((arrays, [out.work.accepted, out.work.rejected, out.work.evaluations]))
}

/// Winds of an ensemble, as Python hands them over.
#[derive(FromPyObject)]
enum GivenWinds {
    Drawn(Py<WindGenerator>, u64),
    Branched(Py<WindGenerator>, u64, Py<Particles>),
    One(Py<WindPath>),
    Paths(Vec<Py<WindPath>>),
    InMemory(Py<WindPaths>),
    Fields(Py<FieldWinds>),
}

impl GivenWinds {
    /// The paths, where they are given one by one.
    fn paths(&self) -> Vec<&CorePath> {
        match self {
            Self::One(path) => vec![&path.get().0],
            Self::Paths(paths) => paths.iter().map(|path| &path.get().0).collect(),
            _ => Vec::new(),
        }
    }

    fn core<'a>(&'a self, paths: &'a [&'a CorePath]) -> Winds<'a> {
        match self {
            Self::Drawn(generator, seed) => {
                Winds::Drawn { generator: &generator.get().0, seed: *seed }
            }
            Self::Branched(generator, seed, particles) => Winds::Branched {
                generator: &generator.get().0,
                seed: *seed,
                particles: &particles.get().particles,
                parts: particles.get().parts,
            },
            Self::One(_) | Self::Paths(_) => Winds::Given(paths),
            Self::InMemory(paths) => Winds::InMemory(&paths.get().0),
            Self::Fields(winds) => Winds::Fields(&winds.get().0),
        }
    }
}

/// Position, velocity, slow position and velocity; steps accepted, rejected, and evaluations.
type Followed<'py> = ([Bound<'py, PyArray2<f64>>; 4], [usize; 3]);

/// Where the fate of each member goes, a row each: status, stranding time and place, positions of
/// the kept members (which come first, and may be fewer), entry time of each target.
type Fates<'py> = (
    PyReadwriteArray1<'py, i8>,
    PyReadwriteArray1<'py, f64>,
    PyReadwriteArray2<'py, f64>,
    PyReadwriteArray3<'py, f64>,
    PyReadwriteArray2<'py, f64>,
);

/// Compiled core of driftcore.
#[pymodule]
mod _core {
    #[pymodule_export]
    use super::{
        Bootstrap, Coast, FieldWinds, Fleet, HandOver, Maps, Particles, Scenario, Sea, Solver,
        WindGenerator, WindPath, WindPaths,
    };

    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");
}
