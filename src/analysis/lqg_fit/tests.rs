//! Requests that are understood, and those that are not; what a report says and refuses to say.

use crate::analysis::{Failure, Library, Plan, Problem, Report, Request};
use crate::ctl::{Ctl, StopReason};
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_distr::StandardNormal;
use serde_json::{Value, json};

fn parse(value: &Value) -> Result<Plan, Problem> {
    let request: Request = serde_json::from_value(value.clone()).unwrap();
    Plan::parse(&request)
}

fn run(value: &Value) -> Report {
    parse(value).unwrap().run(&Library::default(), &Ctl::new()).unwrap()
}

fn example() -> Value {
    serde_json::from_str(include_str!("example.json")).unwrap()
}

fn codes(report: &Report) -> Vec<&str> {
    report.warnings.iter().map(|w| w.code.as_str()).collect()
}

/// A trial of the reference's example person, whose filter is made for true noises, from rest: not told ±.5, output as
/// sensed, control with a recorder of variance 4e-4.
fn trial(samples: usize, seed: u64) -> Value {
    let m = |rows: usize, columns: usize, entries: &[f64]| DMatrix::from_row_slice(rows, columns, entries);
    let a = m(2, 2, &[1.0007985088138476, 0.019945437607715825, 0.0797817504308633, 0.9948148775315327]);
    let b = m(2, 1, &[0.00019962720346188757, 0.019945437607715825]);
    let k = m(1, 2, &[22.82849892809421, 7.594252899751503]);
    let l = m(2, 1, &[0.293482781930906, 1.726761679483015]);
    let mut stream = crate::num::rng::stream(seed, "lqg fit requests");
    let mut normal = |sd: f64| sd * stream.sample::<f64, _>(StandardNormal);
    let (mut x, mut belief) = (DVector::zeros(2), DVector::zeros(2));
    let (mut push, mut output, mut control) = (Vec::new(), Vec::new(), Vec::new());
    for sample in 0..samples {
        let d = if (sample / 15) % 2 == 0 || (sample / 45) % 3 == 0 { 0.5 } else { -0.5 };
        let (y, u) = (x[0] + normal(0.01), -(&k * &belief)[0]);
        push.push(d);
        output.push(y);
        control.push(u + normal(0.02));
        let innovation = y - belief[0];
        x = &a * &x + &b * (u + d) + DVector::from_vec(vec![normal(1e-3), normal(0.02)]);
        belief = &a * &belief + &b * u + &l * innovation;
    }
    json!({"sample_time_s": 0.02, "disturbance": push, "output": output, "control": control})
}

/// With one scale of each noise, of the shape of the truth.
fn request(samples: usize, seed: u64) -> Value {
    let mut value = example();
    value["inputs"]["trial"] = trial(samples, seed);
    for name in ["process_noise", "perceived_process_noise"] {
        value["spec"][name] = json!([{"name": name, "diagonal": [0.0025, 1]}]);
    }
    value
}

#[test]
fn a_request_with_its_defaults_is_the_same_request() {
    let mut bare = example();
    bare["spec"] = json!({"control": "not_used"});
    for value in [example(), request(40, 1), bare] {
        let plan = parse(&value).unwrap();
        let again = Plan::parse(&plan.request()).unwrap();
        assert_eq!(again.request(), plan.request());
        assert_eq!(plan.request().spec["disturbance"], "unknown_to_person");
    }
}

