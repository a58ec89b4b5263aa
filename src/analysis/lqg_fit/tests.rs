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
        ("/inputs/plant/d", json!([[1, 2]]), "/inputs/plant/d", "D is 1x2 and must be 1x1"),
        ("/inputs/plant/lag", json!(0.1), "/inputs/plant/lag", "unknown field"),
        ("/inputs/plant/c_recorded", json!([[1, 0]]), "/spec/instrument_variance", "nothing is said of the instrument"),
        (
            "/inputs/internal_model",
            json!({"a": [[0, 1], [4, 0]], "b": [[0, 0], [1, 1]], "c": [[1, 0]]}),
            "/inputs/internal_model/b",
            "2 controls",
        ),
        (
            "/inputs/internal_model",
            json!({"a": [[4]], "b": [[1]], "c": [[1]]}),
            "/inputs/internal_model/a",
            "1 states, and the plant 2",
        ),
        ("/inputs/trial/initial_state", json!([0, 0]), "/inputs/trial/initial_state", "does not use it"),
        ("/inputs/plant/sample_time_s", json!(0.1), "/inputs/plant/sample_time_s", "sampled every 0.1 s"),
        ("/inputs/trial/sample_time_s", json!(0), "/inputs/trial/sample_time_s", "positive"),
        ("/inputs/trial/input", json!([1]), "/inputs/trial/input", "there is no \"input\""),
        ("/inputs/trial/control", json!([1, 2]), "/inputs/trial/control", "2 samples"),
        ("/inputs/trial/output", json!([1e40, 2]), "/inputs/trial/output/0", "magnitudes"),
        ("/inputs/trials", json!([]), "/inputs", "both trial and trials"),
        ("/spec/delay", json!({"seconds": 0.1}), "/spec/delay", "unknown field"),
        ("/spec/sensory_delay_s", json!(0.05), "/spec/sensory_delay_s", "no whole number"),
        ("/spec/sensory_delay_s", json!(-0.02), "/spec/sensory_delay_s", "must not be negative"),
        ("/spec/sensory_delay_s", json!(0.9), "/spec/sensory_delay_s", "states"),
        ("/spec/target", json!("cursor"), "/spec/target", "expected struct LqgFitTarget"),
        ("/spec/target", json!({"state": 7}), "/spec/target/state", "state 7"),
        ("/spec/target", json!({"state": 1}), "/spec/target/state", "does not move by itself"),
        ("/spec/initial_state", json!("first_sample"), "/spec/initial_state", "only where outputs are exact"),
        ("/spec/initial_state", json!("given"), "/inputs/trial/initial_state", "no initial state"),
        ("/spec/control_weight", json!([{"name": "r", "diagonal": [1]}]), "/spec/control_weight", "no weight is held"),
        (
            "/spec/perceived_measurement_noise",
            json!([{"name": "vp", "diagonal": [1]}]),
            "/spec/perceived_measurement_noise",
            "none of them is held",
        ),
        (
            "/spec/perceived_measurement_noise",
            json!([{"name": "vp", "diagonal": [1], "same_as": "nobody"}]),
            "/spec/perceived_measurement_noise/0/same_as",
            "no term",
        ),
        (
            "/spec/perceived_measurement_noise",
            json!([{"name": "vp", "diagonal": [1], "same_as": "position"}]),
            "/spec/perceived_measurement_noise/0/same_as",
            "not of one kind",
        ),
        (
            "/spec/perceived_measurement_noise",
            json!([{"name": "vp", "diagonal": [1], "same_as": "v1", "held": 1}]),
            "/spec/perceived_measurement_noise/0/same_as",
            "one of its own",
        ),
        ("/spec/starts", json!(4), "/spec/starts", "5 to 100"),
        ("/spec/confidence", json!(1), "/spec/confidence", "between 0 and 1"),
        ("/spec/control_variance", Value::Null, "/spec/control_variance", "both recorded exactly"),
        ("/spec/control_variance", json!([[-1]]), "/spec/control_variance", "not positive semidefinite"),
        ("/spec/control", json!("not_used"), "/spec/control_variance", "no control is used"),
        ("/spec/instrument_variance", json!([[-1]]), "/spec/instrument_variance", "not positive semidefinite"),
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

