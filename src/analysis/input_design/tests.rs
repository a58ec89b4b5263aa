use super::{Model, ModelInput, catalogue};
use crate::analysis::{Code, Failure, Library, Plan, Problem, Report, Request, samples};
use crate::ctl::Ctl;
use serde_json::{Value, json};

fn plan(inputs: Value, spec: Value) -> Result<Plan, Problem> {
    Plan::parse(&Request { kind: "input_design".to_owned(), inputs, spec })
}

fn run(inputs: Value, spec: Value) -> Report {
    let plan = plan(inputs, spec).unwrap();
    assert_eq!(Plan::parse(&plan.request()).unwrap().request(), plan.request(), "canonical");
    plan.run(&Library::default(), &Ctl::new()).unwrap()
}

fn refused(inputs: Value, spec: Value) -> Problem {
    match plan(inputs, spec) {
        Err(problem) => problem,
        Ok(plan) => match plan.run(&Library::default(), &Ctl::new()) {
            Err(Failure::Problem(problem)) => problem,
            other => panic!("{other:?}"),
        },
    }
}

fn oscillator() -> Value {
    json!({"parameters": [{"name": "k", "value": 4, "lower": 0.1}, {"name": "b", "value": 0.8},
                          {"name": "m", "value": 1, "free": false}],
           "a": [[0, 1], ["-k/m", "-b/m"]], "b": [[0], ["1/m"]], "c": [[1, 0], ["-k/m", "-b/m"]], "d": [[0], ["1/m"]],
           "outputs": ["position", "acceleration"]})
}

fn alternating(samples: usize) -> Vec<f64> {
    (0..samples).map(|k| if k / 4 % 2 == 0 { 1.0 } else { -1.0 }).collect()
}

#[test]
fn a_model_of_formulas_is_designed_for_and_refitted() {
    let inputs = json!({"model": oscillator(), "starts": [
        alternating(60),
        {"generator": {"kind": "prbs", "order": 5, "chip_s": 0.4}, "sample_time_s": 0.2, "duration_s": 12}]});
    let spec = json!({"samples": 60, "sample_time_s": 0.2, "criterion": "a", "measured": ["position"],
                      "noise_covariance": [[1e-6]],
                      "limits": {"input": 1.5, "input_change": 3,
                                 "outputs": {"position": 0.8, "acceleration": [-4, 4]}},
                      "scale_to_fit": true, "monte_carlo": {"replicates": 400, "seed": 1}});
    let report = run(inputs.clone(), spec.clone());
    let result = &report.result;
    assert_eq!(report.schema, "volition.input_design/2");
    assert!(result["factor"].as_f64().unwrap() > 1.05, "{}", result["factor"]);
    for limit in result["limits"].as_array().unwrap() {
        assert!(limit["slack"].as_f64().unwrap() >= 0.0, "{limit}");
    }
    let monte_carlo = &result["monte_carlo"];
    assert_eq!(monte_carlo["all_within"], json!(true), "{monte_carlo}");
    for parameter in monte_carlo["parameters"].as_array().unwrap() {
        for over in parameter["over_predicted"].as_array().unwrap() {
            assert!((over.as_f64().unwrap() - 1.0).abs() < 0.15, "{parameter}");
        }
    }
    for parameter in result["parameters"].as_array().unwrap() {
        assert!(parameter["standard_deviation"][1].as_f64().unwrap() > 0.0);
    }
    assert!(result["proof"]["duality_gap"].as_f64().unwrap() < 1e-5, "{}", result["proof"]);
    assert_eq!(result["starts"].as_array().unwrap().len(), 2);
    assert_eq!(report.provenance.seed, Some(1));
    assert_eq!(run(inputs, spec).provenance.result_sha256, report.provenance.result_sha256);
}

#[test]
fn a_sampled_model_brings_its_sample_time() {
    let model = json!({"parameters": [{"name": "p", "value": 0.7}], "a": [["p"]], "b": [["1 - p"]], "c": [[1]],
                       "sample_time_s": 0.5});
    let inputs = json!({"model": model, "starts": [alternating(40)]});
    let report = run(inputs, json!({"samples": 40, "criterion": "t", "limits": {"input": 1, "outputs": {"y1": 0.95}}}));
    assert_eq!(report.result["sample_time_s"], json!(0.5));
    assert!(report.result["factor"].as_f64().unwrap() >= 1.0);
}

