//! What surrounds the routes: hosts, methods, health, metrics, documentation.

use crate::api::harness::TestServer;
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use volition::api::Limits;

#[tokio::test]
async fn unknown_routes_and_methods_are_problems() {
    let server = TestServer::start().await;
    let lost = server.get("/v2/studies").await.problem(404, "not_found");
    assert!(lost["mend"].as_str().unwrap().contains("/openapi.json"));
    let moved = reqwest::Client::builder().redirect(reqwest::redirect::Policy::none()).build().unwrap();
    for (method, path, to) in [
        ("GET", "/v1/studies/?limit=3", "/v1/studies?limit=3"),
        ("POST", "/v1/analyses//", "/v1/analyses"),
        ("GET", "/v1/", "/v1"),
    ] {
        let method = reqwest::Method::from_bytes(method.as_bytes()).unwrap();
        let answer = moved.request(method, server.url(path)).send().await.unwrap();
        assert_eq!((answer.status().as_u16(), &answer.headers()["location"]), (308, &to.parse().unwrap()), "{path}");
    }
    let answer = moved.get(server.url("//lab.example/")).send().await.unwrap();
    assert_eq!(answer.status().as_u16(), 404, "no address leads to another host");
    let refused = server.send(server.request("PUT", "/v1/studies")).await;
    refused.problem(405, "method_not_allowed");
    let mut allowed: Vec<&str> = refused.header("allow").split(',').collect();
    allowed.sort_unstable();
    assert_eq!(allowed, ["GET", "HEAD", "POST"]);
    let head = server.send(server.request("HEAD", "/v1/studies")).await;
    assert_eq!((head.status.as_u16(), head.bytes.len()), (200, 0));
    server.finish().await;
}

#[tokio::test]
async fn foreign_hosts_and_origins_are_refused() {
    let server = TestServer::start().await;
    let port = server.address.port();
    for host in [format!("localhost:{port}"), "127.0.0.1".into(), format!("[::1]:{port}")] {
        let request = server.request("GET", "/healthz").header("host", &host);
        assert_eq!(server.send(request).await.status, 200, "{host}");
    }
    for host in ["lab.example", "127.0.0.1.lab.example:80", "192.168.1.7"] {
        let request = server.request("GET", "/v1/studies").header("host", host);
        assert_eq!(server.send(request).await.problem(421, "malformed")["where"], "header Host", "{host}");
    }
    for origin in ["https://lab.example", "null"] {
        let request = server.request("POST", "/v1/studies").header("origin", origin).json(&json!({"name": "x"}));
        assert_eq!(server.send(request).await.problem(421, "malformed")["where"], "header Origin", "{origin}");
    }
    let own = server.request("POST", "/v1/studies").header("origin", format!("http://localhost:{port}"));
    server.send(own.json(&json!({"name": "x"}))).await.json(201);
    assert_eq!(server.census().await[0], 1);
    server.finish().await;
}

#[tokio::test]
async fn the_index_names_every_route_and_every_limit() {
    let server = TestServer::start_with(Limits { max_rows: 1234, ..Limits::default() }).await;
    let index = server.get("/v1").await.json(200);
    let document: serde_json::Value = serde_json::from_str(&volition::api::document()).unwrap();
    let named: Vec<&str> =
        index["resources"].as_array().unwrap().iter().map(|own| own["path"].as_str().unwrap()).collect();
    let documented: Vec<&String> = document["paths"].as_object().unwrap().keys().collect();
    assert_eq!(named.len(), documented.len());
    assert!(documented.iter().all(|path| named.contains(&path.as_str())));
    let studies = index["resources"].as_array().unwrap().iter().find(|own| own["path"] == "/v1/studies").unwrap();
    assert_eq!(studies["methods"][1], json!({"method": "POST", "does": "Makes a study."}));
    let limits = &index["limits"];
    assert_eq!(
        (&limits["trial_samples"], &limits["page_rows"], &limits["wait_s"]),
        (&json!(1234), &json!(500), &json!(60.0))
    );
    for link in ["openapi", "docs", "kinds", "studies"] {
        assert_eq!(server.get(index["links"][link].as_str().unwrap()).await.status, 200, "{link}");
    }
    server.finish().await;
}

