//! Analyses: asked for here, computed by workers.

use super::answer::{created, no_content};
use super::cursor::{List, PageQuery, Paged};
use super::etag::{self, IfNoneMatch};
use super::extract::{FromQuery, Json, Params, QueryText, off_thread};
use super::idempotency::{Idempotency, IdempotencyHeader, mark};
use super::named::{Named, View};
use super::prefer::{Prefer, PreferHeader};
use super::problem::{ApiResult, unless_missing};
use super::shorthand::written_out;
use super::state::AppState;
use super::timestamp::Timestamp;
use crate::analysis::ids::{AnalysisId, StudyId, SubjectId, TrialId};
use crate::analysis::report::sha256_json;
use crate::analysis::{Code, Incumbent, Kind, Plan, Problem, Report, Request, registry};
use crate::ctl::{Bracket, Phase};
use crate::jobs::Status;
use crate::store::{AnalysisFilter, AnalysisRecord, NewAnalysis, StoreError, SubjectName, TrialName};
use crate::trial::pointer;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use time::OffsetDateTime;
use utoipa::IntoParams;

/// An analysis: what was asked for and where it stands.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "Analysis")]
pub(crate) struct AnalysisView {
    /// Its id.
    id: AnalysisId,
    /// What is computed.
    kind: Kind,
    /// Where it stands.
    status: Status,
    /// How often a worker took it.
    attempts: u32,
    /// How far it is.
    progress: ProgressView,
    /// Whether somebody asked for it to be cancelled.
    cancel_requested: bool,
    /// What went wrong; only where the status is `failed`.
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<Problem>,
    /// The study of its inputs; null where the request carries its data itself.
    study: Option<StudyId>,
    /// The subject whose trials it uses; null where they are of several subjects, or none is stored.
    subject: Option<AnalysisSubject>,
    /// The stored trial that it uses; null where it uses several, or none.
    trial: Option<AnalysisTrial>,
    /// How many stored trials it uses.
    trials: u64,
    /// The request with every default filled in. Lists leave it out.
    #[serde(skip_serializing_if = "Option::is_none")]
    request: Option<Request>,
    /// SHA-256 of the spec with every default filled in: equal for analyses done in the same way.
    spec_sha256: String,
    /// Counts changes, from 1.
    version: i64,
    /// When it was made, UTC.
    #[serde(with = "time::serde::rfc3339")]
    #[schemars(with = "Timestamp")]
    created_at: OffsetDateTime,
    /// When the present or last attempt began.
    #[serde(with = "time::serde::rfc3339::option")]
    #[schemars(with = "Option<Timestamp>")]
    started_at: Option<OffsetDateTime>,
    /// When it came to its end, UTC; null before.
    #[serde(with = "time::serde::rfc3339::option")]
    #[schemars(with = "Option<Timestamp>")]
    finished_at: Option<OffsetDateTime>,
    /// When it last changed, UTC.
    #[serde(with = "time::serde::rfc3339")]
    #[schemars(with = "Timestamp")]
    updated_at: OffsetDateTime,
    /// Where to go on from here.
    links: AnalysisLinks,
}

/// Whose trials an analysis uses.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct AnalysisSubject {
    /// The subject.
    id: SubjectId,
    /// Its pseudonym.
    code: String,
}

/// The trial that an analysis uses.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct AnalysisTrial {
    /// The trial.
    id: TrialId,
    /// Its number.
    number: i64,
    /// Its session, where it has one.
    session: Option<i64>,
}

/// How far an analysis is, as of the last word from its worker.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "Progress")]
pub(crate) struct ProgressView {
    /// The share of the whole that is done, from 0 to 1. It never falls while an attempt goes on.
    fraction: f64,
    /// What the computation is at, or was at when it was stopped; null before it began and after it succeeded.
    phase: Option<Phase>,
    /// Units of the present count that are finished (candidates, trials, frequencies).
    done: u64,
    /// Units of the present count in all; 0 while that is not known.
    total: u64,
    /// Seconds left; null while that is not known.
    eta_s: Option<f64>,
    /// How near the search for a best candidate is; only while it goes on, and where it was cancelled or its time has
    /// passed.
    #[serde(skip_serializing_if = "Option::is_none")]
    bracket: Option<BracketView>,
}

/// Between which two values the smallest cost of a pool lies. An analysis may search several pools, one after another;
/// this is of the search under way, or of the last one.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "Bracket")]
pub(crate) struct BracketView {
    /// The smallest cost found so far.
    cost: f64,
    /// What every candidate is proven to cost at least.
    lower_bound: f64,
    /// The candidate with that cost, by its index in the pool.
    index: u64,
    /// (cost − lower_bound)/cost: from 1, nothing is proven, to 0, no candidate costs less.
    gap: f64,
    /// That candidate, where the search was stopped.
    #[serde(skip_serializing_if = "Option::is_none")]
    controllers: Option<Incumbent>,
}

