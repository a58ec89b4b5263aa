//! Costs and noises by likelihood: the verified reference, exact gradients, twins, and fits of simulated persons.
#![allow(non_snake_case)]

use crate::lqg_people::{binary, diagonal, example, example_truth, matrix, simulate, term};
use nalgebra::DMatrix;
use rand::RngExt;
use serde_json::Value;
use volition::ctl::{Ctl, StopReason};
use volition::likelihood::lqg::{
    self, Climbed, Design, Explanation, Fit, FitError, Inference, Plant, Problem, Record, RecordError, Recorded, Role,
    Start, Timing,
};
use volition::num::rng::{self, Stream};

fn numbers(value: &Value) -> Vec<f64> {
    match value.as_array() {
        Some(list) => list.iter().flat_map(numbers).collect(),
        None => vec![value.as_f64().unwrap()],
    }
}

/// The design of a case of `lqg_likelihood.json`.
fn reference_design(golden: &Value, case: &Value) -> Design {
    let m = |name: &str, rows, columns| matrix(rows, columns, &numbers(&golden["plant"][name]));
    let one = |i: usize| diagonal(&[f64::from(u8::from(i == 0)), f64::from(u8::from(i == 1))]);
    let scalar = |name: &str| matrix(1, 1, &[golden[name].as_f64().unwrap()]);
    Design {
        plant: Plant { a: m("A", 2, 2), b: m("B", 2, 1), c: m("C", 1, 2), e: m("E", 2, 1), d: matrix(1, 1, &[0.0]) },
        internal: None,
        terms: vec![
            term("q1", Role::StateWeight, one(0)),
            term("q2", Role::StateWeight, one(1)),
            term("wp1", Role::PerceivedProcessNoise, one(0)),
            term("wp2", Role::PerceivedProcessNoise, one(1)),
            term("w1", Role::ProcessNoise, one(0)),
            term("w2", Role::ProcessNoise, one(1)),
            term("v", Role::MeasurementNoise, matrix(1, 1, &[1.0])),
        ],
        control_weight: matrix(1, 1, &numbers(&golden["R"])),
        perceived_measurement_noise: scalar("perceived_v"),
        is_told: case["told"] == 1,
        timing: Timing::Predictor,
        recorded: Recorded {
            rows: None,
            instrument: (case["recorded_y"] == "apart").then(|| scalar("recorder_y_variance")),
            control: (case["recorded_u"] == true).then(|| scalar("recorder_u_variance")),
            is_applied: false,
        },
        start: Start::Rest,
        horizon: None,
        on_the_way: None,
    }
}

/// Log likelihoods and gradients of an independent prototype, six cases of two points.
#[test]
fn the_likelihood_is_that_of_the_reference() {
    let golden: Value = serde_json::from_str(include_str!("../golden/lqg_likelihood.json")).unwrap();
    let mut points = 0;
    for case in golden["cases"].as_array().unwrap() {
        let design = reference_design(&golden, case);
        let d = numbers(&case["disturbance"]);
        let record = Record {
            measured: matrix(d.len(), design.channels(), &numbers(&case["z"])),
            disturbance: matrix(d.len(), 1, &d),
            initial: None,
        };
        let problem = Problem::new(&design, &[record]).unwrap();
        for point in case["points"].as_array().unwrap() {
            let theta = numbers(&point["theta"]);
            let member = design.member(&theta, false).unwrap();
            let near = |found: &DMatrix<f64>, expected: &Value| {
                found.iter().zip(numbers(expected)).all(|(v, w)| (v / w - 1.0).abs() < 1e-9)
            };
            assert!(near(&member.k, &point["K"]) && near(&member.l, &point["L"]), "{}", case["name"]);
            let found = problem.evaluate(&theta, true, &Ctl::new()).unwrap().unwrap();
            let expected = point["log_likelihood"].as_f64().unwrap();
            let error = (found.log_likelihood - expected).abs() / expected.abs();
            assert!(error < 1e-9, "{}: {error:e}", case["name"]);
            let gradient = numbers(&point["gradient"]);
            let size = gradient.iter().fold(1.0_f64, |most, v| most.max(v.abs()));
            for (found, expected) in found.gradient.iter().zip(&gradient) {
                let error = (found - expected).abs() / size;
                assert!(error < 1e-5, "{}: {found} for {expected}", case["name"]);
            }
            points += 1;
        }
    }
    assert_eq!(points, 12);
}

