//! What is estimated from: trials, or the loop's responses in the request; and trials to validate on.

use crate::analysis::inputs::References;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{self, FittedTrials};
use crate::control::Model;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The loop's responses to both stimuli, in a request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
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
        let lines = self.omega_rad_s.len();
        reading::check_frequencies(&self.omega_rad_s, false)?;
        for (name, h) in [("h_yr", &self.h_yr), ("h_yd", &self.h_yd)] {
            reading::check_responses(h.len(), lines, name)?;
            if let Some(i) = h.iter().position(|h| h.is_some_and(|[re, im]| re == 0.0 && im == 0.0)) {
                let detail = "the response is zero, and says nothing about the controllers";
                return Err(reading::wrong_data(detail, format!("{name}/{i}")));
            }
        }
        if self.variance_yr.is_some() != self.variance_yd.is_some() {
            return Err(reading::wrong_data("one response has variances and the other has none", "variance_yr"));
        }
        reading::check_variances(self.variance_yr.as_deref(), lines, "variance_yr")?;
        reading::check_variances(self.variance_yd.as_deref(), lines, "variance_yd")
    }
}

/// Checked inputs.
#[derive(Debug, Clone, PartialEq)]
pub enum TwoStimulusInputs {
    /// Trials, each with its plant.
    Trials(FittedTrials),
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
        let Some(data) = inputs.get("frequency_response") else {
            return FittedTrials::parse(inputs).map(Self::Trials);
        };
        let (plant, data): (Model, StimulusResponsesInput) = reading::plant_and_data(inputs, data)?;
        data.check()?;
        Ok(Self::Responses { plant, data })
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
            Self::Trials(trials) => trials.inline_plant(),
            Self::Responses { plant, .. } => Some(plant),
        }
    }

    /// The stored things among them.
    #[must_use]
    pub fn references(&self) -> References {
        match self {
            Self::Trials(trials) => trials.references(),
            Self::Responses { .. } => References::default(),
        }
    }

    /// The canonical `inputs`: parsing them again gives equal inputs.
    #[must_use]
    pub fn to_value(&self) -> Value {
        match self {
            Self::Trials(trials) => trials.to_value(),
            Self::Responses { plant, data } => json!({"plant": plant, "frequency_response": data}),
        }
    }
}