impl BracketView {
    fn new(bracket: Bracket, controllers: Option<Incumbent>) -> Self {
        let Bracket { incumbent, bound, index } = bracket;
        Self { cost: incumbent, lower_bound: bound, index, gap: bracket.gap(), controllers }
    }
}

/// Where to go on from an analysis.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct AnalysisLinks {
    /// The analysis itself.
    #[serde(rename = "self")]
    itself: String,
    /// Its report, once it succeeded.
    report: String,
    /// Its life as server-sent events.
    events: String,
    /// Where to POST to cancel it.
    cancel: String,
}

/// A page of analyses.
pub(crate) type AnalysisList = List<AnalysisView>;

impl View for AnalysisView {
    type Record = AnalysisRecord;
}

impl From<AnalysisRecord> for AnalysisView {
    fn from(record: AnalysisRecord) -> Self {
        let request = record.request.clone();
        Self { request: Some(request), ..Self::brief(record) }
    }
}

impl AnalysisView {
    /// Without the request, which may carry data.
    #[must_use]
    pub(crate) fn brief(record: AnalysisRecord) -> Self {
        let itself = format!("/v1/analyses/{}", record.id);
        Self {
            id: record.id,
            kind: record.kind,
            status: record.status,
            attempts: record.attempts,
            progress: ProgressView {
                fraction: record.progress.fraction,
                phase: (!matches!(record.status, Status::Queued | Status::Succeeded)).then_some(record.progress.phase),
                done: record.progress.done,
                total: record.progress.total,
                eta_s: record.eta_s,
                bracket: record.bracket.map(|bracket| BracketView::new(bracket, record.incumbent)),
            },
            cancel_requested: record.cancel_requested,
            problem: record.problem,
            study: record.study,
            subject: record.uses.subject.map(|SubjectName { id, code }| AnalysisSubject { id, code }),
            trial: record.uses.trial.map(|TrialName { id, number, session }| AnalysisTrial { id, number, session }),
            trials: record.uses.trials,
            request: None,
            spec_sha256: record.spec_sha256,
            version: record.version,
            created_at: record.created_at,
            started_at: record.started_at,
            finished_at: record.finished_at,
            updated_at: record.updated_at,
            links: AnalysisLinks {
                report: format!("{itself}/report"),
                events: format!("{itself}/events"),
                cancel: format!("{itself}/cancel"),
                itself,
            },
        }
    }
}

const STATUSES: [Status; 5] = [Status::Queued, Status::Running, Status::Succeeded, Status::Failed, Status::Cancelled];

/// Names an analysis in the path.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "documents the path")]
pub(crate) struct AnalysisPath {
    /// The analysis.
    analysis: AnalysisId,
}

/// Which analyses.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct AnalysisQuery {
    /// Only those of this study.
    #[param(nullable = false)]
    study: Option<StudyId>,
    /// Only those that use this trial.
    #[param(nullable = false)]
    trial: Option<TrialId>,
    /// Only those of this kind.
    #[param(nullable = false, inline)]
    kind: Option<Kind>,
    /// Only those in this status.
    #[param(nullable = false, inline)]
    status: Option<Status>,
    /// In which order: `created` (the default), or `-created` for the newest first.
    #[param(value_type = Option<String>, required = false, nullable = false, default = "created",
        pattern = "^-?created$")]
    sort: bool,
}

impl FromQuery for AnalysisQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let kinds = registry::names();
        let statuses = STATUSES.map(Status::name).join(", ");
        Ok(Self {
            study: query.id("study")?,
            trial: query.id("trial")?,
            kind: query.one_of("kind", &kinds, |text| text.parse().ok())?,
            status: query.one_of("status", &statuses, Status::from_name)?,
            sort: query.one_of("sort", "created, -created", newest_first)?.unwrap_or_default(),
        })
    }
}

/// Whether an order has the newest first.
fn newest_first(order: &str) -> Option<bool> {
    match order {
        "created" => Some(false),
        "-created" => Some(true),
        _ => None,
    }
}

/// A checked request, ready to be queued.
pub(crate) struct Checked {
    pub(crate) new: NewAnalysis,
}

/// Checks a request; specs can be large grids, so this is work for a blocking thread.
pub(crate) fn check(request: &Request) -> Result<Checked, Problem> {
    let plan = Plan::parse(request)?;
    let canonical = plan.request();
    let references = plan.references();
    Ok(Checked {
        new: NewAnalysis {
            study: None,
            kind: plan.kind(),
            spec_sha256: sha256_json(&canonical.spec),
            request: canonical,
            trials: references.trials,
            plants: references.plants,
            analyses: references.analyses,
        },
    })
}

