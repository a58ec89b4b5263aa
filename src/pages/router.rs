//! The addresses of pages, and the layers around them.

use super::{
    analysis, assets, compare, excitation, gate, home, new_study, problems, queue, report, start, study, subject,
    trial, upload,
};
use crate::api::{AppState, router_with};
use axum::Router;
use axum::middleware::from_fn;
use axum::routing::{get, post};
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::SizeAbove;

/// Shorter answers are sent as they are.
const PACKED_FROM: u64 = 860;

fn routes() -> Router<AppState> {
    Router::new()
        .route("/", get(home::page))
        .route("/studies/new", get(new_study::page).post(new_study::send))
        .route("/studies/{study}", get(study::page))
        .route("/subjects/{subject}", get(subject::page))
        .route("/trials/{trial}", get(trial::page))
        .route("/trials/{trial}/remarks", post(trial::keep_remarks))
        .route("/analyses/new", get(start::page).post(start::send))
        .route("/analyses/{analysis}", get(analysis::page))
        .route("/analyses/{analysis}/cancel", post(analysis::cancel))
        .route("/analyses/{analysis}/again", post(analysis::again))
        .route("/queue", get(queue::page).post(queue::act))
        .route("/studies/{study}/report", get(report::page))
        .route("/studies/{study}/report.html", get(report::file))
        .route("/compare", get(compare::page))
        .route("/excitation", get(excitation::page))
        .route("/upload", get(upload::page).post(upload::send))
        .route("/upload/{draft}", get(upload::draft).post(upload::act))
        .route("/a/{file}", get(assets::read))
        .layer(from_fn(gate::choose_theme))
        .layer(CompressionLayer::new().gzip(true).compress_when(SizeAbove::new(PACKED_FROM)))
}

/// The whole service: the interface, and pages beside it.
pub fn router(state: AppState) -> Router {
    router_with(routes(), state).layer(from_fn(problems::as_pages))
}
