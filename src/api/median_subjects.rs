//! The median subject of each group with some of its trials, in one request.

use super::etag::{self, IfNoneMatch};
use super::extract::{FromQuery, Id, Params, QueryText, off_thread};
use super::frequency_responses::grid;
use super::learning_curves::GroupQuery;
use super::learning_inputs::{CurveQuery, gather};
use super::problem::ApiResult;
use super::state::AppState;
use super::studies::StudyPath;
use crate::analysis::ids::{StudyId, TrialId};
use crate::analysis::{Code, Problem};
use crate::learning::curves::Metric;
use crate::learning::median_subject::{
    MedianChoice, ShownSignals, ShownTrial, StudyMedianSubjects, ValueOver, study_median_subjects,
};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde::de::DeserializeOwned;
use utoipa::IntoParams;

/// Frequencies unless asked otherwise.
const DEFAULT_POINTS: i64 = 100;
/// Frequencies at most.
const MAX_POINTS: i64 = 2000;
/// Trials that are shown of a subject at most.
const MAX_TRIALS: usize = 20;
/// Every so many-th sample at most.
const MAX_EVERY: i64 = 1_000_000;
/// Samples of all signals of an answer at most.
const MAX_SAMPLES: usize = 500_000;

/// Whose median, and what is shown.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct MedianQuery {
    /// The metric whose median the subject has: `mean_abs_error`, `rms_error`, `norm_feedback`,
    /// `norm_feedforward_minus_inverse`, `norm_feedforward_plant_minus_one`, `variance_accounted_for` or
    /// `control_log_dimensionless_jerk`.
    #[param(value_type = Option<String>, nullable = false, pattern = "^[a-z_]+$", default = "mean_abs_error")]
    metric: Metric,
    /// What a subject's value is: the mean over `all` of its trials that are shown, or that of the `first` or `last`
    /// one.
    #[param(value_type = Option<String>, nullable = false, pattern = "^(all|first|last)$", default = "all")]
    over: ValueOver,
    /// Which of its trials are shown: `first`, `last` and trial numbers, separated by commas, 20 at most.
    #[param(value_type = Option<String>, nullable = false, default = "first,last", example = "first,10,20,last",
        pattern = "^(first|last|[1-9][0-9]{0,8})(,(first|last|[1-9][0-9]{0,8}))*$")]
    trials: Vec<ShownTrial>,
    /// Whether their signals are given.
    #[param(required = false, default = true)]
    signals: bool,
    /// Which samples of the signals are given: every so many-th.
    #[param(required = false, minimum = 1, maximum = 1000000, default = 1)]
    every: usize,
    /// Lowest frequency of the responses in rad/s; without it, that of the identified band.
    #[param(nullable = false, minimum = 0)]
    omega_from_rad_s: Option<f64>,
    /// Highest frequency in rad/s; without it, that of the identified band.
    #[param(nullable = false, minimum = 0)]
    omega_to_rad_s: Option<f64>,
    /// How many frequencies, equally spaced.
    #[param(required = false, minimum = 1, maximum = 2000, default = 100)]
    points: usize,
}

/// A name as serde writes it.
fn parse<T: DeserializeOwned>(word: &str) -> Option<T> {
    serde_json::from_value(serde_json::Value::from(word)).ok()
}

fn shown(text: &str) -> Option<ShownTrial> {
    match text {
        "first" => Some(ShownTrial::First),
        "last" => Some(ShownTrial::Last),
        number => {
            let plain = !number.starts_with(['0', '+']) && number.len() <= 9;
            number.parse().ok().filter(|n| plain && *n >= 1).map(ShownTrial::Number)
        }
    }
}

