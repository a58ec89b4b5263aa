use crate::analysis::{Code, Failure, Library, Plan, Problem, Request, samples};
use crate::ctl::Ctl;
use serde_json::{Value, json};

fn small() -> Value {
    json!({"experiment": {"duration_s": 8, "sample_time_s": 0.04, "edge_hz": [0.2, 2.0]}, "draws": 4,
           "fresh_draws": 24, "max_iterations": 8, "rounds": 2})
}

fn plan(inputs: Value, spec: Value) -> Result<Plan, Problem> {
    Plan::parse(&Request { kind: "robust_input_design".to_owned(), inputs, spec })
}

#[test]
fn the_worst_subject_is_no_worse_off_than_with_the_nominal_experiment() {
    for axis in ["flexion_extension", "axial_rotation"] {
        let plan = plan(json!({"axis": axis}), small()).unwrap();
        assert_eq!(Plan::parse(&plan.request()).unwrap().request(), plan.request(), "canonical");
        let ctl = Ctl::new();
        let report = plan.run(&Library::default(), &ctl).unwrap();
        assert_eq!(ctl.progress().fraction, 1.0);
        let result = &report.result;
        let number = |value: &Value| value.as_f64().unwrap();
        assert!(number(&result["robust"]["worst_cost"]) <= number(&result["nominal"]["worst_cost"]));
        assert_eq!(result["difference"]["no_worse"], json!(true), "{}", result["difference"]);
        assert!(result["assumptions"].as_array().unwrap().len() > 10);
        assert_eq!(result["robust"]["samples"].as_array().unwrap().len(), 200);
        for design in ["robust", "nominal"] {
            let parts = &result[design]["fresh"]["parts"];
            let sum: f64 = ["error", "acceleration", "torque", "angle"].iter().map(|part| number(&parts[part])).sum();
            assert!((sum - number(&result[design]["fresh"]["cost"])).abs() < 1e-9 * (1.0 + sum));
        }
        // Where a search knew its few draws too well, it says so.
        let optimisms = ["robust", "nominal"].map(|design| result[design]["fresh"]["optimism"].clone());
        let is_outside = optimisms.iter().any(|optimism| {
            let interval: [f64; 2] = serde_json::from_value(optimism["interval"].clone()).unwrap();
            assert!((interval[0]..=interval[1]).contains(&number(&optimism["mean"])));
            !(interval[0]..=interval[1]).contains(&0.0)
        });
        assert_eq!(report.warnings.iter().any(|warning| warning.code == "draws_too_few"), is_outside);
        assert_eq!(result["robust"]["fresh"]["draws"], json!(12), "half of the fresh draws choose, half estimate");
        // A null result is the first thing that is said.
        let is_null = result["difference"]["verdict"] == "not_distinguished";
        assert_eq!(report.warnings[0].code == "null_result", is_null);
        assert_eq!(result["conclusion"].as_str().unwrap().starts_with("Null result"), is_null);
        assert!(result["given"].is_null());
        let csv = samples::csv(&report).unwrap();
        assert!(csv.starts_with("t,signal,nominal\r\n0.0,") && csv.lines().count() == 201);
        assert_eq!(report.provenance.seed, Some(1));
        let again = plan.run(&Library::default(), &Ctl::new()).unwrap();
        assert_eq!(again.provenance.result_sha256, report.provenance.result_sha256);
    }
}

