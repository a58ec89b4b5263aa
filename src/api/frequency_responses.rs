//! Mean and standard deviation of identified controllers over subjects.

use super::etag::IfNoneMatch;
use super::extract::{FromQuery, Id, Params, QueryText, off_thread};
use super::forms::{self, AcceptForm, FormQuery};
use super::learning_curves::GroupQuery;
use super::learning_inputs::{CurveQuery, gather};
use super::problem::ApiResult;
use super::state::AppState;
use super::studies::StudyPath;
use crate::analysis::ids::StudyId;
use crate::analysis::{Code, Problem};
use crate::exchange::tables::responses as tables;
use crate::learning::bode::{frequency_grid, identified_band};
use crate::learning::{StudyFrequencyResponses, SubjectInput, TrialSelection, study_frequency_responses};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use utoipa::IntoParams;

/// Frequencies unless asked otherwise.
const DEFAULT_POINTS: i64 = 100;
/// Frequencies at most.
const MAX_POINTS: i64 = 2000;

/// Which trial of each subject, at which frequencies.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct ResponseQuery {
    /// Which identified trial of each subject: `first`, `last`, or a trial number.
    #[param(value_type = Option<String>, nullable = false, pattern = "^(first|last|[1-9][0-9]{0,8})$",
        default = "last")]
    trial: TrialSelection,
    /// Lowest frequency in rad/s; without it, that of the identified band.
    #[param(nullable = false, minimum = 0)]
    omega_from_rad_s: Option<f64>,
    /// Highest frequency in rad/s; without it, that of the identified band.
    #[param(nullable = false, minimum = 0)]
    omega_to_rad_s: Option<f64>,
    /// How many frequencies, equally spaced.
    #[param(required = false, minimum = 1, maximum = 2000, default = 100)]
    points: usize,
    /// Whether the responses of each subject are given too.
    #[param(required = false, default = false)]
    each_subject: bool,
}

/// The parameter `trial`.
pub(super) fn trial_selection(query: &mut QueryText) -> Result<Option<TrialSelection>, Problem> {
    query.one_of("trial", "first, last and trial numbers", |text| match text {
        "first" => Some(TrialSelection::First),
        "last" => Some(TrialSelection::Last),
        number => {
            let plain = !number.starts_with(['0', '+']) && number.len() <= 9;
            number.parse().ok().filter(|n| plain && *n >= 1).map(TrialSelection::Number)
        }
    })
}

impl FromQuery for ResponseQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let trial = trial_selection(query)?;
        let omega_from_rad_s = query.number("omega_from_rad_s")?;
        let omega_to_rad_s = query.number("omega_to_rad_s")?;
        for (name, value) in [("omega_from_rad_s", omega_from_rad_s), ("omega_to_rad_s", omega_to_rad_s)] {
            if let Some(bad) = value.filter(|value| *value < 0.0) {
                return Err(Problem::new(Code::Malformed, "bad query parameter", format!("{bad} is negative"))
                    .at(format!("query parameter {name}")));
            }
        }
        let points = query.integer("points", 1, MAX_POINTS)?.unwrap_or(DEFAULT_POINTS) as usize;
        let each_subject = query.flag("each_subject")?;
        Ok(Self { trial: trial.unwrap_or_default(), omega_from_rad_s, omega_to_rad_s, points, each_subject })
    }
}

/// The frequencies asked for, or those of the band that was identified; none where neither says.
///
/// # Errors
/// Where the lowest lies above the highest.
pub(super) fn grid(
    subjects: &[SubjectInput],
    [from, to]: [Option<f64>; 2],
    points: usize,
) -> Result<Vec<f64>, Problem> {
    let band = identified_band(subjects);
    let from = from.or(band.map(|(from, _)| from));
    let to = to.or(band.map(|(_, to)| to));
    match (from, to) {
        // One frequency repeated would be no grid.
        (Some(from), Some(to)) if from <= to => Ok(frequency_grid((from, to), if from < to { points } else { 1 })),
        (Some(from), Some(to)) => {
            Err(Problem::new(Code::Invalid, "no frequencies", format!("{from} rad/s lies above {to} rad/s"))
                .at("query parameter omega_from_rad_s")
                .mend("Give a lowest frequency below the highest one."))
        }
        _ => Ok(Vec::new()),
    }
}

/// Everything that is asked in the query.
type Asked = (GroupQuery, (CurveQuery, (ResponseQuery, FormQuery)));

/// Mean and standard deviation over each group's subjects of the identified feedforward, feedback, feedforward times
/// plant and closed loop, frequency by frequency, with trimmed versions, beside those of the plant and its inverse.
#[utoipa::path(get, path = "/v1/studies/{study}/frequency-responses", tag = "learning",
    operation_id = "read_study_frequency_responses",
    params(StudyPath, GroupQuery, CurveQuery, ResponseQuery, FormQuery, AcceptForm, IfNoneMatch),
    responses((status = 200,
        description = "The responses; without frequencies where nothing is identified yet and none are asked for. As a \
            table with a row for each group, part of the loop and frequency.",
        content((StudyFrequencyResponses = "application/json"), (String = "text/csv"),
            (String = "application/x-ndjson"))),
        (status = 422, description = "The frequencies asked for make no grid, or joint estimates are not of \
            prediction_error.")))]
pub(crate) async fn of_study(
    State(state): State<AppState>,
    Id(id): Id<StudyId>,
    Params(params): Params<Asked>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let (GroupQuery { group }, (query, (response, form))) = params;
    let form = form.choose(&headers, forms::DOCUMENT)?;
    state.store.study(id).await?;
    let mut gathered = gather(&state, id, None, group, &query).await?;
    let (subjects, options) = (gathered.subjects, query.options());
    let ResponseQuery { trial, each_subject, .. } = response;
    let omega = grid(&subjects, [response.omega_from_rad_s, response.omega_to_rad_s], response.points)?;
    let answer = move || study_frequency_responses(&subjects, trial, &omega, &options, each_subject);
    let mut responses = off_thread(answer).await?;
    responses.remarks.append(&mut gathered.remarks);
    forms::document(&headers, form, "frequency-responses", &responses, tables::of_study)
}
