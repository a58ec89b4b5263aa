//! Figures of a study.

use super::of_trial::units as units_of;
use super::{FigureList, FigureName, FigureQuery, Offered, answer};
use crate::analysis::ids::{StudyId, SubjectId};
use crate::analysis::{Code, Problem};
use crate::api::etag::{self, IfNoneMatch};
use crate::api::extract::{FromQuery, Id, Params, QueryText, off_thread};
use crate::api::frequency_responses::trial_selection;
use crate::api::learning_inputs::{CurveQuery, Gathered, everything, gather, left_out_in};
use crate::api::named::Named;
use crate::api::problem::{ApiResult, internal};
use crate::api::state::AppState;
use crate::api::studies::{StudyPath, StudyView};
use crate::api::trust::{quantity, study_trust};
use crate::control::Model;
use crate::control::bode::log_grid;
use crate::figure::Figure;
use crate::figure::of::Units;
use crate::figure::of::divergent::{self, divergent};
use crate::figure::of::last_trial::{self, last_trial};
use crate::figure::of::learning_curves::{METRICS, learning_curve, learning_curve_of, name as name_of, title};
use crate::figure::of::mean_bode::{self, mean_bode, practice_bode, trimmed_bode};
use crate::figure::of::plants::{self, bode_of_plants, steps_of_plants, zero_of_plants};
use crate::figure::of::scatter::{self, Distance, scatter};
use crate::figure::of::trust_grid::{self, trust_grid};
use crate::learning::bode::identified_band;
use crate::learning::curves::Metric;
use crate::learning::{CurveOptions, Remark, TrialSelection, study_frequency_responses, study_learning_curves};
use crate::store::{SignalUnits, Subject};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use utoipa::IntoParams;

/// Frequencies of a mean response, equally spaced on a logarithmic scale.
const FREQUENCIES: usize = 120;

/// A band that begins at zero is drawn over so many powers of ten.
const LEAST_SHARE: f64 = 1e-3;

/// The curve of every quantity, mean controllers, scatters, last trials, divergent trials, plants, the grid of trust.
fn offered() -> Vec<Offered> {
    let mut all = METRICS.map(|metric| Offered { name: name_of(metric), title: title(metric) }).to_vec();
    all.extend([
        Offered { name: mean_bode::NAME, title: "Gff, Gfb and Gff·G of the groups on a trial" },
        Offered { name: mean_bode::PRACTICE, title: "Gff, Gfb and the closed loop, first trials against last ones" },
        Offered { name: mean_bode::TRIMMED, title: "Gff, Gfb and Gff·G without the extremes" },
        Offered { name: scatter::NAME, title: "Tracking error against distance from the inverse dynamics" },
        Offered { name: scatter::INVERSE, title: "Tracking error against ‖Gff − G⁻¹‖" },
        Offered { name: last_trial::NAME, title: "‖Gff G − 1‖ and ‖Gfb‖ of every subject's last trial" },
        Offered { name: divergent::NAME, title: "Divergent trials of each group" },
        Offered { name: trust_grid::NAME, title: "How far a quantity of each trial may be used" },
        Offered { name: plants::BODE, title: "Frequency responses of the plants" },
        Offered { name: plants::STEPS, title: "Answers of the plants to a unit step" },
        Offered { name: plants::ZERO, title: "Answers of the plants to the exponential of an unstable zero" },
    ]);
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
    /// Only trials of this subject: controllers and divergent trials are then its own, and curves too, before mean and
    /// spread of its group.
    #[param(nullable = false)]
    subject: Option<SubjectId>,
}

impl FromQuery for GridQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let trial = trial_selection(query)?.unwrap_or_default();
        Ok(Self { quantity: quantity(query)?, trial, subject: query.id("subject")? })
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

/// Frequencies over the band that was identified; none where nothing is.
fn frequencies(gathered: &Gathered) -> Vec<f64> {
    let band = identified_band(&gathered.subjects);
    band.map_or_else(Vec::new, |(from, to)| log_grid(from.max(LEAST_SHARE * to), to, FREQUENCIES))
}

/// The mean controllers of the groups' identified trials, the first or the last of each person, over the band that was
/// identified.
pub(crate) fn mean_controllers(gathered: &Gathered, trial: TrialSelection, options: &CurveOptions) -> Figure {
    let omega = frequencies(gathered);
    mean_bode(&study_frequency_responses(&gathered.subjects, trial, &omega, options, false))
}

/// A figure with the trials that somebody excluded named in its caption.
pub(crate) fn naming_excluded(mut figure: Figure, remarks: &[Remark]) -> Figure {
    if let Some(remark) = left_out_in(remarks) {
        let mut letters = remark.message.chars();
        let sentence: String = letters.next().into_iter().flat_map(char::to_uppercase).chain(letters).collect();
        figure.caption = format!("{sentence}. {}", figure.caption);
    }
    figure
}

