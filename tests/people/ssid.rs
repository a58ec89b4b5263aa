//! Subsystem identification of recorded people.

use crate::contract::contract;
use crate::recordings::{folder, read};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use volition::analysis::{Code, Failure, Library, Report, Request};
use volition::ctl::Ctl;
use volition::trial::write;

fn identify(trial: Value, plant: &Value, spec: &Value) -> Result<Report, Failure> {
    let request =
        Request { kind: "ssid".to_owned(), inputs: json!({"trial": trial, "plant": plant}), spec: spec.clone() };
    contract().run(&request, &Library::default(), &Ctl::new())
}

/// Every trial with a command is identified; every other is refused because its command carries no power.
#[test]
fn recorded_people_are_identified_or_refused_with_the_reason() {
    let folder = folder();
    let mut index = ::csv::Reader::from_path(folder.join("index.csv")).unwrap();
    let (mut identified, mut refused) = (0, 0);
    for row in index.deserialize::<BTreeMap<String, String>>() {
        let row = row.unwrap();
        // The three to six command lines of a trial with two stimuli bear no more than four or five coefficients: a
        // feedforward of the degree of the inverse dynamics, and the crossover model's feedback (a lag on 1/s, a lead
        // on 1/(s(s+1))).
        let (den, feedforward, roots, zeros, poles) = match row["plant"].as_str() {
            "1/s" => (json!([1.0, 0.0]), 1, "feedback_poles", 0, 1),
            "1/(s(s+1))" => (json!([1.0, 1.0, 0.0]), 2, "feedback_zeros", 1, 0),
            other => panic!("{other}"),
        };
        let plant = json!({"num": [1.0], "den": den, "sample_time_s": null});
        let mut pool = json!({"roots": {
            "feedback_poles": {},
            "peak_gains": [0.0, 0.3, 0.5, 0.7, 1.0, 1.5, 2.2, 3.2, 4.6, 6.8, 10.0, 15.0],
            "band_rad_s": [0.6, 10.0]
        }});
        pool["roots"][roots] = json!({"real_rad_s": {"from": -40.0, "to": -0.1, "count": 400}});
        let spec = json!({
            "pool": pool,
            "feedforward_numerator_degree": feedforward, "feedforward_denominator_degree": 0,
            "feedback_numerator_degree": zeros, "feedback_denominator_degree": poles,
            // Five seconds of ramp, then two periods of 20 s.
            "frequency": {"lines": "excited", "segments": [{"start_s": 5, "end_s": 25}, {"start_s": 25, "end_s": 45}]}
        });
        match identify(write::json_value(&read(&folder.join(&row["file"])).trial), &plant, &spec) {
            Ok(report) => {
                assert_ne!(row["reference"], "r-zer", "{}: no command, and yet a result", row["file"]);
                assert!(report.result["cost"].as_f64().unwrap() > 0.0);
                identified += 1;
            }
            Err(Failure::Problem(problem)) => {
                assert_eq!(row["reference"], "r-zer", "{}: {problem}", row["file"]);
                assert_eq!(problem.code, Code::NotIdentifiable, "{problem}");
                assert!(problem.detail.contains("command") && problem.mend.is_some(), "{problem}");
                refused += 1;
            }
            Err(other) => panic!("{}: {other}", row["file"]),
        }
    }
    eprintln!("{identified} trials identified, {refused} without a command refused");
    assert_eq!(identified + refused, 120);
}
