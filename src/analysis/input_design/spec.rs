//! How the design is put, as people write it.

use super::refusal::{TITLE, wrong};
use crate::analysis::contract::Part;
use crate::analysis::problem::Problem;
use crate::analysis::reading;
use crate::excite::design::Criterion;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// A largest magnitude, or a range.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
#[schemars(rename = "InputDesignLimit")]
pub enum Limit {
    /// The largest magnitude, in the unit of what is limited.
    #[schemars(title = "Magnitude")]
    Magnitude(f64),
    /// Least and largest value, in the unit of what is limited.
    #[schemars(title = "Range")]
    Range([f64; 2]),
}

impl Limit {
    pub(super) fn range(self) -> [f64; 2] {
        match self {
            Self::Magnitude(most) => [-most, most],
            Self::Range(range) => range,
        }
    }
}

/// A limit on the difference of two outputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "InputDesignDifferenceLimit")]
pub struct DifferenceLimit {
    /// The outputs: the first less the second.
    pub of: [String; 2],
    /// The limit, in the unit of the outputs.
    pub limit: Limit,
}

/// How predictable the input may be: its normalised autocorrelation stays within `tolerance` of a reference at the lags
/// 1 to `lags`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "InputDesignAutocorrelation")]
pub struct AutocorrelationSpec {
    /// β, dimensionless, above 0 and below 2. Default: 0.16.
    #[serde(default = "tolerance")]
    pub tolerance: f64,
    /// γ, dimensionless: steps aim at β − γ. Default: an eighth of β.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub margin: Option<f64>,
    /// The largest lag, in samples. Default: half of the record less 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lags: Option<usize>,
    /// The reference at the lags 1, 2, …, dimensionless, from −1 to 1. Default: the autocorrelation of each start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<Vec<f64>>,
}

fn tolerance() -> f64 {
    0.16
}

/// What the input must keep to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "InputDesignLimits")]
pub struct LimitsSpec {
    /// On every sample of the input, in its unit.
    pub input: Limit,
    /// On the magnitude of the input's change from sample to sample, in its unit. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub input_change: Option<f64>,
    /// On outputs of the model, by name, in their units; measured or not, so that the person's torque is one of them.
    #[serde(default)]
    pub outputs: BTreeMap<String, Limit>,
    /// On differences of outputs. Default: none.
    #[serde(default)]
    pub differences: Vec<DifferenceLimit>,
    /// On the autocorrelation. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub autocorrelation: Option<AutocorrelationSpec>,
}

/// Simulated records that are fitted anew, to check the predicted standard deviations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "InputDesignMonteCarlo")]
pub struct MonteCarloSpec {
    /// Records of each of the two inputs, 10 to 2,000. Default: 100.
    #[serde(default = "replicates")]
    pub replicates: usize,
    /// Seed of the noise. Default: 1.
    #[serde(default = "seed")]
    pub seed: u64,
}

fn replicates() -> usize {
    100
}
fn seed() -> u64 {
    1
}

/// The spec of `input_design`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InputDesignSpec {
    /// Length of the record in samples, N: 10 to 2,000. The outputs y_0 … y_{N−1} that are recorded beside the input
    /// samples u_0 … u_{N−1} are what is scored and limited, and nothing after them.
    pub samples: usize,
    /// Sample time in seconds; that of the model, where it is a sampled one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sample_time_s: Option<f64>,
    /// What is made large. Default: `d`.
    #[serde(default = "criterion")]
    pub criterion: Criterion,
    /// Names of the measured outputs. Default: both angles of seated balance, the angle of the head, all outputs of a
    /// model in the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<Vec<String>>,
    /// Covariance of the noise of the measured outputs, in products of their units, samples being independent. Default:
    /// the identity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_covariance: Option<Vec<Vec<f64>>>,
    /// Scales of parameters for the scaled criteria, by name, in their units. Default: their magnitudes.
    #[serde(default)]
    pub scales: BTreeMap<String, f64>,
    /// Which input is designed, from 0; the others stay zero. Default: 0.
    #[serde(default)]
    pub input: usize,
    /// What the input must keep to.
    pub limits: LimitsSpec,
    /// Whether starts that break a limit are scaled down until they fit. Default: false.
    #[serde(default)]
    pub scale_to_fit: bool,
    /// δ_u, in the unit of the input: the largest change of a sample in a step. Default: a fortieth of the input's
    /// largest magnitude.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trust_region: Option<f64>,
    /// The climb ends where no step within the trust region gains more than this share, above 0 and below 1: to first
    /// order, by the bound of a linear program over the whole region. Default: 1e-3.
    #[serde(default = "growth")]
    pub tolerance: f64,
    /// Steps from each start at most, 1 to 2,000. Default: 200.
    #[serde(default = "steps")]
    pub max_steps: usize,
    /// Simulated records that are fitted anew. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub monte_carlo: Option<MonteCarloSpec>,
}

fn criterion() -> Criterion {
    Criterion::D
}
fn growth() -> f64 {
    1e-3
}
fn steps() -> usize {
    200
}

impl Part for InputDesignSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        let members = value.as_object().ok_or_else(|| wrong("the spec is no object", at))?;
        for needed in ["samples", "limits"] {
            if !members.contains_key(needed) {
                return Err(wrong(format!("there is no {needed}"), at)
                    .mend("Give samples and limits, {\"input\": ..} at least."));
            }
        }
        reading::read(value, at, TITLE)
    }
}
