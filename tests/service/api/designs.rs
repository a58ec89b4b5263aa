//! Designed experiments over HTTP.

use crate::api::harness::TestServer;
use serde_json::{Value, json};

fn prbs(samples: usize) -> Vec<f64> {
    (0..samples).map(|k| if (k / 5) * (k / 5 + 3) % 7 < 3 { 6.0 } else { -6.0 }).collect()
}

fn request() -> Value {
    json!({
        "kind": "input_design",
        "inputs": {"model": {"name": "seated_balance", "initial": [0.01, 0, 0, 0]}, "starts": [prbs(100)]},
        "spec": {"samples": 100, "sample_time_s": 0.1, "criterion": "t", "scale_to_fit": true, "max_steps": 5,
                 "limits": {"input": 20, "outputs": {"lower_angle": 0.192, "upper_angle": 0.078, "torque": 60},
                            "differences": [{"of": ["upper_angle", "lower_angle"], "limit": 0.252}],
                            "autocorrelation": {}}}
    })
}

#[tokio::test]
async fn a_model_goes_in_and_an_input_comes_out() {
    let server = TestServer::start().await;
    let queued = server.post("/v1/analyses", &request()).await;
    assert_eq!(queued.json(202)["request"]["spec"]["limits"]["autocorrelation"]["lags"], 49, "defaults are filled in");
    let path = queued.header("location").to_owned();
    server.work().await;
    let finished = server.get(&path).await.json(200);
    assert_eq!(finished["status"], "succeeded", "{finished}");
    assert_eq!(finished["progress"]["done"], finished["progress"]["total"]);
    let report = server.get(&format!("{path}/report")).await.json(200);
    assert_eq!(report["schema"], "volition.input_design/2");
    let result = &report["result"];
    assert!(result["factor"].as_f64().unwrap() > 1.2 && result["input"].as_array().unwrap().len() == 100);
    for limit in result["limits"].as_array().unwrap() {
        assert!(limit["slack"].as_f64().unwrap() >= 0.0, "{limit}");
    }
    let codes: Vec<&str> = report["warnings"].as_array().unwrap().iter().map(|w| w["code"].as_str().unwrap()).collect();
    assert!(codes.contains(&"trace_dominated") && codes.contains(&"noise_assumed"), "{codes:?}");
    // As a device would play it.
    let csv = server.get(&format!("{path}/samples")).await.text();
    let mut lines = csv.lines();
    assert_eq!(lines.next(), Some("t,signal,start"));
    let first: Vec<f64> = lines.next().unwrap().split(',').map(|number| number.parse().unwrap()).collect();
    assert_eq!(first, [0.0, result["input"][0].as_f64().unwrap(), result["start_input"][0].as_f64().unwrap()]);
    assert_eq!(lines.count(), 99);
    let mut contradictory = request();
    contradictory["spec"]["limits"]["outputs"]["torque"] = json!([60, -60]);
    let problem = server.post("/v1/analyses", &contradictory).await.problem(422, "invalid");
    assert_eq!(problem["where"], "/spec/limits/outputs/torque");
    server.finish().await;
}

#[tokio::test]
async fn an_experiment_for_the_worst_subject() {
    let server = TestServer::start().await;
    let request = json!({
        "kind": "robust_input_design", "inputs": {"axis": "axial_rotation"},
        "spec": {"experiment": {"duration_s": 6, "sample_time_s": 0.06}, "draws": 2, "fresh_draws": 8,
                 "max_iterations": 3, "rounds": 1}
    });
    let queued = server.post("/v1/analyses", &request).await;
    let path = queued.header("location").to_owned();
    server.work().await;
    let finished = server.get(&path).await.json(200);
    assert_eq!(finished["status"], "succeeded", "{finished}");
    let report = server.get(&format!("{path}/report")).await.json(200);
    let worst = |design: &str| report["result"][design]["worst_cost"].as_f64().unwrap();
    assert!(worst("robust") <= worst("nominal"));
    assert!(!report["result"]["assumptions"].as_array().unwrap().is_empty());
    let nonsense = json!({"kind": "robust_input_design", "inputs": {"axis": "axial_rotation"},
        "spec": {"experiment": {"edge_hz": [1, 40]}}});
    let problem = server.post("/v1/analyses", &nonsense).await.problem(422, "invalid");
    assert_eq!(problem["where"], "/spec/experiment/edge_hz");
    server.finish().await;
}
