//! Persons beyond the plain loop: another model than the plant, a target in the state, an end, delays, noise that grows
//! with the control.
#![allow(non_snake_case)]

use crate::lqg_people::{
    binary, diagonal, example, example_truth, follower, held, matrix, reach, reach_truth, reaches, simulate,
    simulate_from, sum, term, tied,
};
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use serde_json::Value;
use volition::ctl::Ctl;
use volition::likelihood::lqg::{self, Design, Plant, Problem, Record, Role, Start, Timing};
use volition::num::rng::{self, Stream};

fn log_likelihood(design: &Design, records: &[Record], theta: &[f64]) -> f64 {
    let problem = Problem::new(design, records).unwrap();
    problem.evaluate(theta, false, &Ctl::new()).unwrap().unwrap().log_likelihood
}

/// Trials of a case of the package `lqg` 0.3.1: states, which are recorded exactly.
fn followed(golden: &Value, states: usize) -> Vec<Record> {
    let one = |trial: &Value| {
        let rows = trial.as_array().unwrap();
        let x = DMatrix::from_fn(rows.len(), 2, |k, j| rows[k][j].as_f64().unwrap());
        let first = x.row(0).transpose();
        let mut belief = DVector::zeros(states);
        belief.rows_mut(0, 2).copy_from(&first);
        Record { disturbance: DMatrix::zeros(x.nrows(), 1), initial: Some([first, belief]), measured: x }
    };
    golden["x"].as_array().unwrap().iter().map(one).collect()
}

/// The names of the package, in the order of θ, and how many times their logarithm is the coefficient's.
const BOUNDED: [(&str, f64); 4] =
    [("action_cost", 1.0), ("action_variability", 2.0), ("sigma_target", 2.0), ("sigma_cursor", 2.0)];
const SUBJECTIVE: [(&str, f64); 2] = [("subj_noise", 2.0), ("subj_vel_noise", 2.0)];

fn peers(golden: &Value, values: &Value) -> Vec<f64> {
    let is_subjective = golden["model"] == "SubjectiveActor";
    let names = BOUNDED.iter().chain(SUBJECTIVE.iter().take(if is_subjective { 2 } else { 0 }));
    names.map(|(name, times)| times * values[*name].as_f64().unwrap().ln()).collect()
}

fn peer_cases() -> [(Value, Design); 2] {
    [include_str!("../golden/lqg_bounded.json"), include_str!("../golden/lqg_subjective.json")].map(|text| {
        let golden: Value = serde_json::from_str(text).unwrap();
        let design = follower(300, golden["model"] == "SubjectiveActor");
        (golden, design)
    })
}

/// Log likelihoods of the package `lqg` 0.3.1 at the truth and at its estimate, and its gains.
#[test]
fn the_peers_likelihoods_are_reproduced() {
    for (golden, design) in peer_cases() {
        let records = followed(&golden, design.internal().a.nrows());
        let truth = peers(&golden, &golden["truth"]);
        let gains = design.gains_by_sample(&truth, None).unwrap();
        let numbers = |value: &Value| -> Vec<f64> {
            let rows = value.as_array().unwrap();
            rows.iter().flat_map(|row| row.as_array().unwrap().iter().map(|v| v.as_f64().unwrap())).collect()
        };
        let own = design.internal().a.nrows();
        for (found, name) in [(&gains[0][0], "gain_first"), (&gains[299][0], "gain_last")] {
            let expected = matrix(1, own, &numbers(&golden[name]));
            assert!((found - &expected).norm() < 1e-9 * expected.norm(), "{name}: {found}{expected}");
        }
        let expected = matrix(own, 2, &numbers(&golden["filter_gain_last"]));
        assert!((&gains[300][1] - &expected).norm() < 1e-9 * expected.norm(), "{}{expected}", gains[300][1]);
        let peer = &golden["peer"];
        for (theta, expected, share) in [
            (truth, &golden["log_likelihood_truth"], 1e-8),
            (peers(&golden, &peer["estimate"]), &peer["log_likelihood"], 1e-8),
        ] {
            let found = log_likelihood(&design, &records, &theta);
            let expected = expected.as_f64().unwrap();
            assert!((found - expected).abs() < share * expected.abs(), "{found} {expected}");
        }
    }
}

