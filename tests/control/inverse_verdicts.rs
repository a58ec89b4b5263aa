//! Verdicts against another implementation at forty digits, in any units, and for structures at their limits.
#![allow(non_snake_case)]

use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use serde_json::Value;
use volition::control::lqg::lqr;
use volition::control::lyapunov::Clock;
use volition::ctl::Ctl;
use volition::inverse::fit::{FitSettings, fit};
use volition::inverse::{Gains, InverseLqr, QSign, Settings, Structure, StructureError, Verdict, inverse_lqr};
use volition::num::rng;

fn mat(value: &Value) -> DMatrix<f64> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).unwrap();
    DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

fn rows(rows: usize, columns: usize, entries: &[f64]) -> DMatrix<f64> {
    DMatrix::from_row_slice(rows, columns, entries)
}

fn ask(gains: &Gains, structure: Structure) -> InverseLqr {
    inverse_lqr(gains, &Settings { structure, ..Settings::default() }, &Ctl::new()).unwrap()
}

/// 220 gains of two to four inputs, 52 of them with |t*| < 1e-3 and 20 with |t*| < 1e-5, the smallest 3.7e-7.
#[test]
fn margins_and_verdicts_are_those_of_forty_digits() {
    let golden: Value = serde_json::from_str(include_str!("../golden/inverse_margins.json")).unwrap();
    let cases = golden["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 220);
    let mut counts = [0; 3];
    for (i, case) in cases.iter().enumerate() {
        let clock = if case["discrete"] == true { Clock::Sampled } else { Clock::Continuous };
        let gains = Gains::regulator(&mat(&case["A"]), &mat(&case["B"]), &mat(&case["K"]), clock).unwrap();
        let answer = ask(&gains, Structure::default());
        let exact = case["t_star"].as_f64().unwrap();
        assert_eq!(answer.unknowns as u64, case["unknowns"].as_u64().unwrap(), "case {i}");
        let found = answer.t_star.unwrap();
        assert!((found - exact).abs() < 1e-8, "case {i}: {found:e} {exact:e}");
        match answer.verdict {
            Verdict::Feasible => {
                counts[0] += 1;
                assert!(exact > 0.0, "case {i}: {exact:e}");
            }
            Verdict::Infeasible => {
                counts[1] += 1;
                assert!(exact < 0.0 && answer.t_star_upper_bound.unwrap() < 0.0, "case {i}: {exact:e}");
            }
            Verdict::Boundary => {
                counts[2] += 1;
                assert!(exact.abs() < 1e-6, "case {i}: {exact:e} is no boundary");
            }
        }
    }
    assert!(counts[0] >= 108 && counts[1] >= 106, "{counts:?}");
}

/// States in units that differ by up to six decades, so that Q's entries differ by twelve: the verdict is that of any
/// other units.
#[test]
fn the_units_of_the_states_decide_nothing() {
    let mut stream = rng::stream(31, "units of the states");
    let mut asked = 0;
    for round in 0..150 {
        let n = stream.random_range(1..=8usize);
        let m = stream.random_range(1..=n);
        let clock = if stream.random::<bool>() { Clock::Continuous } else { Clock::Sampled };
        let mut matrix =
            |rows: usize, columns: usize| DMatrix::from_fn(rows, columns, |_, _| stream.random_range(-1.0..1.0));
        let (a, b, q, r) = (matrix(n, n), matrix(n, m), matrix(n, n), matrix(m, m));
        let q = &q * q.transpose() + DMatrix::identity(n, n) * 0.01;
        let size = 10f64.powf(stream.random_range(-3.0..=3.0));
        let r = (&r * r.transpose() + DMatrix::identity(m, m) * 0.01) * size;
        let Ok(solution) = lqr(&a, &b, &q, &r, clock) else { continue };
        let unit: Vec<f64> = (0..n).map(|_| 10f64.powf(stream.random_range(-3.0..=3.0))).collect();
        let a = DMatrix::from_fn(n, n, |i, j| a[(i, j)] * unit[i] / unit[j]);
        let b = DMatrix::from_fn(n, m, |i, j| b[(i, j)] * unit[i]);
        let k = DMatrix::from_fn(m, n, |i, j| solution.k[(i, j)] / unit[j]);
        let answer = ask(&Gains::regulator(&a, &b, &k, clock).unwrap(), Structure::default());
        assert_eq!(answer.verdict, Verdict::Feasible, "{round}: n = {n}, m = {m}, {clock:?}, {:?}", answer.decision);
        let error = answer.weights.unwrap().proof.forward_error;
        assert!(error <= 1e-6, "{round}: {error:e}");
        asked += 1;
    }
    assert!(asked > 140, "{asked}");
}

fn without_rates() -> Structure {
    let pattern = DMatrix::from_fn(4, 4, |i, j| i % 2 == 0 && j % 2 == 0);
    Structure { q_pattern: Some(pattern), q_sign: QSign::Semidefinite, ..Structure::default() }
}

/// Two coupled masses with a force each: angles or positions are paid for, rates are not.
fn two_masses(clock: Clock) -> [DMatrix<f64>; 5] {
    let a = rows(4, 4, &[0., 1., 0., 0., 2., -0.3, 1., 0.1, 0., 0., 0., 1., 0.5, 0., -1., -0.2]);
    let b = rows(4, 2, &[0., 0., 1., 0.2, 0., 0., 0., 0.7]);
    let (a, b) = match clock {
        Clock::Continuous => (a, b),
        Clock::Sampled => (DMatrix::identity(4, 4) + a * 0.1, b * 0.1),
    };
    let mut q = DMatrix::zeros(4, 4);
    (q[(0, 0)], q[(2, 2)], q[(0, 2)], q[(2, 0)]) = (3.0, 2.0, 0.4, 0.4);
    let r = rows(2, 2, &[1.0, 0.1, 0.1, 0.5]);
    let k = lqr(&a, &b, &q, &r, clock).unwrap().k;
    [a, b, q, r, k]
}

#[test]
fn states_may_be_left_out_of_the_cost() {
    for clock in [Clock::Continuous, Clock::Sampled] {
        let [a, b, q, r, k] = two_masses(clock);
        let gains = Gains::regulator(&a, &b, &k, clock).unwrap();
        let answer = ask(&gains, without_rates());
        assert_eq!(answer.verdict, Verdict::Feasible, "{clock:?}: {answer:?}");
        let weights = answer.weights.unwrap();
        assert!(weights.proof.forward_error < 1e-8);
        assert!((0..4).all(|i| (0..4).all(|j| (i % 2 == 0 && j % 2 == 0) || weights.q[(i, j)] == 0.0)));
        // So few unknowns are left that the weights come back, up to their scale.
        assert_eq!(answer.unknowns, 1);
        let scale = weights.r[(0, 0)] / r[(0, 0)];
        assert!((&weights.q / scale - &q).amax() < 1e-6 && (&weights.r / scale - &r).amax() < 1e-6);
        // With three digits of the gain nothing is left, and the fit says how little that means.
        let rounded = k.map(|v| (v * 1e3).round() / 1e3);
        let gains = Gains::regulator(&a, &b, &rounded, clock).unwrap();
        let answer = ask(&gains, without_rates());
        assert_eq!(answer.verdict, Verdict::Infeasible, "{clock:?}");
        let settings = FitSettings {
            structure: without_rates(),
            condition_numbers: vec![1e1, 1e3],
            random_starts: 1,
            ..FitSettings::default()
        };
        let found = fit(&gains, &settings, &Ctl::new()).unwrap();
        let point = &found.curve[1];
        assert!(point.residual < 2.0 * 8.0 * 0.25e-6, "{clock:?}: {:e}", point.residual);
        assert!((0..4).all(|i| (0..4).all(|j| (i % 2 == 0 && j % 2 == 0) || point.q[(i, j)] == 0.0)));
        let again = lqr(&a, &b, &point.q, &point.r, clock).unwrap().k;
        assert!(((&again - &rounded).norm_squared() / point.residual - 1.0).abs() < 1e-5);
    }
    // A gain that feeds back rates alone is paid for by no weight on positions.
    let (a, b) = (rows(2, 2, &[0., 1., -1., 0.]), rows(2, 1, &[0., 1.]));
    let gains = Gains::regulator(&a, &b, &rows(1, 2, &[0.0, 1.0]), Clock::Continuous).unwrap();
    let pattern = rows(2, 2, &[1., 0., 0., 0.]).map(|v| v > 0.0);
    let structure = Structure { q_pattern: Some(pattern), q_sign: QSign::Semidefinite, ..Structure::default() };
    assert_eq!(ask(&gains, structure.clone()).verdict, Verdict::Infeasible);
    let nothing = Structure { q_pattern: Some(DMatrix::from_element(2, 2, false)), ..structure };
    assert_eq!(nothing.check(2, 1), Err(StructureError::NothingWeighed { order: 2 }));
}

#[test]
fn a_fixed_weight_is_a_shape_whatever_its_size() {
    let (a, b) = (rows(2, 2, &[0., 1., 2., 0.]), rows(2, 1, &[0., 1.]));
    let gains = Gains::regulator(&a, &b, &rows(1, 2, &[5.0, 4.0]), Clock::Continuous).unwrap();
    let alpha = ask(&gains, Structure::default()).conditioning.unwrap().alpha;
    for size in [1e-200, 1e-3, 1.0, 1e50] {
        let structure = Structure { r: Some(rows(1, 1, &[size])), ..Structure::default() };
        let answer = ask(&gains, structure);
        assert_eq!(answer.verdict, Verdict::Feasible, "{size:e}");
        assert!((answer.conditioning.unwrap().alpha / alpha - 1.0).abs() < 1e-6, "{size:e}");
    }
    let huge = Structure { r: Some(rows(1, 1, &[1e300])), ..Structure::default() };
    assert!(matches!(huge.check(2, 1), Err(StructureError::Entry { order: 1, row: 0, column: 0, .. })));
    let negative = Structure { r: Some(rows(1, 1, &[-1.0])), ..Structure::default() };
    let error = negative.check(2, 1).unwrap_err().to_string();
    assert!(error.contains("R (1x1) is not positive definite") && error.contains("-1"), "{error}");
}

/// Sixteen plants of one state side by side, `q_i = k_i(k_i − 2) r_i`: α is the largest ratio, and every other r_i is
/// free in an interval.
#[test]
fn large_sets_of_best_weights_are_chosen_from_and_measured() {
    let one = DMatrix::identity(16, 16);
    let gain = DVector::from_fn(16, |i, _| 3.0 + 0.1 * i as f64);
    let gains = Gains::regulator(&one, &one, &DMatrix::from_diagonal(&gain), Clock::Continuous).unwrap();
    let answer = ask(&gains, Structure::default());
    let conditioning = answer.conditioning.unwrap();
    assert!((conditioning.alpha / 11.25 - 1.0).abs() < 1e-6, "{conditioning:?}");
    assert_eq!(conditioning.solution_dimension, 15);
    // The least norm takes every r_i = 1; the first may rise to 11.25/3.
    let weights = answer.weights.unwrap();
    assert!((&weights.r - &one).amax() < 2e-3, "{}", weights.r);
    assert!((conditioning.solution_width.unwrap() - 2.75).abs() < 1e-2, "{conditioning:?}");
}

#[test]
fn a_fit_is_weighted_by_the_covariance_of_the_gain() {
    let golden: Value = serde_json::from_str(include_str!("../golden/inverse.json")).unwrap();
    let case = &golden["cases"]["ch4_4.4.3_Ke"];
    let gains = Gains::regulator(&mat(&case["A"]), &mat(&case["B"]), &mat(&case["K"]), Clock::Continuous).unwrap();
    // K₁₁ and K₂₃ are known a hundred times as well as the others, and the errors of neighbours go together.
    let sd = [0.01, 1.0, 1.0, 1.0, 1.0, 0.01];
    let covariance = DMatrix::from_fn(6, 6, |i, j| {
        let together = if i == j {
            1.0
        } else if i / 2 == j / 2 {
            0.3
        } else {
            0.0
        };
        together * sd[i] * sd[j]
    });
    let metric = covariance.clone().try_inverse().unwrap();
    let settings = |metric| FitSettings { metric, condition_numbers: vec![1e2, 1e3], ..FitSettings::default() };
    let plain = fit(&gains, &settings(None), &Ctl::new()).unwrap();
    let weighted = fit(&gains, &settings(Some(metric.clone())), &Ctl::new()).unwrap();
    let distance = |k: &DMatrix<f64>| {
        let e = DVector::from_column_slice((k - gains.k()).as_slice());
        e.dot(&(&metric * &e))
    };
    for (one, other) in weighted.curve.iter().zip(&plain.curve) {
        assert!((one.residual / distance(&one.k) - 1.0).abs() < 1e-9);
        assert!(one.residual < 0.5 * distance(&other.k), "{} {}", one.residual, distance(&other.k));
        let error = |k: &DMatrix<f64>, i, j| (k[(i, j)] - gains.k()[(i, j)]).abs();
        for (i, j) in [(0, 0), (1, 2)] {
            assert!(error(&one.k, i, j) < error(&other.k, i, j), "K{i}{j}");
        }
    }
}

#[test]
fn without_a_bound_the_fit_reaches_the_least_values_known() {
    let golden: Value = serde_json::from_str(include_str!("../golden/inverse.json")).unwrap();
    // The best values that a search without bounds reached elsewhere.
    for (name, best) in [
        ("ch3_3.4_Ke", 1.466_483_641_731_657),
        ("ch4_4.4.3_Ke", 3.021_048_240_707_403_7),
        ("ch4_4.4.3_Le_dual", 1.273_847_307_497_924_4),
    ] {
        let case = &golden["cases"][name];
        let gains = Gains::regulator(&mat(&case["A"]), &mat(&case["B"]), &mat(&case["K"]), Clock::Continuous).unwrap();
        let found = fit(&gains, &FitSettings::default(), &Ctl::new()).unwrap();
        let (free, last) = (found.unbounded.unwrap(), found.curve.last().unwrap());
        assert!(free.residual <= best * (1.0 + 1e-3), "{name}: {best} {free:?}");
        assert!(free.residual <= last.residual, "{name}: {free:?} {}", last.residual);
        assert!(free.condition_number > 1e3);
    }
}
