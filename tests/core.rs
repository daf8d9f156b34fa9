//! The core on its own: exact solutions, orders of convergence, bounds and laws, without Python.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on must fail")]

use std::f64::consts::TAU;
use std::ops::ControlFlow;
use std::sync::Arc;

use driftcore::coast::{Coast, Side};
use driftcore::ensemble::{Ensemble, Member, Scenario, Status, Winds};
use driftcore::error::DriftError;
use driftcore::field::academic::{AcademicSea, SeparableCurrent};
use driftcore::field::gridded::{Axis, GriddedSea, Tide};
use driftcore::field::{SeaField, Vec2};
use driftcore::model::{Formulation, Model, Problem, Solver};
use driftcore::wind::bootstrap::{Bootstrap, Catalogue};
use driftcore::wind::hand_over::HandOver;
use driftcore::wind::lanes::WindPaths;
use driftcore::wind::path::WindPath;
use driftcore::wind::small_scale::SmallScale;
use driftcore::wind::{Sampling, WindGenerator};
use nalgebra::Matrix2;
use num_complex::Complex64;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const FULL: Model = Model::Full(Formulation::B);

fn solver(model: Model, rtol: f64) -> Solver {
    Solver { model, rtol, atol: rtol, euler_step: None }
}

/// A gentle wind with knots, covering whatever a window needs.
fn wind() -> WindPath {
    let times: Vec<f64> = (0..120).map(|k| -2.0 + 0.043 * f64::from(k)).collect();
    let velocity = (times.iter())
        .map(|t| Vec2::new(0.3 + (7.0 * t).sin(), -0.3 + 0.8 * (5.0 * t + 1.0).cos()))
        .collect();
    WindPath::new(times, velocity).unwrap()
}

/// Two tide harmonics and a residual with one, all nonlinear in position and slow in time. The
/// coefficients are a smooth function of the node, so that the field is smooth; `period` scales
/// the residual as the paper's ε does.
fn nonlinear_sea(period: f64) -> GriddedSea {
    let axis = |count| Axis { start: -2.0, step: 6.0 / (count - 1) as f64, count };
    let (x, y, time) = (axis(31), axis(29), Axis { start: -0.5, step: 0.25, count: 9 });
    let mut coefficients = Vec::new();
    for it in 0..time.count + 2 {
        for iy in 0..y.count + 2 {
            for ix in 0..x.count + 2 {
                let place = |axis: Axis, i: usize| axis.start + (i as f64 - 1.0) * axis.step;
                let (t, y, x) = (place(time, it), place(y, iy), place(x, ix));
                for channel in 0..8 {
                    let c = f64::from(channel);
                    let wave = (0.9 * x + 0.4 * c).sin() * (0.7 * y - 0.3 * c).cos();
                    let scale = if channel < 4 { 1.0 } else { period };
                    coefficients.push(
                        Complex64::new(wave, 0.6 * (x + 0.5 * y + c).cos())
                            * scale
                            * (1.0 + 0.3 * (2.0 * t + c).sin()),
                    );
                }
            }
        }
    }
    GriddedSea::new(period, [x, y, time], Tide::Harmonics(2), 8, coefficients).unwrap()
}

fn problem<'a>(sea: &'a dyn SeaField, wind: &'a WindPath, drag: f64) -> Problem<'a> {
    let (position, velocity) = (Vec2::new(0.8, 0.6), Vec2::new(0.1, -0.2));
    Problem { sea, wind, drag, duration: 1.0, position, velocity }
}

/// Position and velocity at regular times, with a check that each piece stays in its reach.
fn followed(solver: &Solver, problem: Problem, count: usize) -> Vec<(Vec2, Vec2)> {
    let mut out = Vec::new();
    let run = solver.follow(problem, &mut |piece| {
        let (start, end) = piece.span();
        let reach = piece.reach();
        for k in 0..=8 {
            let t = start + (end - start) * f64::from(k) / 8.0;
            assert!((piece.position(t)? - reach.center).norm() <= reach.radius * (1.0 + 1e-9));
        }
        while out.len() <= count && out.len() as f64 / count as f64 <= end {
            let t = out.len() as f64 / count as f64;
            out.push((piece.position(t)?, piece.velocity(t)?));
        }
        Ok(ControlFlow::Continue(()))
    });
    run.unwrap();
    assert_eq!(out.len(), count + 1);
    out
}

