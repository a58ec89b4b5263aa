//! Trials with several channels, all stored or all in the request.

use super::library::{Library, StoredTrial};
use crate::analysis::ids::TrialId;
use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_inputs as wrong;
use nalgebra::DMatrix;
use serde_json::{Map, Value};

/// Trials at most.
const MAX_TRIALS: usize = 1000;

/// Where a trial is in the request, as a JSON pointer.
pub(crate) fn place(many: bool, index: usize) -> String {
    if many { format!("/inputs/trials/{index}") } else { "/inputs/trial".to_owned() }
}

/// The trials as they are written, and whether they are in a list: one as `trial`, or several as `trials`. `members`
/// says what the signals of a trial are.
pub(crate) fn listed<'a>(
    inputs: &'a Map<String, Value>,
    members: &str,
    at: &str,
) -> Result<(&'a [Value], bool), Problem> {
    let present = |name: &str| inputs.get(name).filter(|v| !v.is_null());
    let (list, many) = match (present("trial"), present("trials")) {
        (Some(trial), None) => (std::slice::from_ref(trial), false),
        (None, Some(Value::Array(trials))) => (trials.as_slice(), true),
        (None, Some(_)) => return Err(wrong("trials is no array", "/inputs/trials")),
        (Some(_), Some(_)) => return Err(wrong("there are both trial and trials", at)),
        (None, None) => {
            return Err(wrong("there is no trial", at)
                .mend(format!("Give trials: ids of stored ones, or objects with {members}.")));
        }
    };
    if list.is_empty() || list.len() > MAX_TRIALS {
        let detail = format!("there are {} trials; 1 to {MAX_TRIALS} are taken", list.len());
        return Err(wrong(detail, "/inputs/trials"));
    }
    if let Some(i) = list.iter().position(|trial| trial.is_string() != list[0].is_string()) {
        return Err(wrong("ids and signals are mixed", place(many, i)));
    }
    Ok((list, many))
}

/// The id of a stored trial.
pub(crate) fn id(text: &str, at: &str) -> Result<TrialId, Problem> {
    text.parse().map_err(|_| wrong(format!("{text:?} is no id of a trial"), at).mend("Ids are UUIDs."))
}

/// A stored trial whose place in the request is told where it is gone.
pub(crate) fn stored<'a>(library: &'a Library, id: TrialId, at: &str) -> Result<&'a StoredTrial, Problem> {
    Ok(library.trial(id).map_err(|problem| problem.at(at))?)
}

/// The sample time of a trial in the request.
pub(crate) fn sample_time_s(trial: &Map<String, Value>, at: &str) -> Result<f64, Problem> {
    let period = needed(trial, "sample_time_s", at)?;
    period.as_f64().filter(|v| *v > 0.0 && v.is_finite()).ok_or_else(|| {
        let detail = format!("the sample time is {period}, and must be a positive number of seconds");
        wrong(detail, format!("{at}/sample_time_s"))
    })
}

/// A member that every trial in the request has.
pub(crate) fn needed<'a>(trial: &'a Map<String, Value>, name: &str, at: &str) -> Result<&'a Value, Problem> {
    let found = trial.get(name).filter(|v| !v.is_null());
    found.ok_or_else(|| wrong(format!("the trial has no {name}"), format!("{at}/{name}")))
}

/// Refuses signals beside the output that are not as long.
pub(crate) fn as_long(
    output: &DMatrix<f64>,
    others: &[(&str, Option<&DMatrix<f64>>)],
    at: &str,
) -> Result<(), Problem> {
    for (name, other) in others {
        if let Some(other) = other.filter(|other| other.nrows() != output.nrows()) {
            let detail = format!("the {name} has {} samples and the output has {}", other.nrows(), output.nrows());
            return Err(wrong(detail, format!("{at}/{name}")));
        }
    }
    Ok(())
}

/// Adds what is not there yet: twice the same noise is no second measurement.
pub(crate) fn add<T: PartialEq>(all: &mut Vec<T>, found: T, at: &str) -> Result<(), Problem> {
    if all.contains(&found) {
        return Err(wrong("this is the same recording as an earlier one", at)
            .mend("Twice the same noise is no second measurement."));
    }
    all.push(found);
    Ok(())
}
