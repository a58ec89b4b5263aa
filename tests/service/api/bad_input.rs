//! Whatever is wrong with a request, the answer says what, where and how to mend it, and nothing is stored.

use crate::api::harness::{Lab, TestServer, gzip, recording};
use serde_json::{Value, json};

/// A JSON body that is refused: path, body, status, code, where.
type Refusal = (&'static str, Value, u16, &'static str, &'static str);

async fn path(lab: &Lab, template: &str) -> String {
    template.replace("{study}", &lab.study).replace("{subject}", &lab.subject).replace("{plant}", &lab.plant)
}

#[tokio::test]
async fn json_bodies() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let census = server.census().await;
    let study = "/v1/studies";
    let plants = "/v1/studies/{study}/plants";
    let subjects = "/v1/studies/{study}/subjects";
    let trials = "/v1/subjects/{subject}/trials?plant={plant}";
    let refusals: Vec<Refusal> = vec![
        (study, json!({}), 422, "invalid", "/name"),
        (study, json!([]), 422, "invalid", "/"),
        (study, json!(["a"]), 422, "invalid", "/"),
        (study, json!({"name": 7}), 422, "invalid", "/name"),
        (study, json!({"name": null}), 422, "invalid", "/name"),
        (study, json!({"name": ""}), 422, "invalid", "/name"),
        (study, json!({"name": " \u{a0} "}), 422, "invalid", "/name"),
        (study, json!({"name": "a\u{7}b"}), 422, "invalid", "/name"),
        (study, json!({"name": "x".repeat(201)}), 422, "invalid", "/name"),
        (study, json!({"name": "a", "nmae": "b"}), 422, "invalid", "/nmae"),
        (study, json!({"name": "a", "description": null}), 422, "invalid", "/description"),
        (study, json!({"name": "a", "description": "x".repeat(20_001)}), 422, "invalid", "/description"),
        (study, json!({"name": "a", "display_limit": 0}), 422, "invalid", "/display_limit"),
        (study, json!({"name": "a", "display_limit": -5.0}), 422, "invalid", "/display_limit"),
        (study, json!({"name": "a", "display_limit": "5"}), 422, "invalid", "/display_limit"),
        (plants, json!({"name": "a"}), 422, "invalid", "/model"),
        (plants, json!({"name": "a", "model": {}}), 422, "invalid", "/model"),
        (plants, json!({"name": "a", "model": [1, 2]}), 422, "invalid", "/model"),
        (plants, json!({"name": "a", "model": {"num": [1]}}), 422, "invalid", "/model/den"),
        (plants, json!({"name": "a", "model": {"num": [1], "den": [1, "s"]}}), 422, "invalid", "/model/den/1"),
        (plants, json!({"name": "a", "model": {"num": [1], "den": [0, 0]}}), 422, "invalid", "/model"),
        (plants, json!({"name": "a", "model": {"num": [], "den": [1]}}), 422, "invalid", "/model"),
        (plants, json!({"name": "a", "model": {"num": [1], "den": [1], "dt": 1}}), 422, "invalid", "/model/dt"),
        (
            plants,
            json!({"name": "a", "model": {"num": [1], "den": [1, 1], "sample_time_s": 0}}),
            422,
            "invalid",
            "/model",
        ),
        (plants, json!({"name": "a", "model": {"num": [1], "den": [1], "a": [[1]]}}), 422, "invalid", "/model"),
        (
            plants,
            json!({"name": "a", "model": {"a": [[1, 2]], "b": [[1]], "c": [[1]], "d": [[0]]}}),
            422,
            "invalid",
            "/model",
        ),
        (
            plants,
            json!({"name": "a", "model": {"a": [[1]], "b": [[1]], "c": [[1]], "d": [[0], [0]]}}),
            422,
            "invalid",
            "/model",
        ),
        (subjects, json!({"code": "s01"}), 409, "conflict", ""),
        (subjects, json!({"code": "\t"}), 422, "invalid", "/code"),
        (subjects, json!({"code": "a", "group": ""}), 422, "invalid", "/group"),
        (subjects, json!({"code": "a", "attributes": []}), 422, "invalid", "/attributes"),
        (subjects, json!({"code": "a", "attributes": null}), 422, "invalid", "/attributes"),
        (subjects, json!({"code": "a", "attributes": {"x": "y".repeat(65_536)}}), 422, "invalid", "/attributes"),
        (trials, json!({"sample_time_s": 0.1, "r": [1, 2], "u": [1, 2]}), 400, "malformed", ""),
        (trials, json!({"sample_time_s": 0.1, "r": [1, 2], "u": [1, 2], "y": [1]}), 422, "bad_signal", "/r"),
        (trials, json!({"sample_time_s": 0.1, "r": [1, null], "u": [1, 2], "y": [1, 2]}), 422, "bad_signal", "/r/1"),
        (trials, json!({"sample_time_s": 0.1, "r": [1, "2"], "u": [1, 2], "y": [1, 2]}), 422, "bad_signal", "/r/1"),
        (
            trials,
            json!({"sample_time_s": 0, "r": [1, 2], "u": [1, 2], "y": [1, 2]}),
            422,
            "bad_signal",
            "/sample_time_s",
        ),
        (trials, json!({"r": [1, 2], "u": [1, 2], "y": [1, 2]}), 422, "bad_signal", ""),
        (trials, json!({"sample_time_s": 1, "r": [1, 2], "u": [1, 2], "y": [1, 2], "v": []}), 400, "malformed", "/v"),
        (trials, json!({"sample_time_s": 1, "r": [], "u": [], "y": []}), 422, "bad_signal", ""),
        (
            "/v1/subjects/{subject}/trials?plant={plant}&columns=r:target",
            json!({"sample_time_s": 1, "r": [1, 2], "u": [1, 2], "y": [1, 2]}),
            400,
            "malformed",
            "query parameter columns",
        ),
        (
            "/v1/subjects/{subject}/trials",
            json!({"sample_time_s": 1, "r": [1, 2], "u": [1, 2], "y": [1, 2]}),
            400,
            "malformed",
            "query parameter plant",
        ),
        (
            "/v1/subjects/{subject}/trials?plant=0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10",
            json!({"sample_time_s": 1, "r": [1, 2], "u": [1, 2], "y": [1, 2]}),
            422,
            "invalid",
            "query parameter plant",
        ),
    ];
    for (template, body, status, code, place) in refusals {
        let answer = server.post(&path(&lab, template).await, &body).await;
        let problem = answer.problem(status, code);
        assert_eq!(problem.get("where").and_then(Value::as_str).unwrap_or_default(), place, "{body} → {problem}");
    }
    assert_eq!(server.census().await, census);
    server.finish().await;
}

