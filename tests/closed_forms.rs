//! The core against answers known in closed form: bounds, splines, coasts, counts, wind paths.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on must fail")]

use std::f64::consts::{PI, TAU};
use std::ops::ControlFlow;
use std::sync::Arc;

use driftcore::coast::{Coast, Side};
use driftcore::dopri5::{Options, Step, Work, euler, integrate};
use driftcore::ensemble::{Ensemble, Scenario, Status, Winds};
use driftcore::error::DriftError;
use driftcore::field::academic::{AcademicSea, SeparableCurrent};
use driftcore::field::gridded::{Axis, GriddedSea, Tide};
use driftcore::field::{FieldBounds, Harmonics, SeaField, Vec2, in_phase, phasors, real};
use driftcore::model::lanes::{Carrier, Grid, State};
use driftcore::model::{Formulation, Model, Piece, Problem, Reach, Solver};
use driftcore::wind::bootstrap::{Bootstrap, Catalogue};
use driftcore::wind::lanes::{LaneWind, WindPaths};
use driftcore::wind::path::WindPath;
use driftcore::wind::small_scale::SmallScale;
use driftcore::wind::{Sampling, WindGenerator, sample};
use nalgebra::Vector1;
use num_complex::Complex64;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

fn solver(model: Model) -> Solver {
    Solver { model, rtol: 1e-11, atol: 1e-11, euler_step: None }
}

fn steady(wind: Vec2) -> WindPath {
    WindPath::new(vec![-4.0, 4.0], vec![wind; 2]).unwrap()
}

const MODELS: [Model; 6] = [
    Model::Full(Formulation::A),
    Model::Full(Formulation::B),
    Model::MeanFlow { order: 1 },
    Model::MeanFlow { order: 2 },
    Model::Paper { order: 0, window: 0.3, wind_terms: true },
    Model::Paper { order: 1, window: 0.3, wind_terms: true },
];

// Reach

/// A sea at rest that claims to know no more of itself than its bounds.
struct Bounded {
    bounds: FieldBounds,
}

impl SeaField for Bounded {
    fn period(&self) -> f64 {
        PI // ω = 2
    }
    fn velocity(&self, _: f64, _: Vec2) -> Result<Vec2, DriftError> {
        Ok(Vec2::zeros())
    }
    fn harmonics(&self, _: f64, _: Vec2, out: &mut Harmonics) -> Result<(), DriftError> {
        *out = Harmonics::default();
        Ok(())
    }
    fn bounds(&self, _: Vec2, _: f64) -> FieldBounds {
        self.bounds
    }
}

/// The table under equations.md (7). The body moves with a steady wind `s`, so
/// `P = x + st − Λst²/2` in the full and the mean-flow model and `Y⁰ = x + st` in the paper's, and
/// every sum of the table is known.
#[test]
fn reach_is_that_of_the_table() {
    let (tide, gradient, rate, residual) = (3.0, 2.0, 5.0, 7.0);
    let sea = Bounded { bounds: FieldBounds { tide, gradient, rate, residual } };
    let (omega, drag) = (2.0, 1.7);
    let (position, velocity) = (Vec2::new(0.8, -0.6), Vec2::new(0.3, 0.4));
    let (wind, s) = (steady(velocity), velocity.norm());
    for model in MODELS {
        let problem = Problem { sea: &sea, wind: &wind, drag, duration: 2.0, position, velocity };
        let mut count = 0;
        let run = solver(model).follow(problem, &mut |piece| {
            let (t, end) = piece.span();
            let h = end - t;
            let blown = drag * (s * t + h * s);
            let r0 = s * h * (1.0 - drag * t).abs() + drag * s * h * h / 2.0 + h * blown;
            let s0 = s * (1.0 - drag * t).abs() + drag * s * h + blown;
            let first = (r0 + tide / omega, s0 + tide + (rate + gradient * s0) / omega);
            let (radius, speed) = match model {
                Model::Full(_) => (r0, s0),
                Model::MeanFlow { order: 1 } => first,
                Model::MeanFlow { .. } => {
                    let f = s0 + gradient * tide / (2.0 * omega) + residual;
                    let b2 = ((gradient + drag) * tide / omega
                        + residual
                        + (rate + gradient * f) / omega)
                        / omega;
                    (first.0 + b2, first.1 + 8.0 * omega * b2)
                }
                Model::Paper { order: 0, .. } => (s * h, s),
                Model::Paper { .. } => {
                    (s * h + 2.0 * tide / omega, s + tide + 2.0 * (rate + gradient * s) / omega)
                }
            };
            let Reach { center, radius: found_radius, speed: found_speed } = piece.reach();
            let place = position + velocity * t;
            assert!((center - place).norm() < 1e-9, "{model:?} at {t}: {center}");
            assert!((found_radius - radius).abs() < 1e-6, "{model:?}: {found_radius}, {radius}");
            assert!((found_speed - speed).abs() < 1e-6, "{model:?}: {found_speed}, {speed}");
            count += 1;
            Ok(ControlFlow::Continue(()))
        });
        assert!(run.is_ok_and(|work| work.accepted == count) && count > 0, "{model:?}");
    }
}

/// The same table for members side by side, whose sums are of the components' magnitudes.
#[test]
fn lanes_reach_as_far_as_the_table_says() {
    let zero = FieldBounds { tide: 0.0, gradient: 0.0, rate: 0.0, residual: 0.0 };
    let sea = Bounded { bounds: zero };
    let (position, velocity, drag) = (Vec2::new(0.8, -0.6), Vec2::new(0.3, -0.4), 1.7);
    let s = velocity.x.abs() + velocity.y.abs();
    let wind = steady(velocity);
    let problem = Problem { sea: &sea, wind: &wind, drag, duration: 2.0, position, velocity };
    let paths = WindPaths::new(-0.3, 0.7, [3, 5], |_, _| velocity).unwrap();
    for carrier in [Carrier::Velocity, Carrier::MeanDrift] {
        let grid = Grid::new(carrier, &sea, 2.0, drag, (0.01, 1)).unwrap();
        assert_eq!(grid.steps(), 64);
        for last in [0, 1, 7, 40, 63] {
            let (t, end) = grid.span(last);
            let h = end - t;
            let lanes = LaneWind::in_memory(&paths, 0);
            let mut state = State::new(&grid, &problem, position).unwrap();
            let steps = 0..last + 1;
            let stepped = state.advance(&grid, &sea, &lanes, steps, Some((1e-9, 1e-9)), true);
            let Reach { center, radius, speed } = stepped.reach.unwrap().of(2);
            let blown = drag * (s * t + h * s);
            let moved = s * h * (1.0 - drag * t).abs() + drag * s * h * h / 2.0;
            assert!((center - position - velocity * t).norm() < 1e-9, "at {t}: {center}");
            assert!((radius - moved - h * blown).abs() < 1e-6, "at {t}: {radius}");
            let fastest = s * (1.0 - drag * t).abs() + drag * s * h + blown;
            assert!((speed - fastest).abs() < 1e-6, "at {t}: {speed}");
            assert!(!state.failed(2));
        }
    }
}

