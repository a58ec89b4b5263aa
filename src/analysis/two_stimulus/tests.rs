use super::*;
use crate::analysis::{Plan, Report, Request};
use crate::ctl::StopReason;
use crate::two_stimulus::structure::Muscles;
use serde_json::{Value, json};

fn complex(z: Complex64) -> [f64; 2] {
    [z.re, z.im]
}

/// Responses of a McRuer person with feedforward on 1/s.
fn responses_of(with_disturbance: bool) -> Value {
    let plant = json!({"num": [1.0], "den": [1.0, 0.0], "sample_time_s": null});
    let system = check_plant(&serde_json::from_value(plant.clone()).unwrap(), "").unwrap();
    let person = Person::new(&system, Structure::mcruer(true, Muscles::None), [0.0, 1.0], 3.0).unwrap();
    let values = [3.0, 0.15, 0.9, 0.18, 0.8, 0.12, 0.25];
    let omega: Vec<f64> = (1..=12).map(|k| 0.7 * f64::from(k)).collect();
    let h: Vec<[Complex64; 4]> = omega.iter().map(|w| person.closed_loop(&values, *w)).collect();
    let h_yr: Vec<[f64; 2]> = h.iter().map(|h| complex(h[1])).collect();
    let h_yd: Vec<Option<[f64; 2]>> = h.iter().map(|h| with_disturbance.then(|| complex(h[3]))).collect();
    json!({"plant": plant, "frequency_response": {"omega_rad_s": omega, "h_yr": h_yr, "h_yd": h_yd}})
}

fn run(inputs: Value, spec: Value) -> Result<Report, Failure> {
    let request = Request { kind: "two_stimulus".to_owned(), inputs, spec };
    let plan = Plan::parse(&request)?;
    assert_eq!(
        Plan::parse(&plan.request()).unwrap().request(),
        plan.request(),
        "canonical requests parse to equal plans"
    );
    plan.run(&Library::default(), &Ctl::new())
}

#[test]
fn responses_in_the_request_give_both_controllers() {
    let structure = json!({"feedback": "lead_lag", "feedforward": "inverse_dynamics"});
    let report = run(responses_of(true), json!({"structures": [structure], "starts": 4})).unwrap();
    let fit = &report.result["fits"][0];
    for (i, truth) in [3.0, 0.15, 0.9, 0.18, 0.8, 0.12, 0.25].into_iter().enumerate() {
        let found = fit["parameters"][i]["value"].as_f64().unwrap();
        assert!((found / truth - 1.0).abs() < 1e-3, "{i}: {found} {truth}");
    }
    let line = &report.result["lines"][3];
    let number = |v: &Value| v.as_f64().unwrap();
    let fb = Complex64::new(number(&line["feedback"]["value"][0]), number(&line["feedback"]["value"][1]));
    let s = Complex64::new(0.0, 2.8);
    let truth = 3.0 * (1.0 + 0.15 * s) / (1.0 + 0.9 * s) * (-0.18 * s).exp();
    assert!((fb - truth).norm() < 1e-9, "{fb} {truth}");
    assert!(report.warnings.iter().any(|w| w.code == "noise_unknown"));
}