/// Each change of the example, with the pointer and a part of the text that it is refused with.
#[test]
fn what_is_wrong_is_named() {
    let q = |name: &str, diagonal: Value| json!([{"name": name, "diagonal": diagonal}]);
    let cases: &[(&str, Value, &str, &str)] = &[
        ("/inputs/plant", Value::Null, "/inputs/plant", "there is no plant"),
        ("/inputs/plant/a", json!([[0, 1]]), "/inputs/plant/a", "A is 1x2 and must be 1x1"),
        ("/inputs/plant/b", json!([[0], [1], [2]]), "/inputs/plant/b", "B is 3x1 and must be 2x1"),
        ("/inputs/plant/d", json!([[1]]), "/inputs/plant/d", "unknown field"),
        ("/inputs/plant/sample_time_s", json!(0.1), "/inputs/plant/sample_time_s", "sampled every 0.1 s"),
        ("/inputs/trial/sample_time_s", json!(0), "/inputs/trial/sample_time_s", "positive"),
        ("/inputs/trial/input", json!([1]), "/inputs/trial/input", "there is no \"input\""),
        ("/inputs/trial/control", json!([1, 2]), "/inputs/trial/control", "2 samples"),
        ("/inputs/trial/output", json!([1e40, 2]), "/inputs/trial/output/0", "magnitudes"),
        ("/inputs/trials", json!([]), "/inputs", "both trial and trials"),
        ("/spec/delay", json!({"seconds": 0.1}), "/spec/delay", "unknown field"),
        ("/spec/target", json!([[1]]), "/spec/target", "unknown field"),
        ("/spec/horizon", json!(50), "/spec/horizon", "unknown field"),
        ("/spec/starts", json!(4), "/spec/starts", "5 to 100"),
        ("/spec/confidence", json!(1), "/spec/confidence", "between 0 and 1"),
        ("/spec/control_variance", Value::Null, "/spec/control_variance", "both recorded exactly"),
        ("/spec/control_variance", json!([[-1]]), "/spec/control_variance", "not positive semidefinite"),
        ("/spec/control", json!("not_used"), "/spec/control_variance", "no control is used"),
        ("/spec/instrument_variance", json!([[0]]), "/spec/instrument_variance", "not positive definite"),
        ("/spec/control_weight", json!([[0]]), "/spec/control_weight", "not positive definite"),
        ("/spec/state_weight", json!([]), "/spec/state_weight", "has no term"),
        ("/spec/state_weight", q("q", json!([1])), "/spec/state_weight/0/diagonal", "1 entries and must have 2"),
        ("/spec/state_weight", q("q", json!([1, -1])), "/spec/state_weight/0/diagonal", "must not be negative"),
        ("/spec/state_weight", q("q", json!([0, 0])), "/spec/state_weight/0/diagonal", "is zero"),
        ("/spec/state_weight", q("w", json!([1, 1])), "/spec/process_noise/0/name", "is taken already"),
        ("/spec/state_weight", json!([{"name": "q"}]), "/spec/state_weight/0", "neither a diagonal nor a matrix"),
        (
            "/spec/state_weight",
            json!([{"name": "q", "matrix": [[1, 2], [2, 1]]}]),
            "/spec/state_weight/0/matrix",
            "not positive semidefinite",
        ),
        (
            "/spec/state_weight",
            json!([{"name": "q", "diagonal": [1, 1], "start": 0}]),
            "/spec/state_weight/0/start",
            "must be positive",
        ),
        (
            "/spec/state_weight",
            json!([{"name": "q", "diagonal": [1, 1], "start": 1, "held": 1}]),
            "/spec/state_weight/0/start",
            "held and started",
        ),
        (
            "/spec/measurement_noise",
            json!([{"name": "v", "diagonal": [1], "held": 0}]),
            "/spec/measurement_noise",
            "without noise",
        ),
    ];
    for (at, replacement, location, text) in cases {
        let mut value = example();
        let (parent, name) = at.rsplit_once('/').unwrap();
        let parent = value.pointer_mut(parent).unwrap().as_object_mut().unwrap();
        if replacement.is_null() {
            parent.remove(name);
        } else {
            parent.insert(name.to_owned(), replacement.clone());
        }
        let problem = parse(&value).expect_err(at);
        assert_eq!(problem.location.as_deref(), Some(*location), "{at}: {problem}");
        assert!(problem.detail.contains(text), "{at}: {problem}");
    }
}

/// A noise of the motor beside a process noise that enters where the controls do: only their sum shows, unless the
/// applied control is recorded.
#[test]
fn a_motor_noise_that_the_process_noise_covers_is_refused() {
    let mut value = example();
    value["inputs"]["plant"] = json!({
        "a": [[1, 0.02], [0.08, 0.99]], "b": [[0], [0.02]], "c": [[1, 0]], "sample_time_s": 0.02
    });
    value["spec"]["motor_noise"] = json!([{"name": "m", "diagonal": [1]}]);
    let problem = parse(&value).unwrap_err();
    assert_eq!(problem.location.as_deref(), Some("/spec/motor_noise"));
    assert!(problem.detail.contains("W + BMBᵀ"), "{problem}");
    value["spec"]["control"] = json!("applied");
    assert_eq!(parse(&value).unwrap().kind().to_string(), "lqg_fit");
    value["spec"]["control"] = json!("commanded");
    value["spec"]["process_noise"] = json!([{"name": "w", "diagonal": [1, 0]}]);
    assert_eq!(parse(&value).unwrap().kind().to_string(), "lqg_fit");
}

