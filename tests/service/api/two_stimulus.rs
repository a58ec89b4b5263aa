use crate::api::harness::{Lab, TestServer};
use num_complex::Complex64;
use serde_json::{Value, json};
use std::f64::consts::TAU;
use volition::control::{Continuous, TransferFunction};
use volition::simulate::subject::{SimulatedSubject, SubjectParameters};
use volition::trial::Trial;

const DT: f64 = 0.02;

/// A sum of sinusoids with amplitude 1/f, at multiples of 0.05 Hz.
fn stimulus(lines: &[u32], samples: usize) -> Vec<f64> {
    let at = |t: f64| -> f64 {
        let term = |k: &u32| 0.8 / f64::from(*k) * (TAU * 0.05 * f64::from(*k) * t + f64::from(k * k)).cos();
        (t / 5.0).min(1.0) * lines.iter().map(term).sum::<f64>()
    };
    (0..samples).map(|i| at(i as f64 * DT)).collect()
}

fn subject() -> SimulatedSubject {
    let plant = TransferFunction::new(&[1.0], &[1.0, 0.0], Continuous).unwrap();
    let parameters = SubjectParameters {
        remnant: 0.02,
        learning_scatter: 0.0,
        learning_trials: 0.1,
        ..SubjectParameters::draw(3, false)
    };
    SimulatedSubject::with_parameters(&plant, DT, 3, parameters).unwrap()
}

/// 65 s of the trial, whose end the subject's preview would bend.
fn csv(trial: &Trial) -> String {
    let s = &trial.signals;
    let mut csv = "t,r,u,y,d\n".to_owned();
    for i in 0..3250 {
        let d = s.disturbance.as_ref().map_or(0.0, |d| d[i]);
        csv.push_str(&format!("{:.2},{},{},{},{d}\n", i as f64 * DT, s.command[i], s.control[i], s.output[i]));
    }
    csv
}

/// A study on 1/s with three trials: r and d on interleaved lines, exchanged in the second; the command alone in the
/// third.
async fn study(server: &TestServer) -> (Lab, Vec<String>) {
    let study = server.study().await;
    let plant = json!({"name": "1/s", "model": {"num": [1.0], "den": [1.0, 0.0], "sample_time_s": null}});
    let plant = server.post(&format!("/v1/studies/{study}/plants"), &plant).await.id(201);
    let who = server.subject(&study, "s01").await;
    let lab = Lab { study, plant, subject: who };
    let (even, odd) = (stimulus(&[2, 5, 11, 17, 23], 4000), stimulus(&[3, 7, 13, 19, 29], 4000));
    let subject = subject();
    let mut trials = Vec::new();
    for (number, r, d) in [(1, &even, Some(&odd)), (2, &odd, Some(&even)), (3, &even, None)] {
        let trial = subject.trial(number, r, d.map(Vec::as_slice)).unwrap();
        trials.push(server.upload_csv(&lab, &format!("&number={number}&session=1"), csv(&trial)).await.id(201));
    }
    (lab, trials)
}

fn spec() -> Value {
    json!({"frequency": {"segments": {"length_s": 20, "start_s": 5}, "detrend": "mean"}, "starts": 3})
}

