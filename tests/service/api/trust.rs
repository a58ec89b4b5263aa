//! How far values may be used, over HTTP.

use crate::api::harness::{Lab, TestServer};
use serde_json::{Value, json};
use volition::analysis::Report;
use volition::analysis::estimates::quantities;
use volition::simulate::reference_signals::chirp60;
use volition::simulate::subject::SimulatedSubject;

const SAMPLE_TIME_S: f64 = 0.05;

async fn upload(server: &TestServer, lab: &Lab, seed: u64, number: u32) -> String {
    let plant = volition::plants::catalogue::minimum_phase();
    let subject = SimulatedSubject::new(&plant, SAMPLE_TIME_S, seed).unwrap();
    let trial = subject.trial(number, &chirp60(SAMPLE_TIME_S), None).unwrap();
    let mut csv = Vec::new();
    volition::trial::write::csv(&trial, &mut csv).unwrap();
    let query = format!("&number={number}&sample_time_s={SAMPLE_TIME_S}");
    server.upload_csv(lab, &query, String::from_utf8(csv).unwrap()).await.id(201)
}

/// A study of three people with two trials each, identified by the pool and by prediction error.
pub async fn identified(server: &TestServer) -> Lab {
    let mut lab = server.lab().await;
    for (seed, code) in [(1, "s01"), (2, "s02"), (3, "s03")] {
        if code != "s01" {
            lab.subject = server.subject(&lab.study, code).await;
        }
        for number in [1, 20] {
            upload(server, &lab, seed, number).await;
        }
    }
    let thin = json!({"poles": 12, "zeros": 12, "damping": 4, "gains": 6});
    let spec = json!({"pool": {"name": "zhang2015_appendix_c", "thin": thin}});
    let path = format!("/v1/studies/{}/analyses", lab.study);
    server.post(&path, &json!({"kind": "ssid", "spec": spec})).await.json(202);
    server.post(&path, &json!({"kind": "prediction_error"})).await.json(202);
    server.work().await;
    lab
}

#[tokio::test]
async fn the_rule_is_shown_as_it_is_applied() {
    let server = TestServer::start().await;
    let shown = server.get("/v1/trust-rule").await.json(200);
    assert_eq!(shown, serde_json::to_value(volition::trust::rule()).unwrap());
    assert_eq!(shown["constants"]["spread_do_not_use"], 3.0);
    server.finish().await;
}

#[tokio::test]
async fn trust_is_the_same_in_analysis_trial_study_and_curve() {
    let server = TestServer::start().await;
    let lab = identified(&server).await;
    let study = format!("/v1/studies/{}", lab.study);
    let plant = server.get(&format!("/v1/plants/{}", lab.plant)).await.json(200);
    let model = serde_json::from_value(plant["model"].clone()).unwrap();
    let analyses = server.get(&format!("/v1/analyses?study={}&limit=100", lab.study)).await.json(200);
    let analyses = analyses["items"].as_array().unwrap().clone();
    assert_eq!(analyses.len(), 12);
    for analysis in &analyses {
        let address = format!("/v1/analyses/{}", analysis["id"].as_str().unwrap());
        // What is stored is the pure function of the report.
        let report: Report = serde_json::from_value(server.get(&format!("{address}/report")).await.json(200)).unwrap();
        let found = server.get(&format!("{address}/trust")).await.json(200);
        let mut expected: Vec<Value> =
            quantities(&report, Some(&model)).iter().map(|own| serde_json::to_value(own).unwrap()).collect();
        let key = |own: &Value| (own["estimator"].to_string(), own["quantity"].to_string());
        expected.sort_by_key(key);
        let mut stored = found["trust"].as_array().unwrap().clone();
        stored.sort_by_key(key);
        assert!(!stored.is_empty());
        assert_eq!(stored, expected, "{address}");
    }
    for (estimator, quantity) in [
        ("ssid", "norm_feedback"),
        ("ssid", "norm_feedforward_plant_minus_one"),
        ("prediction_error", "norm_feedback"),
        ("prediction_error", "variance_accounted_for"),
        ("ssid", "mean_abs_error"),
    ] {
        let grid = server.get(&format!("{study}/trust?estimator={estimator}&quantity={quantity}")).await.json(200);
        let curves = server.get(&format!("{study}/learning-curves?estimator={estimator}")).await.json(200);
        let group = &curves["groups"][0];
        let mut levels = Vec::new();
        for (row, subject) in grid["rows"].as_array().unwrap().iter().zip(group["subjects"].as_array().unwrap()) {
            assert_eq!(row["code"], subject["code"]);
            for (cell, point) in
                row["trials"].as_array().unwrap().iter().zip(subject["curve"]["points"].as_array().unwrap())
            {
                let trust = point["trust"].as_array().unwrap().iter().find(|own| own["quantity"] == quantity).unwrap();
                for key in ["quantity", "level", "code", "because", "do", "also"] {
                    assert_eq!(cell[key], trust[key], "{estimator} {quantity} {key}");
                }
                assert_eq!(
                    (&cell["trial"], &cell["value"]),
                    (&point["trial"], &point[quantity]),
                    "{estimator} {quantity}"
                );
                levels.push(cell["level"].as_str().unwrap().to_owned());
                let own = server.get(&format!("/v1/trials/{}/trust", cell["trial"].as_str().unwrap())).await.json(200);
                let all = own["measured"].as_array().unwrap().iter().chain(own["identified"].as_array().unwrap());
                let same = |one: &&Value| {
                    one["quantity"] == quantity && (one["estimator"] == estimator || one.get("estimator").is_none())
                };
                assert_eq!(all.filter(same).map(|one| &one["level"]).collect::<Vec<_>>(), [&cell["level"]]);
            }
        }
        let count = |level: &str| levels.iter().filter(|own| *own == level).count();
        for level in ["not_identified", "ok", "read", "do_not_use"] {
            assert_eq!(grid["counts"][level], count(level), "{estimator} {quantity} {levels:?}");
        }
        // Of every mean it is said how many of its values are not to be used.
        let bad: u64 = group["points"]
            .as_array()
            .unwrap()
            .iter()
            .map(|point| point["metrics"][quantity]["trust"]["do_not_use"].as_u64().unwrap())
            .sum();
        // A share that is less than nothing is in no mean.
        let in_a_mean = |cell: &&Value| {
            let value = cell["value"].as_f64();
            quantity != "variance_accounted_for" || value.is_some_and(|value| value >= 0.0)
        };
        let cells = grid["rows"].as_array().unwrap().iter().flat_map(|row| row["trials"].as_array().unwrap());
        let in_means = cells.filter(in_a_mean).filter(|cell| cell["level"] == "do_not_use").count();
        assert_eq!(bad as usize, in_means, "{estimator} {quantity} {levels:?}");
        let said = curves["remarks"].as_array().unwrap().iter().any(|own| {
            own["code"] == "values_not_to_be_used"
                && own["message"].as_str().unwrap().contains(&format!("of {quantity}"))
        });
        assert_eq!(said, bad > 0, "{estimator} {quantity}: {}", curves["remarks"]);
        // The picture has the same cells.
        let figure = format!("{study}/figures/trust?estimator={estimator}&quantity={quantity}&format=json");
        let figure = server.get(&figure).await.json(200);
        let drawn: Vec<String> = figure["panels"][0]["series"]
            .as_array()
            .unwrap()
            .iter()
            .flat_map(|series| series["trust"].as_array().unwrap())
            .map(|level| level.as_str().unwrap().to_owned())
            .collect();
        assert_eq!(drawn, levels);
    }
    server.finish().await;
}

