//! ETags, cursors and idempotency keys, on every sort of thing.

use crate::api::harness::{TestServer, recording};
use serde_json::{Value, json};

#[tokio::test]
async fn unchanged_things_are_not_sent_again() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    for path in [
        format!("/v1/studies/{}", lab.study),
        format!("/v1/plants/{}", lab.plant),
        format!("/v1/subjects/{}", lab.subject),
        format!("/v1/trials/{trial}"),
        "/v1/studies".to_owned(),
        format!("/v1/studies/{}/plants", lab.study),
        format!("/v1/studies/{}/subjects", lab.study),
        format!("/v1/subjects/{}/trials", lab.subject),
        "/v1/analyses".to_owned(),
        format!("/v1/studies/{}/learning-curves", lab.study),
        format!("/v1/studies/{}/comparison", lab.study),
        format!("/v1/subjects/{}/learning-curves", lab.subject),
        format!("/v1/studies/{}/frequency-responses", lab.study),
        format!("/v1/studies/{}/median-subjects", lab.study),
        format!("/v1/studies/{}/progress", lab.study),
        "/openapi.json".to_owned(),
    ] {
        let first = server.get(&path).await;
        first.json(200);
        let tag = first.header("etag").to_owned();
        assert!(tag.starts_with('"') && tag.ends_with('"'), "{path}: {tag} is strong");
        let again = server.send(server.request("GET", &path).header("if-none-match", format!("\"x\", {tag}"))).await;
        assert_eq!((again.status.as_u16(), again.bytes.len()), (304, 0), "{path}");
        let other = server.send(server.request("GET", &path).header("if-none-match", "\"x\"")).await;
        assert_eq!(other.bytes, first.bytes, "{path}");
    }
    server.finish().await;
}

#[tokio::test]
async fn changes_can_insist_on_a_state() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    for (path, patch) in [
        (format!("/v1/trials/{trial}"), json!({"number": 9})),
        (format!("/v1/plants/{}", lab.plant), json!({"name": "renamed"})),
        (format!("/v1/subjects/{}", lab.subject), json!({"code": "renamed"})),
        (format!("/v1/studies/{}", lab.study), json!({"name": "renamed"})),
    ] {
        let old = server.get(&path).await.header("etag").to_owned();
        let patched = server.send(server.request("PATCH", &path).header("if-match", &old).json(&patch)).await;
        patched.json(200);
        let new = patched.header("etag").to_owned();
        assert_eq!(server.get(&path).await.header("etag"), new, "{path}: a patch answers with the new ETag");
        let stale = server.send(server.request("PATCH", &path).header("if-match", &old).json(&patch)).await;
        assert_eq!(stale.problem(412, "precondition_failed")["where"], "header If-Match");
        let stale = server.send(server.request("DELETE", &path).header("if-match", &old)).await;
        stale.problem(412, "precondition_failed");
        server.send(server.request("PATCH", &path).header("if-match", "*").json(&patch)).await.json(200);
    }
    for path in [
        format!("/v1/trials/{trial}"),
        format!("/v1/plants/{}", lab.plant),
        format!("/v1/subjects/{}", lab.subject),
        format!("/v1/studies/{}", lab.study),
    ] {
        let tag = server.get(&path).await.header("etag").to_owned();
        assert_eq!(server.send(server.request("DELETE", &path).header("if-match", &tag)).await.status, 204, "{path}");
        let gone = server.send(server.request("DELETE", &path).header("if-match", &tag)).await;
        gone.problem(404, "not_found");
    }
    server.finish().await;
}

#[tokio::test]
async fn a_repeated_creation_makes_nothing_twice() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let posts: Vec<(String, Value, Value)> = vec![
        ("/v1/studies".into(), json!({"name": "a"}), json!({"name": "b"})),
        (
            format!("/v1/studies/{}/plants", lab.study),
            json!({"name": "a", "model": {"num": [1], "den": [1, 1]}}),
            json!({"name": "a", "model": {"num": [1], "den": [1, 2]}}),
        ),
        (format!("/v1/studies/{}/subjects", lab.study), json!({"code": "a"}), json!({"code": "b"})),
        (
            format!("/v1/subjects/{}/trials?plant={}", lab.subject, lab.plant),
            json!({"sample_time_s": 0.1, "r": [1, 2], "u": [0, 0], "y": [1, 1]}),
            json!({"sample_time_s": 0.1, "r": [1, 2], "u": [0, 0], "y": [1, 2]}),
        ),
    ];
    for (path, body, other) in posts {
        let post = |body: &Value| server.request("POST", &path).header("idempotency-key", "once").json(body);
        let first = server.send(post(&body)).await;
        let id = first.id(201);
        assert!(!first.headers.contains_key("idempotent-replayed"), "{path}");
        let census = server.census().await;
        let again = server.send(post(&body)).await;
        assert_eq!(again.id(201), id, "{path}");
        assert_eq!(again.header("idempotent-replayed"), "true");
        assert_eq!(again.header("location"), first.header("location"));
        let reused = server.send(post(&other)).await.problem(422, "invalid");
        assert_eq!(reused["where"], "header Idempotency-Key");
        assert_eq!(server.census().await, census, "{path}");
    }
    for bad in ["", "with space", &"x".repeat(256)] {
        let request = server.request("POST", "/v1/studies").header("idempotency-key", bad).json(&json!({"name": "x"}));
        assert_eq!(server.send(request).await.problem(400, "malformed")["where"], "header Idempotency-Key", "{bad}");
    }
    server.finish().await;
}

#[tokio::test]
async fn lists_come_in_pages_that_later_rows_do_not_shift() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    for i in 1..=5 {
        server.upload_csv(&lab, &format!("&number={i}"), recording(8, f64::from(i))).await.json(201);
    }
    let path = format!("/v1/subjects/{}/trials", lab.subject);
    let numbers = |page: &Value| -> Vec<i64> {
        page["items"].as_array().unwrap().iter().map(|t| t["number"].as_i64().unwrap()).collect()
    };
    let first = server.get(&format!("{path}?limit=2")).await.json(200);
    assert_eq!(numbers(&first), [1, 2]);
    // Deleting a row of the first page and adding one at the end shifts nothing.
    let gone = first["items"][0]["id"].as_str().unwrap();
    assert_eq!(server.delete(&format!("/v1/trials/{gone}")).await.status, 204);
    server.upload_csv(&lab, "&number=6", recording(8, 6.0)).await.json(201);
    let cursor = first["next_cursor"].as_str().unwrap();
    let second = server.get(&format!("{path}?limit=3&cursor={cursor}")).await.json(200);
    assert_eq!(numbers(&second), [3, 4, 5]);
    let cursor = second["next_cursor"].as_str().unwrap();
    let third = server.get(&format!("{path}?limit=3&cursor={cursor}")).await.json(200);
    assert_eq!((numbers(&third), &third["next_cursor"]), (vec![6], &Value::Null));
    // A page that is just full is the last one.
    assert_eq!(server.get(&format!("{path}?limit=5")).await.json(200)["next_cursor"], Value::Null);
    // Another list's cursor is no cursor of this list.
    let strange = server.get(&format!("/v1/studies?cursor={cursor}")).await.problem(400, "malformed");
    assert_eq!(strange["where"], "query parameter cursor");
    server.finish().await;
}
