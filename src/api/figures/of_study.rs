//! Figures of a study.

use super::{FigureList, FigureName, FigureQuery, Offered, answer};
use crate::analysis::ids::StudyId;
use crate::api::etag::{self, IfNoneMatch};
use crate::api::extract::{Id, Params};
use crate::api::learning_inputs::{CurveQuery, Gathered, gather};
use crate::api::named::Named;
use crate::api::problem::ApiResult;
use crate::api::state::AppState;
use crate::api::studies::{StudyPath, StudyView};
use crate::control::bode::log_grid;
use crate::figure::Figure;
use crate::figure::of::Units;
use crate::figure::of::learning_curves::{METRICS, learning_curve, name as name_of, title};
use crate::figure::of::mean_bode::{self, mean_bode};
use crate::learning::bode::identified_band;
use crate::learning::{CurveOptions, TrialSelection, study_frequency_responses, study_learning_curves};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use utoipa::IntoParams;

/// Frequencies of a mean response, equally spaced on a logarithmic scale.
const FREQUENCIES: usize = 120;

/// A band that begins at zero is drawn over so many powers of ten.
const LEAST_SHARE: f64 = 1e-3;

/// The curve of every quantity, and the mean controllers.
fn offered() -> Vec<Offered> {
    let mut all = METRICS.map(|metric| Offered { name: name_of(metric), title: title(metric) }).to_vec();
    all.push(Offered { name: mean_bode::NAME, title: "Gff, Gfb and Gff·G of the groups on the last trial" });
    all
}

/// The mean controllers of the groups' last identified trials, over the band that was identified.
pub(crate) fn last_controllers(gathered: &Gathered, options: &CurveOptions) -> Figure {
    let band = identified_band(&gathered.subjects);
    let omega = band.map_or_else(Vec::new, |(from, to)| log_grid(from.max(LEAST_SHARE * to), to, FREQUENCIES));
    let responses = study_frequency_responses(&gathered.subjects, TrialSelection::Last, &omega, options, false);
    mean_bode(&responses, &gathered.evidence)
}

/// Names a figure of a study in the path.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "documents the path")]
pub(crate) struct StudyFigurePath {
    /// The study.
    study: StudyId,
    /// The figure's name, one of those that the study lists.
    name: String,
}

/// Lists the figures of a study.
#[utoipa::path(get, path = "/v1/studies/{study}/figures", tag = "figures", operation_id = "list_study_figures",
    params(StudyPath, IfNoneMatch),
    responses((status = 200, description = "The figures by name.", body = FigureList)))]
pub(crate) async fn list(study: Named<StudyView>) -> ApiResult<Response> {
    study.state.store.study(study.id).await?;
    etag::conditional(&study.headers, &FigureList::new(&format!("/v1/studies/{}", study.id), &offered()))
}

/// Draws the learning curve of a quantity: every subject, the mean of every group with ± 1 SD, intervals, and a cross
/// over what is not to be used; or the mean Bode plots of the groups' last identified trials (`bode`).
///
/// Which trials and which estimates are shown is asked for as of `/v1/studies/{study}/learning-curves`.
#[utoipa::path(get, path = "/v1/studies/{study}/figures/{name}", tag = "figures", operation_id = "draw_study_figure",
    params(StudyFigurePath, FigureQuery, CurveQuery, IfNoneMatch),
    responses(
        (status = 200, description = "The figure.",
            content((String = "image/svg+xml"), (String = "image/png"), (String = "text/csv"),
                (Figure = "application/json"))),
        (status = 422, description = "There is nothing in view, a picture needs colours, or only prediction_error has \
            joint estimates.")))]
pub(crate) async fn read(
    State(state): State<AppState>,
    Id(id): Id<StudyId>,
    name: FigureName,
    Params(params): Params<(FigureQuery, CurveQuery)>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let (query, curves) = params;
    let name = name.among(&offered())?;
    let metric = METRICS.into_iter().find(|metric| name_of(*metric) == name);
    state.store.study(id).await?;
    let gathered = gather(&state, id, None, None, &curves).await?;
    let options = curves.options();
    let figure = move || {
        let Some(metric) = metric else {
            return Ok(last_controllers(&gathered, &options));
        };
        let curves = study_learning_curves(&gathered.subjects, &options);
        Ok(learning_curve(&curves, metric, &gathered.evidence, &Units::default()))
    };
    answer(&state, &headers, query, None, figure).await
}
