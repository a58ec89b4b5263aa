//! Figures of an analysis.

use super::of_trial::Shown;
use super::{FigureList, FigureName, FigureQuery, Offered, answer};
use crate::analysis::ids::{AnalysisId, TrialId};
use crate::analysis::{
    Analysis as _, Code, Kind, Plan, Problem, References, Report, Request, compensator_design, excitation_quality,
    frequency_response, gain_fit, inverse_lqe, inverse_lqg, inverse_lqr, prediction_error, ssid, two_stimulus,
};
use crate::analysis::{input_design as input_design_kind, simulate as simulate_kind};
use crate::api::analyses::{AnalysisPath, AnalysisView, report_text};
use crate::api::etag::{self, IfNoneMatch};
use crate::api::extract::{Id, Params, off_thread};
use crate::api::named::Named;
use crate::api::problem::ApiResult;
use crate::api::state::AppState;
use crate::control::Model;
use crate::figure::Figure;
use crate::figure::of::bode::{self, Origin, Unreadable, bode};
use crate::figure::of::compensator::{self, compensator};
use crate::figure::of::cost::{self, cost};
use crate::figure::of::descent::{self, descent};
use crate::figure::of::excitation::{self, excitation};
use crate::figure::of::input_design::{self, input_design};
use crate::figure::of::near_optimal::{self, near_optimal};
use crate::figure::of::poles::{self, poles};
use crate::figure::of::response::{self, response};
use crate::figure::of::return_difference::{self, return_difference};
use crate::figure::of::simulated::{self, simulated};
use crate::figure::of::simulation::{self, simulation};
use crate::store::AnalysisRecord;
use crate::trial::Trial;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde_json::Value;
use utoipa::IntoParams;

const BODE: Offered = Offered { name: bode::NAME, title: "Gff, Gfb and Gff·G with their bands" };
const RESPONSE: Offered = Offered { name: response::NAME, title: "The closed loop's frequency response" };
const SIMULATED: Offered = Offered { name: simulated::NAME, title: "The recording against the identified loop" };

const POLES: Offered = Offered { name: poles::NAME, title: "Poles of plant, controllers and closed loop" };
const NEAR: Offered = Offered { name: near_optimal::NAME, title: "Candidates that fit nearly as well" };
const COST: Offered = Offered { name: cost::NAME, title: "What the cost weighs" };
const RETURN: Offered = Offered { name: return_difference::NAME, title: "Kalman's inequality over frequency" };
const EXCITATION: [Offered; 4] = [
    Offered { name: excitation::SIGNAL, title: "The signal over time" },
    Offered { name: excitation::SPECTRUM, title: "The power at its lines" },
    Offered { name: excitation::AUTOCORRELATION, title: "Its autocorrelation" },
    Offered { name: excitation::FLATNESS, title: "Its flatness over the band" },
];
const COMPENSATOR: Offered = Offered { name: compensator::NAME, title: "The flatness gain over the gain" };
const DESIGN: [Offered; 5] = [
    Offered { name: input_design::INPUT, title: "The input before and after" },
    Offered { name: input_design::IMPROVEMENT, title: "How much better the experiment became, step by step" },
    Offered { name: input_design::OUTPUTS, title: "The outputs before and after, with their limits" },
    Offered { name: input_design::AUTOCORRELATION, title: "The autocorrelation before and after, with its limits" },
    Offered { name: input_design::DEVIATIONS, title: "Standard deviations after over before" },
];
const DESCENT: Offered = Offered { name: descent::NAME, title: "How the gradient descent went" };
const SIMULATION: [Offered; 3] = [
    Offered { name: simulation::SIGNALS, title: "The simulated signals" },
    Offered { name: simulation::BODE, title: "Gff, Gfb and the closed loop" },
    Offered { name: simulation::STEP, title: "The answer to a unit step" },
];

/// What a report of a kind can be drawn as; `spec` says which parts were asked for.
fn offered(kind: Kind, has_trial: bool, spec: &Value) -> Vec<Offered> {
    let mut all = of_kind(kind, has_trial);
    let has = |pointer: &str| spec.pointer(pointer).is_some_and(|own| !own.is_null());
    if !["", "/regulator", "/filter"].iter().any(|root| has(&format!("{root}/fit/descent"))) {
        all.retain(|one| one.name != descent::NAME);
    }
    if kind == input_design_kind::Plan::KIND && !has("/limits/autocorrelation") {
        all.retain(|one| one.name != input_design::AUTOCORRELATION);
    }
    all
}

