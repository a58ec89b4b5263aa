//! Documents that once came out wrong, unclear or not at all, with what is right.

use proptest::prelude::*;
use serde_json::{Value, json};
use std::fs::File;
use std::path::Path;
use volition::analysis::{Code, Failure, Library, Plan, Problem, Report, Request};
use volition::ctl::Ctl;

#[path = "../support/property.rs"]
mod property;

fn document(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases/identify").join(name);
    let file = File::open(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    if name.ends_with(".gz") {
        serde_json::from_reader(flate2::read::GzDecoder::new(file)).unwrap()
    } else {
        serde_json::from_reader(file).unwrap()
    }
}

fn run(document: &Value) -> Result<Report, Problem> {
    let request = Request {
        kind: document["kind"].as_str().unwrap().to_owned(),
        inputs: document["inputs"].clone(),
        spec: document["spec"].clone(),
    };
    match Plan::parse(&request)?.run(&Library::default(), &Ctl::new()) {
        Ok(report) => Ok(report),
        Err(Failure::Problem(problem)) => Err(problem),
        Err(other) => panic!("{other}"),
    }
}

fn codes(report: &Report) -> Vec<&str> {
    report.warnings.iter().map(|warning| warning.code.as_str()).collect()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

// ---- hidden modes

#[test]
fn f20_a_cancelled_integrator_is_named_and_no_pool_is_blamed() {
    let problem = run(&document("F20_cancel_origin.json")).unwrap_err();
    assert_eq!(problem.code, Code::NotIdentifiable);
    assert!(problem.detail.contains("share the root s = 0,"), "{problem}");
    assert!(!problem.to_string().contains("iden the pool"), "{problem}");
}

#[test]
fn f22_a_double_cancelled_integrator_among_far_coefficients_is_named() {
    let problem = run(&document("F22_jc679.json")).unwrap_err();
    assert!(problem.detail.contains("share the root s = 0,"), "{problem}");
    assert!(problem.mend.unwrap().contains("common factor"));
}

proptest! {
    #![proptest_config(property::from_seed(14, 40))]

    /// Plants with a common factor on or right of the boundary name it; the same plants without it do not.
    #[test]
    fn any_hidden_mode_is_named(
        kind in 0..3_u8, size in 0.05_f64..3.0, frequency in 0.3_f64..3.0, zero in 0.5_f64..4.0, pole in 0.5_f64..4.0,
    ) {
        let factor = match kind {
            0 => vec![1.0, -size],
            1 => vec![1.0, 0.0],
            _ => vec![1.0, -size, frequency * frequency + size * size / 4.0],
        };
        let times = |a: &[f64], b: &[f64]| {
            let mut product = vec![0.0; a.len() + b.len() - 1];
            for (i, x) in a.iter().enumerate() {
                for (j, y) in b.iter().enumerate() {
                    product[i + j] += x * y;
                }
            }
            product
        };
        let (num, den) = (vec![1.0, zero], vec![1.0, pole + 1.0, pole]);
        let mut case = document("F20_cancel_origin.json");
        case["inputs"]["plant"] = json!({"num": times(&num, &factor), "den": times(&den, &factor)});
        let problem = run(&case).unwrap_err();
        prop_assert!(problem.detail.contains("share the root"), "{}", problem);
        case["inputs"]["plant"] = json!({"num": num, "den": den});
        if let Err(problem) = run(&case) {
            prop_assert!(!problem.detail.contains("share the root"), "{}", problem);
        }
    }
}

// ---- ties

/// Zhang's Example 2.1: φ = (1, 3) and φ = (3, −1) give one closed loop; both are in the family.
#[test]
fn ex2_1_both_of_its_controllers_are_in_the_family() {
    let report = run(&document("ex2_1.json")).unwrap();
    let near = &report.result["near_optimal"];
    let family = near["family"].as_array().unwrap();
    assert!(family.len() >= 2, "{near}");
    let gains: Vec<f64> = family.iter().map(|c| numbers(&c["feedback"]["num"])[0]).collect();
    let distinct: std::collections::BTreeSet<i64> = gains.iter().map(|g| (g * 1e6).round() as i64).collect();
    assert!(distinct.len() >= 2, "{gains:?}");
    assert_eq!(near["family_is_complete"], json!(true));
    assert!(codes(&report).contains(&"near_optimal_candidates"), "{:?}", report.warnings);
}

#[test]
fn candidates_equal_to_rounding_are_all_in_the_family() {
    for (name, least) in [("ex4_1.json", 10), ("unstable_plant.json", 2), ("pure_feedback.json", 2)] {
        let report = run(&document(name)).unwrap();
        let near = &report.result["near_optimal"];
        let family = near["family"].as_array().unwrap();
        assert!(family.len() >= least, "{name}: {} candidates", family.len());
        let (best, rounding) = (near["family"][0]["cost"].as_f64().unwrap(), near["rounding"].as_f64().unwrap());
        let limit = (1.01 * best).max(best + rounding);
        for member in family {
            assert!(member["cost"].as_f64().unwrap() <= limit, "{name}: {member}");
        }
        // Every candidate that costs as little is listed, or the family does not claim it.
        if near["family_is_complete"] == json!(true) {
            assert!(near["count"].as_u64().unwrap() >= family.len() as u64, "{near}");
        }
    }
}

#[test]
fn noisy_data_have_the_family_of_one_per_cent() {
    for name in ["pure_feedback_noisy.json", "pure_feedforward_noisy.json"] {
        let report = run(&document(name)).unwrap();
        let near = &report.result["near_optimal"];
        let best = near["family"][0]["cost"].as_f64().unwrap();
        assert!(near["rounding"].as_f64().unwrap() < 1e-6 * best);
        for member in near["family"].as_array().unwrap() {
            assert!(member["cost"].as_f64().unwrap() <= 1.01 * best * (1.0 + 1e-12), "{name}");
        }
    }
}

// ---- lines

#[test]
fn unsorted_lines_are_sorted_and_twins_are_named() {
    let unsorted = document("unsorted_lines.json");
    let report = run(&unsorted).unwrap();
    let mut sorted = unsorted.clone();
    let response = &mut sorted["inputs"]["frequency_response"];
    for field in ["omega_rad_s", "h"] {
        response[field].as_array_mut().unwrap().reverse();
    }
    let other = run(&sorted).unwrap();
    assert_eq!(report.result, other.result);
    assert_eq!(report.provenance.inputs_sha256, other.provenance.inputs_sha256);

    let problem = run(&document("duplicated_lines.json")).unwrap_err();
    assert!(problem.detail.contains("is there twice, at the places"), "{problem}");
    assert!(problem.mend.is_some() && problem.location.unwrap().starts_with("/inputs/frequency_response/omega_rad_s/"));
}

// ---- fewer outputs than controls

/// Gy has one row and two columns; Ω₂ at the true feedback has singular values from 5.5 to 9e-4, so that the data
/// determine the feedforward all the same. Its feedback is [[.2, .1], [.1, .3]].
#[test]
fn mimo_y_not_v_is_identified() {
    let mut case = document("mimo_y_not_v.json");
    case["kind"] = json!("ssid_mimo");
    let report = run(&case).unwrap();
    assert!(report.result["cost"].as_f64().unwrap() < 1e-20, "{}", report.result["cost"]);
    // With two lines of one equation each the feedforward has more coefficients than there are equations.
    for field in ["omega_rad_s", "h"] {
        case["inputs"]["frequency_response"][field].as_array_mut().unwrap().truncate(2);
    }
    let problem = run(&case).unwrap_err();
    assert_eq!(problem.code, Code::NotIdentifiable, "{problem}");
}

// ---- known delays of the plant

/// G = e^{−.15 s}/s: the field was unknown.
#[test]
fn plant_delay_field_is_a_known_delay() {
    let case = document("plant_delay_field.json");
    let report = run(&case).unwrap();
    // The smallest cost over all candidates of the pool, by numpy.
    let cost = report.result["cost"].as_f64().unwrap();
    assert!((cost - 2.843_922_164_566e-4).abs() < 1e-12, "{cost}");
    assert!(codes(&report).contains(&"plant_delay"), "{:?}", report.warnings);
    let refined = &report.result["refined"];
    assert_eq!(refined["feedback_delay_s"], json!(0.15), "{refined}");
    // Without the delay nothing of the pool fits.
    let mut without = case.clone();
    without["inputs"]["plant"].as_object_mut().unwrap().remove("delay_s");
    assert!(run(&without).unwrap().result["cost"].as_f64().unwrap() > 10.0 * cost);
    let mut negative = case.clone();
    negative["inputs"]["plant"]["delay_s"] = json!(-0.1);
    assert!(run(&negative).unwrap_err().detail.contains("not negative"));
    let mut twice = case;
    twice["spec"]["delay"] = json!({"feedback_s": 0.1});
    assert_eq!(run(&twice).unwrap_err().location.as_deref(), Some("/spec/delay"));
}

proptest! {
    #![proptest_config(property::from_seed(15, 12))]

    /// A sampled plant with delay_s is the plant with as many poles at the origin, to the last digit.
    #[test]
    fn sampled_delays_are_poles_at_the_origin(samples in 1_usize..6, pole in 0.2_f64..0.9, gain in 0.1_f64..1.0) {
        let period = 0.1;
        let omega: Vec<f64> = (1..=20).map(|k| 0.5 * f64::from(k)).collect();
        let h: Vec<[f64; 2]> = omega.iter().map(|w| [1.0 / (1.0 + w), -0.3 * w / (1.0 + w)]).collect();
        let delay = samples as f64 * period;
        let plant = json!({"num": [gain], "den": [1.0, -pole], "sample_time_s": period, "delay_s": delay});
        let den = [vec![1.0, -pole], vec![0.0; samples]].concat();
        let longer = json!({"num": [gain], "den": den, "sample_time_s": period});
        let spec = json!({"pool": {"grid": {"feedback_numerator": [{"from": -0.3, "to": 0.3, "step": 0.1}]}},
            "feedforward_numerator_degree": 2, "feedforward_denominator_degree": 2});
        let with = |plant: Value| {
            run(&json!({"kind": "ssid", "spec": spec,
                "inputs": {"plant": plant, "frequency_response": {"omega_rad_s": omega, "h": h}}})).unwrap()
        };
        let (a, b) = (with(plant), with(longer));
        prop_assert_eq!(a.result, b.result);
    }
}

// ---- two stimuli

/// d = r/2 on every line of both trials: the file has no answer, whatever the structure.
#[test]
fn two_proportional_is_refused_as_confounded() {
    let problem = run(&document("two_proportional.json.gz")).unwrap_err();
    assert_eq!(problem.code, Code::NotIdentifiable);
    assert!(problem.detail.contains("in one proportion"), "{problem}");
}

/// Gff = s, Gfb = 3 e^{−.2 s} around the sampled integrator, whose inverse is half a sample late for s: it came out
/// with a feedforward delay of .02 s at its edge, a lag of .69 s and χ² of 713.
#[test]
fn a_feedforward_may_look_ahead_of_the_sampled_inverse() {
    let period = 1.0 / 60.0;
    let omega: Vec<f64> =
        [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31].iter().map(|k| f64::from(*k) * 0.314_159_265).collect();
    let pair = |z: num_complex::Complex64| json!([z.re, z.im]);
    let loops: Vec<[num_complex::Complex64; 2]> = omega
        .iter()
        .map(|w| {
            let s = num_complex::Complex64::new(0.0, *w);
            let g = period / (1.0 - (-s * period).exp());
            let fb = 3.0 * (-0.2 * s).exp();
            [g * (s + fb) / (1.0 + g * fb), g / (1.0 + g * fb)]
        })
        .collect();
    let variance = vec![1e-8; omega.len()];
    let case = json!({"kind": "two_stimulus",
        "inputs": {"plant": {"num": [period, 0.0], "den": [1.0, -1.0], "sample_time_s": period},
            "frequency_response": {"omega_rad_s": omega,
                "h_yr": loops.iter().map(|h| pair(h[0])).collect::<Vec<_>>(),
                "h_yd": loops.iter().map(|h| pair(h[1])).collect::<Vec<_>>(),
                "variance_yr": variance, "variance_yd": variance}},
        "spec": {}});
    let report = run(&case).unwrap();
    let fitted = &report.result["fits"][1];
    let parameter = |name: &str| -> f64 {
        let all = fitted["parameters"].as_array().unwrap_or_else(|| panic!("{fitted}"));
        let own = all.iter().find(|p| p["name"] == name).unwrap_or_else(|| panic!("no {name} in {fitted}"));
        own["value"].as_f64().unwrap()
    };
    assert!((parameter("feedback_gain") - 3.0).abs() < 0.05, "{fitted}");
    assert!((parameter("feedback_delay_s") - 0.2).abs() < 0.005, "{fitted}");
    assert!((parameter("feedforward_gain") - 1.0).abs() < 0.05, "{fitted}");
    assert!((parameter("feedforward_delay_s") + 0.5 * period).abs() < 0.006, "{fitted}");
    assert!(parameter("feedforward_lag_s") < 0.02, "{fitted}");
}