/// The pointer of the first string within `value` that equals `text`.
fn pointer_to(value: &Value, text: &str, at: &str) -> Option<String> {
    match value {
        Value::String(found) => (found.eq_ignore_ascii_case(text)).then(|| at.to_owned()),
        Value::Array(items) => {
            items.iter().enumerate().find_map(|(i, item)| pointer_to(item, text, &format!("{at}/{i}")))
        }
        Value::Object(fields) => {
            fields.iter().find_map(|(key, item)| pointer_to(item, text, &pointer::member(at, key)))
        }
        _ => None,
    }
}

/// Where the inputs name `id`.
fn place_of(inputs: &Value, id: &str) -> String {
    pointer_to(inputs, id, "/inputs").unwrap_or_else(|| "/inputs".to_owned())
}

fn no_such(noun: &str, id: &str, inputs: &Value) -> Problem {
    Problem::new(Code::Invalid, format!("no such {noun}"), format!("there is no {noun} {id}")).at(place_of(inputs, id))
}

/// The study that everything referred to is of; `None` where nothing is.
async fn study_of(state: &AppState, new: &NewAnalysis, inputs: &Value) -> ApiResult<Option<StudyId>> {
    let missing = |noun: &str, id: &str| no_such(noun, id, inputs).mend("Check the id; it may have been deleted.");
    let mut found: Option<(StudyId, String)> = None;
    let mut join = |study: StudyId, id: String| match &found {
        Some((first, other)) if *first != study => Err(Problem::new(
            Code::Invalid,
            "inputs of several studies",
            format!("{id} is of study {study}, {other} of study {first}"),
        )
        .at(place_of(inputs, &id))
        .mend("Name inputs of one study only.")),
        Some(_) => Ok(()),
        None => {
            found = Some((study, id));
            Ok(())
        }
    };
    for trial in &new.trials {
        let id = trial.to_string();
        let record = unless_missing(state.store.trial(*trial).await)?.ok_or_else(|| missing("trial", &id))?;
        join(record.study, id)?;
    }
    for plant in &new.plants {
        let id = plant.to_string();
        let record = unless_missing(state.store.plant(*plant).await)?.ok_or_else(|| missing("plant", &id))?;
        join(record.study, id)?;
    }
    for analysis in &new.analyses {
        let id = analysis.to_string();
        let record = unless_missing(state.store.analysis(*analysis).await)?.ok_or_else(|| missing("analysis", &id))?;
        if let Some(study) = record.study {
            join(study, id)?;
        }
    }
    Ok(found.map(|(study, _)| study))
}

/// Queues an analysis.
///
/// `inputs` names stored trials and plants by id, or carries the data itself; `spec` says how it is computed. Both
/// depend on the kind. `{"subject": ID}` stands for all trials of a subject, `{"analysis": ID}` for the gains that an
/// earlier analysis found: the request is stored with what they stand for.
#[utoipa::path(post, path = "/v1/analyses", tag = "analyses", operation_id = "create_analysis",
    params(IdempotencyHeader, PreferHeader),
    request_body(content = Request, example = json!({
        "kind": "ssid",
        "inputs": {"trial": "0199d2f4-7a3c-7bb0-8a41-2f6a7e1c9d10"},
        "spec": {"pool": "zhang2015_appendix_b"}
    })),
    responses(
        (status = 200, description = "It was waited for (`Prefer: wait`), and is finished.", body = AnalysisView),
        (status = 202, description = "Queued; Location names the analysis, which says how it goes on.",
            body = AnalysisView),
        (status = 409, description = "The earlier analysis that it names has no report.")))]
pub(crate) async fn create(
    State(state): State<AppState>,
    Params(()): Params<()>,
    idempotency: Idempotency,
    prefer: Prefer,
    body: Json<Request>,
) -> ApiResult<Response> {
    let key = idempotency.key(&body.bytes);
    let request = written_out(&state, body.value).await?;
    let inputs = request.inputs.clone();
    let Checked { mut new } = off_thread(move || check(&request)).await??;
    new.study = study_of(&state, &new, &inputs).await?;
    let made = match state.store.create_analysis(new, key.as_ref()).await {
        // Deleted between the look above and the write.
        Err(StoreError::NotFound { noun, id }) => return Err(no_such(noun, &id, &inputs).into()),
        other => other?,
    };
    let record = prefer.awaited(&state, made.clone().into_inner().id).await?;
    let status = if prefer.asks() && record.status.is_final() { StatusCode::OK } else { StatusCode::ACCEPTED };
    let view = AnalysisView::from(record);
    let location = view.links.itself.clone();
    let response = prefer.applied(&state, etag::tagged(status, &view)?);
    Ok(mark(created(response, location), &made))
}