/// From its own starts the fit is at least as likely as the peer's, and within .05 standard errors of it.
#[test]
fn the_peers_estimates_are_found() {
    for (golden, design) in peer_cases() {
        let records = followed(&golden, design.internal().a.nrows());
        let problem = Problem::new(&design, &records).unwrap();
        let ctl = Ctl::new();
        let fit = lqg::fit(&problem, None, 5, 1, &ctl).unwrap();
        let peer = &golden["peer"];
        let best = fit.best.evaluation.log_likelihood;
        assert!(best >= peer["log_likelihood"].as_f64().unwrap() - 1e-3, "{best}");
        let expected = peers(&golden, &golden["prototype"]["estimate"]);
        let of_peer = peers(&golden, &peer["estimate"]);
        let errors = &golden["prototype"]["standard_error_of_log"];
        let is_subjective = golden["model"] == "SubjectiveActor";
        let names = BOUNDED.iter().chain(SUBJECTIVE.iter().take(if is_subjective { 2 } else { 0 }));
        for (i, (name, times)) in names.enumerate() {
            let error = times * errors[*name].as_f64().unwrap();
            for expected in [expected[i], of_peer[i]] {
                let away = (fit.best.theta[i] - expected).abs() / error;
                assert!(away < 0.05, "{name}: {} {expected} {error}", fit.best.theta[i]);
            }
        }
    }
}

/// Gains of the error's subspace and of a random walk's filter in closed form: b = dt, p = (1 + √(1 + 4r/b²))/2.
#[test]
fn a_target_that_no_control_moves_has_gains_of_the_error() {
    let mut design = follower(300, false);
    design.horizon = None;
    design.terms.retain(|term| !matches!(term.role, Role::TerminalWeight | Role::InitialCovariance));
    // What was tied is in its place still: the terms that went came last.
    let theta = [1e-3, 0.25, 36.0, 36.0].map(f64::ln);
    let member = design.member(&theta, true).unwrap();
    let (r, b) = (1e-3, 1.0 / 60.0_f64);
    let p = 0.5 * (1.0 + (1.0 + 4.0 * r / (b * b)).sqrt());
    let k = b * p / (r + b * b * p);
    assert!((k - 24.36903).abs() < 1e-5);
    assert!((&member.k - matrix(1, 2, &[-k, k])).norm() < 1e-9 * k, "{}", member.k);
    assert!((member.l[(0, 0)] - 0.153_355_5).abs() < 1e-7, "{}", member.l);
    // Along a horizon without end the gains of one that ends are these, but for the last ones.
    let last = follower(300, false).gains_by_sample(&theta, None).unwrap();
    assert!((&last[0][0] - &member.k).norm() < 1e-9 * k);
    let h = 1e-5;
    let moved = |sign: f64| {
        let mut theta = theta;
        theta[0] += sign * h;
        design.member(&theta, false).unwrap().k
    };
    let quotient = (moved(1.0) - moved(-1.0)) / (2.0 * h);
    let slope = member.k_slopes[0].as_ref().unwrap();
    assert!((slope - &quotient).norm() < 1e-7 * quotient.norm(), "{slope}{quotient}");
}

/// log p(target, cursor) = log p(target) + log p(cursor | target): a random walk in the state, or a target that is what
/// the experimenter does.
#[test]
fn conditioning_on_a_target_leaves_the_cursors_density() {
    let mut stream = rng::stream(40, "lqg target");
    let mut walks = follower(60, false);
    walks.horizon = None;
    walks.terms.retain(|term| !matches!(term.role, Role::TerminalWeight | Role::InitialCovariance));
    let theta = [1e-3, 0.25, 36.0, 9.0].map(f64::ln);
    for timing in [Timing::Filter, Timing::Predictor] {
        walks.timing = timing;
        let record = simulate(&walks, &theta, &DMatrix::zeros(61, 1), &mut stream);
        let both = log_likelihood(&walks, std::slice::from_ref(&record), &theta);
        let target = record.measured.column(0);
        let steps = (1..61).map(|k| target[k] - target[k - 1]);
        let alone: f64 = steps.map(|v: f64| -0.5 * (v * v + (2.0 * std::f64::consts::PI).ln())).sum();
        let mut given = walks.clone();
        given.internal = Some(walks.plant.clone());
        given.plant = Plant {
            a: matrix(1, 1, &[1.0]),
            b: matrix(1, 1, &[1.0 / 60.0]),
            c: matrix(2, 1, &[0.0, 1.0]),
            e: matrix(1, 1, &[0.0]),
            d: matrix(2, 1, &[1.0, 0.0]),
        };
        given.recorded.rows = Some([matrix(1, 1, &[1.0]), matrix(1, 1, &[0.0])]);
        given.recorded.instrument = Some(matrix(1, 1, &[0.0]));
        for term in given.terms.iter_mut().filter(|term| term.role == Role::ProcessNoise) {
            term.shape = term.shape.view((1, 1), (1, 1)).into_owned();
        }
        let cursor = Record {
            disturbance: DMatrix::from_column_slice(61, 1, target.as_slice()),
            measured: record.measured.columns(1, 1).into_owned(),
            initial: None,
        };
        let conditional = log_likelihood(&given, &[cursor], &theta);
        assert!((both - alone - conditional).abs() < 1e-9 * both.abs(), "{both} {alone} {conditional}");
    }
}