// Trajectories

/// The slow velocity that a model gives is the derivative of its slow position, and the velocity
/// of the reconstruction that of the position up to the order of the expansion; outputs come at
/// the times asked for, and the full model has no slow part.
#[test]
fn slow_velocity_is_the_derivative_of_the_slow_position() {
    let period = 0.02;
    let sea: Arc<dyn SeaField> = Arc::new(AcademicSea::paper(period).unwrap());
    let scenario = Scenario {
        sea,
        coast: None,
        drag: 1.7,
        duration: 1.0,
        position: Vec2::new(0.9, 1.1),
        velocity: Vec2::new(0.2, -0.1),
    };
    let times: Vec<f64> = (0..120).map(|k| -3.0 + 0.06 * f64::from(k)).collect();
    let velocity = times.iter().map(|t| Vec2::new((5.0 * t).sin(), 0.7 * (3.0 * t).cos()));
    let wind = WindPath::new(times.clone(), velocity.collect()).unwrap();
    let d = 1e-4;
    let outputs: Vec<f64> =
        (0..20).flat_map(|k| [0.0, d, 2.0 * d].map(|s| 0.011 + 0.049 * f64::from(k) + s)).collect();
    for model in [
        Model::MeanFlow { order: 1 },
        Model::MeanFlow { order: 2 },
        Model::Paper { order: 1, window: period / 2.0, wind_terms: false },
        Model::Full(Formulation::B),
    ] {
        let found = scenario.trajectory(&wind, &solver(model), &outputs).unwrap();
        assert_eq!((found.position.len(), found.velocity.len()), (60, 60));
        assert!(found.work.accepted > 0 && found.work.evaluations > 6 * found.work.accepted);
        for (x, v) in found.position.chunks(3).zip(found.velocity.chunks(3)) {
            // Exact for the full model; the expansions' velocity has their own error, O(T).
            let tolerance = if matches!(model, Model::Full(_)) { 1e-2 } else { 0.2 };
            assert!(((x[2] - x[0]) / (2.0 * d) - v[1]).norm() < tolerance, "{model:?}");
        }
        if matches!(model, Model::Full(_)) {
            assert!(found.mean.is_empty());
            continue;
        }
        assert_eq!(found.mean.len(), 60);
        for mean in found.mean.chunks(3) {
            let slope = (mean[2].0 - mean[0].0) / (2.0 * d);
            let slow_only = matches!(model, Model::Paper { .. });
            // u₁ is the paper's slow velocity; Y′ differs from U⁰ + u₁ by drifts of O(T).
            let tolerance = if slow_only { 20.0 * period } else { 1e-6 };
            assert!((slope - mean[1].1).norm() < tolerance, "{model:?}: {slope} {}", mean[1].1);
        }
    }
}

/// In a wind `W = ct` over a sea at rest the paper's system has a closed solution. The window's mean
/// is the wind itself, `T·B_W = −c(t − nT)²/2` since the tide began, `T⟨B_W⟩ = −cT²/6` and
/// `⟨∂ₜB_W⟩ = 0`, so that `y₁ = −(cT²/6)(1 − e^{−Λt})` and `u₁ = −Λy₁`.
#[test]
fn wind_terms_of_a_growing_wind() {
    let (period, drag, c) = (0.3, 1.7, Vec2::new(2.0, -0.7));
    let still = SeparableCurrent {
        mean: 0.0,
        modulation: 0.0,
        cycles: 0.0,
        phase: 0.0,
        axis: 0,
        sines: vec![Vec2::new(1.0, 1.0)],
    };
    let scenario = Scenario {
        sea: Arc::new(AcademicSea::new(period, still.clone(), still, 1.0).unwrap()),
        coast: None,
        drag,
        duration: 1.0,
        position: Vec2::new(0.3, -0.2),
        velocity: Vec2::new(-0.4, 0.9),
    };
    let wind = WindPath::new(vec![-3.0, 4.0], vec![c * -3.0, c * 4.0]).unwrap();
    let times: Vec<f64> = (0..=50).map(|k| 0.02 * f64::from(k)).collect();
    let model = Model::Paper { order: 1, window: 0.11, wind_terms: true };
    let found = scenario.trajectory(&wind, &solver(model), &times).unwrap();
    for (k, t) in times.iter().enumerate() {
        let left = (-drag * t).exp();
        let past = (scenario.velocity + c / drag) * left;
        let y0 = scenario.position
            + c * (t * t / 2.0 - t / drag)
            + (scenario.velocity + c / drag) * ((1.0 - left) / drag);
        let y1 = -c * (period * period / 6.0 * (1.0 - left));
        assert!((found.position[k] - y0 - y1).norm() < 1e-9, "position at {t}");
        let since = t - (t / period + 1e-9).floor() * period;
        let velocity = c * (t - 1.0 / drag) + past - y1 * drag - c * (drag * since * since / 2.0);
        assert!((found.velocity[k] - velocity).norm() < 1e-9, "velocity at {t}");
    }
}

/// Only the paper's model looks beyond the run: half a window at both ends, and with the terms
/// `B_W` the means of a tide, from the tide before the release to half a tide after the end.
#[test]
fn wind_is_needed_as_far_as_the_means_reach() {
    let needed = |model| solver(model).wind_needed(3.0, 0.5);
    assert_eq!(needed(Model::Full(Formulation::A)), (0.0, 3.0));
    assert_eq!(needed(Model::MeanFlow { order: 2 }), (0.0, 3.0));
    let paper = |order, wind_terms| needed(Model::Paper { order, window: 0.2, wind_terms });
    assert_eq!(paper(1, true), (-0.6, 3.35));
    assert_eq!(paper(1, false), (-0.1, 3.1));
    assert_eq!(paper(0, true), (-0.1, 3.1));
}

// Dormand–Prince and Euler

fn decay(_: f64, y: &Vector1<f64>) -> Result<Vector1<f64>, DriftError> {
    Ok(-y * 50.0)
}

/// Seven stages, the last of which is the first of the next step: one evaluation and six a trial,
/// rejected ones included; and every trial step that is too long is rejected.
#[test]
fn work_is_counted() {
    let options = Options { rtol: 1e-8, atol: 1e-8, max_step: 1.0, first_step: Some(1.0) };
    let (mut evaluations, mut accepted) = (0, 0);
    let (work, next) = integrate(
        |t, y| {
            evaluations += 1;
            decay(t, y)
        },
        (0.0, 2.0),
        Vector1::new(1.0),
        options,
        |_| {
            accepted += 1;
            Ok(ControlFlow::Continue(()))
        },
    )
    .unwrap();
    assert!(work.rejected >= 3, "{work:?}");
    assert_eq!(work.accepted, accepted);
    assert_eq!(work.evaluations, evaluations);
    assert_eq!(work.evaluations, 1 + 6 * (work.accepted + work.rejected));
    assert!(next > 0.0 && next <= 1.0);
}

