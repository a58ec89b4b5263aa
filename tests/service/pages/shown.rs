//! What pages say.

use super::{filled, look, page, stands_alone, upload};
use crate::api::harness::TestServer;
use serde_json::{Value, json};
use volition::analysis::{Code, Problem};

#[tokio::test]
async fn an_empty_database_offers_three_ways_to_begin() {
    let server = TestServer::start().await;
    let home = page(&server, "/").await;
    home.has("No study yet. Three ways to begin:");
    for way in ["volition demo --database", "volition import FOLDER", "/v1/studies"] {
        home.has(way);
    }
    page(&server, "/queue").await.has("Nothing was ever asked for.");
    let study = server.study().await;
    page(&server, "/").await.has("gm and gn");
    page(&server, &format!("/studies/{study}")).await.has("No trial yet");
    server.finish().await;
}

/// The number behind a word.
#[track_caller]
fn number_after(words: &str, before: &str) -> f64 {
    let rest = words.split_once(before).unwrap_or_else(|| panic!("{before:?} is not in {words}")).1;
    rest.split_whitespace().next().unwrap().trim_matches(|c: char| !c.is_ascii_digit()).parse().unwrap()
}

#[tokio::test]
async fn a_study_says_the_answer_first_and_its_numbers_are_those_of_the_interface() {
    let server = TestServer::start().await;
    let (lab, trials) = filled(&server).await;
    let path = format!("/studies/{}", lab.study);
    let seen = page(&server, &path).await;
    let words = seen.words();
    let order = ["Who learned what", "Tracking error", "Trials", "Subjects", "Where this comes from"];
    let places: Vec<usize> = order.iter().map(|title| seen.text.find(&format!("<h2>{title}</h2>")).unwrap()).collect();
    assert!(places.is_sorted(), "{places:?}");

    // The means that the sentence has, once more from the curves.
    let curves =
        server.get(&format!("/v1/studies/{}/learning-curves?estimator=prediction_error", lab.study)).await.json(200);
    let points = curves["groups"][0]["points"].as_array().unwrap();
    let mean = |at: usize| points[at]["metrics"]["mean_abs_error"]["mean"].as_f64().unwrap();
    let sentence = "from trial 1 to trial 20 the tracking error fell from ";
    assert!((number_after(&words, sentence) / mean(0) - 1.0).abs() < 0.005, "{words}");
    let share = 100.0 * (mean(1) - mean(0)) / mean(0);
    seen.has(&format!("−{:.0} %", -share));
    seen.has("n = 3");

    // Every trial has its cell, with the trust that the figure of the interface has.
    let figure = format!("/v1/studies/{}/figures/norm_feedback?estimator=prediction_error&format=json", lab.study);
    let figure = server.get(&figure).await.json(200);
    let series = figure["panels"][0]["series"].as_array().unwrap();
    let grid = page(&server, &format!("{path}?quantity=norm_feedback")).await;
    for (code, own) in ["s01", "s02", "s03"].iter().zip(&trials) {
        let line = series.iter().find(|one| one["name"] == *code).unwrap();
        for (at, trial) in own.iter().enumerate() {
            let level = line["trust"][at].as_str().unwrap();
            let cell = format!("href=\"/trials/{trial}\" data-trust=\"{level}\"");
            assert!(grid.text.contains(&cell), "{cell} is missing");
        }
    }
    // Controllers by prediction errors have their mean too, and every figure its numbers as a table.
    assert_eq!(seen.text.matches("data-figure=\"bode\"").count(), 2);
    let cards = seen.text.matches("class=\"card figure\"").count();
    assert_eq!(seen.text.matches("<details class=\"numbers\">").count(), cards);
    let more = page(&server, &format!("{path}?figure=bode_practice")).await;
    assert_eq!(more.text.matches("data-figure=\"bode_practice\"").count(), 2);
    page(&server, &format!("{path}?figure=plant_zero")).await.has("Nothing to draw");
    // The first page counts what the grid of the study counts.
    let counts = server.get(&format!("/v1/studies/{}/trust?estimator=prediction_error", lab.study)).await.json(200);
    let counts = &counts["counts"];
    let home = page(&server, "/").await;
    home.has(&format!("✓ {} ! {} ✕ {}", counts["ok"], counts["read"], counts["do_not_use"]));
    // Both widths of the figure are there, and it says its finding to those who do not see it.
    assert_eq!(seen.text.matches("data-figure=\"mean_abs_error\"").count(), 2);
    assert!(seen.text.contains("<desc>") && seen.text.contains("role=\"img\""));
    server.finish().await;
}

