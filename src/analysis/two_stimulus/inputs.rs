//! What is estimated from: trials, or the loop's responses in the request; and trials to validate on.

use crate::analysis::inputs::data::{
    Responses, TrialsOrResponses, check_frequencies, check_responses, check_variances, in_order, increasing, wrong_data,
};
use crate::analysis::problem::{Code, Problem};
use crate::two_stimulus::responses::LineResponse;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What is estimated from.
pub type TwoStimulusInputs = TrialsOrResponses<TwoStimulusResponses>;

/// The loop's responses to both stimuli, in a request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TwoStimulusResponses {
    /// Angular frequencies in rad/s, positive, each once; they are sorted.
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

impl Responses for TwoStimulusResponses {
    fn check(&self) -> Result<(), Problem> {
        let lines = self.omega_rad_s.len();
        check_frequencies(&self.omega_rad_s, false)?;
        for (name, h) in [("h_yr", &self.h_yr), ("h_yd", &self.h_yd)] {
            check_responses(h.len(), lines, name)?;
            if let Some(i) = h.iter().position(|h| h.is_some_and(|[re, im]| re == 0.0 && im == 0.0)) {
                let detail = "the response is zero, and says nothing about the controllers";
                return Err(wrong_data(detail, format!("{name}/{i}")));
            }
        }
        if self.variance_yr.is_some() != self.variance_yd.is_some() {
            return Err(wrong_data("one response has variances and the other has none", "variance_yr"));
        }
        check_variances(self.variance_yr.as_deref(), lines, "variance_yr")?;
        check_variances(self.variance_yd.as_deref(), lines, "variance_yd")
    }

    fn sorted(self) -> Self {
        let order = increasing(&self.omega_rad_s);
        Self {
            omega_rad_s: in_order(&self.omega_rad_s, &order),
            h_yr: in_order(&self.h_yr, &order),
            h_yd: in_order(&self.h_yd, &order),
            variance_yr: self.variance_yr.map(|variance| in_order(&variance, &order)),
            variance_yd: self.variance_yd.map(|variance| in_order(&variance, &order)),
        }
    }
}

/// The inputs do not tell feedback from feedforward.
pub(super) fn no_disturbance(lines: &[LineResponse]) -> Problem {
    if lines.iter().any(|line| line.confounded) {
        return Problem::new(
            Code::NotIdentifiable,
            "command and disturbance are confounded",
            "command and disturbance excite the same lines in one proportion, so their effects cannot be told apart",
        )
        .at("/inputs")
        .mend("Add a trial in which one of them has the other sign, or excite interleaved lines.");
    }
    Problem::new(
        Code::NotIdentifiable,
        "the feedback is not determined",
        "the disturbance excites no line, and from the command alone feedback and feedforward cannot be told apart: \
         every feedback has a feedforward with the same response",
    )
    .at("/inputs")
    .mend(
        "Add trials with a disturbance at the plant's input, or ask for ssid, which tells them apart by assumed \
           degrees.",
    )
}
