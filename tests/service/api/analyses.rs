use crate::api::harness::{TestServer, recording};
use serde_json::{Value, json};
use volition::ctl::Progress;
use volition::jobs::Status;

fn request(trial: &str) -> Value {
    json!({"kind": "frequency_response", "inputs": {"trial": trial}})
}

#[tokio::test]
async fn an_analysis_is_queued_computed_and_reported() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    let queued = server.post("/v1/analyses", &request(&trial)).await;
    let analysis = queued.json(202);
    let path = queued.header("location").to_owned();
    assert_eq!(path, format!("/v1/analyses/{}", analysis["id"].as_str().unwrap()));
    assert_eq!((&analysis["kind"], &analysis["status"]), (&json!("frequency_response"), &json!("queued")));
    assert_eq!((&analysis["attempts"], &analysis["study"]), (&json!(0), &json!(lab.study)));
    assert_eq!(analysis["progress"], json!({"fraction": 0.0, "phase": null, "done": 0, "total": 0, "eta_s": null}));
    assert_eq!(analysis["request"]["inputs"], json!({"trial": trial}));
    assert!(!analysis["request"]["spec"].as_object().unwrap().is_empty(), "defaults are filled in");
    assert!(analysis.get("problem").is_none());

    let report = format!("{path}/report");
    let early = server.get(&report).await.problem(409, "conflict");
    assert!(early["detail"].as_str().unwrap().contains("queued"), "{early}");

    server.work().await;
    let finished = server.get(&path).await.json(200);
    assert_eq!(finished["status"], "succeeded", "{finished}");
    assert_eq!(finished["attempts"], 1);
    assert!(finished["finished_at"].is_string() && finished["started_at"].is_string());
    let answer = server.get(&report).await;
    let body = answer.json(200);
    assert_eq!(
        (&body["kind"], &body["schema"]),
        (&json!("frequency_response"), &json!("volition.frequency_response/2"))
    );
    assert!(body["result"]["h"].is_array() && body["warnings"].is_array());
    assert_eq!(body["provenance"]["spec_sha256"], finished["spec_sha256"]);
    let stored = server.store.report_json(finished["id"].as_str().unwrap().parse().unwrap()).await.unwrap().unwrap();
    assert_eq!(answer.bytes, stored.as_bytes(), "byte for byte");
    let known = server.send(server.request("GET", &report).header("if-none-match", answer.header("etag"))).await;
    assert_eq!((known.status.as_u16(), known.bytes.len()), (304, 0));

    let listed =
        server.get(&format!("/v1/analyses?trial={trial}&kind=frequency_response&status=succeeded")).await.json(200);
    assert_eq!(listed["items"].as_array().unwrap().len(), 1);
    assert!(listed["items"][0].get("request").is_none());
    for filter in ["kind=ssid", "status=failed", "trial=0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10"] {
        let none = server.get(&format!("/v1/analyses?{filter}")).await.json(200);
        assert_eq!(none["items"], json!([]), "{filter}");
    }
    assert_eq!(server.delete(&path).await.status, 204);
    server.get(&report).await.problem(404, "not_found");
    server.finish().await;
}

