//! From a simulated person's trials to the costs that they minimise, over HTTP.

use crate::api::harness::TestServer;
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_distr::StandardNormal;
use serde_json::{Value, json};
use volition::num::rng;

const SAMPLES: usize = 240;

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

/// Disturbance, output and control of a person on 1/(s² + .3s − 4), sampled at 20 ms.
fn person(seed: u64) -> [Vec<f64>; 3] {
    let m = |rows: usize, columns: usize, entries: &[f64]| DMatrix::from_row_slice(rows, columns, entries);
    let a = m(2, 2, &[1.0007985088138476, 0.019945437607715825, 0.0797817504308633, 0.9948148775315327]);
    let b = m(2, 1, &[0.00019962720346188757, 0.019945437607715825]);
    let (k, l) = (m(1, 2, &[22.8285, 7.5943]), m(2, 1, &[0.29348, 1.72676]));
    let mut stream = rng::stream(seed, "lqg fit of stored trials");
    let mut normal = |sd: f64| sd * stream.sample::<f64, _>(StandardNormal);
    let (mut x, mut belief) = (DVector::zeros(2), DVector::zeros(2));
    let mut found = [Vec::new(), Vec::new(), Vec::new()];
    for sample in 0..SAMPLES {
        let d = if (sample / 15) % 2 == 0 { 0.5 } else { -0.5 };
        let (y, u) = (x[0] + normal(0.01), -(&k * &belief)[0]);
        // As a file writes them.
        for (signal, value) in found.iter_mut().zip([d, y, u + normal(0.02)]) {
            signal.push((value * 1e6).round() / 1e6);
        }
        let innovation = y - belief[0];
        x = &a * &x + &b * (u + d) + DVector::from_vec(vec![normal(1e-3), normal(0.02)]);
        belief = &a * &belief + &b * u + &l * innovation;
    }
    found
}

async fn result(server: &TestServer, trials: Vec<Value>) -> Value {
    let request = json!({
        "kind": "lqg_fit",
        "inputs": {"plant": {"a": [[0, 1], [4, -0.3]], "b": [[0], [1]], "c": [[1, 0]]}, "trials": trials},
        "spec": {
            "control_variance": [[0.0004]], "initial_state": "rest",
            "control_weight": [[0.001]], "perceived_measurement_noise": [[0.0001]],
            "process_noise": [{"name": "w", "diagonal": [0.0025, 1]}],
            "perceived_process_noise": [{"name": "wp", "diagonal": [0.0025, 1]}]
        }
    });
    let queued = server.post("/v1/analyses", &request).await;
    assert_eq!(queued.json(202)["status"], "queued");
    let path = queued.header("location").to_owned();
    server.work().await;
    let finished = server.get(&path).await.json(200);
    assert_eq!(finished["status"], "succeeded", "{finished}");
    server.get(&format!("{path}/report")).await.json(200)["result"].clone()
}

/// Stored trials and the same numbers in the request are one fit.
#[tokio::test]
async fn stored_trials_are_fitted_like_those_of_a_request() {
    let server = TestServer::start().await;
    let study = server.study().await;
    let plant = json!({"name": "unstable", "model": {"num": [1.0], "den": [1.0, 0.3, -4.0], "sample_time_s": null}});
    let plant = server.post(&format!("/v1/studies/{study}/plants"), &plant).await.id(201);
    let subject = server.subject(&study, "s01").await;
    let lab = crate::api::harness::Lab { study, plant, subject };
    let (mut stored, mut inline) = (Vec::new(), Vec::new());
    for number in 1..=2 {
        let [d, y, u] = person(number);
        let mut csv = "t,r,u,y,d\n".to_owned();
        for i in 0..SAMPLES {
            csv.push_str(&format!("{:.2},0,{},{},{}\n", i as f64 * 0.02, u[i], y[i], d[i]));
        }
        let query = format!("&number={number}&session=1");
        stored.push(json!(server.upload_csv(&lab, &query, csv).await.id(201)));
        inline.push(json!({"sample_time_s": 0.02, "disturbance": d, "output": y, "control": u}));
    }
    let (of_stored, of_inline) = (result(&server, stored).await, result(&server, inline).await);
    assert_eq!(of_stored["samples"], 2 * SAMPLES);
    let near = |x: &Value, y: &Value| {
        let [x, y] = [x, y].map(|v| v.as_f64().unwrap());
        (x - y).abs() < 1e-6 * (1.0 + y.abs())
    };
    assert!(near(&of_stored["log_likelihood"], &of_inline["log_likelihood"]), "{of_stored} {of_inline}");
    let q = &of_stored["parameters"][0];
    assert_eq!(q["name"], "q1");
    assert!(near(&q["log_standard_error"], &of_inline["parameters"][0]["log_standard_error"]), "{q}");
    // Q is diag(.4, .02).
    let [low, high] = [0, 1].map(|end| q["interval"][end].as_f64().unwrap());
    assert!(low < 0.4 && 0.4 < high, "{q}");
    server.finish().await;
}