/// A horizon that ends needs trials of one length and a start, and control-dependent noise a person whose gains are
/// known.
#[test]
fn what_a_horizon_or_noise_of_the_control_cannot_tell_is_named() {
    let mut value = example();
    value["spec"]["horizon"] = json!({});
    value["inputs"]["trials"] = json!([trial(40, 3), trial(39, 3)]);
    value["inputs"].as_object_mut().unwrap().remove("trial");
    let problem = parse(&value).unwrap_err();
    assert_eq!(problem.location.as_deref(), Some("/inputs/trials/1/output"));
    assert!(problem.detail.contains("unequal length"), "{problem}");
    value["inputs"]["trials"] = json!([trial(40, 3)]);
    value["spec"]["initial_state"] = json!("settled");
    let problem = parse(&value).unwrap_err();
    assert_eq!(problem.location.as_deref(), Some("/spec/initial_state"));
    assert!(problem.detail.contains("no steady state"), "{problem}");
    value["spec"]["initial_state"] = json!("rest");
    value["spec"]["control_dependent_noise"] = json!({"name": "c"});
    assert_eq!(parse(&value).unwrap_err().location.as_deref(), Some("/spec/horizon/initial_covariance"));
    value["spec"]["horizon"] = json!({"initial_covariance": []});
    value["spec"]["process_noise"] = json!([]);
    value["spec"]["motor_noise"] = json!([{"name": "additive", "diagonal": [1]}]);
    let problem = parse(&value).unwrap_err();
    assert_eq!(problem.location.as_deref(), Some("/spec/motor_noise"));
    assert!(problem.detail.contains("additive and c are not told apart"), "{problem}");
    value["spec"]["motor_noise"] = json!([{"name": "additive", "diagonal": [1], "held": 0.01}]);
    assert_eq!(parse(&value).unwrap().kind().to_string(), "lqg_fit");
    value["spec"]["control"] = json!("applied");
    assert_eq!(parse(&value).unwrap_err().location.as_deref(), Some("/spec/control"));
    value["spec"]["control"] = json!("commanded");
    value["spec"]["belief"] = json!("filtered");
    assert_eq!(parse(&value).unwrap_err().location.as_deref(), Some("/spec/belief"));
}

/// A target that no control moves is no state that settles, and one that grows is refused.
#[test]
fn a_target_has_no_steady_state() {
    let mut value = example();
    value["inputs"]["plant"] = json!({
        "a": [[1, 0], [0, 1]], "b": [[0], [0.02]], "c": [[1, 0], [0, 1]], "sample_time_s": 0.02
    });
    let output: Vec<[f64; 2]> = (0..60).map(|k| [f64::from(k).sin(), f64::from(k).cos()]).collect();
    value["inputs"]["trial"] = json!({"sample_time_s": 0.02, "output": output});
    value["spec"] = json!({"state_weight": [{"name": "error", "matrix": [[1, -1], [-1, 1]]}]});
    let problem = parse(&value).unwrap_err();
    assert_eq!(problem.location.as_deref(), Some("/spec/initial_state"));
    value["spec"]["initial_state"] = json!("rest");
    assert_eq!(parse(&value).unwrap().kind().to_string(), "lqg_fit");
    value["inputs"]["plant"]["a"] = json!([[1.1, 0], [0, 1]]);
    let problem = parse(&value).unwrap_err();
    assert!(problem.detail.contains("grows by itself"), "{problem}");
    assert_eq!(problem.location.as_deref(), Some("/inputs/plant"));
}

/// A recorded target is conditioned on: the person sees target and cursor with noise, and the cursor alone is recorded,
/// after 40 ms. Twins of such persons are not known, and the report says so.
#[test]
fn a_target_is_followed_with_a_delay() {
    let mut stream = crate::num::rng::stream(34, "lqg fit follower");
    let mut normal = |sd: f64| sd * stream.sample::<f64, _>(StandardNormal);
    let (mut cursor, mut seen, mut push, mut output) = (0.0_f64, vec![0.0_f64; 3], Vec::new(), Vec::new());
    let mut target = 0.0_f64;
    for k in 0..500 {
        push.push(target);
        output.push(cursor + normal(0.01));
        // Two samples late, with no belief: a person to be fitted, not to be recovered.
        seen.push(target - cursor + normal(0.1));
        cursor += 0.02 * (4.0 * seen[seen.len() - 4]) + normal(0.02);
        target += if k % 20 == 0 { normal(1.0) } else { 0.0 };
    }
    let value = json!({"kind": "lqg_fit", "inputs": {
        "plant": {
            "a": [[1, 0], [0, 1]], "b": [[0], [0.02]], "c": [[1, 0], [0, 1]], "c_recorded": [[0, 1]],
            "sample_time_s": 0.02
        },
        "trial": {"sample_time_s": 0.02, "disturbance": push, "output": output}
    }, "spec": {
        "target": {"state": 0}, "sensory_delay_s": 0.04, "instrument_variance": [[0.0001]], "initial_state": "rest",
        "state_weight": [{"name": "error", "matrix": [[1, -1], [-1, 1]]}],
        "perceived_process_noise": [{"name": "believed target", "diagonal": [1, 0]},
            {"name": "believed cursor", "diagonal": [0, 1], "same_as": "cursor"}],
        "process_noise": [{"name": "cursor", "diagonal": [0, 1]}],
        "measurement_noise": [{"name": "senses", "diagonal": [1, 1]}],
        "perceived_measurement_noise": [{"name": "believed senses", "diagonal": [1, 1], "same_as": "senses"}]
    }});
    let plan = parse(&value).unwrap();
    assert_eq!(Plan::parse(&plan.request()).unwrap().request(), plan.request());
    let report = run(&value);
    let explanation = &report.result["explanations"][0];
    // The line of what is on its way is no state that is answered for.
    assert_eq!(explanation["k_standard_error"].as_array().unwrap()[0].as_array().unwrap().len(), 2);
    assert_eq!(explanation["l_standard_error"].as_array().unwrap().len(), 2);
    assert_eq!(explanation["coefficients"]["believed senses"], explanation["coefficients"]["senses"]);
    assert_eq!(report.result["parameters"].as_array().unwrap().len(), 4);
    assert_eq!(report.result["perceived_measurement_noise"], Value::Null);
    assert_eq!(report.result["twins_outside"], Value::Null);
    assert!(codes(&report).contains(&"twins_not_looked_for"), "{:?}", report.warnings);
}