fn of_kind(kind: Kind, has_trial: bool) -> Vec<Offered> {
    if kind == ssid::Plan::KIND {
        let mut all = vec![BODE, RESPONSE, POLES, NEAR];
        all.extend(has_trial.then_some(SIMULATED));
        all
    } else if kind == two_stimulus::Plan::KIND || kind == prediction_error::Plan::KIND {
        vec![BODE]
    } else if kind == frequency_response::Plan::KIND {
        vec![RESPONSE]
    } else if kind == inverse_lqr::Plan::KIND {
        vec![COST, RETURN, DESCENT]
    } else if kind == inverse_lqe::Plan::KIND {
        vec![DESCENT]
    } else if kind == inverse_lqg::Plan::KIND {
        vec![COST, DESCENT]
    } else if kind == simulate_kind::Plan::KIND {
        SIMULATION.to_vec()
    } else if kind == gain_fit::Plan::KIND {
        vec![RETURN]
    } else if kind == excitation_quality::Plan::KIND {
        EXCITATION.to_vec()
    } else if kind == compensator_design::Plan::KIND {
        vec![COMPENSATOR]
    } else if kind == input_design_kind::Plan::KIND {
        DESIGN.to_vec()
    } else {
        Vec::new()
    }
}

/// Names a figure of an analysis in the path.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "documents the path")]
pub(crate) struct AnalysisFigurePath {
    /// The analysis.
    analysis: AnalysisId,
    /// The figure's name, one of those that the analysis lists.
    name: String,
}

/// The stored things that an analysis names; specs can be large, so this is work for a blocking thread.
async fn references(request: Request) -> ApiResult<References> {
    Ok(off_thread(move || Plan::parse(&request).map(|plan| plan.references())).await??)
}

/// What an analysis is about.
struct About {
    subject: String,
    trials: Vec<String>,
    plant: Option<Model>,
    first: Option<Shown>,
}

impl About {
    async fn read(state: &AppState, request: Request) -> ApiResult<Self> {
        let inline = request.inputs.get("plant").and_then(|plant| serde_json::from_value::<Model>(plant.clone()).ok());
        let References { trials, plants, .. } = references(request).await?;
        let shown = |id: Option<TrialId>| async move {
            match id {
                Some(id) => Shown::read(state, id).await.map(Some),
                None => Ok(None),
            }
        };
        let (first, last) = (shown(trials.first().copied()).await?, shown(trials.last().copied()).await?);
        let name = |shown: &Option<Shown>| shown.as_ref().map_or_else(String::new, |shown| shown.origin().name());
        let subject = match trials.len() {
            0 => "data of the request".to_owned(),
            1 => name(&first),
            count => format!("{count} trials, {} to {}", name(&first), name(&last)),
        };
        // Of several trials the first and the last are named.
        let mut names = vec![String::new(); trials.len()];
        names.iter_mut().for_each(|own| *own = "trial".to_owned());
        for (own, shown) in [(0, &first), (trials.len().saturating_sub(1), &last)] {
            if let Some(slot) = names.get_mut(own) {
                *slot = name(shown);
            }
        }
        let plant = match (inline, plants.first()) {
            (Some(model), _) => Some(model),
            (None, Some(id)) => Some(state.store.plant(*id).await?.model),
            (None, None) => first.as_ref().map(|first| first.plant.model.clone()),
        };
        Ok(Self { subject, trials: names, plant, first })
    }
}

/// Lists the figures of an analysis: those of its kind.
#[utoipa::path(get, path = "/v1/analyses/{analysis}/figures", tag = "figures",
    operation_id = "list_analysis_figures", params(AnalysisPath, IfNoneMatch),
    responses((status = 200, description = "The figures by name.", body = FigureList)))]
pub(crate) async fn list(analysis: Named<AnalysisView>) -> ApiResult<Response> {
    let record = analysis.state.store.analysis(analysis.id).await?;
    let spec = record.request.spec.clone();
    let has_trial = !references(record.request).await?.trials.is_empty();
    let all = offered(record.kind, has_trial, &spec);
    etag::conditional(&analysis.headers, &FigureList::new(&format!("/v1/analyses/{}", analysis.id), &all))
}

/// Draws a figure of a report, one of those that its kind has: the controllers (`bode`), the closed loop's response
/// (`response`), poles (`poles`), candidates that fit nearly as well (`near_optimal`), the recording against the
/// identified loop (`simulated`), what a cost weighs (`cost`), Kalman's inequality (`return_difference`), the descent
/// that was asked for (`descent`), a simulation (`signals`, `bode`, `step`), an excitation (`signal`, `spectrum`,
/// `autocorrelation`, `flatness`), a compensator's flatness gain (`compensator`), or a design (`input`, `improvement`,
/// `outputs`, `autocorrelation`, `deviations`).
#[utoipa::path(get, path = "/v1/analyses/{analysis}/figures/{name}", tag = "figures",
    operation_id = "draw_analysis_figure", params(AnalysisFigurePath, FigureQuery, IfNoneMatch),
    responses(
        (status = 200, description = "The figure.",
            content((String = "image/svg+xml"), (String = "image/png"), (String = "text/csv"),
                (Figure = "application/json"))),
        (status = 409, description = "There is no report: the analysis is not finished, failed, or was cancelled; or \
            it is of another version."),
        (status = 422, description = "There is nothing in view, a picture needs colours, or the report has nothing to \
            draw.")))]