#[tokio::test]
async fn broken_bodies() {
    let server = TestServer::start().await;
    let send = |media: &'static str, body: &'static str| {
        server.request("POST", "/v1/studies").header("content-type", media).body(body)
    };
    for (body, place) in [
        ("", "body"),
        ("{\"name\": \"a\"", "body, line 1, column 12"),
        ("{\"name\": \"a\"} x", "body, line 1, column 15"),
        ("{\"name\": \"a\", \"display_limit\": NaN}", "body, line 1, column 32"),
        ("{\"name\": \"a\", \"display_limit\": 1e400}", "body, line 1, column 36"),
        ("{\"name\": \"\\ud800\"}", "body, line 1, column 17"),
        ("name=a", "body, line 1, column 2"),
    ] {
        let problem = server.send(send("application/json", body)).await.problem(400, "malformed");
        assert_eq!(problem["where"], place, "{body} → {problem}");
    }
    let latin = server
        .request("POST", "/v1/studies")
        .header("content-type", "application/json")
        .body(b"{\"name\": \"\xe4\"}".to_vec());
    server.send(latin).await.problem(400, "malformed");
    let deep = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
    let deep = server.request("POST", "/v1/studies").header("content-type", "application/json").body(deep);
    assert!(server.send(deep).await.status.is_client_error());
    for media in ["text/plain", "application/xml", "application/jsonx", "multipart/form-data; boundary=x"] {
        let problem = server.send(send(media, "{\"name\": \"a\"}")).await.problem(415, "unsupported_media_type");
        assert_eq!(problem["where"], "header Content-Type", "{media}");
    }
    let untyped = server.send(server.request("POST", "/v1/studies").body("{\"name\": \"a\"}")).await;
    untyped.problem(415, "unsupported_media_type");
    let packed = server.request("POST", "/v1/studies").header("content-encoding", "br").json(&json!({"name": "a"}));
    assert_eq!(server.send(packed).await.problem(415, "unsupported_media_type")["where"], "header Content-Encoding");
    assert_eq!(server.census().await[0], 0);
    server.finish().await;
}

