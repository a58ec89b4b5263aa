//! Multivariable subsystem identification: the worked examples of Zhang 2015, chapter 4, and random systems against
//! brute force.

use nalgebra::DMatrix;
use num_complex::Complex64;
use serde_json::{Value, json};
use std::f64::consts::PI;
use volition::control::{Discrete, Multivariable, MultivariableModel, MultivariableSystem};
use volition::ctl::{Ctl, StopReason};
use volition::identify::mimo::{
    AxisMatrix, FeedbackPool, Identified, MatrixFrequencyData, MimoError, Plant, Settings, identify,
};
use volition::identify::ssid::Weights;

fn golden() -> Value {
    serde_json::from_str(include_str!("../golden/ssid_mimo.json")).unwrap()
}

pub fn system(model: Value) -> Multivariable<Discrete> {
    let model: MultivariableModel = serde_json::from_value(model).unwrap();
    match model.check().unwrap() {
        MultivariableSystem::Discrete(system) => system,
        MultivariableSystem::Continuous(system) => panic!("{system:?}"),
    }
}

pub fn pool(numerator: Value, denominator: Value, margin: f64) -> FeedbackPool {
    let numerator: AxisMatrix = serde_json::from_value(numerator).unwrap();
    let denominator: Option<AxisMatrix> = serde_json::from_value(denominator).unwrap();
    FeedbackPool::new(&numerator, denominator.as_ref(), margin, "pool/matrix_grid").unwrap()
}

pub fn settings(pool: FeedbackPool, feedforward_order: usize) -> Settings {
    Settings { pool, feedforward_order, weights: Weights::Uniform, max_candidates: 10_000_000 }
}

/// The closed loop `Gy (I + Gfb Gv)⁻¹ (Gfb + Gff)`, straight from equation 4.4.
pub fn closed_loop(
    gy: &DMatrix<Complex64>,
    gv: &DMatrix<Complex64>,
    gff: &DMatrix<Complex64>,
    gfb: &DMatrix<Complex64>,
) -> DMatrix<Complex64> {
    let m = gfb.nrows();
    gy * (DMatrix::identity(m, m) + gfb * gv).try_inverse().unwrap() * (gfb + gff)
}

// ---- Examples ------------------------------------------------------------------------------------------------------

/// D = diag(z + 0.1, z − 0.2), Ny = Nv = diag(1, −1), at angles (a sample time of one second).
fn example_plant() -> Plant {
    let fraction = system(json!({
        "numerator": [[[1.0], [0.0]], [[0.0], [-1.0]]],
        "denominator": [[[1.0, 0.1], [0.0]], [[0.0], [1.0, -0.2]]],
        "sample_time_s": 1.0,
    }));
    Plant { system: fraction, measured: vec![0, 1], fed_back: vec![0, 1] }
}

fn example_angles() -> Vec<f64> {
    (1..=20).map(|k| 0.02 * PI * f64::from(k)).collect()
}

fn example_truth(omega_rad_s: &[f64]) -> MatrixFrequencyData {
    let plant = example_plant();
    let real = |rows: [f64; 4]| DMatrix::from_row_slice(2, 2, &rows).map(|v| Complex64::new(v, 0.0));
    let h = omega_rad_s
        .iter()
        .map(|w| {
            let z = Complex64::from_polar(1.0, *w);
            let g = plant.system.eval(z).unwrap();
            let gff = real([1.0, 1.0, 0.5, 0.0]) + real([-0.3, 0.4, 0.0, 1.0]) / z;
            closed_loop(&g, &g, &gff, &real([0.3, 1.0, 0.2, 0.4]))
        })
        .collect();
    MatrixFrequencyData { omega_rad_s: omega_rad_s.to_vec(), h, variance: None }
}

fn grid(axis: Value, margin: f64) -> FeedbackPool {
    let entry = json!([axis]);
    pool(json!([[entry, entry], [entry, entry]]), json!(null), margin)
}

fn static_gains(found: &Identified) -> Vec<f64> {
    found.optimum.coefficients.concat()
}

