use super::*;
use crate::analysis::{Plan as AnyPlan, Report, Request};
use crate::ctl::StopReason;
use serde_json::{Value, json};

fn run(inputs: &Value, spec: Value) -> Result<Report, Failure> {
    let request = Request { kind: "simulate".to_owned(), inputs: inputs.clone(), spec };
    let plan = AnyPlan::parse(&request)?;
    let canonical = plan.request();
    assert_eq!(AnyPlan::parse(&canonical).unwrap().request(), canonical, "canonical requests parse to equal plans");
    plan.run(&Library::default(), &Ctl::new())
}

fn problem(inputs: &Value, spec: Value) -> Problem {
    match run(inputs, spec) {
        Err(Failure::Problem(problem)) => problem,
        other => panic!("{other:?}"),
    }
}

fn codes(report: &Report) -> Vec<&str> {
    report.warnings.iter().map(|w| w.code.as_str()).collect()
}

/// 1/s with a gain of 2 behind 0.2 s, and a ramp as the command.
fn simple() -> Value {
    let ramp: Vec<f64> = (0..200).map(|k| 0.02 * f64::from(k)).collect();
    json!({
        "plant": "integrator",
        "feedback": {"num": [2], "den": [1], "delay_s": 0.2},
        "command": {"samples": ramp, "sample_time_s": 0.02},
    })
}

