use crate::api::harness::TestServer;
use num_complex::Complex64;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;
use volition::simulate::reference_signals::chirp60;
use volition::simulate::subject::SimulatedSubject;
use volition::worker::{Analyses, Worker, WorkerSettings};

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

/// Example 2.2 of Zhang 2015 over a pool of hundreds of millions, candidate by candidate.
fn long_search() -> Value {
    let omega: Vec<f64> = (1..=20).map(|k| 0.2 * std::f64::consts::PI * f64::from(k)).collect();
    let h: Vec<[f64; 2]> = omega
        .iter()
        .map(|w| {
            let s = Complex64::new(0.0, *w);
            let (g, ff, fb) = (4.0 / (s + 2.0), (2.13 * s + 3.0) / (s + 6.57), 5.44 / (s + 7.11));
            let closed = g * (ff + fb) / (1.0 + g * fb);
            [closed.re, closed.im]
        })
        .collect();
    let axis = json!([{"from": 0.01, "to": 10, "step": 0.005}]);
    json!({"kind": "ssid",
           "inputs": {"plant": {"num": [4], "den": [1, 2]}, "frequency_response": {"omega_rad_s": omega, "h": h}},
           "spec": {"pool": {"grid": {"feedforward_denominator": axis, "feedback_numerator": axis,
                             "feedback_denominator": axis}},
                    "search": "exhaustive", "max_candidates": 100_000_000_000_u64}})
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_search_shows_its_gap_and_leaves_what_it_found_when_it_is_cancelled() {
    let server = TestServer::start().await;
    let path = format!("/v1/analyses/{}", server.post("/v1/analyses", &long_search()).await.id(202));
    let settings = WorkerSettings { compute_threads: 1, poll_s: 0.02, heartbeat_s: 0.05, ..WorkerSettings::default() };
    let worker = Worker::new(server.store.clone(), Arc::new(Analyses::default()), settings).unwrap();
    let stop = CancellationToken::new();
    let client = async {
        let until = async |wanted: &dyn Fn(&Value) -> bool| {
            for _ in 0..6000 {
                let now = server.get(&path).await.json(200);
                if wanted(&now) {
                    return now;
                }
                assert_ne!(now["status"], "failed", "{now}");
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
            panic!("nothing came");
        };
        assert!(server.get(&path).await.json(200)["progress"].get("bracket").is_none());
        let running = until(&|now| now["progress"]["bracket"].is_object()).await;
        let first = running["progress"]["bracket"].clone();
        assert!(first["cost"].as_f64().unwrap() > 0.0 && first["index"].is_u64(), "{first}");
        assert_eq!((&first["lower_bound"], &first["gap"]), (&json!(0.0), &json!(1.0)));
        assert!(first.get("controllers").is_none());
        let asked = Instant::now();
        assert_eq!(server.send(server.request("POST", &format!("{path}/cancel"))).await.status, 202);
        let cancelled = until(&|now| now["status"] == "cancelled").await;
        let took = asked.elapsed();
        let last = cancelled["progress"]["bracket"].clone();
        assert!(last["cost"].as_f64().unwrap() <= first["cost"].as_f64().unwrap(), "{first} {last}");
        // The controllers are those of the cost: their closed loop gives it again.
        let response = |model: &Value, s: Complex64| {
            let at =
                |c: &Value| c.as_array().unwrap().iter().fold(Complex64::ZERO, |sum, c| sum * s + c.as_f64().unwrap());
            at(&model["num"]) / at(&model["den"])
        };
        let inputs = &cancelled["request"]["inputs"]["frequency_response"];
        let lines = inputs["omega_rad_s"].as_array().unwrap().iter().zip(inputs["h"].as_array().unwrap());
        let cost: f64 = lines
            .map(|(omega, h)| {
                let s = Complex64::new(0.0, omega.as_f64().unwrap());
                let ff = response(&last["controllers"]["feedforward"], s);
                let fb = response(&last["controllers"]["feedback"], s);
                let g = 4.0 / (s + 2.0);
                let h = Complex64::new(h[0].as_f64().unwrap(), h[1].as_f64().unwrap());
                (g * (ff + fb) / (1.0 + g * fb) - h).norm_sqr()
            })
            .sum();
        assert!((cost - last["cost"].as_f64().unwrap()).abs() < 1e-9 * cost, "{cost} {last}");
        stop.cancel();
        took
    };
    let (_, took) = tokio::join!(worker.run(stop.clone()), client);
    assert!(took < Duration::from_secs(10), "{took:?}");
    server.finish().await;
}

/// The hypotheses of no feedback and no feedforward, on a recorded trial.
#[tokio::test]
async fn a_controller_is_held_at_zero() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.upload_csv(&lab, "&number=20&sample_time_s=0.05", simulated(20)).await.id(201);
    let spec = |more: Value| {
        let mut spec = json!({"pool": {"name": "zhang2015_appendix_c",
                                       "thin": {"poles": 16, "zeros": 16, "damping": 4, "gains": 10}}});
        spec.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        json!({"kind": "ssid", "inputs": {"trial": trial}, "spec": spec})
    };
    let both = report(&server, &spec(json!({"restrictions": ["feedforward", "feedback"]}))).await;
    for (at, (held, other)) in [("feedforward", "feedback"), ("feedback", "feedforward")].iter().enumerate() {
        let body = report(&server, &spec(json!({"held_at_zero": held}))).await;
        let result = &body["result"];
        assert_eq!(body["provenance"]["spec"]["held_at_zero"], *held);
        assert_eq!((&result[*held]["num"], &result[*held]["den"]), (&json!([0.0]), &json!([1.0])));
        assert_ne!(result[*other]["num"], json!([0.0]));
        let vaf = result["variance_accounted_for"].as_f64().unwrap();
        assert!(vaf > 0.0, "what is simulated is that controller alone: {vaf}");
        let row = &both["result"]["restrictions"][at];
        assert_eq!((&row["held_at_zero"], &row["cost"]), (&json!(held), &result["cost"]));
        assert!(row["cost"].as_f64() >= both["result"]["cost"].as_f64(), "{row}");
        assert!(row["f"]["statistic"].as_f64().unwrap() >= 0.0 || row["f_reason"].is_string(), "{row}");
        let codes: Vec<&Value> = body["warnings"].as_array().unwrap().iter().map(|w| &w["code"]).collect();
        assert!(codes.contains(&&json!("controller_held_at_zero")), "{codes:?}");
    }
    for (more, place) in [
        (json!({"held_at_zero": "feedback", "feedback_numerator_degree": 1}), "/spec/feedback_numerator_degree"),
        (json!({"held_at_zero": "feedback", "restrictions": ["feedback"]}), "/spec/restrictions"),
        (json!({"held_at_zero": "feedforward", "delay": {"feedforward_s": 0.1}}), "/spec/delay/feedforward_s"),
    ] {
        let problem = server.post("/v1/analyses", &spec(more)).await.problem(422, "invalid");
        assert_eq!(problem["where"], place);
    }
    server.finish().await;
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
    let spec = json!({"pool": {"name": "zhang2015_appendix_c",
                               "thin": {"poles": 16, "zeros": 16, "damping": 4, "gains": 10}},
                      "delay": {"feedback_s": [0.0, 0.1, 0.2]}});
    let request = |held_out: &[String]| -> Value {
        json!({"kind": "ssid", "inputs": {"trial": trials[0], "validate_on": held_out}, "spec": spec})
    };
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
    // Of equal costs or worse: the family begins with the best candidate.
    let near = &result["near_optimal"];
    assert_eq!(near["family"][0]["index"], result["certificate"]["index"]);
    assert_eq!(near["family"][0]["norm_feedback"], result["metrics"]["norm_feedback"]);
    assert!(near["spread"]["lines"].as_array().unwrap().len() > 10, "{near}");
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

#[tokio::test]
async fn structures_and_delays_are_judged_by_trials_left_out() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let mut trials = Vec::new();
    for number in [20, 21, 22, 23] {
        let query = format!("&number={number}&sample_time_s=0.05");
        trials.push(server.upload_csv(&lab, &query, simulated(number)).await.id(201));
    }
    let spec = json!({"pool": {"name": "zhang2015_appendix_c",
                               "thin": {"poles": 16, "zeros": 16, "damping": 4, "gains": 10}},
                      "structures": [{"feedforward_denominator_degree": 2}, {"feedforward_denominator_degree": 4}],
                      "delay": {"feedback_s": [0.0, 0.1, 0.2], "search": true}});
    let request = json!({"kind": "ssid", "inputs": {"trials": trials[..3], "validate_on": trials[3..]}, "spec": spec});
    let body = report(&server, &request).await;
    let result = &body["result"];
    assert_eq!(body["schema"], "volition.ssid/7");
    // How many QR had to decide depends on which thread found what first: it once made the hash of a result differ
    // between two runs.
    assert!(result["certificate"]["decided_by_qr"].is_null(), "{}", result["certificate"]);
    assert!(body["provenance"]["effort"]["candidates_decided_by_qr"].as_u64().unwrap() > 0);
    let compared = &result["structures"];
    assert_eq!((&compared["repeats"], &compared["folds"]), (&json!("trials"), &json!(3)), "{compared}");
    for row in compared["rows"].as_array().unwrap() {
        let left_out = row["criteria"]["cross_validation_over_repeats"].as_f64().unwrap();
        // What was not fitted is missed by more than what was.
        assert!(left_out > row["criteria"]["cost"].as_f64().unwrap(), "{row}");
    }
    let delayed = &result["delayed"];
    let points = delayed["points"].as_array().unwrap();
    assert_eq!(points.len(), 3);
    // Without a delay it is the search itself.
    assert_eq!((&points[0]["cost"], &points[0]["index"]), (&result["cost"], &result["certificate"]["index"]));
    let best = &points[delayed["best"].as_u64().unwrap() as usize];
    assert_eq!((&best["exact"], &delayed["exact"]), (&json!(true), &json!(true)), "{delayed}");
    let cost = |point: &Value| point["cost"].as_f64().unwrap();
    assert!(points.iter().all(|point| cost(best) <= cost(point)));
    assert!(result["refined"]["cost"].as_f64().unwrap() <= cost(best));
    for part in ["pool", "refined"] {
        assert!(result["held_out"][part]["trials"][0]["y"].is_f64(), "{result}");
    }

    // A pool cannot be searched at every delay of a range.
    let mut range = request;
    range["spec"]["delay"]["feedback_s"] = json!({"from": 0.0, "to": 0.2});
    let problem = server.post("/v1/analyses", &range).await.problem(422, "invalid");
    assert_eq!(problem["where"], "/spec/delay/feedback_s");
    server.finish().await;
}
