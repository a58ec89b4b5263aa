//! Inputs that stand for stored things, written out before a request is checked: `{"subject": ID}` for all its trials,
//! `{"analysis": ID}` for the gains that an earlier analysis found.

use super::analyses::report_text;
use super::extract::{from_value, off_thread};
use super::problem::{ApiResult, unless_missing};
use super::state::AppState;
use crate::analysis::ids::AnalysisId;
use crate::analysis::inputs::earlier::{Earlier, EarlierAnalysis, TrialsOfSubject};
use crate::analysis::{Code, Problem, Report, Request, registry};
use crate::store::TrialFilter;
use serde_json::{Map, Value, json};

/// Where the weights to compare with are.
const OTHER: &str = "/inputs/compare_with";

/// The request with what its inputs stand for. What is no shorthand stays as it is.
pub(crate) async fn written_out(state: &AppState, request: Request) -> ApiResult<Request> {
    let is_written = |name: &str| request.inputs.get(name).is_some_and(|value| !value.is_null());
    if is_written("subject") {
        trials_of_subject(state, request).await
    } else if is_written("analysis") {
        earlier(state, request).await
    } else {
        with_other_weights(state, request).await
    }
}

/// A report by the id of its analysis, which is named at `at`.
async fn report(state: &AppState, id: AnalysisId, at: &str) -> ApiResult<Report> {
    if unless_missing(state.store.analysis(id).await)?.is_none() {
        return Err(Problem::new(Code::Invalid, "no such analysis", format!("there is no analysis {id}"))
            .at(at)
            .mend("Check the id; it may have been deleted.")
            .into());
    }
    let text = report_text(state, id).await?;
    let report = off_thread(move || serde_json::from_str(&text)).await?;
    Ok(report.map_err(|error| Problem::new(Code::Internal, "unreadable report", error.to_string()))?)
}

async fn trials_of_subject(state: &AppState, request: Request) -> ApiResult<Request> {
    const AT: &str = "/inputs/subject";
    if !registry::about(&request.kind)?.takes_trials {
        let takers: Vec<&str> = registry::kinds().filter(|k| k.takes_trials).map(|k| k.kind.name()).collect();
        return Err(Problem::new(Code::Invalid, "unusable inputs", format!("{} takes no trials", request.kind))
            .at(AT)
            .mend(format!("Kinds that take all trials of a subject: {}.", takers.join(", ")))
            .into());
    }
    let TrialsOfSubject { subject, session, plant } = from_value(&request.inputs, "/inputs")?;
    let Some(record) = unless_missing(state.store.subject(subject).await)? else {
        return Err(Problem::new(Code::Invalid, "no such subject", format!("there is no subject {subject}"))
            .at(AT)
            .mend("Check the id; it may have been deleted.")
            .into());
    };
    let filter = TrialFilter { subject: Some(subject), session, excluded: Some(false), ..TrialFilter::default() };
    let trials = state.store.matching_trials(record.study, &filter).await?;
    if trials.is_empty() {
        let of_session = session.map_or_else(String::new, |session| format!(" in session {session}"));
        let detail = format!("subject {} has no trial{of_session} that is neither excluded nor divergent", record.code);
        return Err(Problem::new(Code::Invalid, "no trials", detail)
            .at(AT)
            .mend("Upload trials, or name some by \"trials\".")
            .into());
    }
    let mut inputs = json!({"trials": trials.iter().map(|trial| trial.id).collect::<Vec<_>>()});
    if let Some(plant) = plant {
        inputs["plant"] = Value::Object(plant);
    }
    Ok(Request { inputs, ..request })
}

async fn earlier(state: &AppState, request: Request) -> ApiResult<Request> {
    let EarlierAnalysis { analysis, explanation, compare_with, trajectory } = from_value(&request.inputs, "/inputs")?;
    let report = report(state, analysis, "/inputs/analysis").await?;
    let found = registry::of_earlier(&request.kind, &Earlier { analysis, report: &report, explanation })?;
    let spec = found.completed(&request.spec);
    let mut inputs = found.inputs;
    let own = [("compare_with", compare_with), ("trajectory", trajectory)];
    inputs.extend(own.into_iter().filter_map(|(name, value)| Some((name.to_owned(), Value::Object(value?)))));
    with_other_weights(state, Request { inputs: Value::Object(inputs), spec, ..request }).await
}

/// The request with the weights of the analysis that `compare_with` names, where it names one.
async fn with_other_weights(state: &AppState, mut request: Request) -> ApiResult<Request> {
    let Some(other) = request.inputs.get_mut("compare_with").filter(|other| other.get("analysis").is_some()) else {
        return Ok(request);
    };
    /// `{"analysis": ID}`.
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Named {
        analysis: AnalysisId,
    }
    let Named { analysis } = from_value(other, OTHER)?;
    let report = report(state, analysis, OTHER).await?;
    *other = Value::Object(weights(&report)?);
    Ok(request)
}

/// The weights that a report of an inverse problem found, by their letters.
fn weights(report: &Report) -> Result<Map<String, Value>, Problem> {
    let halves = [Some(&report.result), report.result.get("regulator"), report.result.get("filter")];
    let found = halves.into_iter().flatten().flat_map(|half| {
        let letter = |name: &str| {
            let value = half.get(name).filter(|value| value.is_array())?;
            Some((name.to_owned(), value.clone()))
        };
        ["q", "r", "w", "v"].map(letter)
    });
    let found: Map<String, Value> = found.flatten().collect();
    if found.is_empty() {
        let detail = format!("that report of kind {} has no weights for which its gains are optimal", report.kind);
        return Err(Problem::new(Code::Invalid, "no weights to compare with", detail)
            .at(OTHER)
            .mend("Name an analysis of kind inverse_lqr, inverse_lqe or inverse_lqg whose verdict is feasible."));
    }
    Ok(found)
}
