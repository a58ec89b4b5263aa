use super::*;
use crate::analysis::problem::Code;
use crate::analysis::{Plan, Report};
use crate::control::MultivariableModel;
use crate::ctl::StopReason;
use nalgebra::DMatrix;
use num_complex::Complex64;
use serde_json::{Value, json};

/// The example of Zhang 2015, section 4.6, on a pool around the truth.
fn request() -> Value {
    let plant = json!({
        "numerator": [[[1.0], [0.0]], [[0.0], [-1.0]]],
        "denominator": [[[1.0, 0.1], [0.0]], [[0.0], [1.0, -0.2]]],
        "sample_time_s": 1.0,
    });
    let model: MultivariableModel = serde_json::from_value(plant.clone()).unwrap();
    let MultivariableSystem::Discrete(system) = model.check().unwrap() else { panic!("{model:?}") };
    let real = |rows: [f64; 4]| DMatrix::from_row_slice(2, 2, &rows).map(|v| Complex64::new(v, 0.0));
    let omega: Vec<f64> = (1..=20).map(|k| 0.02 * std::f64::consts::PI * f64::from(k)).collect();
    let h: Vec<Vec<Vec<[f64; 2]>>> = omega
        .iter()
        .map(|w| {
            let z = Complex64::from_polar(1.0, *w);
            let (g, fb) = (system.eval(z).unwrap(), real([0.3, 1.0, 0.2, 0.4]));
            let ff = real([1.0, 1.0, 0.5, 0.0]) + real([-0.3, 0.4, 0.0, 1.0]) / z;
            let closed = &g * (DMatrix::identity(2, 2) + &fb * &g).try_inverse().unwrap() * (fb + ff);
            closed.row_iter().map(|row| row.iter().map(|v| [v.re, v.im]).collect()).collect()
        })
        .collect();
    let axis = |low: f64, high: f64| json!([{"from": low, "to": high, "step": 0.1}]);
    json!({
        "kind": "ssid_mimo",
        "inputs": {"plant": plant, "frequency_response": {"omega_rad_s": omega, "h": h}},
        "spec": {
            "pool": {"matrix_grid": {"feedback_numerator": [
                [axis(0.1, 0.5), axis(0.8, 1.2)], [axis(0.0, 0.4), axis(0.2, 0.6)]
            ]}},
            "feedforward_order": 1,
        },
    })
}

fn parsed(request: &Value) -> Result<Plan, Problem> {
    Plan::parse(&serde_json::from_value(request.clone()).unwrap())
}

fn run(request: &Value) -> Result<Report, Failure> {
    parsed(request).map_err(Failure::Problem)?.run(&Library::default(), &Ctl::new())
}

#[test]
fn a_report_holds_the_truth_and_its_certificate() {
    let report = run(&request()).unwrap();
    assert_eq!((report.kind.name(), report.schema.as_str()), ("ssid_mimo", "volition.ssid_mimo/1"));
    let result: SsidMimoResult = serde_json::from_value(report.result.clone()).unwrap();
    assert_eq!(result.feedback.numerator, [[vec![0.3], vec![1.0]], [vec![0.2], vec![0.4]]]);
    assert_eq!(result.feedback.denominator, [[vec![1.0], vec![0.0]], [vec![0.0], vec![1.0]]]);
    assert_eq!(result.feedforward.denominator[0][0], [1.0, 0.0]);
    let expected = [[[1.0, -0.3], [1.0, 0.4]], [[0.5, 0.0], [0.0, 1.0]]];
    for (i, row) in result.feedforward.transfer_functions.iter().enumerate() {
        for (j, entry) in row.iter().enumerate() {
            let mut num = entry.num.clone();
            num.splice(0..0, vec![0.0; 2 - entry.num.len()]);
            assert!(num.iter().zip(&expected[i][j]).all(|(a, b)| (a - b).abs() < 1e-12), "{i} {j} {num:?}");
            assert_eq!((entry.den.as_slice(), entry.sample_time_s), (&[1.0, 0.0][..], Some(1.0)));
        }
    }
    assert!(result.cost < 1e-27 && result.unreachable_cost == 0.0, "{} {}", result.cost, result.unreachable_cost);
    let certificate = &result.certificate;
    assert!(certificate.exact && certificate.pool_size <= 625 && certificate.evaluated == certificate.pool_size);
    assert_eq!((certificate.listed, certificate.listed_index), (625, 2 * 125 + 2 * 25 + 2 * 5 + 2));
    assert_eq!((result.near_optimal.count, result.near_optimal.is_lower_bound), (1, false));
    assert_eq!((result.fit.len(), result.closed_loop_poles.len()), (20, 2));
    assert!(result.stability.spectral_radius.unwrap() < 1.0);
    assert!(result.residual_share.iter().flatten().all(|share| share.unwrap() < 1e-27));
    assert_eq!(result.identifiability.unknowns, 12);
    assert!(report.warnings.iter().any(|w| w.code == "feedback_from_structure"), "{:?}", report.warnings);
    assert_eq!(report.provenance.inputs_sha256.len(), 4);
    // The same bytes again.
    assert_eq!(run(&request()).unwrap(), report);
}

