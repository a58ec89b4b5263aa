//! The HTTP service.
//!
//! Handlers read the request ([`extract`]), call the store, and answer with views of its records; long or blocking work
//! runs on blocking threads, never on those that serve requests. Whatever goes wrong is a
//! [`Problem`](crate::analysis::Problem) that the [`fence`](router()) around all routes writes as
//! `application/problem+json`.
// The macros of `utoipa` write whole paths for what they are given.
#![allow(unused_qualifications)]

pub mod analyses;
pub mod checks;
pub mod cursor;
pub mod docs;
pub mod etag;
pub mod events;
pub mod extract;
mod fence;
pub mod frequency_responses;
pub mod idempotency;
pub mod kinds;
pub mod learning_curves;
mod learning_inputs;
mod named;
pub mod ops;
pub mod plants;
pub mod problem;
pub mod router;
pub mod samples;
mod schema;
pub mod signals;
pub mod state;
pub mod studies;
pub mod study_analyses;
pub mod subjects;
pub mod trials;
pub mod upload;

pub use docs::document;
pub use router::{openapi, router};
pub use state::{AppState, Hosts, Limits};

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
