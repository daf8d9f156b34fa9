//! Cost of one step of everything: each field, the wind, each model, a whole member.

#![expect(clippy::expect_used, reason = "a bench that cannot be set up must stop")]

use std::hint::black_box;
use std::ops::ControlFlow;
use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use driftcore::coast::{Coast, Side};
use driftcore::ensemble::{Ensemble, Scenario, Winds};
use driftcore::field::academic::AcademicSea;
use driftcore::field::gridded::{Axis, GriddedSea, Tide};
use driftcore::field::{Harmonics, SeaField, Vec2};
use driftcore::model::{Formulation, Model, Problem, Solver};
use driftcore::wind::bootstrap::{Bootstrap, Catalogue};
use driftcore::wind::lanes::WindPaths;
use driftcore::wind::small_scale::SmallScale;
use driftcore::wind::{Sampling, WindGenerator};
use num_complex::Complex64;

const EPSILON: f64 = 1.0 / 50.0;
const SYNOPTIC_STEP: f64 = 6.0 / 12.5 * EPSILON;

/// A catalogue of an AR(1) record made of sines of incommensurate periods: dense enough to be
/// searched like a real one.
fn bootstrap() -> Bootstrap {
    let n = 2200;
    let wave = |k: usize, a: f64, b: f64| (a * k as f64).sin() + (b * k as f64).cos();
    let value = |k: usize| [wave(k, 0.61, 1.17), wave(k, 0.37, 1.93)];
    let states = (2..n + 2).flat_map(|k| [value(k), value(k - 1)].concat()).collect();
    let target = (3..n + 3).flat_map(value).collect();
    let identity = (0..16).map(|k| f64::from(u8::from(k % 5 == 0))).collect();
    let catalogue = Catalogue {
        order: 2,
        states,
        whitening: identity,
        target,
        predictor: vec![0.0; 10],
        noise: vec![0.05, 0.0, 0.0, 0.05],
        row: (2..n + 2).collect(),
        phase: vec![0; n],
        start: vec![true; n],
        cycle: vec![0.0, 0.0],
        bandwidth: 0.3,
    };
    Bootstrap::new(catalogue).expect("the catalogue is well formed")
}

fn generator() -> WindGenerator {
    let small_scale =
        SmallScale::new(0.1, 3.0 / 12.5 * EPSILON, SYNOPTIC_STEP, 48).expect("numbers above 0");
    WindGenerator::new(Arc::new(bootstrap()), small_scale, SYNOPTIC_STEP, 1.0, 7, None)
        .expect("numbers above 0")
}

fn gridded() -> GriddedSea {
    let axis = |count| Axis { start: 0.0, step: 2.0 / (count - 1) as f64, count };
    let channels = 8;
    let count = 52 * 52 * channels;
    let coefficients = (0..count).map(|k| Complex64::cis((k * k % 997) as f64)).collect();
    let still = Axis { start: 0.0, step: 1.0, count: 1 };
    GriddedSea::new(
        EPSILON,
        [axis(50), axis(50), still],
        Tide::Harmonics(2),
        channels,
        coefficients,
    )
    .expect("the grid is well formed")
}

fn scenario() -> Scenario {
    Scenario {
        sea: Arc::new(AcademicSea::paper(EPSILON).expect("epsilon is above 0")),
        coast: Coast::circle(Vec2::new(1.0, 1.0), 0.3, Side::Inside).ok(),
        drag: 1.0,
        duration: 1.0,
        position: Vec2::new(1.0, 1.0),
        velocity: Vec2::zeros(),
    }
}

fn fields(c: &mut Criterion) {
    let seas: [(&str, Box<dyn SeaField>); 2] = [
        ("academic", Box::new(AcademicSea::paper(EPSILON).expect("epsilon is above 0"))),
        ("gridded", Box::new(gridded())),
    ];
    let x = Vec2::new(1.01, 0.97);
    for (name, sea) in &seas {
        c.bench_function(&format!("field/{name}/velocity"), |b| {
            b.iter(|| sea.velocity(black_box(0.123), black_box(x)));
        });
        let mut out = Harmonics::default();
        c.bench_function(&format!("field/{name}/harmonics"), |b| {
            b.iter(|| sea.harmonics(black_box(0.123), black_box(x), &mut out));
        });
    }
}