fn sup_errors(a: &[(Vec2, Vec2)], b: &[(Vec2, Vec2)]) -> [f64; 2] {
    let largest = |f: &dyn Fn(&(Vec2, Vec2)) -> Vec2| -> f64 {
        a.iter().zip(b).map(|(a, b)| (f(a) - f(b)).norm()).fold(0.0, f64::max)
    };
    [largest(&|pair| pair.0), largest(&|pair| pair.1)]
}

/// Least-squares slope of log(error) over log(period).
fn slope(periods: &[f64], errors: &[f64]) -> f64 {
    let (x, y): (Vec<f64>, Vec<f64>) =
        periods.iter().zip(errors).map(|(p, e)| (p.ln(), e.ln())).unzip();
    let n = x.len() as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let covariance: f64 = x.iter().zip(&y).map(|(x, y)| (x - mx) * (y - my)).sum();
    covariance / x.iter().map(|x| (x - mx).powi(2)).sum::<f64>()
}

/// Slopes of the position's and the velocity's error against the full model.
fn orders(model: impl Fn(f64) -> Model, wind: &WindPath, drag: f64) -> [f64; 2] {
    let periods = [1.0 / 30.0, 1.0 / 60.0, 1.0 / 120.0];
    let errors: Vec<[f64; 2]> = periods
        .iter()
        .map(|period| {
            let sea = nonlinear_sea(*period);
            let count = (24.0 / period) as usize;
            let exact = followed(&solver(FULL, 1e-11), problem(&sea, wind, drag), count);
            let averaged =
                followed(&solver(model(*period), 1e-10), problem(&sea, wind, drag), count);
            sup_errors(&exact, &averaged)
        })
        .collect();
    [0, 1].map(|k| slope(&periods, &errors.iter().map(|e| e[k]).collect::<Vec<_>>()))
}

fn assert_near(found: [f64; 2], expected: f64, tolerance: f64) {
    for slope in found {
        assert!((slope - expected).abs() < tolerance, "slopes {found:?}, expected {expected}");
    }
}

#[test]
fn mean_flow_has_its_orders_in_a_nonlinear_sea() {
    let wind = wind();
    assert_near(orders(|_| Model::MeanFlow { order: 1 }, &wind, 1.7), 2.0, 0.12);
    assert_near(orders(|_| Model::MeanFlow { order: 2 }, &wind, 1.7), 3.0, 0.15);
}

#[test]
fn stroboscopic_expansion_has_its_orders_for_any_drag() {
    let calm = WindPath::new(vec![-2.0, 3.0], vec![Vec2::zeros(); 2]).unwrap();
    let paper =
        |order| move |period| Model::Paper { order, window: period / 10.0, wind_terms: false };
    assert_near(orders(paper(0), &calm, 1.7), 1.0, 0.12);
    assert_near(orders(paper(1), &calm, 1.7), 2.0, 0.12);
}

/// In a wind that is slow against the tide the terms `B_W` vanish with the period, and the
/// expansion keeps its first order with them.
#[test]
fn wind_terms_leave_the_first_order() {
    let with = |period| Model::Paper { order: 1, window: period / 2.0, wind_terms: true };
    for slope in orders(with, &wind(), 1.0) {
        assert!(slope > 0.9, "{slope}");
    }
}

#[test]
fn both_formulations_are_one_model() {
    let (sea, wind) = (nonlinear_sea(0.02), wind());
    let [a, b] = [Formulation::A, Formulation::B]
        .map(|f| followed(&solver(Model::Full(f), 1e-11), problem(&sea, &wind, 1.7), 500));
    let errors = sup_errors(&a, &b);
    assert!(errors.iter().all(|error| *error < 1e-8), "{errors:?}");
}

fn still_sea() -> AcademicSea {
    let still = SeparableCurrent {
        mean: 0.0,
        modulation: 0.0,
        cycles: 0.0,
        phase: 0.0,
        axis: 0,
        sines: vec![Vec2::new(1.0, 1.0)],
    };
    AcademicSea::new(0.02, still.clone(), still, 1.0).unwrap()
}