/// A random design of up to three states and two of each port.
fn random_design(stream: &mut Stream, round: usize) -> Design {
    let n = stream.random_range(1..=3usize);
    let (m, p, q) = (stream.random_range(1..=n.min(2)), stream.random_range(1..=n.min(2)), 1);
    let mut draw = |rows, columns| DMatrix::from_fn(rows, columns, |_, _| stream.random_range(-1.0..1.0));
    let mut plant = Plant { a: draw(n, n), b: draw(n, m), c: draw(p, n), e: draw(n, q), d: DMatrix::zeros(p, q) };
    // What the experimenter does is seen at once by some.
    if round % 6 > 2 {
        plant.d = draw(p, q);
    }
    let mut shape = |order: usize| {
        let root = draw(order, order);
        &root * root.transpose() + DMatrix::identity(order, order) * 0.2
    };
    let terms = vec![
        term("q1", Role::StateWeight, shape(n)),
        term("q2", Role::StateWeight, shape(n)),
        term("wp1", Role::PerceivedProcessNoise, shape(n)),
        term("wp2", Role::PerceivedProcessNoise, shape(n)),
        term("w", Role::ProcessNoise, shape(n)),
        term("v", Role::MeasurementNoise, shape(p)),
        term("m", Role::MotorNoise, shape(m)),
    ];
    let (control_weight, perceived_measurement_noise) = (shape(m), shape(p));
    let instrument = (round % 2 == 1).then(|| shape(p) * 0.1);
    let control = (!round.is_multiple_of(3)).then(|| shape(m) * 0.1);
    Design {
        plant,
        terms,
        control_weight,
        perceived_measurement_noise,
        is_told: round % 5 < 2,
        timing: if round % 4 < 2 { Timing::Predictor } else { Timing::Filter },
        internal: None,
        recorded: Recorded { rows: None, instrument, control, is_applied: round % 3 == 2 },
        start: if round % 7 < 4 { Start::Rest } else { Start::Settled },
        horizon: None,
        on_the_way: None,
    }
}

/// Against difference quotients of sixth order, over random persons in both timings and with all that can be recorded.
#[test]
fn gradients_are_exact() {
    let mut stream = rng::stream(23, "lqg gradients");
    let (mut checked, mut sharp, mut compared) = (0, 0, 0);
    for round in 0..84 {
        let design = random_design(&mut stream, round);
        let theta: Vec<f64> = design.free().map(|_| stream.random_range(-1.0..1.0)).collect();
        if design.member(&theta, false).is_none() {
            continue;
        }
        let d = binary(40, 1.0, &mut stream);
        let truth: Vec<f64> = theta.iter().map(|v| v + stream.random_range(-0.3..0.3)).collect();
        let records: Vec<Record> = [40, 25]
            .iter()
            .map(|samples| simulate(&design, &truth, &d.rows(0, *samples).into_owned(), &mut stream))
            .collect();
        let problem = Problem::new(&design, &records).unwrap();
        // Plants that are hardly stabilisable have no regulator to working precision, here or beside.
        let Some(found) = problem.evaluate(&theta, true, &Ctl::new()).unwrap() else { continue };
        let at = |theta: &[f64]| {
            problem.evaluate(theta, false, &Ctl::new()).unwrap().map_or(f64::NAN, |found| found.log_likelihood)
        };
        // With derivatives the covariance recursion ends a little later.
        let apart = (found.log_likelihood - at(&theta)).abs() / (1.0 + found.log_likelihood.abs());
        assert!(apart < 1e-8, "{round}: {apart:e}");
        let size = found.gradient.amax().max(1.0);
        for i in 0..theta.len() {
            let moved = |step: f64| {
                let mut moved = theta.clone();
                moved[i] += step;
                at(&moved)
            };
            let quotient = |h: f64| {
                ((moved(h) - moved(-h)) * 45.0 - (moved(2.0 * h) - moved(-2.0 * h)) * 9.0
                    + (moved(3.0 * h) - moved(-3.0 * h)))
                    / (60.0 * h)
            };
            // Where the equations are ill-conditioned a quotient has their rounding; three steps say how much.
            let quotients = [2e-3, 4e-3, 8e-3].map(quotient);
            if quotients.iter().any(|v| v.is_nan()) {
                continue;
            }
            let doubt = (quotients[0] - quotients[2]).abs().max((quotients[1] - quotients[2]).abs()) / size;
            let error = (quotients[2] - found.gradient[i]).abs() / size;
            assert!(
                error < 1e-7 + 3.0 * doubt,
                "{round} {}: {} for {quotients:?}: {error:e}",
                design.terms[i].name,
                found.gradient[i]
            );
            sharp += usize::from(doubt < 1e-7);
            compared += 1;
        }
        checked += 1;
    }
    assert!(checked > 70 && 10 * sharp > 9 * compared, "{checked}, {sharp} of {compared}");
}