/// Steps join without a gap, none exceeds the limit, and the last one ends exactly at the end.
#[test]
fn steps_join_and_land() {
    let options = Options { rtol: 1e-6, atol: 1e-6, max_step: 0.07, first_step: None };
    let (mut end, mut state) = (0.25, Vector1::new(1.0));
    let run = integrate(
        |_, y| Ok(-y),
        (0.25, 1.2),
        state,
        options,
        |step: &Step<1>| {
            assert_eq!((step.t, step.y), (end, state));
            assert!(step.h > 0.0 && step.h <= 0.07 + 1e-12);
            assert!((step.state(step.end) - step.y_end).norm() < 1e-14);
            (end, state) = (step.end, step.y_end);
            Ok(ControlFlow::Continue(()))
        },
    );
    assert!(run.is_ok());
    assert_eq!(end, 1.2);
    assert!((state.x - (-0.95f64).exp()).abs() < 1e-6);
}

/// Where the limit rules, every step has it but the last two, which share what is left so that no
/// sliver remains; where the tolerance rules, the first step estimated from the slope is accepted.
#[test]
fn steps_are_chosen_with_care() {
    let options = Options { rtol: 1e-6, atol: 1e-6, max_step: 0.07, first_step: Some(0.07) };
    let mut lengths = Vec::new();
    let span = (0.25, 0.25 + 10.0 * 0.07 + 0.01);
    let run = integrate(
        |_, y: &Vector1<f64>| Ok(-y),
        span,
        Vector1::new(1.0),
        options,
        |step| {
            lengths.push(step.h);
            Ok(ControlFlow::Continue(()))
        },
    );
    assert!(run.is_ok_and(|(work, _)| work.rejected == 0));
    assert_eq!(lengths.len(), 11);
    for (k, h) in lengths.iter().enumerate() {
        let expected = if k < 9 { 0.07 } else { 0.04 };
        assert!((h - expected).abs() < 1e-12, "step {k}: {h}");
    }

    for rate in [1e-3, 1.0, 1e3] {
        let free = Options { rtol: 1e-8, atol: 1e-8, max_step: 1e9, first_step: None };
        let mut first = None;
        let run = integrate(
            |t, y: &Vector1<f64>| Ok(y * (-rate * (1.0 + 0.5 * (rate * t).sin()))),
            (0.0, 20.0 / rate),
            Vector1::new(1.0),
            free,
            |step| {
                first.get_or_insert(step.h * rate);
                Ok(ControlFlow::Continue(()))
            },
        );
        let (work, _) = run.unwrap();
        assert!(first.is_some_and(|h| h > 1e-4 && h < 0.1), "{first:?}");
        assert!(work.rejected <= 3 && work.accepted < 200, "{work:?}");
    }
    // A step that the end cuts short says little about the next one.
    let long = Options { rtol: 1e-6, atol: 1e-6, max_step: 9.0, first_step: Some(0.3) };
    let (_, next) = integrate(
        |_, y: &Vector1<f64>| Ok(-y),
        (0.0, 1e-3),
        Vector1::new(1.0),
        long,
        |_| Ok(ControlFlow::Continue(())),
    )
    .unwrap();
    assert_eq!(next, 0.3);
    // Without a slope nothing forbids to cross the span at once.
    let rest = Options { rtol: 1e-8, atol: 1e-8, max_step: 1e9, first_step: None };
    let run = integrate(
        |_, _: &Vector1<f64>| Ok(Vector1::zeros()),
        (0.0, 5.0),
        Vector1::new(1.0),
        rest,
        |_| Ok(ControlFlow::Continue(())),
    );
    assert!(run.is_ok_and(|(work, _)| work.accepted == 1));
}

/// In a sea at rest and a steady wind nothing but its limit holds a step back: a tenth of a tide
/// in the full model, a tide in the averaged ones, less where the means of the wind jump.
#[test]
fn steps_are_limited_by_the_tide() {
    let sea = Bounded { bounds: FieldBounds::default() };
    let velocity = Vec2::new(0.3, 0.4);
    let wind = WindPath::new(vec![-9.0, 99.0], vec![velocity; 2]).unwrap();
    for model in MODELS {
        let problem = Problem {
            sea: &sea,
            wind: &wind,
            drag: 1e-3,
            duration: 40.0,
            position: Vec2::zeros(),
            velocity,
        };
        let mut longest: f64 = 0.0;
        let run = solver(model).follow(problem, &mut |piece| {
            longest = longest.max(piece.span().1 - piece.span().0);
            Ok(ControlFlow::Continue(()))
        });
        assert!(run.is_ok());
        let tides = match model {
            Model::Full(_) => 0.1,
            Model::Paper { .. } | Model::MeanFlow { .. } => 1.0,
        };
        let limit = tides * PI;
        assert!((longest - limit).abs() < 1e-9, "{model:?}: {longest}");
    }
}