fn with(name: &str, value: Value) -> Value {
    let mut inputs = simple();
    inputs[name] = value;
    inputs
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

#[test]
fn the_example_has_signals_spread_and_responses() {
    let example: Request = serde_json::from_str(Plan::EXAMPLE).unwrap();
    let report = run(&example.inputs, example.spec.clone()).unwrap();
    let result = &report.result;
    assert_eq!(report.provenance.seed, Some(7));
    let signals = &result["signals"];
    let [t, r, y, e] = ["t", "r", "y", "e"].map(|name| numbers(&signals[name]));
    assert_eq!((t.len(), signals["samples"].as_u64()), (61, Some(3001)));
    assert!((t[60] - 60.0).abs() < 1e-9 && (0..61).all(|k| e[k] == r[k] - y[k]));
    let spread = &result["realisations"]["mean_abs_error"];
    let [low, high] = [0, 1].map(|i| spread["range_95"][i].as_f64().unwrap());
    let mean = spread["mean"].as_f64().unwrap();
    assert!(low < mean && mean < high && result["without_interval"].is_null(), "{spread}");
    assert!(result["slowest_pole"]["rate_per_s"].as_f64().unwrap() < 0.0);
    assert_eq!(result["frequency_responses"]["plant"]["gain_db"].as_array().unwrap().len(), 40);
    assert!(result["metrics"]["control_log_dimensionless_jerk"].is_f64());
    // The feedforward is the inverse of the plant behind 50/(s + 50).
    assert!(result["norms"]["norm_feedforward_plant_minus_one"].as_f64().unwrap() < 0.05);
    // From y(0) = 0.5 the plant alone, and then with what the person does 0.15 s later.
    let free = numbers(&result["free_response"]["y"]);
    assert!((free[0] - 0.5).abs() < 1e-12 && free[200].abs() < 0.02, "{free:?}");
    assert_eq!(numbers(&result["free_response"]["u"])[..8], [0.0; 8]);
}

#[test]
fn equal_seeds_draw_equal_noise_and_others_do_not() {
    let inputs = with("noise", json!({"perception": {"sd": 0.1}, "measurement": {"sd": 0.05}}));
    let y = |seed: u64| {
        let report = run(&inputs, json!({"seed": seed, "realisations": 2})).unwrap();
        assert_eq!(report.provenance.seed, Some(seed));
        numbers(&report.result["signals"]["y"])
    };
    assert_eq!(y(3), y(3));
    assert_ne!(y(3), y(4));
    let quiet = run(&simple(), json!({"seed": 3})).unwrap();
    assert_eq!(quiet.provenance.seed, None);
    assert!(quiet.result["realisations"].is_null() && quiet.result["without_interval"].is_string());
}

#[test]
fn measurement_noise_is_not_in_the_loop() {
    let quiet = run(&simple(), json!({})).unwrap().result;
    let noisy = run(&with("noise", json!({"measurement": {"sd": 1.0}})), json!({"realisations": 1})).unwrap().result;
    assert_eq!(quiet["signals"]["u"], noisy["signals"]["u"]);
    let difference: Vec<f64> =
        numbers(&noisy["signals"]["y"]).iter().zip(numbers(&quiet["signals"]["y"])).map(|(a, b)| a - b).collect();
    let sd = crate::num::stats::standard_deviation(&difference).unwrap();
    assert!((0.8..1.2).contains(&sd), "{sd}");
}

#[test]
fn a_trial_is_replayed_and_compared_with_what_was_recorded() {
    let simulated = run(&simple(), json!({})).unwrap().result;
    let signals = &simulated["signals"];
    let mut trial = json!({"sample_time_s": 0.02, "r": signals["r"], "u": signals["u"], "y": signals["y"]});
    let replay = |trial: &Value| {
        let mut inputs = simple();
        inputs["command"] = json!({"trial": trial});
        run(&inputs, json!({})).unwrap()
    };
    let report = replay(&trial);
    assert_eq!(report.result["recorded"], json!({"accounted_for_u": 1.0, "accounted_for_y": 1.0}));
    assert!(codes(&report).is_empty());
    trial["d"] = json!(vec![0.1; 200]);
    let report = replay(&trial);
    assert_eq!(codes(&report), ["disturbance_left_out"]);
    let mut inputs = simple();
    inputs["command"] = json!({"trial": trial});
    inputs["disturbance"] = json!({"trial": trial});
    let report = run(&inputs, json!({})).unwrap();
    assert!(codes(&report).is_empty());
    assert_ne!(report.result["signals"]["y"], signals["y"]);
}

#[test]
fn a_controller_that_differentiates_has_no_control_to_show() {
    let mut inputs = simple();
    inputs["plant"] = json!("damped_double_integrator");
    inputs["feedforward"] = json!({"num": [1, 1, 0], "den": [1]});
    let report = run(&inputs, json!({})).unwrap();
    assert_eq!(codes(&report), ["control_without_samples"]);
    assert!(report.result["signals"]["u"].is_null());
    assert!(report.result["metrics"]["right_control_undetermined"].as_str().unwrap().contains("differentiates"));
    // The inverse of the plant, exactly: no error is left.
    let e = numbers(&report.result["signals"]["e"]);
    assert!(e.iter().all(|e| e.abs() < 1e-6), "{e:?}");
}

#[test]
fn refusals_name_their_field_and_a_way_on() {
    let samples = |n: usize| json!({"samples": vec![1.0; n], "sample_time_s": 0.02});
    for (inputs, place, words) in [
        (json!(3), "/inputs", "no object"),
        (with("plnat", json!(1)), "/inputs/plnat", "plnat"),
        (json!({"plant": "integrator"}), "/inputs/command", "no command"),
        (json!({"command": samples(9)}), "/inputs/plant", "no plant"),
        (with("plant", json!("triple_pendulum")), "/inputs/plant", "catalogue"),
        (with("plant", json!({"num": [1], "den": []})), "/inputs/plant", "denominator"),
        (with("plant", json!({"num": [1, 0], "den": [1]})), "/inputs/plant", "zeros"),
        (
            with("feedforward", json!({"num": [1], "den": [1], "delay_s": -0.1})),
            "/inputs/feedforward/delay_s",
            "future",
        ),
        (with("feedforward", json!({"num": [1], "den": [1, -1]})), "/inputs/feedforward", "s = 1.0"),
        (with("feedforward", json!({"num": [1, 0, 0, 0], "den": [1]})), "/inputs/feedforward", "differentiate"),
        (with("feedback", json!({"num": [9], "den": [1], "delay_s": 0.2})), "/inputs/feedback", "pole at s = "),
        (with("feedback", Value::Null), "/inputs/feedback", "not asymptotically stable"),
        (
            with("feedback", json!({"num": [1, 0, 0], "den": [0.1, 1], "delay_s": 0.1})),
            "/inputs/feedback",
            "as many zeros",
        ),
        (with("feedback", json!({"num": [1], "den": [1], "delay_s": 1e-7})), "/inputs/feedback", "small part"),
        (with("feedback", json!({"num": [1], "den": [1], "sample_time_s": 0.05})), "/inputs/feedback", "0.05"),
        (
            with("feedback", json!({"num": [1], "den": [1], "sample_time_s": 0.02, "delay_s": 0.03})),
            "/inputs/feedback",
            "whole samples",
        ),
        (with("preview_s", json!(-1)), "/inputs/preview_s", "-1"),
        (with("preview_s", json!(4)), "/inputs/preview_s", "4 s"),
        (with("disturbance", samples(9)), "/inputs/disturbance", "9 samples"),
        (with("command", json!({"samples": [1, 2], "sample_time_s": 0.02})), "/inputs/command/samples", "2 samples"),
        (with("noise", json!({"remnant": {"sd": -1}})), "/inputs/noise/remnant/sd", "-1"),
        (with("noise", json!({"remnant": {}})), "/inputs/noise/remnant/sd", "missing"),
        (with("noise", json!({"tremor": {"sd": 1}})), "/inputs/noise/tremor", "tremor"),
        (with("initial_state", json!([])), "/inputs/initial_state", "0 numbers"),
        (with("initial_state", json!([1, 2])), "/inputs/initial_state", "1 states"),
    ] {
        let found = problem(&inputs, json!({}));
        let at = found.location.as_deref().unwrap();
        assert!(at.starts_with(place), "{inputs} → {found}");
        assert!(found.detail.contains(words), "{inputs} → {found}");
    }
    for (spec, place) in [
        (json!({"sede": 1}), "/spec/sede"),
        (json!({"seed": (1_u64 << 53) + 1}), "/spec/seed"),
        (json!({"realisations": 0}), "/spec/realisations"),
        (json!({"response_s": 0.0}), "/spec/response_s"),
        (json!({"response_s": 1e6}), "/spec/response_s"),
        (json!({"band_hz": [0.0, 1.0]}), "/spec/band_hz"),
        (json!({"norm_band_hz": [1.0, 0.5]}), "/spec/norm_band_hz"),
        (json!({"points": 1}), "/spec/points"),
        (json!({"every": 0}), "/spec/every"),
    ] {
        let found = problem(&simple(), spec.clone());
        assert_eq!(found.location.as_deref(), Some(place), "{spec} → {found}");
    }
    // What cannot be simulated in sampled time is named with what can.
    let mut sampled = simple();
    sampled["feedback"] = json!({"num": [2], "den": [1], "sample_time_s": 0.02, "delay_s": 0.2});
    sampled["feedforward"] = json!({"num": [1, 0, 0], "den": [1], "sample_time_s": 0.02});
    let found = problem(&sampled, json!({}));
    assert!(found.mend.as_deref().unwrap().contains("\"preview_s\": 0.04"), "{found}");
    sampled["feedforward"] = json!({"num": [1, 0, 0], "den": [1, 0, 0], "sample_time_s": 0.02});
    sampled["preview_s"] = json!(0.04);
    assert_eq!(run(&sampled, json!({})).unwrap().result["signals"]["samples"], json!(198));
    sampled["norm_band_hz"] = json!(1);
    assert_eq!(problem(&sampled, json!({})).location.as_deref(), Some("/inputs/norm_band_hz"));
}

#[test]
fn long_signals_are_thinned_only_when_asked() {
    let command = json!({"generator": {"kind": "multisine", "base_hz": 0.001, "harmonics": [10, 50]},
        "sample_time_s": 0.005});
    let inputs = with("command", command);
    let found = problem(&inputs, json!({}));
    assert_eq!((found.code, found.location.as_deref()), (Code::TooLarge, Some("/spec/every")), "{found}");
    assert!(found.mend.unwrap().contains("\"every\": 2"));
    // A delay that is a whole number of steps only with 64 of them in each of 200,000 samples.
    let mut awkward = inputs;
    awkward["feedback"]["delay_s"] = json!(0.2 + 0.005 / 64.0);
    let found = problem(&awkward, json!({"every": 2}));
    assert_eq!((found.code, found.location.as_deref()), (Code::Unaffordable, Some("/inputs/command")), "{found}");
}

#[test]
fn it_stops_when_told_to() {
    let request: Request = serde_json::from_str(Plan::EXAMPLE).unwrap();
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    let stopped = AnyPlan::parse(&request).unwrap().run(&Library::default(), &ctl);
    assert!(matches!(stopped, Err(Failure::Stopped(_))));
}