#[tokio::test]
async fn recordings() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let rows = |n: usize, row: &dyn Fn(usize) -> String| -> String {
        (0..n).fold("t,r,u,y\n".to_owned(), |text, i| text + &row(i) + "\n")
    };
    let good = |i: usize| format!("{},1,1,{i}", i as f64 * 0.1);
    let with = |at: usize, bad: &'static str| rows(12, &|i| if i == at { bad.to_owned() } else { good(i) });
    let cases: Vec<(String, u16, &str, &str, &str)> = vec![
        (String::new(), 400, "malformed", "", "empty"),
        ("t,r,u,y\n".into(), 400, "malformed", "", "no row"),
        ("0,1,1,1\n0.1,1,1,1\n".into(), 400, "malformed", "row 1", "does not name"),
        ("t;r;u;y\n0;1;1;1\n".into(), 422, "bad_signal", "", "1 samples"),
        ("time,target,stick,cursor\n0,1,1,1\n1,1,1,1\n".into(), 400, "malformed", "row 1", "\"target\""),
        ("t,r,u\n0,1,1\n".into(), 400, "malformed", "row 1", "\"y\""),
        ("t,r,u,y,y\n0,1,1,1,1\n".into(), 400, "malformed", "column y", "both named"),
        ("r,u,y\n1,1,1\n1,1,1\n".into(), 422, "bad_signal", "", "sample time"),
        (with(5, "0.5,1,NaN,1"), 422, "bad_signal", "row 7, column u", "NaN"),
        (with(5, "0.5,1,1,inf"), 422, "bad_signal", "row 7, column y", "inf"),
        (with(5, "0.5,1,1,1e999"), 422, "bad_signal", "row 7, column y", "1e999"),
        (with(5, "0.5,left,1,1"), 422, "bad_signal", "row 7, column r", "left"),
        (with(5, "0.5,,1,1"), 422, "bad_signal", "row 7, column r", "empty"),
        (with(5, "0.5,1,1"), 400, "malformed", "row 7", "3 cells"),
        (with(5, ""), 400, "malformed", "row 7", "empty"),
        (with(5, "0.4,1,1,1"), 422, "bad_signal", "row 7, column t", "twice"),
        (with(5, "0.3,1,1,1"), 422, "bad_signal", "row 7, column t", "backwards"),
        (with(5, "0.55,1,1,1"), 422, "bad_signal", "row 7, column t", "off the uniform grid"),
        (
            rows(12, &|i| good(if i < 6 { i } else { i + 3 })),
            422,
            "bad_signal",
            "row 8, column t",
            "3 samples are missing",
        ),
        (rows(1, &good), 422, "bad_signal", "", "1 samples"),
    ];
    for (csv, status, code, place, words) in cases {
        let problem = server.upload_csv(&lab, "&number=1", csv.clone()).await.problem(status, code);
        assert_eq!(problem.get("where").and_then(Value::as_str).unwrap_or_default(), place, "{csv} → {problem}");
        assert!(problem["detail"].as_str().unwrap().contains(words), "{csv} → {problem}");
        assert!(problem["mend"].is_string(), "{problem}");
    }
    let given = server.upload_csv(&lab, "&sample_time_s=0.2", recording(20, 1.0)).await.problem(422, "bad_signal");
    assert!(given["detail"].as_str().unwrap().contains("0.2"), "{given}");

    let whole = gzip(recording(200, 1.0).as_bytes());
    let path = format!("/v1/subjects/{}/trials?plant={}", lab.subject, lab.plant);
    let mut corrupt = whole.clone();
    let middle = corrupt.len() / 2;
    corrupt[middle] ^= 0xff;
    let packed: [(&[u8], &str); 5] = [
        (b"", "empty"),
        (&whole[..whole.len() / 2], "truncated"),
        (b"t,r,u,y\n0,1,1,1\n", "gzip header"),
        (&corrupt, ""),
        (&[whole.as_slice(), b"tail"].concat(), "follow"),
    ];
    for (bytes, words) in packed {
        let request =
            server.request("POST", &path).header("content-type", "text/csv").header("content-encoding", "gzip");
        let answer = server.send(request.body(bytes.to_vec())).await;
        assert!(answer.status.is_client_error(), "{}", answer.text());
        let problem = answer.problem(
            answer.status.as_u16(),
            serde_json::from_slice::<Value>(&answer.bytes).unwrap()["code"].as_str().unwrap(),
        );
        assert!(problem["detail"].as_str().unwrap().contains(words), "{problem}");
    }
    assert_eq!(server.census().await[3], 0, "nothing was stored");
    server.finish().await;
}