/// The mean of the information is the covariance of the score: over many records the mean score is zero and its
/// covariance what the information says.
#[test]
fn scores_have_mean_zero_and_the_information_as_covariance() {
    let design = example(true, Some(4e-4));
    let theta = example_truth(5.0);
    let mut stream = rng::stream(24, "lqg scores");
    let sets = 200;
    let (mut sum, mut squares, mut information) =
        (nalgebra::DVector::zeros(5), DMatrix::zeros(5, 5), DMatrix::zeros(5, 5));
    for _ in 0..sets {
        let d = binary(100, 0.5, &mut stream);
        let record = simulate(&design, &theta, &d, &mut stream);
        let problem = Problem::new(&design, &[record]).unwrap();
        let found = problem.evaluate(&theta, true, &Ctl::new()).unwrap().unwrap();
        sum += &found.gradient;
        squares += &found.gradient * found.gradient.transpose();
        information += &found.information;
    }
    for i in 0..5 {
        let deviation = information[(i, i)].sqrt();
        // Four standard deviations of a mean, and of a variance, of 200 draws.
        assert!(sum[i].abs() < 4.0 * deviation, "{i}: {} of {deviation}", sum[i]);
        let ratio = squares[(i, i)] / information[(i, i)];
        assert!((ratio - 1.0).abs() < 4.0 * (2.0 / f64::from(sets)).sqrt(), "{i}: {ratio}");
    }
}

/// A full fit.
fn fitted(problem: &Problem<'_>, starts: usize) -> (Fit, Climbed, Inference, Vec<Explanation>) {
    let ctl = Ctl::new();
    let fit = lqg::fit(problem, None, starts, 1, &ctl).unwrap();
    let hills = lqg::hills(problem, &fit.best, &fit.bounds, &ctl).unwrap();
    let (best, known) = lqg::inference(problem, fit.best.clone(), &fit.bounds, 0.95, &ctl).unwrap();
    let explanations = lqg::explanations(problem, &fit, &hills, &best, &known, &ctl).unwrap();
    (fit, best, known, explanations)
}