/// Without a sea and in a steady wind, `V = W + (v − W)e^{−Λt}` and `X` is its integral: in every
/// model.
#[test]
fn still_sea_gives_the_exact_drag_solution() {
    let (sea, drag, steady) = (still_sea(), 1.7, Vec2::new(0.5, -1.0));
    let wind = WindPath::new(vec![-2.0, 3.0], vec![steady; 2]).unwrap();
    let problem = problem(&sea, &wind, drag);
    let models = [
        FULL,
        Model::Full(Formulation::A),
        Model::MeanFlow { order: 1 },
        Model::MeanFlow { order: 2 },
        Model::Paper { order: 0, window: 0.01, wind_terms: true },
        Model::Paper { order: 1, window: 0.01, wind_terms: true },
    ];
    for model in models {
        for (k, (x, v)) in followed(&solver(model, 1e-11), problem, 20).iter().enumerate() {
            let t = k as f64 / 20.0;
            let left = (-drag * t).exp();
            let velocity = steady + (problem.velocity - steady) * left;
            let position =
                problem.position + steady * t + (problem.velocity - steady) * ((1.0 - left) / drag);
            assert!((x - position).norm() < 1e-9, "{model:?} at {t}");
            assert!((v - velocity).norm() < 1e-9, "{model:?} at {t}");
        }
    }
}

#[test]
fn euler_has_order_one() {
    let (sea, wind) = (nonlinear_sea(0.05), wind());
    let exact = followed(&solver(FULL, 1e-11), problem(&sea, &wind, 1.0), 100);
    let steps = [1.0 / 2000.0, 1.0 / 4000.0, 1.0 / 8000.0];
    let errors: Vec<f64> = (steps.iter())
        .map(|step| {
            let euler = Solver { euler_step: Some(*step), ..solver(FULL, 1e-8) };
            let run = followed(&euler, problem(&sea, &wind, 1.0), 100);
            (run[100].0 - exact[100].0).norm()
        })
        .collect();
    assert!((slope(&steps, &errors) - 1.0).abs() < 0.05, "{errors:?}");
}

#[test]
fn bad_calls_are_errors() {
    let (sea, wind) = (nonlinear_sea(0.02), wind());
    let fails = |model, rtol| {
        let run = solver(model, rtol)
            .follow(problem(&sea, &wind, 1.0), &mut |_| Ok(ControlFlow::Continue(())));
        run.is_err()
    };
    assert!(fails(Model::MeanFlow { order: 0 }, 1e-8));
    assert!(fails(Model::MeanFlow { order: 3 }, 1e-8));
    assert!(fails(Model::Paper { order: 2, window: 0.01, wind_terms: true }, 1e-8));
    assert!(fails(Model::Paper { order: 1, window: 0.0, wind_terms: true }, 1e-8));
    assert!(fails(Model::Paper { order: 1, window: 9.0, wind_terms: true }, 1e-8));
    assert!(fails(FULL, 0.0));
    let short = WindPath::new(vec![0.0, 0.5], vec![Vec2::zeros(); 2]).unwrap();
    let run = solver(FULL, 1e-8)
        .follow(problem(&sea, &short, 1.0), &mut |_| Ok(ControlFlow::Continue(())));
    assert!(matches!(run, Err(DriftError::WindTooShort { .. })));
}

/// A catalogue of a made-up record of order 1 with two phases, dense enough to be searched.
fn catalogue(bandwidth: f64) -> Catalogue {
    let n = 700;
    let value = |k: usize| {
        let k = k as f64;
        [(0.61 * k).sin() + (1.17 * k).cos(), (0.37 * k).sin() - (1.93 * k).cos()]
    };
    Catalogue {
        order: 1,
        states: (1..=n).flat_map(value).collect(),
        whitening: vec![1.0, 0.2, 0.0, 0.9],
        target: (2..=n + 1).flat_map(value).collect(),
        predictor: vec![0.0; 6],
        noise: vec![0.05, 0.0, 0.01, 0.04],
        row: (1..=n).collect(),
        phase: (1..=n).map(|k| k % 2).collect(),
        start: vec![true; n],
        cycle: vec![0.3, -0.1, -0.3, 0.1],
        bandwidth,
    }
}

