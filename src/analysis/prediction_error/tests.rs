use super::*;
use crate::analysis::{Plan as AnyPlan, Report, Request};
use crate::ctl::StopReason;
use serde_json::{Value, json};

fn example() -> Value {
    serde_json::from_str(Plan::EXAMPLE).unwrap()
}

fn run(inputs: &Value, spec: Value) -> Result<Report, Failure> {
    let request = Request { kind: "prediction_error".to_owned(), inputs: inputs.clone(), spec };
    let plan = AnyPlan::parse(&request)?;
    let canonical = plan.request();
    assert_eq!(AnyPlan::parse(&canonical).unwrap().request(), canonical, "canonical requests parse to equal plans");
    plan.run(&Library::default(), &Ctl::new())
}

/// The example's trial in two halves that overlap a little, as two trials.
fn two_trials() -> Value {
    let example = example();
    let trial = &example["inputs"]["trial"];
    let part = |from: usize, to: usize| {
        let cut = |name: &str| trial[name].as_array().unwrap()[from..to].to_vec();
        json!({"sample_time_s": 0.1, "r": cut("r"), "u": cut("u"), "y": cut("y")})
    };
    json!({"trials": [part(0, 70), part(50, 120)], "plant": example["inputs"]["plant"]})
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

#[test]
fn the_example_answers_with_intervals() {
    let example = example();
    let report = run(&example["inputs"], example["spec"].clone()).unwrap();
    let result = &report.result;
    assert_eq!(result["lags"]["feedback"], json!([1, 3]));
    assert_eq!(result["lags"]["slow_zeros"].as_array().unwrap().len(), 2);
    let norm = &result["trials"][0]["metrics"]["norm_feedback"];
    let [low, high] = [0, 1].map(|k| norm["nominal_interval"][k].as_f64().unwrap());
    let value = norm["value"].as_f64().unwrap();
    assert!(low < value && value < high && norm["standard_error"].as_f64().unwrap() > 0.0);
    // The person's feedback is 0.8 e(t − 0.2 s), its feedforward 0.6.
    assert!(low < 0.8 && 0.8 < high, "{norm}");
    assert_eq!(result["trials"][0]["stable"], json!(true));
    assert_eq!(result["feedback"]["lines"].as_array().unwrap().len(), 30);
    assert!(result["change"].is_null() && result["hypotheses"]["unchanged_feedback"].is_null());
    assert!(codes(&report).contains(&"assumptions"));
    let one_step = result["trials"][0]["accounted_for"]["one_step_u"].as_f64().unwrap();
    assert!((0.5..1.0).contains(&one_step), "{one_step}");
}

#[test]
fn trials_share_a_feedback_unless_told_otherwise() {
    let inputs = two_trials();
    let spec = |shared: Value| {
        json!({"feedforward_terms": 2, "preview_s": 0.1, "feedforward_memory_s": 0.2,
        "band_hz": [0.1, 0.7], "shared": shared})
    };
    let together = run(&inputs, spec(json!(["feedback", "noise"]))).unwrap().result;
    let norms =
        |result: &Value| [0, 1].map(|i| result["trials"][i]["metrics"]["norm_feedback"]["value"].as_f64().unwrap());
    let [a, b] = norms(&together);
    assert!(a == b && together["trials"][0]["feedback"].is_null());
    assert_eq!(together["change"]["trials"], json!(1));
    assert!(together["hypotheses"]["unchanged_feedback"]["p_value"].is_number());
    let apart = run(&inputs, spec(json!([]))).unwrap().result;
    let [a, b] = norms(&apart);
    assert!(a != b && apart["feedback"].is_null() && apart["trials"][1]["feedback"].is_object());
}

#[test]
fn refusals_name_their_field() {
    let inputs = &example()["inputs"];
    for (spec, place) in [
        (json!({"feedback_delay_s": [0.5, 0.2]}), "/spec/feedback_delay_s"),
        (json!({"autoregressive_order": 2}), "/spec/autoregressive_order"),
        (json!({"autoregressive_order": 21}), "/spec/autoregressive_order"),
        (json!({"moving_average_order": 9}), "/spec/moving_average_order"),
        (json!({"preview_s": -1.0}), "/spec/preview_s"),
        (json!({"feedforward_memory_s": 11.0}), "/spec/feedforward_memory_s"),
        (json!({"feedforward_terms": 0}), "/spec/feedforward_terms"),
        (json!({"feedforward_terms": 30}), "/spec/feedforward_terms"),
        (json!({"band_hz": [2.0, 1.0]}), "/spec/band_hz"),
        (json!({"band_hz": [0.1, 6.0]}), "/spec/band_hz"),
        (json!({"sample_time_s": 0.15}), "/spec/sample_time_s"),
        (json!({"sample_time_s": 0.0}), "/spec/sample_time_s"),
        (json!({"shared": ["feedback"]}), "/spec/shared"),
        (json!({"shared": ["everything"]}), "/spec/shared"),
        (json!({"change_trials": 1}), "/spec/change_trials"),
        (json!({"no_such": 1}), "/spec/no_such"),
    ] {
        let found = problem(inputs, spec.clone());
        assert_eq!(found.location.as_deref(), Some(place), "{spec}: {found}");
    }
    let mut short = example()["inputs"].clone();
    for name in ["r", "u", "y"] {
        short["trial"][name].as_array_mut().unwrap().truncate(30);
    }
    let found = problem(&short, json!({"feedforward_terms": 3}));
    assert_eq!((found.code, found.location.as_deref()), (Code::NotIdentifiable, Some("/inputs/trial")));
    let mut idle = example()["inputs"].clone();
    idle["trial"]["u"] = json!(vec![0.0; 120]);
    assert_eq!(problem(&idle, json!({"feedforward_terms": 3})).code, Code::NotIdentifiable);
}

/// With a least delay of one sample of 0.02 s and a plant that answers within it, y = G u is a regression too.
#[test]
fn coloured_residuals_take_the_promise_from_the_interval() {
    let mut inputs = example()["inputs"].clone();
    // Noise of the measured control alone, which is no process with the controllers' poles.
    let u: Vec<f64> = inputs["trial"]["u"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    let rough: Vec<f64> = u
        .iter()
        .enumerate()
        .map(|(i, v)| v + 0.4 * (1.3 * (i * i) as f64).sin().signum() * f64::from(i as u32 % 3))
        .collect();
    inputs["trial"]["u"] = json!(rough);
    let report =
        run(&inputs, json!({"feedforward_terms": 3, "band_hz": [0.1, 0.7], "autoregressive_order": 0})).unwrap();
    assert!(codes(&report).contains(&"prediction_errors_not_white"), "{:?}", codes(&report));
    let norm = &report.result["trials"][0]["metrics"]["norm_feedback"];
    assert!(norm["interval_95"].is_null() && norm["nominal_interval"].is_array());
    assert!(norm["reason"].as_str().unwrap().contains("not white"));
    let beside = &report.result["moving_average_answer"];
    assert_eq!(beside["noise"]["moving_average"].as_array().unwrap().len(), 2);
}

#[test]
fn it_stops_when_told_to() {
    let example = example();
    let request: Request = serde_json::from_value(example).unwrap();
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    let stopped = AnyPlan::parse(&request).unwrap().run(&Library::default(), &ctl);
    assert!(matches!(stopped, Err(Failure::Stopped(_))));
}
