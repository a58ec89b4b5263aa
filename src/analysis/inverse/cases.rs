//! Documents that once came out wrong, each standing for a class; what is right and why is in
//! `tests/golden/inverse_cases/README.md`.

use crate::analysis::inputs::library::Library;
use crate::analysis::problem::Problem;
use crate::analysis::{Plan, Report, Request};
use crate::ctl::{Ctl, StopReason};
use serde_json::{Value, json};

macro_rules! case {
    ($name:literal) => {
        serde_json::from_str::<Value>(include_str!(concat!("../../../tests/golden/inverse_cases/", $name, ".json")))
            .unwrap()
    };
}

fn parsed(document: &Value) -> Result<Plan, Problem> {
    let member = |name: &str, default: Value| document.get(name).cloned().unwrap_or(default);
    let kind = document["kind"].as_str().unwrap().to_owned();
    Plan::parse(&Request { kind, inputs: member("inputs", json!({})), spec: member("spec", json!({})) })
}

fn run(document: &Value) -> Report {
    parsed(document).unwrap().run(&Library::default(), &Ctl::new()).unwrap()
}

/// Without a fit, which the verdict does not need.
fn unfitted(mut document: Value) -> Report {
    document["spec"]["fit"] = Value::Null;
    run(&document)
}

fn codes(report: &Report) -> Vec<&str> {
    report.warnings.iter().map(|w| w.code.as_str()).collect()
}

#[test]
fn gains_on_the_boundary_are_called_so() {
    for document in [
        case!("F01_inverse_velocity_cost_false_infeasible"),
        case!("F02_inverse_velocity_cost_false_feasible"),
        case!("F04_inverse_lqe_dual_false_infeasible"),
        case!("F05_inverse_sampled_false_infeasible"),
    ] {
        let report = unfitted(document);
        assert_eq!(report.result["verdict"], "boundary", "{}", report.result);
        assert_eq!(report.result["evidence"]["kind"], "return_difference");
        assert!(report.result["evidence"]["ratio"].as_f64().unwrap().abs() < 1.0);
        assert!(codes(&report).contains(&"boundary"), "{:?}", codes(&report));
    }
    // Q = diag(0, 336), R = 1 returns the first exactly: weights are found, and within a pattern that leaves the
    // position out they are definite, which for the whole is the boundary.
    let mut document = case!("F01_inverse_velocity_cost_false_infeasible");
    let report = unfitted(document.clone());
    assert!(report.result["forward_error"].as_f64().unwrap() < 1e-6);
    document["spec"]["state_weight"] = json!({"pattern": [[false, false], [false, true]]});
    let report = unfitted(document);
    let result = &report.result;
    assert_eq!((&result["verdict"], &result["within_pattern"]), (&json!("feasible"), &json!(true)), "{result}");
    assert_eq!(result["evidence"]["verdict"], "boundary");
    let ratio = result["q"][1][1].as_f64().unwrap() / result["r"][0][0].as_f64().unwrap();
    assert!((ratio / 336.0 - 1.0).abs() < 1e-9, "{ratio}");
    assert!(codes(&report).contains(&"within_pattern"));
}

#[test]
fn loops_that_are_stable_within_rounding_alone_are_refused() {
    for document in [case!("F07_inverse_marginal_loop_no_answer"), case!("F28_inverse_marginal_random")] {
        let problem = parsed(&document).unwrap_err();
        assert_eq!(problem.location.as_deref(), Some("/inputs/k"), "{problem}");
        assert!(problem.detail.contains("stable only within rounding"), "{problem}");
    }
}

#[test]
fn a_gain_of_zero_is_a_gain() {
    let report = run(&case!("F08_inverse_zero_gain_refused"));
    assert_eq!(report.result["verdict"], "feasible", "{}", report.result);
    // A is nilpotent: any gain that vanishes on its kernel would do.
    assert_eq!(report.result["uninformative"], true);
    assert!(report.result["forward_error"].as_f64().unwrap() < 1e-12);
}