#[tokio::test]
async fn pages_of_named_origins_may_ask_and_read() {
    let lab = "https://lab.example";
    let server = TestServer::start_for(Limits::default(), &[lab]).await;
    let asked = server
        .request("OPTIONS", "/v1/studies")
        .header("origin", lab)
        .header("access-control-request-method", "POST")
        .header("access-control-request-headers", "content-type, idempotency-key, prefer");
    let allowed = server.send(asked).await;
    assert_eq!((allowed.status.as_u16(), allowed.header("access-control-allow-origin")), (200, lab));
    assert!(allowed.header("access-control-allow-methods").contains("PATCH"));
    assert!(allowed.header("access-control-allow-headers").contains("idempotency-key"));
    let made = server.request("POST", "/v1/studies").header("origin", lab).json(&json!({"name": "from a page"}));
    let made = server.send(made).await;
    made.json(201);
    assert_eq!(made.header("access-control-allow-origin"), lab);
    assert!(made.header("access-control-expose-headers").contains("etag"));
    // What is wrong can be read too.
    let wrong = server.send(server.request("GET", "/v1/studies?x=1").header("origin", lab)).await;
    wrong.problem(400, "malformed");
    assert_eq!(wrong.header("access-control-allow-origin"), lab);
    let other = server.send(server.request("GET", "/v1/studies").header("origin", "https://evil.example")).await;
    other.problem(421, "malformed");
    server.finish().await;
    // Nobody was named: a page of this machine may ask, as before, and its browser shows it nothing.
    let server = TestServer::start().await;
    let own = server.send(server.request("GET", "/v1/studies").header("origin", "http://localhost:3000")).await;
    assert!(own.status == 200 && !own.headers.contains_key("access-control-allow-origin"));
    let refused = server.send(server.request("OPTIONS", "/v1/studies").header("origin", lab)).await;
    refused.problem(421, "malformed");
    server.finish().await;
}

#[tokio::test]
async fn what_cannot_be_accepted_is_refused_before_anything_is_done() {
    let server = TestServer::start().await;
    let study = server.study().await;
    for (method, path) in [
        ("POST", "/v1/studies".to_owned()),
        ("GET", "/v1/studies".to_owned()),
        ("GET", "/v1".to_owned()),
        ("GET", format!("/v1/studies/{study}/learning-curves")),
        ("GET", "/metrics".to_owned()),
        ("GET", format!("/v1/studies/{study}/figures/mean_abs_error")),
    ] {
        let request = server.request(method, &path).header("accept", "application/pdf").json(&json!({"name": "x"}));
        let refused = server.send(request).await.problem(406, "not_acceptable");
        assert_eq!(refused["where"], "header Accept", "{path}");
    }
    assert_eq!(server.census().await[0], 1, "the refused creation made nothing");
    for accept in ["*/*", "application/*", "text/html;q=0.9, application/json;q=0.1"] {
        let read = server.request("GET", &format!("/v1/studies/{study}")).header("accept", accept);
        server.send(read).await.json(200);
    }
    let gone = server.request("DELETE", &format!("/v1/studies/{study}")).header("accept", "image/png");
    assert_eq!(server.send(gone).await.status, 204, "an answer without a body has no type");
    server.finish().await;
}

