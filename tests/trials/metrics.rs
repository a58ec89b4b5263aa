//! Learning: metrics of trials, distances from the inverse dynamics, curves and groups.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use volition::control::model::{StateSpaceModel, TransferFunctionModel};
use volition::control::{Continuous, Discrete, Model, System, TransferFunction};
use volition::learning::frequency_domain::{MetricsError, controller_metrics};
use volition::learning::time_domain::{InitialDirection, NoDirection, initial_direction, metrics};
use volition::trial::gzip::GzipReader;
use volition::trial::{Signals, Trial, csv};

fn tf(num: &[f64], den: &[f64]) -> Model {
    Model::TransferFunction(TransferFunctionModel {
        num: num.to_vec(),
        den: den.to_vec(),
        sample_time_s: None,
        delay_s: None,
    })
}

fn continuous(num: &[f64], den: &[f64]) -> System {
    System::Continuous(TransferFunction::new(num, den, Continuous).unwrap())
}

fn sampled(num: &[f64], den: &[f64], period: f64) -> System {
    System::Discrete(TransferFunction::new(num, den, Discrete::new(period).unwrap()).unwrap())
}

fn trial(r: &[f64], u: &[f64], y: &[f64]) -> Trial {
    let signals =
        Signals { time_s: None, command: r.to_vec(), control: u.to_vec(), output: y.to_vec(), disturbance: None };
    Trial::new(0.5, signals).unwrap()
}

// Zhang 2015, equations 5.4 and 5.5.
fn minimum_phase() -> Model {
    tf(&[2.0, 4.4], &[1.0, 3.6, 4.0])
}
fn nonminimum_phase() -> Model {
    tf(&[-2.0, 4.4], &[1.0, 3.6, 4.0])
}

#[test]
fn errors_of_a_trial_computed_by_hand() {
    let m = metrics(&trial(&[1.0, 2.0, 3.0, 0.0], &[0.0; 4], &[0.0, 4.0, 3.0, -5.0]), &minimum_phase());
    assert_eq!(m.mean_abs_error, 2.0);
    assert!((m.rms_error - (30.0_f64 / 4.0).sqrt()).abs() < 1e-15);
    assert_eq!(m.max_abs_output, 5.0);
}

#[test]
fn metrics_of_extreme_recordings_are_finite() {
    let m = metrics(&trial(&[f64::MAX, 0.0], &[0.0; 2], &[f64::MIN, 0.0]), &minimum_phase());
    assert!(m.mean_abs_error.is_finite() && m.rms_error.is_finite() && m.max_abs_output == f64::MAX);
    let m = metrics(&trial(&[1e-200, 1e-200], &[0.0; 2], &[0.0, 0.0]), &minimum_phase());
    assert!((m.rms_error / 1e-200 - 1.0).abs() < 1e-15, "squares must not vanish: {}", m.rms_error);
    let m = metrics(&trial(&[0.0; 2], &[0.0; 2], &[0.0; 2]), &minimum_phase());
    assert_eq!((m.mean_abs_error, m.rms_error), (0.0, 0.0));
}

#[test]
fn right_control_at_start_follows_the_plant() {
    // The sample at time zero is not looked at; |u| passes 0.05 first at sample 2; sample 3 is judged.
    let r = [0.0, 0.1, 0.2, 0.3];
    let right = |u: &[f64], plant: &Model| {
        let m = metrics(&trial(&r, u, &[0.0; 4]), plant);
        assert_eq!(m.right_control_at_start.is_none(), m.right_control_undetermined.is_some());
        (m.right_control_at_start, m.right_control_time_s)
    };
    assert_eq!(right(&[9.0, 0.05, 0.06, 0.2], &minimum_phase()), (Some(true), Some(1.5)));
    assert_eq!(right(&[9.0, 0.05, 0.06, -0.2], &minimum_phase()), (Some(false), Some(1.5)));
    assert_eq!(right(&[9.0, 0.05, 0.06, 0.2], &nonminimum_phase()), (Some(false), Some(1.5)));
    assert_eq!(right(&[9.0, 0.05, -0.06, -0.2], &nonminimum_phase()), (Some(true), Some(1.5)));
}