/// The leaves and the plain weighing draw rows by the weights: χ² over the rows that expect at
/// least five of 40,000 draws, p > 1e-4 by the normal approximation (z < 3.72).
#[test]
fn rows_are_drawn_by_their_weights() {
    for bandwidth in [0.08, 0.3, 0.8] {
        let catalogue = catalogue(bandwidth);
        let bootstrap = Bootstrap::new(catalogue.clone()).unwrap();
        for (case, y) in [[0.4, -0.2], [1.2, 0.9], [-1.7, 1.6]].iter().enumerate() {
            let whiten = |y: &[f64]| [y[0] + 0.2 * y[1], 0.9 * y[1]];
            let z = whiten(y);
            let distance2 = |k: usize| {
                let row = whiten(&catalogue.states[2 * k..2 * k + 2]);
                (row[0] - z[0]).powi(2) + (row[1] - z[1]).powi(2)
            };
            let nearest = (0..700).map(distance2).fold(f64::INFINITY, f64::min);
            let weights: Vec<f64> = (0..700)
                .map(|k| ((nearest - distance2(k)) / (2.0 * bandwidth * bandwidth)).exp())
                .collect();
            let total: f64 = weights.iter().sum();
            for weigh_all in [false, true] {
                let mut rng = ChaCha8Rng::seed_from_u64(case as u64);
                let draws = bootstrap.draws_at(y, weigh_all, 40_000, &mut rng).unwrap();
                let mut count = vec![0.0; 701];
                draws.iter().for_each(|row| count[*row] += 1.0);
                let (mut chi2, mut cells) = (0.0, 0.0);
                let (mut rest, mut rest_expected) = (0.0, 0.0);
                for (k, weight) in weights.iter().enumerate() {
                    let expected = 40_000.0 * weight / total;
                    if expected < 5.0 {
                        rest += count[k + 1];
                        rest_expected += expected;
                    } else {
                        chi2 += (count[k + 1] - expected).powi(2) / expected;
                        cells += 1.0;
                    }
                }
                if rest_expected >= 5.0 {
                    chi2 += (rest - rest_expected).powi(2) / rest_expected;
                    cells += 1.0;
                }
                // Wilson–Hilferty.
                let degrees: f64 = cells - 1.0;
                let z = ((chi2 / degrees).cbrt() - 1.0 + 2.0 / (9.0 * degrees))
                    / (2.0 / (9.0 * degrees)).sqrt();
                assert!(degrees > 1.0 && z < 3.72, "h {bandwidth}, {y:?}, {weigh_all}: z = {z}");
            }
        }
    }
}

/// What proposals are for: at states of the catalogue a row is accepted after a few trials, of one
/// random number (two words) each by columns, of two by the tree; all rows need not be weighed,
/// which would take one number.
#[test]
fn rows_are_accepted_soon() {
    for (bandwidth, expected) in [(0.3, 2.01..3.0), (0.03, 2.01..3.0), (0.003, 4.0..16.0)] {
        let catalogue = catalogue(bandwidth);
        let bootstrap = Bootstrap::new(catalogue.clone()).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let draws = 200;
        let mut words = 0;
        for row in (0..600).step_by(20) {
            let state = &catalogue.states[2 * row..2 * row + 2];
            let before = rng.get_word_pos();
            bootstrap.draws_at(state, false, draws, &mut rng).unwrap();
            words += rng.get_word_pos() - before;
        }
        let each = words as f64 / (30.0 * draws as f64);
        assert!(expected.contains(&each), "h {bandwidth}: {each} words a draw");
    }
}

#[test]
fn broken_catalogues_are_refused() {
    assert!(Bootstrap::new(catalogue(0.0)).is_err());
    assert!(Bootstrap::new(catalogue(f64::NAN)).is_err());
    let spoiled: [fn(&mut Catalogue); 8] = [
        |c| c.order = 0,
        |c| c.order = 9,
        |c| c.states[7] = f64::NAN,
        |c| c.target.truncate(3),
        |c| c.phase[5] = 2,
        |c| c.row.swap(0, 1),
        |c| c.start.fill(false),
        |c| c.cycle.clear(),
    ];
    for (k, spoil) in spoiled.iter().enumerate() {
        let mut catalogue = catalogue(0.3);
        spoil(&mut catalogue);
        assert!(Bootstrap::new(catalogue).is_err(), "case {k}");
    }
}

fn generator() -> WindGenerator {
    generator_of(2.0)
}

fn generator_of(unit: f64) -> WindGenerator {
    let small_scale = SmallScale::new(0.2, 0.005, 0.0096, 48).unwrap();
    let bootstrap = Bootstrap::new(catalogue(0.3)).unwrap();
    WindGenerator::new(Arc::new(bootstrap), small_scale, 0.0096, unit, 7, None).unwrap()
}

/// The coarse and the fine path of a member are one wind: same values at the synoptic steps, same
/// integrals between them; and a longer path begins with the shorter one.
#[test]
fn one_member_is_one_wind() {
    is_one_wind(&generator());
    is_one_wind(&handed_over());
}