/// A figure that is made of what was gathered.
fn of_trials(name: &str, gathered: &Gathered, options: &CurveOptions, units: &Units, trial: TrialSelection) -> Figure {
    let responses =
        |trial| study_frequency_responses(&gathered.subjects, trial, &frequencies(gathered), options, false);
    let curves = || study_learning_curves(&gathered.subjects, options);
    if let Some(metric) = METRICS.into_iter().find(|metric| name_of(*metric) == name) {
        return learning_curve(&curves(), metric, units);
    }
    match name {
        mean_bode::PRACTICE => practice_bode(&responses(TrialSelection::First), &responses(TrialSelection::Last)),
        mean_bode::TRIMMED => trimmed_bode(&responses(trial)),
        scatter::NAME => scatter(&curves(), units, Distance::PlantMinusOne),
        scatter::INVERSE => scatter(&curves(), units, Distance::MinusInverse),
        last_trial::NAME => last_trial(&curves(), units),
        divergent::NAME => divergent(&curves()),
        _ => mean_bode(&responses(trial)),
    }
}

/// The figures that a study's page has one of at a time, each with what it shows.
pub(crate) fn more_figures() -> impl Iterator<Item = (&'static str, &'static str)> {
    let own = |one: &Offered| one.name != trust_grid::NAME && one.name != mean_bode::NAME;
    offered().into_iter().filter(own).map(|one| (one.name, one.title))
}

/// Plants by name.
pub(crate) type NamedPlants = Vec<(String, Model)>;

/// The plants of a study by name.
pub(crate) async fn plants_of_study(state: &AppState, study: StudyId) -> ApiResult<NamedPlants> {
    let plants = everything(|page| state.store.plants(study, page), |plant| plant.id.0).await?;
    Ok(plants.into_iter().map(|plant| (plant.name, plant.model)).collect())
}

/// One of [`more_figures`].
///
/// # Errors
/// Where the study has nothing for it.
pub(crate) fn of_study(
    name: &str,
    gathered: &Gathered,
    options: &CurveOptions,
    units: &Units,
    plants: &[(String, Model)],
) -> Result<Figure, Problem> {
    of_plants(name, plants, units).unwrap_or_else(|| {
        let figure = of_trials(name, gathered, options, units, TrialSelection::Last);
        Ok(naming_excluded(figure, &gathered.remarks))
    })
}

/// A figure of the plants by its name; `None` where it is of trials.
fn of_plants(name: &str, plants: &[(String, Model)], units: &Units) -> Option<Result<Figure, Problem>> {
    match name {
        plants::BODE => Some(Ok(bode_of_plants(plants))),
        plants::STEPS => Some(Ok(steps_of_plants(plants, &units.output))),
        plants::ZERO => Some(zero_of_plants(plants, &units.output).ok_or_else(|| {
            Problem::new(Code::Invalid, "nothing to draw", "no plant of the study has a real zero on the right")
        })),
        _ => None,
    }
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
    let plants = plants_of_study(&study.state, study.id).await?;
    let has_zero = off_thread(move || zero_of_plants(&plants, "").is_some()).await?;
    let mut all = offered();
    all.retain(|one| has_zero || one.name != plants::ZERO);
    etag::conditional(&study.headers, &FigureList::new(&format!("/v1/studies/{}", study.id), &all))
}

/// Draws the learning curve of a quantity: every subject, the mean of every group with ± 1 SD, intervals, and a cross
/// over what is not to be used; the mean Bode plots of the groups' last identified trials (`bode`), first trials
/// against last ones (`bode_practice`), or without the extremes (`bode_trimmed`); error against distance (`scatter`,
/// `scatter_inverse`); the norms of last trials (`last_trial`); how many trials diverged (`divergent`); how far the
/// `quantity` of each trial may be used (`trust`); or the study's plants (`plants`, `plant_steps`, `plant_zero`).
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
    let (query, (curves, GridQuery { quantity, trial, subject })) = params;
    let name = name.among(&offered())?;
    state.store.study(id).await?;
    if name == trust_grid::NAME {
        let found = study_trust(&state, id, quantity, curves.estimator, curves.spec.as_deref()).await?;
        return answer(&state, &headers, query, None, move || Ok(trust_grid(&found))).await;
    }
    let units = units_of_study(&state, id).await?;
    if [plants::BODE, plants::STEPS, plants::ZERO].contains(&name) {
        let plants = plants_of_study(&state, id).await?;
        let figure = move || of_plants(name, &plants, &units).unwrap_or_else(|| Err(internal()));
        return answer(&state, &headers, query, None, figure).await;
    }
    let subject = match subject {
        Some(own) => Some(of_this_study(state.store.subject(own).await?, id)?),
        None => None,
    };
    let metric = METRICS.into_iter().find(|metric| name_of(*metric) == name);
    let options = curves.options();
    if let (Some(metric), Some(subject)) = (metric, &subject) {
        // A person is seen before its group.
        let gathered = gather(&state, id, None, subject.group.clone(), &curves).await?;
        let own = subject.id.to_string();
        let figure = move || {
            let figure = learning_curve_of(&study_learning_curves(&gathered.subjects, &options), &own, metric, &units);
            Ok(naming_excluded(figure, &gathered.remarks))
        };
        return answer(&state, &headers, query, None, figure).await;
    }
    let gathered = gather(&state, id, subject, None, &curves).await?;
    let figure = move || {
        let figure = of_trials(name, &gathered, &options, &units, trial);
        Ok(naming_excluded(figure, &gathered.remarks))
    };
    answer(&state, &headers, query, None, figure).await
}

/// A subject, if it is one of the study.
fn of_this_study(subject: Subject, study: StudyId) -> Result<Subject, Problem> {
    if subject.study == study {
        return Ok(subject);
    }
    let detail = format!("the study has no subject {}", subject.id);
    Err(Problem::new(Code::NotFound, "no such subject", detail).at("query parameter subject"))
}
