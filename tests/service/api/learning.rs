use crate::api::harness::{Lab, TestServer, simulated};
use num_complex::Complex64;
use serde_json::{Value, json};

#[tokio::test]
async fn curves_before_anything_is_identified() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    for number in 1..=3 {
        server.trial(&lab, number).await;
    }
    let wild = "t,r,u,y\n0,0,0,0\n0.1,1,1,4.5\n0.2,1,1,-6\n0.3,1,1,2\n";
    server.upload_csv(&lab, "&number=4&session=1", wild).await.json(201);

    let path = format!("/v1/subjects/{}/learning-curves", lab.subject);
    let curve = server.get(&path).await.json(200);
    assert_eq!((&curve["code"], &curve["group"]), (&json!("s01"), &json!("gm")));
    let curve = &curve["curves"][0];
    assert_eq!(curve["plant"], json!({"id": lab.plant, "name": "gm"}));
    assert_eq!(numbers(&curve["points"]), [1, 2, 3]);
    assert_eq!(numbers(&curve["left_out"]), [4]);
    assert_eq!(curve["spec"], Value::Null);
    let first = server.get(&format!("/v1/trials/{}", curve["points"][0]["trial"].as_str().unwrap())).await.json(200);
    assert_eq!(curve["points"][0]["mean_abs_error"], first["metrics"]["mean_abs_error"]);

    let all = server.get(&format!("{path}?include_divergent=true")).await.json(200);
    assert_eq!(numbers(&all["curves"][0]["points"]), [1, 2, 3, 4]);
    let none = server.get(&format!("{path}?session=2")).await.json(200);
    assert_eq!(none["curves"], json!([]));
    let one = server.get(&format!("{path}?plant={}&session=1", lab.plant)).await.json(200);
    assert_eq!(one["curves"].as_array().unwrap().len(), 1);

    let study = server.get(&format!("/v1/studies/{}/learning-curves", lab.study)).await.json(200);
    assert_eq!((&study["groups"][0]["group"], &study["trim"]), (&json!("gm"), &json!(1)));
    let responses = server.get(&format!("/v1/studies/{}/frequency-responses", lab.study)).await.json(200);
    assert_eq!(responses["omega_rad_s"], json!([]));
    let grid = format!("/v1/studies/{}/frequency-responses?omega_from_rad_s=1&omega_to_rad_s=3&points=5", lab.study);
    assert_eq!(server.get(&grid).await.json(200)["omega_rad_s"], json!([1.0, 1.5, 2.0, 2.5, 3.0]));
    server.finish().await;
}

fn numbers(list: &Value) -> Vec<i64> {
    list.as_array().unwrap().iter().map(|p| p["number"].as_i64().unwrap()).collect()
}

