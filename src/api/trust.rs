//! How far values may be used: the rule, and what it says of analyses, trials and studies, without opening a report.

use super::etag::{self, IfNoneMatch};
use super::extract::{FromQuery, Id, Params, QueryText};
use super::learning_inputs::{estimator, everything, spec_sha256};
use super::problem::{ApiResult, internal};
use super::state::AppState;
use super::studies::StudyPath;
use crate::analysis::Problem;
use crate::analysis::estimates::QuantityTrust;
use crate::analysis::ids::{AnalysisId, StudyId, TrialId};
use crate::api::analyses::AnalysisPath;
use crate::api::trials::TrialPath;
use crate::learning::curves::Metric;
use crate::learning::inputs::Estimator;
use crate::learning::time_domain::TimeDomainMetrics;
use crate::learning::trust_grid::{StudyTrust, TrustGridCell, TrustGridRow};
use crate::learning::{Identification, PlantName, SpecChoice, TrialInput, choose_spec};
use crate::store::{StoredTrust, TrialFilter, TrialRecord, TrustFilter};
use crate::trust::{Evidence, LeftOut, RULE_VERSION, Trust, measured, not_identified, rule};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::BTreeMap;
use utoipa::IntoParams;

/// The rule by which values are marked: its numbers and its rows.
#[utoipa::path(get, path = "/v1/trust-rule", tag = "learning", operation_id = "read_trust_rule", params(IfNoneMatch),
    responses((status = 200, description = "The rule.", body = crate::trust::TrustRule)))]
pub(crate) async fn read_rule(Params(()): Params<()>, headers: HeaderMap) -> ApiResult<Response> {
    etag::conditional(&headers, &rule())
}

/// How far the quantities of an analysis may be used.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct AnalysisTrust {
    /// Which version of the rule judged.
    rule: u32,
    /// Each quantity; none before the analysis succeeded, and of kinds that identify nothing of a person.
    trust: Vec<QuantityTrust>,
}

/// How far each quantity of an analysis may be used, and why no further. Whether a trial was divergent is said with the
/// trial, since a study's display limit may change.
#[utoipa::path(get, path = "/v1/analyses/{analysis}/trust", tag = "analyses", operation_id = "read_analysis_trust",
    params(AnalysisPath, IfNoneMatch),
    responses((status = 200, description = "The quantities.", body = AnalysisTrust)))]
pub(crate) async fn of_analysis(
    State(state): State<AppState>,
    Id(id): Id<AnalysisId>,
    Params(()): Params<()>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    state.store.analysis(id).await?;
    let trust = state.store.trust_of_analysis(id).await?;
    etag::conditional(&headers, &AnalysisTrust { rule: RULE_VERSION, trust })
}

/// A quantity as an analysis of a trial has it.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct TrialQuantity {
    /// The analysis.
    analysis: AnalysisId,
    /// SHA-256 of its spec.
    spec_sha256: String,
    /// How many trials the analysis combines.
    trials: u64,
    /// The quantity, and how far it may be used.
    #[serde(flatten)]
    quantity: QuantityTrust,
}

/// How far the quantities of a trial may be used.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct TrialTrust {
    /// Which version of the rule judged.
    rule: u32,
    /// What was measured in time.
    measured: Vec<Trust>,
    /// What was identified, by analysis, the oldest first.
    identified: Vec<TrialQuantity>,
}

/// Whether nothing of a trial is to be used, and why.
fn left_out(trial: &TrialRecord) -> LeftOut<'_> {
    LeftOut::of(trial.divergent, trial.excluded.as_deref())
}

/// The trust in what was measured of a trial.
pub(super) fn measured_of(metrics: &serde_json::Value, trial: LeftOut<'_>) -> Vec<Trust> {
    [Metric::MeanAbsError, Metric::RmsError, Metric::ControlLogDimensionlessJerk]
        .into_iter()
        .map(|metric| match metrics.get(metric.name()).and_then(serde_json::Value::as_f64) {
            Some(_) => measured(metric.name(), trial),
            None => not_identified(metric.name(), "the trial has no such measure"),
        })
        .collect()
}

/// How far each quantity of a trial may be used: what was measured, and what each of its analyses identified.
#[utoipa::path(get, path = "/v1/trials/{trial}/trust", tag = "trials", operation_id = "read_trial_trust",
    params(TrialPath, IfNoneMatch),
    responses((status = 200, description = "The quantities.", body = TrialTrust)))]
