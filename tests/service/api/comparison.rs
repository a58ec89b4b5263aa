//! `GET /v1/studies/{study}/comparison`.

use crate::api::harness::{Lab, TestServer};
use serde_json::{Value, json};

/// A short recording whose error |r − y| is `error`, and whose first control is `u`.
fn recording(error: f64, u: f64) -> String {
    let rows: Vec<String> =
        (0..6).map(|i| format!("{},1,{},{}", 0.1 * f64::from(i), if i == 0 { 0.0 } else { u }, 1.0 - error)).collect();
    format!("t,r,u,y\n{}\n", rows.join("\n"))
}

/// Two groups of four people with five trials; the second group's error ends higher, and begins with a smaller control.
async fn study(server: &TestServer) -> Lab {
    let mut lab = server.lab().await;
    for (group, last, control) in [("gm", 0.2, 0.5), ("gn", 0.5, 0.1)] {
        for person in 0..4 {
            let body = json!({"code": format!("{group}{person}"), "group": group});
            lab.subject = server.post(&format!("/v1/studies/{}/subjects", lab.study), &body).await.id(201);
            for number in 1..=5 {
                // Scatter that is the same in every run.
                let scatter = 0.01 * f64::from((person * 7 + number * 3) % 5);
                let error = last + 0.4 * (-f64::from(number - 1) / 1.5).exp() + scatter;
                let query = format!("&number={number}&sample_time_s=0.1");
                server.upload_csv(&lab, &query, recording(error, control)).await.json(201);
            }
        }
    }
    lab
}

fn finding<'a>(comparison: &'a Value, part: &str) -> &'a str {
    let findings = comparison["findings"].as_array().unwrap();
    let found = findings.iter().filter_map(Value::as_str).find(|s| s.contains(part));
    found.unwrap_or_else(|| panic!("no finding has {part}: {findings:#?}"))
}