#[tokio::test]
async fn several_inputs_and_outputs_come_with_the_request() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    // Two uncoupled loops with plants 1/(z - 0.5) and 1/(z + 0.4), Gff = I and Gfb = diag(0.2, 0.3).
    let omega: Vec<f64> = (1..=10).map(|k| 0.3 * f64::from(k)).collect();
    let h: Vec<Value> = omega
        .iter()
        .map(|w| {
            let z = num_complex::Complex64::from_polar(1.0, *w);
            let closed = |pole: f64, gain: f64| {
                let g = 1.0 / (z - pole);
                let h = g * (1.0 + gain) / (1.0 + g * gain);
                [h.re, h.im]
            };
            json!([[closed(0.5, 0.2), [0, 0]], [[0, 0], closed(-0.4, 0.3)]])
        })
        .collect();
    let gains = json!([{"from": 0.0, "to": 0.4, "step": 0.1}]);
    let request = json!({"kind": "ssid_mimo",
        "inputs": {
            "plant": {"a": [[0.5, 0], [0, -0.4]], "b": [[1, 0], [0, 1]], "c": [[1, 0], [0, 1]], "d": [[0, 0], [0, 0]],
                      "sample_time_s": 1},
            "frequency_response": {"omega_rad_s": omega, "h": h}},
        "spec": {"pool": {"matrix_grid": {"feedback_numerator": [[gains, [[0]]], [[[0]], gains]]}},
                 "feedforward_order": 0}});
    let queued = server.post("/v1/analyses", &request).await;
    let path = queued.header("location").to_owned();
    let analysis = queued.json(202);
    assert_eq!(
        (&analysis["kind"], &analysis["request"]["inputs"]["measured_outputs"]),
        (&json!("ssid_mimo"), &json!([0, 1]))
    );
    server.work().await;
    let report = server.get(&format!("{path}/report")).await.json(200);
    assert_eq!(report["schema"], "volition.ssid_mimo/1");
    let result = &report["result"];
    assert_eq!(result["feedback"]["numerator"], json!([[[0.2], [0.0]], [[0.0], [0.3]]]), "{result}");
    assert_eq!(result["certificate"]["listed"], 25);
    assert_eq!(result["fit"][0]["h"].as_array().unwrap().len(), 2);

    // A trial has one command, one control and one output.
    let mut of_trial = request.clone();
    of_trial["inputs"] = json!({"trial": trial});
    let refused = server.post("/v1/analyses", &of_trial).await.problem(422, "invalid");
    assert_eq!(refused["where"], "/inputs/trial");
    assert!(refused["detail"].as_str().unwrap().contains("one command, one control and one output"), "{refused}");
    let mut ragged = request;
    ragged["inputs"]["plant"]["b"] = json!([[1, 0]]);
    let refused = server.post("/v1/analyses", &ragged).await.problem(422, "invalid");
    assert_eq!(refused["where"], "/inputs/plant");
    assert!(refused["detail"].as_str().unwrap().contains("B is 1x2 and must be 2x2"), "{refused}");
    server.finish().await;
}

#[tokio::test]
async fn progress_is_what_the_worker_says_and_has_its_etag() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    let path = format!("/v1/analyses/{}", server.post("/v1/analyses", &request(&trial)).await.id(202));
    let queued = server.get(&path).await.header("etag").to_owned();
    let claim = server.store.claim("test", 60.0).await.unwrap().unwrap();
    server.store.heartbeat(&claim.lease, Progress::of_units(3, 12), 60.0).await.unwrap();
    let changed = server.send(server.request("GET", &path).header("if-none-match", &queued)).await;
    let running = changed.json(200);
    assert_eq!((&running["status"], &running["attempts"]), (&json!("running"), &json!(1)));
    assert_eq!((&running["progress"]["done"], &running["progress"]["total"]), (&json!(3), &json!(12)));
    assert!(running["progress"]["eta_s"].as_f64().unwrap() >= 0.0);
    let same = server.send(server.request("GET", &path).header("if-none-match", changed.header("etag"))).await;
    assert_eq!(same.status, 304);

    // Cancelling a running one is asked for, and done by its worker.
    let asked = server.send(server.request("POST", &format!("{path}/cancel"))).await.json(202);
    assert_eq!((&asked["status"], &asked["cancel_requested"]), (&json!("running"), &json!(true)));
    assert!(server.store.confirm_cancel(&claim.lease).await.unwrap());
    let over = server.send(server.request("POST", &format!("{path}/cancel"))).await.json(200);
    assert_eq!(over["status"], "cancelled");
    let none = server.get(&format!("{path}/report")).await.problem(409, "conflict");
    assert!(none["detail"].as_str().unwrap().contains("cancelled"));
    server.finish().await;
}

#[tokio::test]
async fn a_queued_analysis_is_cancelled_at_once() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    let id = server.post("/v1/analyses", &request(&trial)).await.id(202);
    let cancelled = server.send(server.request("POST", &format!("/v1/analyses/{id}/cancel"))).await.json(200);
    assert_eq!(cancelled["status"], "cancelled");
    assert_eq!(server.count(Status::Queued).await, 0);
    server.finish().await;
}

#[tokio::test]
async fn a_failed_analysis_carries_its_problem() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    let path = format!("/v1/analyses/{}", server.post("/v1/analyses", &request(&trial)).await.id(202));
    let claim = server.store.claim("test", 60.0).await.unwrap().unwrap();
    let problem = volition::analysis::Problem::new(volition::analysis::Code::NotIdentifiable, "no power", "r is zero");
    assert!(server.store.fail(&claim.lease, &problem).await.unwrap());
    let failed = server.get(&path).await.json(200);
    assert_eq!((&failed["status"], &failed["problem"]["code"]), (&json!("failed"), &json!("not_identifiable")));
    assert_eq!(failed["problem"]["detail"], "r is zero");
    let none = server.get(&format!("{path}/report")).await.problem(409, "conflict");
    assert!(none["detail"].as_str().unwrap().contains("failed"));
    server.finish().await;
}

