//! What is estimated from: trials, or the loop's responses in the request; and trials to validate on.

use crate::analysis::inputs::References;
use crate::analysis::problem::{Code, Problem};
use crate::analysis::trial_input::{PlantNeed, TrialInputs, parse_model};
use crate::control::Model;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use utoipa::ToSchema;

/// Lines at most.
const MAX_LINES: usize = 10_000;

/// The loop's responses to both stimuli, in a request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StimulusResponsesInput {
    /// Angular frequencies in rad/s, positive, increasing.
    pub omega_rad_s: Vec<f64>,
    /// The response from command to output at each as `[re, im]`; null where the command does not excite the line.
    pub h_yr: Vec<Option<[f64; 2]>>,
    /// The response from disturbance to output; null where the disturbance does not excite the line.
    pub h_yd: Vec<Option<[f64; 2]>>,
    /// The variance `E|h − E h|²` of each `h_yr`, positive.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variance_yr: Option<Vec<f64>>,
    /// The variance of each `h_yd`. Both are given, or neither.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variance_yd: Option<Vec<f64>>,
}

impl StimulusResponsesInput {
    fn check(&self) -> Result<(), Problem> {
        const AT: &str = "/inputs/frequency_response";
        let wrong = |detail: String, field: &str| {
            Problem::new(Code::Invalid, "unusable frequency data", detail).at(format!("{AT}/{field}"))
        };
        let lines = self.omega_rad_s.len();
        if lines == 0 || lines > MAX_LINES {
            return Err(wrong(format!("there are {lines} frequencies; 1 to {MAX_LINES} are taken"), "omega_rad_s"));
        }
        for (i, omega) in self.omega_rad_s.iter().enumerate() {
            let before = if i > 0 { self.omega_rad_s[i - 1] } else { 0.0 };
            let increases = *omega > before && omega.is_finite();
            if !increases {
                return Err(wrong(
                    format!("the frequency {omega} follows {before}; frequencies must be positive and increase"),
                    &format!("omega_rad_s/{i}"),
                ));
            }
        }
        for (name, h) in [("h_yr", &self.h_yr), ("h_yd", &self.h_yd)] {
            if h.len() != lines {
                return Err(wrong(format!("there are {} responses at {lines} frequencies", h.len()), name));
            }
            if let Some(i) = h.iter().position(|h| h.is_some_and(|[re, im]| re == 0.0 && im == 0.0)) {
                let detail = "the response is zero, and says nothing about the controllers".to_owned();
                return Err(wrong(detail, &format!("{name}/{i}")));
            }
        }
        if self.variance_yr.is_some() != self.variance_yd.is_some() {
            return Err(wrong("one response has variances and the other has none".to_owned(), "variance_yr"));
        }
        for (name, variance) in [("variance_yr", &self.variance_yr), ("variance_yd", &self.variance_yd)] {
            let Some(variance) = variance else { continue };
            if variance.len() != lines {
                return Err(wrong(format!("there are {} variances at {lines} frequencies", variance.len()), name));
            }
            if let Some(i) = variance.iter().position(|v| !(v.is_finite() && *v > 0.0)) {
                return Err(wrong(format!("the variance {} is not positive", variance[i]), &format!("{name}/{i}")));
            }
        }
        Ok(())
    }
}

/// Checked inputs.
#[derive(Debug, Clone, PartialEq)]
pub enum TwoStimulusInputs {
    /// Trials, each with its plant.
    Trials {
        /// Those that are estimated from.
        trials: TrialInputs,
        /// Those that the fits are simulated on.
        validate_on: Option<TrialInputs>,
    },
    /// A plant and the loop's responses.
    Responses {
        /// The plant.
        plant: Model,
        /// The responses.
        data: StimulusResponsesInput,
    },
}

impl TwoStimulusInputs {
    /// Checks the `inputs` of a request.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(inputs: &Value) -> Result<Self, Problem> {
        let wrong = |detail: String, at: &str| Problem::new(Code::Invalid, "unusable inputs", detail).at(at);
        let Some(data) = inputs.get("frequency_response") else {
            let mut rest = inputs.clone();
            let validate_on = rest.as_object_mut().and_then(|members| members.remove("validate_on"));
            let trials = TrialInputs::parse(&rest, PlantNeed::Required)?;
            let validate_on = match validate_on {
                None | Some(Value::Null) => None,
                Some(list) => {
                    let mut members = Map::from_iter([("trials".to_owned(), list)]);
                    if let Some(plant) = rest.get("plant") {
                        members.insert("plant".to_owned(), plant.clone());
                    }
                    let parsed = TrialInputs::parse(&Value::Object(members), PlantNeed::Required).map_err(renamed)?;
                    if trials.references().trials.iter().any(|id| parsed.references().trials.contains(id)) {
                        return Err(wrong(
                            "a trial to validate on is among those that are estimated from".to_owned(),
                            "/inputs/validate_on",
                        )
                        .mend("Keep them apart: a model explains best what it was fitted to."));
                    }
                    Some(parsed)
                }
            };
            return Ok(Self::Trials { trials, validate_on });
        };
        for name in inputs.as_object().into_iter().flat_map(|members| members.keys()) {
            if !["frequency_response", "plant"].contains(&name.as_str()) {
                return Err(wrong(
                    format!("there is no input {name:?} beside frequency_response and plant"),
                    &format!("/inputs/{}", name.replace('~', "~0").replace('/', "~1")),
                )
                .mend("Give trials, or responses with their plant, not both."));
            }
        }
        let data: StimulusResponsesInput = serde_json::from_value(data.clone())
            .map_err(|error| wrong(error.to_string(), "/inputs/frequency_response"))?;
        data.check()?;
        let plant = inputs
            .get("plant")
            .filter(|plant| !plant.is_null())
            .ok_or_else(|| wrong("there is no plant".to_owned(), "/inputs").mend("Give the plant beside the data."))?;
        Ok(Self::Responses { plant: parse_model(plant, "/inputs/plant")?, data })
    }

    /// Whether the request carries responses instead of trials.
    #[must_use]
    pub fn is_responses(&self) -> bool {
        matches!(self, Self::Responses { .. })
    }

    /// The plant given in the request.
    #[must_use]
    pub fn inline_plant(&self) -> Option<&Model> {
        match self {
            Self::Trials { trials, .. } => trials.inline_plant(),
            Self::Responses { plant, .. } => Some(plant),
        }
    }

    /// The stored things among them.
    #[must_use]
    pub fn references(&self) -> References {
        match self {
            Self::Trials { trials, validate_on } => {
                let mut references = trials.references();
                if let Some(validate_on) = validate_on {
                    references.trials.extend(validate_on.references().trials);
                }
                references
            }
            Self::Responses { .. } => References::default(),
        }
    }

    /// The canonical `inputs`: parsing them again gives equal inputs.
    #[must_use]
    pub fn to_value(&self) -> Value {
        match self {
            Self::Trials { trials, validate_on } => {
                let mut value = trials.to_value();
                let held = validate_on.as_ref().map(TrialInputs::to_value).and_then(|v| v.get("trials").cloned());
                if let (Some(members), Some(held)) = (value.as_object_mut(), held) {
                    members.insert("validate_on".to_owned(), held);
                }
                value
            }
            Self::Responses { plant, data } => json!({"plant": plant, "frequency_response": data}),
        }
    }
}

/// Problems of `trials` belong to `validate_on` there.
pub(super) fn renamed(mut problem: Problem) -> Problem {
    problem.location = problem.location.map(|at| at.replacen("/inputs/trials", "/inputs/validate_on", 1));
    problem
}
