//! Reading requests; whatever is wrong with one is said with its place.

mod body;
mod json;
mod query;
mod weight;

pub(super) use body::{Encoding, encoding, media_type, read_body, unsupported};
pub(super) use json::{Integer, Json, MergePatch, from_json, from_value};
pub(super) use json::{or_default, present};
pub(super) use query::parse_id;
pub(crate) use query::{FromQuery, Id, Params, QueryText};

use super::problem::{ApiResult, internal};
use axum::http::{HeaderMap, HeaderName};

/// Text as it may be quoted in a problem.
pub(super) fn shortened(text: &str) -> String {
    match text.char_indices().nth(80) {
        None => text.to_owned(),
        Some((at, _)) => format!("{}…", &text[..at]),
    }
}

/// A header as text to quote.
pub(super) fn header_text(headers: &HeaderMap, name: &HeaderName) -> String {
    headers.get(name).map_or_else(String::new, |value| shortened(&String::from_utf8_lossy(value.as_bytes())))
}

/// Runs blocking or long work away from the threads that serve requests.
pub(crate) async fn off_thread<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> ApiResult<T> {
    match tokio::task::spawn_blocking(work).await {
        Ok(value) => Ok(value),
        Err(error) => {
            if error.is_panic() {
                // The guard logs it and answers.
                std::panic::resume_unwind(error.into_panic());
            }
            tracing::error!(%error, "blocking work was cancelled");
            Err(internal().into())
        }
    }
}