pub(crate) async fn of_trial(
    State(state): State<AppState>,
    Id(id): Id<TrialId>,
    Params(()): Params<()>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let record = state.store.trial(id).await?;
    let filter = TrustFilter { trial: Some(id), ..TrustFilter::default() };
    let found = state.store.trust_of_study(record.study, &filter).await?;
    let left_out = left_out(&record);
    let identified = found.into_iter().map(|own| {
        let mut quantity = own.quantity;
        quantity.trust = quantity.trust.in_trial(left_out);
        TrialQuantity { analysis: own.analysis, spec_sha256: own.spec_sha256, trials: own.trials, quantity }
    });
    let identified = identified.collect();
    let measured = measured_of(&record.metrics, left_out);
    etag::conditional(&headers, &TrialTrust { rule: RULE_VERSION, measured, identified })
}

/// Which quantity of a study's trials.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct TrustQuery {
    /// The quantity: `norm_feedforward_plant_minus_one`, `norm_feedforward_minus_inverse`, `norm_feedback`,
    /// `variance_accounted_for`, `mean_abs_error`, `rms_error` or `control_log_dimensionless_jerk`.
    #[param(value_type = Option<String>, nullable = false, pattern = "^[a-z_]+$",
        default = "norm_feedforward_plant_minus_one")]
    quantity: Metric,
    /// How the controllers were estimated: `ssid`, `ssid_refined`, `two_stimulus` or `prediction_error`.
    #[param(value_type = Option<String>, nullable = false,
        pattern = "^(ssid|ssid_refined|two_stimulus|prediction_error)$", default = "ssid")]
    estimator: Estimator,
    /// Show the identifications with this `spec_sha256`; without it, those with the spec that covers most trials.
    #[param(nullable = false, pattern = "^[0-9a-f]{64}$")]
    spec: Option<String>,
}

/// The parameter `quantity`.
pub(in crate::api) fn quantity(query: &mut QueryText) -> Result<Metric, Problem> {
    let names = Metric::ALL.map(Metric::name).join(", ");
    let found =
        query.one_of("quantity", &names, |text| Metric::ALL.into_iter().find(|metric| metric.name() == text))?;
    Ok(found.unwrap_or(Metric::NormFeedforwardPlantMinusOne))
}

impl FromQuery for TrustQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok(Self {
            quantity: quantity(query)?,
            estimator: estimator(query)?.unwrap_or_default(),
            spec: spec_sha256(query)?,
        })
    }
}

/// One quantity of every trial of a study, subjects down and trials across, with how far each may be used.
#[utoipa::path(get, path = "/v1/studies/{study}/trust", tag = "learning", operation_id = "read_study_trust",
    params(StudyPath, TrustQuery, IfNoneMatch),
    responses((status = 200, description = "The quantity of every trial.", body = StudyTrust)))]
pub(crate) async fn of_study(
    State(state): State<AppState>,
    Id(id): Id<StudyId>,
    Params(query): Params<TrustQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    state.store.study(id).await?;
    let found = study_trust(&state, id, query.quantity, query.estimator, query.spec.as_deref()).await?;
    etag::conditional(&headers, &found)
}

