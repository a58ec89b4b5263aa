use super::*;
use crate::analysis::{Library, Plan, Request};
use crate::ctl::Ctl;

fn judged(example: &str) -> (Report, Vec<QuantityTrust>) {
    let request: Request = serde_json::from_str(example).unwrap();
    let plan = Plan::parse(&request).unwrap();
    let report = plan.run(&Library::default(), &Ctl::new()).unwrap();
    let plant = request.inputs.get("plant").and_then(|plant| serde_json::from_value(plant.clone()).ok());
    let all = quantities(&report, plant.as_ref());
    (report, all)
}

fn of<'a>(all: &'a [QuantityTrust], name: &str) -> &'a QuantityTrust {
    all.iter().find(|own| own.trust.quantity == name).unwrap_or_else(|| panic!("no {name} in {all:#?}"))
}

/// What is read by pointers stands where the kinds write it: the examples of the kinds have every quantity.
#[test]
fn the_quantities_of_every_kind_are_found_in_real_reports() {
    let (report, all) = judged(crate::analysis::prediction_error::Plan::EXAMPLE);
    let norm = of(&all, "norm_feedforward_plant_minus_one");
    let written = &report.result["trials"][0]["metrics"]["norm_feedforward_plant_minus_one"];
    assert_eq!(norm.value, written["value"].as_f64());
    assert_eq!(norm.interval_95.map(|ends| ends[1]), written["interval_95"][1].as_f64());
    assert_eq!(norm.estimator, Some(Estimator::PredictionError));
    assert!(of(&all, "variance_accounted_for").value.is_some());

    let (report, all) = judged(crate::analysis::ssid::Plan::EXAMPLE);
    let norm = all.iter().find(|own| own.estimator == Some(Estimator::Ssid)).unwrap();
    assert_eq!(norm.value, report.result["metrics"]["norm_feedforward_plant_minus_one"].as_f64());
    assert!(norm.trust.codes().any(|code| code == "no_interval"), "{norm:?}");

    let (report, all) = judged(gain_fit::Plan::EXAMPLE);
    assert_eq!(all.len(), report.result["parameters"].as_array().unwrap().len());
    assert!(!all.is_empty() && all.iter().all(|own| own.value.is_some() && own.interval_95.is_some()), "{all:#?}");

    let (report, all) = judged(lqg_fit::Plan::EXAMPLE);
    assert_eq!(all.len(), report.result["parameters"].as_array().unwrap().len());

    for (example, names) in [
        (inverse_lqr::Plan::EXAMPLE, vec!["q", "r"]),
        (inverse_lqe::Plan::EXAMPLE, vec!["w", "v"]),
        (inverse_lqg::Plan::EXAMPLE, vec!["q", "r", "w", "v"]),
    ] {
        let (_, all) = judged(example);
        assert_eq!(all.iter().map(|own| own.trust.quantity.as_str()).collect::<Vec<_>>(), names);
        assert!(all.iter().all(|own| own.trust.code != "not_identified"), "{all:#?}");
    }
}
