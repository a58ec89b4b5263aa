//! From a simulated person's trials to the costs that they minimise, over HTTP.

use crate::api::harness::TestServer;
use serde_json::{Value, json};

#[tokio::test]
async fn costs_come_out_and_what_is_not_built_is_refused() {
    let server = TestServer::start().await;
    let mut request: Value = serde_json::from_str(include_str!("../../../src/analysis/lqg_fit/example.json")).unwrap();
    let queued = server.post("/v1/analyses", &request).await;
    assert_eq!(queued.json(202)["status"], "queued");
    let path = queued.header("location").to_owned();
    server.work().await;
    let finished = server.get(&path).await.json(200);
    assert_eq!(finished["status"], "succeeded", "{finished}");
    let report = server.get(&format!("{path}/report")).await.json(200);
    assert_eq!(report["schema"], "volition.lqg_fit/1");
    let names: Vec<&str> =
        report["result"]["parameters"].as_array().unwrap().iter().map(|p| p["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["position", "velocity", "wp", "w", "v1"]);
    for parameter in report["result"]["parameters"].as_array().unwrap() {
        // A number, or the reason why there is none.
        assert!(parameter["value"].is_number() != parameter["refused"].is_string(), "{parameter}");
    }
    assert!(!report["result"]["explanations"].as_array().unwrap().is_empty());

    request["spec"]["delay"] = json!({"seconds": 0.1});
    let problem = server.post("/v1/analyses", &request).await.problem(422, "invalid");
    assert_eq!(problem["where"], "/spec/delay", "{problem}");
    server.finish().await;
}
