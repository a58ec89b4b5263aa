//! From uploaded trials to the cost that a person minimises, by the ids of what is stored.

use crate::api::harness::{Lab, TestServer};
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_distr::StandardNormal;
use serde_json::{Value, json};
use volition::control::parametric::Realisation;
use volition::control::{Continuous, Discrete, StateSpace};
use volition::num::rng;

/// The plant ẍ = 2x + u + d, and the gain of the person who balances it.
const K: [f64; 2] = [6.0, 4.0];

/// A lab with the plant, whose subjects are added by [`person`].
async fn lab(server: &TestServer) -> Lab {
    let study = server.study().await;
    let plant = json!({"name": "unstable", "model": {
        "a": [[0.0, 1.0], [2.0, 0.0]], "b": [[0.0], [1.0]], "c": [[1.0, 0.0]], "d": [[0.0]], "sample_time_s": null}});
    let plant = server.post(&format!("/v1/studies/{study}/plants"), &plant).await.id(201);
    Lab { study, plant, subject: String::new() }
}

/// 12 s of that person at 50 Hz, pushed by ±1, with 5 mm of noise.
fn recording(seed: u64) -> String {
    let closed = StateSpace::new(
        DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 2.0 - K[0], -K[1]]),
        DMatrix::from_row_slice(2, 1, &[0.0, 1.0]),
        DMatrix::from_row_slice(2, 2, &[1.0, 0.0, -K[0], -K[1]]),
        DMatrix::zeros(2, 1),
        Continuous,
    )
    .unwrap();
    let model = Realisation { model: closed, initial: DVector::zeros(2) };
    let model = model.sampled(Discrete::new(0.02).unwrap()).unwrap();
    let mut stream = rng::stream(seed, "intent");
    let mut value = 1.0;
    let push = DMatrix::from_fn(600, 1, |i, _| {
        if i % 25 == 0 {
            value = if stream.random::<bool>() { 1.0 } else { -1.0 };
        }
        value
    });
    let response = model.respond(&push).unwrap();
    let mut csv = "t,r,u,y,d\n".to_owned();
    for i in 0..600 {
        let y = response[(i, 0)] + 0.005 * stream.sample::<f64, _>(StandardNormal);
        csv.push_str(&format!("{:.2},0,{},{y},{}\n", i as f64 * 0.02, response[(i, 1)], push[(i, 0)]));
    }
    csv
}

/// A subject with a trial in each of two sessions.
async fn person(server: &TestServer, lab: &mut Lab, code: &str, seed: u64) -> (String, Vec<String>) {
    lab.subject = server.subject(&lab.study, code).await;
    let mut trials = Vec::new();
    for number in [1, 2] {
        let query = format!("&number={number}&session={number}");
        trials.push(server.upload_csv(lab, &query, recording(seed + number)).await.id(201));
    }
    (lab.subject.clone(), trials)
}

async fn succeeded(server: &TestServer, path: &str) -> Value {
    server.work().await;
    let finished = server.get(path).await.json(200);
    assert_eq!(finished["status"], "succeeded", "{finished}");
    server.get(&format!("{path}/report")).await.json(200)
}

async fn queued(server: &TestServer, request: &Value) -> String {
    server.post("/v1/analyses", request).await.id(202)
}

fn quick() -> Value {
    json!({"optimality": null, "climbs": 2, "draws": 10})
}

