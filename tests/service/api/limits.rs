//! Bodies and files larger than the server takes.

use crate::api::harness::{TestServer, gzip};
use futures::StreamExt;
use reqwest::multipart::{Form, Part};
use std::io::Write;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use volition::api::Limits;

/// Memory that this process has in RAM, in MiB.
fn resident_mib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() / 1024
}

#[tokio::test]
async fn a_client_that_keeps_sending_a_gibibyte_gets_its_problem() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let before = resident_mib();
    // A client of the simplest sort: it writes all of the body, and only then reads.
    for head in ["Content-Length: 1073741824", "Transfer-Encoding: chunked"] {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        let request = format!(
            "POST /v1/subjects/{}/trials?plant={} HTTP/1.1\r\nHost: localhost\r\n\
             Content-Type: text/csv\r\n{head}\r\n\r\n",
            lab.subject, lab.plant
        );
        stream.write_all(request.as_bytes()).await.unwrap();
        let chunked = head.starts_with('T');
        let block = vec![b'1'; 1 << 20];
        for _ in 0..1024 {
            if chunked {
                stream.write_all(b"100000\r\n").await.unwrap();
            }
            stream.write_all(&block).await.unwrap();
            if chunked {
                stream.write_all(b"\r\n").await.unwrap();
            }
        }
        if chunked {
            stream.write_all(b"0\r\n\r\n").await.unwrap();
        }
        let mut answer = String::new();
        stream.read_to_string(&mut answer).await.unwrap();
        assert!(answer.starts_with("HTTP/1.1 413 "), "{answer}");
        assert!(answer.contains("application/problem+json") && answer.contains("\"code\":\"too_large\""), "{answer}");
    }
    let grown = resident_mib().saturating_sub(before);
    assert!(grown < 300, "the memory grew by {grown} MiB");
    assert_eq!(server.census().await[3], 0);
    server.finish().await;
}

#[tokio::test]
async fn a_client_that_never_stops_is_cut_off() {
    let limits = Limits { max_body_bytes: 1 << 10, max_drained_bytes: 1 << 20, ..Limits::default() };
    let server = TestServer::start_with(limits).await;
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    let head = "POST /v1/studies HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n\
                Content-Length: 1099511627776\r\n\r\n";
    stream.write_all(head.as_bytes()).await.unwrap();
    let block = vec![b' '; 1 << 16];
    let mut sent = 0_u64;
    let endless = async {
        while stream.write_all(&block).await.is_ok() {
            sent += block.len() as u64;
        }
    };
    tokio::time::timeout(Duration::from_secs(20), endless).await.expect("the connection was closed");
    assert!(sent < 64 << 20, "{sent} bytes were taken");
    server.finish().await;
}

#[tokio::test]
async fn a_client_that_asks_first_sends_nothing() {
    let server = TestServer::start().await;
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    let head = "POST /v1/studies HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n\
                Content-Length: 1073741824\r\nExpect: 100-continue\r\n\r\n";
    stream.write_all(head.as_bytes()).await.unwrap();
    let mut answer = String::new();
    tokio::time::timeout(Duration::from_secs(10), stream.read_to_string(&mut answer)).await.unwrap().unwrap();
    assert!(answer.starts_with("HTTP/1.1 413 "), "{answer}");
    server.finish().await;
}

#[tokio::test]
async fn ten_million_rows_are_refused_on_the_way() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    // 10 million rows that pack to a few hundred kilobytes.
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(b"r,u,y\n").unwrap();
    let block = b"1,0,1\n".repeat(100_000);
    for _ in 0..100 {
        encoder.write_all(&block).unwrap();
    }
    let packed = encoder.finish().unwrap();
    let before = resident_mib();
    let path = format!("/v1/subjects/{}/trials?plant={}&sample_time_s=0.01", lab.subject, lab.plant);
    let request = server.request("POST", &path).header("content-type", "text/csv").header("content-encoding", "gzip");
    let problem = server.send(request.body(packed)).await.problem(413, "too_large");
    assert!(problem["detail"].as_str().unwrap().contains("2000000 rows"), "{problem}");
    let grown = resident_mib().saturating_sub(before);
    assert!(grown < 400, "the memory grew by {grown} MiB");
    assert_eq!(server.census().await[3], 0);
    server.finish().await;
}

#[tokio::test]
async fn a_small_body_that_unpacks_to_a_large_one_is_refused() {
    let limits = Limits { max_decompressed_bytes: 1 << 20, ..Limits::default() };
    let server = TestServer::start_with(limits).await;
    let lab = server.lab().await;
    let bomb = gzip(format!("t,r,u,y\n{}", "0".repeat(4 << 20)).as_bytes());
    let path = format!("/v1/subjects/{}/trials?plant={}", lab.subject, lab.plant);
    let request = server.request("POST", &path).header("content-type", "text/csv").header("content-encoding", "gzip");
    let answer = server.send(request.body(bomb)).await;
    assert!(answer.status.is_client_error(), "{}", answer.text());
    // Within a form the files share the limit.
    let rows = "0,0,0\n".repeat(100_000);
    let csv = format!("r,u,y\n{rows}");
    let form = Form::new()
        .part("f", Part::bytes(gzip(csv.as_bytes())).file_name("a.csv.gz"))
        .part("f", Part::bytes(gzip(csv.as_bytes())).file_name("b.csv.gz"));
    let answer = server.send(server.request("POST", &format!("{path}&sample_time_s=0.01")).multipart(form)).await;
    assert_eq!(answer.problem(413, "too_large")["where"], "file 'b.csv.gz'");
    assert_eq!(server.census().await[3], 0);
    server.finish().await;
}

#[tokio::test]
async fn forms_have_a_limit_of_files() {
    let limits = Limits { max_multipart_files: 3, ..Limits::default() };
    let server = TestServer::start_with(limits).await;
    let lab = server.lab().await;
    let form = (0..4).fold(Form::new(), |form, i| {
        form.part("f", Part::bytes("r,u,y\n1,1,1\n1,1,2\n".as_bytes()).file_name(format!("{i}.csv")))
    });
    let path = format!("/v1/subjects/{}/trials?plant={}&sample_time_s=0.1", lab.subject, lab.plant);
    server.send(server.request("POST", &path).multipart(form)).await.problem(413, "too_large");
    server.finish().await;
}

#[tokio::test]
async fn a_body_that_stalls_is_given_up() {
    let limits = Limits { body_stall: Duration::from_millis(200), ..Limits::default() };
    let server = TestServer::start_with(limits).await;
    let stalled =
        futures::stream::once(async { Ok::<_, std::io::Error>("{\"name\":") }).chain(futures::stream::pending());
    let request = server.request("POST", "/v1/studies").header("content-type", "application/json");
    let answer = server.send(request.body(reqwest::Body::wrap_stream(stalled))).await;
    answer.problem(408, "deadline_exceeded");
    server.finish().await;
}
