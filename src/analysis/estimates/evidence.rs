//! What a report says of the trust in everything that it identified from a trial.

use crate::analysis::Report;
use crate::learning::inputs::Estimator;
use crate::trust::{Agreement, Evidence};
use serde_json::Value;

/// Warnings that the stimuli do not tell the feedback, with what each says in short.
const NOT_TOLD: [(&str, &str); 4] = [
    (
        "command_does_not_determine_feedback",
        "half of the pool or more fits as well: the command does not tell the feedback",
    ),
    ("feedback_not_determined", "nothing tells the feedback"),
    ("near_inverse_of_the_plant", "the feedback found looks like −1/G, which fits whatever the person does"),
    ("feedback_poorly_determined", "the command alone hardly tells feedback from feedforward"),
];

/// Warnings that say what the form of the model leaves out.
const FORM: [&str; 4] = ["answer_moves", "feedback_cut_short", "feedforward_cut_short", "prediction_errors_not_white"];

/// What a report says of the trust in it, by one of its estimators, about the trial at a place among its trials.
#[must_use]
pub fn evidence(report: &Report, estimator: Estimator, position: usize) -> Evidence {
    let has = |wanted: &str| report.warnings.iter().any(|warning| warning.code == wanted);
    let result = &report.result;
    let agreement = if has("output_not_from_control") || has("channels_exchanged") {
        Agreement::Foreign
    } else if has("output_loosely_from_control") {
        Agreement::Loose
    } else {
        Agreement::Agrees
    };
    let not_told = NOT_TOLD.iter().find(|(code, _)| has(code)).map(|(_, words)| (*words).to_owned());
    let common = Evidence {
        agreement,
        feedback_not_told: not_told,
        form_moves_answer: FORM.into_iter().filter(|code| has(code)).map(str::to_owned).collect(),
        ..Evidence::default()
    };
    match estimator {
        Estimator::Ssid => pool(result, common, &has),
        Estimator::SsidRefined => refined(result, common, &has),
        Estimator::TwoStimulus => {
            Evidence { simulated_share: best_fit(result).and_then(|fit| number(fit, "/simulated_vaf/y")), ..common }
        }
        Estimator::PredictionError => prediction_error(result, position, common),
    }
}

fn number(value: &Value, pointer: &str) -> Option<f64> {
    value.pointer(pointer)?.as_f64()
}

fn best_fit(result: &Value) -> Option<&Value> {
    result.get("fits")?.get(usize::try_from(result.get("best")?.as_u64()?).ok()?)
}

/// The smallest p of several tests, adjusted by Holm: the smallest one times their number.
fn smallest_p(tests: impl IntoIterator<Item = Option<f64>>) -> Option<f64> {
    let known: Vec<f64> = tests.into_iter().flatten().collect();
    let least = known.iter().copied().reduce(f64::min)?;
    Some((least * known.len() as f64).min(1.0))
}

fn refined_tests(result: &Value) -> Option<f64> {
    let tests = result.pointer("/refined/residual_tests")?;
    smallest_p([number(tests, "/power_p_value"), number(tests, "/whiteness_p_value")])
}

/// The widest of the ranges of a norm: of candidates that fit nearly as well, and of those that the data cannot tell
/// from the best one.
fn spread(result: &Value, norm: &str) -> Option<[f64; 2]> {
    let near = result.pointer(&format!("/near_optimal/spread/{norm}")).and_then(Value::as_array);
    let near = near.and_then(|ends| Some([ends.first()?.as_f64()?, ends.get(1)?.as_f64()?]));
    let equal = |end: &str| number(result, &format!("/equivalent/{norm}/{end}/norm"));
    let equal = equal("least").zip(equal("largest")).map(|(low, high)| [low, high]);
    near.into_iter().chain(equal).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
}

fn with_spreads(result: &Value, evidence: Evidence) -> Evidence {
    Evidence {
        spread_feedback: spread(result, "norm_feedback"),
        spread_distance: spread(result, "norm_feedforward_plant_minus_one"),
        residual_p: refined_tests(result),
        ..evidence
    }
}

fn pool(result: &Value, common: Evidence, has: &dyn Fn(&str) -> bool) -> Evidence {
    let is_exact = result.pointer("/certificate/exact").and_then(Value::as_bool).unwrap_or(true);
    Evidence {
        simulation_fails: has("simulation_fails"),
        simulated_share: number(result, "/simulated_vaf/y"),
        not_converged: (!is_exact).then(|| "the candidate is not proven to be the pool's best".to_owned()),
        held_back: if has("edge_of_pool") { vec!["the edge of the pool".to_owned()] } else { Vec::new() },
        ..with_spreads(result, common)
    }
}