/// By another augmentation: the whole state is stacked, x_k … x_{k−d}, and the person senses the last one. With y
/// recorded apart both are one system.
#[test]
fn a_delay_is_that_of_stacked_states() {
    let mut stream = rng::stream(41, "lqg delay");
    let mut plain = example(false, Some(4e-4));
    plain.recorded.instrument = Some(matrix(1, 1, &[1e-6]));
    let theta = example_truth(2.0);
    for (samples, timing) in [(1, Timing::Predictor), (3, Timing::Predictor), (2, Timing::Filter)] {
        plain.timing = timing;
        let delayed = plain.delayed(samples);
        let record = simulate(&delayed, &theta, &binary(200, 0.5, &mut stream), &mut stream);
        let mut stacked = plain.clone();
        let order = 2 * (samples + 1);
        let pad = |m: &DMatrix<f64>, rows, columns| {
            let mut all = DMatrix::zeros(rows, columns);
            all.view_mut((0, 0), m.shape()).copy_from(m);
            all
        };
        let Plant { a, b, c, e, d } = &plain.plant;
        let mut all = pad(a, order, order);
        for at in 1..=samples {
            all.view_mut((2 * at, 2 * at - 2), (2, 2)).fill_with_identity();
        }
        let mut last = DMatrix::zeros(1, order);
        last.view_mut((0, order - 2), (1, 2)).copy_from(c);
        let (b, e) = (pad(b, order, 1), pad(e, order, 1));
        stacked.plant = Plant { a: all, b, c: last, e, d: d.clone() };
        stacked.recorded.rows = Some([pad(c, 1, order), d.clone()]);
        for term in &mut stacked.terms {
            if term.role != Role::MeasurementNoise {
                term.shape = pad(&term.shape, order, order);
            }
        }
        let (found, expected) = (
            log_likelihood(&delayed, std::slice::from_ref(&record), &theta),
            log_likelihood(&stacked, std::slice::from_ref(&record), &theta),
        );
        assert!((found - expected).abs() < 1e-9 * expected.abs(), "{samples}: {found} {expected}");
        // K is that of no delay, and the state's L is AᵈL.
        let [of_delayed, of_plain] = [&delayed, &plain].map(|design| design.member(&theta, false).unwrap());
        assert!((of_delayed.k.columns(0, 2) - &of_plain.k).norm() < 1e-9 * of_plain.k.norm());
        assert!(of_delayed.k.columns(2, samples).amax() < 1e-9 * of_plain.k.norm(), "{}", of_delayed.k);
        let mut ahead = of_plain.l.clone();
        for _ in 0..samples {
            ahead = a * ahead;
        }
        assert!((of_delayed.l.rows(0, 2) - &ahead).norm() < 1e-8 * ahead.norm(), "{}{ahead}", of_delayed.l);
        // Told that there is no delay the same record is less likely.
        let without = log_likelihood(&plain, std::slice::from_ref(&record), &theta);
        assert!(without < expected - 1.0, "{without} {expected}");
    }
}