#[tokio::test]
async fn a_sentence_whose_numbers_are_not_to_be_used_is_no_statement() {
    let server = TestServer::start().await;
    let mut lab = server.lab().await;
    for (seed, code) in [(1, "s01"), (2, "s02"), (3, "s03")] {
        if code != "s01" {
            lab.subject = server.subject(&lab.study, code).await;
        }
        for number in [1, 20] {
            upload(&server, &lab, seed, number).await;
        }
    }
    let waiting = page(&server, &format!("/studies/{}", lab.study)).await;
    waiting.has("Nothing identified yet");
    waiting.has("6 trials wait.");
    let thin = json!({"poles": 12, "zeros": 12, "damping": 4, "gains": 6});
    let spec = json!({"pool": {"name": "zhang2015_appendix_c", "thin": thin}});
    let path = format!("/v1/studies/{}/analyses", lab.study);
    server.post(&path, &json!({"kind": "ssid", "spec": spec})).await.json(202);
    server.work().await;
    let seen = page(&server, &format!("/studies/{}", lab.study)).await;
    // The command alone tells no feedback: six values of ‖Gfb‖, none to be used.
    seen.has("No statement about the gain of the feedback, ‖Gfb‖ (means ");
    seen.has("): 6 of the 6 values are not to be used. Restrict the pool, or record with a second stimulus.");
    seen.has("in 4 of 6 values, among candidates that fit nearly as well the greatest value is more than three times");
    page(&server, &format!("/studies/{}?quantity=norm_feedback", lab.study)).await.has("6 do not use");
    server.finish().await;
}

#[tokio::test]
async fn a_subject_and_its_trials_lead_to_one_another() {
    let server = TestServer::start().await;
    let (lab, trials) = filled(&server).await;
    let subject = page(&server, &format!("/subjects/{}", lab.subject)).await;
    subject.has("gm · 2 trials · estimated by prediction error");
    for trial in &trials[2] {
        assert!(subject.text.contains(&format!("/trials/{trial}")));
    }
    let [first, last] = &trials[2];
    let seen = page(&server, &format!("/trials/{last}?from=20&to=25")).await;
    seen.has("s03, trial 20");
    seen.has("Can it be trusted?");
    // The neighbour keeps the view; the figure is that of the interface at the same view.
    assert!(seen.text.contains(&format!("href=\"/trials/{first}?from=20&amp;to=25\"")), "{}", seen.text);
    assert!(seen.text.contains("data-from=\"20.0\" data-to=\"25.0\""));
    let drawn = server.get(&format!("/v1/trials/{last}/figures/signals?theme=page&w=760&from=20&to=25")).await.text();
    assert!(seen.text.contains(&drawn), "the page's figure is another one");
    // Without a stretch that exists, the whole trial.
    page(&server, &format!("/trials/{last}?from=500&to=600")).await.has("Signals");
    let curve = format!("/v1/subjects/{}/learning-curves?estimator=prediction_error", lab.subject);
    let curve = server.get(&curve).await.json(200);
    let point = &curve["curves"][0]["points"][1];
    let interval = &point["intervals_95"]["norm_feedforward_plant_minus_one"];
    let ends: Vec<f64> = interval.as_array().unwrap().iter().map(|end| end.as_f64().unwrap()).collect();
    let decimals = (1 - (0.5 * (ends[1] - ends[0])).log10().floor() as i32).max(0) as usize;
    let value = point["norm_feedforward_plant_minus_one"].as_f64().unwrap();
    seen.has(&format!("‖Gff G − 1‖ {value:.decimals$} [{:.decimals$}, {:.decimals$}]", ends[0], ends[1]));
    server.finish().await;
}

#[tokio::test]
async fn what_is_said_of_a_trial_is_kept_and_leaves_it_out() {
    let server = TestServer::start().await;
    let (lab, trials) = filled(&server).await;
    let trial = &trials[0][1];
    let path = format!("/trials/{trial}/remarks");
    let said = super::start::send(&server, &path, &[("note", "a cough"), ("excluded", "<b>let go</b>")]).await;
    assert_eq!((said.status, said.header("location")), (303, format!("/trials/{trial}").as_str()));
    let seen = page(&server, &format!("/trials/{trial}")).await;
    seen.has("somebody excluded it");
    assert!(
        seen.text.contains("value=\"&lt;b&gt;let go&lt;/b&gt;\"") && seen.text.contains(">a cough<"),
        "{}",
        seen.text
    );
    let stored = server.get(&format!("/v1/trials/{trial}")).await.json(200);
    assert_eq!((&stored["note"], &stored["excluded"]["reason"]), (&json!("a cough"), &json!("<b>let go</b>")));
    page(&server, &format!("/studies/{}", lab.study)).await.has("s01 trial 20 (<b>let go</b>)");
    let said = super::start::send(&server, &path, &[("note", ""), ("excluded", "")]).await;
    assert_eq!(said.status, 303);
    assert_eq!(server.get(&format!("/v1/trials/{trial}")).await.json(200)["excluded"], Value::Null);
    let long = "x".repeat(5000);
    let said = super::start::send(&server, &path, &[("note", ""), ("excluded", &long)]).await;
    assert_eq!(said.status, 422);
    server.finish().await;
}

