//! Figures of a trial.

use super::{FigureList, FigureName, FigureQuery, Offered, answer, tag, unchanged};
use crate::analysis::ids::TrialId;
use crate::analysis::{Code, Problem};
use crate::api::etag::{self, IfNoneMatch};
use crate::api::extract::{Id, Params};
use crate::api::named::Named;
use crate::api::problem::ApiResult;
use crate::api::state::AppState;
use crate::api::trials::{TrialPath, TrialView};
use crate::figure::Figure;
use crate::figure::of::plant_check::{self, plant_check};
use crate::figure::of::signals::{self, signals};
use crate::figure::of::spectra::{self, spectra};
use crate::figure::of::{TrialOrigin, Units};
use crate::store::{Plant, SignalUnits, Study, Subject, TrialRecord};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use utoipa::IntoParams;

/// What every trial has.
const OFFERED: [Offered; 3] = [
    Offered { name: signals::NAME, title: "The signals r, y, u and e" },
    Offered { name: plant_check::NAME, title: "Whether y follows from the control through the plant" },
    Offered { name: spectra::NAME, title: "The power of r, y, u and e over frequency" },
];

/// Names a figure of a trial in the path.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "documents the path")]
pub(crate) struct TrialFigurePath {
    /// The trial.
    trial: TrialId,
    /// The figure's name, one of those that the trial lists.
    name: String,
}

/// A trial with what its figures name.
pub(crate) struct Shown {
    pub(crate) record: TrialRecord,
    pub(crate) subject: Subject,
    pub(crate) plant: Plant,
    pub(crate) study: Study,
}

impl Shown {
    pub(crate) async fn read(state: &AppState, id: TrialId) -> ApiResult<Self> {
        let record = state.store.trial(id).await?;
        let subject = state.store.subject(record.subject).await?;
        let plant = state.store.plant(record.plant).await?;
        let study = state.store.study(record.study).await?;
        Ok(Self { record, subject, plant, study })
    }

    pub(crate) fn origin(&self) -> TrialOrigin {
        TrialOrigin {
            subject: self.subject.code.clone(),
            number: self.record.number,
            session: self.record.session,
            plant: self.plant.name.clone(),
            sha256: self.record.sha256.clone(),
            display_limit: self.study.display_limit,
            units: units(&self.record.units.or(&self.plant.units)),
        }
    }
}

/// Units as figures write them: what nobody gave is said to be unknown.
pub(super) fn units(own: &SignalUnits) -> Units {
    let unknown = Units::default();
    Units {
        output: own.output.clone().unwrap_or(unknown.output),
        control: own.control.clone().unwrap_or(unknown.control),
    }
}

/// Lists the figures of a trial.
#[utoipa::path(get, path = "/v1/trials/{trial}/figures", tag = "figures", operation_id = "list_trial_figures",
    params(TrialPath, IfNoneMatch),
    responses((status = 200, description = "The figures by name.", body = FigureList)))]
pub(crate) async fn list(trial: Named<TrialView>) -> ApiResult<Response> {
    trial.state.store.trial(trial.id).await?;
    etag::conditional(&trial.headers, &FigureList::new(&format!("/v1/trials/{}", trial.id), &OFFERED))
}

/// Draws a figure of a trial: its signals (`signals`), the output against what the plant makes of the control
/// (`plant_check`), or powers over frequency (`spectra`).
///
/// Of samples closer than four a pixel, every pixel column shows the first, the least, the greatest and the last; CSV
/// and JSON have the numbers that are drawn. All samples are at `/v1/trials/{trial}/signals`.
#[utoipa::path(get, path = "/v1/trials/{trial}/figures/{name}", tag = "figures", operation_id = "draw_trial_figure",
    params(TrialFigurePath, FigureQuery, IfNoneMatch),
    responses(
        (status = 200, description = "The figure.",
            content((String = "image/svg+xml"), (String = "image/png"), (String = "text/csv"),
                (Figure = "application/json"))),
        (status = 422, description = "There is nothing in view, a picture needs colours, or the plant cannot judge the \
            recording.")))]
pub(crate) async fn read(
    State(state): State<AppState>,
    Id(id): Id<TrialId>,
    name: FigureName,
    Params(query): Params<FigureQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let name = name.among(&OFFERED)?;
    let shown = Shown::read(&state, id).await?;
    let versions = [shown.record.version, shown.subject.version, shown.plant.version, shown.study.version];
    let tag = tag(&query, &[name, &id.to_string(), &shown.record.sha256, &format!("{versions:?}")]);
    if let Some(response) = unchanged(&headers, &tag) {
        return Ok(response);
    }
    let trial = state.store.trial_signals(id).await?;
    let figure = move || {
        let origin = shown.origin();
        if name == signals::NAME {
            return Ok(signals(&trial, &origin));
        }
        if name == spectra::NAME {
            return Ok(spectra(&trial, &origin));
        }
        plant_check(&trial, &shown.plant.model, &origin).ok_or_else(|| {
            Problem::new(
                Code::Invalid,
                "nothing to judge",
                "the plant cannot be sampled, or has several channels, or the output never moves",
            )
        })
    };
    answer(&state, &headers, query, Some(tag), figure).await
}