#[tokio::test]
async fn large_answers_are_packed_for_whoever_takes_that() {
    use std::io::Read as _;
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = server.trial(&lab, 1).await;
    for path in ["/openapi.json".to_owned(), format!("/v1/trials/{trial}/signals"), "/v1/kinds".to_owned()] {
        let plain = server.get(&path).await;
        assert!(!plain.headers.contains_key("content-encoding"), "{path}");
        let request = server.request("GET", &path).header("accept-encoding", "gzip");
        let packed = reqwest::Client::new().execute(request.build().unwrap()).await.unwrap();
        assert_eq!(packed.headers()["content-encoding"], "gzip", "{path}");
        // The bytes are others, and so is their strong tag; either is known again.
        let (tag, plain_tag) = (packed.headers()["etag"].clone(), plain.headers["etag"].clone());
        assert_eq!(tag.to_str().unwrap(), format!("{}-gzip\"", plain_tag.to_str().unwrap().trim_end_matches('"')));
        for (accepts, known) in [("gzip", &tag), ("gzip", &plain_tag), ("identity", &plain_tag)] {
            let request = server.request("GET", &path).header("accept-encoding", accepts);
            let again = server.send(request.header("if-none-match", known)).await;
            assert_eq!((again.status.as_u16(), &again.headers["etag"]), (304, known), "{path}");
        }
        let bytes = packed.bytes().await.unwrap();
        let mut text = Vec::new();
        flate2::read::GzDecoder::new(&bytes[..]).read_to_end(&mut text).unwrap();
        assert!(text == plain.bytes && bytes.len() < text.len(), "{path}");
    }
    // A change may be conditional on what came packed.
    let study = format!("/v1/studies/{}", lab.study);
    server.patch(&study, &json!({"description": "long ".repeat(300)})).await.json(200);
    let read = server.send(server.request("GET", &study).header("accept-encoding", "gzip")).await;
    let tag = read.headers["etag"].to_str().unwrap().to_owned();
    assert!(tag.ends_with("-gzip\""), "{tag}");
    let change = || {
        let request = server.request("PATCH", &study).header("if-match", &tag);
        request.header("content-type", "application/merge-patch+json").body(r#"{"name": "packed"}"#)
    };
    server.send(change()).await.json(200);
    server.send(change()).await.problem(412, "precondition_failed");
    let small = server.request("GET", "/healthz").header("accept-encoding", "gzip");
    assert!(!server.send(small).await.headers.contains_key("content-encoding"));
    server.finish().await;
}

#[tokio::test]
async fn health_and_metrics() {
    let server = TestServer::start().await;
    assert_eq!(server.get("/healthz").await.json(200)["status"], "ok");
    assert_eq!(server.get("/readyz").await.json(200)["status"], "ok");
    server.get("/v1/studies/0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10").await.problem(404, "not_found");
    let metrics = server.get("/metrics").await;
    assert!(metrics.header("content-type").starts_with("text/plain"));
    let text = metrics.text();
    for line in [
        "volition_analyses{status=\"queued\"} 0",
        "volition_shared_total{what=\"trees\",from=\"cache\"} 0",
        "volition_http_request_duration_seconds_count{method=\"GET\",route=\"/v1/studies/{study}\",status=\"404\"} 1",
        "volition_http_request_duration_seconds_bucket{method=\"GET\",route=\"/healthz\",status=\"200\",le=\"+Inf\"} 1",
    ] {
        assert!(text.lines().any(|found| found == line), "{line} is not in\n{text}");
    }
    server.finish().await;
}

#[tokio::test]
async fn the_document_and_its_pages_come_from_here() {
    let server = TestServer::start().await;
    assert_eq!(server.get("/openapi.json").await.text(), volition::api::document());
    let page = server.get("/docs/").await;
    assert_eq!(page.status, 200);
    assert!(page.header("content-type").starts_with("text/html"));
    for word in ["http://", "https://", "//cdn"] {
        assert!(!page.text().contains(&format!("src=\"{word}")), "the page loads from elsewhere:\n{}", page.text());
    }
    assert!(server.get("/docs/swagger-initializer.js").await.text().contains("/openapi.json"));
    assert_eq!(server.get("/docs/swagger-ui.css").await.status, 200);
    server.finish().await;
}

#[tokio::test]
async fn a_body_that_breaks_off_stores_nothing() {
    let server = TestServer::start().await;
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    let head =
        "POST /v1/studies HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 50\r\n\r\n";
    stream.write_all(head.as_bytes()).await.unwrap();
    stream.write_all(b"{\"name\": \"half").await.unwrap();
    stream.shutdown().await.unwrap();
    let mut answer = Vec::new();
    // Whether the client still hears of it is the connection's affair.
    let _ = stream.read_to_end(&mut answer).await;
    assert_eq!(server.census().await[0], 0);
    server.finish().await;
}
