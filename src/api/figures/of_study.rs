//! Figures of a study.

use super::of_trial::units as units_of;
use super::{FigureList, FigureName, FigureQuery, Offered, answer};
use crate::analysis::Problem;
use crate::analysis::ids::StudyId;
use crate::api::etag::{self, IfNoneMatch};
use crate::api::extract::{FromQuery, Id, Params, QueryText};
use crate::api::frequency_responses::trial_selection;
use crate::api::learning_inputs::{CurveQuery, Gathered, everything, gather};
use crate::api::named::Named;
use crate::api::problem::ApiResult;
use crate::api::state::AppState;
use crate::api::studies::{StudyPath, StudyView};
use crate::api::trust::{quantity, study_trust};
use crate::control::bode::log_grid;
use crate::figure::Figure;
use crate::figure::of::Units;
use crate::figure::of::learning_curves::{METRICS, learning_curve, name as name_of, title};
use crate::figure::of::mean_bode::{self, mean_bode};
use crate::figure::of::scatter::{self, scatter};
use crate::figure::of::trust_grid::{self, trust_grid};
use crate::learning::bode::identified_band;
use crate::learning::curves::Metric;
use crate::learning::{CurveOptions, TrialSelection, study_frequency_responses, study_learning_curves};
use crate::store::SignalUnits;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use utoipa::IntoParams;

/// Frequencies of a mean response, equally spaced on a logarithmic scale.
const FREQUENCIES: usize = 120;

/// A band that begins at zero is drawn over so many powers of ten.
const LEAST_SHARE: f64 = 1e-3;

/// The curve of every quantity, the mean controllers, the scatter, and the grid of trust.
fn offered() -> Vec<Offered> {
    let mut all = METRICS.map(|metric| Offered { name: name_of(metric), title: title(metric) }).to_vec();
    all.push(Offered { name: mean_bode::NAME, title: "Gff, Gfb and Gff·G of the groups on a trial" });
    all.push(Offered { name: scatter::NAME, title: "Tracking error against distance from the inverse dynamics" });
    all.push(Offered { name: trust_grid::NAME, title: "How far a quantity of each trial may be used" });
    all
}

/// What the grid of trust and the mean controllers show.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct GridQuery {
    /// The quantity of the figure `trust`, by its name; other figures have their own.
    #[param(value_type = Option<String>, nullable = false, pattern = "^[a-z_]+$",
        default = "norm_feedforward_plant_minus_one")]
    quantity: Metric,
    /// Which identified trial of each subject the figure `bode` shows: `first`, `last`, or a trial number.
    #[param(value_type = Option<String>, nullable = false, pattern = "^(first|last|[1-9][0-9]{0,8})$",
        default = "last")]
    trial: TrialSelection,
}

impl FromQuery for GridQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok(Self { quantity: quantity(query)?, trial: trial_selection(query)?.unwrap_or_default() })
    }
}

/// The units of a study's curves: those that all of its plants share.
pub(crate) async fn units_of_study(state: &AppState, study: StudyId) -> ApiResult<Units> {
    let plants = everything(|page| state.store.plants(study, page), |plant| plant.id.0).await?;
    let shared = |of: fn(&SignalUnits) -> &Option<String>| {
        let mut all = plants.iter().map(|plant| of(&plant.units));
        let first = all.next()?.clone();
        first.filter(|first| all.all(|own| own.as_ref() == Some(first)))
    };
    Ok(units_of(&SignalUnits { output: shared(|own| &own.output), control: shared(|own| &own.control) }))
}

/// The mean controllers of the groups' identified trials, the first or the last of each person, over the band that was
/// identified.
pub(crate) fn mean_controllers(gathered: &Gathered, trial: TrialSelection, options: &CurveOptions) -> Figure {
    let band = identified_band(&gathered.subjects);
    let omega = band.map_or_else(Vec::new, |(from, to)| log_grid(from.max(LEAST_SHARE * to), to, FREQUENCIES));
    mean_bode(&study_frequency_responses(&gathered.subjects, trial, &omega, options, false))
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
/// over what is not to be used; the mean Bode plots of the groups' last identified trials (`bode`); error against
/// distance (`scatter`); or how far the `quantity` of each trial may be used (`trust`).
///
/// Which trials and which estimates are shown is asked for as of `/v1/studies/{study}/learning-curves`.
#[utoipa::path(get, path = "/v1/studies/{study}/figures/{name}", tag = "figures", operation_id = "draw_study_figure",
    params(StudyFigurePath, FigureQuery, CurveQuery, GridQuery, IfNoneMatch),
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
    Params(params): Params<(FigureQuery, (CurveQuery, GridQuery))>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let (query, (curves, GridQuery { quantity, trial })) = params;
    let name = name.among(&offered())?;
    let metric = METRICS.into_iter().find(|metric| name_of(*metric) == name);
    state.store.study(id).await?;
    if name == trust_grid::NAME {
        let found = study_trust(&state, id, quantity, curves.estimator, curves.spec.as_deref()).await?;
        return answer(&state, &headers, query, None, move || Ok(trust_grid(&found))).await;
    }
    let gathered = gather(&state, id, None, None, &curves).await?;
    let options = curves.options();
    let units = units_of_study(&state, id).await?;
    let figure = move || {
        if name == scatter::NAME {
            return Ok(scatter(&study_learning_curves(&gathered.subjects, &options), &units));
        }
        let Some(metric) = metric else {
            return Ok(mean_controllers(&gathered, trial, &options));
        };
        let curves = study_learning_curves(&gathered.subjects, &options);
        Ok(learning_curve(&curves, metric, &units))
    };
    answer(&state, &headers, query, None, figure).await
}