/// Random designs of all kinds of persons, with a truth and records.
fn kinds(stream: &mut Stream) -> Vec<(&'static str, Design, Vec<f64>, Vec<Record>)> {
    let mut found = Vec::new();
    let d = binary(45, 0.5, stream);
    // Senses delayed, what was sensed recorded.
    let mut delayed = example(true, Some(4e-4));
    delayed.timing = Timing::Filter;
    let delayed = delayed.delayed(2);
    let theta = example_truth(3.0);
    found.push(("delay", delayed.clone(), theta.clone(), vec![simulate(&delayed, &theta, &d, stream)]));
    // Noise of the control, with and without the control recorded.
    for control in [None, Some(4e-4), Some(0.0)] {
        let mut design = example(false, control);
        design.recorded.instrument = Some(matrix(1, 1, &[1e-6]));
        design.terms.push(term("c", Role::ControlDependentNoise, matrix(1, 1, &[1.0])));
        let mut theta = example_truth(2.0);
        theta.push(0.5_f64.ln());
        found.push(("grown", design.clone(), theta.clone(), vec![simulate(&design, &theta, &d, stream)]));
    }
    // All weights and beliefs with terms, of a model that is not the plant, ends and no ends.
    for (round, believes) in [(0, false), (1, true), (2, false)] {
        let mut design = follower(30, believes);
        let mut theta = [1e-3, 0.25, 36.0, 9.0].map(f64::ln).to_vec();
        if believes {
            theta.extend([0.3, 1.2].map(f64::ln));
        }
        if round == 2 {
            design.timing = Timing::Predictor;
            design.horizon = None;
            design.terms.retain(|term| !matches!(term.role, Role::TerminalWeight | Role::InitialCovariance));
        }
        let first = DVector::from_column_slice(&[3.0, -1.0]);
        let mut belief = DVector::zeros(design.internal().a.nrows());
        belief.rows_mut(0, 2).copy_from(&first);
        let gains = design.gains_by_sample(&theta, None).unwrap();
        let at = |k: usize| gains[k.min(gains.len() - 1)].clone();
        let nothing = DMatrix::zeros(31, 1);
        let records: Vec<Record> = (0..2)
            .map(|_| {
                let initial = Some([first.clone(), belief.clone()]);
                simulate_from(&design, &theta, initial, &nothing, &at, stream)
            })
            .collect();
        found.push(("follower", design, theta, records));
    }
    let design = reach(20);
    let theta = reach_truth(20);
    let records = reaches(&design, &theta, &[0.1, 0.2], 30, stream);
    found.push(("reach", design, theta, records));
    found
}

/// Against difference quotients of sixth order.
#[test]
fn gradients_of_all_kinds_are_exact() {
    let mut stream = rng::stream(42, "lqg gradients of all kinds");
    for (name, design, truth, records) in kinds(&mut stream) {
        let problem = Problem::new(&design, &records).unwrap();
        let theta: Vec<f64> = truth.iter().map(|v| v + stream.random_range(-0.2..0.2)).collect();
        let found = problem.evaluate(&theta, true, &Ctl::new()).unwrap().unwrap();
        let at = |theta: &[f64]| problem.evaluate(theta, false, &Ctl::new()).unwrap().unwrap().log_likelihood;
        let apart = (found.log_likelihood - at(&theta)).abs() / (1.0 + found.log_likelihood.abs());
        assert!(apart < 1e-9, "{name}: {apart:e}");
        let size = found.gradient.amax().max(1.0);
        for i in 0..theta.len() {
            let moved = |step: f64| {
                let mut moved = theta.clone();
                moved[i] += step;
                at(&moved)
            };
            let h = 4e-3;
            let quotient = ((moved(h) - moved(-h)) * 45.0 - (moved(2.0 * h) - moved(-2.0 * h)) * 9.0
                + (moved(3.0 * h) - moved(-3.0 * h)))
                / (60.0 * h);
            let error = (quotient - found.gradient[i]).abs() / size;
            assert!(error < 2e-7, "{name} {i}: {} {quotient}: {error:e}", found.gradient[i]);
        }
    }
}

/// The expected cost of a reach under these gains, by the exact moments of state and belief.
fn expected_cost(design: &Design, theta: &[f64], start: &DVector<f64>, gains: &[[DMatrix<f64>; 2]]) -> f64 {
    let Plant { a, b, c, .. } = &design.plant;
    let steps = design.horizon.unwrap().steps;
    let [r, v] = [(Role::ControlWeight, 1), (Role::MeasurementNoise, 3)].map(|(role, n)| sum(design, theta, role, n));
    let terminal = sum(design, theta, Role::TerminalWeight, 5);
    let additive = sum(design, theta, Role::MotorNoise, 1);
    let c_u = sum(design, theta, Role::ControlDependentNoise, 1);
    let both = DVector::from_iterator(10, start.iter().chain(start.iter()).copied());
    let mut moment = &both * both.transpose();
    let mut cost = 0.0;
    for [k, l] in &gains[..steps] {
        let mut f = DMatrix::zeros(10, 10);
        f.view_mut((0, 0), (5, 5)).copy_from(a);
        f.view_mut((0, 5), (5, 5)).copy_from(&(-(b * k)));
        f.view_mut((5, 0), (5, 5)).copy_from(&(l * c));
        f.view_mut((5, 5), (5, 5)).copy_from(&(a - b * k - l * c));
        let of_control = k * moment.view((5, 5), (5, 5)) * k.transpose();
        cost += (&r * &of_control)[(0, 0)];
        let mut noise = DMatrix::zeros(10, 10);
        let motor = &additive + &c_u * &of_control * &c_u;
        noise.view_mut((0, 0), (5, 5)).copy_from(&(b * motor * b.transpose()));
        noise.view_mut((5, 5), (5, 5)).copy_from(&(l * &v * l.transpose()));
        moment = &f * moment * f.transpose() + noise;
    }
    cost + (terminal * moment.view((0, 0), (5, 5))).trace()
}