#[test]
fn the_canonical_request_parses_to_an_equal_plan() {
    let mut continuous = request();
    continuous["inputs"]["plant"] =
        json!({"a": [[-1.0, 0.0], [0.0, -2.0]], "b": [[1, 0], [0, 1]], "c": [[1, 0], [0, 1]], "d": [[0, 0], [0, 0]]});
    continuous["spec"]["sample_time_s"] = json!(0.1);
    for request in [request(), continuous] {
        let first = parsed(&request).unwrap();
        let again = Plan::parse(&first.request()).unwrap();
        assert_eq!(again.request(), first.request());
        assert_eq!(first.request().inputs["fed_back_outputs"], json!([0, 1]));
        assert_eq!(first.request().spec["max_candidates"], json!(500_000_000));
        assert!(first.references().is_empty());
    }
}

/// Other outputs than those fed back: the first is measured, the second compared with the command.
#[test]
fn measured_and_fed_back_outputs_may_differ() {
    let plant = json!({"a": [[0.9, 0.1], [0.0, 0.8]], "b": [[0.0], [1.0]], "c": [[1, 0], [0, 1]], "d": [[0], [0]],
        "sample_time_s": 0.1});
    let model: MultivariableModel = serde_json::from_value(plant.clone()).unwrap();
    let MultivariableSystem::Discrete(system) = model.check().unwrap() else { panic!("{model:?}") };
    let omega: Vec<f64> = (1..=15).map(f64::from).collect();
    let h: Vec<_> = omega
        .iter()
        .map(|w| {
            let z = Complex64::from_polar(1.0, 0.1 * w);
            let g = system.eval(z).unwrap();
            let (ff, fb) = (0.5 + 0.25 / z, 0.6 / (z - 0.3));
            let closed = g[(0, 0)] * (fb + ff) / (1.0 + fb * g[(1, 0)]);
            [[[closed.re, closed.im]]]
        })
        .collect();
    let request = json!({"kind": "ssid_mimo",
        "inputs": {"plant": plant, "measured_outputs": [0], "fed_back_outputs": [1],
                   "frequency_response": {"omega_rad_s": omega, "h": h, "variance": vec![0.1; 15]}},
        "spec": {"pool": {"matrix_grid": {"feedback_numerator": [[[{"from": 0.1, "to": 1.0, "step": 0.1}]]],
                                          "feedback_denominator": [[[{"from": -0.9, "to": 0.9, "step": 0.1}]]]}},
                 "feedforward_order": 1, "weights": "inverse_variance"}});
    let report = run(&request).unwrap();
    let result: SsidMimoResult = serde_json::from_value(report.result).unwrap();
    assert_eq!((&result.feedback.numerator[0][0], &result.feedback.denominator[0][0]), (&vec![0.6], &vec![1.0, -0.3]));
    let ff = &result.feedforward.transfer_functions[0][0].num;
    assert!((ff[0] - 0.5).abs() < 1e-12 && (ff[1] - 0.25).abs() < 1e-12, "{ff:?}");
    assert_eq!(result.fit[0].weight, 1.0);
}

