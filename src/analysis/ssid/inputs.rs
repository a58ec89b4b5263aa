//! What is identified from: trials, or frequency data in the request.

use crate::analysis::inputs::data::{
    Responses, TrialsOrResponses, check_frequencies, check_responses, check_variances, in_order, increasing, wrong_data,
};
use crate::analysis::problem::{Code, Problem};
use crate::response::FrequencyData;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// What is identified from.
pub type SsidInputs = TrialsOrResponses<SsidResponses>;

/// Frequency data in a request: the closed loop's response from command to output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SsidResponses {
    /// Angular frequencies in rad/s, not negative, each once; they are sorted.
    pub omega_rad_s: Vec<f64>,
    /// The response at each as `[re, im]`.
    pub h: Vec<[f64; 2]>,
    /// The variance `E|h − E h|²` at each, positive; weights by inverse variance and the uncertainty of refined
    /// controllers need it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variance: Option<Vec<f64>>,
    /// The number of segments that each variance was estimated from, 2 or more; absent, the variances count as known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub averages: Option<u32>,
}

impl SsidResponses {
    /// As the identification takes it.
    #[must_use]
    pub fn data(&self) -> FrequencyData {
        FrequencyData {
            omega_rad_s: self.omega_rad_s.clone(),
            h: self.h.iter().map(|[re, im]| Complex64::new(*re, *im)).collect(),
            variance: self.variance.clone(),
        }
    }
}

impl Responses for SsidResponses {
    fn check(&self) -> Result<(), Problem> {
        let lines = self.omega_rad_s.len();
        check_frequencies(&self.omega_rad_s, true)?;
        check_responses(self.h.len(), lines, "h")?;
        if let Some(averages) = self.averages
            && (self.variance.is_none() || averages < 2)
        {
            let detail = format!("variances of {averages} segments, with no variance or too few segments for one");
            return Err(wrong_data(detail, "averages"));
        }
        check_variances(self.variance.as_deref(), lines, "variance")
    }

    fn sorted(self) -> Self {
        let order = increasing(&self.omega_rad_s);
        Self {
            omega_rad_s: in_order(&self.omega_rad_s, &order),
            h: in_order(&self.h, &order),
            variance: self.variance.map(|variance| in_order(&variance, &order)),
            averages: self.averages,
        }
    }

    /// Matrices belong to `ssid_mimo`.
    fn refuse_others(inputs: &Value) -> Result<(), Problem> {
        let is_matrix = inputs.pointer("/frequency_response/h/0/0").is_some_and(Value::is_array);
        let of_matrices = ["/plant/transfer_functions", "/plant/numerator", "/plant/denominator"]
            .into_iter()
            .chain(["/measured_outputs", "/fed_back_outputs"])
            .find(|place| inputs.pointer(place).is_some())
            .or(is_matrix.then_some("/frequency_response/h"));
        match of_matrices {
            None => Ok(()),
            Some(place) => Err(several_channels("these are inputs", format!("/inputs{place}"))),
        }
    }
}

/// What belongs to identification with several inputs and outputs.
pub(super) fn several_channels(what: &str, at: impl Into<String>) -> Problem {
    let detail = format!("{what} of identification with several inputs and outputs, which is a kind of its own");
    Problem::new(Code::Invalid, "several inputs and outputs", detail)
        .at(at)
        .mend("Ask for the same with \"kind\": \"ssid_mimo\".")
}