#[tokio::test]
async fn requests_that_cannot_be_done_are_not_queued() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    let elsewhere = server.lab().await;
    let stranger = server.trial(&elsewhere, 1).await;
    let nobody = "0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10";
    for (body, place) in [
        (json!({}), "/kind"),
        (json!({"kind": "sisd", "inputs": {}}), "/kind"),
        (json!({"kind": "ssid"}), "/inputs"),
        (json!({"kind": 7, "inputs": {}}), "/kind"),
        (json!({"kind": "frequency_response", "inputs": {"trial": nobody}}), "/inputs/trial"),
        (json!({"kind": "frequency_response", "inputs": {"trials": [trial, nobody]}}), "/inputs/trials/1"),
        (json!({"kind": "frequency_response", "inputs": {"trials": [trial, stranger]}}), "/inputs/trials/1"),
        (json!({"kind": "frequency_response", "inputs": {"trial": trial}, "spec": {"linse": []}}), "/spec/linse"),
        (json!({"kind": "frequency_response", "inputs": {"trial": trial}, "sepc": {}}), "/sepc"),
    ] {
        let problem = server.post("/v1/analyses", &body).await.problem(422, "invalid");
        assert_eq!(problem["where"], place, "{body} → {problem}");
    }
    assert_eq!(server.census().await[4], 0);
    server.finish().await;
}

#[tokio::test]
async fn data_can_come_with_the_request() {
    let server = TestServer::start().await;
    let numbers = |f: &dyn Fn(f64) -> f64| -> Vec<f64> { (0..64).map(|i| f(f64::from(i) * 0.1)).collect() };
    let trial = json!({
        "sample_time_s": 0.1, "r": numbers(&|t| (3.0 * t).sin()), "u": numbers(&|t| t.cos()),
        "y": numbers(&|t| (3.0 * t - 0.2).sin())
    });
    let body = json!({"kind": "frequency_response", "inputs": {"trial": trial}});
    let queued = server.post("/v1/analyses", &body).await.json(202);
    assert_eq!(queued["study"], Value::Null);
    assert_eq!(queued["request"]["inputs"]["trial"]["r"], trial["r"]);
    server.work().await;
    let path = format!("/v1/analyses/{}", queued["id"].as_str().unwrap());
    assert_eq!(server.get(&path).await.json(200)["status"], "succeeded");
    server.finish().await;
}

#[tokio::test]
async fn an_idempotent_request_is_queued_once() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    let post = |path: &str, body: &Value| server.request("POST", path).header("idempotency-key", "k1").json(body);
    let first = server.send(post("/v1/analyses", &request(&trial))).await.id(202);
    let again = server.send(post("/v1/analyses", &request(&trial))).await;
    assert_eq!((again.id(202), again.header("idempotent-replayed")), (first, "true"));
    let bulk = format!("/v1/studies/{}/analyses", lab.study);
    let body = json!({"kind": "frequency_response", "only": "all"});
    let first = server.send(post(&bulk, &body)).await.json(202);
    server.trial(&lab, 2).await;
    assert_eq!(server.send(post(&bulk, &body)).await.json(202), first, "a replay answers for the trials of then");
    assert_eq!(server.count(Status::Queued).await, 2);
    server.work().await;
    server.finish().await;
}

