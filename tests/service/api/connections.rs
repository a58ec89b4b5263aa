//! Clients that connect and keep silent, that never end, that never read, that hang up: nobody else waits for them.

use super::harness::TestServer;
use serde_json::json;
use std::net::SocketAddr;
use std::time::{Duration, Instant};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio_util::sync::CancellationToken;
use volition::api::{AppState, Connections, router, serve};
use volition::store::Store;

/// How long clients are waited for here.
const QUICK: Connections =
    Connections { at_once: 20, header: Duration::from_millis(500), write: Duration::from_millis(700) };

/// Long enough for a wait that never ends to be told from one that is slow on a busy machine.
const FOR_EVER: Duration = Duration::from_secs(20);

async fn start(extra: Option<axum::Router>) -> (SocketAddr, CancellationToken, tokio::task::JoinHandle<()>, Store) {
    let store = Store::open(None).await.unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let shutdown = CancellationToken::new();
    let app = router(AppState::new(store.clone())).merge(extra.unwrap_or_default());
    let serving = tokio::spawn(serve(listener, app, QUICK, shutdown.clone()));
    (address, shutdown, serving, store)
}

/// Everything that comes until the server closes the connection, or the first error of a connection that was reset.
async fn to_the_end(stream: &mut TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    let read = async {
        let mut chunk = vec![0; 64 << 10];
        while let Ok(many @ 1..) = stream.read(&mut chunk).await {
            bytes.extend_from_slice(&chunk[..many]);
        }
    };
    tokio::time::timeout(FOR_EVER, read).await.expect("the connection is still open");
    bytes
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn silent_and_endless_clients_are_closed_in_time() {
    let (address, shutdown, serving, store) = start(None).await;
    let begin = Instant::now();
    // Says nothing.
    let mut silent = TcpStream::connect(address).await.unwrap();
    assert_eq!(to_the_end(&mut silent).await, b"");
    assert!(begin.elapsed() >= Duration::from_millis(400), "closed before its time");
    // Half a header; a header that goes on and on.
    let mut half = TcpStream::connect(address).await.unwrap();
    half.write_all(b"GET /healthz HTTP/1.1\r\nHost: loc").await.unwrap();
    let mut endless = TcpStream::connect(address).await.unwrap();
    endless.write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n").await.unwrap();
    let (mut reading, mut writing) = endless.into_split();
    let dripping = tokio::spawn(async move {
        while writing.write_all(b"X-A: b\r\n").await.is_ok() {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    });
    to_the_end(&mut half).await;
    let mut said = Vec::new();
    let _ = tokio::time::timeout(FOR_EVER, reading.read_to_end(&mut said)).await.expect("still open");
    dripping.await.unwrap();
    // Answers, then keeps the connection and says no more.
    let mut idle = TcpStream::connect(address).await.unwrap();
    idle.write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n").await.unwrap();
    let answer = String::from_utf8(to_the_end(&mut idle).await).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    shutdown.cancel();
    tokio::time::timeout(FOR_EVER, serving).await.unwrap().unwrap();
    store.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_that_sleeps_is_cut_off_and_a_slow_answer_is_not() {
    let slow = || async {
        tokio::time::sleep(Duration::from_millis(2000)).await;
        "in the end"
    };
    let large = || async { vec![b'x'; 64 << 20] };
    let extra = axum::Router::new().route("/slow", axum::routing::get(slow)).route("/large", axum::routing::get(large));
    let (address, shutdown, serving, store) = start(Some(extra)).await;
    let mut sleeping = TcpStream::connect(address).await.unwrap();
    sleeping.write_all(b"GET /large HTTP/1.1\r\nHost: localhost\r\n\r\n").await.unwrap();
    tokio::time::sleep(Duration::from_millis(4000)).await;
    let got = to_the_end(&mut sleeping).await.len();
    assert!(got < 64 << 20, "{got} bytes: the whole answer was kept for somebody who did not read");
    let mut patient = TcpStream::connect(address).await.unwrap();
    patient.write_all(b"GET /slow HTTP/1.1\r\nHost: localhost\r\n\r\n").await.unwrap();
    let answer = String::from_utf8(to_the_end(&mut patient).await).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with("in the end"), "{answer}");
    shutdown.cancel();
    tokio::time::timeout(FOR_EVER, serving).await.unwrap().unwrap();
    store.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connections_beyond_the_most_wait_and_are_served_when_others_go() {
    let (address, shutdown, serving, store) = start(None).await;
    let mut silent = Vec::new();
    for _ in 0..QUICK.at_once * 3 {
        silent.push(TcpStream::connect(address).await.unwrap());
    }
    let mut late = TcpStream::connect(address).await.unwrap();
    late.write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n").await.unwrap();
    let answer = String::from_utf8(to_the_end(&mut late).await).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    shutdown.cancel();
    tokio::time::timeout(FOR_EVER, serving).await.unwrap().unwrap();
    store.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn requests_that_a_proxy_might_read_otherwise_are_refused() {
    let (address, shutdown, serving, store) = start(None).await;
    let long = "X".repeat(100_000);
    let many: String = (0..150).map(|k| format!("X-{k}: y\r\n")).collect();
    let cases = [
        ("400", "GET /healthz HTTP/1.1\r\nHost: localhost\r\nHost: localhost\r\n\r\n".to_owned()),
        ("421", "GET /healthz HTTP/1.1\r\nHost: lab.example\r\n\r\n".to_owned()),
        ("431", format!("GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Long: {long}\r\n\r\n")),
        ("431", format!("GET /healthz HTTP/1.1\r\nHost: localhost\r\n{many}\r\n")),
        ("200", "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n".to_owned()),
    ];
    for (status, request) in cases {
        let mut stream = TcpStream::connect(address).await.unwrap();
        let _ = stream.write_all(request.as_bytes()).await;
        let answer = String::from_utf8_lossy(&to_the_end(&mut stream).await).into_owned();
        let begin: String = request.chars().take(60).collect();
        assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{begin:?}: {answer}");
    }
    shutdown.cancel();
    tokio::time::timeout(FOR_EVER, serving).await.unwrap().unwrap();
    store.close().await;
}

/// Requests that write, each dropped at another moment: before its end is sent, at once, or while it is answered.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_that_hang_up_at_any_moment_leave_no_connection_in_a_transaction() {
    use rand::{RngExt, SeedableRng};
    let server = TestServer::start().await;
    let study = server.post("/v1/studies", &json!({"name": "kept"})).await;
    let study: serde_json::Value = serde_json::from_slice(&study.bytes).unwrap();
    let id = study["id"].as_str().unwrap().to_owned();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1019);
    let mut running = tokio::task::JoinSet::new();
    for k in 0..600 {
        let body = format!("{{\"code\":\"S{k}\",\"attributes\":{{\"note\":\"{}\"}}}}", "x".repeat(2000));
        let (method, path, body) = match k % 3 {
            0 => ("POST", format!("/v1/studies/{id}/subjects"), body),
            1 => ("POST", "/v1/studies".to_owned(), format!("{{\"name\":\"dropped {k}\"}}")),
            _ => ("GET", format!("/v1/studies/{id}/subjects"), String::new()),
        };
        let head = format!(
            "{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n\
             Content-Length: {}\r\n\r\n",
            body.len()
        );
        let mut request = [head.into_bytes(), body.into_bytes()].concat();
        if rng.random_bool(0.2) {
            request.truncate(rng.random_range(0..request.len()));
        }
        let pause = Duration::from_micros(rng.random_range(0..8_000));
        let address = server.address;
        running.spawn(async move {
            let mut stream = TcpStream::connect(address).await.unwrap();
            let _ = stream.write_all(&request).await;
            tokio::time::sleep(pause).await;
            // Reset, not closed in good order.
            let _ = stream.set_zero_linger();
        });
        if running.len() >= 32 {
            running.join_next().await.unwrap().unwrap();
        }
    }
    while let Some(joined) = running.join_next().await {
        joined.unwrap();
    }
    for k in 0..20 {
        let answer = server.post("/v1/studies", &json!({"name": format!("after {k}")})).await;
        assert_eq!(answer.status, 201);
        assert_eq!(server.get(&format!("/v1/studies/{id}/subjects")).await.status, 200);
    }
    assert_eq!(server.get("/readyz").await.status, 200);
    assert_eq!(server.store.count_replaced(), 0, "connections were left within transactions");
    server.finish().await;
}