/// Nff as β of Zhang 2015 has it: for each command the coefficients of z (control by control), then those of 1.
fn beta(found: &Identified) -> Vec<Vec<f64>> {
    let n = found.feedforward.numerator();
    (0..2)
        .map(|j| {
            [1, 0].into_iter().flat_map(|p| n.coefficient(p).column(j).iter().copied().collect::<Vec<_>>()).collect()
        })
        .collect()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn noisy(entry: &Value) -> MatrixFrequencyData {
    let h = entry["H_11_12_21_22"]
        .as_array()
        .unwrap()
        .iter()
        .map(|line| {
            let entries = line.as_array().unwrap().iter().map(numbers).map(|v| Complex64::new(v[0], v[1]));
            DMatrix::from_row_iterator(2, 2, entries)
        })
        .collect();
    MatrixFrequencyData { omega_rad_s: example_angles(), h, variance: None }
}

/// `G̃ = 1/z` whatever the feedback (the thesis prints 1): the data do not determine it, and the report says so.
#[test]
fn example_4_1_is_confounded() {
    let plant = Plant {
        system: system(json!({"num": [1.0], "den": [1.0, 0.5], "sample_time_s": 1.0})),
        measured: vec![0],
        fed_back: vec![0],
    };
    let h = example_angles().iter().map(|w| DMatrix::from_element(1, 1, Complex64::from_polar(1.0, -w))).collect();
    let data = MatrixFrequencyData { omega_rad_s: example_angles(), h, variance: None };
    let pool = pool(json!([[[{"from": -1.0, "to": 1.0, "step": 0.1}]]]), json!(null), 0.0);
    let found = identify(&plant, &data, &settings(pool, 1), &Ctl::new()).unwrap();
    // Stable for −1.5 < k < 0.5; every one of these fits, and the first is taken.
    assert_eq!((found.listed, found.optimum.pool_size, found.optimum.near_optimal), (21, 15, 15));
    assert_eq!((found.optimum.index, static_gains(&found)), (0, vec![-1.0]));
    assert!(found.optimum.fit.cost < 1e-28);
    assert!(found.identifiability.separation.unwrap() < 1e-12, "{:?}", found.identifiability);
    assert!(found.findings.iter().any(|f| f.code == "feedback_not_determined"), "{:?}", found.findings);
    // Gff = 1 − k + (0.5 + k)/z, as the thesis' pairs k = 0.1 with (0.9 z + 0.6)/z and k = 0.2 with (0.8 z + 0.7)/z.
    let numerator = found.feedforward.numerator().entry(0, 0).coefficients().to_vec();
    assert!((numerator[0] - 2.0).abs() < 1e-12 && (numerator[1] + 0.5).abs() < 1e-12, "{numerator:?}");
    // The example of section 4.6 is determined.
    let found = identify(
        &example_plant(),
        &example_truth(&example_angles()),
        &settings(grid(json!([0.2, 0.3, 0.4, 1.0]), 0.0), 1),
        &Ctl::new(),
    )
    .unwrap();
    assert!(found.identifiability.separation.unwrap() > 1e-3, "{:?}", found.identifiability);
    assert!(!found.findings.iter().any(|f| f.code == "feedback_not_determined"), "{:?}", found.findings);
}

#[test]
fn example_4_2_is_recovered() {
    let golden = &golden()["ex4.2"];
    let settings = settings(grid(json!({"from": -0.5, "to": 1.5, "step": 0.1}), 0.0), 1);
    let found = identify(&example_plant(), &example_truth(&example_angles()), &settings, &Ctl::new()).unwrap();
    assert_eq!((found.listed, found.optimum.pool_size), (194_481, golden["M"].as_u64().unwrap()));
    assert_eq!(static_gains(&found), numbers(&golden["Nfb"]));
    assert!(found.optimum.fit.cost < 1e-27, "{}", found.optimum.fit.cost);
    assert!(found.cost_of_coefficients < 1e-27);
    assert_eq!(found.optimum.near_optimal, 1);
    for (found, expected) in beta(&found).iter().zip(golden["beta_cols"].as_array().unwrap()) {
        let expected = numbers(expected);
        assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-13), "{found:?} {expected:?}");
    }
    // det(zI + diag(0.1, −0.2) + K diag(1, −1)) = (z + 0.4)(z − 0.6) + 0.2
    let poles = &found.closed_loop_poles;
    assert_eq!(poles.len(), 2);
    for pole in poles {
        assert!(((pole + 0.4) * (pole - 0.6) + 0.2).norm() < 1e-13, "{pole}");
    }
}