#[tokio::test]
async fn analyses_are_compared_with_what_was_asked_differently() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trials = [upload(&server, &lab, 1, 1).await, upload(&server, &lab, 1, 20).await];
    let mut ids = Vec::new();
    for (trial, ahead) in [(&trials[0], 0.1), (&trials[1], 0.1), (&trials[1], 0.2)] {
        let spec = json!({"band_hz": [0.02, 0.5], "preview_s": ahead});
        let request = json!({"kind": "prediction_error", "inputs": {"trial": trial}, "spec": spec});
        ids.push(server.post("/v1/analyses", &request).await.id(202));
    }
    server.work().await;
    let same = page(&server, &format!("/compare?a={}&b={}", ids[0], ids[1])).await;
    assert!(!same.words().contains("identified in different ways"));
    same.has("inputs/trial");
    assert!(!same.text.contains("spec/preview_s") && same.text.contains("data-figure=\"overlay\""));
    // The distance fell by far more than its intervals: it stands before what did not.
    let trust = |id: &str| {
        let address = format!("/v1/analyses/{id}/trust");
        let server = &server;
        async move { server.get(&address).await.json(200)["trust"].clone() }
    };
    let of = |trust: &Value| {
        let all = trust.as_array().unwrap();
        let own = all.iter().find(|own| own["quantity"] == "norm_feedforward_plant_minus_one").unwrap();
        [own["interval_95"][0].as_f64().unwrap(), own["interval_95"][1].as_f64().unwrap()]
    };
    let (first, last) = (of(&trust(&ids[0]).await), of(&trust(&ids[1]).await));
    assert!(last[1] < first[0], "{first:?} {last:?}");
    let row = same.text.find("<tr data-differs>").expect("a row that differs");
    assert!(same.text[row..].starts_with("<tr data-differs><th scope=\"row\">norm feed"), "{:.300}", &same.text[row..]);
    let differ = page(&server, &format!("/compare?a={}&b={}&c={}", ids[0], ids[1], ids[2])).await;
    differ.has("These were identified in different ways: a difference may come from the method.");
    differ.has("spec/preview_s");
    for (query, status) in [
        (format!("a={}", ids[0]), 400),
        (format!("a={}&b={}", ids[0], ids[0]), 400),
        (format!("a={}&b=0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10", ids[0]), 404),
    ] {
        assert_eq!(look(&server, "GET", &format!("/compare?{query}"), &[]).await.status, status, "{query}");
    }
    // From the page of the trial, what else was asked of it.
    page(&server, &format!("/trials/{}", trials[1])).await.has("compare prediction_error with the one shown");
    server.finish().await;
}