/// What is not finite ends a run with an error; a run may be stopped from outside.
#[test]
fn runs_end_as_they_must() {
    let options = Options { rtol: 1e-6, atol: 1e-6, max_step: 1.0, first_step: None };
    let go_on = |_: &Step<1>| Ok(ControlFlow::Continue(()));
    for beyond in [f64::NAN, f64::INFINITY] {
        let broken =
            |t: f64, _: &Vector1<f64>| Ok(Vector1::new(if t < 0.5 { 1.0 } else { beyond }));
        let finite = |step: &Step<1>| {
            assert!(step.y_end.x.is_finite() && step.end < 0.5);
            Ok(ControlFlow::Continue(()))
        };
        let run = integrate(broken, (0.0, 2.0), Vector1::new(0.0), options, finite);
        assert!(matches!(run, Err(DriftError::Integration { t, .. }) if t < 0.5), "{run:?}");
        let run = euler(broken, (0.0, 2.0), Vector1::new(0.0), 0.25, go_on);
        assert!(matches!(run, Err(DriftError::Integration { t, .. }) if t == 0.5));
    }

    let mut seen = 0;
    let stop = |_: &Step<1>| {
        seen += 1;
        Ok(if seen == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    };
    let work = euler(decay, (0.0, 1.0), Vector1::new(1.0), 0.01, stop).unwrap();
    assert_eq!(work, Work { accepted: 3, rejected: 0, evaluations: 3 });
    for bad in [
        Options { rtol: 0.0, ..options },
        Options { atol: -1.0, ..options },
        Options { max_step: f64::NAN, ..options },
        Options { first_step: Some(0.0), ..options },
    ] {
        assert!(integrate(decay, (0.0, 1.0), Vector1::new(1.0), bad, go_on).is_err(), "{bad:?}");
    }
}

/// Euler's steps are equal and no longer than asked: `y = (1 − λh)ⁿ`.
#[test]
fn euler_takes_equal_steps() {
    for (step, count) in [(0.3, 4), (0.25, 4), (0.1, 10), (5.0, 1)] {
        let mut last = (0, 0.0, 0.0);
        let work = euler(
            |_, y: &Vector1<f64>| Ok(-y * 0.5),
            (2.0, 3.0),
            Vector1::new(1.0),
            step,
            |step| {
                last = (last.0 + 1, step.end, step.y_end.x);
                let (t, half) = (step.t + step.h / 2.0, step.y + (step.y_end - step.y) / 2.0);
                assert!((step.state(t) - half).norm() < 1e-14);
                Ok(ControlFlow::Continue(()))
            },
        )
        .unwrap();
        assert_eq!((work.accepted, last.0, last.1), (count, count, 3.0));
        let exact = (1.0 - 0.5 / count as f64).powi(count as i32);
        assert!((last.2 - exact).abs() < 1e-14, "{step}: {}", last.2);
    }
}

// Coasts

/// A convex polygon without an edge along an axis: inside, the distance to the coast line is the
/// least of those to the lines of the edges; outside, the least of those to the edges.
#[test]
fn clearance_from_slanted_edges() {
    let corners = [(2.0, 0.3), (0.4, 1.9), (-1.6, 0.9), (-1.1, -1.3), (0.9, -1.7)]
        .map(|(x, y)| Vec2::new(x, y));
    let coast = Coast::polygons(&[corners.to_vec()], Side::Inside).unwrap();
    let (mut inside, mut outside) = (0, 0);
    for i in 0..41 {
        for j in 0..41 {
            let x = Vec2::new(-2.5 + 0.13 * f64::from(i), -2.5 + 0.127 * f64::from(j));
            let (mut to_line, mut to_edge) = (f64::INFINITY, f64::INFINITY);
            for k in 0..5 {
                let (from, along) = (corners[k], corners[(k + 1) % 5] - corners[k]);
                let place = ((x - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
                to_edge = to_edge.min((x - from - along * place).norm());
                to_line = to_line.min(along.perp(&(x - from)) / along.norm());
            }
            let expected = if to_line > 0.0 { to_line } else { -to_edge };
            let count = if to_line > 0.0 { &mut inside } else { &mut outside };
            *count += 1;
            let found = coast.clearance(x);
            assert!((found - expected).abs() < 1e-12, "{x}: {found}, expected {expected}");
        }
    }
    assert!(inside > 300 && outside > 300);
}

#[test]
fn broken_coasts_are_refused() {
    for center in [Vec2::new(f64::NAN, 0.0), Vec2::new(0.0, f64::INFINITY)] {
        assert!(Coast::circle(center, 1.0, Side::Inside).is_err());
    }
    for radius in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(Coast::circle(Vec2::zeros(), radius, Side::Inside).is_err());
    }
    let (a, b, c) = (Vec2::zeros(), Vec2::new(1.0, 0.0), Vec2::new(0.0, 1.0));
    for bad in [vec![], vec![a], vec![a, a, a], vec![a, b, a], vec![a, b, Vec2::new(f64::NAN, 1.0)]]
    {
        assert!(Coast::polygons(&[vec![a, b, c], bad], Side::Inside).is_err());
    }
    // A ring that its file has closed is the ring that is closed here.
    let closed = Coast::polygons(&[vec![a, b, b, c, a]], Side::Inside).unwrap();
    assert_eq!(closed.clearance(Vec2::new(0.25, 0.25)), 0.25);
}

/// Motion along the x axis at an even speed, with a generous bound of it.
struct Straight {
    span: (f64, f64),
    start: f64,
    speed: f64,
}

impl Piece for Straight {
    fn span(&self) -> (f64, f64) {
        self.span
    }
    fn position(&self, t: f64) -> Result<Vec2, DriftError> {
        Ok(Vec2::new(self.start + self.speed * (t - self.span.0), 0.0))
    }
    fn velocity(&self, _: f64) -> Result<Vec2, DriftError> {
        Ok(Vec2::new(self.speed, 0.0))
    }
    fn mean(&self, _: f64) -> Result<Option<(Vec2, Vec2)>, DriftError> {
        Ok(None)
    }
    fn reach(&self) -> Reach {
        let radius = self.speed * (self.span.1 - self.span.0);
        Reach { center: Vec2::new(self.start, 0.0), radius, speed: 1.5 * self.speed }
    }
}

/// A crossing is found to rounding, also just after the release; and a piece that
/// ends before the coast has none.
#[test]
fn crossings_are_found_to_rounding() {
    let coast = Coast::circle(Vec2::zeros(), 1.0, Side::Inside).unwrap();
    for (span, until_shore) in [((0.0, 2e-8), 1e-8), ((0.0, 3.0), 1.25), ((7.0, 9.0), 0.125)] {
        let start = 1.0 - until_shore;
        let piece = Straight { span, start, speed: 1.0 };
        let (t, x) = coast.first_crossing(&piece, 0.1).unwrap().unwrap();
        let expected = span.0 + (1.0 - start);
        assert!((t - expected).abs() <= 4.0 * f64::EPSILON * expected.max(1.0), "{t} {expected}");
        assert!((x.norm() - 1.0).abs() <= 4.0 * f64::EPSILON);
        let end = span.0 + 0.9 * until_shore;
        let short = Straight { span: (span.0, end), start, speed: 1.0 };
        assert_eq!(coast.first_crossing(&short, 0.1).unwrap(), None);
    }
}

/// Strides are as long as the clearance and the bound of the speed allow, no longer: a swift body
/// does not jump over a narrow island, at whatever distance it starts.
#[test]
fn a_narrow_island_is_not_jumped_over() {
    let ring = [(0.0, -1.0), (0.1, -1.0), (0.1, 1.0), (0.0, 1.0)].map(|(x, y)| Vec2::new(x, y));
    let coast = Coast::polygons(&[ring.to_vec()], Side::Outside).unwrap();
    for (speed, distance) in [(5.0, 3.0), (0.2, 0.7), (40.0, 11.0)] {
        let piece = Straight { span: (0.0, 2.0 * distance / speed), start: -distance, speed };
        // The island takes longer than T/128 to cross.
        let (t, x) = coast.first_crossing(&piece, 12.0 * 0.1 / speed).unwrap().unwrap();
        assert!((t - distance / speed).abs() < 1e-13 * distance && x.x.abs() < 1e-13 * distance);
    }
}

// Seas

/// The paper's section 4.1, written out.
#[test]
fn academic_sea_is_that_of_the_paper() {
    let epsilon = 0.03;
    let sea = AcademicSea::paper(epsilon).unwrap();
    assert_eq!(sea.period(), epsilon);
    let mut out = Harmonics::default();
    for k in 0..60 {
        let (t, x) = (0.0171 * f64::from(k), Vec2::new(1.2 - 0.03 * f64::from(k), 0.7));
        let theta = TAU * t / epsilon;
        let m = x.x
            * (2.0 + (3.0 * TAU * t).sin())
            * Vec2::new(theta.sin() + 0.25 * (2.0 * theta).sin(), 0.5 * theta.sin());
        let n = x.y * (2.0 + (3.0 * TAU * t).cos()) * Vec2::new(1.0, 1.0) * theta.sin();
        assert!((sea.velocity(t, x).unwrap() - m - n * epsilon).norm() < 1e-12);
        sea.harmonics(t, x, &mut out).unwrap();
        // ∂ₜ and ∇ of the amplitude −i s x₁(2 + sin 6πt).
        let modulation = 2.0 + (3.0 * TAU * t).sin();
        let rate = 3.0 * TAU * (3.0 * TAU * t).cos();
        for (harmonic, s) in out.tide.iter().zip([Vec2::new(1.0, 0.5), Vec2::new(0.25, 0.0)]) {
            for c in 0..2 {
                assert!((harmonic.rate[c].im + s[c] * x.x * rate).abs() < 1e-12);
                assert!((harmonic.gradient[(c, 0)].im + s[c] * modulation).abs() < 1e-12);
                assert_eq!(harmonic.gradient[(c, 1)].norm(), 0.0);
            }
        }
    }
    // In a ball of radius 0.2 about (1, 2): Σ|s_j| = √1.25 + ¼, |x₁| ≤ 1.2, |x₂| ≤ 2.2.
    let bounds = sea.bounds(Vec2::new(-1.0, 2.0), 0.2);
    let waves = 1.25f64.sqrt() + 0.25;
    assert!((bounds.tide - waves * 3.0 * 1.2).abs() < 1e-12);
    assert!((bounds.gradient - waves * 3.0).abs() < 1e-12);
    assert!((bounds.rate - waves * 3.0 * TAU * 1.2).abs() < 1e-12);
    assert!((bounds.residual - 2f64.sqrt() * 3.0 * 2.2 * epsilon).abs() < 1e-12);
}

/// Amplitudes cubic in x, quadratic in y and linear in t: cubic splines hold them exactly, with
/// coefficients `x³ − h²x`, `y² − h²/3` and `t` at the nodes.
#[test]
fn splines_reproduce_cubics() {
    let x = Axis { start: -1.0, step: 0.25, count: 9 };
    let y = Axis { start: 0.5, step: 0.5, count: 5 };
    let time = Axis { start: -0.5, step: 0.4, count: 6 };
    let node = |axis: Axis, i: usize| axis.start + (i as f64 - 1.0) * axis.step;
    // Tide: (u, v) = ((1 + 2i) f, i f) with f = (x³ + 2)(y² − y)(1 + t); residual mean f, −f.
    let channels = [(1.0, 2.0), (0.0, 1.0), (1.0, 0.0), (-1.0, 0.0)];
    let channels = channels.map(|(re, im)| Complex64::new(re, im));
    let mut coefficients = Vec::new();
    for it in 0..8 {
        for iy in 0..7 {
            for ix in 0..11 {
                let (t, b, a) = (node(time, it), node(y, iy), node(x, ix));
                let cubic = a.powi(3) - x.step * x.step * a + 2.0;
                let square = b * b - y.step * y.step / 3.0 - b;
                coefficients.extend(channels.map(|c| c * cubic * square * (1.0 + t)));
            }
        }
    }
    let sea = GriddedSea::new(0.7, [x, y, time], Tide::Harmonics(1), 4, coefficients).unwrap();
    let mut out = Harmonics::default();
    for k in 0..60 {
        let part = |stride: f64| (stride * f64::from(k)).fract();
        let at = Vec2::new(-1.0 + 2.0 * part(0.377), 0.5 + 2.0 * part(0.211));
        let t = -0.5 + 2.0 * part(0.59);
        let (f, fx, fxx) = (at.x.powi(3) + 2.0, 3.0 * at.x * at.x, 6.0 * at.x);
        let (g, gy, gyy) = (at.y * at.y - at.y, 2.0 * at.y - 1.0, 2.0);
        let s = 1.0 + t;
        sea.harmonics(t, at, &mut out).unwrap();
        for (harmonic, parts) in [(&out.tide[0], 0), (&out.residual[0], 2)] {
            for c in 0..2 {
                let z = channels[parts + c];
                let near = |found: Complex64, expected: f64| {
                    assert!((found - z * expected).norm() < 1e-11, "{at} {t}: {found} {expected}");
                };
                near(harmonic.amplitude[c], f * g * s);
                near(harmonic.rate[c], f * g);
                near(harmonic.gradient[(c, 0)], fx * g * s);
                near(harmonic.gradient[(c, 1)], f * gy * s);
                near(harmonic.hessian[c][(0, 0)], fxx * g * s);
                near(harmonic.hessian[c][(1, 1)], f * gyy * s);
                near(harmonic.hessian[c][(0, 1)], fx * gy * s);
                near(harmonic.hessian[c][(1, 0)], fx * gy * s);
            }
        }
        let phasor = phasors(sea.omega() * t).next().unwrap();
        let velocity = in_phase(out.tide[0].amplitude, phasor) + real(out.residual[0].amplitude);
        assert!((sea.velocity(t, at).unwrap() - velocity).norm() < 1e-11);
    }
}

/// One coefficient alone is one B-spline: the cube `u³/6` in its first cell, nothing before it.
/// (A polynomial all over the grid would not tell in which cell it is evaluated.)
#[test]
fn splines_are_local() {
    let x = Axis { start: 0.0, step: 0.5, count: 9 };
    let constant = Axis { start: 0.0, step: 1.0, count: 1 };
    for last in 3..=10 {
        let coefficients = (0..11)
            .flat_map(|k| [Complex64::from(f64::from(u8::from(k == last))), Complex64::from(0.0)]);
        let sea = GriddedSea::new(
            1.0,
            [x, constant, constant],
            Tide::Harmonics(0),
            2,
            coefficients.collect(),
        )
        .unwrap();
        for place in [0.3, 0.9, 1.4, 2.2, 3.7, 4.5, 5.1, 6.6, 7.2, 7.9] {
            let into = place - (last as f64 - 3.0);
            let found = sea.velocity(0.0, Vec2::new(0.5 * place, 7.0)).unwrap();
            if into <= 1.0 {
                let expected = into.max(0.0).powi(3) / 6.0;
                assert!((found.x - expected).abs() < 1e-14, "{last}, {place}: {found}");
            } else {
                assert!(into >= 4.0 || found.x > 0.0, "{last}, {place}: {found}");
            }
        }
    }
}

/// A tide `z₀ + gx + ky` that grows as `1 + rt`: its bounds are those of the nodes that can
/// matter, and exact where they are sums of differences.
#[test]
fn bounds_of_a_linear_tide() {
    let (g, k, r) = (0.7, 0.2, 0.3);
    let axis = |step, count| Axis { start: 0.0, step, count };
    let (x, y, time) = (axis(1.0, 10), axis(2.0, 6), axis(0.5, 4));
    let mut coefficients = Vec::new();
    for it in 0..6 {
        for iy in 0..8 {
            for ix in 0..12 {
                let node = |axis: Axis, i: i32| axis.step * (f64::from(i) - 1.0);
                let (t, y, x) = (node(time, it), node(y, iy), node(x, ix));
                let z = Complex64::new(0.0, (2.0 + g * x + k * y) * (1.0 + r * t));
                // The residual has a mean and one harmonic.
                let (mean, none) = (Complex64::new(0.1, 0.0), Complex64::new(0.0, 0.0));
                coefficients.extend([z * 0.6, z * 0.8, mean, none, none, mean]);
            }
        }
    }
    let sea = GriddedSea::new(0.1, [x, y, time], Tide::Harmonics(1), 6, coefficients).unwrap();
    // Within 0.2 of (4.5, 5) only one cell matters: nodes 3 to 6 and 2 to 8, times to 2.
    let bounds = sea.bounds(Vec2::new(4.5, 5.0), 0.2);
    let largest = 2.0 + 6.0 * g + 8.0 * k;
    assert!((bounds.tide - largest * (1.0 + 2.0 * r)).abs() < 1e-12);
    assert!((bounds.gradient - (g + k) * (1.0 + 2.0 * r)).abs() < 1e-12);
    assert!((bounds.rate - largest * r).abs() < 1e-12);
    assert!((bounds.residual - 0.2).abs() < 1e-12);
    // The ball reaches over a grid line of x: one node more.
    let wider = sea.bounds(Vec2::new(4.5, 5.0), 0.6);
    assert!((wider.tide - (largest + g) * (1.0 + 2.0 * r)).abs() < 1e-12);
    for (x, y, inside) in
        [(9.0, 10.0, true), (9.1, 5.0, false), (-0.1, 5.0, false), (4.0, 10.1, false)]
    {
        assert_eq!(sea.velocity(0.1, Vec2::new(x, y)).is_ok(), inside, "({x}, {y})");
    }
}

/// An axis of one point is constant and has no end.
#[test]
fn a_sea_of_one_row() {
    let (x, one) =
        (Axis { start: 0.0, step: 1.0, count: 4 }, Axis { start: 0.0, step: 1.0, count: 1 });
    let row = (-1..=4).flat_map(|i| [f64::from(i), 1.0].map(Complex64::from));
    let sea = GriddedSea::new(1.0, [x, one, one], Tide::Harmonics(1), 2, row.collect()).unwrap();
    for y in [0.0, 1e6, -1e6] {
        // Re[Z e^{iωt}] at t = 1/6, cos ωt = ½.
        let velocity = sea.velocity(1.0 / 6.0, Vec2::new(1.7, y)).unwrap();
        assert!((velocity - Vec2::new(0.85, 0.5)).norm() < 1e-12);
    }
    let bounds = sea.bounds(Vec2::new(1.5, 1e6), 0.1);
    assert!((bounds.tide - 10f64.sqrt()).abs() < 1e-12 && (bounds.gradient - 1.0).abs() < 1e-12);
    assert_eq!((bounds.rate, bounds.residual), (0.0, 0.0));
}

#[test]
fn broken_seas_are_refused() {
    let axis = |count| Axis { start: 0.0, step: 0.5, count };
    let zeros = |n| vec![Complex64::new(0.0, 0.0); n];
    let sea = |x, tides, channels, coefficients| {
        GriddedSea::new(1.0, [x, axis(1), axis(1)], Tide::Harmonics(tides), channels, coefficients)
    };
    assert!(sea(axis(4), 1, 4, zeros(24)).is_ok());
    assert!(sea(axis(4), 2, 4, zeros(24)).is_ok());
    assert!(sea(axis(3), 1, 4, zeros(20)).is_err());
    assert!(sea(axis(0), 1, 4, zeros(8)).is_err());
    assert!(sea(axis(4), 1, 3, zeros(18)).is_err());
    assert!(sea(axis(4), 3, 4, zeros(24)).is_err());
    assert!(sea(axis(4), 1, 4, zeros(23)).is_err());
    assert!(sea(Axis { step: 0.0, ..axis(4) }, 1, 4, zeros(24)).is_err());
    let mut bad = zeros(24);
    bad[17] = Complex64::new(0.0, f64::NAN);
    assert!(sea(axis(4), 1, 4, bad).is_err());
    assert!(AcademicSea::paper(0.0).is_err());
    let current = SeparableCurrent {
        mean: 1.0,
        modulation: 0.0,
        cycles: 0.0,
        phase: 0.0,
        axis: 2,
        sines: vec![Vec2::new(1.0, 0.0)],
    };
    let good = SeparableCurrent { axis: 1, ..current.clone() };
    assert!(AcademicSea::new(0.1, good.clone(), good.clone(), 1.0).is_ok());
    assert!(AcademicSea::new(0.1, current.clone(), good.clone(), 1.0).is_err());
    assert!(AcademicSea::new(0.1, good, current, 1.0).is_err());
}

// Wind

/// A path must cover the run but for rounding in proportion to the run's length.
#[test]
fn a_path_covers_the_run_up_to_rounding() {
    let path = |start: f64, end: f64| {
        WindPath::new(vec![start, end], vec![Vec2::zeros(); 2]).unwrap().require(100.0, 1100.0)
    };
    assert!(path(100.0, 1100.0).is_ok());
    assert!(path(100.0 + 5e-7, 1100.0 - 5e-7).is_ok());
    assert!(path(100.0 + 5e-6, 1100.0).is_err());
    assert!(path(100.0, 1100.0 - 5e-6).is_err());
    assert!(path(50.0, 2000.0).is_ok());
}

/// Three rows of a record with two phases, of which each draw but one has no weight: the chain
/// goes round the record. With noise `B = 0` and no predictor the wind is cycle + successor.
fn round_robin() -> Bootstrap {
    Bootstrap::new(Catalogue {
        order: 1,
        states: vec![0.0, 0.0, 10.0, 0.0, 0.0, 10.0],
        whitening: vec![1.0, 0.0, 0.0, 1.0],
        target: vec![10.0, 0.0, 0.0, 10.0, 0.0, 0.0],
        predictor: vec![0.0; 6],
        noise: vec![0.0; 4],
        row: vec![1, 2, 3],
        phase: vec![1, 0, 1],
        start: vec![true, true, false],
        cycle: vec![0.5, -0.5, -1.0, 1.0],
        bandwidth: 0.1,
    })
    .unwrap()
}

#[test]
fn a_deterministic_record_is_replayed() {
    let bootstrap = round_robin();
    assert_eq!((bootstrap.phases(), bootstrap.catalogue().order), (2, 1));
    let anomaly = [Vec2::zeros(), Vec2::new(10.0, 0.0), Vec2::new(0.0, 10.0)];
    let cycle = [Vec2::new(0.5, -0.5), Vec2::new(-1.0, 1.0)];
    for (phase, first) in [(1, 0), (0, 1)] {
        let found = sample(&bootstrap, 3, 0..4, 7, Some(phase)).unwrap();
        assert_eq!((found.wind.len(), found.predecessor.len()), (28, 28));
        for (k, (wind, predecessor)) in found.wind.iter().zip(&found.predecessor).enumerate() {
            let step = k % 7;
            assert_eq!(*wind, anomaly[(first + step) % 3] + cycle[(phase + step) % 2]);
            // The record row before the one that the value stands in.
            let expected = if step == 0 { first } else { (first + step - 1) % 3 + 1 };
            assert_eq!(*predecessor, Some(expected));
        }
    }
    // Any start: both rows come up, the third never.
    let mut seen = [0; 3];
    for member in 0..60 {
        let wind = sample(&bootstrap, 3, member..member + 1, 1, None).unwrap().wind[0];
        let row = (0..2).find(|i| wind == anomaly[*i] + cycle[1 - *i]).unwrap();
        seen[row] += 1;
    }
    assert!(seen[0] > 15 && seen[1] > 15, "{seen:?}");
    assert!(sample(&bootstrap, 3, 0..1, 1, Some(2)).is_err());
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    assert!(bootstrap.draws_at(&[0.0], false, 1, &mut rng).is_err());
    for weigh_all in [false, true] {
        let drawn = bootstrap.draws_at(&[0.0, 9.0], weigh_all, 2, &mut rng).unwrap();
        assert_eq!(drawn, [3, 3]);
    }
}

/// A catalogue of one row leaves nothing to chance: `x_{k+1} = c + 2cos φ x_k − x_{k−1} + target`,
/// which swings about its fixed point, `x_k = x* + cos(kφ)` and `x* + sin(kψ)` from those states.
#[test]
fn one_row_is_a_linear_recurrence() {
    let (phi, psi) = (0.7f64, 1.3f64);
    let (c, target) = ([0.4, -0.2], [0.3, 0.9]);
    let fixed = Vec2::new(
        (c[0] + target[0]) / (2.0 - 2.0 * phi.cos()),
        (c[1] + target[1]) / (2.0 - 2.0 * psi.cos()),
    );
    let state = |k: f64| fixed + Vec2::new((k * phi).cos(), (k * psi).sin());
    let bootstrap = Bootstrap::new(Catalogue {
        order: 2,
        states: [state(0.0), state(-1.0)].iter().flatten().copied().collect(),
        whitening: (0..16).map(|k| if k % 5 == 0 { 1.0 } else { 0.1 }).collect(),
        target: target.to_vec(),
        predictor: vec![
            c[0],
            2.0 * phi.cos(),
            0.0,
            -1.0,
            0.0,
            c[1],
            0.0,
            2.0 * psi.cos(),
            0.0,
            -1.0,
        ],
        noise: vec![0.0; 4],
        row: vec![1],
        phase: vec![0],
        start: vec![true],
        cycle: vec![7.0, -8.0],
        bandwidth: 0.5,
    })
    .unwrap();
    let winds = sample(&bootstrap, 1, 0..1, 50, None).unwrap().wind;
    for (k, wind) in winds.iter().enumerate() {
        assert!((wind - state(k as f64) - Vec2::new(7.0, -8.0)).norm() < 1e-12, "step {k}");
    }
}

/// A catalogue of one row, without a predictor, gives white noise of covariance `BBᵀ`.
fn white(noise: [f64; 4]) -> Bootstrap {
    Bootstrap::new(Catalogue {
        order: 1,
        states: vec![0.0, 0.0],
        whitening: vec![1.0, 0.0, 0.0, 1.0],
        target: vec![0.0, 0.0],
        predictor: vec![0.0; 6],
        noise: noise.to_vec(),
        row: vec![1],
        phase: vec![0],
        start: vec![true],
        cycle: vec![0.0, 0.0],
        bandwidth: 0.5,
    })
    .unwrap()
}

/// 40,000 steps: standard errors of the moments below are at most 2/√40,000 of the variances'
/// geometric mean; the thresholds are about four of them.
#[test]
fn noise_has_its_covariance() {
    let bootstrap = white([0.6, 0.8, -0.3, 0.5]);
    let winds = sample(&bootstrap, 5, 0..1, 40_001, None).unwrap().wind;
    let mean = |f: &dyn Fn(usize) -> f64| (1..40_000).map(f).sum::<f64>() / 39_999.0;
    assert!((mean(&|k| winds[k].x * winds[k].x) - 1.0).abs() < 0.03);
    assert!((mean(&|k| winds[k].y * winds[k].y) - 0.34).abs() < 0.01);
    assert!((mean(&|k| winds[k].x * winds[k].y) - 0.22).abs() < 0.015);
    assert!(mean(&|k| winds[k].x).abs() < 0.02 && mean(&|k| winds[k].y).abs() < 0.012);
    assert!(mean(&|k| winds[k].x * winds[k + 1].x).abs() < 0.02);
}

/// No member's numbers are another's: where the small scale starts and what fills its first step,
/// and what the synoptic noise does, are uncorrelated between neighbouring members (one stream
/// taken for another's would give correlations of order 1; 4 sd of 3,000 members is 0.073).
#[test]
fn members_draw_from_streams_of_their_own() {
    let members = 3000;
    let features = |synoptic: f64, sd: f64| -> Vec<[f64; 3]> {
        let small_scale = SmallScale::new(sd, 1.0, 1.0, 2).unwrap();
        let bootstrap = Arc::new(white([synoptic, 0.0, 0.0, synoptic]));
        let generator = WindGenerator::new(bootstrap, small_scale, 1.0, 1.0, 0, None).unwrap();
        let knots = |member| generator.path(1, member, 1.0, Sampling::Fine).unwrap();
        (0..members + 4)
            .map(|member| {
                let path = knots(member);
                let w = path.knots();
                [w[0].x, w[1].x - (w[0].x + w[2].x) / 2.0, w[2].x]
            })
            .collect()
    };
    let (small, synoptic) = (features(0.0, 1.0), features(1.0, 0.0));
    let correlation = |f: &dyn Fn(usize) -> (f64, f64)| {
        let pairs: Vec<_> = (0..members as usize).map(f).collect();
        let sum = |g: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(g).sum::<f64>();
        sum(&|p| p.0 * p.1) / (sum(&|p| p.0 * p.0) * sum(&|p| p.1 * p.1)).sqrt()
    };
    for lag in 1..4 {
        for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1), (0, 2), (2, 0)] {
            let found = correlation(&|m| (small[m][i], small[m + lag][j]));
            assert!(found.abs() < 0.073, "small scale {i}, {j}, lag {lag}: {found}");
        }
        for i in [0, 1, 2] {
            let found = correlation(&|m| (small[m][i], synoptic[m + lag][2]));
            assert!(found.abs() < 0.073, "synoptic, {i}, lag {lag}: {found}");
        }
    }
}

