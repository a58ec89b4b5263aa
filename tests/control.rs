//! Public behaviour of `control`: conversions, discretisation, stability tests, closed loops and their simulation.
#![allow(clippy::unwrap_used)]

use num_complex::Complex64;
use volition::control::bode::log_grid;
use volition::control::simulate::{self, Hold};
use volition::control::{
    Continuous, Discrete, Model, ModelError, StateSpace, TransferFunction, TwoDegreesOfFreedom, conversion, discretise,
};
use volition::plants::catalogue::{self, Plant};

fn tf(num: &[f64], den: &[f64]) -> TransferFunction<Continuous> {
    TransferFunction::new(num, den, Continuous).unwrap()
}

fn model(json: &str) -> Result<Model, String> {
    serde_json::from_str(json).map_err(|e| e.to_string())
}

#[test]
fn a_model_is_read_in_either_form_and_keeps_it() {
    let text = r#"{"num":[2.0,4.4],"den":[1.0,3.6,4.0],"sample_time_s":null}"#;
    assert_eq!(serde_json::to_string(&model(text).unwrap()).unwrap(), text);
    let text = r#"{"a":[[0.0]],"b":[[1.0]],"c":[[1.0]],"d":[[0.0]],"sample_time_s":0.5}"#;
    assert_eq!(serde_json::to_string(&model(text).unwrap()).unwrap(), text);
    assert!(model(r#"{"num":[1],"den":[1,0]}"#).is_ok(), "the sample time may be left out");
}

#[test]
fn a_model_that_is_incomplete_says_what_it_has() {
    let error = model(r#"{"num": [1]}"#).unwrap_err();
    assert!(error.contains("either num and den") && error.contains("this one has num"), "{error}");
    let error = model(r#"{"num": [1], "den": [1], "a": [[1]]}"#).unwrap_err();
    assert!(error.contains("this one has num, den, a"), "{error}");
    let error = model("{}").unwrap_err();
    assert!(error.contains("neither"), "{error}");
    let error = model(r#"{"num": [1], "den": [1], "gain": 2}"#).unwrap_err();
    assert!(error.contains("gain"), "{error}");
}

#[test]
fn a_ragged_or_misshapen_model_quotes_its_sizes() {
    let error = model(r#"{"a":[[1,2],[3]],"b":[[1],[1]],"c":[[1,0]],"d":[[0]]}"#).unwrap().shape().unwrap_err();
    assert_eq!(error, ModelError::Ragged { matrix: "A", row: 1, columns: 1, expected: 2 });
    let error = model(r#"{"a":[[1,2],[3,4]],"b":[[1],[1],[1]],"c":[[1,0]],"d":[[0]]}"#).unwrap().check().unwrap_err();
    let text = error.to_string();
    assert!(text.contains("B is 3x1 and must be 2x1"), "{text}");
    let error = model(r#"{"num":[1],"den":[1,1],"sample_time_s":0}"#).unwrap().check().unwrap_err();
    assert!(matches!(error, ModelError::SampleTime(_)), "{error}");
}

#[test]
fn a_model_with_several_inputs_has_a_shape_and_no_transfer_function() {
    let m = model(r#"{"a":[[-1,0],[0,-2]],"b":[[1,0],[0,1]],"c":[[1,1]],"d":[[0,0]]}"#).unwrap();
    let shape = m.shape().unwrap();
    assert_eq!((shape.states, shape.inputs, shape.outputs), (2, 2, 1));
    let error = m.check().unwrap_err();
    assert_eq!(error, ModelError::Conversion(conversion::ConversionError::NotSingle { inputs: 2, outputs: 1 }));
}

#[test]
fn a_static_gain_may_be_written_without_states() {
    let m = model(r#"{"a":[],"b":[],"c":[],"d":[[2.5]]}"#).unwrap();
    assert_eq!(m.shape().unwrap().states, 0);
    assert_eq!(m.check().unwrap().response(3.0), Complex64::new(2.5, 0.0));
}

#[test]
fn the_catalogue_converts_to_state_space_and_back() {
    for plant in Plant::ALL {
        let g = plant.transfer_function();
        let back = conversion::to_transfer_function(&conversion::to_state_space(&g).unwrap()).unwrap();
        assert_eq!(back.num().degree(), g.num().degree(), "{}", plant.name());
        for omega in log_grid(0.01, 100.0, 50) {
            let scale = g.num().leading() / g.den().leading();
            assert!((back.response(omega) - g.response(omega)).norm() < 1e-11 * g.response(omega).norm());
            assert!(scale.is_finite());
        }
    }
}

/// Two masses by their own equations of motion (Zhang 2015, equations 3.1–3.3), states x, y, ẋ, ẏ.
#[test]
fn two_masses_by_their_equations_of_motion_have_the_printed_transfer_function() {
    use std::f64::consts::PI;
    let (m1, m2, c1, c2, k1, k2) = (1.0, 0.5, 0.56 * PI, 0.5 * PI, 0.16 * PI * PI, 0.5 * PI * PI);
    let a = nalgebra::DMatrix::from_row_slice(
        4,
        4,
        &[
            0.0,
            0.0,
            1.0,
            0.0, //
            0.0,
            0.0,
            0.0,
            1.0, //
            -(k1 + k2) / m1,
            k2 / m1,
            -(c1 + c2) / m1,
            c2 / m1, //
            k2 / m2,
            -k2 / m2,
            c2 / m2,
            -c2 / m2,
        ],
    );
    let b = nalgebra::DMatrix::from_row_slice(4, 1, &[0.0, 0.0, 0.0, 1.0 / m2]);
    let c = nalgebra::DMatrix::from_row_slice(1, 4, &[0.0, 1.0, 0.0, 0.0]);
    let d = nalgebra::DMatrix::zeros(1, 1);
    let mechanics = StateSpace::new(a, b, c, d, Continuous).unwrap();
    let converted = conversion::to_transfer_function(&mechanics).unwrap();
    let printed = catalogue::two_mass();
    let monic = printed.den().leading();
    for (x, y) in converted.den().coefficients().iter().zip(printed.den().coefficients()) {
        assert!((x - y / monic).abs() < 1e-12 * y.abs(), "{x} {y}");
    }
    assert_eq!(converted.num().degree(), 2);
    for (x, y) in converted.num().coefficients().iter().zip(printed.num().coefficients()) {
        assert!((x - y / monic).abs() < 1e-12 * y.abs(), "{x} {y}");
    }
}

#[test]
fn zero_order_hold_of_an_integrator_and_a_lag_is_the_textbook_one() {
    let time = Discrete::new(0.1).unwrap();
    let integrator = discretise::zero_order_hold(&catalogue::integrator(), time).unwrap();
    assert_eq!(integrator.den().coefficients(), [1.0, -1.0]);
    assert!((integrator.num().coefficients()[0] - 0.1).abs() < 1e-16);
    let lag = discretise::zero_order_hold(&tf(&[3.0], &[1.0, 2.0]), time).unwrap();
    let pole = (-0.2_f64).exp();
    assert!((lag.den().coefficients()[1] + pole).abs() < 1e-15);
    assert!((lag.num().coefficients()[0] - 1.5 * (1.0 - pole)).abs() < 1e-15);
}

#[test]
fn a_closed_loop_with_inverse_dynamics_tracks() {
    let g = catalogue::minimum_phase();
    let inverse = tf(&[1.0, 3.6, 4.0], &[2.0, 4.4]);
    let closed = TwoDegreesOfFreedom::new(g, inverse, tf(&[0.7], &[0.1, 1.0])).unwrap();
    for omega in log_grid(0.01, 100.0, 30) {
        assert!((closed.command_to_output(omega) - 1.0).norm() < 1e-12);
        assert!(closed.command_to_error(omega).norm() < 1e-12);
    }
    assert!(closed.is_stable(0.0));
}

#[test]
fn a_first_order_hold_of_a_ramp_is_exact() {
    // y' = r with r = t: y = t²/2 at the samples.
    let time = Discrete::new(0.25).unwrap();
    let ramp: Vec<f64> = (0..9).map(|i| 0.25 * f64::from(i)).collect();
    let y = simulate::sampled_response(&catalogue::integrator(), &ramp, time, Hold::First).unwrap();
    for (t, y) in ramp.iter().zip(y) {
        assert!((y - t * t / 2.0).abs() < 1e-14);
    }
}