/// Costs, belief and noises with their intervals; the truth is Q = diag(.4, .02) on R = .001, W_p = W.
#[test]
fn a_report_has_costs_with_intervals() {
    let report = run(&request(1000, 31));
    let result = &report.result;
    assert_eq!(result["control"], "commanded");
    let truth = [("position", 0.4), ("velocity", 0.02), ("perceived_process_noise", 4e-4), ("process_noise", 4e-4)];
    for (i, (name, truth)) in truth.into_iter().enumerate() {
        let parameter = &result["parameters"][i];
        assert_eq!(parameter["name"], name);
        assert_eq!(parameter["refused"], Value::Null, "{parameter}");
        let error = parameter["log_standard_error"].as_f64().unwrap();
        let value = parameter["value"].as_f64().unwrap();
        assert!((value / truth).ln().abs() < 4.0 * error && error < 0.3, "{parameter}");
        let [low, high] = [0, 1].map(|end| parameter["interval"][end].as_f64().unwrap());
        assert!(low < value && value < high, "{parameter}");
    }
    assert_eq!(result["explanations"].as_array().unwrap().len(), 1, "{result}");
    let explanation = &result["explanations"][0];
    for (j, truth) in [22.8285, 7.5943].into_iter().enumerate() {
        let (k, error) = (&explanation["k"][0][j], &explanation["k_standard_error"][0][j]);
        let (k, error) = (k.as_f64().unwrap(), error.as_f64().unwrap());
        assert!((k - truth).abs() < 4.0 * error, "{explanation}");
    }
    assert!(result["twins_outside"].is_number());
    assert_eq!(result["convergence"]["converged"], true, "{result}");
    assert_eq!(result["signals"].as_array().unwrap().len(), 2);
    assert!(!codes(&report).contains(&"parameters_refused"), "{:?}", report.warnings);
}

/// With a perceived noise of as many terms as the filter has gains the twin of the reference is a person too: both are
/// given, and no cost alone.
#[test]
fn twins_are_both_given() {
    let mut value = request(1200, 32);
    value["spec"]["perceived_process_noise"] =
        json!([{"name": "wp1", "diagonal": [1, 0]}, {"name": "wp2", "diagonal": [0, 1]}]);
    let report = run(&value);
    let result = &report.result;
    let explanations = result["explanations"].as_array().unwrap();
    assert!(explanations.len() >= 2, "{result}");
    assert!(codes(&report).contains(&"explanations_not_told_apart"), "{:?}", report.warnings);
    let likelihood = |i: usize| explanations[i]["log_likelihood"].as_f64().unwrap();
    assert!((likelihood(0) - likelihood(1)).abs() < 1e-6, "{explanations:?}");
    // One of both is the truth.
    let near = |e: &&Value| {
        [22.8285, 7.5943].iter().enumerate().all(|(j, truth)| {
            let (k, error) = (&e["k"][0][j], &e["k_standard_error"][0][j]);
            (k.as_f64().unwrap() - truth).abs() < 4.0 * error.as_f64().unwrap()
        })
    };
    assert_eq!(explanations.iter().filter(near).count(), 1, "{explanations:?}");
    for i in 0..2 {
        assert_eq!(result["parameters"][i]["value"], Value::Null);
        assert_eq!(result["parameters"][i]["refused"], "other_explanations");
    }
    // Told, the same kind of person has no twin: the question is not even put.
    value["spec"]["disturbance"] = json!("known_to_person");
    let told = run(&value);
    assert_eq!(told.result["twins_outside"], Value::Null);
    assert!(codes(&told).contains(&"coloured_residuals"), "{:?}", told.warnings);
}

/// Outputs alone of a person who is not told: no cost, by name.
#[test]
fn costs_from_outputs_alone_have_no_number() {
    let mut value = request(800, 33);
    value["spec"]["control"] = json!("not_used");
    value["spec"].as_object_mut().unwrap().remove("control_variance");
    let report = run(&value);
    let refused = &report.warnings.iter().find(|w| w.code == "parameters_refused").unwrap().message;
    assert!(refused.contains("position") && refused.contains("velocity"), "{refused}");
    for i in 0..2 {
        assert_eq!(report.result["parameters"][i]["value"], Value::Null);
    }
    assert_eq!(report.result["explanations"][0]["q"], Value::Null);
    assert_eq!(report.result["explanations"][0]["coefficients"]["position"], Value::Null);
}

#[test]
fn a_fit_that_is_cancelled_stops() {
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    let stopped = parse(&example()).unwrap().run(&Library::default(), &ctl);
    assert!(matches!(stopped, Err(Failure::Stopped(_))));
}
