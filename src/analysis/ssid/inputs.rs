//! What is identified from: trials, or frequency data in the request.

use crate::analysis::inputs::References;
use crate::analysis::problem::{Code, Problem};
use crate::analysis::trial_input::{PlantNeed, TrialInputs, parse_model};
use crate::control::Model;
use crate::identify::frequency::FrequencyData;
use num_complex::Complex64;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::ToSchema;

/// Lines of frequency data at most.
const MAX_LINES: usize = 10_000;

/// Where trials to validate on are in a request.
pub(super) const HELD_OUT: &str = "/inputs/validate_on";

/// Frequency data in a request: the closed loop's response from command to output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
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
        const AT: &str = "/inputs/frequency_response";
        let wrong = |detail: String, field: &str| {
            Problem::new(Code::Invalid, "unusable frequency data", detail).at(format!("{AT}/{field}"))
        };
        let lines = self.omega_rad_s.len();
        if lines == 0 || lines > MAX_LINES {
            return Err(wrong(format!("there are {lines} frequencies; 1 to {MAX_LINES} are taken"), "omega_rad_s"));
        }
        if self.h.len() != lines {
            return Err(wrong(format!("there are {} responses at {lines} frequencies", self.h.len()), "h"));
        }
        for (i, omega) in self.omega_rad_s.iter().enumerate() {
            if !(omega.is_finite() && *omega >= 0.0) {
                return Err(wrong(format!("the frequency {omega} is negative"), &format!("omega_rad_s/{i}")));
            }
            if i > 0 && *omega <= self.omega_rad_s[i - 1] {
                return Err(wrong(
                    format!("the frequency {omega} follows {}; frequencies must increase", self.omega_rad_s[i - 1]),
                    &format!("omega_rad_s/{i}"),
                ));
            }
        }
        if let Some(averages) = self.averages
            && (self.variance.is_none() || averages < 2)
        {
            let detail = format!("variances of {averages} segments, with no variance or too few segments for one");
            return Err(wrong(detail, "averages"));
        }
        if let Some(variance) = &self.variance {
            if variance.len() != lines {
                return Err(wrong(
                    format!("there are {} variances at {lines} frequencies", variance.len()),
                    "variance",
                ));
            }
            if let Some(i) = variance.iter().position(|v| !(v.is_finite() && *v > 0.0)) {
                return Err(wrong(format!("the variance {} is not positive", variance[i]), &format!("variance/{i}")));
            }
        }
        Ok(())
    }
}

/// Checked inputs.
#[derive(Debug, Clone, PartialEq)]
pub enum SsidInputs {
    /// Trials, each with its plant.
    Trials {
        /// Those that are identified from.
        fitted: TrialInputs,
        /// Those that the result is simulated on beside them.
        held_out: Option<TrialInputs>,
    },
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
            return Self::parse_trials(inputs);
        };
        let wrong = |detail: String, at: &str| Problem::new(Code::Invalid, "unusable inputs", detail).at(at);
        for name in inputs.as_object().into_iter().flat_map(|members| members.keys()) {
            if !["frequency_response", "plant"].contains(&name.as_str()) {
                return Err(wrong(
                    format!("there is no input {name:?} beside frequency_response and plant"),
                    &format!("/inputs/{}", name.replace('~', "~0").replace('/', "~1")),
                )
                .mend("Give trials, or frequency data with their plant, not both."));
            }
        }
        let data: FrequencyResponseInput = serde_json::from_value(data.clone())
            .map_err(|error| wrong(error.to_string(), "/inputs/frequency_response"))?;
        data.check()?;
        let plant = inputs
            .get("plant")
            .filter(|plant| !plant.is_null())
            .ok_or_else(|| wrong("there is no plant".to_owned(), "/inputs").mend("Give the plant beside the data."))?;
        Ok(Self::FrequencyResponse { plant: parse_model(plant, "/inputs/plant")?, data })
    }

    /// Trials, with `validate_on` beside them: `{"trial": ID, "validate_on": [ID, ..]}`, or signals in both places.
    fn parse_trials(inputs: &Value) -> Result<Self, Problem> {
        let mut members = inputs.clone();
        let held_out = members.as_object_mut().and_then(|members| members.remove("validate_on"));
        let fitted = TrialInputs::parse(&members, PlantNeed::Required)?;
        let Some(held_out) = held_out else { return Ok(Self::Trials { fitted, held_out: None }) };
        let mut request = json!({"trials": held_out});
        if let (Some(plant), true) = (inputs.get("plant"), fitted.inline_plant().is_some()) {
            request["plant"] = plant.clone();
        }
        let held_out = TrialInputs::parse(&request, PlantNeed::Required).map_err(|mut problem| {
            problem.location = problem.location.map(|at| at.replacen("/inputs/trials", HELD_OUT, 1));
            problem
        })?;
        Ok(Self::Trials { fitted, held_out: Some(held_out) })
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
            Self::Trials { fitted, .. } => fitted.inline_plant(),
            Self::FrequencyResponse { plant, .. } => Some(plant),
        }
    }

    /// The stored things among them.
    #[must_use]
    pub fn references(&self) -> References {
        match self {
            Self::Trials { fitted, held_out } => {
                let mut references = fitted.references();
                for id in held_out.iter().flat_map(|inputs| inputs.references().trials) {
                    if !references.trials.contains(&id) {
                        references.trials.push(id);
                    }
                }
                references
            }
            Self::FrequencyResponse { .. } => References::default(),
        }
    }

    /// The canonical `inputs`: parsing them again gives equal inputs.
    #[must_use]
    pub fn to_value(&self) -> Value {
        match self {
            Self::Trials { fitted, held_out } => {
                let mut value = fitted.to_value();
                if let Some(held_out) = held_out {
                    value["validate_on"] = held_out.to_value()["trials"].take();
                }
                value
            }
            Self::FrequencyResponse { plant, data } => json!({"plant": plant, "frequency_response": data}),
        }
    }
}