fn refined(result: &Value, common: Evidence, has: &dyn Fn(&str) -> bool) -> Evidence {
    let shares: Option<Vec<f64>> = result
        .pointer("/refined/simulated_vaf")
        .and_then(Value::as_array)
        .and_then(|trials| trials.iter().map(|trial| number(trial, "/y")).collect());
    let converged = result.pointer("/refined/converged").and_then(Value::as_bool).unwrap_or(true);
    let constraints = result.pointer("/refined/active_constraints").and_then(Value::as_array).map_or(0, Vec::len);
    let mut held_back = Vec::new();
    if has("stability_margin_active") {
        held_back.push("the stability margin".to_owned());
    }
    if constraints > 0 {
        held_back.push(format!("{constraints} active constraints"));
    }
    Evidence {
        simulated_share: shares.and_then(|shares| crate::num::stats::mean(&shares)),
        not_converged: (!converged).then(|| "the refinement is no local optimum".to_owned()),
        held_back,
        ..with_spreads(result, common)
    }
}

fn prediction_error(result: &Value, position: usize, common: Evidence) -> Evidence {
    let Some(trial) = result.get("trials").and_then(|trials| trials.get(position)) else { return common };
    let test = |pointer: &str| number(result, &format!("/residual_tests/{pointer}/p_value"));
    Evidence {
        simulation_fails: trial.get("stable").and_then(Value::as_bool) == Some(false),
        simulated_share: number(trial, "/accounted_for/simulated_y"),
        residual_p: smallest_p([
            test("whiteness/ljung_box"),
            test("whiteness/serial_correlation"),
            test("later_command"),
            test("later_error"),
        ]),
        ..common
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn report(kind: &str, codes: &[&str], result: Value) -> Report {
        let warnings: Vec<Value> = codes.iter().map(|code| json!({"code": code, "message": "m"})).collect();
        serde_json::from_value(json!({
            "kind": kind, "schema": "s", "result": result, "warnings": warnings,
            "provenance": {"product_version": "0", "spec": {}, "spec_sha256": "", "inputs_sha256": {}, "seed": null,
                "result_sha256": "", "wall_time_s": null, "cpu_time_s": null, "effort": null}
        }))
        .unwrap()
    }

    #[test]
    fn evidence_comes_from_the_fields_and_warnings_of_each_estimator() {
        let of_pool = report(
            "ssid",
            &["feedback_poorly_determined", "edge_of_pool", "output_loosely_from_control"],
            json!({
                "simulated_vaf": {"y": 0.7}, "certificate": {"exact": false},
                "near_optimal": {"spread": {"norm_feedback": [1.0, 2.5], "norm_feedforward_plant_minus_one": null}},
                "equivalent": {"norm_feedback": {"least": {"norm": 0.5}, "largest": {"norm": 2.0}},
                    "norm_feedforward_plant_minus_one": {"least": {"norm": 0.2}, "largest": null}},
                "refined": {"converged": false, "active_constraints": [{}, {}], "simulated_vaf": [{"y": 0.4}],
                    "residual_tests": {"power_p_value": 0.02, "whiteness_p_value": 0.5}}
            }),
        );
        let found = evidence(&of_pool, Estimator::Ssid, 0);
        assert_eq!(found.agreement, Agreement::Loose);
        assert_eq!((found.simulated_share, found.simulation_fails), (Some(0.7), false));
        assert_eq!((found.spread_feedback, found.spread_distance), (Some([0.5, 2.5]), None));
        assert_eq!(found.residual_p, Some(0.04));
        assert_eq!(found.held_back, ["the edge of the pool"]);
        assert!(found.not_converged.is_some() && found.feedback_not_told.is_some());
        let found = evidence(&of_pool, Estimator::SsidRefined, 0);
        assert_eq!((found.simulated_share, found.held_back.len()), (Some(0.4), 1));
        assert!(found.not_converged.unwrap().contains("optimum"));

        let p = |p: f64| json!({"p_value": p});
        let tests = json!({"whiteness": {"ljung_box": p(0.3), "serial_correlation": p(0.01)},
            "later_command": p(0.5), "later_error": p(0.9)});
        let trial =
            |share: Option<f64>, stable: bool| json!({"stable": stable, "accounted_for": {"simulated_y": share}});
        let of_several = report(
            "prediction_error",
            &["near_inverse_of_the_plant", "answer_moves"],
            json!({"residual_tests": tests, "trials": [trial(Some(0.9), true), trial(None, false)]}),
        );
        let first = evidence(&of_several, Estimator::PredictionError, 0);
        assert_eq!((first.simulated_share, first.simulation_fails, first.residual_p), (Some(0.9), false, Some(0.04)));
        assert_eq!(first.form_moves_answer, ["answer_moves"]);
        assert!(first.feedback_not_told.unwrap().contains("−1/G"));
        assert!(evidence(&of_several, Estimator::PredictionError, 1).simulation_fails);

        let fits = json!({"best": 1, "fits": [{}, {"simulated_vaf": {"y": 0.3}}]});
        let of_two = report("two_stimulus", &["channels_exchanged"], fits);
        let found = evidence(&of_two, Estimator::TwoStimulus, 0);
        assert_eq!((found.agreement, found.simulated_share), (Agreement::Foreign, Some(0.3)));
    }
}