#[tokio::test]
async fn two_requests_lead_from_a_subject_to_the_cost() {
    let server = TestServer::start().await;
    let mut lab = lab(&server).await;
    let (subject, trials) = person(&server, &mut lab, "s01", 31).await;
    let excluded = server.upload_csv(&lab, "&number=3&session=2", recording(40)).await.id(201);
    let reason = json!({"excluded": {"reason": "The subject fell asleep."}});
    server.patch(&format!("/v1/trials/{excluded}"), &reason).await.json(200);

    let fit = queued(&server, &json!({"kind": "gain_fit", "inputs": {"subject": subject}, "spec": quick()})).await;
    let path = format!("/v1/analyses/{fit}");
    let fitted = succeeded(&server, &path).await;
    let asked = server.get(&path).await.json(200);
    assert_eq!(asked["request"]["inputs"], json!({"trials": trials}), "the excluded trial is left out");

    let request = json!({"kind": "inverse_lqr", "inputs": {"analysis": fit}, "spec": {"state_weight": "diagonal"}});
    let intent = queued(&server, &request).await;
    let path = format!("/v1/analyses/{intent}");
    let found = succeeded(&server, &path).await;
    assert_eq!(found["result"]["verdict"], "feasible");
    let asked = server.get(&path).await.json(200);
    // It carries everything that it was computed from, and is listed with the person's other analyses.
    let inputs = &asked["request"]["inputs"];
    assert_eq!(inputs["k"], fitted["result"]["k"]);
    assert_eq!(inputs["found_by"]["analysis"], json!(fit));
    assert_eq!(inputs["found_by"]["result_sha256"], fitted["provenance"]["result_sha256"]);
    assert_eq!(asked["request"]["spec"]["fit"]["gain_covariance"], fitted["result"]["k_covariance"]);
    assert_eq!((&asked["subject"]["code"], &asked["trials"]), (&json!("s01"), &json!(2)));
    let listed = server.get(&format!("/v1/analyses?trial={}", trials[1])).await.json(200);
    let ids: Vec<&Value> = listed["items"].as_array().unwrap().iter().map(|item| &item["id"]).collect();
    assert_eq!(ids, [&json!(fit), &json!(intent)]);

    // The same question by hand has the same answer.
    let by_hand = json!({"kind": "inverse_lqr", "inputs": fitted["result"]["inverse_lqr_inputs"],
        "spec": {"state_weight": "diagonal", "fit": {"gain_covariance": fitted["result"]["k_covariance"]}}});
    let by_hand = queued(&server, &by_hand).await;
    let by_hand = succeeded(&server, &format!("/v1/analyses/{by_hand}")).await;
    assert_eq!(by_hand["result"], found["result"]);

    // Beside another person's cost.
    let request = json!({"kind": "inverse_lqr", "inputs": {"analysis": fit, "compare_with": {"analysis": intent}}});
    let compared = queued(&server, &request).await;
    let compared = succeeded(&server, &format!("/v1/analyses/{compared}")).await;
    assert!(compared["result"]["reading"]["comparison"].is_object(), "{compared}");

    // Erasing the person erases the cost that was made of their trials.
    server.delete(&format!("/v1/subjects/{subject}")).await;
    server.get(&path).await.problem(404, "not_found");
    server.finish().await;
}

#[tokio::test]
async fn a_study_gets_one_intent_for_each_subject_and_session() {
    let server = TestServer::start().await;
    let mut lab = lab(&server).await;
    for (code, seed) in [("s01", 50), ("s02", 60)] {
        person(&server, &mut lab, code, seed).await;
    }
    let study = format!("/v1/studies/{}/analyses", lab.study);
    let fits = json!({"kind": "gain_fit", "each": "session", "spec": quick()});
    let made = server.post(&study, &fits).await.json(202);
    assert_eq!(made["created"], 4, "{made}");
    let both = json!({"kind": "gain_fit", "each": "subject", "spec": quick()});
    let made = server.post(&study, &both).await.json(202);
    assert_eq!(made["created"], 2, "{made}");
    assert!(made["analyses"].as_array().unwrap().iter().all(|one| one["trials"] == 2 && one["subject"].is_string()));
    let intents = json!({"kind": "inverse_lqr", "each": "analysis", "of": {"kind": "gain_fit"}});
    let none = server.post(&study, &intents).await.json(202);
    assert_eq!(none["created"], 0, "nothing has succeeded yet: {none}");
    server.work().await;
    let made = server.post(&study, &intents).await.json(202);
    assert_eq!((&made["created"], &made["skipped"]), (&json!(6), &json!([])), "{made}");
    server.work().await;
    for one in made["analyses"].as_array().unwrap() {
        let report = server.get(&format!("/v1/analyses/{}/report", one["id"].as_str().unwrap())).await.json(200);
        assert_eq!(report["result"]["verdict"], "feasible");
    }
    // Asked again, nothing is done twice.
    let again = server.post(&study, &intents).await.json(202);
    assert_eq!((&again["created"], again["existing"].as_array().unwrap().len()), (&json!(0), 6), "{again}");
    server.finish().await;
}