#[tokio::test]
async fn groups_are_compared_with_intervals_and_in_words() {
    let server = TestServer::start().await;
    let lab = study(&server).await;
    let path = format!("/v1/studies/{}/comparison", lab.study);
    let found = server.get(&format!("{path}?contrasts=last")).await.json(200);
    assert_eq!(found["groups"].as_array().unwrap().len(), 2);
    let contrast = &found["pairs"][0]["metrics"][0]["contrasts"][0];
    assert_eq!(
        (&found["pairs"][0]["metrics"][0]["metric"], &contrast["contrast"]),
        (&json!("mean_abs_error"), &json!("last"))
    );
    // 2/C(8, 4): the groups do not overlap.
    assert!((contrast["permutation"]["p"].as_f64().unwrap() - 2.0 / 70.0).abs() < 1e-15, "{contrast}");
    assert_eq!(
        (&contrast["permutation"]["allocations"], &contrast["p_adjusted"]),
        (&json!(70), &contrast["permutation"]["p"])
    );
    let interval: Vec<f64> =
        contrast["difference"]["interval95"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
    assert!(interval[0] < 0.3 && 0.3 < interval[1], "{interval:?}");
    assert!(
        finding(&found, "gn on gm less gm on gm, ‖e‖, at trial 5").contains("the groups differ, gn on gm being higher")
    );

    // The threshold of the first control is that of the request: recordings are read again.
    let right = |found: &Value, group: usize| {
        found["groups"][group]["counts"]["right_control_first"]["people"]["count"].clone()
    };
    assert_eq!((right(&found, 0), right(&found, 1)), (json!(4), json!(4)));
    let strict = server.get(&format!("{path}?right_control_threshold=0.3&contrasts=last")).await.json(200);
    assert_eq!((right(&strict, 0), right(&strict, 1)), (json!(4), json!(0)));
    assert_eq!(strict["groups"][1]["counts"]["right_control_first"]["people"]["of"], 0, "no |u| passes 0.3");
    assert_eq!(strict["settings"]["right_control_threshold"], 0.3);
    assert!(finding(&found, "Right control").contains("|u| > 0.0500"));

    // Everything else that can be asked for.
    let all = server
        .get(&format!(
            "{path}?groups=gn,gm&metrics=rms_error,mean_abs_error&contrasts=change,first&curve=trials\
             &correction=benjamini_hochberg&extrapolated=take_in&retention_trials=3&seed=7&plant={}",
            lab.plant
        ))
        .await
        .json(200);
    let settings = &all["settings"];
    assert_eq!(
        *settings,
        json!({"curve": "trials", "correction": "benjamini_hochberg", "leave_out_extrapolated": false,
               "retention_trials": 3, "right_control_threshold": 0.05, "seed": 7})
    );
    let metrics: Vec<&Value> = all["pairs"][0]["metrics"].as_array().unwrap().iter().map(|m| &m["metric"]).collect();
    assert_eq!(metrics, ["rms_error", "mean_abs_error"]);
    assert_eq!(all["families"]["differences"], 4);
    let one = server.get(&format!("{path}?groups=gm")).await.json(200);
    assert_eq!((one["pairs"].as_array().unwrap().len(), &one["remarks"][0]["code"]), (0, &json!("one_group")));
    server.finish().await;
}

/// Smoothness is read off the recordings at their upload and compared like any other metric: a tremor of the second
/// group lowers it.
#[tokio::test]
async fn the_smoothness_of_the_control_is_compared() {
    let server = TestServer::start().await;
    let mut lab = server.lab().await;
    let recording = |tremor: f64, phase: f64| {
        let row = |i: u32| {
            let t = 0.02 * f64::from(i);
            let u = (1.3 * t + phase).sin() + tremor * (16.0 * t).sin();
            format!("{t},1,{u},{}", 0.5 + 0.1 * (1.3 * t).sin())
        };
        format!("t,r,u,y\n{}\n", (0..500).map(row).collect::<Vec<_>>().join("\n"))
    };
    let mut jerks = Vec::new();
    for (group, tremor) in [("gm", 0.0), ("gn", 0.1)] {
        for person in 0..4 {
            let body = json!({"code": format!("{group}{person}"), "group": group});
            lab.subject = server.post(&format!("/v1/studies/{}/subjects", lab.study), &body).await.id(201);
            for number in 1..=2 {
                let csv = recording(tremor, 0.05 * f64::from(2 * person + number));
                let query = format!("&number={number}&sample_time_s=0.02");
                let trial = server.upload_csv(&lab, &query, csv).await.json(201);
                if (group, number) == ("gn", 2) {
                    jerks.push(trial["metrics"]["control_log_dimensionless_jerk"].as_f64().unwrap());
                }
            }
        }
    }
    let found = server
        .get(&format!(
            "/v1/studies/{}/comparison?metrics=control_log_dimensionless_jerk&contrasts=last&curve=trials",
            lab.study
        ))
        .await
        .json(200);
    let compared = &found["pairs"][0]["metrics"][0];
    assert_eq!(compared["metric"], "control_log_dimensionless_jerk");
    let contrast = &compared["contrasts"][0];
    assert!(contrast["difference"]["difference"].as_f64().unwrap() < -1.0, "{contrast}");
    assert!((contrast["permutation"]["p"].as_f64().unwrap() - 2.0 / 70.0).abs() < 1e-15, "{contrast}");
    let mean = found["groups"][1]["metrics"][0]["contrasts"][0]["mean"]["coefficients"][0]["value"].as_f64().unwrap();
    assert!((mean - jerks.iter().sum::<f64>() / 4.0).abs() < 1e-12, "{mean} {jerks:?}");
    let sentence = finding(&found, "gn on gm less gm on gm, log dimensionless jerk of u, at trial 2");
    assert!(sentence.contains("the groups differ, gm on gm being higher"), "{sentence}");
    assert!(found["remarks"].as_array().unwrap().iter().any(|r| r["code"] == "jerk_depends_on_duration"));
    server.finish().await;
}

#[tokio::test]
async fn what_makes_no_sense_is_refused_by_name() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let path = format!("/v1/studies/{}/comparison", lab.study);
    for (query, place) in [
        ("metrics=error", "metrics"),
        ("metrics=", "metrics"),
        ("contrasts=first,middle", "contrasts"),
        ("curve=line", "curve"),
        ("correction=none", "correction"),
        ("extrapolated=true", "extrapolated"),
        ("right_control_threshold=0", "right_control_threshold"),
        ("retention_trials=0", "retention_trials"),
        ("seed=-1", "seed"),
        ("groups=gm,", "groups"),
        ("session=x", "session"),
        ("spec=abc", "spec"),
        ("include_divergent=true", "include_divergent"),
    ] {
        let problem = server.get(&format!("{path}?{query}")).await.problem(400, "malformed");
        assert_eq!(problem["where"], format!("query parameter {place}"), "{query}");
    }
    let problem = server.get(&format!("{path}?groups=gx")).await.problem(404, "not_found");
    assert_eq!(problem["where"], "query parameter groups");
    let empty = server.get(&path).await.json(200);
    assert_eq!((&empty["groups"], &empty["findings"]), (&json!([]), &json!([])));
    for (i, group) in ["a", "b", "c", "d", "e"].iter().enumerate() {
        let body = json!({"code": format!("p{i}"), "group": group});
        let subject = server.post(&format!("/v1/studies/{}/subjects", lab.study), &body).await.id(201);
        let lab = Lab { subject, study: lab.study.clone(), plant: lab.plant.clone() };
        server.upload_csv(&lab, "&number=1&sample_time_s=0.1", recording(0.1 * i as f64, 0.5)).await.json(201);
    }
    let problem = server.get(&path).await.problem(422, "invalid");
    assert_eq!(problem["where"], "query parameter groups");
    assert_eq!(server.get(&format!("{path}?groups=a,b")).await.json(200)["pairs"].as_array().unwrap().len(), 1);
    server.finish().await;
}

