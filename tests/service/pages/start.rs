//! From a form to an analysis and its figure.

use super::{Seen, page, stands_alone, upload};
use crate::api::harness::TestServer;
use serde_json::json;

/// Sends a form as a browser does.
pub(super) async fn send(server: &TestServer, path: &str, fields: &[(&str, &str)]) -> Seen {
    let client = reqwest::Client::builder().redirect(reqwest::redirect::Policy::none()).build().unwrap();
    let encoded = |text: &str| text.bytes().map(|byte| format!("%{byte:02X}")).collect::<String>();
    let body: Vec<String> = fields.iter().map(|(name, text)| format!("{}={}", encoded(name), encoded(text))).collect();
    let request = client.post(server.url(path)).header("accept", "text/html").body(body.join("&"));
    let answer = request.header("content-type", "application/x-www-form-urlencoded").send().await.unwrap();
    let (status, headers) = (answer.status().as_u16(), answer.headers().clone());
    Seen { status, headers, text: answer.text().await.unwrap() }
}

#[tokio::test]
async fn a_form_from_the_schema_becomes_an_analysis() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = upload(&server, &lab, 1, 1).await;
    let path = format!("/analyses/new?kind=prediction_error&trial={trial}");
    let form = page(&server, &path).await;
    form.has("s01, trial 1");
    for field in ["spec.band_hz", "spec.autoregressive_order", "spec.preview_s"] {
        assert!(form.text.contains(&format!("name=\"{field}\"")), "{field}");
    }
    // A field that holds no number keeps what was written, and says so beside it.
    let wrong = send(&server, &path, &[("spec.band_hz", "low to <b>high"), ("do", "start")]).await;
    stands_alone(&wrong);
    wrong.has("'low to <b>high' is not a number");
    assert!(wrong.text.contains("value=\"low to &lt;b&gt;high\"") && !wrong.text.contains("<b>high"));
    let wrong = send(&server, &path, &[("rest", "[1]"), ("do", "start")]).await;
    wrong.has("it is not an object in braces");
    // What the kind refuses has the place of the interface's own problem.
    let wrong = send(&server, &path, &[("spec.band_hz", "0.5, 0.1"), ("do", "start")]).await;
    let body = json!({"kind": "prediction_error", "inputs": {"trial": trial}, "spec": {"band_hz": [0.5, 0.1]}});
    let problem = server.post("/v1/analyses", &body).await.problem(422, "invalid");
    wrong.has(problem["detail"].as_str().unwrap());
    wrong.has(&format!("Where: {}", problem["where"].as_str().unwrap()));
    assert_eq!(server.census().await[4], 0, "nothing was queued");
    // Checked, it shows what is sent; started, it is that.
    let fields = [("spec.band_hz", "0.02, 0.5"), ("spec.autoregressive_order", "2")];
    let checked = send(&server, &path, &[&fields[..], &[("do", "check")]].concat()).await;
    checked.has("It is in order");
    let spec = json!({"band_hz": [0.02, 0.5], "autoregressive_order": 2});
    checked.has(&json!({"kind": "prediction_error", "inputs": {"trial": trial}, "spec": spec}).to_string());
    let started = send(&server, &path, &[&fields[..], &[("do", "start")]].concat()).await;
    assert_eq!(started.status, 303, "{}", started.text);
    let place = started.header("location").to_owned();
    let made = server.get(&format!("/v1{place}")).await.json(200);
    assert_eq!(
        (&made["request"]["spec"]["band_hz"], &made["request"]["spec"]["autoregressive_order"]),
        (&json!([0.02, 0.5]), &json!(2))
    );
    server.work().await;
    let done = page(&server, &place).await;
    assert!(done.text.contains("data-figure=\"bode\""), "{}", done.words());
    // One for every trial of the study.
    upload(&server, &lab, 1, 20).await;
    let form = format!("/analyses/new?kind=frequency_response&study={}", lab.study);
    let started = send(&server, &form, &[("do", "start")]).await;
    assert_eq!(started.header("location"), "/queue");
    server.work().await;
    assert_eq!(server.census().await[4], 3);
    server.finish().await;
}