#[tokio::test]
async fn what_stands_for_nothing_is_refused_with_the_way_on() {
    let server = TestServer::start().await;
    let mut lab = lab(&server).await;
    let (subject, trials) = person(&server, &mut lab, "s01", 70).await;
    let nobody = server.subject(&lab.study, "s02").await;
    let by_hand = json!({"a": [[0, 1], [2, 0]], "b": [[0], [1]], "k": [[6, 4]]});
    let other = queued(&server, &json!({"kind": "inverse_lqr", "inputs": by_hand})).await;
    let fit = queued(&server, &json!({"kind": "gain_fit", "inputs": {"subject": subject}, "spec": quick()})).await;
    let waiting = json!({"kind": "inverse_lqr", "inputs": {"analysis": fit}});
    let problem = server.post("/v1/analyses", &waiting).await.problem(409, "conflict");
    assert!(problem["detail"].as_str().unwrap().contains("queued"), "{problem}");
    server.work().await;
    let absent = "00000000-0000-7000-8000-000000000000";
    for (kind, inputs, place, words) in [
        ("inverse_lqr", json!({"analysis": absent}), "/inputs/analysis", "there is no analysis"),
        ("inverse_lqr", json!({"analysis": "x"}), "/inputs/analysis", "UUID"),
        ("inverse_lqr", json!({"analysis": other}), "/inputs/analysis", "of kind inverse_lqr"),
        ("inverse_lqe", json!({"analysis": fit}), "/inputs/analysis", "did not estimate the filter"),
        ("inverse_lqr", json!({"analysis": fit, "explanation": 1}), "/inputs/explanation", "0 twins"),
        ("inverse_lqr", json!({"analysis": fit, "k": [[1.0]]}), "/inputs/k", "unknown field"),
        (
            "inverse_lqr",
            json!({"analysis": fit, "compare_with": {"analysis": fit}}),
            "/inputs/compare_with",
            "no weights",
        ),
        ("simulate", json!({"analysis": fit}), "/inputs/analysis", "takes no earlier analysis"),
        ("simulate", json!({"subject": subject}), "/inputs/subject", "takes no trials"),
        ("ssid", json!({"subject": absent}), "/inputs/subject", "there is no subject"),
        ("gain_fit", json!({"subject": nobody}), "/inputs/subject", "has no trial"),
        ("gain_fit", json!({"subject": subject, "session": 9}), "/inputs/subject", "in session 9"),
        ("gain_fit", json!({"subject": subject, "trial": trials[0]}), "/inputs/trial", "unknown field"),
    ] {
        let request = json!({"kind": kind, "inputs": inputs});
        let problem = server.post("/v1/analyses", &request).await.problem(422, "invalid");
        assert_eq!(problem["where"], place, "{problem}");
        let said = problem["detail"].as_str().unwrap();
        assert!(said.contains(words), "{problem}");
    }
    let study = format!("/v1/studies/{}/analyses", lab.study);
    for (request, place) in [
        (json!({"kind": "inverse_lqr", "each": "analysis"}), "/of"),
        (json!({"kind": "ssid", "of": {"kind": "gain_fit"}}), "/of"),
        (json!({"kind": "ssid", "each": "person"}), "/each"),
    ] {
        let problem = server.post(&study, &request).await.problem(422, "invalid");
        assert_eq!(problem["where"], place, "{problem}");
    }
    server.finish().await;
}
