//! Figures as publications have them.

use crate::api::harness::{TestServer, upload_simulated as upload};
use serde_json::{Value, json};

/// The course of a descent, from an analysis to its figure.
#[tokio::test]
async fn a_descent_is_drawn_where_it_was_asked_for() {
    let server = TestServer::start().await;
    let inputs = json!({"a": [[1, 2, -1], [-0.5, 1, 2], [1, 1, 1]], "b": [[0, 1], [-1, 1], [0.5, 0]],
        "k": [[2.17, 2.88, 7.35], [1.82, 3.94, 6.08]]});
    let fit = |descent: Value| json!({"fit": {"condition_numbers": [100], "random_starts": 0, "descent": descent}});
    let mut ids = Vec::new();
    for descent in [json!({"rate": 1e-4, "steps": 1000}), Value::Null] {
        let request = json!({"kind": "inverse_lqr", "inputs": inputs, "spec": fit(descent)});
        ids.push(server.post("/v1/analyses", &request).await.id(202));
    }
    server.work().await;
    let with = format!("/v1/analyses/{}", ids[0]);
    for (id, is_there) in ids.iter().zip([true, false]) {
        let list = server.get(&format!("/v1/analyses/{id}/figures")).await.json(200);
        let has = list["figures"].as_array().unwrap().iter().any(|figure| figure["name"] == "descent");
        assert_eq!(has, is_there, "{list}");
    }
    server.get(&format!("/v1/analyses/{}/figures/descent", ids[1])).await.problem(404, "not_found");
    let figure = server.get(&format!("{with}/figures/descent?format=json&w=2000")).await.json(200);
    let report = server.get(&format!("{with}/report")).await.json(200);
    let course = &report["result"]["fit"]["descent"]["course"];
    let series = |panel: usize| figure["panels"][panel]["series"][0].clone();
    let numbers = |value: &Value| -> Vec<f64> { value.as_array().unwrap().iter().filter_map(Value::as_f64).collect() };
    assert_eq!(numbers(&series(0)["x"]), numbers(&course["step"]));
    assert_eq!(numbers(&series(0)["y"]), numbers(&course["residual"]));
    assert_eq!(numbers(&series(1)["y"]), numbers(&course["relative_distance"]));
    assert_eq!(numbers(&series(0)["x"]).last(), Some(&1000.0));
    server.finish().await;
}

/// First against last trials, one person's figures, plants, and excluded trials by name.
#[tokio::test]
async fn a_study_is_drawn_as_publications_draw_it() {
    let server = TestServer::start().await;
    let mut lab = server.lab().await;
    let mut excluded = String::new();
    for (seed, code) in [(1, "s01"), (2, "s02"), (3, "s03")] {
        if code != "s01" {
            lab.subject = server.subject(&lab.study, code).await;
        }
        for number in [1, 10, 20] {
            excluded = upload(&server, &lab, seed, number).await;
        }
    }
    // Trial 20 of the last person.
    let reason = json!({"excluded": {"reason": "let go of the stick"}});
    server.patch(&format!("/v1/trials/{excluded}"), &reason).await.json(200);
    let body = json!({"kind": "prediction_error", "spec": {"band_hz": [0.02, 0.5]}});
    let path = format!("/v1/studies/{}/analyses", lab.study);
    server.post(&path, &body).await.json(202);
    server.work().await;
    let study = format!("/v1/studies/{}/figures", lab.study);
    let by = "estimator=prediction_error&format=json&w=2000";
    let figure = |name: &str, more: &str| {
        let address = format!("{study}/{name}?{by}{more}");
        let server = &server;
        async move { server.get(&address).await.json(200) }
    };
    let names = |panel: &Value| -> Vec<String> {
        let all = panel["series"].as_array().unwrap().iter();
        all.filter(|one| one["mark"] == "line").map(|one| one["name"].as_str().unwrap().to_owned()).collect()
    };
    let practice = figure("bode_practice", "").await;
    assert_eq!(names(&practice["panels"][0]), ["G⁻¹", "gm, first", "gm, last"]);
    // The mean of the first trials is that of the interface at the same frequencies.
    let own = server.get(&format!("/v1/studies/{}/learning-curves?estimator=prediction_error", lab.study)).await;
    assert_eq!(own.json(200)["groups"][0]["first_trials"]["rows"].as_array().unwrap().len(), 3);
    let line = practice["panels"][0]["series"].as_array().unwrap().iter().find(|one| one["name"] == "gm, first");
    let line = line.unwrap().clone();
    let omega: Vec<f64> =
        line["x"].as_array().unwrap().iter().map(|f| f.as_f64().unwrap() * std::f64::consts::TAU).collect();
    let ends = format!("omega_from_rad_s={}&omega_to_rad_s={}&points=2", omega[0], omega.last().unwrap());
    let address =
        format!("/v1/studies/{}/frequency-responses?estimator=prediction_error&trial=first&{ends}", lab.study);
    let said = server.get(&address).await.json(200);
    let gain = &said["groups"][0]["all"]["feedforward"]["mean_gain_db"];
    for (at, place) in [(0, 0), (1, omega.len() - 1)] {
        let (a, b) = (gain[at].as_f64().unwrap(), line["y"][place].as_f64().unwrap());
        assert!((a - b).abs() < 1e-6, "{a} {b}");
    }
    // Of one person: a mean over nobody else.
    let only = figure("bode_practice", &format!("&subject={}", lab.subject)).await;
    assert_eq!(names(&only["panels"][0]), ["G⁻¹", "s03, first", "s03, last"]);
    assert!(only["title"].as_str().unwrap().contains("of s03"), "{}", only["title"]);
    for name in ["mean_abs_error", "bode", "scatter"] {
        let caption = figure(name, "").await["caption"].as_str().unwrap().to_owned();
        assert!(caption.contains("s03 trial 20 (let go of the stick)"), "{name}: {caption}");
    }
    let last = figure("last_trial", "").await;
    assert_eq!(last["x"]["names"], json!(["s01", "s02", "s03"]));
    let trimmed = figure("bode_trimmed", "").await;
    // Behind the sentence that names who is left out altogether.
    let caption = trimmed["caption"].as_str().unwrap().split("Mean over subjects").last().unwrap();
    assert_eq!(["s01", "s02", "s03"].iter().filter(|code| caption.contains(&format!("{code} trial"))).count(), 1);
    let steps = figure("plant_steps", "").await;
    assert_eq!(steps["panels"][0]["series"].as_array().unwrap().len(), 1);
    let none = server.get(&format!("{study}/plant_zero")).await.problem(422, "invalid");
    assert!(none["detail"].as_str().unwrap().contains("no plant of the study"));
    let other = server.lab().await;
    server.get(&format!("{study}/bode?subject={}", other.subject)).await.problem(404, "not_found");
    server.finish().await;
}