/// Lists analyses.
#[utoipa::path(get, path = "/v1/analyses", tag = "analyses", operation_id = "list_analyses",
    params(AnalysisQuery, PageQuery, IfNoneMatch),
    responses((status = 200, description = "A page of analyses, without their requests; as NDJSON all of them, one a \
        line.", content((AnalysisList = "application/json"), (AnalysisView = "application/x-ndjson")))))]
pub(crate) async fn list(list: Paged<AnalysisQuery>) -> ApiResult<Response> {
    let AnalysisQuery { study, trial, kind, status, sort } = list.filter.clone();
    let (store, filter) = (list.state.store.clone(), AnalysisFilter { study, trial, kind, status });
    let rows = move |page| {
        let (store, filter) = (store.clone(), filter.clone());
        async move { store.listed_analyses(&filter, sort, page).await }
    };
    list.answer(rows, |analysis| analysis.id.0, AnalysisView::brief).await
}

/// Reads an analysis: its status, attempts and progress.
#[utoipa::path(get, path = "/v1/analyses/{analysis}", tag = "analyses", operation_id = "read_analysis",
    params(AnalysisPath, PreferHeader, IfNoneMatch),
    responses((status = 200, description = "The analysis.", body = AnalysisView)))]
pub(crate) async fn read(prefer: Prefer, analysis: Named<AnalysisView>) -> ApiResult<Response> {
    let Named { state, id, headers } = analysis;
    let record = prefer.awaited(&state, id).await?;
    Ok(prefer.applied(&state, etag::conditional(&headers, &AnalysisView::from(record))?))
}

/// The report's text, or why there is none.
pub(crate) async fn report_text(state: &AppState, id: AnalysisId) -> ApiResult<String> {
    if let Some(text) = state.store.report_json(id).await? {
        return Ok(text);
    }
    let record = state.store.analysis(id).await?;
    let status = record.status.name();
    let (title, mend) = match record.status {
        Status::Failed => ("failed", "GET the analysis: its problem says why."),
        Status::Cancelled => ("cancelled", "Queue the analysis again."),
        _ => ("not finished", "Follow its events, or ask again later."),
    };
    Err(Problem::new(Code::Conflict, title, format!("the analysis is {status} and has no report")).mend(mend).into())
}

/// Reads the report, byte for byte as the worker wrote it.
#[utoipa::path(get, path = "/v1/analyses/{analysis}/report", tag = "analyses", operation_id = "read_report",
    params(AnalysisPath, IfNoneMatch),
    responses((status = 200, description = "The report.", body = Report),
        (status = 409, description = "There is no report: the analysis is not finished, failed, or was cancelled.")))]
pub(crate) async fn report(analysis: Named<AnalysisView>) -> ApiResult<Response> {
    let text = report_text(&analysis.state, analysis.id).await?;
    Ok(etag::conditional_bytes(&analysis.headers, "application/json", text.into_bytes()))
}

/// Cancels an analysis: a queued one at once, a running one within moments. A finished one stays as it is.
#[utoipa::path(post, path = "/v1/analyses/{analysis}/cancel", tag = "analyses", operation_id = "cancel_analysis",
    params(AnalysisPath),
    responses((status = 200, description = "It is finished: cancelled now, or finished before.", body = AnalysisView),
        (status = 202, description = "It is running and will stop.", body = AnalysisView)))]
pub(crate) async fn cancel(analysis: Named<AnalysisView>) -> ApiResult<Response> {
    let record = analysis.state.store.request_cancel(analysis.id).await?;
    let status = if record.status.is_final() { StatusCode::OK } else { StatusCode::ACCEPTED };
    etag::tagged(status, &AnalysisView::from(record))
}

/// Deletes an analysis with its report. A running one is abandoned.
#[utoipa::path(delete, path = "/v1/analyses/{analysis}", tag = "analyses", operation_id = "delete_analysis",
    params(AnalysisPath), responses((status = 204, description = "It is gone.")))]
pub(crate) async fn delete(analysis: Named<AnalysisView>) -> ApiResult<Response> {
    analysis.state.store.delete::<AnalysisRecord>(analysis.id, None).await?;
    Ok(no_content())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn references_are_found_in_the_inputs() {
        let inputs = json!({"trials": ["a", "b"], "plant": "c"});
        assert_eq!(pointer_to(&inputs, "B", "/inputs").as_deref(), Some("/inputs/trials/1"));
        assert_eq!(pointer_to(&inputs, "c", "/inputs").as_deref(), Some("/inputs/plant"));
        assert_eq!(pointer_to(&inputs, "d", "/inputs"), None);
    }
}
