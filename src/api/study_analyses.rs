//! One analysis for each trial of a study that matches a filter, and how far they are.

use super::analyses::{Checked, check};
use super::bulk_requests::{self, Alike, BulkEach, BulkOf, OfAnalyses};
use super::checks::MAX_NAME;
use super::etag::IfNoneMatch;
use super::extract::{FromQuery, Id, Integer, Json, Params, QueryText, from_value, off_thread};
use super::idempotency::{IDEMPOTENT_REPLAYED, Idempotency, IdempotencyHeader};
use super::learning_inputs::spec_sha256;
use super::problem::{ApiResult, unless_missing};
use super::state::AppState;
use super::studies::StudyPath;
use crate::analysis::ids::{AnalysisId, PlantId, StudyId, SubjectId, TrialId};
use crate::analysis::{Code, Kind, Problem, registry};
use crate::jobs::{Status, run_eta_s};
use crate::store::{Existing, Made, NewAnalysis, Only, RunFilter, RunProgress, TrialFilter, TrialRecord};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::Response;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use utoipa::IntoParams;

/// What to compute, and of which trials.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(example = serde_json::json!({
    "kind": "ssid", "spec": {"pool": "zhang2015_appendix_b"}, "filter": {"group": "gm"}
}))]
pub(crate) struct BulkRequest {
    /// The kind; one that takes what `each` names.
    #[schemars(with = "Kind")]
    kind: String,
    /// What one analysis is made of: a `trial` (the default); a `subject`, all its trials together; a `session` of a
    /// subject; or an earlier `analysis`, whose gains are asked about.
    #[serde(default)]
    each: BulkEach,
    /// Inputs beside the trials, for all alike, such as the `plant` of kinds that take one. Default: none.
    #[serde(default)]
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    inputs: Map<String, Value>,
    /// Which earlier analyses, with `each: analysis`: the newest that succeeded for the same trials.
    #[serde(default)]
    of: Option<BulkOf>,
    /// How it is computed, for every trial alike.
    #[serde(default = "empty")]
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    spec: Value,
    /// Which trials; without it, all of the study.
    #[serde(default = "empty")]
    #[schemars(with = "BulkFilter")]
    filter: Value,
    /// Which of them are queued: `missing` (the default), those that nobody has asked for in the same words or that
    /// failed or were cancelled; or `all`, once more.
    #[serde(default)]
    only: BulkOnly,
}

/// Which analyses of a bulk request are queued.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum BulkOnly {
    /// Those for which no analysis with the same inputs and spec is queued, running or succeeded.
    #[default]
    Missing,
    /// All of them, whatever there is.
    All,
}

fn empty() -> Value {
    json!({})
}

/// Which trials of a study: those for which everything given holds.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct BulkFilter {
    /// Of subjects of this group.
    #[schemars(length(max = 200))]
    group: Option<String>,
    /// Of this subject.
    subject: Option<SubjectId>,
    /// On this plant.
    plant: Option<PlantId>,
    /// In this session.
    #[schemars(with = "Option<i64>")]
    session: Option<Integer>,
    /// With this number or a greater one.
    #[schemars(with = "Option<i64>")]
    number_from: Option<Integer>,
    /// With this number or a smaller one.
    #[schemars(with = "Option<i64>")]
    number_to: Option<Integer>,
    /// Divergent trials too; they are skipped otherwise.
    include_divergent: bool,
    /// Excluded trials too; they are skipped otherwise.
    include_excluded: bool,
}

/// What was queued: a run.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct BulkAnswer {
    /// How many analyses were queued.
    created: usize,
    /// They, in the order of their first trials.
    analyses: Vec<BulkAnalysis>,
    /// Analyses that were asked for in the same words before, and were not queued again.
    existing: Vec<BulkExisting>,
    /// Trials that match but for a reason named.
    skipped: Vec<Skipped>,
    /// How far the run is, with what was queued in the same way before.
    progress: String,
}

/// An analysis that was queued.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct BulkAnalysis {
    /// The analysis.
    id: AnalysisId,
    /// Its trial, of several the first.
    trial: TrialId,
    /// How many trials it rests on.
    trials: u64,
    /// Their subject; null where they are of several.
    subject: Option<SubjectId>,
}

/// An analysis that was there already.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct BulkExisting {
    /// The analysis.
    id: AnalysisId,
    /// Its trial, of several the first.
    trial: TrialId,
    /// Where it stands.
    status: Status,
}

