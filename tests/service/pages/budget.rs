//! What pages may weigh.

use super::{page, upload};
use crate::api::harness::{Lab, TestServer, gzip};
use serde_json::json;
use volition::analysis::Report;

/// People, and trials of each: 440 in all, with three kinds of analysis.
const PEOPLE: usize = 11;
const TRIALS: usize = 40;

/// Bytes of a study's page as they come over the wire.
const MOST_PACKED: usize = 150_000;

/// Bytes of a study's report, as a file.
const MOST_REPORT: usize = 2_000_000;

/// One of the analyses of a study that succeeded.
async fn report_of(server: &TestServer, study: &str) -> String {
    let list = server.get(&format!("/v1/analyses?study={study}&status=succeeded&limit=1")).await.json(200);
    list["items"][0]["id"].as_str().unwrap().to_owned()
}

/// Reports of one trial stand in for those of all others: what they weigh is the same.
#[tokio::test]
async fn the_page_of_a_large_study_is_small() {
    let server = TestServer::start().await;
    let mut lab = server.lab().await;
    let first = upload(&server, &lab, 1, 1).await;
    for person in 0..PEOPLE {
        if person > 0 {
            let group = if person % 2 == 0 { "gm" } else { "gn" };
            let body = json!({"code": format!("s{:02}", person + 1), "group": group});
            let subject = server.post(&format!("/v1/studies/{}/subjects", lab.study), &body).await.id(201);
            lab = Lab { subject, ..lab };
        }
        for number in 1..=TRIALS {
            if person > 0 || number > 1 {
                let csv = crate::api::harness::recording(64, (person * TRIALS + number) as f64);
                server.upload_csv(&lab, &format!("&number={number}"), csv).await.id(201);
            }
        }
    }
    let thin = json!({"poles": 12, "zeros": 12, "damping": 4, "gains": 6});
    let specs = [
        ("ssid", json!({"pool": {"name": "zhang2015_appendix_c", "thin": thin}})),
        ("frequency_response", json!({})),
        ("prediction_error", json!({"band_hz": [0.02, 0.5]})),
    ];
    for (kind, spec) in specs {
        let body = json!({"kind": kind, "inputs": {"trial": first}, "spec": spec});
        let own = server.post("/v1/analyses", &body).await.id(202);
        server.work().await;
        let report = server.get(&format!("/v1/analyses/{own}/report")).await.json(200);
        let report: Report = serde_json::from_value(report).unwrap();
        let body = json!({"kind": kind, "spec": spec, "only": "all"});
        let run = server.post(&format!("/v1/studies/{}/analyses", lab.study), &body).await.json(202);
        assert_eq!(run["created"], PEOPLE * TRIALS);
        while let Some(claim) = server.store.claim("test", 60.0).await.unwrap() {
            assert!(server.store.succeed(&claim.lease, &report).await.unwrap());
        }
    }
    let began = std::time::Instant::now();
    let seen = page(&server, &format!("/studies/{}", lab.study)).await;
    let packed = gzip(seen.text.as_bytes()).len();
    eprintln!(
        "{PEOPLE} × {TRIALS} trials, three kinds: {} bytes, {packed} packed, {:.2} s",
        seen.text.len(),
        began.elapsed().as_secs_f64()
    );
    assert!(packed <= MOST_PACKED, "{packed} bytes");
    // None of this was read from a report: with all of them damaged it is the same, and so are the curves.
    let curves = format!("/v1/studies/{}/learning-curves?estimator=prediction_error", lab.study);
    let before = server.get(&curves).await;
    server.meddle("UPDATE analyses SET report = 'damaged' WHERE report IS NOT NULL").await;
    let own = &report_of(&server, &lab.study).await;
    assert_eq!(server.get(&format!("/v1/analyses/{own}/report")).await.status.as_u16(), 500, "a report is damaged");
    let damaged = page(&server, &format!("/studies/{}", lab.study)).await;
    assert_eq!(damaged.header("etag"), seen.header("etag"), "the page of a study reads reports");
    assert_eq!(server.get(&curves).await.bytes, before.bytes, "curves read reports");
    let file = page(&server, &format!("/studies/{}/report", lab.study)).await;
    assert!(file.text.len() <= MOST_REPORT, "{} bytes of report", file.text.len());
    assert_eq!(seen.text.matches("class=\"cell ").count(), PEOPLE * TRIALS);
    page(&server, "/").await.has("440/440");
    server.finish().await;
}