#[test]
fn the_head_is_in_the_catalogue() {
    let inputs = json!({"model": {"name": "head_neck", "axis": "axial_rotation", "values": {"t_m": 0.04}},
        "starts": [{"generator": {"kind": "prbs", "order": 5, "chip_s": 0.5, "amplitude": 0.2},
                    "sample_time_s": 0.1, "duration_s": 8}]});
    let spec = json!({"samples": 80, "sample_time_s": 0.1, "criterion": "scaled_a", "noise_covariance": [[1e-6]],
                      "max_steps": 20, "limits": {"input": 0.35, "outputs": {"angle": 0.8, "torque": 5.9}}});
    let report = run(inputs, spec);
    assert!(report.result["factor"].as_f64().unwrap() > 1.1, "{}", report.result["factor"]);
    assert_eq!(report.result["parameters"][3]["name"], json!("tau"));
}

#[test]
fn the_plants_of_the_catalogue_are_models() {
    use crate::control::{Discrete, TimeBase as _, discretise};
    use crate::plants::Plant as Catalogued;
    let sampled = |model: Value| {
        let ModelInput::Named(named) = ModelInput::read(&model, "/inputs/model").unwrap() else { panic!("{model}") };
        let model: Model = catalogue::named(&named).unwrap();
        let time = Discrete::new(0.1).unwrap();
        let found = model.sampled(&model.nominal(), time).unwrap();
        assert_eq!(found.slopes.len(), model.names().len());
        move |omega: f64| found.value.model.eval(time.point(omega)).unwrap()[(0, 0)]
    };
    for plant in Catalogued::ALL {
        let found = sampled(json!({"name": plant.name()}));
        let expected = discretise::zero_order_hold(&plant.transfer_function(), Discrete::new(0.1).unwrap()).unwrap();
        for omega in [0.3, 2.0, 9.0, 25.0] {
            let expected = expected.response(omega);
            assert!((found(omega) - expected).norm() < 1e-10 * expected.norm(), "{plant:?} {omega}");
        }
    }
    // Qiu 2021, equations 17 and 18.
    let found = sampled(json!({"name": "linear_drive", "values": {"mass": 8}}));
    let [b1, b2] = crate::excite::path::mass_damper_pulse(8.0, 50.0, 0.1);
    let z = Discrete::new(0.1).unwrap().point(3.0);
    let expected = (b1 * z + b2) / ((z - 1.0) * (z - (-0.625_f64).exp()));
    assert!((found(3.0) - expected).norm() < 1e-10 * expected.norm());

    // One is designed for: what matters is learnt better, within the limits, and the other masses are taken as known.
    let inputs = json!({"model": {"name": "two_mass", "free": ["m2", "k2", "c2"], "initial": [0, 0, 0.01, 0]},
        "starts": [{"generator": {"kind": "prbs", "order": 5, "chip_s": 0.4}, "sample_time_s": 0.2,
                    "duration_s": 12}]});
    let limits = json!({"input": 1.5, "outputs": {"first_position": 0.9, "velocity": 1.2}});
    let spec = json!({"samples": 60, "sample_time_s": 0.2, "criterion": "scaled_a", "noise_covariance": [[1e-6]],
        "limits": limits, "scale_to_fit": true, "monte_carlo": {"replicates": 200, "seed": 1}});
    let report = run(inputs.clone(), spec.clone());
    let result = &report.result;
    assert!(result["factor"].as_f64().unwrap() > 1.2, "{}", result["factor"]);
    assert_eq!(result["parameters"][0]["name"], json!("m2"));
    assert!(result["limits"].as_array().unwrap().iter().all(|limit| limit["slack"].as_f64().unwrap() >= 0.0));
    assert_eq!(result["monte_carlo"]["failed"], json!([0, 0]));
    let csv = samples::csv(&report).unwrap();
    assert!(csv.starts_with("t,signal,start\r\n0.0,") && csv.lines().count() == 61, "{csv}");

    for (change, at, words) in [
        (json!({"axis": "axial_rotation"}), "/inputs/model/axis", "takes no axis"),
        (json!({"delay_order": 2}), "/inputs/model/delay_order", "takes no delay_order"),
        (json!({"values": {"m3": 1}}), "/inputs/model/values/m3", "no parameter"),
        (json!({"values": {"m1": 0}}), "/inputs/model/values/m1", "positive"),
        (json!({"free": ["m1", "mass"]}), "/inputs/model/free/1", "no parameter"),
        (json!({"free": []}), "/inputs/model", "no parameter is free"),
        (json!({"initial": [0, 0]}), "/inputs/model/initial", "2 entries and must have 4"),
    ] {
        let mut inputs = inputs.clone();
        inputs["model"].as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        let problem = refused(inputs, spec.clone());
        assert_eq!(problem.location.as_deref(), Some(at), "{problem}");
        assert!(problem.detail.contains(words), "{problem}");
    }
    let seated = json!({"model": {"name": "seated_balance", "initial": [0.1]}, "starts": [[1]]});
    assert_eq!(refused(seated, spec).location.as_deref(), Some("/inputs/model/initial"));
}

