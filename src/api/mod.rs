//! The HTTP service.
//!
//! Handlers read the request ([`extract`]), call the store, and answer with views of its records; long or blocking work
//! runs on blocking threads, never on those that serve requests. Whatever goes wrong is a
//! [`Problem`](crate::analysis::Problem) that the [`guard`] around all routes writes as
//! `application/problem+json`.
// The macros of `utoipa` write whole paths for what they are given.
#![allow(unused_qualifications)]

mod analyses;
mod answer;
mod checks;
mod comparison;
mod cursor;
mod docs;
mod etag;
mod events;
mod extract;
mod figures;
mod frequency_responses;
mod guard;
mod idempotency;
mod kinds;
mod learning_curves;
mod learning_inputs;
mod learning_reports;
mod median_subjects;
mod named;
mod ops;
mod plants;
mod problem;
mod router;
mod samples;
mod schema;
mod server;
mod signals;
mod state;
mod studies;
mod study_analyses;
mod subjects;
mod telemetry;
mod timestamp;
mod trials;
mod upload;

pub use docs::document;
pub use router::{openapi, router};
pub use server::{Connections, serve};
pub use state::{AppState, Limits};
