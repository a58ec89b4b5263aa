//! Gathers from the store what learning curves and mean controllers are made from.

use super::extract::{FromQuery, QueryText, off_thread};
use super::problem::{ApiResult, unless_missing};
use super::state::AppState;
use crate::analysis::ids::{AnalysisId, PlantId, StudyId, SubjectId, TrialId};
use crate::analysis::{Analysis as _, Code, Kind, Problem, prediction_error, ssid, two_stimulus};
use crate::learning::inputs::{Estimator, Identification, PlantName, Remark, SubjectInput, TrialInput};
use crate::learning::{CurveOptions, time_domain::TimeDomainMetrics};
use crate::num::hexadecimal;
use crate::store::{Page, Plant, StoreError, Subject, TrialEstimate, TrialFilter, TrialRecord};
use std::collections::BTreeMap;
use utoipa::IntoParams;
use uuid::Uuid;

/// Rows fetched at once.
const PAGE: u32 = 500;

/// Which trials, and how they are shown.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct CurveQuery {
    /// Only trials on this plant.
    #[param(nullable = false)]
    pub(crate) plant: Option<PlantId>,
    /// Only trials of this session.
    #[param(nullable = false, minimum = 0, maximum = 1000000000)]
    pub(crate) session: Option<i64>,
    /// Whether divergent trials are shown.
    #[param(required = false, default = false)]
    pub(crate) include_divergent: bool,
    /// Whether trials are shown that somebody excluded; they are named and left out otherwise.
    #[param(required = false, default = false)]
    pub(crate) include_excluded: bool,
    /// Which estimate of the controllers is shown: `ssid`, `ssid_refined`, `two_stimulus` or `prediction_error`. The
    /// others are compared with it where both have intervals.
    #[param(value_type = Option<String>, nullable = false,
        pattern = "^(ssid|ssid_refined|two_stimulus|prediction_error)$", default = "ssid")]
    pub(crate) estimator: Estimator,
    /// With `prediction_error`, show analyses that combine several trials, with what they say of each, instead of those
    /// of single trials.
    #[param(required = false, default = false)]
    pub(crate) joint: bool,
    /// Show the identifications with this `spec_sha256`; without it, those with the spec that covers most
    /// trials.
    #[param(nullable = false, pattern = "^[0-9a-f]{64}$")]
    pub(crate) spec: Option<String>,
    /// Values dropped at each end in trimmed statistics.
    #[param(required = false, minimum = 0, maximum = 1000, default = 1)]
    pub(crate) trim: usize,
}

/// The parameter `spec`.
pub(super) fn spec_sha256(query: &mut QueryText) -> Result<Option<String>, Problem> {
    query.one_of("spec", "64 hexadecimal digits", |text| {
        hexadecimal::bytes(text).filter(|bytes| bytes.len() == 32).map(|_| text.to_owned())
    })
}

/// The parameter `estimator`.
pub(crate) fn estimator(query: &mut QueryText) -> Result<Option<Estimator>, Problem> {
    let names = Estimator::ALL.map(Estimator::name).join(", ");
    query.one_of("estimator", &names, |text| Estimator::ALL.into_iter().find(|e| e.name() == text))
}

/// The kind of analysis that an estimator comes from.
pub(crate) fn kind_of(estimator: Estimator) -> Kind {
    match estimator {
        Estimator::Ssid | Estimator::SsidRefined => ssid::Plan::KIND,
        Estimator::TwoStimulus => two_stimulus::Plan::KIND,
        Estimator::PredictionError => prediction_error::Plan::KIND,
    }
}

impl FromQuery for CurveQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let spec = spec_sha256(query)?;
        Ok(Self {
            estimator: estimator(query)?.unwrap_or_default(),
            joint: query.flag("joint")?,
            plant: query.id("plant")?,
            session: query.integer("session", 0, super::trials::MAX_NUMBER)?,
            include_divergent: query.flag("include_divergent")?,
            include_excluded: query.flag("include_excluded")?,
            spec,
            trim: query.integer("trim", 0, 1000)?.map_or(CurveOptions::default().trim, |trim| trim as usize),
        })
    }
}

impl CurveQuery {
    /// All trials, by this estimator.
    #[must_use]
    pub(crate) fn by(estimator: Estimator) -> Self {
        Self {
            plant: None,
            session: None,
            include_divergent: false,
            include_excluded: false,
            estimator,
            joint: false,
            spec: None,
            trim: CurveOptions::default().trim,
        }
    }

