//! Trials, or frequency data in their place.

use super::fitted::FittedTrials;
use super::library::{Library, References};
use super::plant::parse_model;
use crate::analysis::contract::{Inputs, Part, members_sha256};
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::wrong_inputs as wrong;
use crate::control::Model;
use crate::trial::pointer;
use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Display;

/// Lines of frequency data in a request at most.
const MAX_LINES: usize = 10_000;

/// Where frequency data are in a request.
const RESPONSES: &str = "/inputs/frequency_response";

/// Responses of the closed loop at some lines, as people write them.
pub trait Responses: Serialize + DeserializeOwned + JsonSchema + Send + Sync {
    /// Checks lengths and values.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    fn check(&self) -> Result<(), Problem>;

    /// The same in increasing frequency, of data that have been checked.
    #[must_use]
    fn sorted(self) -> Self;

    /// Refuses inputs that are meant for another kind.
    ///
    /// # Errors
    /// A [`Problem`] that names the other kind.
    fn refuse_others(_inputs: &Value) -> Result<(), Problem> {
        Ok(())
    }
}

/// What an identification starts from: trials, each with its plant, or a plant and frequency data.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
#[schemars(rename = "TrialsOr{D}")]
pub enum TrialsOrResponses<D> {
    /// Trials, each with its plant.
    Trials(FittedTrials),
    /// A plant and frequency data.
    Responses(PlantAndResponses<D>),
}

/// A plant and frequency data of the loop around it.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields, rename = "PlantAnd{D}")]
pub struct PlantAndResponses<D> {
    /// The known plant, from control to output.
    pub plant: Model,
    /// Frequency data of the closed loop.
    pub frequency_response: D,
}

impl<D: Responses> TrialsOrResponses<D> {
    /// Whether the request carries frequency data instead of trials.
    #[must_use]
    pub fn is_responses(&self) -> bool {
        matches!(self, Self::Responses(_))
    }

    /// The plant given in the request.
    #[must_use]
    pub fn inline_plant(&self) -> Option<&Model> {
        match self {
            Self::Trials(trials) => trials.inline_plant(),
            Self::Responses(given) => Some(&given.plant),
        }
    }
}

impl<D: Responses> Part for TrialsOrResponses<D> {
    fn read(inputs: &Value, at: &str) -> Result<Self, Problem> {
        D::refuse_others(inputs)?;
        let Some(data) = inputs.get("frequency_response") else {
            return FittedTrials::read(inputs, at).map(Self::Trials);
        };
        for name in inputs.as_object().into_iter().flat_map(|members| members.keys()) {
            if !["frequency_response", "plant"].contains(&name.as_str()) {
                let detail = format!("there is no input {name:?} beside frequency_response and plant");
                return Err(wrong(detail, pointer::member("/inputs", name))
                    .mend("Give trials, or frequency data with their plant, not both."));
            }
        }
        let data: D = serde_json::from_value(data.clone()).map_err(|error| wrong(error.to_string(), RESPONSES))?;
        let plant = inputs
            .get("plant")
            .filter(|plant| !plant.is_null())
            .ok_or_else(|| wrong("there is no plant", "/inputs").mend("Give the plant beside the data."))?;
        let plant = parse_model(plant, "/inputs/plant")?;
        data.check()?;
        Ok(Self::Responses(PlantAndResponses { plant, frequency_response: data.sorted() }))
    }
}

impl<D: Responses> Inputs for TrialsOrResponses<D> {
    fn references(&self) -> References {
        match self {
            Self::Trials(trials) => trials.references(),
            Self::Responses(_) => References::default(),
        }
    }

    fn sha256(&self, library: &Library) -> Result<BTreeMap<String, String>, Problem> {
        match self {
            Self::Trials(trials) => trials.sha256(library),
            Self::Responses(given) => Ok(members_sha256(given)),
        }
    }
}

/// A problem of a field of the frequency data in a request.
pub fn wrong_data(detail: impl Into<String>, field: impl Display) -> Problem {
    Problem::new(Code::Invalid, "unusable frequency data", detail).at(format!("{RESPONSES}/{field}"))
}

/// Frequencies must be there, finite, not negative and each there once; `from_zero` says whether 0 is one.
///
/// # Errors
/// A [`Problem`] with the pointer of the first that is wrong.
pub fn check_frequencies(omega_rad_s: &[f64], from_zero: bool) -> Result<(), Problem> {
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
    }
    let order = increasing(omega_rad_s);
    match order.windows(2).find(|pair| omega_rad_s[pair[0]] == omega_rad_s[pair[1]]) {
        None => Ok(()),
        Some(twins) => {
            let detail = format!(
                "the frequency {} is there twice, at the places {} and {}",
                omega_rad_s[twins[0]], twins[0], twins[1]
            );
            Err(wrong_data(detail, format!("omega_rad_s/{}", twins[1]))
                .mend("Leave one of the two out, or average their responses."))
        }
    }
}

/// The places of frequencies in increasing order.
#[must_use]
pub fn increasing(omega_rad_s: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..omega_rad_s.len()).collect();
    order.sort_by(|a, b| omega_rad_s[*a].total_cmp(&omega_rad_s[*b]));
    order
}

/// Values in another order.
pub fn in_order<T: Clone>(values: &[T], order: &[usize]) -> Vec<T> {
    order.iter().map(|i| values[*i].clone()).collect()
}

/// There must be a response for every frequency.
///
/// # Errors
/// A [`Problem`] with the pointer of the responses.
pub fn check_responses(responses: usize, lines: usize, field: &str) -> Result<(), Problem> {
    if responses == lines {
        return Ok(());
    }
    Err(wrong_data(format!("there are {responses} responses at {lines} frequencies"), field))
}

/// Variances, where there are any, must be positive, one for every frequency.
///
/// # Errors
/// A [`Problem`] with the pointer of the first that is wrong.
pub fn check_variances(variance: Option<&[f64]>, lines: usize, field: &str) -> Result<(), Problem> {
    let Some(variance) = variance else { return Ok(()) };
    if variance.len() != lines {
        return Err(wrong_data(format!("there are {} variances at {lines} frequencies", variance.len()), field));
    }
    match variance.iter().position(|v| !(v.is_finite() && *v > 0.0)) {
        Some(i) => Err(wrong_data(format!("the variance {} is not positive", variance[i]), format!("{field}/{i}"))),
        None => Ok(()),
    }
}