/// A trial that no analysis was queued for.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct Skipped {
    /// The trial.
    trial: TrialId,
    /// Why.
    reason: String,
}

/// Queues one analysis for each trial of the study that matches the filter, or for each subject, session or earlier
/// analysis, where there is none yet; all of them or none.
#[utoipa::path(post, path = "/v1/studies/{study}/analyses", tag = "analyses", operation_id = "create_study_analyses",
    params(StudyPath, IdempotencyHeader), request_body = BulkRequest,
    responses((status = 202, description = "Queued.", body = BulkAnswer)))]
pub(crate) async fn create(
    State(state): State<AppState>,
    Id(study): Id<StudyId>,
    Params(()): Params<()>,
    idempotency: Idempotency,
    body: Json<BulkRequest>,
) -> ApiResult<Response> {
    let key = idempotency.key(&body.bytes);
    let BulkRequest { kind, each, inputs, of, spec, filter, only } = body.value;
    kind.parse::<Kind>()?;
    let of = bulk_requests::named(each, of)?;
    let filter: BulkFilter = from_value(&filter, "/filter")?;
    state.store.study(study).await?;
    let (include_divergent, include_excluded) = (filter.include_divergent, filter.include_excluded);
    let left_out = |trial: &TrialRecord| {
        (trial.divergent && !include_divergent) || (trial.excluded.is_some() && !include_excluded)
    };
    let filter = checked(&state, study, filter).await?;
    let (skipped, trials): (Vec<TrialRecord>, Vec<TrialRecord>) =
        state.store.matching_trials(study, &filter).await?.into_iter().partition(left_out);
    let alike = Alike { kind: kind.clone(), inputs, spec };
    let sample = alike.sample(each);
    let OfAnalyses { requests, refused } = match of {
        Some(of) => bulk_requests::of_analyses(&state, study, &of, alike, &trials).await?,
        None => OfAnalyses { requests: alike.of_trials(each, &trials), refused: Vec::new() },
    };
    let limit = state.limits.max_bulk_analyses;
    if requests.len() > limit {
        return Err(Problem::new(
            Code::Unaffordable,
            "too many analyses at once",
            format!("{} {each} match, and {limit} analyses are queued at most", requests.len(), each = each.plural()),
        )
        .at("/filter")
        .mend("Narrow the filter.")
        .into());
    }
    let (run, new) = off_thread(move || {
        let run = sample.map(|request| check(&request)).transpose()?.map(|checked| checked.new.spec_sha256);
        let new = requests
            .iter()
            .map(|request| {
                let Checked { new } = check(request)?;
                Ok(NewAnalysis { study: Some(study), ..new })
            })
            .collect::<Result<Vec<_>, Problem>>()?;
        Ok::<_, Problem>((run, new))
    })
    .await??;
    // Each earlier analysis brings settings of its own along: such a run is told by its kind alone.
    let spec = run.map_or_else(String::new, |run| format!("&spec={run}"));
    let progress = format!("/v1/studies/{study}/progress?kind={kind}{spec}");
    let only = match only {
        BulkOnly::Missing => Only::Missing,
        BulkOnly::All => Only::All,
    };
    let bulk = state.store.create_bulk(new, only, key.as_ref()).await?;
    let made = |Made { analysis, trial }: &Made| {
        let (id, uses) = (analysis.id, &analysis.uses);
        Some(BulkAnalysis {
            id,
            trial: (*trial)?,
            trials: uses.trials,
            subject: uses.subject.as_ref().map(|subject| subject.id),
        })
    };
    let analyses: Vec<BulkAnalysis> = bulk.made.iter().filter_map(made).collect();
    let existing = bulk.existing.into_iter();
    let existing = existing.map(|Existing { id, trial, status }| BulkExisting { id, trial, status }).collect();
    let left_out = skipped.into_iter().map(|trial| Skipped { trial: trial.id, reason: why_skipped(&trial) });
    let refused = refused
        .into_iter()
        .map(|(analysis, trial, problem)| Skipped { trial, reason: format!("analysis {analysis}: {problem}") });
    let skipped = left_out.chain(refused).collect();
    let answer = BulkAnswer { created: analyses.len(), analyses, existing, skipped, progress };
    let mut response = super::etag::tagged(StatusCode::ACCEPTED, &answer)?;
    if bulk.replayed {
        response.headers_mut().insert(IDEMPOTENT_REPLAYED, HeaderValue::from_static("true"));
    }
    Ok(response)
}