/// The first 30 steps handed over, of two forecasts.
fn handed_over() -> WindGenerator {
    let small_scale = SmallScale::new(0.2, 0.005, 0.0096, 48).unwrap();
    let bootstrap = Bootstrap::new(catalogue(0.3)).unwrap();
    let forecasts = (0..60).map(|k| Vec2::new(k as f64, -0.5 * k as f64)).collect();
    let spread = (0..30).map(|k| k as f64 / 30.0).collect();
    let matrices = [0.8, 0.6, 1.0].map(|value| Matrix2::identity() * value);
    let hand_over = HandOver::new(forecasts, spread, matrices).unwrap();
    WindGenerator::new(Arc::new(bootstrap), small_scale, 0.0096, 2.0, 7, Some(0))
        .unwrap()
        .handed_over(Arc::new(hand_over))
}

fn is_one_wind(generator: &WindGenerator) {
    let coarse = generator.path(5, 3, 1.0, Sampling::Coarse).unwrap();
    let fine = generator.path(5, 3, 1.0, Sampling::Fine).unwrap();
    assert_eq!(coarse.start(), fine.start());
    for t in coarse.times() {
        let t = t.clamp(coarse.start(), coarse.end() - 1e-12);
        assert!((coarse.velocity(t) - fine.velocity(t)).norm() < 1e-9);
        assert!((coarse.integral(t) - fine.integral(t)).norm() < 1e-12);
    }
    let longer = generator.path(5, 3, 1.7, Sampling::Fine).unwrap();
    assert_eq!(&longer.knots()[..fine.knots().len()], fine.knots());
    for (seed, member) in [(5, 4), (6, 3)] {
        let other = generator.path(seed, member, 1.0, Sampling::Coarse).unwrap();
        assert_ne!(other.knots()[0], coarse.knots()[0]);
    }
}

fn scenario(sea: Arc<dyn SeaField>, coast: Option<Coast>, position: Vec2) -> Scenario {
    Scenario { sea, coast, drag: 1.0, duration: 1.0, position, velocity: Vec2::zeros() }
}

fn follow(
    scenario: &Scenario,
    winds: &Winds,
    solver: &Solver,
    steps_per_tide: Option<f64>,
    outputs: (&[f64], u64),
    members: std::ops::Range<u64>,
) -> Vec<Member> {
    Ensemble::new(scenario, winds, *solver, steps_per_tide, outputs).unwrap().follow(members)
}

#[test]
fn members_end_as_they_should() {
    let calm = WindPath::new(vec![-2.0, 3.0], vec![Vec2::zeros(); 2]).unwrap();
    let blown = WindPath::new(vec![-2.0, 3.0], vec![Vec2::new(4.0, 0.0); 2]).unwrap();
    let winds = [&calm, &blown];
    let sea: Arc<dyn SeaField> = Arc::new(still_sea());
    let circle = Coast::circle(Vec2::new(1.0, 1.0), 0.3, Side::Inside).ok();
    let inside = scenario(sea.clone(), circle.clone(), Vec2::new(1.0, 1.0));
    let times = [0.0, 0.1, 0.5, 1.0];
    let run = |scenario: &Scenario, solver: &Solver, keep| {
        follow(scenario, &Winds::Given(&winds), solver, None, (&times, keep), 0..2)
    };
    let order_1 = solver(Model::MeanFlow { order: 1 }, 1e-10);
    let members = run(&inside, &order_1, 1);
    assert_eq!(members[0].status, Status::Afloat);
    assert_eq!(members[0].positions.len(), 4);
    assert_eq!(members[1].status, Status::Stranded);
    assert!(members[1].positions.is_empty());
    // 4(t − 1 + e^{−t}) = 0.3.
    let (t, x) = members[1].stranding.unwrap();
    assert!((4.0 * (t - 1.0 + (-t).exp()) - 0.3).abs() < 1e-9);
    assert!((x - Vec2::new(1.3, 1.0)).norm() < 1e-9);

    let on_the_line = scenario(sea.clone(), circle, Vec2::new(1.3, 1.0));
    let first = &run(&on_the_line, &order_1, 0)[0];
    assert_eq!((first.status, first.stranding.unwrap().0), (Status::Stranded, 0.0));

    let grid = scenario(Arc::new(nonlinear_sea(0.05)), None, Vec2::new(3.95, 0.5));
    assert_eq!(run(&grid, &solver(FULL, 1e-8), 2)[1].status, Status::LeftDomain);

    let broken = run(&inside, &solver(Model::MeanFlow { order: 7 }, 1e-8), 0);
    assert!(broken.iter().all(|m| m.status == Status::Failed && m.failure.is_some()));
}