/// A generator's path has the lead-in and as many steps as reach the end, no more: the record's
/// winds in the scenario's unit at the synoptic knots, linear or whole between them.
#[test]
fn a_path_is_as_long_as_asked() {
    let small_scale = SmallScale::new(0.0, 0.1, 0.25, 5).unwrap();
    let bootstrap = Arc::new(round_robin());
    let (unit, lead_in) = (2.0, 3);
    let generator =
        WindGenerator::new(bootstrap.clone(), small_scale, 0.25, unit, lead_in, Some(0)).unwrap();
    for (end, steps) in [(2.5, 10), (2.51, 11), (0.0, 1)] {
        let coarse = generator.path(9, 0, end, Sampling::Coarse).unwrap();
        let fine = generator.path(9, 0, end, Sampling::Fine).unwrap();
        assert_eq!(coarse.knots().len(), lead_in + steps + 1);
        assert_eq!(fine.knots().len(), 5 * (lead_in + steps) + 1);
        for path in [&coarse, &fine] {
            assert_eq!((path.start(), path.times()[0]), (-0.75, -0.75));
            let spacing = 0.25 * (lead_in + steps) as f64 / (path.times().len() - 1) as f64;
            assert!(path.times().windows(2).all(|t| (t[1] - t[0] - spacing).abs() < 1e-12));
            assert_eq!(path.times().len(), path.knots().len());
            assert!((path.end() - 0.25 * steps as f64).abs() < 1e-12);
        }
        let winds = sample(&bootstrap, 9, 0..1, lead_in + steps + 1, Some(0)).unwrap().wind;
        for (k, pair) in winds.windows(2).enumerate() {
            let t = -0.75 + 0.25 * k as f64;
            for path in [&coarse, &fine] {
                assert!((path.velocity(t) - pair[0] / unit).norm() < 1e-9);
                let middle = (pair[0] + pair[1]) / (2.0 * unit);
                assert!((path.velocity(t + 0.125) - middle).norm() < 1e-9);
                let whole = path.integral(t + 0.25) - path.integral(t);
                assert!((whole - middle * 0.25).norm() < 1e-9);
            }
        }
    }
    let bad = SmallScale::new(0.1, 0.1, 0.25, 5).unwrap();
    assert!(WindGenerator::new(bootstrap.clone(), bad.clone(), 0.0, 1.0, 0, None).is_err());
    assert!(WindGenerator::new(bootstrap, bad, 0.25, -1.0, 0, None).is_err());
}