/// No other gains cost less: K and L are perturbed at random, all samples or one alone. Gains of the plain problem cost
/// more.
#[test]
fn gains_under_noise_of_the_control_cost_least() {
    let mut stream = rng::stream(43, "lqg coupled gains");
    let design = reach(25);
    let theta = reach_truth(25);
    let start = DVector::from_column_slice(&[0.0, 0.0, 0.0, 0.0, 0.15]);
    let gains = design.gains_by_sample(&theta, Some(&start)).unwrap();
    let least = expected_cost(&design, &theta, &start, &gains);
    for round in 0..60 {
        let only = stream.random_range(0..25);
        for sign in [1.0, -1.0] {
            let moved: Vec<[DMatrix<f64>; 2]> = gains
                .iter()
                .enumerate()
                .map(|(k, pair)| {
                    if round % 2 == 0 && k != only {
                        return pair.clone();
                    }
                    let turn = |m: &DMatrix<f64>, size: f64, stream: &mut Stream| {
                        m.map(|v| v + size * m.amax() * stream.random_range(-1.0..1.0))
                    };
                    let size = sign * 0.02;
                    match round % 3 {
                        0 => [turn(&pair[0], size, &mut stream), pair[1].clone()],
                        1 => [pair[0].clone(), turn(&pair[1], size, &mut stream)],
                        _ => [turn(&pair[0], size, &mut stream), turn(&pair[1], size, &mut stream)],
                    }
                })
                .collect();
            let cost = expected_cost(&design, &theta, &start, &moved);
            assert!(cost >= least * (1.0 - 1e-9), "{round}: {cost:e} {least:e}");
        }
    }
    // Without the noise they are those of the plain problem, which cost more where there is noise.
    let mut little = theta.clone();
    little[3] = 1e-6_f64.ln();
    let mut plain = design.clone();
    plain.terms.retain(|term| term.role != Role::ControlDependentNoise);
    for term in &mut plain.terms {
        term.same_as = term.same_as.map(|_| 4);
    }
    let without = [theta[0], theta[1], theta[2], theta[4]];
    let simple = plain.gains_by_sample(&without, None).unwrap();
    let near = design.gains_by_sample(&little, Some(&start)).unwrap();
    for k in 0..25 {
        for (x, y) in simple[k].iter().zip(&near[k]) {
            assert!((x - y).norm() < 1e-6 * (1e-9 + y.norm()), "{k}: {x}{y}");
        }
    }
    assert!(expected_cost(&design, &theta, &start, &simple) > least * 1.001);
}

/// Mean and covariance that reaches are taken for are those of simulated ones, and many reaches of one start are taken
/// by mean and scatter with the likelihood of each alone.
#[test]
fn reaches_have_the_moments_that_they_are_taken_for() {
    let mut stream = rng::stream(44, "lqg reaches");
    let design = reach(12);
    let theta = reach_truth(12);
    let records = reaches(&design, &theta, &[0.1, 0.2], 40, &mut stream);
    // 40 reaches of 13 samples: fewer stand for all.
    let together = log_likelihood(&design, &records, &theta);
    let alone: f64 = records.iter().map(|r| log_likelihood(&design, std::slice::from_ref(r), &theta)).sum();
    assert!((together - alone).abs() < 1e-9 * alone.abs(), "{together} {alone}");
    // Whitened by what they are taken for, many reaches have mean zero and variance one.
    let many = reaches(&design, &theta, &[0.2], 4000, &mut stream);
    let problem = Problem::new(&design, &many).unwrap();
    let errors = problem.innovations(&theta, &Ctl::new()).unwrap().unwrap();
    for k in 1..13 {
        let values: Vec<f64> = errors.iter().map(|e| e[(k, 0)]).collect();
        let mean = values.iter().sum::<f64>() / 4000.0;
        let variance = values.iter().map(|v| v * v).sum::<f64>() / 4000.0;
        assert!(mean.abs() < 4.5 / 4000.0_f64.sqrt(), "{k}: {mean}");
        assert!((variance - 1.0).abs() < 4.5 * (2.2 / 4000.0_f64).sqrt(), "{k}: {variance}");
        for other in 1..k {
            let shared = errors.iter().map(|e| e[(k, 0)] * e[(other, 0)]).sum::<f64>() / 4000.0;
            assert!(shared.abs() < 5.0 / 4000.0_f64.sqrt(), "{k} {other}: {shared}");
        }
    }
}

