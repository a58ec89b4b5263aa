//! The outermost layer: names each request, refuses foreign hosts, bounds its time, catches panics, writes problems.

use super::problem::{ApiError, HttpProblem, PROBLEM_JSON, RequestCode, Unwritten, internal, of_status};
use super::state::AppState;
use crate::analysis::{Code, Problem};
use axum::body::{Body, BodyDataStream, Bytes, HttpBody};
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures::{FutureExt, Stream, StreamExt};
use std::panic::AssertUnwindSafe;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};
use tracing::Instrument;
use uuid::Uuid;

/// The header that names a request.
pub(crate) const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// How long a client may pause while the rest of its body is thrown away.
const DRAIN_PAUSE: Duration = Duration::from_secs(2);

/// Runs a request behind the guard.
pub(super) async fn guard(State(state): State<AppState>, request: Request, next: Next) -> Response {
    let began = Instant::now();
    let id = Uuid::now_v7();
    let method = request.method().clone();
    let path = request.uri().path().to_owned();
    let route = request.extensions().get::<MatchedPath>().map_or("none", MatchedPath::as_str).to_owned();
    let span = tracing::info_span!("request", request_id = %id, %method, path);

    let mut response = async {
        if let Err(refused) = check_host(request.uri(), request.headers(), &state.origins) {
            return refused.into_response();
        }
        let request = drained_when_dropped(request, &state);
        let run = AssertUnwindSafe(next.run(request)).catch_unwind();
        match tokio::time::timeout(state.limits.request_timeout, run).await {
            Ok(Ok(response)) => response,
            Ok(Err(panic)) => {
                let message = panic
                    .downcast_ref::<&str>()
                    .map(|text| (*text).to_owned())
                    .or_else(|| panic.downcast_ref::<String>().cloned())
                    .unwrap_or_default();
                tracing::error!(message, "handler panicked");
                ApiError::from(internal()).into_response()
            }
            Err(_) => ApiError::from(
                Problem::new(
                    RequestCode::Busy,
                    "took too long",
                    format!("the request was not answered within {} s", state.limits.request_timeout.as_secs()),
                )
                .mend("Try again later, or ask for less at once."),
            )
            .into_response(),
        }
    }
    .instrument(span.clone())
    .await;

    let status = response.status();
    if status.is_client_error() || status.is_server_error() {
        response = write_problem(response, id, method.as_str(), &path);
    }
    if let Ok(value) = HeaderValue::from_str(&id.to_string()) {
        response.headers_mut().insert(REQUEST_ID, value);
    }
    let elapsed = began.elapsed();
    state.telemetry.observe(method.as_str(), &route, status.as_u16(), elapsed);
    let _entered = span.enter();
    tracing::debug!(status = status.as_u16(), route, elapsed_ms = elapsed.as_secs_f64() * 1e3, "answered");
    response
}

fn write_problem(response: Response, id: Uuid, method: &str, path: &str) -> Response {
    let (mut parts, _) = response.into_parts();
    let problem = match parts.extensions.remove::<Unwritten>() {
        Some(Unwritten(problem)) => *problem,
        None => of_status(parts.status, method, path).into_problem(),
    };
    let body = HttpProblem::new(problem, parts.status, format!("urn:uuid:{id}"));
    let Ok(bytes) = serde_json::to_vec(&body) else { return StatusCode::INTERNAL_SERVER_ERROR.into_response() };
    parts.headers.remove(header::CONTENT_LENGTH);
    parts.headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
    parts.headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Response::from_parts(parts, Body::from(bytes))
}

/// Refuses names that are not of the loopback interface, the only one that is served: a web page that makes its own
/// name point to 127.0.0.1 (DNS rebinding), or posts a form across origins, is refused, unless its origin is `allowed`.
fn check_host(uri: &Uri, headers: &HeaderMap, allowed: &[HeaderValue]) -> Result<(), ApiError> {
    let refuse = |what: &str, value: &str| {
        let problem = Problem::new(
            Code::Malformed,
            "foreign host",
            format!("this server serves its own machine only, and the {what} names '{value}'"),
        );
        let mend = "Use http://localhost or http://127.0.0.1 with the server's port.";
        ApiError::from(problem.at(format!("header {what}")).mend(mend)).with_status(StatusCode::MISDIRECTED_REQUEST)
    };
    if headers.get_all(header::HOST).iter().nth(1).is_some() {
        let problem = Problem::new(Code::Malformed, "two hosts", "the request has more than one header Host");
        return Err(problem.at("header Host").mend("Send one.").into());
    }
    let host = match uri.host() {
        Some(host) => Some(host.to_owned()),
        None => headers.get(header::HOST).map(|value| String::from_utf8_lossy(value.as_bytes()).into_owned()),
    };
    if let Some(host) = host
        && !is_loopback(&host)
    {
        return Err(refuse("Host", &host));
    }
    if let Some(origin) = headers.get(header::ORIGIN).filter(|origin| !allowed.contains(origin)) {
        let text = String::from_utf8_lossy(origin.as_bytes()).into_owned();
        let authority = text.split_once("://").map_or(text.as_str(), |(_, rest)| rest);
        if !is_loopback(authority) {
            return Err(refuse("Origin", &text));
        }
    }
    Ok(())
}

