//! Trials of a study and of a subject: filtered, sorted, streamed; trials that are noted, excluded, put
//! on another plant.

use crate::api::harness::{Lab, TestServer, recording};
use serde_json::{Value, json};

/// Two subjects with trials of two sessions on two plants; the numbers of a list are told by subject and number.
async fn two_people(server: &TestServer) -> (Lab, String) {
    let lab = server.lab().await;
    let other = json!({"name": "lag & lead", "model": {"num": [1.0], "den": [1.0, 1.0], "sample_time_s": null}});
    let plant = server.post(&format!("/v1/studies/{}/plants", lab.study), &other).await.id(201);
    let body = json!({"code": "a02", "group": "gn"});
    let second = server.post(&format!("/v1/studies/{}/subjects", lab.study), &body).await.id(201);
    for (subject, plant, session, number) in [
        (&lab.subject, &lab.plant, 1, 1),
        (&lab.subject, &plant, 1, 2),
        (&second, &lab.plant, 1, 3),
        (&second, &lab.plant, 2, 1),
    ] {
        let path = format!("/v1/subjects/{subject}/trials?plant={plant}&session={session}&number={number}");
        let csv = recording(64, f64::from(10 * session + number));
        server.send(server.request("POST", &path).header("content-type", "text/csv").body(csv)).await.json(201);
    }
    (lab, second)
}

fn names(list: &Value) -> Vec<String> {
    let name =
        |trial: &Value| format!("{} {}/{}", trial["subject_code"].as_str().unwrap(), trial["session"], trial["number"]);
    list["items"].as_array().unwrap().iter().map(name).collect()
}

#[tokio::test]
async fn trials_of_a_study_are_found_by_names() {
    let server = TestServer::start().await;
    let (lab, second) = two_people(&server).await;
    let study = format!("/v1/studies/{}/trials", lab.study);
    let list = async |query: &str| names(&server.get(&format!("{study}?{query}")).await.json(200));
    let all = ["s01 1/1", "s01 1/2", "a02 1/3", "a02 2/1"];
    assert_eq!(list("").await, all);
    for (query, expected) in [
        ("subject=a02", vec![all[2], all[3]]),
        (&format!("subject={second}&session=2"), vec![all[3]]),
        ("group=gm", vec![all[0], all[1]]),
        ("group=nobody", vec![]),
        ("plant=lag%20%26%20lead", vec![all[1]]),
        (&format!("plant={}&number_from=2&number_to=3", lab.plant), vec![all[2]]),
        ("divergent=true", vec![]),
        ("divergent=false&excluded=false", all.to_vec()),
        ("excluded=true", vec![]),
        ("sort=-created", vec![all[3], all[2], all[1], all[0]]),
        ("sort=number", vec![all[0], all[1], all[2], all[3]]),
        ("sort=subject", vec![all[2], all[3], all[0], all[1]]),
        ("sort=-subject", vec![all[1], all[0], all[3], all[2]]),
    ] {
        assert_eq!(list(query).await, expected, "{query}");
    }
    let of_subject = server.get(&format!("/v1/subjects/{second}/trials?sort=-number")).await.json(200);
    assert_eq!(names(&of_subject), [all[3], all[2]]);
    let errors = |list: &Value| -> Vec<f64> {
        let error = |trial: &Value| trial["metrics"]["mean_abs_error"].as_f64().unwrap();
        list["items"].as_array().unwrap().iter().map(error).collect()
    };
    let worst = errors(&server.get(&format!("{study}?sort=-mean_abs_error")).await.json(200));
    assert!(worst.len() == 4 && worst.windows(2).all(|pair| pair[0] > pair[1]), "{worst:?}");
    for (query, status, code, place) in [
        ("subject=s99", 404, "not_found", "query parameter subject"),
        ("plant=gx", 404, "not_found", "query parameter plant"),
        ("sort=age", 400, "malformed", "query parameter sort"),
        ("divergent=maybe", 400, "malformed", "query parameter divergent"),
        ("number_from=3&number_to=2", 400, "malformed", "query parameter number_to"),
    ] {
        let refused = server.get(&format!("{study}?{query}")).await.problem(status, code);
        assert_eq!(refused["where"], place, "{query}: {refused}");
    }
    server.get(&format!("/v1/subjects/{second}/trials?subject=a02")).await.problem(400, "malformed");
    server.finish().await;
}