#[test]
fn a_pool_is_searched_for_both_responses() {
    // Zhang 2015, section 2.6: Gp = 4/(s+2), Gff = (2.1s+3)/(s+6.5), Gfb = 5.4/(s+7.1).
    let s = |w: f64| Complex64::new(0.0, w);
    let omega: Vec<f64> = (1..=12).map(|k| 0.6 * f64::from(k)).collect();
    let laws = |w: f64| (4.0 / (s(w) + 2.0), (2.1 * s(w) + 3.0) / (s(w) + 6.5), 5.4 / (s(w) + 7.1));
    let pick = |f: &dyn Fn(f64) -> Complex64| -> Vec<[f64; 2]> { omega.iter().map(|w| complex(f(*w))).collect() };
    let h_yr = pick(&|w| {
        let (g, ff, fb) = laws(w);
        g * (ff + fb) / (1.0 + g * fb)
    });
    let h_yd = pick(&|w| {
        let (g, _, fb) = laws(w);
        g / (1.0 + g * fb)
    });
    let inputs = json!({
        "plant": {"num": [4.0], "den": [1.0, 2.0], "sample_time_s": null},
        "frequency_response": {"omega_rad_s": omega, "h_yr": h_yr, "h_yd": h_yd}
    });
    let axis = json!([{"from": 3.4, "to": 8.0, "step": 0.1}]);
    let spec = json!({
        "pool": {"grid": {"feedforward_denominator": axis, "feedback_numerator": axis, "feedback_denominator": axis},
            "stability_margin": 0.0},
        "feedforward_numerator_degree": 1, "structures": []
    });
    let report = run(inputs.clone(), spec.clone()).unwrap();
    let pool = &report.result["pool"];
    assert!(pool["cost"].as_f64().unwrap() < 1e-20, "{pool}");
    for (pointer, truth) in
        [("/feedback/num/0", 5.4), ("/feedback/den/1", 7.1), ("/feedforward/num/0", 2.1), ("/feedforward/den/1", 6.5)]
    {
        let found = pool.pointer(pointer).and_then(Value::as_f64).unwrap();
        assert!((found - truth).abs() < 1e-9, "{pointer}: {pool}");
    }
    let mut small = spec;
    small["max_candidates"] = json!(10);
    let Err(Failure::Problem(problem)) = run(inputs.clone(), small) else { panic!("a pool past its limit") };
    assert_eq!(problem.code, Code::Unaffordable);
    let Err(Failure::Problem(problem)) = run(inputs, json!({"max_candidates": 10})) else { panic!("a stray limit") };
    assert_eq!(problem.location.as_deref(), Some("/spec/max_candidates"));
}

#[test]
fn the_command_alone_is_refused_with_the_reason() {
    let Err(Failure::Problem(problem)) = run(responses_of(false), json!({})) else { panic!("a result from r alone") };
    assert_eq!(problem.code, Code::NotIdentifiable);
    assert!(problem.detail.contains("cannot be told apart"), "{problem}");
}

#[test]
fn every_refusal_names_its_place() {
    for (change, location) in [
        (json!({"starts": 0}), "/spec/starts"),
        (json!({"delay_s": [1.0, 0.5]}), "/spec/delay_s"),
        (json!({"structures": "all"}), "/spec/structures"),
        (json!({"structure": []}), "/spec/structure"),
        (json!({"frequency": {}}), "/spec/frequency"),
    ] {
        let Err(Failure::Problem(problem)) = run(responses_of(true), change.clone()) else { panic!("{change}") };
        assert_eq!(problem.location.as_deref(), Some(location), "{change}: {problem}");
    }
    let mut short = responses_of(true);
    short["frequency_response"]["h_yd"] = json!([[1.0, 0.0]]);
    let mut zero = responses_of(true);
    zero["frequency_response"]["h_yr"][2] = json!([0.0, 0.0]);
    let mut twins = responses_of(true);
    twins["frequency_response"]["omega_rad_s"][1] = twins["frequency_response"]["omega_rad_s"][0].clone();
    let mut lone = responses_of(true);
    lone["frequency_response"]["variance_yr"] = json!(vec![1.0; 12]);
    for (inputs, location) in [
        (short, "/inputs/frequency_response/h_yd"),
        (zero, "/inputs/frequency_response/h_yr/2"),
        (twins, "/inputs/frequency_response/omega_rad_s/1"),
        (lone, "/inputs/frequency_response/variance_yr"),
    ] {
        let Err(Failure::Problem(problem)) = run(inputs, json!({})) else { panic!("{location}") };
        assert_eq!(problem.location.as_deref(), Some(location), "{problem}");
    }
    let id = "0190b3e0-0000-7000-8000-000000000001";
    let inputs = json!({"trials": [id], "validate_on": [id]});
    let Err(Failure::Problem(problem)) = run(inputs, json!({})) else { panic!("validated on itself") };
    assert_eq!(problem.location.as_deref(), Some("/inputs/validate_on/0"));
}

#[test]
fn it_stops_when_asked() {
    let request = Request { kind: "two_stimulus".to_owned(), inputs: responses_of(true), spec: json!({}) };
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    assert!(matches!(Plan::parse(&request).unwrap().run(&Library::default(), &ctl), Err(Failure::Stopped(_))));
}