/// A body on a circular tidal orbit touches the coast once a tide; the first touch is found
/// whatever the step of the integrator.
#[test]
fn grazing_oscillations_are_found() {
    let period = 0.1;
    let tide = SeparableCurrent {
        mean: 1.0,
        modulation: 0.0,
        cycles: 0.0,
        phase: 0.0,
        axis: 0,
        sines: vec![Vec2::new(0.0, 1.0)],
    };
    let still = SeparableCurrent { mean: 0.0, ..tide.clone() };
    let sea: Arc<dyn SeaField> = Arc::new(AcademicSea::new(period, tide, still, 1.0).unwrap());
    let calm = WindPath::new(vec![-2.0, 3.0], vec![Vec2::zeros(); 2]).unwrap();
    // y = 1 + (1 − cos ωt)/ω at x = 1: highest at half a tide.
    let highest = 1.0 + 2.0 * period / TAU;
    for (depth, status) in [(1e-5, Status::Stranded), (-1e-5, Status::Afloat)] {
        let shore = highest - depth;
        let ring = [(-9.0, shore), (9.0, shore), (9.0, shore + 5.0), (-9.0, shore + 5.0)];
        let ring = ring.map(|(x, y)| Vec2::new(x, y)).to_vec();
        let coast = Coast::polygons(&[ring], Side::Outside).ok();
        // The body moves with the water from the start, so the drag does not matter at first.
        let mut scenario = scenario(sea.clone(), coast, Vec2::new(1.0, 1.0));
        scenario.drag = 1e-9;
        scenario.duration = 0.4;
        for model in [FULL, Model::MeanFlow { order: 1 }] {
            let winds = Winds::Given(&[&calm]);
            let members = follow(&scenario, &winds, &solver(model, 1e-11), None, (&[], 0), 0..1);
            let member = &members[0];
            assert_eq!(member.status, status, "{model:?}, depth {depth}");
            if let Some((t, _)) = member.stranding {
                assert!(t < period / 2.0 && t > 0.4 * period, "{model:?}: {t}");
            }
        }
    }
}

/// Members side by side are the members alone: 40 winds (two whole groups and a part), both models,
/// a sea linear in the position and one that is not, positions and strandings within the errors of
/// the steps. A member that leaves the grid, or whose tolerance no common step meets, is followed
/// alone and ends the same way to the last bit.
#[test]
fn side_by_side_as_alone() {
    let generator = generator_of(0.3);
    let times: Vec<f64> = (0..=20).map(|k| f64::from(k) / 20.0).collect();
    let drawn = Winds::Drawn { generator: &generator, seed: 3 };
    let academic: Arc<dyn SeaField> = Arc::new(AcademicSea::paper(0.02).unwrap());
    let gridded: Arc<dyn SeaField> = Arc::new(nonlinear_sea(0.02));
    for (sea, with_coast) in [(academic, true), (gridded.clone(), true), (gridded, false)] {
        let mut scenario = scenario(sea, None, Vec2::new(1.0, 1.0));
        for model in [FULL, Model::MeanFlow { order: 1 }] {
            let sampling = if model == FULL { Sampling::Fine } else { Sampling::Coarse };
            let paths: Vec<WindPath> =
                (0..40).map(|k| generator.path(3, k, 1.0, sampling).unwrap()).collect();
            let given: Vec<&WindPath> = paths.iter().collect();
            let outputs = (times.as_slice(), 40);
            scenario.coast = None;
            if with_coast {
                // About half of the members go this far.
                let open = follow(&scenario, &drawn, &solver(model, 1e-5), None, outputs, 0..40);
                let mut farthest: Vec<f64> = (open.iter())
                    .map(|member| {
                        let distance = |x: &Vec2| (x - scenario.position).norm();
                        member.positions.iter().map(distance).fold(0.0, f64::max)
                    })
                    .collect();
                farthest.sort_by(f64::total_cmp);
                let radius = (farthest[19] + farthest[20]) / 2.0;
                scenario.coast = Coast::circle(scenario.position, radius, Side::Inside).ok();
            }
            let alone = follow(
                &scenario,
                &Winds::Given(&given),
                &solver(model, 1e-11),
                None,
                outputs,
                0..40,
            );
            let abreast = follow(&scenario, &drawn, &solver(model, 1e-5), None, outputs, 0..40);
            let mut stranded = 0;
            for (one, other) in alone.iter().zip(&abreast) {
                assert_eq!(one.status, other.status, "{model:?}");
                for (x, y) in one.positions.iter().zip(&other.positions) {
                    // Below the tolerance of the steps side by side.
                    assert!((x - y).norm() < 5e-6, "{model:?}: {}", (x - y).norm());
                }
                if let (Some((t, x)), Some((s, y))) = (one.stranding, other.stranding) {
                    assert!((t - s).abs() < 1e-4 && (x - y).norm() < 1e-4, "{model:?}: {t} {s}");
                    stranded += 1;
                }
            }
            assert!(
                scenario.coast.is_none() || (1..40).contains(&stranded),
                "{model:?}: {stranded}"
            );
            // No common step meets this tolerance: every member goes alone.
            let strict = solver(model, 1e-13);
            let exact = follow(&scenario, &drawn, &strict, None, outputs, 0..20);
            let expected = follow(&scenario, &Winds::Given(&given), &strict, None, outputs, 0..20);
            for (one, other) in exact.iter().zip(&expected) {
                assert_eq!(one.positions, other.positions);
                assert_eq!(one.stranding, other.stranding);
            }
        }
    }
}

