use crate::api::harness::TestServer;
use futures::StreamExt;
use serde_json::{Value, json};
use std::time::Duration;
use volition::ctl::Progress;

/// Reads events until the stream ends or `enough` says so.
async fn events(
    response: reqwest::Response,
    mut enough: impl AsyncFnMut(&str, &Value) -> bool,
) -> Vec<(String, Value)> {
    let mut found = Vec::new();
    let mut text = String::new();
    let mut stream = response.bytes_stream();
    while let Some(chunk) = tokio::time::timeout(Duration::from_secs(20), stream.next()).await.unwrap() {
        text.push_str(std::str::from_utf8(&chunk.unwrap()).unwrap());
        while let Some((event, rest)) = text.split_once("\n\n") {
            let field = |name: &str| event.lines().find_map(|line| line.strip_prefix(name)).map(str::trim);
            if let (Some(name), Some(data)) = (field("event:"), field("data:")) {
                let data: Value = serde_json::from_str(data).unwrap();
                if name != "problem" {
                    assert_eq!(field("id:"), Some(data["version"].to_string().as_str()));
                }
                let done = enough(name, &data).await;
                found.push((name.to_owned(), data));
                if done {
                    return found;
                }
            }
            text = rest.to_owned();
        }
    }
    found
}

#[tokio::test]
async fn an_analysis_is_followed_to_its_end() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    let body = json!({"kind": "frequency_response", "inputs": {"trial": trial}});
    let path = format!("/v1/analyses/{}/events", server.post("/v1/analyses", &body).await.id(202));
    let response = server.request("GET", &path).send().await.unwrap();
    assert_eq!(response.headers()["content-type"], "text/event-stream");
    let mut claim = None;
    let found = events(response, async |name, data| {
        // Each event is the signal for the next change.
        match (name, data["status"].as_str().unwrap(), data["progress"]["done"].as_u64().unwrap()) {
            ("status", "queued", _) => claim = server.store.claim("test", 60.0).await.unwrap(),
            ("status", "running", 0) => {
                let lease = &claim.as_ref().unwrap().lease;
                server.store.heartbeat(lease, Progress::of_units(5, 10), 60.0).await.unwrap();
            }
            ("progress", "running", 5) => {
                assert!(server.store.release(&claim.as_ref().unwrap().lease).await.unwrap());
                server.work().await;
            }
            _ => {}
        }
        false
    })
    .await;
    let last = found.last().unwrap();
    assert_eq!((last.0.as_str(), &last.1["status"]), ("status", &json!("succeeded")), "{found:?}");
    assert!(found.iter().any(|(name, data)| name == "progress" && data["progress"]["total"] == 10));

    // Of a finished one there is one event, and the stream ends.
    let response = server.request("GET", &path).send().await.unwrap();
    let found = events(response, async |_, _| false).await;
    assert_eq!((found.len(), &found[0].1["status"]), (1, &json!("succeeded")));
    server.finish().await;
}

#[tokio::test]
async fn a_deleted_analysis_ends_its_stream() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    let body = json!({"kind": "frequency_response", "inputs": {"trial": trial}});
    let path = format!("/v1/analyses/{}", server.post("/v1/analyses", &body).await.id(202));
    let response = server.request("GET", &format!("{path}/events")).send().await.unwrap();
    let found = events(response, async |name, _| {
        if name == "status" {
            assert_eq!(server.delete(&path).await.status, 204);
        }
        false
    })
    .await;
    assert_eq!((found.len(), found[1].0.as_str(), &found[1].1["code"]), (2, "problem", &json!("not_found")));
    server.finish().await;
}

#[tokio::test]
async fn a_draining_server_ends_its_streams() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    let body = json!({"kind": "frequency_response", "inputs": {"trial": trial}});
    let id = server.post("/v1/analyses", &body).await.id(202);
    let response = server.request("GET", &format!("/v1/analyses/{id}/events")).send().await.unwrap();
    let follower = tokio::spawn(events(response, async |_, _| false));
    server.store.request_cancel(id.parse().unwrap()).await.unwrap();
    server.finish().await;
    assert!(!follower.await.unwrap().is_empty());
}
