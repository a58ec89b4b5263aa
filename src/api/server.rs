//! Connections: how many, and how long each may take over what.
//!
//! `axum::serve` sets no clock: a client that connects and says nothing, or sends a header byte by byte, or never reads
//! its answer, keeps its connection for ever. Here every wait for a client ends.

use axum::Router;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio_io_timeout::TimeoutStream;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

/// What headers of one request may take, in bytes, and how many there may be. As much again may come with the last
/// packet before it is counted.
const HEADER_BYTES: usize = 32 << 10;
const HEADERS: usize = 100;

/// Pause after a connection could not be accepted: no file handle is free, mostly.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// How many connections there may be, and how long a client is waited for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Connections {
    /// Connections at the same time; others wait to be accepted.
    pub at_once: usize,
    /// From the end of an answer (or the beginning) to the end of the next request's header.
    pub header: Duration,
    /// For which a client may take nothing of its answer.
    pub write: Duration,
}

impl Default for Connections {
    fn default() -> Self {
        Self { at_once: 512, header: Duration::from_secs(20), write: Duration::from_secs(30) }
    }
}

/// Serves until `shutdown`, then lets requests under way finish.
pub async fn serve(listener: TcpListener, router: Router, connections: Connections, shutdown: CancellationToken) {
    let free = Arc::new(Semaphore::new(connections.at_once.max(1)));
    let open = TaskTracker::new();
    loop {
        let accepted = async {
            let permit = Arc::clone(&free).acquire_owned().await;
            (permit, listener.accept().await)
        };
        let (permit, accepted) = tokio::select! {
            () = shutdown.cancelled() => break,
            accepted = accepted => accepted,
        };
        match accepted {
            Ok((stream, _)) => {
                let (router, shutdown) = (router.clone(), shutdown.clone());
                open.spawn(async move {
                    let _permit = permit;
                    one(stream, router, connections, shutdown).await;
                });
            }
            Err(error) => {
                tracing::warn!(%error, "a connection could not be accepted");
                tokio::time::sleep(ACCEPT_PAUSE).await;
            }
        }
    }
    drop(listener);
    open.close();
    open.wait().await;
}

async fn one(stream: TcpStream, router: Router, connections: Connections, shutdown: CancellationToken) {
    // Small answers leave at once.
    let _ = stream.set_nodelay(true);
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(connections.write));
    let mut http = hyper::server::conn::http1::Builder::new();
    http.timer(TokioTimer::new())
        .header_read_timeout(connections.header)
        .max_buf_size(HEADER_BYTES)
        .max_headers(HEADERS);
    let serving = http.serve_connection(TokioIo::new(Box::pin(stream)), TowerToHyperService::new(router));
    let mut serving = pin!(serving);
    let ended = tokio::select! {
        ended = serving.as_mut() => ended,
        () = shutdown.cancelled() => {
            serving.as_mut().graceful_shutdown();
            serving.await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(%error, "a connection ended early");
    }
}