/// Who leaves the grid side by side with others is followed alone, and has left the domain.
#[test]
fn members_leave_the_domain_side_by_side() {
    let generator = generator_of(0.3);
    let drawn = Winds::Drawn { generator: &generator, seed: 3 };
    let scenario = scenario(Arc::new(nonlinear_sea(0.05)), None, Vec2::new(3.95, 0.5));
    for model in [FULL, Model::MeanFlow { order: 1 }] {
        let members = follow(&scenario, &drawn, &solver(model, 1e-5), None, (&[], 0), 0..20);
        assert!(members.iter().any(|member| member.status == Status::LeftDomain));
        assert!(members.iter().all(|member| member.status != Status::Failed));
    }
}

/// Neither the lane nor the neighbours of a member matter: parts of a run, begun anywhere, are the
/// run, bit for bit, with winds drawn and with winds in memory.
#[test]
fn lanes_do_not_influence_each_other() {
    let generator = generator();
    let drawn = Winds::Drawn { generator: &generator, seed: 3 };
    let paths: Vec<WindPath> =
        (0..40).map(|k| generator.path(3, k, 1.0, Sampling::Fine).unwrap()).collect();
    let (start, step) = (paths[0].start(), paths[0].times()[1] - paths[0].times()[0]);
    let lanes = WindPaths::new(start, step, [40, paths[0].times().len()], |member, knot| {
        paths[member].knots()[knot]
    })
    .unwrap();
    let in_memory = Winds::InMemory(&lanes);
    let coast = Coast::circle(Vec2::new(1.0, 1.0), 0.3, Side::Inside).ok();
    let sea = Arc::new(AcademicSea::paper(0.02).unwrap());
    let scenario = scenario(sea, coast, Vec2::new(1.0, 1.0));
    let times = [0.25, 0.5, 1.0];
    for (winds, model) in
        [(&drawn, FULL), (&drawn, Model::MeanFlow { order: 1 }), (&in_memory, FULL)]
    {
        let run =
            |members| follow(&scenario, winds, &solver(model, 1e-6), None, (&times, 40), members);
        let whole = run(0..40);
        let parts: Vec<Member> = [0..1, 1..18, 18..33, 33..40].into_iter().flat_map(run).collect();
        for (one, other) in whole.iter().zip(&parts) {
            assert_eq!(one.positions, other.positions);
            assert_eq!(one.stranding, other.stranding);
        }
    }
    // One wind, drawn or in memory, is one trajectory up to rounding.
    let one = follow(&scenario, &drawn, &solver(FULL, 1e-6), None, (&times, 40), 0..40);
    let two = follow(&scenario, &in_memory, &solver(FULL, 1e-6), None, (&times, 40), 0..40);
    for (one, two) in one.iter().zip(&two) {
        for (x, y) in one.positions.iter().zip(&two.positions) {
            assert!((x - y).norm() < 1e-11);
        }
    }
}

