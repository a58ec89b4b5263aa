//! The HTTP service.
//!
//! Handlers read the request ([`extract`]), call the store, and answer with views of its records; long or blocking work
//! runs on blocking threads, never on those that serve requests. Whatever goes wrong is a
//! [`Problem`](crate::analysis::Problem) that the [`guard`] around all routes writes as
//! `application/problem+json`.
// The macros of `utoipa` write whole paths for what they are given.
#![allow(unused_qualifications)]

mod analyses;
mod checks;
mod cursor;
mod docs;
mod etag;
mod events;
mod extract;
mod frequency_responses;
mod guard;
mod idempotency;
mod kinds;
mod learning_curves;
mod learning_inputs;
mod named;
mod ops;
mod plants;
mod problem;
mod router;
mod samples;
mod schema;
mod signals;
mod state;
mod studies;
mod study_analyses;
mod subjects;
mod trials;
mod upload;

pub use docs::document;
pub use router::{openapi, router};
pub use state::{AppState, Limits};

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Adds where the thing that was made is found.
fn created(mut response: Response, location: String) -> Response {
    if let Ok(value) = HeaderValue::from_str(&location) {
        response.headers_mut().insert(header::LOCATION, value);
    }
    response
}

/// The answer to a deletion.
fn no_content() -> Response {
    StatusCode::NO_CONTENT.into_response()
}