#[test]
fn the_gain_of_the_corrected_estimate_has_a_form_of_its_own() {
    let mut document = case!("F23_pc1173_filt");
    let report = unfitted(document.clone());
    assert_eq!(report.result["verdict"], "infeasible");
    assert!(codes(&report).contains(&"filter_form"), "{:?}", codes(&report));
    document["spec"]["form"] = json!("filter");
    let report = unfitted(document);
    assert_eq!(report.result["verdict"], "feasible", "{}", report.result);
    assert!(report.result["forward_error"].as_f64().unwrap() < 1e-6);
    let mut regulator = case!("F02_inverse_velocity_cost_false_feasible");
    regulator["spec"]["form"] = json!("filter");
    assert_eq!(parsed(&regulator).unwrap_err().location.as_deref(), Some("/spec/form"));
}

#[test]
fn kalmans_inequality_proves_infeasibility() {
    for document in [case!("kalman_1_10"), case!("kalman_1_82"), case!("kalman_1_265")] {
        let report = unfitted(document);
        let evidence = &report.result["evidence"];
        assert_eq!(report.result["verdict"], "infeasible", "{evidence}");
        assert!(
            evidence["value"].as_f64().unwrap() < -1e-5 && evidence["ratio"].as_f64().unwrap() < -1e3,
            "{evidence}"
        );
        // A dip within the axis has a distance; where R/(R + BᵀPB) itself is negative there is none.
        let change = &report.result["relative_change"];
        assert!(change.as_f64().is_some_and(|v| v > 0.0) || evidence["kind"] == "input_weight", "{evidence}");
    }
}

#[test]
fn modes_that_decay_by_themselves_are_free() {
    for document in [
        case!("uncontrollable_stable_2x1"),
        case!("opt_1_104_stab_uncontrollable"),
        case!("opt_1_164_stab_uncontrollable"),
    ] {
        let report = unfitted(document);
        assert_eq!(report.result["verdict"], "feasible", "{}", report.result["evidence"]);
        assert!(!report.result["unreached"]["decaying"].as_array().unwrap().is_empty());
        assert!(codes(&report).contains(&"free_modes"), "{:?}", codes(&report));
        assert!(report.result["forward_error"].as_f64().unwrap() < 1e-6);
    }
}

#[test]
fn a_target_in_the_state_is_steered_to() {
    let report = run(&case!("tracking_uncontrollable_rothkopf"));
    let result = &report.result;
    assert_eq!(result["verdict"], "feasible", "{result}");
    // The person steers to the target itself: Q = q [1 −1; −1 1].
    let points = &result["unreached"]["set_points"];
    assert!((points[0][0].as_f64().unwrap() / points[1][0].as_f64().unwrap() - 1.0).abs() < 1e-9, "{points}");
    let q = |i: usize, j: usize| result["q"][i][j].as_f64().unwrap();
    assert!(q(0, 0) > 0.0 && (q(0, 1) + q(0, 0)).abs() < 1e-9 * q(0, 0) && (q(1, 1) - q(0, 0)).abs() < 1e-9 * q(0, 0));
    assert!(result["forward_error"].as_f64().unwrap() < 1e-9);
    assert!(codes(&report).contains(&"set_points"));
    // A target that is held at a cost is refused, unless the future is discounted.
    let mut costly = case!("tracking_uncontrollable_rothkopf");
    costly["inputs"]["k"] = json!([[-0.3, 0.38]]);
    costly["inputs"]["a"] = json!([[1, 0], [0.1, 0.9]]);
    let problem = parsed(&costly).unwrap_err();
    assert!(problem.detail.contains("the cost is infinite"), "{problem}");
    costly["spec"]["discount"] = json!(0.95);
    assert!(parsed(&costly).is_ok());
}

#[test]
fn units_over_six_decades_change_nothing() {
    let report = unfitted(case!("opt_1_202_scaled"));
    assert_eq!(report.result["verdict"], "feasible", "{}", report.result["evidence"]);
    assert!(report.result["forward_error"].as_f64().unwrap() < 1e-6);
}

