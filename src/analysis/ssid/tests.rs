use super::*;
use crate::num::StopReason;
use serde_json::Value;

/// The example of Zhang 2015, section 2.6, on a pool around the truth.
fn request() -> Value {
    let omega: Vec<f64> = (1..=20).map(|k| 0.2 * std::f64::consts::PI * f64::from(k)).collect();
    let h: Vec<[f64; 2]> = omega
        .iter()
        .map(|w| {
            let s = num_complex::Complex64::new(0.0, *w);
            let (g, ff, fb) = (4.0 / (s + 2.0), (2.1 * s + 3.0) / (s + 6.5), 5.4 / (s + 7.1));
            let closed = g * (ff + fb) / (1.0 + g * fb);
            [closed.re, closed.im]
        })
        .collect();
    json!({
        "kind": "ssid",
        "inputs": {"plant": {"num": [4], "den": [1, 2]}, "frequency_response": {"omega_rad_s": omega, "h": h}},
        "spec": {"pool": {"grid": {
            "feedforward_denominator": [{"from": 6, "to": 7, "step": 0.1}],
            "feedback_numerator": [{"from": 5, "to": 6, "step": 0.1}],
            "feedback_denominator": [{"from": 7, "to": 8, "step": 0.1}],
        }}},
    })
}

fn plan(request: &Value) -> Result<Plan, Problem> {
    Plan::parse(&serde_json::from_value(request.clone()).unwrap())
}

fn run(request: &Value) -> Result<Report, Failure> {
    plan(request).map_err(Failure::Problem)?.run(&Library::default(), &Ctl::new())
}

#[test]
fn a_report_holds_the_truth_and_its_certificate() {
    let report = run(&request()).unwrap();
    let result: SsidResult = serde_json::from_value(report.result.clone()).unwrap();
    let crate::control::Model::TransferFunction(ff) = &result.feedforward else { panic!("{:?}", result.feedforward) };
    let crate::control::Model::TransferFunction(fb) = &result.feedback else { panic!("{:?}", result.feedback) };
    assert_eq!(
        (ff.den.as_slice(), fb.num.as_slice(), fb.den.as_slice()),
        (&[1.0, 6.5][..], &[5.4][..], &[1.0, 7.1][..])
    );
    assert!((ff.num[0] - 2.1).abs() < 1e-12 && (ff.num[1] - 3.0).abs() < 1e-12, "{:?}", ff.num);
    assert!(result.cost < 1e-28);
    assert_eq!(result.certificate.pool_size, 11 * 11 * 11);
    assert_eq!(result.certificate.evaluated, 11 * 11 * 11);
    // Feedback outermost: denominator 7.1 (1), numerator 5.4 (4), then feedforward 6.5 (5).
    assert_eq!(result.certificate.index, (11 + 4) * 11 + 5);
    assert_eq!(result.fit.len(), 20);
    assert_eq!(result.closed_loop_poles.len(), 3);
    assert!(result.stability.largest_exponent_per_s.unwrap() < 0.0);
    assert!(result.simulated_vaf.is_none() && result.simulated_vaf_reason.is_some());
    assert!(report.warnings.iter().any(|w| w.code == "feedback_from_structure"), "{:?}", report.warnings);
    assert_eq!(report.provenance.inputs_sha256.len(), 2);
    assert!(report.provenance.seed.is_none());
    // The same bytes again.
    assert_eq!(run(&request()).unwrap(), report);
}

#[test]
fn the_canonical_request_parses_to_an_equal_plan() {
    for pool in [
        json!("zhang2015_appendix_b"),
        json!({"name": "zhang2015_appendix_c", "thin": {"poles": 3, "feedforward_poles": 2}}),
        request()["spec"]["pool"].clone(),
        json!({"roots": {"feedback_poles": {"real_rad_s": [-1.0, -2.0]}, "peak_gains": [0, 1.0], "band_rad_s": [0.1, 2.0]}, "time": "sampled"}),
    ] {
        let mut request = request();
        request["spec"]["pool"] = pool;
        let first = plan(&request).unwrap();
        let again = Plan::parse(&first.request()).unwrap();
        assert_eq!(again, first);
        assert_eq!(again.request(), first.request());
    }
}