/// The quantity of every trial of a study, from what is stored beside the reports.
pub(crate) async fn study_trust(
    state: &AppState,
    study: StudyId,
    metric: Metric,
    estimator: Estimator,
    spec: Option<&str>,
) -> ApiResult<StudyTrust> {
    let filter = TrialFilter { include_divergent: true, ..TrialFilter::default() };
    let trials = state.store.matching_trials(study, &filter).await?;
    let is_measured = matches!(metric, Metric::MeanAbsError | Metric::RmsError | Metric::ControlLogDimensionlessJerk);
    let mut stored: BTreeMap<TrialId, Vec<StoredTrust>> = BTreeMap::new();
    if !is_measured {
        let filter = TrustFilter {
            quantity: Some(metric.name().to_owned()),
            estimator: Some(estimator.name().to_owned()),
            ..TrustFilter::default()
        };
        // What several trials were combined for is not that of one.
        for own in state.store.trust_of_study(study, &filter).await?.into_iter().filter(|own| own.trials == 1) {
            stored.entry(own.trial).or_default().push(own);
        }
    }
    let plants = everything(|page| state.store.plants(study, page), |plant| plant.id.0).await?;
    let plants: BTreeMap<_, _> =
        plants.into_iter().map(|plant| (plant.id, PlantName { id: plant.id.to_string(), name: plant.name })).collect();
    let subjects = everything(|page| state.store.subjects(study, None, page), |subject| subject.id.0).await?;
    let subjects: BTreeMap<_, _> = subjects.into_iter().map(|subject| (subject.id, subject)).collect();
    let chosen = if is_measured { None } else { spec_of(&trials, &stored, spec)? };
    let mut rows: BTreeMap<_, TrustGridRow> = BTreeMap::new();
    for trial in trials {
        // Made after the lists were read.
        let (Some(plant), Some(subject)) = (plants.get(&trial.plant), subjects.get(&trial.subject)) else { continue };
        let row = rows.entry((trial.subject, trial.plant)).or_insert_with(|| TrustGridRow {
            subject: subject.id.to_string(),
            code: subject.code.clone(),
            group: subject.group.clone(),
            plant: plant.clone(),
            trials: Vec::new(),
        });
        let cell = if is_measured {
            measured_cell(metric, &trial)
        } else {
            let all = stored.remove(&trial.id).unwrap_or_default();
            let newest =
                all.into_iter().rev().find(|own| chosen.as_ref().is_some_and(|c| c.spec_sha256 == own.spec_sha256));
            identified_cell(metric, estimator, &trial, newest)
        };
        row.trials.push(cell);
    }
    let estimator = (!is_measured).then_some(estimator);
    Ok(StudyTrust::new(metric.name(), estimator, chosen, rows.into_values().collect()))
}

fn measured_cell(metric: Metric, trial: &TrialRecord) -> TrustGridCell {
    let value = trial.metrics.get(metric.name()).and_then(serde_json::Value::as_f64);
    let trust = match value {
        Some(_) => measured(metric.name(), left_out(trial)),
        None => not_identified(metric.name(), "the trial has no such measure"),
    };
    cell(trial, None, value, None, trust)
}

fn identified_cell(
    metric: Metric,
    estimator: Estimator,
    trial: &TrialRecord,
    found: Option<StoredTrust>,
) -> TrustGridCell {
    match found {
        Some(own) => {
            let QuantityTrust { value, interval_95, trust, .. } = own.quantity;
            cell(trial, Some(own.analysis), value, interval_95, trust.in_trial(left_out(trial)))
        }
        None => {
            let why = format!("this trial has no succeeded {} analysis with the chosen spec", estimator.name());
            cell(trial, None, None, None, not_identified(metric.name(), &why))
        }
    }
}

fn cell(
    trial: &TrialRecord,
    analysis: Option<AnalysisId>,
    value: Option<f64>,
    interval_95: Option<[f64; 2]>,
    trust: Trust,
) -> TrustGridCell {
    let analysis = analysis.map(|id| id.to_string());
    let (trial, number, session) = (trial.id.to_string(), trial.number, trial.session);
    TrustGridCell { trial, number, session, analysis, value, interval_95, trust }
}

/// The spec asked for, or the one that covers most trials: as learning curves choose it.
fn spec_of(
    trials: &[TrialRecord],
    stored: &BTreeMap<TrialId, Vec<StoredTrust>>,
    asked: Option<&str>,
) -> ApiResult<Option<SpecChoice>> {
    let mut inputs = Vec::new();
    for trial in trials {
        let Some(found) = stored.get(&trial.id) else { continue };
        let metrics: TimeDomainMetrics = serde_json::from_value(trial.metrics.clone()).map_err(|error| {
            tracing::error!(trial = %trial.id, %error, "stored metrics cannot be read");
            internal()
        })?;
        let identifications = found.iter().map(|own| {
            let estimator = own.quantity.estimator.unwrap_or_default();
            Identification::unread(&own.analysis.to_string(), &own.spec_sha256, estimator, Evidence::default())
        });
        inputs.push(TrialInput {
            trial: trial.id.to_string(),
            number: trial.number,
            session: trial.session,
            plant: PlantName { id: trial.plant.to_string(), name: String::new() },
            divergent: trial.divergent,
            excluded: trial.excluded.clone(),
            metrics,
            identifications: identifications.collect(),
            by_other_estimators: Vec::new(),
        });
    }
    Ok(match asked {
        Some(spec) => Some(SpecChoice::fixed(spec, &inputs)),
        None => choose_spec(&inputs),
    })
}
