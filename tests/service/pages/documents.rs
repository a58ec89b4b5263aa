//! Groups compared, a report in one file, an excitation designed.

use super::{filled, look, page, upload};
use crate::api::harness::{Lab, TestServer};
use serde_json::json;

#[tokio::test]
async fn groups_are_compared_with_the_numbers_of_the_interface() {
    let server = TestServer::start().await;
    let (lab, _) = filled(&server).await;
    for (seed, code) in [(4, "n01"), (5, "n02"), (6, "n03")] {
        let body = json!({"code": code, "group": "gn"});
        let subject = server.post(&format!("/v1/studies/{}/subjects", lab.study), &body).await.id(201);
        let own = Lab { subject, study: lab.study.clone(), plant: lab.plant.clone() };
        upload(&server, &own, seed, 1).await;
        upload(&server, &own, seed, 20).await;
    }
    let path = format!("/v1/studies/{}/comparison?estimator=prediction_error&curve=trials", lab.study);
    let numbers = server.get(&path).await.json(200);
    let seen = page(&server, &format!("/compare?study={}&curve=trials", lab.study)).await;
    for finding in numbers["findings"].as_array().unwrap() {
        seen.has(finding.as_str().unwrap().split_whitespace().collect::<Vec<_>>().join(" ").as_str());
    }
    seen.has("gn on gm less gm on gm");
    seen.has("mean |r − y| on the last trial");
    assert_eq!(seen.text.matches("data-figure=\"mean_abs_error\"").count(), 2);
    assert!(seen.text.contains(&format!("{path}\"").replace('&', "&amp;")), "the numbers are linked");
    let one = page(&server, &format!("/compare?study={}&groups=gn", lab.study)).await;
    one.has("1 group of gm and gn · 3 people");
    assert_eq!(look(&server, "GET", "/compare", &[]).await.status, 400);
    assert_eq!(look(&server, "GET", &format!("/compare?study={}&groups=nobody", lab.study), &[]).await.status, 404);
    let empty = server.study().await;
    page(&server, &format!("/compare?study={empty}")).await.has("Nobody to compare");
    server.finish().await;
}

#[tokio::test]
async fn a_report_is_one_file_that_needs_nothing() {
    let server = TestServer::start().await;
    let (lab, _) = filled(&server).await;
    let evil = json!({"name": "<script>alert(1)</script>", "description": "</style><img src=x>"});
    server.patch(&format!("/v1/studies/{}", lab.study), &evil).await;
    let shown = page(&server, &format!("/studies/{}/report", lab.study)).await;
    shown.has("Who learned what");
    let file = look(&server, "GET", &format!("/studies/{}/report.html", lab.study), &[]).await;
    assert_eq!((file.status, file.header("content-type")), (200, "text/html; charset=utf-8"));
    assert!(file.header("content-disposition").starts_with("attachment; filename=\"report-"));
    assert_eq!(file.header("content-security-policy"), "default-src 'none'; style-src 'unsafe-inline'");
    assert!(!file.text.contains("<script") && !file.text.contains("<img") && !file.text.contains("src=\"http"));
    assert_eq!(file.text.matches("<style>").count(), 1);
    assert_eq!(file.text.matches("</style>").count(), 1);
    // Figures are inside, once each, and the same numbers as on the page of the study.
    for figure in ["mean_abs_error", "norm_feedforward_plant_minus_one", "norm_feedback"] {
        assert_eq!(file.text.matches(&format!("data-figure=\"{figure}\"")).count(), 1, "{figure}");
    }
    let sentence = "from trial 1 to trial 20 the tracking error fell from";
    file.has(sentence);
    page(&server, &format!("/studies/{}", lab.study)).await.has(sentence);
    file.has("Knapp, Hartung");
    let empty = server.study().await;
    page(&server, &format!("/studies/{empty}/report")).await.has("0 trials");
    server.finish().await;
}

#[tokio::test]
async fn an_excitation_is_designed_beside_its_figures() {
    let server = TestServer::start().await;
    for kind in ["prts", "prbs", "multisine", "chirp", "filtered_noise"] {
        let seen = page(&server, &format!("/excitation?kind={kind}")).await;
        assert!(seen.text.contains("data-figure=\"signal\""), "{kind}: {}", seen.words());
        assert!(seen.text.contains("data-figure=\"spectrum\""), "{kind}");
        seen.has("\"include_samples\": true");
    }
    // A sequence of 3³ − 1 chips of 0.1 s at 100 Hz has 260 samples, and so has the file for the device.
    let query = "/excitation?kind=prts&order=3&chip_s=0.1&sample_time_s=0.01&peak=2&band_hz=2";
    let seen = page(&server, query).await;
    let file = look(&server, "GET", &format!("{query}&format=csv"), &[]).await;
    assert!(file.header("content-disposition").contains("excitation.csv"));
    assert_eq!(file.text.lines().count(), 261);
    let peak = file.text.lines().skip(1).map(|line| line.split(',').nth(1).unwrap().parse::<f64>().unwrap().abs());
    assert_eq!(peak.fold(0.0, f64::max), 2.0);
    // MATLAB and NumPy read the same samples, and limits of the device are held against them.
    for (form, begin) in [("mat", "MATLAB 5.0 MAT-file"), ("npz", "PK\u{3}\u{4}")] {
        let answer = look(&server, "GET", &format!("{query}&format={form}"), &[]).await;
        assert_eq!(answer.status, 200, "{form}");
        assert!(answer.header("content-disposition").contains(&format!("excitation.{form}")));
        assert!(answer.text.starts_with(begin), "{form}");
    }
    let limited = page(&server, &format!("{query}&position=1.5&velocity=1e9")).await;
    limited.has("✕ above the limit position reaches 2.00 of 1.50");
    limited.has("✓ within the limit velocity (per s) reaches");
    assert!(limited.text.contains("class=\"f-limit\""), "the limit is a line of the figure");
    // What is shown is what the interface answers to the request that is shown.
    let text = seen.text.split("<pre tabindex=\"0\"><code>").nth(1).unwrap().split("</code>").next().unwrap();
    let request: serde_json::Value = serde_json::from_str(&text.replace("&quot;", "\"")).unwrap();
    let id = server.post("/v1/analyses", &request).await.id(202);
    server.work().await;
    let report = server.get(&format!("/v1/analyses/{id}/report")).await.json(200);
    assert_eq!(report["result"]["signal"]["samples"], 260);
    for (field, text, said) in [
        ("order", "1", "order"),
        ("chip_s", "<b>", "'<b>' is no number"),
        ("sample_time_s", "1e-9", "are drawn while you wait"),
        ("chip_s", "", "chip s is needed"),
    ] {
        let seen =
            page(&server, &format!("/excitation?kind=prts&{field}={}", text.replace('<', "%3C").replace('>', "%3E")))
                .await;
        seen.has(said);
        assert!(seen.text.contains("role=\"alert\"") && !seen.text.contains("<b>\""), "{field}");
    }
    server.finish().await;
}