/// Whether `host` or `host:port` names the loopback interface.
fn is_loopback(authority: &str) -> bool {
    let (host, port) = if let Some(rest) = authority.strip_prefix('[') {
        match rest.split_once(']') {
            Some((host, port)) => (host, port),
            None => return false,
        }
    } else {
        match authority.find(':') {
            Some(at) => authority.split_at(at),
            None => (authority, ""),
        }
    };
    let port_is_fine = match port.strip_prefix(':') {
        Some(digits) => digits.bytes().all(|b| b.is_ascii_digit()),
        None => port.is_empty(),
    };
    let host_is_fine = host.eq_ignore_ascii_case("localhost")
        || host.parse::<std::net::IpAddr>().is_ok_and(|address| address.is_loopback());
    port_is_fine && host_is_fine
}

/// Wraps the body so that what is left of it when the handler is done is read (within bounds) and thrown away.
///
/// A client that writes all of a large body before it reads the answer would otherwise see its connection reset, and
/// never the problem that says why. A client that waits for `100 Continue` has sent nothing yet, and is left alone.
fn drained_when_dropped(request: Request, state: &AppState) -> Request {
    let waits = request.headers().contains_key(header::EXPECT);
    let (bytes, time) = (state.limits.max_drained_bytes, state.limits.max_drain_time);
    let pause = state.limits.body_stall.min(DRAIN_PAUSE);
    request.map(|body| {
        if HttpBody::is_end_stream(&body) {
            return body;
        }
        Body::from_stream(Drained { inner: Some(body.into_data_stream()), started: !waits, bytes, time, pause })
    })
}

struct Drained {
    inner: Option<BodyDataStream>,
    /// Whether the client is sending (or may be).
    started: bool,
    bytes: u64,
    time: Duration,
    pause: Duration,
}

impl Stream for Drained {
    type Item = Result<Bytes, axum::Error>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.started = true;
        let Some(inner) = self.inner.as_mut() else { return Poll::Ready(None) };
        let polled = Pin::new(inner).poll_next(context);
        if matches!(polled, Poll::Ready(None | Some(Err(_)))) {
            self.inner = None;
        }
        polled
    }
}

impl Drop for Drained {
    fn drop(&mut self) {
        let Some(mut body) = self.inner.take() else { return };
        let (mut left, time, pause) = (self.bytes, self.time, self.pause);
        if self.started
            && let Ok(runtime) = tokio::runtime::Handle::try_current()
        {
            runtime.spawn(tokio::time::timeout(time, async move {
                while let Ok(Some(Ok(chunk))) = tokio::time::timeout(pause, body.next()).await {
                    let Some(rest) = left.checked_sub(chunk.len() as u64) else { break };
                    left = rest;
                }
            }));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_loopback_names_pass() {
        for good in ["localhost", "LOCALHOST:8080", "127.0.0.1:1", "127.0.0.9", "[::1]", "[::1]:8080"] {
            assert!(is_loopback(good), "{good}");
        }
        for bad in [
            "",
            "lab.example",
            "localhost.lab.example",
            "127.0.0.1.lab.example:80",
            "10.0.0.1",
            "[::2]:80",
            "localhost:80@lab.example",
            "[::1",
            "null",
            "[::1]x",
        ] {
            assert!(!is_loopback(bad), "{bad}");
        }
    }

    /// The status and the problem that a route behind the guard leads to.
    async fn through(route: axum::routing::MethodRouter<AppState>) -> (u16, HttpProblem) {
        use tower::ServiceExt;
        let store = crate::store::Store::open(None).await.unwrap();
        let limits = super::super::Limits { request_timeout: Duration::from_millis(50), ..Default::default() };
        let state = AppState::new(store).with_limits(limits);
        let router = axum::Router::new()
            .route("/{id}", route)
            .layer(axum::middleware::from_fn_with_state(state.clone(), guard))
            .with_state(state);
        let request = Request::builder().uri("/x").body(Body::empty()).unwrap();
        let response = router.oneshot(request).await.unwrap();
        assert_eq!(response.headers()[header::CONTENT_TYPE], PROBLEM_JSON);
        let id = response.headers()[REQUEST_ID].to_str().unwrap().to_owned();
        let status = response.status().as_u16();
        let bytes = axum::body::to_bytes(response.into_body(), 1 << 20).await.unwrap();
        let problem: HttpProblem = serde_json::from_slice(&bytes).unwrap();
        assert_eq!((problem.status, problem.instance.as_str()), (status, format!("urn:uuid:{id}").as_str()));
        (status, problem)
    }

    #[tokio::test]
    async fn panics_timeouts_and_strange_rejections_leave_as_problems() {
        use axum::routing::get;
        async fn panics() {
            panic!("the password is 7");
        }
        async fn panics_elsewhere() -> super::super::problem::ApiResult<()> {
            super::super::extract::off_thread(|| panic!("the password is 7")).await
        }
        for route in [get(panics), get(panics_elsewhere)] {
            let (status, problem) = through(route).await;
            assert_eq!((status, problem.code), (500, Code::Internal.into()));
            assert!(!format!("{problem:?}").contains("password"), "what panicked is for the log");
        }
        let (status, problem) = through(get(std::future::pending::<()>)).await;
        assert_eq!((status, problem.code), (503, RequestCode::Busy.into()));
        let (status, problem) = through(get(async |_: axum::extract::Path<u32>| ())).await;
        assert_eq!((status, problem.code), (400, Code::Malformed.into()));
        let (status, problem) = through(axum::routing::post(async || ())).await;
        assert_eq!((status, problem.code), (405, RequestCode::MethodNotAllowed.into()));
    }
}