impl FromQuery for MedianQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let trials = query.one_of("trials", "first, last and trial numbers, separated by commas", |text| {
            let all: Option<Vec<ShownTrial>> = text.split(',').map(shown).collect();
            all.filter(|trials| trials.len() <= MAX_TRIALS)
        })?;
        let signals = query.one_of("signals", "true, false", |text| text.parse::<bool>().ok())?;
        let [omega_from_rad_s, omega_to_rad_s] = [query.number("omega_from_rad_s")?, query.number("omega_to_rad_s")?];
        for (name, value) in [("omega_from_rad_s", omega_from_rad_s), ("omega_to_rad_s", omega_to_rad_s)] {
            if let Some(bad) = value.filter(|value| *value < 0.0) {
                return Err(Problem::new(Code::Malformed, "bad query parameter", format!("{bad} is negative"))
                    .at(format!("query parameter {name}")));
            }
        }
        Ok(Self {
            metric: query
                .one_of("metric", "the metrics (see the OpenAPI document)", parse)?
                .unwrap_or(Metric::MeanAbsError),
            over: query.one_of("over", "all, first, last", parse)?.unwrap_or_default(),
            trials: trials.unwrap_or_else(|| vec![ShownTrial::First, ShownTrial::Last]),
            signals: signals.unwrap_or(true),
            every: query.integer("every", 1, MAX_EVERY)?.unwrap_or(1) as usize,
            omega_from_rad_s,
            omega_to_rad_s,
            points: query.integer("points", 1, MAX_POINTS)?.unwrap_or(DEFAULT_POINTS) as usize,
        })
    }
}

/// The median subject of each group on each plant, with some of its trials: their metrics, signals and the frequency
/// responses of their identified controllers.
///
/// Of an even number of subjects none is the median: the lower of the middle two is shown, and a remark names the
/// other. Divergent trials are left out unless asked for.
#[utoipa::path(get, path = "/v1/studies/{study}/median-subjects", tag = "learning",
    operation_id = "read_study_median_subjects",
    params(StudyPath, GroupQuery, CurveQuery, MedianQuery, IfNoneMatch),
    responses((status = 200, description = "The subjects.", body = StudyMedianSubjects),
        (status = 422, description = "The frequencies asked for make no grid, there are too many samples, or joint \
            estimates are not of prediction_error.")))]
pub(crate) async fn of_study(
    State(state): State<AppState>,
    Id(id): Id<StudyId>,
    Params(params): Params<(GroupQuery, (CurveQuery, MedianQuery))>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let (GroupQuery { group }, (query, median)) = params;
    state.store.study(id).await?;
    let mut gathered = gather(&state, id, None, group, &query).await?;
    let (subjects, options) = (gathered.subjects, query.options());
    let omega_rad_s = grid(&subjects, [median.omega_from_rad_s, median.omega_to_rad_s], median.points)?;
    let MedianQuery { metric, over, trials, signals, every, .. } = median;
    let choice = MedianChoice { metric, over, trials, omega_rad_s };
    let mut found = off_thread(move || study_median_subjects(&subjects, &choice, &options)).await?;
    if signals {
        add_signals(&state, &mut found, every).await?;
    }
    found.remarks.append(&mut gathered.remarks);
    etag::conditional(&headers, &found)
}

/// Reads the signals of the trials that are shown, one recording at a time.
async fn add_signals(state: &AppState, found: &mut StudyMedianSubjects, every: usize) -> ApiResult<()> {
    let mut left = MAX_SAMPLES;
    for trial in found.groups.iter_mut().flat_map(|group| &mut group.trials) {
        let Ok(id) = trial.point.trial.parse::<TrialId>() else { return Err(super::problem::internal().into()) };
        let recording = state.store.trial_signals(id).await?;
        let samples = recording.samples().div_ceil(every);
        left = left.checked_sub(samples).ok_or_else(|| {
            let detail = format!("the signals of the trials that are shown have more than {MAX_SAMPLES} samples");
            Problem::new(Code::Unaffordable, "too many samples", detail)
                .at("query parameter every")
                .mend("Ask for every so many-th sample (every=10), for fewer trials, or for signals=false.")
        })?;
        trial.signals = Some(off_thread(move || ShownSignals::new(&recording, every)).await?);
    }
    Ok(())
}