    /// What `learning` is asked for.
    pub(crate) fn options(&self) -> CurveOptions {
        CurveOptions {
            include_divergent: self.include_divergent,
            estimator: self.estimator,
            spec_sha256: self.spec.clone(),
            trim: self.trim,
            ..CurveOptions::default()
        }
    }
}

/// What was gathered.
pub(crate) struct Gathered {
    pub(crate) subjects: Vec<SubjectInput>,
    pub(crate) remarks: Vec<Remark>,
}

/// The trials of a study that the query asks for, with what was identified from them.
pub(crate) async fn gather(
    state: &AppState,
    study: StudyId,
    subject: Option<Subject>,
    group: Option<String>,
    query: &CurveQuery,
) -> ApiResult<Gathered> {
    if let Some(id) = query.plant {
        let plant = unless_missing(state.store.plant(id).await)?;
        if plant.is_none_or(|plant| plant.study != study) {
            let detail = format!("the study has no plant {id}");
            return Err(Problem::new(Code::NotFound, "no such plant", detail).at("query parameter plant").into());
        }
    }
    let filter = TrialFilter {
        group,
        subject: subject.as_ref().map(|subject| subject.id),
        plant: query.plant,
        session: query.session,
        // Left-out trials are counted and named, so they are fetched too.
        include_divergent: true,
        ..TrialFilter::default()
    };
    let trials = state.store.matching_trials(study, &filter).await?;
    let (excluded, trials): (Vec<_>, Vec<_>) =
        trials.into_iter().partition(|trial| trial.excluded.is_some() && !query.include_excluded);
    let ids: Vec<_> = trials.iter().map(|trial| trial.id).collect();
    if query.joint && query.estimator != Estimator::PredictionError {
        let detail = format!("a report of {} about several trials says nothing of each", query.estimator.name());
        return Err(Problem::new(Code::Invalid, "no joint estimates", detail)
            .at("query parameter joint")
            .mend("Ask for estimator=prediction_error, or leave it out.")
            .into());
    }
    let (estimates, damaged) = estimates(state, &ids, query).await?;
    let shown = query.estimator;
    let plants = everything(|page| state.store.plants(study, page), |plant| plant.id.0).await?;
    let subjects = match subject {
        Some(subject) => vec![subject],
        None => {
            everything(|page| state.store.subjects(study, filter.group.as_deref(), page), |subject| subject.id.0)
                .await?
        }
    };
    let mut gathered = off_thread(move || assemble(subjects, plants, trials, estimates, shown)).await??;
    gathered.remarks.extend(damaged);
    gathered.remarks.extend(left_out(&excluded));
    if let Some(spec) = &query.spec {
        let mut identified = gathered.subjects.iter().flat_map(|s| &s.trials).flat_map(|t| &t.identifications);
        if !identified.any(|i| i.spec_sha256 == *spec) {
            let detail = format!("none of the trials was identified with the spec {spec}");
            return Err(Problem::new(Code::NotFound, "no such spec", detail)
                .at("query parameter spec")
                .mend(format!(
                    "Give the spec_sha256 of a succeeded {} analysis of these trials.",
                    kind_of(query.estimator).name()
                ))
                .into());
        }
    }
    Ok(gathered)
}

/// What was said of trials that somebody excluded; `None` where none was left out.
pub(super) fn left_out_in(remarks: &[Remark]) -> Option<&Remark> {
    remarks.iter().find(|remark| remark.code == "excluded_left_out")
}

/// Excluded trials that a remark names at most.
const NAMED: usize = 20;

/// That excluded trials are left out, which and why.
fn left_out(excluded: &[TrialRecord]) -> Option<Remark> {
    let name = |trial: &TrialRecord| {
        let session = trial.session.map_or_else(String::new, |session| format!(" of session {session}"));
        let reason = trial.excluded.as_deref().unwrap_or_default();
        format!("{} trial {}{session} ({reason})", trial.subject_code, trial.number)
    };
    let mut named: Vec<String> = excluded.iter().take(NAMED).map(name).collect();
    if let Some(more) = excluded.len().checked_sub(NAMED).filter(|more| *more > 0) {
        named.push(format!("and {more} more"));
    }
    (!excluded.is_empty()).then(|| Remark {
        code: "excluded_left_out".to_owned(),
        message: format!("{} excluded trials are left out: {}", excluded.len(), named.join("; ")),
    })
}

