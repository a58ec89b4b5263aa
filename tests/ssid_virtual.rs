//! Subsystem identification on recorded people and on virtual subjects made by another simulator.
//!
//! Runs where the shared data lie beside the checkout, and says so where they do not.
#![allow(clippy::unwrap_used)]

use flate2::read::GzDecoder;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::PathBuf;
use volition::analysis::{Code, Failure, Library, Plan, Report, Request};
use volition::ctl::Ctl;
use volition::trial::{csv, write};

fn shared(folder: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")).join(folder);
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("skipped: {} is not there", path.display());
    None
}

/// A recorded trial as a request carries it.
fn inline(path: PathBuf) -> Value {
    let file = GzDecoder::new(File::open(path).unwrap());
    write::json_value(&csv::read(file, &csv::Options::default()).unwrap().trial)
}

fn identify(trial: Value, plant: &Value, spec: &Value) -> Result<Report, Failure> {
    let request =
        Request { kind: "ssid".to_owned(), inputs: json!({"trial": trial, "plant": plant}), spec: spec.clone() };
    Plan::parse(&request)?.run(&Library::default(), &Ctl::new())
}

fn number(report: &Report, pointer: &str) -> f64 {
    report.result.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer}: {}", report.result))
}

/// ‖Gff G − 1‖ falls from the first to the last trial of every subject, and ends lower on the minimum-phase plant, *in
/// this thinning* of appendix C (8/8/2/3: poles, zeros, damping, gains). A regression, no finding about the method: of
/// five thinnings tried, the distances fell for all subjects in three (8/8/2/3, 7/7/2/2, 5/5/2/2), and the order of the
/// groups came out in this one alone, since single minimum-phase trials are taken for high-gain feedback. In the
/// complete pool the distances fall for all six subjects and the order of the groups does not come out (.277 and .255):
/// `cargo bench --bench appendix_c`.
#[test]
fn virtual_subjects_approach_the_inverse_dynamics() {
    let Some(folder) = shared("virtual_subjects") else { return };
    let truth: Vec<Value> = serde_json::from_reader(File::open(folder.join("truth.json")).unwrap()).unwrap();
    let mut distances: BTreeMap<(String, String), BTreeMap<u64, f64>> = BTreeMap::new();
    for entry in &truth {
        let (group, trial) = (entry["group"].as_str().unwrap(), entry["trial"].as_u64().unwrap());
        // Orders of section 5.6.2: the feedforward can approximate the inverse of its plant.
        let order = match group {
            "gm" => 2,
            "gn" => 6,
            _ => continue,
        };
        if trial != 1 && trial != 40 {
            continue;
        }
        let plant = json!({"num": entry["plant_num"], "den": entry["plant_den"], "sample_time_s": null});
        let spec = json!({
            "pool": {"name": "zhang2015_appendix_c", "thin": {"poles": 8, "zeros": 8, "damping": 2, "gains": 3}},
            "feedforward_numerator_degree": order, "feedforward_denominator_degree": order
        });
        let report = identify(inline(folder.join(entry["file"].as_str().unwrap())), &plant, &spec).unwrap();
        assert!(number(&report, "/simulated_vaf/y").is_finite());
        let key = (group.to_owned(), entry["subject"].as_str().unwrap().to_owned());
        let distance = number(&report, "/metrics/norm_feedforward_plant_minus_one");
        distances.entry(key).or_default().insert(trial, distance);
    }
    assert_eq!(distances.len(), 6, "three subjects in each group");
    let mut last: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for ((group, subject), by_trial) in &distances {
        eprintln!("{group} {subject}: ‖Gff G − 1‖ {:.3} → {:.3}", by_trial[&1], by_trial[&40]);
        assert!(by_trial[&40] < by_trial[&1], "{group} {subject}: {by_trial:?}");
        last.entry(group.as_str()).or_default().push(by_trial[&40]);
    }
    let mean = |group: &str| last[group].iter().sum::<f64>() / last[group].len() as f64;
    assert!(mean("gm") < mean("gn"), "{last:?}");
}

/// Every trial with a command is identified; every other is refused because its command carries no power.
#[test]
fn recorded_people_are_identified_or_refused_with_the_reason() {
    let Some(folder) = shared("cphs2017") else { return };
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
        match identify(inline(folder.join(&row["file"])), &plant, &spec) {
            Ok(report) => {
                assert_ne!(row["reference"], "r-zer", "{}: no command, and yet a result", row["file"]);
                assert!(number(&report, "/cost") > 0.0);
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