#[tokio::test]
async fn sorted_pages_neither_skip_nor_repeat() {
    let server = TestServer::start().await;
    let (lab, _) = two_people(&server).await;
    for sort in ["subject", "-number", "mean_abs_error", "-rms_error", "max_abs_output", "-created"] {
        let path = format!("/v1/studies/{}/trials?sort={sort}", lab.study);
        let whole = names(&server.get(&path).await.json(200));
        let (mut found, mut next) = (Vec::new(), String::new());
        loop {
            let page = server.get(&format!("{path}&limit=1{next}")).await.json(200);
            found.extend(names(&page));
            let Some(cursor) = page["next_cursor"].as_str() else { break };
            next = format!("&cursor={cursor}");
        }
        assert_eq!((found.len(), &found), (4, &whole), "{sort}");
    }
    // The trial that ended a page is gone: nobody can say where a sorted list goes on.
    let path = format!("/v1/studies/{}/trials?sort=subject&limit=1", lab.study);
    let page = server.get(&path).await.json(200);
    server.delete(&format!("/v1/trials/{}", page["items"][0]["id"].as_str().unwrap())).await;
    let lost = server.get(&format!("{path}&cursor={}", page["next_cursor"].as_str().unwrap())).await;
    assert_eq!(lost.problem(409, "conflict")["where"], "query parameter cursor");
    server.finish().await;
}

#[tokio::test]
async fn lists_come_as_a_stream_of_lines() {
    let server = TestServer::start().await;
    let (lab, _) = two_people(&server).await;
    let lines = async |path: &str| -> Vec<Value> {
        let answer = server.send(server.request("GET", path).header("accept", "application/x-ndjson")).await;
        assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, "application/x-ndjson"), "{path}");
        answer.text().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    };
    let trials = format!("/v1/studies/{}/trials?sort=-number", lab.study);
    let page = server.get(&trials).await.json(200);
    assert_eq!(json!(lines(&trials).await), page["items"]);
    assert_eq!(lines(&format!("{trials}&limit=3")).await.len(), 3, "a limit is one of the whole stream");
    for index in 0..701 {
        server.post(&format!("/v1/studies/{}/subjects", lab.study), &json!({"code": format!("p{index:04}")})).await;
    }
    let subjects = lines(&format!("/v1/studies/{}/subjects", lab.study)).await;
    assert_eq!(subjects.len(), 703, "everything, beyond one page");
    assert_eq!(subjects[702]["code"], "p0700");
    for path in ["/v1/studies".to_owned(), format!("/v1/studies/{}/plants", lab.study), "/v1/analyses".to_owned()] {
        let page = server.get(&path).await.json(200);
        assert_eq!(json!(lines(&path).await), page["items"], "{path}");
    }
    let none = "/v1/studies/0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10/trials";
    let lost = server.send(server.request("GET", none).header("accept", "application/x-ndjson")).await;
    lost.problem(404, "not_found");
    server.finish().await;
}

