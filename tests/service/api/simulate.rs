//! Kind `simulate` over HTTP: a stored trial's command through its plant, or through another one, as a device plays it.

use crate::api::harness::{TestServer, recording};
use serde_json::{Value, json};

#[tokio::test]
async fn a_stored_command_is_simulated_on_stored_plants() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.upload_csv(&lab, "&number=1", recording(200, 0.0)).await.id(201);
    let plant = json!({"name": "slow", "model": {"num": [1], "den": [1, 0.5], "delay_s": 0.04}});
    let plant = server.post(&format!("/v1/studies/{}/plants", lab.study), &plant).await.id(201);
    let feedback = json!({"num": [1.5], "den": [0.1, 1], "delay_s": 0.15});
    let own = json!({"kind": "simulate", "inputs": {"command": {"trial": trial}, "feedback": feedback},
        "spec": {"every": 2, "response_s": 1}});
    let mut other = own.clone();
    other["inputs"]["plant"] = json!(plant);
    let mut results = Vec::new();
    for request in [own, other] {
        let queued = server.post("/v1/analyses", &request).await;
        let path = queued.header("location").to_owned();
        assert_eq!(queued.json(202)["request"]["inputs"]["command"]["channel"], "r");
        server.work().await;
        let finished = server.get(&path).await.json(200);
        assert_eq!(finished["status"], "succeeded", "{finished}");
        let report = server.get(&format!("{path}/report")).await.json(200);
        assert!(report["provenance"]["inputs_sha256"]["/inputs/plant"].is_string());
        assert!(report["result"]["recorded"]["accounted_for_y"].is_number());
        // What a device would play, and what comes out: every second sample, 0.04 s apart.
        let csv = server.get(&format!("{path}/samples")).await.text();
        let lines: Vec<&str> = csv.lines().collect();
        assert_eq!((lines[0], lines.len()), ("t,r,u,y", 101), "{csv:.80}");
        assert!(lines[2].starts_with("0.04,"), "{}", lines[2]);
        results.push(report["result"].clone());
    }
    assert_eq!(results[0]["signals"]["r"], results[1]["signals"]["r"]);
    assert_ne!(results[0]["signals"]["y"], results[1]["signals"]["y"], "another plant answers otherwise");

    // What would run away is a failure that names the pole.
    let request = json!({"kind": "simulate", "inputs": {"plant": plant, "command": {"trial": trial},
        "feedback": {"num": [50], "den": [0.1, 1], "delay_s": 0.15}}});
    let path = server.post("/v1/analyses", &request).await.header("location").to_owned();
    server.work().await;
    let failed: Value = server.get(&path).await.json(200);
    assert_eq!((&failed["status"], &failed["problem"]["where"]), (&json!("failed"), &json!("/inputs/feedback")));
    assert!(failed["problem"]["detail"].as_str().unwrap().contains("a pole at s = "), "{failed}");
    server.finish().await;
}