fn winds(c: &mut Criterion) {
    let bootstrap = bootstrap();
    let steps = 104;
    let mut seed = 0;
    c.bench_function("wind/104 bootstrap steps", |b| {
        b.iter(|| {
            seed += 1;
            driftcore::wind::sample(&bootstrap, seed, 0..1, steps, None)
        });
    });
    let generator = generator();
    for (name, sampling) in [("coarse", Sampling::Coarse), ("fine", Sampling::Fine)] {
        c.bench_function(&format!("wind/{name} path"), |b| {
            b.iter(|| {
                seed += 1;
                generator.path(seed, 0, 1.0, sampling)
            });
        });
    }
}

fn models(c: &mut Criterion) {
    let generator = generator();
    let coarse = generator.path(1, 0, 1.0, Sampling::Coarse).expect("a path");
    let fine = generator.path(1, 0, 1.02, Sampling::Fine).expect("a path");
    let paper = Model::Paper { order: 1, window: EPSILON / 2.0, wind_terms: true };
    let models = [
        ("full, A", Model::Full(Formulation::A), &fine),
        ("full, B", Model::Full(Formulation::B), &fine),
        ("paper, order 1", paper, &fine),
        ("mean-flow, order 1", Model::MeanFlow { order: 1 }, &coarse),
        ("mean-flow, order 2", Model::MeanFlow { order: 2 }, &fine),
    ];
    let scenario = scenario();
    for (name, model, wind) in models {
        let solver = Solver { model, rtol: 1e-8, atol: 1e-8, euler_step: None };
        let problem = Problem {
            sea: scenario.sea.as_ref(),
            wind,
            drag: 1.0,
            duration: 1.0,
            position: scenario.position,
            velocity: scenario.velocity,
        };
        c.bench_function(&format!("model/{name}"), |b| {
            b.iter(|| solver.follow(problem, &mut |_| Ok(ControlFlow::Continue(()))));
        });
    }
}

/// Members per second: with their own winds drawn and a coast, and with winds in memory.
fn members(c: &mut Criterion) {
    let generator = generator();
    let drawn = Winds::Drawn { generator: &generator, seed: 1 };
    let (mean_flow, full) =
        (Model::MeanFlow { order: 1 }, Model::Full(driftcore::model::Formulation::B));
    let solver = |model| Solver { model, rtol: 1e-6, atol: 1e-6, euler_step: None };
    let scenario = scenario();
    let mut group = c.benchmark_group("members");
    group.throughput(Throughput::Elements(64));
    for (name, model) in [("mean-flow, order 1", mean_flow), ("full", full)] {
        let ensemble = Ensemble::new(&scenario, &drawn, solver(model), None, (&[], 0))
            .expect("the ensemble is well formed");
        group.bench_function(format!("{name}, drawn winds, coast"), |b| {
            b.iter(|| ensemble.follow(0..64));
        });
    }
    let open_sea = Scenario { coast: None, ..scenario };
    for count in [64, 2048] {
        let wave = |member: usize, knot: usize| (0.37 * (31 * member + 17 * knot) as f64).sin();
        let paths = WindPaths::new(0.0, 2e-4, [count, 5001], |member, knot| {
            Vec2::new(wave(member, knot), wave(member + 1, knot))
        })
        .expect("the paths are well formed");
        let winds = Winds::InMemory(&paths);
        group.throughput(Throughput::Elements(count as u64));
        for steps in [None, Some(8.0)] {
            let ensemble = Ensemble::new(&open_sea, &winds, solver(full), steps, (&[], 0))
                .expect("the ensemble is well formed");
            group.bench_function(format!("full, {count} winds in memory, {steps:?} steps"), |b| {
                b.iter(|| ensemble.follow(0..count as u64));
            });
        }
    }
}

criterion_group!(benches, fields, winds, models, members);
criterion_main!(benches);
