//! Answers that wait for an analysis, runs that make only what is missing, and lists that say whose trials were used.

use crate::api::harness::TestServer;
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use volition::api::Limits;

fn inverse() -> Value {
    json!({"kind": "inverse_lqr", "inputs": {"a": [[0.0, 1.0], [2.0, 0.0]], "b": [[0.0], [1.0]], "k": [[5.0, 4.0]]}})
}

#[tokio::test]
async fn a_short_analysis_is_answered_at_once() {
    let server = TestServer::start().await;
    let ask = server.request("POST", "/v1/analyses").header("prefer", "respond-async, wait=30").json(&inverse());
    let working = async {
        // Not before it was asked for.
        while server.census().await[4] == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        server.work().await;
    };
    let (answer, ()) = tokio::join!(server.send(ask), working);
    let done = answer.json(200);
    assert_eq!((&done["status"], answer.header("preference-applied")), (&json!("succeeded"), "wait=30"));
    assert_eq!(answer.header("location"), done["links"]["self"].as_str().unwrap());
    server.get(done["links"]["report"].as_str().unwrap()).await.json(200);
    server.finish().await;
}

#[tokio::test]
async fn nobody_waits_longer_than_the_bound() {
    let limits = Limits { max_wait: Duration::from_secs(1), ..Limits::default() };
    let server = TestServer::start_with(limits).await;
    let begin = Instant::now();
    let asked =
        server.send(server.request("POST", "/v1/analyses").header("prefer", "wait=3600").json(&inverse())).await;
    let queued = asked.json(202);
    let waited = begin.elapsed().as_secs_f64();
    assert!((1.0..10.0).contains(&waited), "{waited}");
    assert_eq!((&queued["status"], asked.header("preference-applied")), (&json!("queued"), "wait=1"));
    let path = queued["links"]["self"].as_str().unwrap();
    // A change of state ends the wait of whoever reads.
    let tag = server.get(path).await.header("etag").to_owned();
    let read = server.request("GET", path).header("prefer", "wait=1").header("if-none-match", &tag);
    let cancel = format!("{path}/cancel");
    let (read, _) = tokio::join!(server.send(read), server.send(server.request("POST", &cancel)));
    assert_eq!(read.json(200)["status"], "cancelled");
    let plain = server.get(path).await;
    assert!(!plain.headers.contains_key("preference-applied"));
    server.send(server.request("GET", path).header("prefer", "wait=soon")).await.json(200);
    server.finish().await;
}

#[tokio::test]
async fn a_run_makes_what_is_missing() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let (first, second) = (server.trial(&lab, 1).await, server.trial(&lab, 2).await);
    let run = format!("/v1/studies/{}/analyses", lab.study);
    let body = json!({"kind": "frequency_response"});
    let counts = |answer: &Value| (answer["created"].clone(), answer["existing"].as_array().unwrap().len());
    let made = server.post(&run, &body).await.json(202);
    assert_eq!(counts(&made), (json!(2), 0));
    let again = server.post(&run, &body).await.json(202);
    assert_eq!(counts(&again), (json!(0), 2));
    assert_eq!(again["existing"][0], json!({"id": made["analyses"][0]["id"], "trial": first, "status": "queued"}));
    server.work().await;
    // A new trial, a cancelled analysis, another spec.
    let third = server.trial(&lab, 3).await;
    let keyed = |body: &Value| server.request("POST", &run).header("idempotency-key", "k7").json(body);
    let more = server.send(keyed(&body)).await;
    assert_eq!(counts(&more.json(202)), (json!(1), 2));
    assert_eq!(more.json(202)["analyses"][0]["trial"], json!(third));
    assert!(!more.headers.contains_key("idempotent-replayed"));
    let retried = server.send(keyed(&body)).await;
    assert_eq!((retried.header("idempotent-replayed"), retried.json(202)), ("true", more.json(202)));
    let cancelled = more.json(202)["analyses"][0]["id"].as_str().unwrap().to_owned();
    server.send(server.request("POST", &format!("/v1/analyses/{cancelled}/cancel"))).await.json(200);
    assert_eq!(counts(&server.post(&run, &body).await.json(202)), (json!(1), 2));
    let other = json!({"kind": "frequency_response", "spec": {"window": "hann"}});
    assert_eq!(counts(&server.post(&run, &other).await.json(202)), (json!(3), 0), "another spec is another question");
    let all = json!({"kind": "frequency_response", "only": "all", "filter": {"number_to": 2}});
    assert_eq!(counts(&server.post(&run, &all).await.json(202)), (json!(2), 0));
    server.post(&run, &json!({"kind": "frequency_response", "only": "some"})).await.problem(422, "invalid");
    let _ = second;
    server.work().await;
    server.finish().await;
}

#[tokio::test]
async fn lists_of_analyses_say_whose_trials_they_use() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trials = [server.trial(&lab, 1).await, server.trial(&lab, 2).await];
    let request = |inputs: Value| json!({"kind": "frequency_response", "inputs": inputs, "spec": {}});
    let one = server.post("/v1/analyses", &request(json!({"trial": trials[0]}))).await.json(202);
    let subject = json!({"id": lab.subject, "code": "s01"});
    assert_eq!(one["trial"], json!({"id": trials[0], "number": 1, "session": 1}));
    assert_eq!((&one["subject"], &one["trials"]), (&subject, &json!(1)));
    server.post("/v1/analyses", &request(json!({"trials": trials}))).await.json(202);
    server.post("/v1/analyses", &inverse()).await.json(202);
    let newest = server.get("/v1/analyses?sort=-created").await.json(200);
    let told: Vec<(Value, Value, Value)> = newest["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(|own| (own["subject"].clone(), own["trial"]["number"].clone(), own["trials"].clone()))
        .collect();
    assert_eq!(
        told,
        [(Value::Null, Value::Null, json!(0)), (subject.clone(), Value::Null, json!(2)), (subject, json!(1), json!(1))]
    );
    // A renamed subject is renamed here too.
    server.patch(&format!("/v1/subjects/{}", lab.subject), &json!({"code": "s77"})).await.json(200);
    let path = one["links"]["self"].as_str().unwrap();
    assert_eq!(server.get(path).await.json(200)["subject"]["code"], "s77");
    server.work().await;
    server.finish().await;
}