/// One fine step in a coarse one: nothing to fill in, and the integral is the trapezoid's, up to
/// the root of a variance that is zero but for rounding. Without spread nothing is random: `w` decays as `e^{−t/τ}`.
#[test]
fn small_scale_at_its_ends() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let coarse = SmallScale::new(0.7, 0.4, 0.2, 1).unwrap();
    let now = Vec2::new(1.5, -0.5);
    let (value, integral) = coarse.advance(now, &mut rng);
    assert!((integral - (now + value) * 0.1).norm() < 1e-7);
    let mut out = vec![now];
    coarse.fill(now, (value, integral), &mut rng, &mut out);
    assert_eq!(out, [now]);

    let still = SmallScale::new(0.0, 0.4, 0.2, 4).unwrap();
    assert_eq!((still.start(&mut rng), still.substeps()), (Vec2::zeros(), 4));
    let (value, integral) = still.advance(now, &mut rng);
    assert!((value - now * (-0.5f64).exp()).norm() < 1e-14);
    still.fill(now, (value, integral), &mut rng, &mut out);
    out.push(value);
    for (k, w) in out.iter().enumerate() {
        assert!((w - now * (-0.125 * k as f64).exp()).norm() < 1e-14);
    }
    let trapezoid: Vec2 = out.windows(2).map(|pair| (pair[0] + pair[1]) * 0.025).sum();
    assert!((integral - trapezoid).norm() < 1e-14);

    for (sd, memory, step, substeps) in [
        (-1.0, 0.4, 0.2, 4),
        (f64::NAN, 0.4, 0.2, 4),
        (f64::INFINITY, 0.4, 0.2, 4),
        (0.1, 0.0, 0.2, 4),
        (0.1, 0.4, 0.0, 4),
        (0.1, 0.4, 0.2, 0),
    ] {
        assert!(SmallScale::new(sd, memory, step, substeps).is_err());
    }
}