/// Of four people none is the median: the lower of the middle two is shown with its first and last trials, by number
/// and with signals, and the other one is named.
#[tokio::test]
async fn the_median_subject_comes_with_its_first_and_last_trial_in_one_request() {
    let server = TestServer::start().await;
    let lab = study(&server).await;
    let path = format!("/v1/studies/{}/median-subjects", lab.study);
    let found = server.get(&path).await.json(200);
    let groups = found["groups"].as_array().unwrap();
    assert_eq!(groups.len(), 2);
    for group in groups {
        let ranking = group["ranking"].as_array().unwrap();
        let values: Vec<f64> = ranking.iter().map(|s| s["value"].as_f64().unwrap()).collect();
        assert!(values.len() == 4 && values.is_sorted(), "{values:?}");
        assert_eq!((&group["median"], &group["other_middle"]), (&ranking[1], &ranking[2]));
        let trials = group["trials"].as_array().unwrap();
        let numbers: Vec<&Value> = trials.iter().map(|t| &t["point"]["number"]).collect();
        assert_eq!(numbers, [1, 5]);
        for trial in trials {
            let signals = &trial["signals"];
            let error = trial["point"]["mean_abs_error"].as_f64().unwrap();
            assert_eq!(signals["e"].as_array().unwrap().len(), 6);
            assert!(signals["e"].as_array().unwrap().iter().all(|e| (e.as_f64().unwrap() - error).abs() < 1e-9));
            assert!(trial["responses"].is_null(), "nothing is identified");
        }
    }
    let codes: Vec<&Value> = found["remarks"].as_array().unwrap().iter().map(|r| &r["code"]).collect();
    assert!(codes.iter().filter(|c| **c == "no_single_median").count() == 2, "{codes:?}");

    let query =
        "group=gm&metric=rms_error&over=last&trials=2,last,9&every=2&omega_from_rad_s=1&omega_to_rad_s=2&points=3";
    let found = server.get(&format!("{path}?{query}")).await.json(200);
    assert_eq!(found["omega_rad_s"], json!([1.0, 1.5, 2.0]));
    let group = &found["groups"][0];
    assert_eq!(group["median"]["trials"], json!(1));
    let shown: Vec<&Value> = group["trials"].as_array().unwrap().iter().map(|t| &t["shown_as"]).collect();
    assert_eq!(shown, [&json!({"number": 2}), &json!("last")]);
    assert_eq!(group["trials"][0]["signals"]["t"].as_array().unwrap().len(), 3);
    assert!(found["remarks"].as_array().unwrap().iter().any(|r| r["code"] == "trial_not_shown"));
    let found = server.get(&format!("{path}?signals=false&metric=norm_feedback")).await.json(200);
    assert!(found["groups"][0]["median"].is_null(), "nothing is identified");
    assert!(found["remarks"].as_array().unwrap().iter().any(|r| r["code"] == "subjects_without_value"));

    for bad in ["metric=speed", "over=some", "trials=0", "trials=first,,last", "signals=2", "every=0", "points=0"] {
        server.get(&format!("{path}?{bad}")).await.problem(400, "malformed");
    }
    server.get(&format!("{path}?omega_from_rad_s=2&omega_to_rad_s=1")).await.problem(422, "invalid");
    server.finish().await;
}
