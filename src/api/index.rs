//! Where to begin: what the interface has, and how much of it one request may ask.

use super::cursor::{DEFAULT_LIMIT, MAX_LIMIT};
use super::etag::{self, IfNoneMatch};
use super::extract::Params;
use super::problem::{ApiResult, of_status};
use super::router::resources;
use super::state::{AppState, Limits};
use axum::extract::{OriginalUri, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use schemars::JsonSchema;
use serde::Serialize;

/// The interface at a glance.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "Index")]
pub(crate) struct IndexView {
    /// Version of the program.
    version: &'static str,
    /// What there is, by address.
    resources: Vec<Resource>,
    /// How much one request may ask.
    limits: IndexLimits,
    /// Where to read on.
    links: IndexLinks,
}

/// An address, with what can be done there.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct Resource {
    /// The address; what stands in braces is an id or a name.
    pub(super) path: String,
    /// The methods that it takes, each with what it does.
    pub(super) methods: Vec<ResourceMethod>,
}

/// What a method does at an address.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct ResourceMethod {
    /// The method.
    pub(super) method: &'static str,
    /// What it does, in a sentence.
    pub(super) does: String,
}

/// How much one request may ask. What is beyond is refused, with the limit in the problem.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct IndexLimits {
    /// Bytes of a request's body, as they come over the wire.
    body_bytes: u64,
    /// Bytes that a packed body, or all packed files of an upload, may unpack to.
    unpacked_bytes: u64,
    /// Bytes that the JSON of a request may take in memory once it is read.
    json_memory_bytes: u64,
    /// Samples of a trial.
    trial_samples: u64,
    /// Files of one upload.
    files: u64,
    /// Analyses that one request may queue.
    analyses_at_once: u64,
    /// Rows of a list's page.
    page_rows: u64,
    /// Rows of a page unless `limit` says otherwise.
    page_rows_by_default: u64,
    /// Seconds that an answer waits for an analysis at most (`Prefer: wait`).
    wait_s: f64,
    /// Seconds that an answer may take in all; streams of events excepted.
    answer_s: f64,
    /// Seconds that a client may pause within a body.
    pause_in_body_s: f64,
    /// Uploads that are read at the same time; others wait.
    uploads_at_the_same_time: u64,
}

impl From<Limits> for IndexLimits {
    fn from(limits: Limits) -> Self {
        Self {
            body_bytes: limits.max_body_bytes as u64,
            unpacked_bytes: limits.max_decompressed_bytes,
            json_memory_bytes: limits.max_json_memory_bytes,
            trial_samples: limits.max_rows as u64,
            files: limits.max_multipart_files as u64,
            analyses_at_once: limits.max_bulk_analyses as u64,
            page_rows: u64::from(MAX_LIMIT),
            page_rows_by_default: u64::from(DEFAULT_LIMIT),
            wait_s: limits.max_wait.as_secs_f64(),
            answer_s: limits.request_timeout.as_secs_f64(),
            pause_in_body_s: limits.body_stall.as_secs_f64(),
            uploads_at_the_same_time: limits.concurrent_uploads as u64,
        }
    }
}

/// Where to read on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct IndexLinks {
    /// The OpenAPI document.
    openapi: &'static str,
    /// Pages that show it.
    docs: &'static str,
    /// The kinds of analysis, each with an example that runs.
    kinds: &'static str,
    /// The studies.
    studies: &'static str,
}

const LINKS: IndexLinks =
    IndexLinks { openapi: "/openapi.json", docs: "/docs/", kinds: "/v1/kinds", studies: "/v1/studies" };

/// Lists what the interface has, and every limit on a request.
#[utoipa::path(get, path = "/v1", tag = "operations", operation_id = "read_index", params(IfNoneMatch),
    responses((status = 200, description = "The interface at a glance.", body = IndexView)))]
pub(crate) async fn read(
    State(state): State<AppState>,
    Params(()): Params<()>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let (version, limits) = (env!("CARGO_PKG_VERSION"), state.limits.into());
    etag::conditional(&headers, &IndexView { version, resources: resources(), limits, links: LINKS })
}

/// The answer where there is nothing: an address without the slash at its end, where that is all that is wrong.
pub(super) async fn elsewhere(method: Method, OriginalUri(uri): OriginalUri) -> Response {
    let trimmed = uri.path().trim_end_matches('/');
    // Two slashes at the beginning would name another host.
    if trimmed.len() == uri.path().len() || trimmed.is_empty() || trimmed.starts_with("//") {
        return of_status(StatusCode::NOT_FOUND, method.as_str(), uri.path()).into_response();
    }
    let query = uri.query().map_or_else(String::new, |query| format!("?{query}"));
    let Ok(location) = HeaderValue::from_str(&format!("{trimmed}{query}")) else {
        return of_status(StatusCode::NOT_FOUND, method.as_str(), uri.path()).into_response();
    };
    let said = format!("There is no slash at the end of an address: {trimmed}\n");
    (StatusCode::PERMANENT_REDIRECT, [(header::LOCATION, location)], said).into_response()
}