#[test]
fn example_4_3_finds_the_same_candidates() {
    for entry in golden()["ex4.3"].as_array().unwrap() {
        let settings = settings(grid(json!({"from": -0.5, "to": 1.5, "step": 0.1}), 0.0), 1);
        let found = identify(&example_plant(), &noisy(entry), &settings, &Ctl::new()).unwrap();
        let i = entry["i"].as_u64().unwrap();
        let (gains, expected) = (static_gains(&found), numbers(&entry["Nfb"]));
        assert_eq!(gains, expected, "i = {i}");
        let cost = entry["J"].as_f64().unwrap();
        assert!((found.optimum.fit.cost / cost - 1.0).abs() < 1e-9, "i = {i}: {} {cost}", found.optimum.fit.cost);
        assert_eq!(gains == [0.3, 1.0, 0.2, 0.4], i >= 8, "exact from i = 8");
    }
}

#[test]
fn example_4_4_finds_the_same_candidates() {
    let golden = golden();
    let mut errors = Vec::new();
    for entry in golden["ex4.4"].as_array().unwrap() {
        let j = entry["j"].as_u64().unwrap();
        let axis = json!({"from": -0.5, "to": 1.5, "count": j + 2});
        for case in entry["cases"].as_array().unwrap() {
            let i = case["i"].as_u64().unwrap();
            let data = noisy(&golden["ex4.3"][(i - 1) as usize]);
            let settings = settings(grid(axis.clone(), -(0.99_f64.ln())), 1);
            let found = identify(&example_plant(), &data, &settings, &Ctl::new()).unwrap();
            assert_eq!(found.optimum.pool_size, entry["M"].as_u64().unwrap(), "j = {j}");
            let (gains, expected) = (static_gains(&found), numbers(&case["Nfb"]));
            assert!(
                gains.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-9),
                "j = {j}, i = {i}: {gains:?} {expected:?}"
            );
            let cost = case["J"].as_f64().unwrap();
            assert!(
                (found.optimum.fit.cost / cost - 1.0).abs() < 1e-9,
                "j = {j}, i = {i}: {} {cost}",
                found.optimum.fit.cost
            );
            if i == 15 {
                let truth = [0.3, 1.0, 0.2, 0.4];
                errors.push(gains.iter().zip(truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt());
            }
        }
    }
    // Theorem 4.2: with little noise the densest pools come close.
    assert!(errors[17] < 0.2 && errors[..4].iter().all(|e| *e > 0.4), "{errors:?}");
}

// ---- Refusals ------------------------------------------------------------------------------------------------------

