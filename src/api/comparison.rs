//! The comparison of a study's groups.

use super::etag::IfNoneMatch;
use super::extract::{FromQuery, Id, Params, QueryText, off_thread};
use super::forms::{self, AcceptForm, FormQuery};
use super::learning_inputs::{CurveQuery, Gathered, estimator, gather, spec_sha256};
use super::problem::ApiResult;
use super::state::AppState;
use super::studies::StudyPath;
use crate::analysis::ids::{PlantId, StudyId, TrialId};
use crate::analysis::{Code, Problem};
use crate::control::Model;
use crate::exchange::tables::comparison as tables;
use crate::learning::comparison::multiple::Correction;
use crate::learning::comparison::people::{Contrast, CurveForm};
use crate::learning::comparison::study::{NoComparison, first_and_last_trials};
use crate::learning::curves::Metric;
use crate::learning::inputs::Estimator;
use crate::learning::{ComparisonOptions, StudyComparison, compare};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, BTreeSet};
use utoipa::IntoParams;

/// Seeds are exact in JSON.
const MOST_SEED: i64 = 1 << 53;

/// What is compared, and how.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct ComparisonQuery {
    /// Only these groups, separated by commas; without it, all (six pairs at most).
    #[param(value_type = Option<String>, nullable = false, example = "gm,gn")]
    groups: Option<Vec<String>>,
    /// Only trials on this plant.
    #[param(nullable = false)]
    plant: Option<PlantId>,
    /// Only trials of this session.
    #[param(nullable = false, minimum = 0, maximum = 1000000000)]
    session: Option<i64>,
    /// Which estimate of the controllers the norms are of: `ssid`, `ssid_refined`, `two_stimulus` or
    /// `prediction_error`.
    #[param(value_type = Option<String>, nullable = false,
        pattern = "^(ssid|ssid_refined|two_stimulus|prediction_error)$", default = "ssid")]
    estimator: Estimator,
    /// With `prediction_error`, analyses that combine several trials, with what they say of each.
    #[param(required = false, default = false)]
    joint: bool,
    /// Compare the identifications with this `spec_sha256`; without it, those with the spec that covers most
    /// trials.
    #[param(nullable = false, pattern = "^[0-9a-f]{64}$")]
    spec: Option<String>,
    /// The metrics, separated by commas: `mean_abs_error`, `rms_error`, `norm_feedback`,
    /// `norm_feedforward_minus_inverse`, `norm_feedforward_plant_minus_one`, `variance_accounted_for`,
    /// `control_log_dimensionless_jerk` (smoothness of u). Each more costs power, since p-values are adjusted for all.
    #[param(value_type = Option<String>, nullable = false, pattern = "^[a-z_]+(,[a-z_]+)*$",
        default = "mean_abs_error,norm_feedback,norm_feedforward_plant_minus_one")]
    metrics: Vec<Metric>,
    /// What is compared of each, separated by commas: `first`, `last`, `change`, `retention` (between sessions).
    #[param(value_type = Option<String>, nullable = false, pattern = "^[a-z]+(,[a-z]+)*$",
        default = "first,last,change,retention")]
    contrasts: Vec<Contrast>,
    /// What a person's first and last value are: those of a fitted curve (`exponential`, `power`), or the `trials`
    /// themselves.
    #[param(value_type = Option<String>, nullable = false, pattern = "^(exponential|power|trials)$",
        default = "exponential")]
    curve: CurveForm,
    /// How p-values of several tests are adjusted: `holm` or `benjamini_hochberg`.
    #[param(value_type = Option<String>, nullable = false, pattern = "^(holm|benjamini_hochberg)$", default = "holm")]
    correction: Correction,
    /// People whose first or last value is an extrapolation beyond their own trials: `leave_out` of means and tests, or
    /// `take_in`.
    #[param(value_type = Option<String>, nullable = false, pattern = "^(leave_out|take_in)$", default = "leave_out")]
    extrapolated: bool,
    /// The threshold on |u|, in units of u, above which the first control of a trial counts as deliberate.
    #[param(required = false, exclusive_minimum = 0, default = 0.05)]
    right_control_threshold: f64,
    /// Trials that retention averages over at the end of a session and at the start of the next, at most.
    #[param(required = false, minimum = 1, maximum = 1000, default = 5)]
    retention_trials: usize,
    /// The seed of random allocations, where there are more than three million of them.
    #[param(required = false, minimum = 0, maximum = 9007199254740992_i64, default = 1)]
    seed: u64,
}