/// With the control recorded exactly the motor's noise is known at every sample: the likelihood is that of a plant
/// whose process noise is given sample by sample.
#[test]
fn noise_of_a_recorded_control_is_exact() {
    let mut stream = rng::stream(45, "lqg noise of the control");
    let scalar = |v: f64| matrix(1, 1, &[v]);
    let design = Design {
        plant: Plant { a: scalar(1.1), b: scalar(0.5), c: scalar(1.0), e: scalar(0.5), d: scalar(0.0) },
        internal: None,
        terms: vec![
            term("q", Role::StateWeight, scalar(1.0)),
            term("wp", Role::PerceivedProcessNoise, scalar(1.0)),
            held("w", Role::ProcessNoise, scalar(1.0), 0.01),
            held("v", Role::MeasurementNoise, scalar(1.0), 0.04),
            term("c", Role::ControlDependentNoise, scalar(1.0)),
        ],
        control_weight: scalar(1.0),
        perceived_measurement_noise: scalar(0.05),
        is_told: false,
        timing: Timing::Predictor,
        recorded: lqg::Recorded {
            rows: None,
            instrument: Some(scalar(0.0)),
            control: Some(scalar(0.0)),
            is_applied: false,
        },
        start: Start::Rest,
        horizon: None,
        on_the_way: None,
    };
    let theta = [1.0, 0.02, 0.6].map(f64::ln);
    let record = simulate(&design, &theta, &binary(50, 1.0, &mut stream), &mut stream);
    let found = log_likelihood(&design, std::slice::from_ref(&record), &theta);
    // x and u are known: x⁺ − Ax − Bu − Ed is of variance W + B²c²u², and u's is that of what v does to the belief.
    let member = design.member(&theta, false).unwrap();
    let (k, l) = (member.k[(0, 0)], member.l[(0, 0)]);
    let normal = |e: f64, variance: f64| -0.5 * (e * e / variance + (2.0 * std::f64::consts::PI * variance).ln());
    let mut expected = 0.0;
    for at in 0..49 {
        let [x, u] = [0, 1].map(|j| record.measured[(at, j)]);
        let [next_x, next_u] = [0, 1].map(|j| record.measured[(at + 1, j)]);
        let moved = next_x - 1.1 * x - 0.5 * (u + record.disturbance[(at, 0)]);
        expected += normal(moved, 0.01 + 0.25 * 0.36 * u * u);
        let belief = -u / k;
        let told = -k * (1.1 * belief + 0.5 * u + l * (x - belief));
        expected += normal(next_u - told, (k * l).powi(2) * 0.04);
    }
    assert!((found - expected).abs() < 1e-8 * expected.abs(), "{found} {expected}");
}

/// What is tied is one parameter, and a scale that is a term is that of the plain design.
#[test]
fn tied_terms_are_one_parameter() {
    let plain = example(true, Some(4e-4));
    let mut stream = rng::stream(46, "lqg ties");
    let record = [simulate(&plain, &example_truth(1.0), &binary(60, 0.5, &mut stream), &mut stream)];
    let mut other = plain.clone();
    other.control_weight = matrix(1, 1, &[0.0]);
    other.terms.push(held("r", Role::ControlWeight, matrix(1, 1, &[1.0]), 1e-3));
    other.perceived_measurement_noise = matrix(1, 1, &[0.0]);
    other.terms.push(tied("vp", Role::PerceivedMeasurementNoise, matrix(1, 1, &[1.0]), 4));
    other.terms[2] = tied("wp", Role::PerceivedProcessNoise, diagonal(&[0.0025, 1.0]), 3);
    let [q1, q2, _, w, v]: [f64; 5] = example_truth(1.0).try_into().unwrap();
    let found = log_likelihood(&other, &record, &[q1, q2, w, v]);
    let expected = log_likelihood(&plain, &record, &[q1, q2, w, w, v]);
    assert!((found - expected).abs() < 1e-9 * expected.abs(), "{found} {expected}");
}