#[tokio::test]
async fn an_analysis_is_shown_through_its_life() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = upload(&server, &lab, 1, 1).await;
    let request = json!({"kind": "frequency_response", "inputs": {"trial": trial}, "spec": {}});
    let mut ids = Vec::new();
    for _ in 0..3 {
        ids.push(server.post("/v1/analyses", &request).await.id(202));
    }
    let address = |id: &str| format!("/analyses/{id}");
    let waiting = page(&server, &address(&ids[0])).await;
    waiting.has("How far it is");
    assert!(waiting.text.contains(&format!("data-events=\"/v1/analyses/{}/events\"", ids[0])));
    assert!(waiting.text.contains("http-equiv=\"refresh\""), "a browser without script sees it go on too");
    page(&server, "/queue").await.has("Waiting");

    // The first fails, with a problem in all its parts.
    let claim = server.store.claim("test", 60.0).await.unwrap().unwrap();
    assert_eq!(claim.lease.analysis.to_string(), ids[0]);
    let problem = Problem::new(Code::NotIdentifiable, "no power at any line", "the command is <b>flat</b>")
        .at("/inputs/trial")
        .mend("Record a command that moves.");
    assert!(server.store.fail(&claim.lease, &problem).await.unwrap());
    let failed = page(&server, &address(&ids[0])).await;
    let words = failed.words();
    let parts = ["No power at any line", "the command is <b>flat</b>", "Where: /inputs/trial", "What to do: Record a"];
    let places: Vec<usize> =
        parts.iter().map(|part| words.find(part).unwrap_or_else(|| panic!("{part}: {words}"))).collect();
    assert!(places.is_sorted() && !failed.text.contains("<b>flat"), "{places:?} {words}");
    page(&server, "/").await.has("no power at any line");

    // The second is cancelled by its button, which is a form.
    let sent =
        look(&server, "POST", &format!("/analyses/{}/cancel", ids[1]), &[("sec-fetch-site", "same-origin")]).await;
    assert_eq!((sent.status, sent.header("location")), (303, address(&ids[1]).as_str()));
    page(&server, &address(&ids[1])).await.has("Somebody stopped it");
    // Several are cancelled, and asked for again, from the queue.
    let several =
        [server.post("/v1/analyses", &request).await.id(202), server.post("/v1/analyses", &request).await.id(202)];
    let ticked = |verb| [("do", verb), ("id", several[0].as_str()), ("id", several[1].as_str())];
    page(&server, "/queue").await.has("Cancel those that are ticked");
    let sent = super::start::send(&server, "/queue", &ticked("cancel")).await;
    assert_eq!((sent.status, sent.header("location")), (303, "/queue"));
    for id in &several {
        assert_eq!(server.get(&format!("/v1/analyses/{id}")).await.json(200)["status"], "cancelled");
    }
    assert_eq!(super::start::send(&server, "/queue", &[("do", "burn"), ("id", &several[0])]).await.status, 400);
    assert_eq!(super::start::send(&server, "/queue", &[("do", "cancel"), ("id", "7")]).await.status, 400);
    // Asked for again, it is another one with the same request.
    let sent = look(&server, "POST", &format!("/analyses/{}/again", ids[1]), &[]).await;
    let again = sent.header("location").to_owned();
    assert!(sent.status == 303 && again != address(&ids[1]), "{again}");
    let of = |path: String| {
        let server = &server;
        async move { server.get(&format!("/v1{path}")).await.json(200)["request"].clone() }
    };
    assert_eq!(of(again.clone()).await, of(address(&ids[1])).await);

    server.work().await;
    let done = page(&server, &address(&ids[2])).await;
    done.has("What it found");
    done.has("s01, trial 1");
    let report = server.get(&format!("/v1/analyses/{}/report", ids[2])).await.json(200);
    for warning in report["warnings"].as_array().unwrap() {
        done.has(warning["message"].as_str().unwrap());
    }
    done.has("What to do: record more repetitions");
    done.has(&report["provenance"]["result_sha256"].as_str().unwrap()[..8]);
    assert!(!done.text.contains("data-events") && !done.text.contains("http-equiv=\"refresh\""));
    assert!(done.text.contains("data-figure=\"response\""));
    server.finish().await;
}

#[tokio::test]
async fn what_is_not_there_is_said_as_a_page_to_browsers_alone() {
    let server = TestServer::start().await;
    let nobody = "0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10";
    for (path, status, words) in [
        ("/nowhere".to_owned(), 404, "No such route"),
        (format!("/studies/{nobody}"), 404, "No such study"),
        (format!("/subjects/{nobody}"), 404, "No such subject"),
        (format!("/trials/{nobody}"), 404, "No such trial"),
        (format!("/analyses/{nobody}"), 404, "No such analysis"),
        ("/trials/<script>alert(1)</script>".to_owned(), 404, "No such route"),
        ("/trials/7".to_owned(), 400, "Not an id"),
        ("/?colour=red".to_owned(), 400, "Unknown query parameter"),
        ("/a/page.css".to_owned(), 404, "No such file"),
    ] {
        let seen = look(&server, "GET", &path, &[]).await;
        assert_eq!(seen.status, status, "{path}");
        stands_alone(&seen);
        seen.has(words);
        seen.has("What to do:");
        let id = seen.header("x-request-id").to_owned();
        seen.has(&format!("urn:uuid:{id}"));
        // Another program reads the same as a document.
        let other = server.send(server.request("GET", &path)).await;
        let problem: Value = serde_json::from_slice(&other.bytes).unwrap();
        assert_eq!((other.header("content-type"), &problem["status"]), ("application/problem+json", &json!(status)));
    }
    // The interface answers everybody with documents.
    let seen = look(&server, "GET", "/v1/nowhere", &[]).await;
    assert_eq!((seen.status, seen.header("content-type")), (404, "application/problem+json"));
    let seen = look(&server, "DELETE", "/queue", &[]).await;
    assert_eq!((seen.status, seen.header("allow")), (405, "GET,HEAD,POST"));
    server.finish().await;
}