#[test]
fn every_refusal_names_its_place() {
    for (change, value, code, location, words) in [
        ("/spec/pool", json!("zhang2015_appendix_c"), Code::Invalid, "/spec/pool", "several inputs"),
        (
            "/spec/pool/matrix_grid/feedback_numerator/0",
            json!([]),
            Code::Invalid,
            "/spec/pool/matrix_grid/feedback_numerator",
            "2x0",
        ),
        (
            "/spec/pool/matrix_grid/feedback_numerator/1",
            json!([]),
            Code::Invalid,
            "/spec/pool/matrix_grid/feedback_numerator/1",
            "must be 2x2",
        ),
        (
            "/spec/pool/matrix_grid/feedback_numerator",
            json!([[[[0.1]], [[0.1]]]]),
            Code::Invalid,
            "/spec/pool/matrix_grid/feedback_numerator",
            "is 1x2, and must be 2x2",
        ),
        ("/spec/pool/stability_margin", json!(-1.0), Code::Invalid, "/spec/pool/stability_margin", "-1"),
        ("/spec/pool/stability_margin", json!(40.0), Code::NotIdentifiable, "/spec/pool", "none of the 625"),
        ("/spec/max_candidates", json!(624), Code::Unaffordable, "/spec/pool", "625"),
        ("/spec/max_candidates", json!(0), Code::Invalid, "/spec/max_candidates", "at least one"),
        (
            "/spec/feedforward_order",
            json!(39),
            Code::NotIdentifiable,
            "/inputs/frequency_response",
            "160 equations for 164",
        ),
        ("/spec/feedforward_order", json!(60), Code::NotIdentifiable, "/inputs/frequency_response", "do not determine"),
        ("/spec/feedforward_order", json!(1000), Code::Invalid, "/spec/feedforward_order", "200"),
        (
            "/spec/feedforward_numerator_degree",
            json!(1),
            Code::Invalid,
            "/spec/feedforward_numerator_degree",
            "unknown field",
        ),
        ("/spec/weights", json!("inverse_variance"), Code::Invalid, "/spec/weights", "no variance"),
        ("/spec/sample_time_s", json!(0.0), Code::Invalid, "/spec/sample_time_s", "not positive"),
        ("/inputs/trial", json!("x"), Code::Invalid, "/inputs/trial", "one command, one control and one output"),
        ("/inputs/frequency_response", json!(null), Code::Invalid, "/inputs", "no frequency_response"),
        ("/inputs/plant", json!(null), Code::Invalid, "/inputs", "no plant"),
        ("/inputs/plant", json!({"a": 1}), Code::Invalid, "/inputs/plant", "sequence"),
        ("/inputs/plant/denominator", json!([[[1.0, 0.1]]]), Code::Invalid, "/inputs/plant", "denominator is 1x1"),
        ("/inputs/plant/numerator/1", json!([[0.0]]), Code::Invalid, "/inputs/plant", "ragged"),
        (
            "/inputs/plant/numerator",
            json!([[[1], [2]], [[2], [4]]]),
            Code::NotIdentifiable,
            "/inputs",
            "full column rank",
        ),
        ("/inputs/plant/sample_time_s", json!(null), Code::Invalid, "/spec/sample_time_s", "continuous"),
        ("/inputs/plant/sample_time_s", json!(100.0), Code::NotIdentifiable, "/inputs", "Nyquist"),
        (
            "/inputs/measured_outputs",
            json!([0]),
            Code::Invalid,
            "/inputs/frequency_response/h/0",
            "is 2x2, and must be 1x2",
        ),
        ("/inputs/measured_outputs", json!([0, 5]), Code::Invalid, "/inputs/measured_outputs", "output 5"),
        ("/inputs/fed_back_outputs", json!([]), Code::Invalid, "/inputs/fed_back_outputs", "empty"),
        (
            "/inputs/frequency_response/h/2/1",
            json!([[1, 0]]),
            Code::Invalid,
            "/inputs/frequency_response/h/2/1",
            "ragged",
        ),
        ("/inputs/frequency_response/h/2", json!([]), Code::Invalid, "/inputs/frequency_response/h/2", "0x0"),
        (
            "/inputs/frequency_response/h/0",
            json!([1, 0]),
            Code::Invalid,
            "/inputs/frequency_response/h",
            "a matrix for each line",
        ),
        (
            "/inputs/frequency_response/omega_rad_s/3",
            json!(-0.1),
            Code::Invalid,
            "/inputs/frequency_response/omega_rad_s/3",
            "negative",
        ),
    ] {
        let mut request = request();
        let (parent, name) = change.rsplit_once('/').unwrap();
        match request.pointer_mut(parent).unwrap() {
            Value::Array(list) => list[name.parse::<usize>().unwrap()] = value,
            object => object[name] = value,
        }
        let problem = match run(&request) {
            Err(Failure::Problem(problem)) => problem,
            other => panic!("{change}: {other:?}"),
        };
        assert_eq!((problem.code, problem.location.as_deref()), (code, Some(location)), "{change}: {problem}");
        assert!(problem.to_string().contains(words), "{change}: {problem}");
    }
}

#[test]
fn ssid_given_matrices_names_this_kind() {
    let refused = |change: &dyn Fn(&mut Value)| {
        let mut request = request();
        request["kind"] = json!("ssid");
        change(&mut request);
        let problem = parsed(&request).unwrap_err();
        assert!(problem.mend.as_ref().is_some_and(|mend| mend.contains("ssid_mimo")), "{problem}");
        problem.location.unwrap()
    };
    let single = json!({"num": [4], "den": [1, 2]});
    assert!(refused(&|_| {}).starts_with("/inputs/plant/"));
    assert_eq!(refused(&|r| r["inputs"]["plant"] = single.clone()), "/inputs/frequency_response/h");
    let response = json!({"omega_rad_s": [0.6], "h": [[1.1, 0.1]]});
    let pool = refused(&|r| {
        r["inputs"] = json!({"plant": single, "frequency_response": response});
    });
    assert_eq!(pool, "/spec/pool/matrix_grid");
    // A plant with several inputs, asked for as if it had one.
    let wide = refused(&|r| {
        let plant = json!({"a": [[0.5]], "b": [[1, 1]], "c": [[1]], "d": [[0, 0]], "sample_time_s": 1.0});
        r["inputs"] = json!({"plant": plant, "frequency_response": response});
        r["spec"] = json!({"pool": "zhang2015_appendix_c"});
    });
    assert_eq!(wide, "/inputs/plant");
}

#[test]
fn a_stopped_analysis_is_no_problem() {
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    let stopped = parsed(&request()).unwrap().run(&Library::default(), &ctl);
    assert!(matches!(stopped, Err(Failure::Stopped(_))), "{stopped:?}");
}