#[tokio::test]
async fn sentences_about_values_that_are_not_to_be_used_are_not_made() {
    let server = TestServer::start().await;
    let lab = identified(&server).await;
    let study = format!("/v1/studies/{}", lab.study);
    // The command alone does not tell the feedback.
    let compared = server.get(&format!("{study}/comparison?metrics=norm_feedback,mean_abs_error")).await.json(200);
    let findings: Vec<&str> = compared["findings"].as_array().unwrap().iter().map(|f| f.as_str().unwrap()).collect();
    let of = |symbol: &str| findings.iter().filter(|own| own.contains(symbol)).copied().collect::<Vec<_>>();
    let refused = of("‖Gfb‖");
    assert!(
        !refused.is_empty() && refused.iter().all(|own| own.contains("no statement: 6 of the 6 values")),
        "{findings:#?}"
    );
    assert!(refused[0].contains("record with a second stimulus"), "{}", refused[0]);
    assert!(of("‖e‖").iter().all(|own| !own.contains("no statement")), "{findings:#?}");
    let trust = &compared["groups"][0]["metrics"][0]["trust"];
    assert_eq!((&trust["level"], &trust["do_not_use"]), (&json!("do_not_use"), &json!(6)));
    let median = server.get(&format!("{study}/median-subjects?metric=norm_feedback")).await.json(200);
    assert_eq!(median["groups"][0]["ranking"][0]["trust"]["level"], "do_not_use");
    assert!(median["remarks"].as_array().unwrap().iter().any(|own| own["code"] == "values_not_to_be_used"), "{median}");

    // A display limit that every trial passes: nothing of them is to be used, without judging anything anew.
    let limit = json!({"display_limit": 1e-3});
    server.patch(&study, &limit).await.json(200);
    let grid = server.get(&format!("{study}/trust?estimator=prediction_error")).await.json(200);
    assert_eq!(grid["counts"]["do_not_use"], 6, "{grid}");
    assert_eq!(grid["rows"][0]["trials"][0]["code"], "divergent");
    let trial = grid["rows"][0]["trials"][0]["trial"].as_str().unwrap();
    let view = server.get(&format!("/v1/trials/{trial}")).await.json(200);
    assert!(view["trust"].as_array().unwrap().iter().all(|own| own["level"] == "do_not_use"), "{view}");
    server.finish().await;
}

#[tokio::test]
async fn what_is_asked_for_wrongly_is_said_with_its_place() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let study = format!("/v1/studies/{}", lab.study);
    for (query, place) in
        [("quantity=luck", "query parameter quantity"), ("estimator=eye", "query parameter estimator")]
    {
        let problem = server.get(&format!("{study}/trust?{query}")).await.problem(400, "malformed");
        assert_eq!(problem["where"], place, "{problem}");
    }
    let grid = server.get(&format!("{study}/trust")).await.json(200);
    assert_eq!((&grid["rows"], &grid["spec"]), (&json!([]), &Value::Null));
    assert_eq!(server.get("/v1/analyses/0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10/trust").await.status.as_u16(), 404);
    server.finish().await;
}