#[test]
fn impossible_designs_are_named() {
    let good = json!({"samples": 60, "sample_time_s": 0.2, "limits": {"input": 1.5}});
    let starts = json!([alternating(60)]);
    let with = |field: &str, value: Value| {
        let mut spec = good.clone();
        spec[field] = value;
        spec
    };
    let model = |change: fn(&mut Value)| {
        let mut model = oscillator();
        change(&mut model);
        model
    };
    let cases = [
        (model(|m| m["a"][1][0] = json!("-kk/m")), good.clone(), "/inputs/model/a/1/0", "no parameter 'kk'"),
        (
            model(|m| m["parameters"][0]["value"] = json!(0)),
            good.clone(),
            "/inputs/model/parameters/0/value",
            "between",
        ),
        (model(|m| m["a"] = json!([[0, 1]])), good.clone(), "/inputs/model/a", "1x2"),
        (model(|m| m["a"][1][1] = json!("1/(m - m)")), good.clone(), "/inputs/model", "finite"),
        (
            json!({"name": "seated_balance", "values": {"k9": 1}}),
            good.clone(),
            "/inputs/model/values/k9",
            "no parameter",
        ),
        (oscillator(), with("samples", json!(5)), "/spec/samples", "5 samples"),
        (oscillator(), with("samples", json!(61)), "/inputs/starts/0", "60 samples"),
        (oscillator(), with("limits", json!({"input": -1})), "/spec/limits/input", "contradicts"),
        (oscillator(), with("limits", json!({"input": [0.5, 1]})), "/spec/limits/input", "zero"),
        (
            oscillator(),
            with("limits", json!({"input": 2, "outputs": {"speed": 1}})),
            "/spec/limits/outputs/speed",
            "no output",
        ),
        (
            oscillator(),
            with("limits", json!({"input": 0.5})),
            "/inputs/starts",
            "sample 0 of the input is 1, beyond 0.5",
        ),
        (
            oscillator(),
            with("limits", json!({"input": 2, "outputs": {"position": 0.01}})),
            "/inputs/starts",
            "position",
        ),
        (
            oscillator(),
            with("limits", json!({"input": 2, "autocorrelation": {"tolerance": 0.1, "margin": 0.1}})),
            "/spec/limits/autocorrelation/margin",
            "below",
        ),
        (
            oscillator(),
            with("limits", json!({"input": 2, "autocorrelation": {"reference": vec![0.0; 29]}})),
            "/inputs/starts",
            "autocorrelation",
        ),
        (oscillator(), with("measured", json!(["speed"])), "/spec/measured/0", "no output"),
        (
            oscillator(),
            with("noise_covariance", json!([[1, 2], [2, 1]])),
            "/spec/noise_covariance",
            "positive definite",
        ),
        (oscillator(), with("criterion", json!("e")), "/spec/criterion", "unknown variant"),
        (oscillator(), with("monte_carlo", json!({"replicates": 1})), "/spec/monte_carlo/replicates", "1 records"),
        (oscillator(), with("sample_time_s", json!(-1)), "/spec/sample_time_s", "-1"),
        (
            model(|m| m["initial"] = json!([3, 0])),
            with("limits", json!({"input": 2, "outputs": {"position": 1}})),
            "/spec/limits",
            "without any input",
        ),
    ];
    for (model, spec, at, words) in cases {
        let problem = refused(json!({"model": model, "starts": starts}), spec);
        assert_eq!(problem.location.as_deref(), Some(at), "{problem}");
        assert!(problem.detail.contains(words), "{problem}");
    }
    // Two parameters that only their product shows.
    let model = json!({"parameters": [{"name": "p", "value": 0.7}, {"name": "q", "value": 2},
                                      {"name": "r", "value": 3}],
                       "a": [["p"]], "b": [["q*r"]], "c": [[1]], "sample_time_s": 0.5});
    let problem = refused(json!({"model": model, "starts": starts}), json!({"samples": 60, "limits": {"input": 2}}));
    assert_eq!(problem.code, Code::NotIdentifiable, "{problem}");
    assert!(problem.detail.contains(" q ") && problem.detail.contains(" r "), "{problem}");
    let order = json!([{"generator": {"kind": "prbs", "order": 0, "chip_s": 0.4}, "sample_time_s": 0.2}]);
    let problem = refused(json!({"model": oscillator(), "starts": order}), good);
    assert!(problem.location.unwrap().starts_with("/inputs/starts/0"), "{}", problem.detail);
}