fn why_skipped(trial: &TrialRecord) -> String {
    match &trial.excluded {
        Some(reason) => format!("excluded: {reason}"),
        None => format!("divergent: |y| reaches {}, beyond the study's display limit", trial.max_abs_output),
    }
}

/// Which analyses of a study.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct RunQuery {
    /// Only those of this kind.
    #[param(nullable = false, inline)]
    kind: Option<Kind>,
    /// Only those with this `spec_sha256`: done in the same way.
    #[param(nullable = false, pattern = "^[0-9a-f]{64}$")]
    spec: Option<String>,
}

impl FromQuery for RunQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let kinds = registry::names();
        Ok(Self { kind: query.one_of("kind", &kinds, |text| text.parse().ok())?, spec: spec_sha256(query)? })
    }
}

/// How far the analyses of a study are.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct StudyProgress {
    /// Analyses that came to an end, whichever.
    done: u64,
    /// Analyses in all.
    total: u64,
    /// Seconds left, if it goes on as the latest did; null while none has succeeded or where nobody works on them.
    eta_s: Option<f64>,
    /// How many there are in each status.
    analyses: StatusCounts,
}

/// How many analyses there are in each status.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, JsonSchema)]
pub(crate) struct StatusCounts {
    /// Those that wait.
    queued: u64,
    /// Those that a worker computes.
    running: u64,
    /// Those that have a report.
    succeeded: u64,
    /// Those that have a problem instead.
    failed: u64,
    /// Those that somebody cancelled.
    cancelled: u64,
}

impl From<RunProgress> for StudyProgress {
    fn from(run: RunProgress) -> Self {
        let mut analyses = StatusCounts::default();
        for (status, count) in run.counts {
            *match status {
                Status::Queued => &mut analyses.queued,
                Status::Running => &mut analyses.running,
                Status::Succeeded => &mut analyses.succeeded,
                Status::Failed => &mut analyses.failed,
                Status::Cancelled => &mut analyses.cancelled,
            } = count;
        }
        let StatusCounts { queued, running, succeeded, failed, cancelled } = analyses;
        let done = succeeded + failed + cancelled;
        Self { done, total: done + queued + running, eta_s: run_eta_s(&run.latest_s, queued, running), analyses }
    }
}

/// Tells how far a study's analyses are: counts by status, and the time left.
#[utoipa::path(get, path = "/v1/studies/{study}/progress", tag = "analyses", operation_id = "study_progress",
    params(StudyPath, RunQuery, IfNoneMatch),
    responses((status = 200, description = "How far they are.", body = StudyProgress)))]
pub(crate) async fn progress(
    State(state): State<AppState>,
    Id(study): Id<StudyId>,
    Params(RunQuery { kind, spec }): Params<RunQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let run = state.store.run_progress(study, &RunFilter { kind, spec_sha256: spec }).await?;
    super::etag::conditional(&headers, &StudyProgress::from(run))
}

/// The filter for the store, which must name things of this study; divergent trials come along, to be named as skipped.
async fn checked(state: &AppState, study: StudyId, filter: BulkFilter) -> ApiResult<TrialFilter> {
    let bad = |field: &str, why: String| Problem::new(Code::Invalid, "bad filter", why).at(format!("/filter/{field}"));
    let BulkFilter { group, subject, plant, session, number_from, number_to, .. } = filter;
    let [session, number_from, number_to] = [session, number_from, number_to].map(|i| i.map(|Integer(i)| i));
    if group.as_ref().is_some_and(|group| group.chars().count() > MAX_NAME) {
        return Err(bad("group", format!("no group has more than {MAX_NAME} characters")).into());
    }
    if let Some(id) = subject {
        let subject = unless_missing(state.store.subject(id).await)?;
        if subject.is_none_or(|subject| subject.study != study) {
            return Err(bad("subject", format!("the study has no subject {id}")).into());
        }
    }
    if let Some(id) = plant {
        let plant = unless_missing(state.store.plant(id).await)?;
        if plant.is_none_or(|plant| plant.study != study) {
            return Err(bad("plant", format!("the study has no plant {id}")).into());
        }
    }
    if let (Some(from), Some(to)) = (number_from, number_to)
        && from > to
    {
        return Err(bad("number_to", format!("it is {to}, and number_from is {from}")).into());
    }
    let filter = TrialFilter { group, subject, plant, session, number_from, number_to, ..TrialFilter::default() };
    Ok(TrialFilter { include_divergent: true, ..filter })
}