#[test]
fn margins_of_infeasible_gains_mean_something() {
    let report = unfitted(case!("d_good_bad"));
    let result = &report.result;
    assert_eq!((&result["verdict"], &result["evidence"]["kind"]), (&json!("infeasible"), &json!("multiplier")));
    let coupled = unfitted(case!("d_skew"));
    assert_eq!(coupled.result["evidence"]["kind"], "coupling", "{}", coupled.result["evidence"]);
    let report = unfitted(case!("d_skew"));
    let result = &report.result;
    assert_eq!(result["verdict"], "infeasible");
    let change = result["relative_change"].as_f64().unwrap();
    assert!(change > 1e-8 && change < 1e-4, "{change}");
    assert!(result["t_star"].as_f64().is_none_or(|t| t.abs() < 1e6), "{}", result["t_star"]);
}

#[test]
fn several_inputs_are_answered_and_a_large_loop_stops_when_told() {
    let report = unfitted(case!("timing_n16_m4"));
    assert_eq!(report.result["verdict"], "feasible");
    assert!(report.result["alpha"].is_number() && report.result["solved_by"] == "interior_point");
    let plan = parsed(&case!("inverse_lqr_n64")).unwrap();
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    assert!(plan.run(&Library::default(), &ctl).is_err());
}

#[test]
fn digits_that_decide_are_pointed_out() {
    // K = [2a, k₂] is the boundary; 2a = 2.4691 for a = 1.23455, and half a unit of its fifth digit reaches it.
    let ask = |k: f64, spec: Value| {
        unfitted(json!({
            "kind": "inverse_lqr", "spec": spec,
            "inputs": {"a": [[0, 1], [1.234_55, 0]], "b": [[0], [1]], "k": [[k, 4.321]]}
        }))
    };
    let report = ask(2.4681, json!({}));
    assert_eq!(report.result["verdict"], "infeasible");
    assert!(!codes(&report).contains(&"gain_digits"), "{:?}", codes(&report));
    let report = ask(2.46907, json!({}));
    assert_eq!(report.result["verdict"], "infeasible");
    assert!(!codes(&report).contains(&"gain_digits"), "{:?}", codes(&report));
    let report = ask(2.469_096, json!({}));
    assert_eq!(report.result["verdict"], "infeasible");
    let report = ask(2.469_099_8, json!({}));
    assert_eq!(report.result["verdict"], "infeasible");
    assert!(!codes(&report).contains(&"gain_digits"), "{:?}", codes(&report));
    // 2.4692 is above by a whole unit, 2.469 below by two: written with four digits it is within its digits.
    let report = ask(2.469, json!({}));
    assert_eq!(report.result["verdict"], "infeasible");
    assert!(codes(&report).contains(&"gain_digits"), "{:?}", codes(&report));
    let report = ask(2.469, json!({"gain_rounding": 0.0005}));
    assert_eq!(report.result["verdict"], "boundary");
    assert_eq!(report.result["evidence"]["gain_rounding"], json!([[0.0005, 0.0005]]));
}

#[test]
fn solvers_agree_and_say_who_answered() {
    let ask = |solver: &str| {
        run(&json!({
            "kind": "inverse_lqr", "spec": {"solver": solver},
            "inputs": {"a": [[1, 2], [-3, 1]], "b": [[0, 1], [-1, 1]], "k": [[-0.0764, -1.51], [1.88, 0.791]]}
        }))
    };
    let (one, other) = (ask("clarabel"), ask("interior_point"));
    assert_eq!((&one.result["solved_by"], &other.result["solved_by"]), (&json!("clarabel"), &json!("interior_point")));
    let alpha = |report: &Report| report.result["alpha"].as_f64().unwrap();
    assert!((alpha(&one) / alpha(&other) - 1.0).abs() < 1e-8);
    assert_eq!(one.result["verdict"], other.result["verdict"]);
}