#[tokio::test]
async fn a_plant_of_several_inputs_takes_no_trials() {
    let server = TestServer::start().await;
    let mut lab = server.lab().await;
    let model = json!({"a": [[-1.0]], "b": [[1.0, 2.0]], "c": [[1.0]], "d": [[0.0, 0.0]]});
    let body = json!({"name": "two inputs", "model": model});
    lab.plant = server.post(&format!("/v1/studies/{}/plants", lab.study), &body).await.id(201);
    let problem = server.upload_csv(&lab, "&number=1", recording(8, 1.0)).await.problem(422, "invalid");
    assert_eq!(problem["where"], "query parameter plant");
    server.finish().await;
}

#[tokio::test]
async fn queries_and_paths() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trials = format!("/v1/subjects/{}/trials", lab.subject);
    let responses = format!("/v1/studies/{}/frequency-responses", lab.study);
    let curves = format!("/v1/studies/{}/learning-curves", lab.study);
    for (path, place) in [
        ("/v1/studies/7".to_owned(), "path parameter study"),
        ("/v1/studies/%FF".to_owned(), "path"),
        ("/v1/trials/0199d2f47a3c7bb08a412f6a7e1c9d10".to_owned(), "path parameter trial"),
        ("/v1/analyses/{x}".to_owned(), "path parameter analysis"),
        ("/v1/studies?limit=0".to_owned(), "query parameter limit"),
        ("/v1/studies?limit=501".to_owned(), "query parameter limit"),
        ("/v1/studies?limit=1e2".to_owned(), "query parameter limit"),
        ("/v1/studies?cursor=abc".to_owned(), "query parameter cursor"),
        ("/v1/studies?limit=1&limit=2".to_owned(), "query parameter limit"),
        ("/v1/studies?offset=3".to_owned(), "query parameter offset"),
        (format!("/v1/studies/{}?verbose=1", lab.study), "query parameter verbose"),
        ("/v1/analyses?kind=sisd".to_owned(), "query parameter kind"),
        ("/v1/analyses?status=done".to_owned(), "query parameter status"),
        ("/v1/analyses?study=x".to_owned(), "query parameter study"),
        (format!("{trials}?number=3"), "query parameter number"),
        (format!("{curves}?include_divergent=yes"), "query parameter include_divergent"),
        (format!("{curves}?spec=abc"), "query parameter spec"),
        (format!("{curves}?trim=-1"), "query parameter trim"),
        (format!("/v1/studies/{}/progress?kind=sisd", lab.study), "query parameter kind"),
        (format!("/v1/studies/{}/progress?spec=abc", lab.study), "query parameter spec"),
        (format!("/v1/studies/{}/progress?status=queued", lab.study), "query parameter status"),
        (format!("{responses}?trial=zeroth"), "query parameter trial"),
        (format!("{responses}?trial=0"), "query parameter trial"),
        (format!("{responses}?omega_from_rad_s=-1"), "query parameter omega_from_rad_s"),
        (format!("{responses}?omega_to_rad_s=inf"), "query parameter omega_to_rad_s"),
        (format!("{responses}?points=0"), "query parameter points"),
        ("/healthz?x=1".to_owned(), "query parameter x"),
    ] {
        let problem = server.get(&path).await.problem(400, "malformed");
        assert_eq!(problem["where"], place, "{path} → {problem}");
    }
    for (query, place) in [
        ("&number=0", "query parameter number"),
        ("&number=1.5", "query parameter number"),
        ("&session=-1", "query parameter session"),
        ("&sample_time_s=0", "query parameter sample_time_s"),
        ("&sample_time_s=NaN", "query parameter sample_time_s"),
        ("&columns=speed:v", "query parameter columns"),
        ("&nmber=1", "query parameter nmber"),
    ] {
        let problem = server.upload_csv(&lab, query, recording(8, 1.0)).await.problem(400, "malformed");
        assert_eq!(problem["where"], place, "{query}");
    }
    let nobody = "0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10";
    for (path, place) in [
        (format!("{curves}?plant={nobody}"), Some("query parameter plant")),
        (format!("{curves}?spec={}", "0".repeat(64)), Some("query parameter spec")),
        (format!("/v1/subjects/{nobody}/learning-curves"), None),
        (format!("/v1/studies/{nobody}/progress"), None),
        (format!("/v1/analyses/{nobody}/events"), None),
        (format!("/v1/analyses/{nobody}/report"), None),
    ] {
        let problem = server.get(&path).await.problem(404, "not_found");
        assert_eq!(problem.get("where").and_then(Value::as_str), place, "{path}");
    }
    let grid = server.get(&format!("{responses}?omega_from_rad_s=2&omega_to_rad_s=1")).await.problem(422, "invalid");
    assert_eq!(grid["where"], "query parameter omega_from_rad_s");
    assert_eq!(server.census().await[3], 0);
    server.finish().await;
}