/// A list of names separated by commas, each once.
fn list<T: DeserializeOwned + PartialEq>(
    query: &mut QueryText,
    name: &'static str,
    known: &str,
) -> Result<Option<Vec<T>>, Problem> {
    query.one_of(name, known, |text| {
        let mut found: Vec<T> = Vec::new();
        for word in text.split(',') {
            let one = parse(word)?;
            if !found.contains(&one) {
                found.push(one);
            }
        }
        Some(found)
    })
}

/// A name as serde writes it.
fn parse<T: DeserializeOwned>(word: &str) -> Option<T> {
    serde_json::from_value(serde_json::Value::from(word)).ok()
}

impl FromQuery for ComparisonQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let default = ComparisonOptions::default();
        let groups = query.one_of("groups", "group names, separated by commas", |text| {
            let names: Vec<String> = text.split(',').map(str::to_owned).collect();
            names.iter().all(|name| !name.is_empty()).then_some(names)
        })?;
        let metrics = "the metrics, separated by commas (see the OpenAPI document)";
        let threshold = query.number("right_control_threshold")?.unwrap_or(default.right_control_threshold);
        if threshold <= 0.0 {
            return Err(Problem::new(Code::Malformed, "bad query parameter", format!("{threshold} is not positive"))
                .at("query parameter right_control_threshold"));
        }
        let settings = default.settings;
        let seed = query.integer("seed", 0, MOST_SEED)?.map_or(settings.seed, i64::unsigned_abs);
        let block = query.integer("retention_trials", 1, 1000)?.map(|n| n as usize);
        Ok(Self {
            groups,
            plant: query.id("plant")?,
            session: query.integer("session", 0, super::trials::MAX_NUMBER)?,
            estimator: estimator(query)?.unwrap_or_default(),
            joint: query.flag("joint")?,
            spec: spec_sha256(query)?,
            metrics: list(query, "metrics", metrics)?.unwrap_or(default.metrics),
            contrasts: list(query, "contrasts", "first, last, change, retention")?.unwrap_or(settings.contrasts),
            curve: query.one_of("curve", "exponential, power, trials", parse)?.unwrap_or(settings.form),
            correction: query.one_of("correction", "holm, benjamini_hochberg", parse)?.unwrap_or(default.correction),
            extrapolated: query
                .one_of("extrapolated", "leave_out, take_in", |text| match text {
                    "leave_out" => Some(true),
                    "take_in" => Some(false),
                    _ => None,
                })?
                .unwrap_or(settings.leave_out_extrapolated),
            right_control_threshold: threshold,
            retention_trials: block.unwrap_or(settings.retention_trials),
            seed,
        })
    }
}

impl ComparisonQuery {
    /// These groups or all, by an estimator, with these first and last values of people.
    #[must_use]
    pub(crate) fn by(groups: Option<Vec<String>>, estimator: Estimator, curve: CurveForm) -> Self {
        let default = ComparisonOptions::default();
        Self {
            groups,
            plant: None,
            session: None,
            estimator,
            joint: false,
            spec: None,
            metrics: default.metrics,
            contrasts: default.settings.contrasts,
            curve,
            correction: default.correction,
            extrapolated: default.settings.leave_out_extrapolated,
            right_control_threshold: default.right_control_threshold,
            retention_trials: default.settings.retention_trials,
            seed: default.settings.seed,
        }
    }

    fn options(&self) -> ComparisonOptions {
        let mut options = ComparisonOptions {
            metrics: self.metrics.clone(),
            correction: self.correction,
            groups: self.groups.clone(),
            estimator: self.estimator,
            spec_sha256: self.spec.clone(),
            right_control_threshold: self.right_control_threshold,
            ..ComparisonOptions::default()
        };
        options.settings.form = self.curve;
        options.settings.contrasts.clone_from(&self.contrasts);
        options.settings.leave_out_extrapolated = self.extrapolated;
        options.settings.retention_trials = self.retention_trials;
        options.settings.seed = self.seed;
        options
    }