/// What was found of these trials, by estimator, and remarks on what is damaged.
async fn estimates(
    state: &AppState,
    ids: &[TrialId],
    query: &CurveQuery,
) -> ApiResult<(Vec<(Estimator, TrialEstimate)>, Vec<Remark>)> {
    let joint = query.joint.then(|| query.estimator.name());
    let all = state.store.estimates_of_trials(ids, joint).await?;
    let named = |name: &str| Estimator::ALL.into_iter().find(|estimator| estimator.name() == name);
    let found = all.found.into_iter().filter_map(|own| Some((named(&own.estimator)?, own))).collect();
    let damaged = all.damaged.into_iter().filter(|(_, estimator, _)| estimator == query.estimator.name());
    let remark = |(analysis, ..): (AnalysisId, String, String)| Remark {
        code: "report_not_used".to_owned(),
        message: format!("what analysis {analysis} found is left out: it is damaged in the database"),
    };
    Ok((found, damaged.map(remark).collect()))
}

/// One trial, with what was identified from it.
pub(crate) async fn gather_trial(
    state: &AppState,
    trial: TrialRecord,
    subject: Subject,
    plant: Plant,
    query: &CurveQuery,
) -> ApiResult<Gathered> {
    let (estimates, damaged) = estimates(state, &[trial.id], query).await?;
    let shown = query.estimator;
    let mut gathered =
        off_thread(move || assemble(vec![subject], vec![plant], vec![trial], estimates, shown)).await??;
    gathered.remarks.extend(damaged);
    Ok(gathered)
}

/// Every row of a list.
pub(in crate::api) async fn everything<T, F>(
    mut page: impl FnMut(Page) -> F,
    id: impl Fn(&T) -> Uuid,
) -> Result<Vec<T>, StoreError>
where
    F: Future<Output = Result<Vec<T>, StoreError>>,
{
    let mut rows: Vec<T> = Vec::new();
    loop {
        let next = page(Page { after: rows.last().map(&id), limit: PAGE }).await?;
        let last = next.len() < PAGE as usize;
        rows.extend(next);
        if last {
            return Ok(rows);
        }
    }
}

fn assemble(
    subjects: Vec<Subject>,
    plants: Vec<Plant>,
    trials: Vec<TrialRecord>,
    estimates: Vec<(Estimator, TrialEstimate)>,
    shown: Estimator,
) -> Result<Gathered, Problem> {
    let plants: BTreeMap<PlantId, Plant> = plants.into_iter().map(|plant| (plant.id, plant)).collect();
    let mut remarks = Vec::new();
    let mut by_trial: BTreeMap<_, Vec<(Estimator, TrialEstimate)>> = BTreeMap::new();
    for (estimator, own) in estimates {
        by_trial.entry(own.trial).or_default().push((estimator, own));
    }
    let mut by_subject: BTreeMap<SubjectId, Vec<TrialInput>> = BTreeMap::new();
    for trial in trials {
        // A plant made after the list was read has no trial in it.
        let Some(plant) = plants.get(&trial.plant) else { continue };
        let (mut identifications, mut by_other_estimators): (Vec<Identification>, Vec<Identification>) =
            Default::default();
        for (estimator, own) in by_trial.remove(&trial.id).unwrap_or_default() {
            let analysis = own.analysis.to_string();
            match own.estimate.identification(estimator, analysis, own.spec_sha256) {
                Ok(found) if estimator == shown => identifications.push(found),
                Ok(found) => by_other_estimators.push(found),
                Err(_) if estimator != shown => {}
                Err(why) => remarks.push(Remark {
                    code: "report_not_used".to_owned(),
                    message: format!("the report of analysis {} is left out: {why}", own.analysis),
                }),
            }
        }
        let metrics: TimeDomainMetrics = serde_json::from_value(trial.metrics).map_err(|error| {
            tracing::error!(trial = %trial.id, %error, "stored metrics cannot be read");
            super::problem::internal()
        })?;
        by_subject.entry(trial.subject).or_default().push(TrialInput {
            trial: trial.id.to_string(),
            number: trial.number,
            session: trial.session,
            plant: PlantName { id: plant.id.to_string(), name: plant.name.clone() },
            divergent: trial.divergent,
            excluded: trial.excluded,
            metrics,
            identifications,
            by_other_estimators,
        });
    }
    let subjects = subjects
        .into_iter()
        .map(|subject| SubjectInput {
            trials: by_subject.remove(&subject.id).unwrap_or_default(),
            subject: subject.id.to_string(),
            code: subject.code,
            group: subject.group,
        })
        .collect();
    Ok(Gathered { subjects, remarks })
}
