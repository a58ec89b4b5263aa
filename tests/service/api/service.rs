//! What surrounds the routes: hosts, methods, health, metrics, documentation.

use crate::api::harness::TestServer;
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

#[tokio::test]
async fn unknown_routes_and_methods_are_problems() {
    let server = TestServer::start().await;
    let lost = server.get("/v2/studies").await.problem(404, "not_found");
    assert!(lost["mend"].as_str().unwrap().contains("/openapi.json"));
    server.get("/v1/studies/").await.problem(404, "not_found");
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