/// Reaches: gains that change from sample to sample, from a given start.
#[test]
fn reaches_have_costs_with_intervals() {
    let mut stream = crate::num::rng::stream(35, "lqg fit reaches");
    let mut normal = |sd: f64| sd * stream.sample::<f64, _>(StandardNormal);
    // A point mass over .1 towards zero, by the gains of 20 controls of cost 1e-3 and terminal weights 1 and .1.
    let (dt, steps) = (0.05, 20);
    let (a, b) = (DMatrix::from_row_slice(2, 2, &[1.0, dt, 0.0, 1.0]), DMatrix::from_row_slice(2, 1, &[0.0, dt]));
    let mut p = DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, 0.1]));
    let mut gains = Vec::new();
    for _ in 0..steps {
        let k = (b.transpose() * &p * &b).add_scalar(1e-3).try_inverse().unwrap() * b.transpose() * &p * &a;
        p = a.transpose() * &p * (&a - &b * &k);
        gains.push(k);
    }
    let one = |normal: &mut dyn FnMut(f64) -> f64| {
        let (mut x, mut output) = (DVector::from_vec(vec![0.1, 0.0]), Vec::new());
        for k in 0..=steps {
            output.push(x[0] + normal(1e-3));
            let seen = &x + DVector::from_vec(vec![normal(1e-3), normal(1e-2)]);
            let u = if k < steps { -(&gains[steps - 1 - k] * seen)[0] } else { 0.0 };
            x = &a * &x + &b * (u * (1.0 + normal(0.2)));
        }
        json!({"sample_time_s": dt, "output": output, "initial_state": [0.1, 0]})
    };
    let trials: Vec<Value> = (0..30).map(|_| one(&mut normal)).collect();
    let value = json!({"kind": "lqg_fit", "inputs": {
        "plant": {"a": [[1, dt], [0, 1]], "b": [[0], [dt]], "c_recorded": [[1, 0]], "sample_time_s": dt},
        "trials": trials
    }, "spec": {
        "initial_state": "given", "instrument_variance": [[1e-6]],
        "horizon": {
            "terminal_weight": [
                {"name": "position", "diagonal": [1, 0], "held": 1}, {"name": "velocity", "diagonal": [0, 1]}
            ],
            "initial_covariance": []
        },
        "state_weight": [], "control_weight": [{"name": "effort", "diagonal": [1]}],
        "process_noise": [], "control_dependent_noise": {"name": "c"},
        "perceived_process_noise": [{"name": "believed noise", "diagonal": [0, 1], "held": 1e-8}],
        "measurement_noise": [{"name": "senses", "diagonal": [1e-6, 1e-4]}],
        "perceived_measurement_noise": [{"name": "believed senses", "diagonal": [1e-6, 1e-4], "same_as": "senses"}]
    }});
    let report = run(&value);
    let parameters = report.result["parameters"].as_array().unwrap();
    let c = parameters.iter().find(|p| p["name"] == "c").unwrap();
    let (value, error) = (c["value"].as_f64().unwrap(), c["log_standard_error"].as_f64().unwrap());
    assert!(error < 0.3 && (value / 0.2).ln().abs() < 4.0 * error + 0.1, "{c}");
    assert_eq!(c["role"], "control_dependent_noise");
    assert_eq!(report.result["explanations"][0]["regulator_poles"], Value::Null);
    assert_eq!(report.result["control_weight"], Value::Null);
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