#[test]
fn an_undetermined_start_says_why() {
    let why = |r: &[f64], u: &[f64], plant: &Model| {
        let m = metrics(&trial(r, u, &vec![0.0; r.len()]), plant);
        assert_eq!(m.right_control_at_start, None);
        m.right_control_undetermined.unwrap()
    };
    let g = minimum_phase();
    assert!(why(&[1.0; 3], &[1.0, 0.05, -0.05], &g).contains("never passes"));
    assert!(why(&[1.0; 3], &[0.0, 0.0, 1.0], &g).contains("last sample"));
    assert!(why(&[0.0; 3], &[0.0, 1.0, 1.0], &g).contains("command r"));
    assert!(why(&[1.0; 3], &[0.0, 1.0, 0.0], &g).contains("control u"));
    assert!(why(&[1.0; 3], &[0.0, 1.0, 1.0], &tf(&[0.0], &[1.0, 1.0])).contains("never answers"));
    let mimo = Model::StateSpace(StateSpaceModel {
        a: vec![vec![-1.0]],
        b: vec![vec![1.0, 1.0]],
        c: vec![vec![1.0]],
        d: vec![vec![0.0, 0.0]],
        sample_time_s: None,
    });
    assert!(why(&[1.0; 3], &[0.0, 1.0, 1.0], &mimo).contains("2 inputs"));
}

#[test]
fn the_initial_direction_is_the_same_in_both_forms() {
    // Controllable canonical form of (b1 s + b0)/(s^2 + 3.6 s + 4).
    let ss = |b1: f64, b0: f64| {
        Model::StateSpace(StateSpaceModel {
            a: vec![vec![-3.6, -4.0], vec![1.0, 0.0]],
            b: vec![vec![1.0], vec![0.0]],
            c: vec![vec![b1, b0]],
            d: vec![vec![0.0]],
            sample_time_s: None,
        })
    };
    for (b1, b0, expected) in [
        (2.0, 4.4, InitialDirection::Along),
        (-2.0, 4.4, InitialDirection::Against),
        (0.0, 4.4, InitialDirection::Along),
        (0.0, -4.4, InitialDirection::Against),
        // Rounding in the leading coefficient must not decide.
        (-1e-17, 4.4, InitialDirection::Along),
    ] {
        assert_eq!(initial_direction(&ss(b1, b0)), Ok(expected), "{b1} {b0}");
        if b1.abs() != 1e-17 {
            assert_eq!(initial_direction(&tf(&[b1, b0], &[1.0, 3.6, 4.0])), Ok(expected));
            assert_eq!(initial_direction(&tf(&[-b1, -b0], &[-1.0, -3.6, -4.0])), Ok(expected));
        }
    }
    assert_eq!(initial_direction(&ss(0.0, 0.0)), Err(NoDirection::Silent));
}

#[test]
fn norms_of_constant_controllers() {
    let m = controller_metrics(
        &continuous(&[2.0], &[1.0]),
        &continuous(&[3.0], &[1.0]),
        &continuous(&[-7.0], &[1.0]),
        (0.2 * PI, 0.8 * PI),
    )
    .unwrap();
    assert!((m.norm_feedback.unwrap() - 7.0).abs() < 1e-12);
    assert!((m.norm_feedforward_minus_inverse.unwrap() - 2.5).abs() < 1e-12);
    assert!((m.norm_feedforward_plant_minus_one.unwrap() - 5.0).abs() < 1e-12);
    assert!(m.undefined.is_empty());
}

#[test]
fn the_exact_inverse_has_no_distance() {
    let m = controller_metrics(
        &continuous(&[-2.0, 4.4], &[1.0, 3.6, 4.0]),
        &continuous(&[1.0, 3.6, 4.0], &[-2.0, 4.4]),
        &continuous(&[1.0], &[1.0, 1.0]),
        (0.0, PI),
    )
    .unwrap();
    assert!(m.norm_feedforward_minus_inverse.unwrap() < 1e-14);
    assert!(m.norm_feedforward_plant_minus_one.unwrap() < 1e-14);
    // 1/π ∫ dω/√(1+ω²) = asinh(π)/π
    assert!((m.norm_feedback.unwrap() - PI.asinh() / PI).abs() < 1e-10);
}