/// Members of an ensemble do as a body alone under the same wind; one without a wind fails alone.
#[test]
fn members_are_bodies_alone() {
    let small_scale = SmallScale::new(0.2, 0.01, 0.05, 10).unwrap();
    let generator =
        WindGenerator::new(Arc::new(round_robin()), small_scale, 0.05, 10.0, 3, None).unwrap();
    let scenario = Scenario {
        sea: Arc::new(AcademicSea::paper(0.05).unwrap()),
        coast: None,
        drag: 1.0,
        duration: 1.0,
        position: Vec2::new(1.0, 1.0),
        velocity: Vec2::zeros(),
    };
    let times = [0.0, 0.4, 1.0];
    for (model, sampling) in [
        (Model::MeanFlow { order: 1 }, Sampling::Coarse),
        (Model::MeanFlow { order: 2 }, Sampling::Fine),
        (Model::Full(Formulation::B), Sampling::Fine),
    ] {
        let solver = Solver { rtol: 1e-8, atol: 1e-8, ..solver(model) };
        let winds = Winds::Drawn { generator: &generator, seed: 11 };
        let members =
            Ensemble::new(&scenario, &winds, solver, None, (&times, 4)).unwrap().follow(2..5);
        assert_eq!(members.len(), 3);
        for (member, index) in members.iter().zip(2..) {
            let wind = generator.path(11, index, 1.0, sampling).unwrap();
            let alone = scenario.trajectory(&wind, &solver, &times).unwrap();
            assert_eq!(member.status, Status::Afloat);
            let kept: &[Vec2] = if index < 4 { &alone.position } else { &[] };
            assert_eq!(member.positions.len(), kept.len());
            // Steps common to all members are other steps than those of a body alone.
            for (x, y) in member.positions.iter().zip(kept) {
                assert!((x - y).norm() < 1e-7, "{model:?}: {}", (x - y).norm());
            }
        }
    }
    let wind = steady(Vec2::zeros());
    let given = Winds::Given(&[&wind]);
    let run = Ensemble::new(&scenario, &given, solver(MODELS[2]), None, (&times, 2))
        .unwrap()
        .follow(0..2);
    assert_eq!((run[0].status, run[0].positions.len()), (Status::Afloat, 3));
    assert_eq!(run[1].status, Status::Failed);
    assert!(run[1].failure.is_some() && run[1].positions.is_empty());
}

/// With `M = −x sin t` the excursion at the start is `a(0, Y) = Y`: the iteration for
/// `Y + a(0, Y) = x` goes to and fro between `x` and 0, and the model says so.
#[test]
fn a_start_that_does_not_converge_is_an_error() {
    let x = Axis { start: -10.0, step: 5.0, count: 5 };
    let constant = Axis { start: 0.0, step: 1.0, count: 1 };
    let coefficients = (-3..=3).flat_map(|k| [Complex64::new(0.0, 5.0 * f64::from(k)), 0.0.into()]);
    let sea = GriddedSea::new(
        TAU,
        [x, constant, constant],
        Tide::Harmonics(1),
        2,
        coefficients.collect(),
    )
    .unwrap();
    let wind = steady(Vec2::zeros());
    let position = Vec2::new(1.0, 0.0);
    let velocity = Vec2::zeros();
    let problem = Problem { sea: &sea, wind: &wind, drag: 1.0, duration: 1.0, position, velocity };
    let run = solver(Model::MeanFlow { order: 1 })
        .follow(problem, &mut |_| Ok(ControlFlow::Continue(())));
    assert!(matches!(run, Err(DriftError::Integration { .. })));
}
