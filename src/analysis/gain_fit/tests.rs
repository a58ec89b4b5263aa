//! Requests that are understood, and those that are not.

use super::optimality::binomial_interval;
use super::*;
use serde_json::{Value, json};

fn wave(samples: usize, seed: f64) -> Vec<f64> {
    (0..samples).map(|k| (k as f64 * 0.7 + seed).sin() + (k as f64 * 0.23 * seed).cos()).collect()
}

fn trial(seed: f64) -> Value {
    let y: Vec<[f64; 2]> = wave(60, seed + 1.0).iter().zip(wave(60, seed + 2.0)).map(|(a, b)| [*a, b]).collect();
    json!({"sample_time_s": 0.05, "input": wave(60, seed), "output": y})
}

fn request() -> Value {
    json!({
        "kind": "gain_fit",
        "inputs": {"plant": {"a": [[0, 1], [2, 0]], "b": [[0], [1]]}, "trials": [trial(1.0), trial(2.0)]},
        "spec": {"draws": 20, "climbs": 2, "optimality": {"draws": 0}}
    })
}

fn parse(value: &Value) -> Result<Plan, Problem> {
    Plan::parse(&serde_json::from_value(value.clone()).unwrap())
}

#[test]
fn a_request_with_its_defaults_is_the_same_request() {
    let mut named = request();
    named["inputs"]["plant"] = json!({"name": "seated_balance", "values": {"k_b": 90.0}});
    named["spec"] = json!({
        "free": ["k_h"], "delay": {"seconds": 0.03}, "muscle_lag": {}, "bounds": {"k_h": [1, null], "tau": [0.01, 0.2]}
    });
    named["spec"]["bounds"].as_object_mut().unwrap().remove("tau");
    for value in [request(), named] {
        let plan = parse(&value).unwrap();
        let again = Plan::parse(&plan.request()).unwrap();
        assert_eq!(again, plan);
        assert_eq!(again.request(), plan.request());
        assert_eq!(plan.request().spec["confidence"], 0.95);
    }
}

#[test]
fn what_is_wrong_is_named() {
    let cases: &[(&str, Value, &str, &str)] = &[
        ("/inputs/plant/a", json!([[0, 1]]), "/inputs/plant/a", "A is 1x2 and must be square"),
        ("/inputs/plant/a", json!([[0, 1], [2]]), "/inputs/plant/a/1", "has 1 entries"),
        ("/inputs/plant/a", json!([[0, 1], [2, 1e300]]), "/inputs/plant/a/1/1", "1e300"),
        ("/inputs/plant/a", json!([[0, 1], [2, null]]), "/inputs/plant/a/1/1", "no number"),
        ("/inputs/plant/b", json!([[0], [1], [2]]), "/inputs/plant/b", "B is 3x1 and must be 2x1"),
        ("/inputs/plant/c", json!([[1, 0, 0]]), "/inputs/plant/c", "C is 1x3 and must be 1x2"),
        ("/inputs/plant/c", json!([[1, 0]]), "/inputs/trials/0/output", "2 columns and must have 1"),
        ("/inputs/plant/d", json!([[1, 0]]), "/inputs/plant/d", "D is 1x2 and must be 2x1"),
        ("/inputs/plant/sample_time_s", json!(0.1), "/inputs/plant/sample_time_s", "every 0.1 s"),
        ("/inputs/plant/sample_time_s", json!(-1), "/inputs/plant/sample_time_s", "positive"),
        ("/inputs/plant", json!({"name": "bicycle"}), "/inputs/plant", "bicycle"),
        ("/inputs/plant", json!({"name": "seated_balance", "values": {"k9": 1}}), "/inputs/plant/values/k9", "k9"),
        ("/inputs/plant", json!({"name": "seated_balance", "values": {"m1": -1}}), "/inputs/plant", "m1 is -1"),
        (
            "/inputs/plant",
            json!({"name": "seated_balance", "values": {"k1": 1}}),
            "/inputs/plant/values/k1",
            "no parameter",
        ),
        ("/inputs/plant", Value::Null, "/inputs/plant", "no plant"),
        ("/inputs/trials/1/output/7/0", Value::Null, "/inputs/trials/1/output/7/0", "no number"),
        ("/inputs/trials/1/output/7/1", json!(1e300), "/inputs/trials/1/output/7", "1e300"),
        ("/inputs/trials/0/input/3", json!("x"), "/inputs/trials/0/input/3/0", "no number"),
        ("/inputs/trials/0/input", json!([1, 2, 3]), "/inputs/trials/0/input", "3 samples"),
        ("/inputs/trials/1/sample_time_s", json!(0.06), "/inputs/trials/1/sample_time_s", "0.06 s, and 0.05 s"),
        ("/inputs/trials/0/sample_time_s", json!(0), "/inputs/trials/0/sample_time_s", "positive"),
        ("/inputs/trials/1", trial(1.0), "/inputs/trials/1", "same recording"),
        ("/inputs/trials", json!([]), "/inputs/trials", "0 trials"),
        (
            "/inputs/trials",
            json!([{"sample_time_s": 0.05, "input": [1, 2], "output": [[1, 0], [2, 0]]}]),
            "/inputs/trials",
            "4 numbers were measured",
        ),
        ("/spec/free", json!(["k_b"]), "/spec/free/0", "k_b"),
        ("/spec/bounds", json!({"k1": [3, 2]}), "/spec/bounds/k1", "cross"),
        ("/spec/bounds", json!({"k7": [1, 2]}), "/spec/bounds/k7", "no parameter"),
        ("/spec/start", json!({"k1": 3}), "/spec/start/k2", "no k2"),
        ("/spec/start", json!({"k1": 3, "k2": 1, "k3": 1}), "/spec/start/k3", "no parameter"),
        ("/spec/noise", json!({"covariance": [[1, 2], [2, 1]]}), "/spec/noise/covariance", "positive definite"),
        ("/spec/noise", json!({"covariance": [[1]]}), "/spec/noise/covariance", "must be 2x2"),
        ("/spec/confidence", json!(1.0), "/spec/confidence", "between 0 and 1"),
        ("/spec/draws", json!(0), "/spec/draws", "1 to"),
        ("/spec/delay", json!({"seconds": -0.1}), "/spec/delay/seconds", "-0.1 s"),
        ("/spec/delay", json!({"order": 40}), "/spec/delay/order", "40"),
        ("/spec/initial_state", json!("given"), "/inputs/trials/0/initial_state", "no initial state"),
        ("/spec/optimality/state_weight", json!({"pattern": [[true]]}), "/spec/optimality/state_weight/pattern", "2x2"),
        ("/spec/gains", json!(1), "/spec/gains", "unknown field"),
    ];
    for (place, value, location, words) in cases {
        let mut wrong = request();
        // A missing member is made first, where the parent is there.
        let (parent, name) = place.rsplit_once('/').unwrap();
        match wrong.pointer_mut(parent).unwrap() {
            Value::Object(members) => drop(members.insert(name.to_owned(), value.clone())),
            Value::Array(items) => items[name.parse::<usize>().unwrap()] = value.clone(),
            _ => panic!("{place}"),
        }
        let problem = parse(&wrong).expect_err(place);
        assert_eq!(problem.location.as_deref(), Some(*location), "{place}: {problem}");
        assert!(problem.detail.contains(words), "{place}: {problem}");
    }
}