#[test]
fn norms_against_analytic_integrals() {
    // G = 1/(s+a), Gff = k: |Gff − G⁻¹| = |k − a − jω|, |Gff G − 1| = |k − a − jω|/√(a²+ω²).
    let (a, k, from, to) = (1.5_f64, 1.5_f64, 0.5_f64, 3.0_f64);
    let m = controller_metrics(
        &continuous(&[1.0], &[1.0, a]),
        &continuous(&[k], &[1.0]),
        &continuous(&[1.0, 0.0], &[1.0]),
        (from, to),
    )
    .unwrap();
    let mean_omega = 0.5 * (from + to);
    assert!((m.norm_feedback.unwrap() - mean_omega).abs() < 1e-12);
    assert!((m.norm_feedforward_minus_inverse.unwrap() - mean_omega).abs() < 1e-12);
    let exact = ((a * a + to * to).sqrt() - (a * a + from * from).sqrt()) / (to - from);
    assert!((m.norm_feedforward_plant_minus_one.unwrap() - exact).abs() < 1e-10);
}

#[test]
fn norms_of_sampled_systems_use_the_unit_circle() {
    // |1 + e^{-jωT}| = 2 cos(ωT/2); over [0, π/T] its mean is 4/π.
    let period = 0.02;
    let one = sampled(&[1.0], &[1.0], period);
    let m = controller_metrics(&one, &one, &sampled(&[1.0, 1.0], &[1.0, 0.0], period), (0.0, PI / period)).unwrap();
    assert!((m.norm_feedback.unwrap() - 4.0 / PI).abs() < 1e-9);
    let beyond = controller_metrics(&one, &one, &one, (0.0, 1.01 * PI / period));
    assert!(matches!(beyond, Err(MetricsError::AboveNyquist { .. })), "{beyond:?}");
}

#[test]
fn a_sampled_inverse_with_huge_coefficients_has_norms() {
    // Found by the demonstration: an FIR feedforward of degree 6, as identified behind a nonminimum-phase plant at 50
    // Hz, whose coefficients of 1e8 cancel to about 1.
    let num = [-1.57e7, 9.56e7, -2.42e8, 3.28e8, -2.5e8, 1.01e8, -1.689_999_95e7];
    let delay = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let one = sampled(&[1.0], &[1.0], 0.02);
    let m = controller_metrics(&one, &sampled(&num, &delay, 0.02), &one, (0.0, PI)).unwrap();
    assert!(m.undefined.is_empty(), "{:?}", m.undefined);
    // A second method: the mean of the modulus by the trapezoidal rule, the polynomial written in powers of z − 1,
    // whose coefficients (repeated synthetic division; sums of integers below 2^53 times 0.05, exact) do not cancel.
    let mut shifted: Vec<i64> = num.iter().map(|c| (c * 20.0).round() as i64).collect();
    for last in (1..shifted.len()).rev() {
        for i in 1..=last {
            shifted[i] += shifted[i - 1];
        }
    }
    let value = |omega: f64| {
        let half = omega * 0.01;
        let delta = num_complex::Complex64::from_polar(2.0 * half.sin(), half + 0.5 * PI);
        let sum = shifted.iter().fold(num_complex::Complex64::new(0.0, 0.0), |s, c| s * delta + *c as f64 / 20.0);
        (sum * num_complex::Complex64::from_polar(1.0, -6.0 * 2.0 * half) - 1.0).norm()
    };
    let n = 20_000;
    let sum: f64 = (1..n).map(|i| value(PI * f64::from(i) / f64::from(n))).sum();
    let exact = (sum + 0.5 * (value(0.0) + value(PI))) / f64::from(n);
    let found = m.norm_feedforward_plant_minus_one.unwrap();
    assert!((found / exact - 1.0).abs() < 1e-6, "{found} {exact}");
}