#[tokio::test]
async fn groups_are_told_apart() {
    let server = TestServer::start().await;
    let mut lab = server.lab().await;
    server.trial(&lab, 1).await;
    let body = json!({"code": "s02", "group": "gn"});
    let other = server.post(&format!("/v1/studies/{}/subjects", lab.study), &body).await.id(201);
    lab = Lab { subject: other, ..lab };
    server.trial(&lab, 2).await;
    let path = format!("/v1/studies/{}/learning-curves", lab.study);
    let groups = |value: &Value| -> Vec<String> {
        value["groups"].as_array().unwrap().iter().map(|g| g["group"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(groups(&server.get(&path).await.json(200)), ["gm", "gn"]);
    assert_eq!(groups(&server.get(&format!("{path}?group=gn")).await.json(200)), ["gn"]);
    server.finish().await;
}

/// A transfer function of a report at ω.
fn response(model: &Value, omega: f64) -> Complex64 {
    let list = |key: &str| model[key].as_array().unwrap().iter().map(|c| c.as_f64().unwrap()).collect::<Vec<_>>();
    let z = Complex64::from_polar(1.0, omega * model["sample_time_s"].as_f64().unwrap());
    let at = |c: &[f64]| c.iter().fold(Complex64::ZERO, |sum, c| sum * z + c);
    at(&list("num")) / at(&list("den"))
}

#[tokio::test]
async fn identified_trials_make_curves_and_mean_controllers() {
    let server = TestServer::start().await;
    let mut lab = server.lab().await;
    let mut subjects = Vec::new();
    for (seed, code) in [(1, "s01"), (2, "s02"), (3, "s03")] {
        if code != "s01" {
            lab.subject = server.subject(&lab.study, code).await;
        }
        subjects.push(lab.subject.clone());
        for number in [1, 20] {
            let query = format!("&number={number}&sample_time_s=0.05");
            server.upload_csv(&lab, &query, simulated(seed, number)).await.json(201);
        }
    }
    let thin = json!({"poles": 12, "zeros": 12, "damping": 4, "gains": 6});
    let spec = |thin: &Value| json!({"pool": {"name": "zhang2015_appendix_c", "thin": thin}});
    let path = format!("/v1/studies/{}/analyses", lab.study);
    let queued = server.post(&path, &json!({"kind": "ssid", "spec": spec(&thin)})).await.json(202);
    assert_eq!(queued["created"], 6);
    server.work().await;

    // The curve shows what the reports say.
    let curve = server.get(&format!("/v1/subjects/{}/learning-curves", subjects[0])).await.json(200);
    let curve = &curve["curves"][0];
    assert_eq!(numbers(&curve["points"]), [1, 20]);
    let mut reports = Vec::new();
    for analysis in queued["analyses"].as_array().unwrap() {
        let id = analysis["id"].as_str().unwrap();
        let report = server.get(&format!("/v1/analyses/{id}/report")).await.json(200);
        reports.push((analysis["trial"].clone(), id.to_owned(), report));
    }
    let spec_sha256 = reports[0].2["provenance"]["spec_sha256"].clone();
    assert_eq!((&curve["spec"]["spec_sha256"], &curve["spec"]["trials"]), (&spec_sha256, &json!(2)));
    for point in curve["points"].as_array().unwrap() {
        let (_, id, report) = reports.iter().find(|(trial, ..)| *trial == point["trial"]).unwrap();
        assert_eq!(point["analysis"], json!(id));
        for norm in ["norm_feedback", "norm_feedforward_minus_inverse", "norm_feedforward_plant_minus_one"] {
            assert_eq!(point[norm], report["result"]["metrics"][norm], "{norm}");
            assert!(point[norm].is_number(), "{norm}");
        }
        assert_eq!(point["cost"], report["result"]["cost"]);
    }

    // The mean feedforward, once more from the transfer functions in the reports.
    let path = format!("/v1/studies/{}/frequency-responses", lab.study);
    let mean = server.get(&format!("{path}?points=7")).await.json(200);
    let group = &mean["groups"][0];
    assert_eq!(group["all"]["subjects"], json!(["s01", "s02", "s03"]));
    assert!(group["trials"].as_array().unwrap().iter().all(|t| t["number"] == 20), "the last trial of each");
    let last: Vec<&Value> = reports
        .iter()
        .filter(|(trial, ..)| group["trials"].as_array().unwrap().iter().any(|t| t["trial"] == *trial))
        .map(|(.., report)| &report["result"]["feedforward"])
        .collect();
    assert_eq!((last.len(), mean["omega_rad_s"].as_array().unwrap().len()), (3, 7));
    for (i, omega) in mean["omega_rad_s"].as_array().unwrap().iter().enumerate() {
        let omega = omega.as_f64().unwrap();
        let expected = last.iter().map(|model| response(model, omega)).sum::<Complex64>() / 3.0;
        let [re, im] = [0, 1].map(|part| group["all"]["feedforward"]["mean"][i][part].as_f64().unwrap());
        assert!((Complex64::new(re, im) - expected).norm() < 1e-9 * expected.norm(), "{omega}: {re} {im} {expected}");
    }
    let first = server.get(&format!("{path}?trial=first&points=1")).await.json(200);
    assert!(first["groups"][0]["trials"].as_array().unwrap().iter().all(|t| t["number"] == 1));

    // A second way of identifying is not mixed in, and its existence is said.
    let trial = &reports[0].0;
    let coarse = spec(&json!({"poles": 16, "zeros": 16, "damping": 4, "gains": 10}));
    let body = json!({"kind": "ssid", "inputs": {"trial": trial}, "spec": coarse});
    let other = server.post("/v1/analyses", &body).await.json(202);
    server.work().await;
    let owner = server.get(&format!("/v1/trials/{}", trial.as_str().unwrap())).await.json(200);
    let path = format!("/v1/subjects/{}/learning-curves", owner["subject"].as_str().unwrap());
    let both = server.get(&path).await.json(200);
    assert_eq!(both["curves"][0]["spec"]["spec_sha256"], spec_sha256, "the spec that covers most trials");
    assert_eq!(both["curves"][0]["spec"]["others"][0]["spec_sha256"], other["spec_sha256"]);
    assert!(both["remarks"].to_string().contains("several_specs"), "{}", both["remarks"]);
    let chosen = server.get(&format!("{path}?spec={}", other["spec_sha256"].as_str().unwrap())).await.json(200);
    let shown: Vec<&Value> = chosen["curves"][0]["points"]
        .as_array()
        .unwrap()
        .iter()
        .map(|p| &p["analysis"])
        .filter(|a| !a.is_null())
        .collect();
    assert_eq!(shown, [&other["id"]]);

    // Group curves have every subject, with the norms.
    let study = server.get(&format!("/v1/studies/{}/learning-curves", lab.study)).await.json(200);
    let group = &study["groups"][0];
    assert_eq!(group["subjects"].as_array().unwrap().len(), 3);
    assert_eq!(group["points"][0]["metrics"]["norm_feedforward_plant_minus_one"]["n"], 3);

    // Deleting a trial takes its analyses, and the curve is without both.
    assert_eq!(server.delete(&format!("/v1/trials/{}", trial.as_str().unwrap())).await.status, 204);
    server.get(&format!("/v1/analyses/{}/report", other["id"].as_str().unwrap())).await.problem(404, "not_found");
    let rest = server.get(&path).await.json(200);
    assert_eq!(rest["curves"][0]["points"].as_array().unwrap().len(), 1);
    server.finish().await;
}

/// Prediction error of single trials and of all together as curves, with the interval of each point or why there is
/// none.
#[tokio::test]
async fn curves_have_intervals_from_prediction_error() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let mut trials = Vec::new();
    for number in [1, 10, 20] {
        let query = format!("&number={number}&sample_time_s=0.05");
        let made = server.upload_csv(&lab, &query, simulated(1, number)).await.json(201);
        trials.push(made["id"].clone());
    }
    let kind = "prediction_error";
    let spec = json!({"feedback_delay_s": [0.1, 0.35], "band_hz": [0.02, 0.5]});
    for trial in &trials[..2] {
        let body = json!({"kind": kind, "inputs": {"trial": trial}, "spec": spec});
        server.post("/v1/analyses", &body).await.json(202);
    }
    let body = json!({"kind": kind, "inputs": {"trials": trials}, "spec": spec});
    let joint = server.post("/v1/analyses", &body).await.json(202);
    server.work().await;

    let path = format!("/v1/subjects/{}/learning-curves", lab.subject);
    let plain = server.get(&path).await.json(200);
    assert_eq!(plain["curves"][0]["estimator"], "ssid");
    assert!(plain["curves"][0]["points"][0]["norm_feedback"].is_null());
    let curve = server.get(&format!("{path}?estimator={kind}")).await.json(200);
    let curve = &curve["curves"][0];
    assert_eq!((&curve["estimator"], &curve["spec"]["trials"]), (&json!(kind), &json!(2)));
    let points = curve["points"].as_array().unwrap();
    for point in &points[..2] {
        let value = point["norm_feedback"].as_f64().unwrap();
        match &point["intervals_95"]["norm_feedback"] {
            Value::Null => assert!(point["intervals_95"]["reason"].is_string(), "{point}"),
            interval => {
                let [low, high] = [0, 1].map(|k| interval[k].as_f64().unwrap());
                assert!(low <= value && value <= high, "{point}");
            }
        }
    }
    assert!(points[2]["norm_feedback"].is_null() && points[2]["intervals_95"]["reason"].is_string());
    // The third is not identified, and not averaged.
    let study = server.get(&format!("/v1/studies/{}/learning-curves?estimator={kind}", lab.study)).await.json(200);
    let counts: Vec<i64> = study["groups"][0]["points"]
        .as_array()
        .unwrap()
        .iter()
        .map(|p| p["metrics"]["norm_feedback"]["n"].as_i64().unwrap())
        .collect();
    assert_eq!(counts, [1, 1, 0]);

    let together = server.get(&format!("{path}?estimator={kind}&joint=true")).await.json(200);
    let points = together["curves"][0]["points"].as_array().unwrap();
    let report = server.get(&format!("/v1/analyses/{}/report", joint["id"].as_str().unwrap())).await.json(200);
    for (i, point) in points.iter().enumerate() {
        assert_eq!(point["analysis"], joint["id"]);
        let metrics = &report["result"]["trials"][i]["metrics"];
        for norm in ["norm_feedback", "norm_feedforward_plant_minus_one"] {
            assert_eq!(point[norm], metrics[norm]["value"]);
            assert_eq!(point["intervals_95"][norm], metrics[norm]["interval_95"]);
        }
    }
    server.get(&format!("{path}?joint=true")).await.problem(422, "invalid");
    server.get(&format!("{path}?estimator=guess")).await.problem(400, "malformed");
    server.finish().await;
}