    /// Which trials are gathered. Divergent ones are never part of a curve: they are counted.
    fn trials(&self) -> CurveQuery {
        CurveQuery {
            plant: self.plant,
            session: self.session,
            include_divergent: false,
            include_excluded: false,
            estimator: self.estimator,
            joint: self.joint,
            spec: self.spec.clone(),
            trim: 0,
        }
    }
}

/// Who learned what: the change of each group with practice and the difference between groups, for each metric, with
/// intervals and exact tests over people.
///
/// Each person's trials are summarised by a fitted curve with errors; means over people are by restricted maximum
/// likelihood with Knapp–Hartung intervals, tests by exact permutation of people, with a mixed model on single trials
/// and other assumptions beside them. Divergent trials and the first control of a trial are counted by people.
/// `findings` says in sentences what was found, and what so many people can and cannot show.
#[utoipa::path(get, path = "/v1/studies/{study}/comparison", tag = "learning",
    operation_id = "read_study_comparison", params(StudyPath, ComparisonQuery, FormQuery, AcceptForm, IfNoneMatch),
    responses((status = 200, description = "The comparison; as a table with a row for each mean of a group, each \
            person's value and each difference, by metric and contrast.",
            content((StudyComparison = "application/json"), (String = "text/csv"), (String = "application/x-ndjson"))),
        (status = 422, description = "There are too many pairs of groups.")))]
pub(crate) async fn of_study(
    State(state): State<AppState>,
    Id(id): Id<StudyId>,
    Params((query, form)): Params<(ComparisonQuery, FormQuery)>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let form = form.choose(&headers, forms::DOCUMENT)?;
    state.store.study(id).await?;
    let comparison = compared(&state, id, &query).await?;
    forms::document(&headers, form, "comparison", &comparison, tables::of_study)
}

/// The comparison that a query asks for.
pub(crate) async fn compared(state: &AppState, study: StudyId, query: &ComparisonQuery) -> ApiResult<StudyComparison> {
    let options = query.options();
    let mut gathered = gather(state, study, None, None, &query.trials()).await?;
    judge_starts(state, &mut gathered, &options).await?;
    let Gathered { subjects, mut remarks } = gathered;
    let mut comparison = off_thread(move || compare(&subjects, &options)).await?.map_err(problem)?;
    comparison.remarks.append(&mut remarks);
    Ok(comparison)
}

fn problem(why: NoComparison) -> Problem {
    let place = "query parameter groups";
    match &why {
        NoComparison::UnknownGroup { .. } => {
            Problem::new(Code::NotFound, "no such group", why.to_string()).at(place).mend("Name groups of this study.")
        }
        NoComparison::TooManyPairs { .. } => Problem::new(Code::Invalid, "too many groups", why.to_string())
            .at(place)
            .mend("Name the groups to compare, such as groups=a,b, or a plant."),
    }
}

/// Judges the first controls that are counted anew where they were judged with another threshold.
async fn judge_starts(state: &AppState, gathered: &mut Gathered, options: &ComparisonOptions) -> ApiResult<()> {
    let threshold = options.right_control_threshold;
    let counted: BTreeSet<String> = first_and_last_trials(&gathered.subjects, options).into_iter().collect();
    let mut plants: BTreeMap<PlantId, Model> = BTreeMap::new();
    for trial in gathered.subjects.iter_mut().flat_map(|s| &mut s.trials) {
        if trial.metrics.right_control_threshold == threshold || !counted.contains(&trial.trial) {
            continue;
        }
        let (Ok(id), Ok(plant)) = (trial.trial.parse::<TrialId>(), trial.plant.id.parse::<PlantId>()) else {
            return Err(super::problem::internal().into());
        };
        let model = match plants.get(&plant) {
            Some(model) => model.clone(),
            None => plants.entry(plant).or_insert(state.store.plant(plant).await?.model).clone(),
        };
        // One at a time, so that only one recording is held.
        let signals = state.store.trial_signals(id).await?;
        let mut metrics = trial.metrics.clone();
        trial.metrics = off_thread(move || {
            metrics.judge_start(&signals, &model, threshold);
            metrics
        })
        .await?;
    }
    Ok(())
}
