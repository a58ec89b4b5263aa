//! What the readers of requests have in common: members read one by one, lists of frequencies, trials with others held out.

use super::inputs::{Library, References};
use super::problem::{Code, Problem};
use super::ssid::problems::{check_sample_times, common_plant};
use super::trial_input::{PlantNeed, ResolvedTrial, TrialInputs, parse_model};
use crate::control::{Model, System};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};

/// Lines of frequency data in a request at most.
pub(super) const MAX_LINES: usize = 10_000;

/// Where frequency data are in a request.
const RESPONSES: &str = "/inputs/frequency_response";

/// Where trials to validate on are in a request.
const HELD_OUT: &str = "/inputs/validate_on";

/// The JSON pointer of a member.
pub(super) fn pointer(at: &str, name: &str) -> String {
    format!("{at}/{}", name.replace('~', "~0").replace('/', "~1"))
}

/// A problem of the spec.
pub(super) fn wrong_spec(detail: impl Into<String>, location: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "unusable spec", detail).at(location)
}

/// Reads an object; what is wrong is found by its member.
///
/// # Errors
/// A [`Problem`] with the pointer of the first member that cannot be read.
pub(super) fn members<T: DeserializeOwned>(members: &Map<String, Value>, at: &str, title: &str) -> Result<T, Problem> {
    let wrong = |error: serde_json::Error, at: String| Problem::new(Code::Invalid, title, error.to_string()).at(at);
    // One at a time first, since the deserialiser does not say where it stopped.
    for (name, value) in members {
        let alone = Value::Object(Map::from_iter([(name.clone(), value.clone())]));
        serde_json::from_value::<T>(alone).map_err(|error| wrong(error, pointer(at, name)))?;
    }
    serde_json::from_value(Value::Object(members.clone())).map_err(|error| wrong(error, at.to_owned()))
}

/// Reads the `spec` of a request.
///
/// # Errors
/// As [`members`]; also where it is no object.
pub(super) fn spec<T: DeserializeOwned>(spec: &Value) -> Result<T, Problem> {
    let Value::Object(written) = spec else { return Err(wrong_spec("the spec is no object", "/spec")) };
    members(written, "/spec", "unusable spec")
}

/// A problem of a field of the frequency data in a request.
pub(super) fn wrong_data(detail: impl Into<String>, field: impl std::fmt::Display) -> Problem {
    Problem::new(Code::Invalid, "unusable frequency data", detail).at(format!("{RESPONSES}/{field}"))
}

/// Frequencies must be there, finite, not negative and increase; `from_zero` says whether 0 is one.
pub(super) fn check_frequencies(omega_rad_s: &[f64], from_zero: bool) -> Result<(), Problem> {
    let lines = omega_rad_s.len();
    if lines == 0 || lines > MAX_LINES {
        return Err(wrong_data(format!("there are {lines} frequencies; 1 to {MAX_LINES} are taken"), "omega_rad_s"));
    }
    for (i, omega) in omega_rad_s.iter().enumerate() {
        let at = format!("omega_rad_s/{i}");
        if !(omega.is_finite() && *omega >= 0.0) {
            return Err(wrong_data(format!("the frequency {omega} is negative"), at));
        }
        if *omega == 0.0 && !from_zero {
            return Err(wrong_data("a frequency is 0, and must be positive", at));
        }
        if i > 0 && *omega <= omega_rad_s[i - 1] {
            let detail = format!("the frequency {omega} follows {}; frequencies must increase", omega_rad_s[i - 1]);
            return Err(wrong_data(detail, at));
        }
    }
    Ok(())
}

/// There must be a response for every frequency.
pub(super) fn check_responses(responses: usize, lines: usize, field: &str) -> Result<(), Problem> {
    if responses == lines {
        return Ok(());
    }
    Err(wrong_data(format!("there are {responses} responses at {lines} frequencies"), field))
}

/// Variances, where there are any, must be positive, one for every frequency.
pub(super) fn check_variances(variance: Option<&[f64]>, lines: usize, field: &str) -> Result<(), Problem> {
    let Some(variance) = variance else { return Ok(()) };
    if variance.len() != lines {
        return Err(wrong_data(format!("there are {} variances at {lines} frequencies", variance.len()), field));
    }
    match variance.iter().position(|v| !(v.is_finite() && *v > 0.0)) {
        Some(i) => Err(wrong_data(format!("the variance {} is not positive", variance[i]), format!("{field}/{i}"))),
        None => Ok(()),
    }
}

