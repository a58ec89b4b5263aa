//! What is identified from: trials, or frequency data in the request.

use crate::analysis::inputs::References;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{self, FittedTrials};
use crate::control::Model;
use crate::response::FrequencyData;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Frequency data in a request: the closed loop's response from command to output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FrequencyResponseInput {
    /// Angular frequencies in rad/s, not negative, increasing.
    pub omega_rad_s: Vec<f64>,
    /// The response at each as `[re, im]`.
    pub h: Vec<[f64; 2]>,
    /// The variance `E|h − E h|²` at each, positive; weights by inverse variance and the uncertainty of refined controllers need it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variance: Option<Vec<f64>>,
    /// The number of segments that each variance was estimated from, 2 or more; absent, the variances count as known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub averages: Option<u32>,
}

impl FrequencyResponseInput {
    /// As the identification takes it.
    #[must_use]
    pub fn data(&self) -> FrequencyData {
        FrequencyData {
            omega_rad_s: self.omega_rad_s.clone(),
            h: self.h.iter().map(|[re, im]| Complex64::new(*re, *im)).collect(),
            variance: self.variance.clone(),
        }
    }

    fn check(&self) -> Result<(), Problem> {
        let lines = self.omega_rad_s.len();
        reading::check_frequencies(&self.omega_rad_s, true)?;
        reading::check_responses(self.h.len(), lines, "h")?;
        if let Some(averages) = self.averages
            && (self.variance.is_none() || averages < 2)
        {
            let detail = format!("variances of {averages} segments, with no variance or too few segments for one");
            return Err(reading::wrong_data(detail, "averages"));
        }
        reading::check_variances(self.variance.as_deref(), lines, "variance")
    }
}

/// Checked inputs.
#[derive(Debug, Clone, PartialEq)]
pub enum SsidInputs {
    /// Trials, each with its plant.
    Trials(FittedTrials),
    /// A plant and frequency data.
    FrequencyResponse {
        /// The plant.
        plant: Model,
        /// The data.
        data: FrequencyResponseInput,
    },
}

impl SsidInputs {
    /// Checks the `inputs` of a request.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(inputs: &Value) -> Result<Self, Problem> {
        let Some(data) = inputs.get("frequency_response") else {
            return FittedTrials::parse(inputs).map(Self::Trials);
        };
        let (plant, data): (Model, FrequencyResponseInput) = reading::plant_and_data(inputs, data)?;
        data.check()?;
        Ok(Self::FrequencyResponse { plant, data })
    }

    /// Whether the request carries frequency data instead of trials.
    #[must_use]
    pub fn is_frequency_data(&self) -> bool {
        matches!(self, Self::FrequencyResponse { .. })
    }

    /// The plant given in the request.
    #[must_use]
    pub fn inline_plant(&self) -> Option<&Model> {
        match self {
            Self::Trials(trials) => trials.inline_plant(),
            Self::FrequencyResponse { plant, .. } => Some(plant),
        }
    }

    /// The stored things among them.
    #[must_use]
    pub fn references(&self) -> References {
        match self {
            Self::Trials(trials) => trials.references(),
            Self::FrequencyResponse { .. } => References::default(),
        }
    }

    /// The canonical `inputs`: parsing them again gives equal inputs.
    #[must_use]
    pub fn to_value(&self) -> Value {
        match self {
            Self::Trials(trials) => trials.to_value(),
            Self::FrequencyResponse { plant, data } => json!({"plant": plant, "frequency_response": data}),
        }
    }
}