#[tokio::test]
async fn an_excluded_trial_is_left_out_and_named() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let (kept, out) = (server.trial(&lab, 1).await, server.trial(&lab, 2).await);
    let path = format!("/v1/trials/{out}");
    let reason = "The subject let go of the stick.";
    let excluded = server.patch(&path, &json!({"note": "see video", "excluded": {"reason": reason}})).await.json(200);
    assert_eq!((&excluded["note"], &excluded["excluded"]), (&json!("see video"), &json!({"reason": reason})));
    for trust in excluded["trust"].as_array().unwrap() {
        assert_eq!((&trust["level"], &trust["code"]), (&json!("do_not_use"), &json!("excluded")), "{trust}");
        assert!(trust["because"].as_str().unwrap().contains(reason));
    }
    let grid = server.get(&format!("/v1/studies/{}/trust?quantity=rms_error", lab.study)).await.text();
    assert!(grid.contains(reason), "{grid}");
    let of_study = format!("/v1/studies/{}", lab.study);
    for curves in [
        format!("{of_study}/learning-curves"),
        format!("/v1/subjects/{}/learning-curves", lab.subject),
        format!("{of_study}/median-subjects"),
        format!("{of_study}/frequency-responses"),
    ] {
        let answer = server.get(&curves).await.text();
        assert!(answer.contains("excluded_left_out") && answer.contains(reason), "{curves}: {answer}");
        assert!(!answer.contains(&out), "{curves}");
    }
    let with =
        server.get(&format!("/v1/subjects/{}/learning-curves?include_excluded=true", lab.subject)).await.json(200);
    let points = with["curves"][0]["points"].as_array().unwrap();
    assert_eq!(
        (points.len(), &points[0]["trial"], &points[1]["excluded"]),
        (2, &json!(kept), &json!(reason)),
        "{with}"
    );
    assert_eq!(points[1]["trust"][0]["code"], "excluded");
    let comparison = server.get(&format!("{of_study}/comparison")).await.text();
    assert!(comparison.contains("excluded_left_out"), "{comparison}");
    // A run skips it with the reason; who asks for it all the same is warned in the report.
    let run = format!("{of_study}/analyses");
    let queued = server.post(&run, &json!({"kind": "frequency_response"})).await.json(202);
    assert_eq!((&queued["created"], &queued["skipped"][0]["trial"]), (&json!(1), &json!(out)));
    assert_eq!(queued["skipped"][0]["reason"], format!("excluded: {reason}"));
    let body = json!({"kind": "frequency_response", "filter": {"include_excluded": true}});
    let queued = server.post(&run, &body).await.json(202);
    assert_eq!((&queued["created"], &queued["existing"][0]["trial"]), (&json!(1), &json!(kept)));
    server.work().await;
    let report = format!("/v1/analyses/{}/report", queued["analyses"][0]["id"].as_str().unwrap());
    let warnings = server.get(&report).await.json(200)["warnings"].clone();
    assert!(warnings.as_array().unwrap().iter().any(|own| own["code"] == "excluded_trial"), "{warnings}");
    let back = server.patch(&path, &json!({"excluded": null, "note": null})).await.json(200);
    assert_eq!(
        (&back["excluded"], &back["note"], &back["trust"][0]["level"]),
        (&Value::Null, &json!(""), &json!("ok"))
    );
    for bad in [json!(true), json!({}), json!({"reason": " "}), json!({"reason": "a\nb"})] {
        let refused = server.patch(&path, &json!({"excluded": bad})).await.problem(422, "invalid");
        assert!(refused["where"].as_str().unwrap().starts_with("/excluded"), "{refused}");
    }
    server.finish().await;
}

#[tokio::test]
async fn a_trial_is_put_on_another_plant_while_nothing_was_computed_from_it() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let csv = recording(600, 1.0);
    let made = server.upload_csv(&lab, "&number=1", csv).await.json(201);
    let trial = made["id"].as_str().unwrap().to_owned();
    let path = format!("/v1/trials/{trial}");
    let body = json!({"name": "lag", "model": {"num": [1.0], "den": [1.0, 1.0], "sample_time_s": null}});
    let other = server.post(&format!("/v1/studies/{}/plants", lab.study), &body).await.id(201);
    let moved = server.patch(&path, &json!({"plant": other})).await.json(200);
    assert_eq!((&moved["plant"], &moved["plant_name"], &moved["version"]), (&json!(other), &json!("lag"), &json!(2)));
    // The same as if it had been uploaded there.
    let fresh = server.subject(&lab.study, "s02").await;
    let there = Lab { study: lab.study.clone(), plant: other.clone(), subject: fresh };
    let uploaded = server.upload_csv(&there, "&number=1", recording(600, 1.0)).await.id(201);
    let uploaded = server.get(&format!("/v1/trials/{uploaded}")).await.json(200);
    assert_eq!(moved["metrics"], uploaded["metrics"]);
    assert_eq!(moved["recording_warnings"], uploaded["recording_warnings"]);
    let elsewhere = server.study().await;
    let foreign = server.plant(&elsewhere).await;
    let refused = server.patch(&path, &json!({"plant": foreign})).await.problem(422, "invalid");
    assert_eq!(refused["where"], "/plant");
    let request = json!({"kind": "frequency_response", "inputs": {"trial": trial}, "spec": {}});
    let analysis = server.post("/v1/analyses", &request).await.id(202);
    let in_use = server.patch(&path, &json!({"plant": lab.plant})).await.problem(409, "conflict");
    assert!(
        in_use["where"] == "/plant" && in_use["mend"].as_str().unwrap().contains("/v1/analyses?trial="),
        "{in_use}"
    );
    assert_eq!(server.delete(&format!("/v1/analyses/{analysis}")).await.status, 204);
    server.patch(&path, &json!({"plant": lab.plant})).await.json(200);
    server.finish().await;
}