/// Steps of one length have no error control that would send a member on its own way: they must be
/// right by themselves. Winds drawn and in memory, both models, a sea linear in the position and
/// one that is not, against members alone.
#[test]
fn steps_of_one_length_are_right() {
    let generator = generator_of(1.0);
    let duration = 0.3;
    let times: Vec<f64> = (1..=6).map(|k| f64::from(k) / 20.0).collect();
    let academic: Arc<dyn SeaField> = Arc::new(AcademicSea::paper(0.02).unwrap());
    let gridded: Arc<dyn SeaField> = Arc::new(nonlinear_sea(0.02));
    for sea in [academic, gridded] {
        let scenario = Scenario { duration, ..scenario(sea, None, Vec2::new(1.0, 1.0)) };
        for model in [FULL, Model::MeanFlow { order: 1 }] {
            let sampling = if model == FULL { Sampling::Fine } else { Sampling::Coarse };
            let paths: Vec<WindPath> =
                (0..18).map(|k| generator.path(3, k, duration, sampling).unwrap()).collect();
            let given: Vec<&WindPath> = paths.iter().collect();
            let (start, step) = (paths[0].start(), paths[0].times()[1] - paths[0].times()[0]);
            let shape = [18, paths[0].times().len()];
            let lanes = WindPaths::new(start, step, shape, |k, knot| paths[k].knots()[knot]);
            let drawn = Winds::Drawn { generator: &generator, seed: 3 };
            let in_memory = Winds::InMemory(lanes.as_ref().unwrap());
            let straight: Vec<WindPath> = (paths.iter())
                .map(|path| WindPath::new(path.times().to_vec(), path.knots().to_vec()).unwrap())
                .collect();
            let straight: Vec<&WindPath> = straight.iter().collect();
            for (winds, given) in [(drawn, given), (in_memory, straight)] {
                let fixed = solver(model, 1e-6);
                let outputs = (times.as_slice(), 18);
                let abreast = follow(&scenario, &winds, &fixed, Some(30.0), outputs, 0..18);
                let exact = solver(model, 1e-11);
                let alone = follow(&scenario, &Winds::Given(&given), &exact, None, outputs, 0..18);
                for (one, other) in alone.iter().zip(&abreast) {
                    assert_eq!((one.positions.len(), other.positions.len()), (6, 6));
                    for (x, y) in one.positions.iter().zip(&other.positions) {
                        assert!((x - y).norm() < 1e-7, "{model:?}: {}", (x - y).norm());
                    }
                }
                // Where the longest of them meet the tolerance, these are the steps: nobody goes alone.
                let (loose, longest) =
                    (solver(model, 1e-3), if model == FULL { 10.0 } else { 0.5 });
                let run = |steps| follow(&scenario, &winds, &loose, steps, outputs, 0..18);
                for (one, other) in run(None).iter().zip(&run(Some(longest))) {
                    assert_eq!(one.positions, other.positions);
                }
            }
        }
    }
}

/// The fixed steps of the full model are of fifth order at least: where the sea changes little with
/// the position they are nearly a quadrature, which has one more.
#[test]
fn common_steps_have_order_five() {
    let generator = generator();
    let sea = Arc::new(AcademicSea::paper(0.02).unwrap());
    // Less than a tide, over which errors of one phase would cancel.
    let duration = 0.015;
    let scenario = Scenario { duration, ..scenario(sea, None, Vec2::new(1.0, 1.0)) };
    let calm = WindPaths::new(0.0, 1.0, [1, 2], |_, _| Vec2::zeros()).unwrap();
    let winds = Winds::InMemory(&calm);
    let end = |steps| {
        let members =
            follow(&scenario, &winds, &solver(FULL, 1e-6), Some(steps), (&[duration], 1), 0..1);
        members[0].positions[0]
    };
    let exact = end(128.0);
    let error = |steps| (end(steps) - exact).norm();
    let orders =
        [(8.0, 16.0), (12.0, 24.0), (16.0, 32.0)].map(|(a, b)| (error(a) / error(b)).log2());
    assert!(orders.iter().all(|order| (4.8..6.6).contains(order)), "{orders:?}");
    let drawn = Winds::Drawn { generator: &generator, seed: 3 };
    let second = Model::MeanFlow { order: 2 };
    let refused = Ensemble::new(&scenario, &drawn, solver(second, 1e-6), Some(8.0), (&[], 0));
    assert!(refused.is_err());
}
