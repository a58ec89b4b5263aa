//! What pages of other origins may do: nothing, unless whoever runs the server names their origin.

use super::guard::REQUEST_ID;
use super::idempotency::{IDEMPOTENCY_KEY, IDEMPOTENT_REPLAYED};
use super::prefer::{PREFER, PREFERENCE_APPLIED};
use super::signals::SAMPLE_TIME;
use axum::http::{HeaderValue, Method, header};
use std::time::Duration;
use tower_http::cors::CorsLayer;

/// How long a browser remembers what it may ask.
const MAX_AGE: Duration = Duration::from_secs(600);

/// Lets pages of these origins ask and read. No cookies and no passwords: there are none. The guard refuses pages of
/// other origins before this is asked.
pub(super) fn cross_origin(origins: &[HeaderValue]) -> CorsLayer {
    CorsLayer::new()
        .allow_origin(origins.to_vec())
        .allow_methods([Method::GET, Method::POST, Method::PATCH, Method::DELETE])
        .allow_headers([
            header::ACCEPT,
            header::CONTENT_TYPE,
            header::CONTENT_ENCODING,
            header::IF_MATCH,
            header::IF_NONE_MATCH,
            IDEMPOTENCY_KEY,
            PREFER,
        ])
        .expose_headers([
            header::ETAG,
            header::LINK,
            header::LOCATION,
            header::RETRY_AFTER,
            REQUEST_ID,
            IDEMPOTENT_REPLAYED,
            PREFERENCE_APPLIED,
            SAMPLE_TIME,
        ])
        .max_age(MAX_AGE)
}
