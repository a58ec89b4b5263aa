//! Answers that many routes give.

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Adds where the thing that was made is found.
pub(super) fn created(mut response: Response, location: String) -> Response {
    if let Ok(value) = HeaderValue::from_str(&location) {
        response.headers_mut().insert(header::LOCATION, value);
    }
    response
}

/// The answer to a deletion.
pub(super) fn no_content() -> Response {
    StatusCode::NO_CONTENT.into_response()
}