#[test]
fn parameters_of_matrices_are_checked() {
    let with = |parameters: Value| {
        let mut value = request();
        value["inputs"]["plant"]["parameters"] = parameters;
        value
    };
    let stiffness = json!({"name": "stiffness", "nominal": 1, "a": [[0, 0], [-1, 0]]});
    let plan = parse(&with(json!([stiffness]))).unwrap();
    let signals = plan.inputs.signals().unwrap();
    let names = |plan: &Plan| plan.assemble(plan.inputs.plant().unwrap(), signals).unwrap().model.names();
    assert_eq!(names(&plan), ["k1", "k2", "stiffness"]);
    let mut held = with(json!([stiffness]));
    held["spec"]["free"] = json!([]);
    assert_eq!(names(&parse(&held).unwrap()), ["k1", "k2"]);
    for (parameters, location, words) in [
        (json!([stiffness, stiffness]), "/inputs/plant/parameters/1/name", "taken"),
        (json!([{"name": "k1", "nominal": 1}]), "/inputs/plant/parameters", "\"k1\""),
        (json!([{"name": "x", "nominal": 1, "a": [[1]]}]), "/inputs/plant/parameters/0/a", "must be 2x2"),
        (json!([{"name": "x", "nominal": 1e300}]), "/inputs/plant/parameters/0/nominal", "1e300"),
    ] {
        let problem = parse(&with(parameters)).unwrap_err();
        assert_eq!(problem.location.as_deref(), Some(location), "{problem}");
        assert!(problem.detail.contains(words), "{problem}");
    }
}

#[test]
fn the_same_request_gives_the_same_bytes() {
    let mut value = request();
    value["spec"]["optimality"]["draws"] = json!(30);
    let plan = parse(&value).unwrap();
    let run = || plan.run(&Library::default(), &Ctl::new()).unwrap();
    let (first, second) = (run(), run());
    assert_eq!(serde_json::to_string(&first.result).unwrap(), serde_json::to_string(&second.result).unwrap());
    assert_eq!(first.provenance.result_sha256, second.provenance.result_sha256);
    // Such outputs are no response to such inputs: the report says so.
    assert!(first.warnings.iter().any(|w| w.code == "coloured_residuals"), "{:?}", first.warnings);
}

#[test]
fn a_plant_that_no_control_reaches_has_no_start() {
    let mut value = request();
    value["inputs"]["plant"] = json!({"a": [[1, 0], [0, -1]], "b": [[0], [1]]});
    let failure = parse(&value).unwrap().run(&Library::default(), &Ctl::new()).unwrap_err();
    let Failure::Problem(problem) = failure else { panic!("{failure}") };
    assert_eq!(problem.code.name(), "not_identifiable");
    assert!(problem.detail.contains("none of 20 starts"), "{problem}");
}

#[test]
fn the_binomial_interval_is_that_of_the_tables() {
    // Clopper and Pearson at 95 %: 0 of 10, 5 of 10 and 10 of 10.
    for (k, expected) in [(0, [0.0, 0.308_497_1]), (5, [0.187_086, 0.812_914]), (10, [0.691_502_9, 1.0])] {
        let found = binomial_interval(k, 10, 0.95);
        assert!((found[0] - expected[0]).abs() < 1e-6 && (found[1] - expected[1]).abs() < 1e-6, "{k}: {found:?}");
    }
}
