//! Inverse optimal control over HTTP.

use crate::harness::TestServer;
use serde_json::json;

#[tokio::test]
async fn gains_go_in_and_the_cost_comes_out() {
    let server = TestServer::start().await;
    let request = json!({
        "kind": "inverse_lqg",
        "inputs": {
            "a": [[1, 2], [-3, 1]], "b": [[0, 1], [-1, 1]], "c": [[1, 0]],
            "k": [[-0.0764, -1.51], [1.88, 0.791]], "l": [[6.11], [4.33]]
        }
    });
    let queued = server.post("/v1/analyses", &request).await;
    let analysis = queued.json(202);
    assert_eq!(analysis["kind"], "inverse_lqg");
    assert!(analysis["request"]["spec"]["regulator"]["fit"].is_object(), "defaults are filled in");
    let path = queued.header("location").to_owned();
    server.work().await;
    let finished = server.get(&path).await.json(200);
    assert_eq!(finished["status"], "succeeded", "{finished}");
    assert_eq!(finished["progress"]["done"], finished["progress"]["total"]);
    let report = server.get(&format!("{path}/report")).await.json(200);
    assert_eq!(
        (&report["result"]["verdict"], &report["schema"]),
        (&json!("feasible"), &json!("volition.inverse_lqg/1"))
    );
    let alpha = report["result"]["regulator"]["alpha"].as_f64().unwrap();
    assert!((alpha - 18.387574037).abs() < 1e-6, "{alpha}");
    assert!(report["result"]["w"].is_array() && report["result"]["q"].is_array());
    let listed = server.get("/v1/analyses?kind=inverse_lqg").await.json(200);
    assert_eq!(listed["items"].as_array().unwrap().len(), 1);
    server.finish().await;
}

#[tokio::test]
async fn infeasible_is_a_result_and_nonsense_a_problem() {
    let server = TestServer::start().await;
    let request = json!({
        "kind": "inverse_lqr", "inputs": {"a": [[1]], "b": [[1]], "k": [[1.5]]}, "spec": {"fit": {"condition_numbers": [100]}}
    });
    let queued = server.post("/v1/analyses", &request).await;
    let path = queued.header("location").to_owned();
    server.work().await;
    let report = server.get(&format!("{path}/report")).await.json(200);
    assert_eq!(report["result"]["verdict"], "infeasible");
    assert!(report["result"]["fit"]["residual"].as_f64().unwrap() > 0.0);
    let unstable = json!({"kind": "inverse_lqr", "inputs": {"a": [[1]], "b": [[1]], "k": [[0.5]]}});
    let problem = server.post("/v1/analyses", &unstable).await.problem(422, "invalid");
    assert_eq!(problem["where"], "/inputs/k");
    assert!(problem["detail"].as_str().unwrap().contains("A − BK is not stable"), "{problem}");
    server.finish().await;
}
