//! The figure of the queue.

use super::{FigureQuery, answer};
use crate::api::extract::Params;
use crate::api::problem::ApiResult;
use crate::api::state::AppState;
use crate::figure::Figure;
use crate::figure::of::queue::{Passage, queue};
use crate::store::Passage as Stored;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;

/// Hours that are shown.
const HOURS: f64 = 24.0;

/// Draws how many analyses waited and ran over the last 24 hours; failed ones are crosses.
#[utoipa::path(get, path = "/v1/figures/queue", tag = "figures", operation_id = "draw_queue", params(FigureQuery),
    responses(
        (status = 200, description = "The figure.",
            content((String = "image/svg+xml"), (String = "image/png"), (String = "text/csv"),
                (Figure = "application/json"))),
        (status = 422, description = "There is nothing in view, or a picture needs colours.")))]
pub(crate) async fn read(
    State(state): State<AppState>,
    Params(query): Params<FigureQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let passages = lately(&state).await?;
    answer(&state, &headers, query, None, move || Ok(queue(&passages, HOURS))).await
}

async fn lately(state: &AppState) -> ApiResult<Vec<Passage>> {
    let own = |own: Stored| {
        let Stored { created_h, started_h, finished_h, failed } = own;
        Passage { created_h, started_h, finished_h, failed }
    };
    Ok(state.store.passages(HOURS).await?.into_iter().map(own).collect())
}

/// The same figure, to be drawn elsewhere.
pub(crate) async fn queue_figure(state: &AppState) -> ApiResult<Figure> {
    let passages = lately(state).await?;
    Ok(queue(&passages, HOURS))
}