pub(crate) async fn read(
    State(state): State<AppState>,
    Id(id): Id<AnalysisId>,
    name: FigureName,
    Params(query): Params<FigureQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let record = state.store.analysis(id).await?;
    let (inputs, spec) = (record.request.inputs.clone(), record.request.spec.clone());
    let about = About::read(&state, record.request).await?;
    let name = name.among(&offered(record.kind, about.first.is_some(), &spec))?;
    let text = report_text(&state, id).await?;
    let trial = match &about.first {
        Some(first) if name == simulated::NAME => Some(state.store.trial_signals(first.record.id).await?),
        _ => None,
    };
    let figure = move || {
        let report: Report = serde_json::from_str(&text)
            .map_err(|error| Problem::new(Code::Internal, "unreadable report", error.to_string()))?;
        make(name, &report, &inputs, &about, trial.as_ref())
    };
    answer(&state, &headers, query, None, figure).await
}

/// A figure of a report by its name.
fn make(name: &str, report: &Report, inputs: &Value, about: &About, trial: Option<&Trial>) -> Result<Figure, Problem> {
    let subject = &*about.subject;
    let found = match (name, &about.first, trial) {
        (simulated::NAME, Some(first), Some(trial)) => simulated(report, trial, &first.origin(), about.plant.as_ref()),
        (response::NAME, ..) => response(report, subject),
        (poles::NAME, ..) => poles(report, subject),
        (near_optimal::NAME, ..) => near_optimal(report, subject),
        (cost::NAME, ..) => cost(report, inputs, subject),
        (return_difference::NAME, ..) => return_difference(report, inputs, subject),
        (compensator::NAME, ..) => compensator(report, subject),
        (descent::NAME, ..) => descent(report, subject),
        (own, ..) if report.kind == simulate_kind::Plan::KIND => simulation(report, own, subject),
        (own, ..) if report.kind == input_design_kind::Plan::KIND && DESIGN.iter().any(|one| one.name == own) => {
            input_design(report, own, subject)
        }
        (own, ..) if EXCITATION.iter().any(|one| one.name == own) => excitation(report, own, subject),
        _ => {
            let sample_time_s = about.first.as_ref().map(|first| first.record.sample_time_s);
            let (trials, plant) = (&*about.trials, about.plant.as_ref());
            bode(report, &Origin { subject, trials, plant, sample_time_s })
        }
    };
    found.map_err(|error| problem(&error))
}

/// All figures that a report can be drawn as, each made when it is asked for.
pub(crate) struct Drawable {
    names: Vec<&'static str>,
    inputs: Value,
    about: About,
    trial: Option<Trial>,
}

impl Drawable {
    /// What the analysis is about: a trial, or several.
    pub(crate) fn subject(&self) -> &str {
        &self.about.subject
    }

    /// The figures; those that the report has nothing for are left out.
    pub(crate) fn figures(&self, report: &Report) -> Vec<Figure> {
        let made = |name: &&str| make(name, report, &self.inputs, &self.about, self.trial.as_ref()).ok();
        self.names.iter().filter_map(made).collect()
    }
}

/// What the figures of an analysis are made from.
pub(crate) async fn drawable(state: &AppState, record: &AnalysisRecord) -> ApiResult<Drawable> {
    let about = About::read(state, record.request.clone()).await?;
    let names: Vec<&'static str> =
        offered(record.kind, about.first.is_some(), &record.request.spec).iter().map(|own| own.name).collect();
    let trial = match &about.first {
        Some(first) if names.contains(&simulated::NAME) => Some(state.store.trial_signals(first.record.id).await?),
        _ => None,
    };
    Ok(Drawable { names, inputs: record.request.inputs.clone(), about, trial })
}

fn problem(error: &Unreadable) -> Problem {
    match error {
        Unreadable::Kind { .. } => Problem::new(Code::NotFound, "no such figure", error.to_string()),
        Unreadable::Form(_) => Problem::new(Code::Conflict, "a report of another version", error.to_string())
            .mend("Queue the analysis again."),
        Unreadable::Nothing(_) => Problem::new(Code::Invalid, "nothing to draw", error.to_string()),
    }
}