/// Two persons of the reference with one compensator: each is found from the other, optimal for its own positive
/// costs, and their likelihoods agree whatever was recorded.
#[test]
fn twins_of_the_reference_explain_the_same_records() {
    let golden: Value = serde_json::from_str(include_str!("../golden/lqg_twins.json")).unwrap();
    let mut stream = rng::stream(25, "lqg twins");
    let each = |prefix: &str, role| {
        [(1.0, 0.0), (0.0, 1.0)].map(|(x, y)| term(&format!("{prefix}{}", 1 + y as usize), role, diagonal(&[x, y])))
    };
    for case in golden["cases"].as_array().unwrap() {
        let factor = case["perceived_v_factor"].as_f64().unwrap();
        for recorded in ["y", "y and u", "y apart and u"] {
            let mut design = example(false, (recorded != "y").then_some(4e-4));
            design.terms = [each("q", Role::StateWeight), each("wp", Role::PerceivedProcessNoise)].concat();
            design.terms.push(term("w", Role::ProcessNoise, diagonal(&[0.0025, 1.0])));
            design.terms.push(term("v", Role::MeasurementNoise, matrix(1, 1, &[1.0])));
            if recorded == "y apart and u" {
                design.recorded.instrument = Some(matrix(1, 1, &[1e-6]));
            }
            let theta = [0.4, 0.02, 1e-6 / factor, 4e-4 / factor, 4e-4, 1e-4].map(f64::ln);
            let records = vec![simulate(&design, &theta, &binary(400, 0.5, &mut stream), &mut stream)];
            let problem = Problem::new(&design, &records).unwrap();
            let here = problem.evaluate(&theta, true, &Ctl::new()).unwrap().unwrap();
            // A climb that stays where it is: the question is about the twin of this person.
            let held = vec![false; theta.len()];
            let bounds = vec![[-40.0, 40.0]; theta.len()];
            let best = lqg::climb(&problem, &theta, &held, &bounds, &Ctl::new()).unwrap().unwrap();
            assert_eq!(best.theta, theta);
            let twins = lqg::explanations::twin_persons(&design, &best.theta).unwrap();
            let [k, l] = [numbers(&case["K2"]), numbers(&case["L2"])];
            let found = twins.iter().find(|twin| (twin.k[(0, 0)] / k[0] - 1.0).abs() < 1e-6).unwrap();
            assert!(found.l.iter().zip(&l).all(|(v, w)| (v / w - 1.0).abs() < 1e-5), "{found:?}");
            let other = found.theta.as_ref().unwrap();
            let there = problem.evaluate(other, false, &Ctl::new()).unwrap().unwrap();
            let apart = (there.log_likelihood - here.log_likelihood).abs();
            assert!(apart < 1e-6, "{factor} {recorded}: {apart:e}");
            // The costs of the reference (§2), as multiples of R, and the noises as multiples of V_p.
            if factor == 1.0 {
                let expected = [10004.0 * 1e-3, 26.01 * 1e-3, 0.00798 * 1e-4, 0.1594 * 1e-4];
                for (value, expected) in other.iter().zip(expected) {
                    assert!((value.exp() / expected - 1.0).abs() < 2e-3, "{} {expected}", value.exp());
                }
            }
        }
    }
}

/// The control recorded, the person not told: all five parameters within four standard errors, all starts at one hill,
/// profile intervals that hold the truth and are those of a parabola where the errors are small.
#[test]
fn output_and_control_tell_costs_and_noises() {
    let design = example(false, Some(4e-4));
    let truth = example_truth(1.0);
    let mut stream = rng::stream(26, "lqg fit of y and u");
    let d: Vec<_> = (0..2).map(|_| binary(750, 0.5, &mut stream)).collect();
    let records: Vec<Record> = d.iter().map(|d| simulate(&design, &truth, d, &mut stream)).collect();
    let problem = Problem::new(&design, &records).unwrap();
    let (fit, best, known, explanations) = fitted(&problem, 5);
    assert_eq!(explanations.len(), 1, "{explanations:?}");
    assert!(fit.arrived(best.evaluation.log_likelihood) >= 2, "{:?}", fit.climbs);
    assert!(known.is_observed && known.remaining_step < 0.01, "{known:?}");
    let expected = [0.014, 0.038, 0.018, 0.16, 0.04];
    for (i, truth) in truth.iter().enumerate() {
        let error = known.standard_errors[i].unwrap();
        // Half of the reference's samples: its errors (§4) times √2, within a third.
        assert!((error / expected[i]).ln().abs() < 0.35, "{i}: {error}");
        assert!((best.theta[i] - truth).abs() < 4.0 * error, "{i}: {} {truth} {error}", best.theta[i]);
        let [low, high] = known.intervals[i].map(Option::unwrap);
        for end in [best.theta[i] - low, high - best.theta[i]] {
            assert!((end / (1.96 * error) - 1.0).abs() < 0.15, "{i}: {end} {error}");
        }
        assert_eq!(known.refusals[i], None);
    }
    // On the ends of a profile the likelihood ratio is the quantile.
    let [low, _] = known.intervals[0].map(Option::unwrap);
    let mut start = best.theta.clone();
    start[0] = low;
    let mut bounds = fit.bounds.clone();
    bounds[0] = [low, low];
    let free = [false, true, true, true, true];
    let held = lqg::climb(&problem, &start, &free, &bounds, &Ctl::new()).unwrap().unwrap();
    let ratio = 2.0 * (best.evaluation.log_likelihood - held.evaluation.log_likelihood);
    assert!((ratio - 3.841).abs() < 0.05, "{ratio}");
}