#[test]
fn an_integrating_plant_is_invertible_at_zero_but_not_finite() {
    let integrator = continuous(&[1.0], &[1.0, 0.0]);
    let lag = continuous(&[1.0], &[1.0, 1.0]);
    let m = controller_metrics(&integrator, &lag, &lag, (0.0, PI)).unwrap();
    assert!(m.norm_feedforward_minus_inverse.is_some() && m.norm_feedback.is_some());
    assert_eq!(m.norm_feedforward_plant_minus_one, None);
    assert_eq!(m.undefined.len(), 1);
    assert_eq!(m.undefined[0].field, "norm_feedforward_plant_minus_one");
    // A feedforward that vanishes at zero cancels the integrator: s/(s+1)·1/s − 1 = −s/(s+1).
    let m = controller_metrics(&integrator, &continuous(&[1.0, 0.0], &[1.0, 1.0]), &lag, (0.0, PI)).unwrap();
    let exact = ((1.0 + PI * PI).sqrt() - 1.0) / PI;
    assert!((m.norm_feedforward_plant_minus_one.unwrap() - exact).abs() < 1e-9);
}

#[test]
fn a_plant_zero_in_the_band_makes_the_inverse_infinite() {
    let notch = continuous(&[1.0, 0.0, 1.0], &[1.0, 2.0, 1.0]);
    let one = continuous(&[1.0], &[1.0]);
    let m = controller_metrics(&notch, &one, &one, (0.5, 2.0)).unwrap();
    assert_eq!(m.norm_feedforward_minus_inverse, None);
    assert!(m.undefined[0].reason.contains("1.0000"), "{:?}", m.undefined);
    assert!(m.norm_feedforward_plant_minus_one.is_some());
}

#[test]
fn bands_and_time_bases_that_make_no_sense_are_refused() {
    let one = continuous(&[1.0], &[1.0]);
    for band in [(1.0, 1.0), (2.0, 1.0), (-1.0, 1.0), (0.0, f64::INFINITY), (f64::NAN, 1.0)] {
        assert!(matches!(controller_metrics(&one, &one, &one, band), Err(MetricsError::BadBand { .. })), "{band:?}");
    }
    let found = controller_metrics(&one, &one, &sampled(&[1.0], &[1.0], 0.1), (0.0, 1.0));
    assert_eq!(found, Err(MetricsError::MixedTimeBases { part: "feedback", found: Some(0.1), expected: None }));
}

#[derive(serde::Deserialize)]
struct Truth {
    file: String,
    group: String,
    divergent: bool,
    mean_abs_error: f64,
    display_limit: f64,
    plant_num: Vec<f64>,
    plant_den: Vec<f64>,
}

#[test]
fn metrics_of_the_virtual_subjects_equal_their_truth() {
    let folder = crate::virtual_subjects::folder();
    let text = std::fs::read_to_string(folder.join("truth.json")).unwrap();
    let truths: Vec<Truth> = serde_json::from_str(&text).unwrap();
    assert_eq!(truths.len(), 60);
    let mut right = BTreeMap::new();
    for truth in &truths {
        let file = std::fs::File::open(folder.join(&truth.file)).unwrap();
        let trial = csv::read(GzipReader::new(file), &csv::Options::default()).unwrap().trial;
        let m = metrics(&trial, &tf(&truth.plant_num, &truth.plant_den));
        // The files are printed with five decimals, so a mean of many rounded values is within half of the last one.
        assert!((m.mean_abs_error - truth.mean_abs_error).abs() < 5e-6, "{}: {m:?}", truth.file);
        assert_eq!(m.max_abs_output > truth.display_limit, truth.divergent, "{}", truth.file);
        let count: &mut (usize, usize) = right.entry(truth.group.clone()).or_default();
        count.0 += usize::from(m.right_control_at_start == Some(true));
        count.1 += usize::from(m.right_control_at_start.is_some());
    }
    eprintln!("right control at start, of those that can be said: {right:?}");
}