#[test]
fn what_cannot_be_identified_is_refused_with_the_reason() {
    let truth = example_truth(&example_angles());
    let small = || grid(json!([0.2, 0.4]), 0.0);
    let refused = |plant: &Plant, data: &MatrixFrequencyData, settings: &Settings, words: &str| {
        let error = identify(plant, data, settings, &Ctl::new()).unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
        error
    };
    let one_row = pool(json!([[[[0.1]], [[0.1]]]]), json!(null), 0.0);
    refused(&example_plant(), &truth, &settings(one_row, 1), "is 1x2, and must be 2x2");
    let mut ragged = truth.clone();
    ragged.h[3] = DMatrix::zeros(2, 3);
    refused(&example_plant(), &ragged, &settings(small(), 1), "line 3 (counted from 0) is 2x3, and must be 2x2");
    refused(
        &example_plant(),
        &truth,
        &Settings { max_candidates: 15, ..settings(small(), 1) },
        "lists 16 feedback candidates, and at most 15",
    );
    let few =
        MatrixFrequencyData { omega_rad_s: truth.omega_rad_s[..2].to_vec(), h: truth.h[..2].to_vec(), variance: None };
    refused(&example_plant(), &few, &settings(small(), 4), "2 frequency lines do not determine the 3 coefficients");
    refused(&example_plant(), &few, &settings(small(), 3), "2 usable frequency lines give 16 equations for 20 unknown");
    let huge = grid(json!([20.0, 30.0]), 0.0);
    let error =
        refused(&example_plant(), &truth, &settings(huge, 1), "none of the 16 feedback candidates has a stable");
    assert!(matches!(error, MimoError::NoneStable { ref hidden, .. } if hidden.is_empty()), "{error}");
    let mut plant = example_plant();
    plant.fed_back = vec![0, 2];
    refused(&plant, &truth, &settings(small(), 1), "fed_back_outputs names output 2");
    plant.fed_back = vec![1, 1];
    refused(&plant, &truth, &settings(small(), 1), "twice");
    // One output for two controls.
    plant = Plant { measured: vec![0], ..example_plant() };
    let narrow =
        MatrixFrequencyData { h: truth.h.iter().map(|h| h.rows(0, 1).into_owned()).collect(), ..truth.clone() };
    refused(&plant, &narrow, &settings(small(), 1), "Gy is 1x2");
    // Both outputs show the same: the plant is singular at every line.
    let singular = system(json!({"numerator": [[[1.0], [1.0]], [[2.0], [2.0]]],
        "denominator": [[[1.0, 0.1], [0.0]], [[0.0], [1.0, -0.2]]], "sample_time_s": 1.0}));
    plant = Plant { system: singular, ..example_plant() };
    refused(&plant, &truth, &settings(small(), 1), "does not have full column rank");
    // A mode outside the unit circle that no output shows.
    let hidden =
        system(json!({"a": [[0.5, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 1.5]], "b": [[1, 0], [0, 1], [1, 1]],
        "c": [[1, 0, 0], [0, 1, 0]], "d": [[0, 0], [0, 0]], "sample_time_s": 1.0}));
    plant = Plant { system: hidden, ..example_plant() };
    refused(&plant, &truth, &settings(small(), 1), "modes at z = 1.5000");
    // No delay anywhere in the loop.
    let direct =
        system(json!({"a": [[0.5]], "b": [[1, 1]], "c": [[1], [2]], "d": [[1, 0], [0, 1]], "sample_time_s": 1.0}));
    plant = Plant { system: direct, ..example_plant() };
    refused(&plant, &truth, &settings(small(), 1), "strictly proper");
    let mut weighted = settings(small(), 1);
    weighted.weights = Weights::InverseVariance;
    refused(&example_plant(), &truth, &weighted, "no variance");
}

#[test]
fn a_line_on_a_pole_is_left_out_and_named() {
    // An integrator in the first channel, data from 0 Hz on.
    let integrator = system(json!({"transfer_functions": [
        [{"num": [1.0], "den": [1.0, -1.0]}, {"num": [0.0], "den": [1.0]}],
        [{"num": [0.0], "den": [1.0]}, {"num": [-1.0], "den": [1.0, -0.2]}],
    ], "sample_time_s": 1.0}));
    let plant = Plant { system: integrator, ..example_plant() };
    let real = |rows: [f64; 4]| DMatrix::from_row_slice(2, 2, &rows).map(|v| Complex64::new(v, 0.0));
    let omega: Vec<f64> = (0..12).map(|k| 0.2 * f64::from(k)).collect();
    let h = omega
        .iter()
        .map(|w| match plant.system.eval(Complex64::from_polar(1.0, *w)) {
            Some(g) if *w > 0.0 => closed_loop(&g, &g, &real([1.0, 0.2, 0.0, 0.5]), &real([0.8, 0.1, 0.1, -0.3])),
            _ => DMatrix::identity(2, 2),
        })
        .collect();
    let data = MatrixFrequencyData { omega_rad_s: omega, h, variance: None };
    let pool = pool(json!([[[[0.7, 0.8, 0.9]], [[0.0, 0.1]]], [[[0.0, 0.1]], [[-0.4, -0.3]]]]), json!(null), 0.0);
    let found = identify(&plant, &data, &settings(pool, 0), &Ctl::new()).unwrap();
    assert_eq!(static_gains(&found), [0.8, 0.1, 0.1, -0.3]);
    assert_eq!((found.lines.len(), found.dropped.len()), (11, 1));
    assert!(found.findings.iter().any(|f| f.code == "line_on_plant_pole"), "{:?}", found.findings);
}

#[test]
fn a_stopped_search_stops() {
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    let settings = settings(grid(json!({"from": -0.5, "to": 1.5, "step": 0.1}), 0.0), 1);
    let stopped = identify(&example_plant(), &example_truth(&example_angles()), &settings, &ctl);
    assert!(matches!(stopped, Err(MimoError::Stopped(_))), "{stopped:?}");
    let ctl = Ctl::new();
    identify(&example_plant(), &example_truth(&example_angles()), &settings, &ctl).unwrap();
    assert_eq!(ctl.progress().done, 194_481);
}