/// Outputs alone of a person who is not told say nothing about the cost: it is refused, by name, and the noises are
/// not.
#[test]
fn costs_from_outputs_alone_are_refused() {
    let design = example(false, None);
    let truth = example_truth(5.0);
    let mut stream = rng::stream(27, "lqg fit of y alone");
    let records = vec![simulate(&design, &truth, &binary(600, 0.5, &mut stream), &mut stream)];
    let problem = Problem::new(&design, &records).unwrap();
    let (_, best, known, _) = fitted(&problem, 5);
    for i in 0..3 {
        assert!(known.refusals[i].is_some(), "{i}: {known:?}");
    }
    assert_eq!(known.refusals[4], None, "{known:?}");
    let error = known.standard_errors[4].unwrap();
    assert!((best.theta[4] - truth[4]).abs() < 4.0 * error, "{best:?}");
}

/// In the filter's timing too.
#[test]
fn the_filters_timing_is_fitted() {
    let mut design = example(true, Some(4e-4));
    design.timing = Timing::Filter;
    let truth = example_truth(5.0);
    let mut stream = rng::stream(28, "lqg fit in the filter's timing");
    let records = vec![simulate(&design, &truth, &binary(800, 0.5, &mut stream), &mut stream)];
    let problem = Problem::new(&design, &records).unwrap();
    let (_, best, known, _) = fitted(&problem, 5);
    for (i, truth) in truth.iter().enumerate() {
        let error = known.standard_errors[i].unwrap();
        assert!((best.theta[i] - truth).abs() < 4.0 * error, "{i}: {} {truth} {error}", best.theta[i]);
    }
}

#[test]
fn a_fit_stops_when_it_is_told() {
    let design = example(false, Some(4e-4));
    let mut stream = rng::stream(29, "lqg stop");
    let records = vec![simulate(&design, &example_truth(1.0), &binary(60, 0.5, &mut stream), &mut stream)];
    let problem = Problem::new(&design, &records).unwrap();
    let ctl = Ctl::new();
    ctl.stop(StopReason::Deadline);
    assert!(matches!(lqg::fit(&problem, None, 5, 1, &ctl), Err(FitError::Stopped(_))));
}

/// A person whose belief is zero for certain commands nothing at the first sample; a record that says otherwise,
/// without noise, did not start at rest.
#[test]
fn a_first_command_that_is_exact_tells_nothing() {
    let mut design = example(false, Some(0.0));
    design.recorded.instrument = Some(matrix(1, 1, &[1e-6]));
    let theta = example_truth(1.0);
    let mut stream = rng::stream(30, "lqg silent");
    let record = simulate(&design, &theta, &binary(60, 0.5, &mut stream), &mut stream);
    assert_eq!(record.measured[(0, 1)], 0.0);
    let found = |record: &Record, design: &Design| {
        Problem::new(design, std::slice::from_ref(record))
            .map(|problem| problem.evaluate(&theta, false, &Ctl::new()).unwrap().unwrap().log_likelihood)
    };
    let silent = found(&record, &design).unwrap();
    // With a recorder whose noise tends to nothing the first command has a density of its own, and no more.
    let mut noisy = design.clone();
    noisy.recorded.control = Some(matrix(1, 1, &[1e-14]));
    let first = -0.5 * (2.0 * std::f64::consts::PI * 1e-14).ln();
    let difference = found(&record, &noisy).unwrap() - first - silent;
    assert!(difference.abs() < 1e-4, "{difference}");
    let mut moved = record;
    moved.measured[(0, 1)] = 0.1;
    assert_eq!(found(&moved, &design), Err(RecordError::NotAtRest { trial: 0 }));
}
