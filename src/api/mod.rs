//! The HTTP service.
//!
//! Handlers read the request ([`extract`]), call the store, and answer with views of its records; long or blocking work
//! runs on blocking threads, never on those that serve requests. Whatever goes wrong is a
//! [`Problem`](crate::analysis::Problem) that the [`guard`] around all routes writes as
//! `application/problem+json`.
// The macros of `utoipa` write whole paths for what they are given.
#![allow(unused_qualifications)]

mod accept;
mod analyses;
mod answer;
mod bulk_requests;
mod checks;
mod comparison;
mod cross_origin;
mod cursor;
mod docs;
mod doubts;
mod etag;
mod events;
mod extract;
mod figures;
mod forms;
mod frequency_responses;
mod guard;
mod idempotency;
mod index;
mod kinds;
mod learning_curves;
mod learning_inputs;
mod median_subjects;
mod models;
mod named;
mod negotiate;
mod ops;
mod plants;
mod prefer;
mod problem;
mod router;
mod samples;
mod schema;
mod sequences;
mod server;
mod shorthand;
mod signals;
mod state;
mod studies;
mod study_analyses;
mod study_table;
mod subjects;
mod telemetry;
mod timestamp;
mod trial_lists;
mod trials;
mod trust;
mod units;
mod upload;

pub(crate) use analyses::{check, report_text};
pub(crate) use checks::{
    description as checked_description, display_limit as checked_display_limit, name as checked_name,
    reason as checked_reason,
};
pub(crate) use comparison::{ComparisonQuery, compared};
pub use docs::document;
pub(crate) use etag::conditional_bytes;
pub(crate) use extract::{FromQuery, Id, Params, QueryText, off_thread};
pub(crate) use figures::drawing;
pub(crate) use figures::of_analysis::drawable as figures_of_analysis;
pub(crate) use figures::of_queue::queue_figure;
pub(crate) use figures::of_study::{
    NamedPlants, mean_controllers, more_figures, naming_excluded, of_study, plants_of_study, units_of_study,
};
pub(crate) use figures::of_trial::Shown;
pub(crate) use learning_inputs::{CurveQuery, Gathered, estimator as asked_estimator, gather, gather_trial, kind_of};
pub(crate) use plants::model as checked_model;
pub(crate) use problem::{ApiError, ApiResult, HttpProblem, PROBLEM_JSON, internal};
pub(crate) use router::router_with;
pub use router::{openapi, router};
pub use server::{Connections, serve};
pub use state::{AppState, Limits};
pub(crate) use trust::study_trust;
pub(crate) use upload::{Preview, Wish, preview, sent_files, stand_beside};