/// The plant and the frequency data of a request that has these two members alone.
///
/// # Errors
/// A [`Problem`] with the pointer of what is wrong.
pub(super) fn plant_and_data<T: DeserializeOwned>(inputs: &Value, data: &Value) -> Result<(Model, T), Problem> {
    let wrong = |detail: String, at: &str| Problem::new(Code::Invalid, "unusable inputs", detail).at(at);
    for name in inputs.as_object().into_iter().flat_map(|members| members.keys()) {
        if !["frequency_response", "plant"].contains(&name.as_str()) {
            let detail = format!("there is no input {name:?} beside frequency_response and plant");
            return Err(wrong(detail, &pointer("/inputs", name))
                .mend("Give trials, or frequency data with their plant, not both."));
        }
    }
    let data = serde_json::from_value(data.clone()).map_err(|error| wrong(error.to_string(), RESPONSES))?;
    let plant = inputs
        .get("plant")
        .filter(|plant| !plant.is_null())
        .ok_or_else(|| wrong("there is no plant".to_owned(), "/inputs").mend("Give the plant beside the data."))?;
    Ok((parse_model(plant, "/inputs/plant")?, data))
}

/// Trials that are fitted, and others that the result is only simulated on: `{"trial": ID, "validate_on": [ID, ..]}`, or signals in both places.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedTrials {
    fitted: TrialInputs,
    held_out: Option<TrialInputs>,
}

/// [`FittedTrials`] at hand, all on one plant and none in both places.
pub(super) struct Resolved {
    pub plant: System,
    pub fitted: Vec<ResolvedTrial>,
    pub held_out: Vec<ResolvedTrial>,
}

fn not_held_out(detail: String, at: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "not held out", detail)
        .at(at)
        .mend("Keep them apart: a model explains best what it was fitted to.")
}

/// Problems of `trials` belong to `validate_on` there.
fn moved(mut problem: Problem) -> Problem {
    problem.location = problem.location.map(|at| at.replacen("/inputs/trials", HELD_OUT, 1));
    problem
}

impl FittedTrials {
    /// Checks the `inputs` of a request.
    ///
    /// # Errors
    /// A [`Problem`] with the pointer of what is wrong.
    pub(super) fn parse(inputs: &Value) -> Result<Self, Problem> {
        let mut members = inputs.clone();
        let held_out = members.as_object_mut().and_then(|members| members.remove("validate_on"));
        let fitted = TrialInputs::parse(&members, PlantNeed::Required)?;
        let Some(held_out) = held_out.filter(|list| !list.is_null()) else {
            return Ok(Self { fitted, held_out: None });
        };
        let mut request = json!({"trials": held_out});
        if let (Some(plant), true) = (inputs.get("plant"), fitted.inline_plant().is_some()) {
            request["plant"] = plant.clone();
        }
        let held_out = TrialInputs::parse(&request, PlantNeed::Required).map_err(moved)?;
        let known = fitted.references().trials;
        if let Some(i) = held_out.references().trials.iter().position(|id| known.contains(id)) {
            let detail = format!("{HELD_OUT}/{i} is fitted too, and a fit is no validation of itself");
            return Err(not_held_out(detail, format!("{HELD_OUT}/{i}")));
        }
        Ok(Self { fitted, held_out: Some(held_out) })
    }

    /// The plant given in the request.
    pub(super) fn inline_plant(&self) -> Option<&Model> {
        self.fitted.inline_plant()
    }

    /// The stored things among them.
    pub(super) fn references(&self) -> References {
        let mut references = self.fitted.references();
        references.trials.extend(self.held_out.iter().flat_map(|inputs| inputs.references().trials));
        references
    }

    /// The canonical `inputs`: parsing them again gives equal inputs.
    pub(super) fn to_value(&self) -> Value {
        let mut value = self.fitted.to_value();
        if let Some(held_out) = &self.held_out {
            value["validate_on"] = held_out.to_value()["trials"].take();
        }
        value
    }

    /// Finds the trials and checks what only they can tell: one plant, its sample time, and none that is fitted and held out at once.
    ///
    /// # Errors
    /// A [`Problem`] with the place of the trial.
    pub(super) fn resolve(&self, library: &Library) -> Result<Resolved, Problem> {
        let fitted = self.fitted.resolve(library)?;
        let plant = common_plant(&fitted)?;
        check_sample_times(&plant, &fitted)?;
        let mut held_out = match &self.held_out {
            None => return Ok(Resolved { plant, fitted, held_out: Vec::new() }),
            Some(inputs) => inputs.resolve(library).map_err(moved)?,
        };
        for trial in &mut held_out {
            trial.name = trial.name.replacen("/inputs/trials", HELD_OUT, 1);
            if let Some(twin) = fitted.iter().find(|other| other.sha256 == trial.sha256) {
                let detail =
                    format!("{} is fitted too ({}), and a fit is no validation of itself", trial.name, twin.name);
                return Err(not_held_out(detail, trial.name.clone()));
            }
        }
        if common_plant(&held_out)? != plant {
            let detail = "the trials to validate on were recorded on another plant than those that are fitted";
            return Err(Problem::new(Code::Invalid, "different plants", detail).at(HELD_OUT));
        }
        check_sample_times(&plant, &held_out)?;
        Ok(Resolved { plant, fitted, held_out })
    }
}