#[tokio::test]
async fn a_study_is_analysed_trial_by_trial() {
    let server = TestServer::start().await;
    let mut lab = server.lab().await;
    let mut trials = Vec::new();
    for number in 1..=4 {
        trials.push(server.trial(&lab, number).await);
    }
    let wild = "t,r,u,y\n0,0,0,0\n0.1,1,1,4.5\n0.2,1,1,-6\n0.3,1,1,2\n";
    let divergent = server.upload_csv(&lab, "&number=5&session=1", wild).await.id(201);
    lab.subject = server.subject(&lab.study, "s02").await;
    let other = server.upload_csv(&lab, "&number=2&session=2", recording(64, 9.0)).await.id(201);
    let path = format!("/v1/studies/{}/analyses", lab.study);

    let all = server.post(&path, &json!({"kind": "frequency_response"})).await.json(202);
    let of = |answer: &Value| -> Vec<String> {
        answer["analyses"].as_array().unwrap().iter().map(|a| a["trial"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(all["created"], 5);
    let mut expected: Vec<String> = trials.iter().chain([&other]).cloned().collect();
    let mut found = of(&all);
    found.sort();
    expected.sort();
    assert_eq!(found, expected);
    assert_eq!(all["skipped"][0]["trial"], json!(divergent));
    assert!(all["skipped"][0]["reason"].as_str().unwrap().contains('6'), "{all}");
    for analysis in all["analyses"].as_array().unwrap() {
        let path = format!("/v1/analyses/{}", analysis["id"].as_str().unwrap());
        assert_eq!(server.get(&path).await.json(200)["request"]["inputs"]["trial"], analysis["trial"]);
    }

    let filter =
        json!({"subject": trials_subject(&server, &trials[0]).await, "session": 1, "number_from": 2, "number_to": 3});
    let body = json!({"kind": "frequency_response", "only": "all", "filter": filter});
    let some = server.post(&path, &body).await.json(202);
    assert_eq!(of(&some), trials[1..3]);
    assert_eq!(some["skipped"], json!([]));
    let wild = json!({"number_from": 5, "include_divergent": true});
    let wild = server.post(&path, &json!({"kind": "frequency_response", "filter": wild})).await.json(202);
    assert_eq!((of(&wild), &wild["skipped"]), (vec![divergent], &json!([])));
    let none =
        server.post(&path, &json!({"kind": "frequency_response", "filter": {"group": "nobody"}})).await.json(202);
    assert_eq!((&none["created"], &none["analyses"]), (&json!(0), &json!([])));

    // All were asked for in the same way, so they are one run; another spec is another one.
    let path_of = |answer: &Value| answer["progress"].as_str().unwrap().to_owned();
    let progress = path_of(&all);
    assert_eq!([path_of(&some), path_of(&none)], [progress.clone(), progress.clone()]);
    let detrended = json!({"kind": "frequency_response", "spec": {"detrend": "mean"}, "filter": {"session": 2}});
    let detrended = server.post(&path, &detrended).await.json(202);
    let queued = |count: u64| {
        json!({"done": 0, "total": count, "eta_s": null, "analyses":
            {"queued": count, "running": 0, "succeeded": 0, "failed": 0, "cancelled": 0}})
    };
    assert_eq!(server.get(&progress).await.json(200), queued(8));
    assert_eq!(server.get(&path_of(&detrended)).await.json(200), queued(1));
    let whole = format!("/v1/studies/{}/progress", lab.study);
    assert_eq!(server.get(&whole).await.json(200), queued(9));
    assert_eq!(server.get(&format!("{whole}?kind=ssid")).await.json(200)["total"], 0);

    let census = server.census().await;
    for (body, place) in [
        (json!({"kind": "sisd"}), "/kind"),
        (json!({"kind": "frequency_response", "spec": {"linse": 1}}), "/spec/linse"),
        (json!({"kind": "frequency_response", "spec": {"linse": 1}, "filter": {"group": "nobody"}}), "/spec/linse"),
        (json!({"kind": "frequency_response", "filter": {"grop": "gm"}}), "/filter/grop"),
        (json!({"kind": "frequency_response", "filter": ["gm"]}), "/filter"),
        (json!({"kind": "frequency_response", "filter": {"subject": lab.plant}}), "/filter/subject"),
        (json!({"kind": "frequency_response", "filter": {"plant": lab.subject}}), "/filter/plant"),
        (json!({"kind": "frequency_response", "filter": {"number_from": 3, "number_to": 2}}), "/filter/number_to"),
    ] {
        let problem = server.post(&path, &body).await.problem(422, "invalid");
        assert_eq!(problem["where"], place, "{body} → {problem}");
    }
    assert_eq!(server.census().await, census);
    server.work().await;
    let done = server.get(&whole).await.json(200);
    assert_eq!((&done["done"], &done["total"], &done["eta_s"]), (&json!(9), &json!(9), &json!(0.0)), "{done}");
    server.finish().await;
}

async fn trials_subject(server: &TestServer, trial: &str) -> Value {
    server.get(&format!("/v1/trials/{trial}")).await.json(200)["subject"].clone()
}
