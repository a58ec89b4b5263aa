use crate::harness::TestServer;
use serde_json::{Value, json};
use volition::plants::commands::chirp60;
use volition::plants::subject::SimulatedSubject;

fn simulated(number: u32) -> String {
    let plant = volition::plants::catalogue::minimum_phase();
    let subject = SimulatedSubject::new(&plant, 0.05, 5).unwrap();
    let trial = subject.trial(number, &chirp60(0.05), None).unwrap();
    let mut csv = Vec::new();
    volition::trial::write::csv(&trial, &mut csv).unwrap();
    String::from_utf8(csv).unwrap()
}

async fn report(server: &TestServer, request: &Value) -> Value {
    let queued = server.post("/v1/analyses", request).await.json(202);
    server.work().await;
    let path = format!("/v1/analyses/{}", queued["id"].as_str().unwrap());
    let finished = server.get(&path).await.json(200);
    assert_eq!(finished["status"], "succeeded", "{finished}");
    server.get(&format!("{path}/report")).await.json(200)
}

#[tokio::test]
async fn an_identification_is_refined_and_simulated_on_a_trial_held_out() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let mut trials = Vec::new();
    for number in [20, 21] {
        let query = format!("&number={number}&sample_time_s=0.05");
        trials.push(server.upload_csv(&lab, &query, simulated(number)).await.id(201));
    }
    let spec = json!({"pool": {"name": "zhang2015_appendix_c", "thin": {"poles": 16, "zeros": 16, "damping": 4, "gains": 10}},
                      "delay": {"feedback_s": [0.0, 0.1, 0.2]}});
    let request = |held_out: &[String]| json!({"kind": "ssid", "inputs": {"trial": trials[0], "validate_on": held_out}, "spec": spec});
    let body = report(&server, &request(&trials[1..])).await;
    let (result, refined) = (&body["result"], &body["result"]["refined"]);
    assert!(refined["cost"].as_f64().unwrap() <= result["cost"].as_f64().unwrap(), "{refined}");
    assert_eq!(refined["pool_cost"], result["cost"]);
    assert_eq!(refined["delay_scan"].as_array().unwrap().len(), 3);
    // One segment of 60 s, its end sample included: the variance is not known, and no band is made up.
    assert!(refined["uncertainty"].is_null() && refined["uncertainty_reason"].is_string(), "{refined}");
    for part in ["pool", "refined"] {
        let held = &result["held_out"][part]["trials"];
        assert_eq!(held[0]["trial"], "/inputs/validate_on/0");
        assert!(held[0]["y"].is_f64(), "{held}");
    }
    assert_eq!(body["provenance"]["inputs_sha256"].as_object().unwrap().len(), 3);
    // A trial that is fitted is none that is held out, and one that is not there is not found.
    let queued = server.post("/v1/analyses", &request(&trials[..1])).await;
    if queued.status.as_u16() == 202 {
        let path = format!("/v1/analyses/{}", queued.json(202)["id"].as_str().unwrap());
        server.work().await;
        let failed = server.get(&path).await.json(200);
        assert_eq!(
            (&failed["status"], &failed["problem"]["where"]),
            (&json!("failed"), &json!("/inputs/validate_on/0"))
        );
    } else {
        queued.problem(422, "invalid");
    }
    server.finish().await;
}