#[test]
fn a_given_experiment_is_evaluated_and_a_design_against_itself_is_a_null_result() {
    let mut spec = small();
    // One experiment is all that there is: robust, nominal and given are the same.
    spec["experiment"]["edge_hz"] = json!([0.8, 0.800_000_1]);
    spec["experiment"]["width_m"] = json!([0.6, 0.600_000_1]);
    spec["given"] = json!({"edge_hz": 0.8, "width_m": 0.6});
    spec["max_iterations"] = json!(1);
    spec["rounds"] = json!(0);
    let report =
        plan(json!({"axis": "flexion_extension"}), spec).unwrap().run(&Library::default(), &Ctl::new()).unwrap();
    let result = &report.result;
    assert_eq!(result["difference"]["verdict"], "not_distinguished");
    assert_eq!(report.warnings[0].code, "null_result");
    assert!(result["conclusion"].as_str().unwrap().starts_with("Null result"));
    let given = &result["given"]["design"];
    assert_eq!((given["edge_hz"].as_f64(), given["width_m"].as_f64()), (Some(0.8), Some(0.6)));
    let over = result["given"]["over_nominal"]["mean"].as_f64().unwrap();
    assert!(over.abs() < 1e-3 * given["fresh"]["cost"].as_f64().unwrap().max(1.0), "{over}");
    // Far outside of what a neck bears, the same evaluation says so.
    let mut spec = small();
    spec["given"] = json!({"edge_hz": 3.0, "width_m": 4.0});
    spec["max_iterations"] = json!(1);
    spec["rounds"] = json!(0);
    let report =
        plan(json!({"axis": "flexion_extension"}), spec).unwrap().run(&Library::default(), &Ctl::new()).unwrap();
    let interval = &report.result["given"]["over_nominal"]["interval"];
    assert!(interval[0].as_f64().unwrap() > 0.0, "{interval}");
}

#[test]
fn impossible_experiments_are_named() {
    let axis = json!({"axis": "flexion_extension"});
    let with = |inputs: Value, spec: Value| plan(inputs, spec).map(|_| ()).unwrap_err();
    let cases = [
        (json!({}), json!({}), "/inputs", "no axis"),
        (json!({"axis": "sideways"}), json!({}), "/inputs/axis", "unknown variant"),
        (axis.clone(), json!({"experiment": {"edge_hz": [0.1, 30]}}), "/spec/experiment/edge_hz", "Nyquist"),
        (axis.clone(), json!({"experiment": {"edge_hz": [2, 1]}}), "/spec/experiment/edge_hz", "nothing"),
        (axis.clone(), json!({"experiment": {"sample_time_s": 0}}), "/spec/experiment/sample_time_s", "0 s"),
        (axis.clone(), json!({"experiment": {"duration_s": 0.1}}), "/spec/experiment/duration_s", "samples"),
        (axis.clone(), json!({"draws": 1}), "/spec/draws", "from 2"),
        (axis.clone(), json!({"fresh_draws": 3}), "/spec/fresh_draws", "from 4"),
        (axis.clone(), json!({"given": {"edge_hz": 30, "width_m": 1}}), "/spec/given/edge_hz", "Nyquist"),
        (axis.clone(), json!({"given": {"edge_hz": 1, "width_m": 0}}), "/spec/given/width_m", "positive"),
        (axis.clone(), json!({"start": [5, 1]}), "/spec/start/0", "outside"),
        (
            axis.clone(),
            json!({"average_subject": {"k_p": 9, "k_d": 0.2, "k_i": 15, "tau": 0.25}}),
            "/spec/average_subject/k_p",
            "outside",
        ),
        (
            json!({"axis": "flexion_extension", "population": {"controller": {"k_i": [12, 900]}}}),
            json!({}),
            "/inputs/population",
            "not stable",
        ),
        (
            json!({"axis": "flexion_extension", "population": {"inertia": -1}}),
            json!({}),
            "/inputs/population/inertia",
            "positive",
        ),
        (axis.clone(), json!({"order": 3}), "/spec/order", "unknown field"),
    ];
    for (inputs, spec, at, words) in cases {
        let problem = with(inputs, spec);
        assert_eq!(problem.location.as_deref(), Some(at), "{problem}");
        assert!(problem.detail.contains(words), "{problem}");
    }
    let problem =
        with(axis, json!({"draws": 2000, "experiment": {"duration_s": 300}, "max_iterations": 200, "rounds": 20}));
    assert_eq!(problem.code, Code::Unaffordable);
}

#[test]
fn it_stops_when_asked() {
    let ctl = Ctl::new();
    ctl.stop(crate::ctl::StopReason::Cancelled);
    let found = plan(json!({"axis": "axial_rotation"}), small()).unwrap().run(&Library::default(), &ctl);
    assert!(matches!(found, Err(Failure::Stopped(_))));
}
