//! Inverse optimal control over HTTP.

use crate::api::harness::TestServer;
use serde_json::{Value, json};

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
        (&json!("feasible"), &json!("volition.inverse_lqg/2"))
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
        "kind": "inverse_lqr", "inputs": {"a": [[1]], "b": [[1]], "k": [[1.5]]},
        "spec": {"fit": {"condition_numbers": [100]}}
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
    assert!(
        problem["detail"].as_str().unwrap().contains("A − BK (1x1) is not stable: it has the eigenvalue 0.5"),
        "{problem}"
    );
    server.finish().await;
}

#[tokio::test]
async fn malformed_matrices_are_named_with_their_sizes_and_the_reason() {
    let server = TestServer::start().await;
    let (a, b, k) = (json!([[0, 1], [2, 0]]), json!([[0], [1]]), json!([[5, 3]]));
    let ask = |a: &Value, b: &Value, k: &Value| json!({"a": a, "b": b, "k": k});
    let fixed = |r: Value| json!({"port_weight": {"fixed": r}});
    for (inputs, spec, place, words) in [
        (ask(&json!([[0, 1, 2], [2, 0, 1]]), &b, &k), json!({}), "/inputs/a", "A is 2x3 and must be square"),
        (ask(&a, &b, &json!([[1, 3]])), json!({}), "/inputs/k", "A − BK (2x2) is not stable: it has the eigenvalue"),
        (
            ask(&json!([[1, 0], [0, -1]]), &b, &k),
            json!({}),
            "/inputs/k",
            "no input reaches the mode 1+0i, which does not decay",
        ),
        (
            ask(&a, &b, &k),
            fixed(json!([[-2]])),
            "/spec/port_weight/fixed",
            "the fixed R (1x1) is not positive definite: its least eigenvalue is -2",
        ),
        (
            ask(&a, &b, &k),
            fixed(json!([[1, 0], [0, 1]])),
            "/spec/port_weight/fixed",
            "the fixed R is 2x2 and must be 1x1",
        ),
        (ask(&a, &b, &json!([[5], [3]])), json!({}), "/inputs/k", "K is 2x1 and must be 1x2 (2 states, 1 inputs)"),
        (
            ask(&json!([[0, 1e300], [2, 0]]), &b, &k),
            json!({}),
            "/inputs/a",
            "A (2x2) has the entry 1e300 at row 0, column 1",
        ),
        (ask(&a, &json!([[0], [1e300]]), &k), json!({}), "/inputs/b", "B (2x1) has the entry 1e300 at row 1, column 0"),
        (ask(&a, &b, &json!([[5, -1e300]])), json!({}), "/inputs/k", "K (1x2) has the entry -1e300 at row 0, column 1"),
        (ask(&a, &b, &json!([[0, 0]])), json!({}), "/inputs/k", "A − BK (2x2) is not stable"),
    ] {
        let request = json!({"kind": "inverse_lqr", "inputs": inputs, "spec": spec});
        let problem = server.post("/v1/analyses", &request).await.problem(422, "invalid");
        assert_eq!(problem["where"], place, "{problem}");
        assert!(problem["detail"].as_str().unwrap().contains(words), "{words}: {problem}");
    }
    // A filter has its own letters, and its sizes as they are written.
    let c = json!([[1, 0]]);
    for (inputs, place, words) in [
        (json!({"a": a, "c": c, "l": [[1], [1]]}), "/inputs/l", "A − LC (2x2) is not stable"),
        (json!({"a": [[1, 0], [0, -1]], "c": [[0, 1]], "l": [[4], [5]]}), "/inputs/l", "no output sees the mode 1+0i"),
        (json!({"a": a, "c": c, "l": [[4], [1e300]]}), "/inputs/l", "L (2x1) has the entry 1e300 at row 1, column 0"),
    ] {
        let request = json!({"kind": "inverse_lqe", "inputs": inputs});
        let problem = server.post("/v1/analyses", &request).await.problem(422, "invalid");
        assert_eq!(problem["where"], place, "{problem}");
        assert!(problem["detail"].as_str().unwrap().contains(words), "{words}: {problem}");
    }
    server.finish().await;
}
