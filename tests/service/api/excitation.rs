//! Excitation over HTTP.

use crate::api::harness::TestServer;
use serde_json::json;

#[tokio::test]
async fn a_sequence_is_judged_and_downloaded() {
    let server = TestServer::start().await;
    let request = json!({
        "kind": "excitation_quality",
        "inputs": {"signal": {"generator": {"kind": "prts", "order": 5, "chip_s": 0.2}, "sample_time_s": 0.02}},
        "spec": {"band_hz": [5, 10], "include_samples": true}
    });
    let queued = server.post("/v1/analyses", &request).await;
    let path = queued.header("location").to_owned();
    assert_eq!(queued.json(202)["request"]["spec"]["lines"], "auto", "defaults are filled in");
    server.get(&format!("{path}/samples")).await.problem(409, "conflict");
    server.work().await;
    let finished = server.get(&path).await.json(200);
    assert_eq!(finished["status"], "succeeded", "{finished}");
    assert_eq!(finished["progress"]["done"], finished["progress"]["total"]);
    let report = server.get(&format!("{path}/report")).await.json(200);
    assert_eq!(report["schema"], "volition.excitation_quality/2");
    let sfm = report["result"]["flatness"][0]["sfm"].as_f64().unwrap();
    assert!((sfm - 0.392_463_547_048_235_6).abs() < 1e-12, "{sfm}");
    let answer = server.get(&format!("{path}/samples")).await;
    assert_eq!(
        (answer.status.as_u16(), answer.header("content-type")),
        (200, "text/csv; charset=utf-8; header=present")
    );
    assert!(answer.text().starts_with("t,signal\r\n0.0,0.0\r\n") && answer.text().lines().count() == 2421);
    let again = server.request("GET", &format!("{path}/samples")).header("if-none-match", answer.header("etag"));
    assert_eq!(server.send(again).await.status.as_u16(), 304);
    server.finish().await;
}

#[tokio::test]
async fn a_stored_trial_and_a_stored_plant_are_judged() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    for channel in ["r", "u", "y"] {
        let request = json!({
            "kind": "excitation_quality",
            "inputs": {"signal": {"trial": trial, "channel": channel}, "plant": lab.plant}, "spec": {"band_hz": [10]}
        });
        let queued = server.post("/v1/analyses", &request).await;
        queued.json(202);
        let path = queued.header("location").to_owned();
        server.work().await;
        let report = server.get(&format!("{path}/report")).await.json(200);
        assert!(report["result"]["flatness"][0]["blsfg"].is_f64(), "{report}");
        assert_eq!(report["provenance"]["inputs_sha256"].as_object().unwrap().len(), 2);
        server.get(&format!("{path}/samples")).await.problem(404, "not_found");
    }
    // Of every trial of the study: the command, and the output that answers to it.
    let bulk =
        server.post(&format!("/v1/studies/{}/analyses", lab.study), &json!({"kind": "excitation_quality"})).await;
    assert_eq!((&bulk.json(202)["created"], &bulk.json(202)["analyses"][0]["trial"]), (&json!(1), &json!(trial)));
    server.work().await;
    let request = json!({
        "kind": "excitation_quality",
        "inputs": {"signal": {"trial": "0190b3e0-0000-7000-8000-000000000001", "channel": "y"}}
    });
    let problem = server.post("/v1/analyses", &request).await.problem(422, "invalid");
    assert_eq!(problem["where"], "/inputs/signal/trial");
    server.finish().await;
}

#[tokio::test]
async fn a_compensator_is_designed_and_nonsense_refused() {
    let server = TestServer::start().await;
    let signal = json!({"generator": {"kind": "prts", "order": 3, "chip_s": 0.2}, "sample_time_s": 0.005});
    let request = json!({
        "kind": "compensator_design", "inputs": {"plant": {"mass_kg": 10, "damping_ns_per_m": 50}, "signal": signal},
        "spec": {"structure": "proportional", "band_hz": 5}
    });
    let queued = server.post("/v1/analyses", &request).await;
    queued.json(202);
    let path = queued.header("location").to_owned();
    server.work().await;
    let report = server.get(&format!("{path}/report")).await.json(200);
    assert!(report["result"]["blsfg"].as_f64().unwrap() > 1.5, "{report}");
    for member in ["gain", "resonance_hz", "disturbance_norm"] {
        assert!(report["result"][member].is_f64(), "{member}");
    }
    let mut wrong = request.clone();
    wrong["inputs"]["signal"]["generator"]["order"] = json!(0);
    let problem = server.post("/v1/analyses", &wrong).await.problem(422, "invalid");
    assert_eq!(problem["where"], "/inputs/signal/generator/order");
    let mut wrong = request;
    wrong["spec"]["band_hz"] = json!(500);
    let problem = server.post("/v1/analyses", &wrong).await.problem(422, "invalid");
    assert_eq!(
        (&problem["where"], &problem["title"]),
        (&json!("/spec/band_hz"), &json!("band above the Nyquist frequency"))
    );
    server.finish().await;
}
