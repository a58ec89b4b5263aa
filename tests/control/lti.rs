//! Public behaviour of `control`: conversions, discretisation, stability tests, closed loops and their simulation.

use num_complex::Complex64;
use volition::control::bode::log_grid;
use volition::control::conversion::ConversionError;
use volition::control::discretise::DiscretiseError;
use volition::control::simulate::SimulationError;
use volition::control::simulate::{self, Hold};
use volition::control::{
    Continuous, Discrete, Model, ModelError, StateSpace, TransferFunction, conversion, discretise,
};
use volition::person::two_degrees_of_freedom::{LoopError, TwoDegreesOfFreedom};
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
    assert_eq!(error, ModelError::Conversion(ConversionError::NotSingle { inputs: 2, outputs: 1 }));
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
            assert!((back.response(omega) - g.response(omega)).norm() < 1e-11 * g.response(omega).norm());
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

#[test]
fn coefficients_that_are_no_numbers_or_too_large_are_refused_when_read() {
    assert!(model(r#"{"num":[1e999],"den":[1]}"#).unwrap_err().contains("out of range"));
    assert!(model(r#"{"num":["1"],"den":[1]}"#).unwrap_err().contains("expected f64"));
    assert!(model(r#"{"num":[null],"den":[1]}"#).unwrap_err().contains("null"));
    let zero = model(r#"{"num":[1],"den":[0,0]}"#).unwrap().check().unwrap_err();
    assert_eq!(zero.to_string(), "the denominator is zero");
}

#[test]
fn an_improper_system_has_no_state_space_and_no_samples() {
    let pd = tf(&[1.0, 2.0, 3.0], &[1.0, 5.0]);
    let improper = ConversionError::Improper { num_degree: 2, den_degree: 1 };
    assert_eq!(conversion::to_state_space(&pd).unwrap_err(), improper);
    let time = Discrete::new(0.1).unwrap();
    let refused = DiscretiseError::Improper { num_degree: 2, den_degree: 1 };
    assert_eq!(discretise::zero_order_hold(&pd, time).unwrap_err(), refused);
    assert_eq!(discretise::tustin(&pd, time).unwrap_err(), refused);
    assert_eq!(discretise::matched(&pd, time).unwrap_err(), refused);
}

#[test]
fn a_hidden_unstable_mode_stays_visible() {
    // The mode at +1 is not driven: the transfer function keeps it in both polynomials.
    let m = model(r#"{"a":[[-2,0],[0,1]],"b":[[1],[0]],"c":[[1,1]],"d":[[0]]}"#).unwrap().check().unwrap();
    assert_eq!(m.den().degree(), 2);
    assert!(m.poles().unwrap().iter().any(|p| (p - 1.0).norm() < 1e-12));
    assert!((m.response(3.0) - 1.0 / Complex64::new(2.0, 3.0)).norm() < 1e-14);
}

#[test]
fn sampling_that_no_coefficients_can_represent_is_refused() {
    let time = Discrete::new(1e-5).unwrap();
    let error = discretise::zero_order_hold(&catalogue::two_mass(), time).unwrap_err();
    assert!(matches!(error, DiscretiseError::IllConditioned { .. }), "{error}");
    // By states there is no such limit.
    let states = conversion::to_state_space(&catalogue::two_mass()).unwrap().balanced();
    let sampled = discretise::zero_order_hold_state_space(&states, time).unwrap();
    let g = catalogue::two_mass().response(2.0);
    let delay = Complex64::from_polar(1.0, -1e-5);
    assert!((sampled.response(2.0).unwrap()[(0, 0)] - g * delay).norm() < 1e-9 * g.norm());
}

#[test]
fn a_pole_at_twice_the_rate_has_no_tustin_image() {
    let error = discretise::tustin(&tf(&[1.0], &[1.0, -4.0]), Discrete::new(0.5).unwrap()).unwrap_err();
    assert_eq!(error, DiscretiseError::PoleAtInfinity { pole: 4.0 });
}

#[test]
fn zero_pole_matching_of_an_integrator_keeps_its_slope() {
    let time = Discrete::new(0.1).unwrap();
    let sampled = discretise::matched(&catalogue::damped_double_integrator(), time).unwrap();
    // y grows by T each T under a unit input once the lag has settled: (z − 1) G(z) → T at z = 1.
    let pole = (-0.1_f64).exp();
    assert_eq!(sampled.num().degree(), 1, "one zero at infinity stays, one goes to -1");
    let slope = sampled.num().eval(Complex64::new(1.0, 0.0)).re / (1.0 - pole);
    assert!((slope - 0.1).abs() < 1e-12, "{slope}");
    assert!(sampled.num().eval(Complex64::new(-1.0, 0.0)).norm() < 1e-15);
}

#[test]
fn a_filter_keeps_its_digits_with_poles_close_to_one() {
    // 1/(z − p)⁴ with p = 1 − 2⁻⁹: the coefficients are exact, and the impulse response is C(k−1, 3) p^(k−4).
    let p = 1.0 - 0.5_f64.powi(9);
    let den = [1.0, -4.0 * p, 6.0 * p * p, -4.0 * p * p * p, p * p * p * p];
    let system = TransferFunction::new(&[1.0], &den, Discrete::new(0.002).unwrap()).unwrap();
    let mut impulse = vec![0.0; 4_000];
    impulse[0] = 1.0;
    let ours = simulate::filter(&system, &impulse).unwrap();
    let mut plain = vec![0.0; 4_000];
    let mut worst_of_plain = 0.0_f64;
    for k in 4..4_000 {
        let n = k as f64;
        let exact = (n - 1.0) * (n - 2.0) * (n - 3.0) / 6.0 * (p.ln() * (n - 4.0)).exp();
        assert!((ours[k] - exact).abs() < 1e-12 * exact, "{k}: {} {exact}", ours[k]);
        plain[k] = impulse[k - 4]
            - den[1] * plain[k - 1]
            - den[2] * plain[k - 2]
            - den[3] * plain[k - 3]
            - den[4] * plain[k - 4];
        worst_of_plain = worst_of_plain.max((plain[k] - exact).abs() / exact);
    }
    assert!(worst_of_plain > 1e-9, "plain recursion would have done: {worst_of_plain}");
}

#[test]
fn filtering_a_plant_sampled_at_500_hz_agrees_with_its_states() {
    let time = Discrete::new(0.002).unwrap();
    let g = catalogue::two_mass();
    let coefficients = discretise::zero_order_hold(&g, time).unwrap();
    let input: Vec<f64> = (0..20_000).map(|k| (1e-3 * f64::from(k)).sin()).collect();
    let filtered = simulate::filter(&coefficients, &input).unwrap();
    let exact = simulate::sampled_response(&g, &input, time, Hold::Zero).unwrap();
    let error = filtered.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(error < 1e-5, "{error}: what rounding the coefficients costs, and no more");
}

#[test]
fn a_filter_that_needs_the_future_or_explodes_says_so() {
    let time = Discrete::new(1.0).unwrap();
    let improper = TransferFunction::new(&[1.0, 0.0], &[1.0], time).unwrap();
    let error = simulate::filter(&improper, &[1.0]).unwrap_err();
    assert_eq!(error, SimulationError::Improper { system: "transfer function", num_degree: 1, den_degree: 0 });
    let unstable = TransferFunction::new(&[1.0], &[1.0, -1e200], time).unwrap();
    assert_eq!(simulate::filter(&unstable, &[1.0; 5]).unwrap_err(), SimulationError::Overflow { sample: 3 });
    let finite_impulse = TransferFunction::new(&[0.5, 0.25, 0.25], &[1.0, 0.0, 0.0], time).unwrap();
    assert_eq!(simulate::filter(&finite_impulse, &[1.0, 0.0, 2.0, 0.0]).unwrap(), [0.5, 0.25, 1.25, 0.5]);
}

#[test]
fn a_loop_within_one_sample_is_solved_or_refused() {
    let time = Discrete::new(0.1).unwrap();
    let gain = |k: f64| TransferFunction::new(&[k], &[1.0], time).unwrap();
    let closed = TwoDegreesOfFreedom::new(gain(2.0), gain(0.5), gain(3.0)).unwrap();
    let response = closed.simulate(&[1.0, -2.0], Some(&[0.0, 7.0])).unwrap();
    // y = (2 (0.5 + 3) r + 2 d)/(1 + 6), u = 0.5 r + 3 (r − y)
    assert!((response.output[0] - 1.0).abs() < 1e-15 && response.output[1].abs() < 1e-15);
    assert!((response.control.unwrap()[1] + 7.0).abs() < 1e-15);
    let loop_of_nothing = TwoDegreesOfFreedom::new(gain(1.0), gain(1.0), gain(-1.0));
    assert_eq!(loop_of_nothing.unwrap_err(), LoopError::Vanishing);
    // 1 + G Gfb vanishes at infinity only: no sample can be solved for, and the loop is not well posed.
    let lag = TransferFunction::new(&[-1.0, 0.2], &[1.0, 0.3], time).unwrap();
    let closed = TwoDegreesOfFreedom::new(gain(1.0), gain(1.0), lag).unwrap();
    assert!(!closed.is_stable(0.0));
    let error = closed.simulate(&[1.0], None).unwrap_err();
    assert_eq!(error, SimulationError::AlgebraicLoop { plant: 1.0, feedback: -1.0 });
}

#[test]
fn parts_of_a_loop_share_their_clock_and_its_signals_their_length() {
    let gain = |period: f64| TransferFunction::new(&[1.0], &[1.0], Discrete::new(period).unwrap()).unwrap();
    let error = TwoDegreesOfFreedom::new(gain(0.1), gain(0.1), gain(0.2)).unwrap_err();
    assert_eq!(
        error,
        LoopError::TimeBase { part: "feedback", sample_time_s: Some(0.2), plant_sample_time_s: Some(0.1) }
    );
    let closed = TwoDegreesOfFreedom::new(gain(0.1), gain(0.1), gain(0.1)).unwrap();
    let error = closed.simulate(&[1.0, 2.0], Some(&[1.0])).unwrap_err();
    assert_eq!(error, SimulationError::Length { signal: "disturbance", samples: 1, expected: 2 });
}

/// After the transient, a stable loop answers a sinusoid by its frequency response.
#[test]
fn a_simulated_loop_settles_on_its_frequency_response() {
    let omega = 2.0;
    let feedback = tf(&[0.8, 2.0], &[1.0, 4.0, 5.0]);
    // Improper, as Zhang 2015 identifies it: four zeros, two poles.
    let feedforward = tf(&[0.02, 0.1, 0.3, 0.5, 0.9], &[1.0, 6.0, 10.0]);
    let closed = TwoDegreesOfFreedom::new(catalogue::two_mass(), feedforward, feedback).unwrap();
    assert!(closed.is_stable(0.1));
    let period = 0.005;
    let sine =
        |phase: f64| -> Vec<f64> { (0..16_000).map(|k| (omega * period * f64::from(k) + phase).sin()).collect() };
    let (r, d) = (sine(0.0), sine(1.0));
    let response = closed.simulate(&r, Some(&d), period).unwrap();
    assert_eq!(response.control, None, "the control would be a derivative of the command");
    let (from_r, from_d) = (closed.command_to_output(omega), closed.disturbance_to_output(omega));
    for k in 12_000..16_000 {
        let turn = Complex64::from_polar(1.0, omega * period * k as f64);
        let exact = (from_r * turn + from_d * turn * Complex64::from_polar(1.0, 1.0)).im;
        // Straight lines between samples flatten a sinusoid by (ωT)²/12 < 1e-5.
        assert!((response.output[k] - exact).abs() < 3e-5, "{k}: {} {exact}", response.output[k]);
    }

    // With a proper feedforward the control exists and drives the plant to the same output.
    let closed =
        TwoDegreesOfFreedom::new(catalogue::minimum_phase(), tf(&[0.3, 0.9], &[0.2, 1.0]), tf(&[1.0], &[0.1, 1.0]))
            .unwrap();
    let response = closed.simulate(&r, None, period).unwrap();
    let control = response.control.unwrap();
    let time = Discrete::new(period).unwrap();
    let driven = simulate::sampled_response(&catalogue::minimum_phase(), &control, time, Hold::First).unwrap();
    let error = driven.iter().zip(&response.output).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(error < 2e-4, "{error}");
}

#[test]
fn a_sampled_loop_settles_on_its_frequency_response() {
    let time = Discrete::new(0.02).unwrap();
    let plant = discretise::zero_order_hold(&catalogue::nonminimum_phase(), time).unwrap();
    let fir = TransferFunction::new(&[3.0, -4.0, 1.5], &[1.0, 0.0, 0.0], time).unwrap();
    let feedback = discretise::matched(&tf(&[0.4], &[0.3, 1.0]), time).unwrap();
    let closed = TwoDegreesOfFreedom::new(plant, fir, feedback).unwrap();
    assert!(closed.is_stable(0.5));
    let omega = 3.0;
    let r: Vec<f64> = (0..3_000).map(|k| (omega * 0.02 * f64::from(k)).sin()).collect();
    let response = closed.simulate(&r, None).unwrap();
    let control = response.control.unwrap();
    let (to_y, to_u) = (closed.command_to_output(omega), closed.command_to_control(omega));
    for (k, (y, u)) in response.output.iter().zip(&control).enumerate().skip(2_500) {
        let turn = Complex64::from_polar(1.0, omega * 0.02 * k as f64);
        assert!((y - (to_y * turn).im).abs() < 1e-10);
        assert!((u - (to_u * turn).im).abs() < 1e-10);
    }
}

#[test]
fn an_unstable_loop_overflows_instead_of_returning_infinities() {
    let closed =
        TwoDegreesOfFreedom::new(catalogue::nonminimum_phase(), tf(&[1.0], &[1.0]), tf(&[50.0], &[1.0])).unwrap();
    assert!(!closed.is_stable(0.0));
    let error = closed.simulate(&vec![1.0; 4_000], None, 0.05).unwrap_err();
    assert!(matches!(error, SimulationError::Overflow { sample } if sample > 10), "{error}");
}

#[test]
fn an_integrator_in_the_loop_does_no_harm_at_zero_frequency() {
    let closed = TwoDegreesOfFreedom::new(catalogue::integrator(), tf(&[0.3], &[1.0]), tf(&[2.0], &[1.0])).unwrap();
    assert_eq!(closed.command_to_output(0.0), Complex64::new(1.15, 0.0));
    assert_eq!(closed.sensitivity(0.0).norm(), 0.0);
    assert_eq!(closed.disturbance_to_output(0.0), Complex64::new(0.5, 0.0));
}

#[test]
fn first_order_hold_in_state_space_propagates_straight_lines() {
    let time = Discrete::new(0.1).unwrap();
    let states = conversion::to_state_space(&tf(&[2.0, 1.0, 3.0], &[1.0, 0.6, 4.0])).unwrap();
    let sampled = discretise::first_order_hold_state_space(&states, time).unwrap();
    let input: Vec<f64> = (0..60).map(|k| (0.2 * f64::from(k)).sin() * f64::from(k % 5)).collect();
    let wanted = simulate::sampled_output(&states, &input, time, Hold::First).unwrap();
    let mut x = nalgebra::DVector::<f64>::zeros(2);
    for (u, y) in input.iter().zip(wanted) {
        let ours = (sampled.c() * &x)[0] + sampled.d()[(0, 0)] * u;
        assert!((ours - y).abs() < 1e-12);
        x = sampled.a() * &x + sampled.b().column(0) * *u;
    }
}