#[tokio::test]
async fn two_trials_give_both_controllers_and_a_third_is_predicted() {
    let server = TestServer::start().await;
    let (_, trials) = study(&server).await;
    let mut spec = spec();
    spec["regularise"] = json!(true);
    let request = json!({
        "kind": "two_stimulus", "spec": spec,
        "inputs": {"trials": [trials[0], trials[1]], "validate_on": [trials[2]]}
    });
    let queued = server.post("/v1/analyses", &request).await;
    let path = queued.header("location").to_owned();
    assert_eq!(queued.json(202)["request"]["inputs"]["validate_on"], json!([trials[2]]));
    server.work().await;
    let finished = server.get(&path).await.json(200);
    assert_eq!(finished["status"], "succeeded", "{finished}");
    let report = server.get(&format!("{path}/report")).await.json(200);
    assert_eq!(report["schema"], "volition.two_stimulus/3");
    let lines = report["result"]["lines"].as_array().unwrap();
    assert_eq!(lines.len(), 10);
    let subject = subject();
    for line in lines {
        let number = |pointer: &str| {
            line.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer}: {line}"))
        };
        let found = Complex64::new(number("/feedback/value/0"), number("/feedback/value/1"));
        let truth = subject.feedback_response(number("/omega_rad_s"));
        assert!((found / truth - 1.0).norm() < 0.5, "{line} {truth}");
        assert!(number("/feedback/magnitude_95/0") < number("/feedback/magnitude_95/1"));
        assert_eq!(line["feedback"]["interpolated"], false);
        assert!(line["feedforward"]["value"].is_array());
    }
    let fits = report["result"]["fits"].as_array().unwrap();
    assert_eq!(fits.len(), 4, "the rungs of the ladder");
    let best = &fits[report["result"]["best"].as_u64().unwrap() as usize];
    for share in ["/simulated_vaf/u", "/simulated_vaf/y", "/held_out_vaf/u", "/held_out_vaf/y"] {
        let share = best.pointer(share).and_then(Value::as_f64).unwrap_or_else(|| panic!("{share}: {best}"));
        assert!(share > 0.5 && share <= 1.0, "{best}");
    }
    assert_eq!(best["held_out_vaf"]["trials"][0]["trial"], "/inputs/validate_on/0");
    assert!(report["provenance"]["inputs_sha256"]["/inputs/validate_on/0"].is_string());
    // Each group of this study has lines with one trial only, so what a group's response could account for is not
    // known.
    let ceiling = &report["result"]["ceiling"];
    let at_lines = ceiling["at_lines"]["y"].as_f64().unwrap();
    assert!(at_lines > 0.9 && at_lines <= 1.0 && ceiling["by_group"]["y"].is_null(), "{ceiling}");
    let shrunk = &report["result"]["regularised"];
    assert_eq!((&shrunk["reason"], &shrunk["structure"]), (&json!(null), &report["result"]["best"]), "{shrunk}");
    assert_eq!(shrunk["groups"], json!(["both", "both"]));
    assert_eq!(shrunk["held_out_vaf"]["trials"][0]["trial"], "/inputs/validate_on/0");
    for share in ["/left_out_vaf/u", "/left_out_vaf/y", "/held_out_vaf/u", "/held_out_vaf/y"] {
        let share = shrunk.pointer(share).and_then(Value::as_f64).unwrap_or_else(|| panic!("{share}: {shrunk}"));
        assert!(share > 0.5 && share <= 1.0, "{shrunk}");
    }
    // Both controllers of all trials, and of the one group that there is; the command is over the third trial alone.
    let controllers = shrunk["controllers"].as_array().unwrap();
    let of: Vec<&Value> = controllers.iter().map(|c| &c["group"]).collect();
    assert_eq!(of, [&json!(null), &json!("both")]);
    for line in controllers[1]["lines"].as_array().unwrap() {
        let number = |pointer: &str| line.pointer(pointer).and_then(Value::as_f64).unwrap();
        let truth = subject.feedback_response(TAU * number("/frequency_hz"));
        let found = Complex64::new(number("/feedback/value/0"), number("/feedback/value/1"));
        assert!((found / truth - 1.0).norm() < 0.5, "{line} {truth}");
        assert!(number("/feedforward/magnitude_95/0") < number("/feedforward/magnitude_95/1"));
    }
    let prediction = &shrunk["predictions"][0];
    assert_eq!((&prediction["trial"], &prediction["group"]), (&json!("/inputs/validate_on/0"), &json!("command")));
    assert_eq!(prediction["lines"].as_array().unwrap().len(), 5, "the lines of its command");
    // No trial of this group was learned from, so the noise of its lines is not known.
    assert_eq!((&prediction["compared"], &prediction["lines"][0]["radius_95"]), (&json!(0), &json!(null)));
    server.finish().await;
}

#[tokio::test]
async fn a_study_wide_request_answers_for_each_trial_or_says_why_not() {
    let server = TestServer::start().await;
    let (lab, trials) = study(&server).await;
    let request = json!({"kind": "two_stimulus", "spec": spec()});
    let made = server.post(&format!("/v1/studies/{}/analyses", lab.study), &request).await.json(202);
    assert_eq!(made["created"], 3);
    server.work().await;
    for (i, analysis) in made["analyses"].as_array().unwrap().iter().enumerate() {
        assert_eq!(analysis["trial"], json!(trials[i]));
        let path = format!("/v1/analyses/{}", analysis["id"].as_str().unwrap());
        let finished = server.get(&path).await.json(200);
        if i == 2 {
            assert_eq!(finished["status"], "failed");
            assert_eq!(finished["problem"]["code"], "not_identifiable", "{finished}");
            continue;
        }
        assert_eq!(finished["status"], "succeeded", "{finished}");
        let report = server.get(&format!("{path}/report")).await.json(200);
        let codes: Vec<&str> =
            report["warnings"].as_array().unwrap().iter().map(|w| w["code"].as_str().unwrap()).collect();
        assert!(codes.contains(&"feedback_interpolated"), "{codes:?}");
    }
    server.finish().await;
}

#[tokio::test]
async fn trials_to_validate_on_are_trials_of_the_study_too() {
    let server = TestServer::start().await;
    let (_, trials) = study(&server).await;
    let unknown = "0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10";
    let request =
        |held: &str| json!({"kind": "two_stimulus", "inputs": {"trials": [trials[0]], "validate_on": [held]}});
    let problem = server.post("/v1/analyses", &request(unknown)).await.problem(422, "invalid");
    assert!(problem["where"].as_str().unwrap().contains("validate_on"), "{problem}");
    let problem = server.post("/v1/analyses", &request(&trials[0])).await.problem(422, "invalid");
    assert_eq!(problem["where"], "/inputs/validate_on/0");
    server.finish().await;
}