#[test]
fn every_refusal_names_its_place() {
    for (change, value, code, location, words) in [
        ("/spec/pool", json!("zhang"), Code::Invalid, "/spec/pool", "zhang2015_appendix_b"),
        ("/spec/pool", json!(null), Code::Invalid, "/spec", "no pool"),
        (
            "/spec/pool/grid/feedback_numerator",
            json!([]),
            Code::Invalid,
            "/spec/pool/grid/feedback_numerator",
            "at least one",
        ),
        (
            "/spec/feedforward_denominator_degree",
            json!(3),
            Code::Invalid,
            "/spec/feedforward_denominator_degree",
            "degree 1",
        ),
        (
            "/spec/feedforward_denominator_degree",
            json!(-1),
            Code::Invalid,
            "/spec/feedforward_denominator_degree",
            "-1",
        ),
        ("/spec/max_candidates", json!(1000), Code::Unaffordable, "/spec/pool", "1331"),
        ("/spec/frequency", json!({"lines": "excited"}), Code::Invalid, "/spec/frequency", "no trial"),
        ("/spec/band_hz", json!([1.0, 0.5]), Code::Invalid, "/spec/band_hz", "none"),
        ("/spec/weights", json!("inverse_variance"), Code::Invalid, "/spec/weights", "no variance"),
        ("/spec/pools", json!(1), Code::Invalid, "/spec/pools", "unknown field"),
        ("/inputs/trial", json!("x"), Code::Invalid, "/inputs/trial", "no input"),
        ("/inputs/plant", json!(null), Code::Invalid, "/inputs", "no plant"),
        ("/inputs/plant", json!({"num": [1], "den": [0]}), Code::Invalid, "/inputs/plant", "denominator is zero"),
        ("/inputs/plant", json!({"num": [0], "den": [1, 1]}), Code::NotIdentifiable, "/inputs", "none of the 20"),
        (
            "/inputs/frequency_response/omega_rad_s/3",
            json!(0.1),
            Code::Invalid,
            "/inputs/frequency_response/omega_rad_s/3",
            "increase",
        ),
        ("/inputs/frequency_response/h/3", json!([1.0]), Code::Invalid, "/inputs/frequency_response", "length"),
        (
            "/inputs/frequency_response",
            json!({"omega_rad_s": [1.0, 2.0], "h": [[1.0, 0.0], [0.9, -0.1]]}),
            Code::NotIdentifiable,
            "/inputs",
            "4 equations for 5",
        ),
        (
            "/spec/feedforward_numerator_degree",
            json!(25),
            Code::Invalid,
            "/spec/feedforward_numerator_degree",
            "at most 24",
        ),
    ] {
        let mut request = request();
        let (parent, name) = change.rsplit_once('/').unwrap();
        let parent = request.pointer_mut(parent).unwrap();
        match parent {
            Value::Array(items) => items[name.parse::<usize>().unwrap()] = value,
            parent => parent[name] = value,
        }
        let Err(Failure::Problem(problem)) = run(&request) else { panic!("{change} passed") };
        assert_eq!((problem.code, problem.location.as_deref()), (code, Some(location)), "{change}: {problem}");
        assert!(problem.detail.contains(words), "{change}: {problem}");
    }
}

#[test]
fn data_that_overflow_are_refused() {
    let mut request = request();
    for h in request["inputs"]["frequency_response"]["h"].as_array_mut().unwrap() {
        *h = json!([1e200, 1e200]);
    }
    let Err(Failure::Problem(problem)) = run(&request) else { panic!("passed") };
    assert_eq!(problem.code, Code::Numerical, "{problem}");
}

#[test]
fn a_sampled_pool_on_a_continuous_plant_needs_a_sample_time() {
    let mut request = request();
    request["spec"] = json!({"pool": {"grid": {"feedback_numerator": [[0.1, 0.2]], "feedback_denominator": [[-0.5]]}, "time": "sampled"}});
    let Err(Failure::Problem(problem)) = run(&request) else { panic!("passed") };
    assert_eq!(problem.location.as_deref(), Some("/spec/sample_time_s"));
    request["spec"]["sample_time_s"] = json!(0.02);
    let result: SsidResult = serde_json::from_value(run(&request).unwrap().result).unwrap();
    assert_eq!(result.plant.sample_time_s(), Some(0.02));
    assert!(result.stability.spectral_radius.unwrap() < 1.0);
}

#[test]
fn trials_are_simulated() {
    // A loop that follows the model class exactly, from rest, over whole periods after the start has died away.
    let time = crate::control::Discrete::new(0.1).unwrap();
    let tf = |num: &[f64], den: &[f64]| crate::control::TransferFunction::new(num, den, time).unwrap();
    let closed = crate::control::two_dof::TwoDegreesOfFreedom::new(
        tf(&[0.2], &[1.0, -0.8]),
        tf(&[0.7, 0.1], &[1.0, 0.0]),
        tf(&[0.5], &[1.0]),
    )
    .unwrap();
    let r: Vec<f64> = (0..800)
        .map(|i| {
            [1, 2, 3, 5, 7, 11]
                .iter()
                .map(|m| (f64::from(m * i) * std::f64::consts::TAU / 400.0 + f64::from(*m)).sin())
                .sum()
        })
        .collect();
    let response = closed.simulate(&r, None).unwrap();
    let request = json!({
        "kind": "ssid",
        "inputs": {"trial": {"sample_time_s": 0.1, "r": r, "u": response.control.unwrap(), "y": response.output},
                   "plant": {"num": [0.2], "den": [1.0, -0.8], "sample_time_s": 0.1}},
        "spec": {"pool": {"grid": {"feedback_numerator": [{"from": 0, "to": 1, "step": 0.1}]}},
                 "feedforward_numerator_degree": 1, "feedforward_denominator_degree": 1,
                 "frequency": {"segments": [{"start_s": 40, "end_s": 80}]}},
    });
    let report = run(&request).unwrap();
    let result: SsidResult = serde_json::from_value(report.result.clone()).unwrap();
    let crate::control::Model::TransferFunction(fb) = &result.feedback else { panic!() };
    assert_eq!(fb.num, [0.5]);
    let vaf = result.simulated_vaf.unwrap();
    assert!(vaf.y.unwrap() > 1.0 - 1e-9 && vaf.u.unwrap() > 1.0 - 1e-9, "{vaf:?} {:?}", report.warnings);
    assert_eq!(result.variance_accounted_for, vaf.y);
}

#[test]
fn it_stops_when_asked() {
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    assert!(matches!(plan(&request()).unwrap().run(&Library::default(), &ctl), Err(Failure::Stopped(_))));
}
