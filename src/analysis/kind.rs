//! The kinds of analysis and the document that asks for one.

use super::problem::{Code, Problem};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;
use utoipa::ToSchema;

/// What is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// The closed-loop frequency response from command to output, with its variance.
    FrequencyResponse,
    /// Subsystem identification: the person's feedforward and feedback controllers.
    Ssid,
    /// The two-stimulus estimate: feedback and feedforward from a command and a disturbance, line by line and by structure.
    TwoStimulus,
    /// The gains of a person, and parameters of the plant, from trials by maximum likelihood.
    GainFit,
    /// The cost for which a feedback gain is optimal.
    InverseLqr,
    /// The noise intensities for which a filter gain is optimal.
    InverseLqe,
    /// Both, for a whole controller.
    InverseLqg,
    /// How flat, rich, unpredictable and bearable an excitation is.
    ExcitationQuality,
    /// The compensator of a position loop that delivers the flattest spectrum.
    CompensatorDesign,
    /// The input that tells the most about the parameters of a model.
    InputDesign,
    /// The experiment whose worst subject is estimated best.
    RobustInputDesign,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Self; 11] = [
        Self::FrequencyResponse,
        Self::Ssid,
        Self::TwoStimulus,
        Self::GainFit,
        Self::InverseLqr,
        Self::InverseLqe,
        Self::InverseLqg,
        Self::ExcitationQuality,
        Self::CompensatorDesign,
        Self::InputDesign,
        Self::RobustInputDesign,
    ];

    /// The name on the wire.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::FrequencyResponse => "frequency_response",
            Self::Ssid => "ssid",
            Self::TwoStimulus => "two_stimulus",
            Self::GainFit => "gain_fit",
            Self::InverseLqr => "inverse_lqr",
            Self::InverseLqe => "inverse_lqe",
            Self::InverseLqg => "inverse_lqg",
            Self::ExcitationQuality => "excitation_quality",
            Self::CompensatorDesign => "compensator_design",
            Self::InputDesign => "input_design",
            Self::RobustInputDesign => "robust_input_design",
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Kind {
    type Err = Problem;

    fn from_str(text: &str) -> Result<Self, Problem> {
        Self::ALL.into_iter().find(|kind| kind.name() == text).ok_or_else(|| {
            let known: Vec<_> = Self::ALL.iter().map(|kind| kind.name()).collect();
            Problem::new(Code::Invalid, "unknown kind of analysis", format!("there is no kind '{text}'"))
                .at("/kind")
                .mend(format!("Use one of: {}.", known.join(", ")))
        })
    }
}

/// A request for an analysis, as people and scripts write it: `{"kind", "inputs", "spec"}`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// The kind, by name.
    #[schema(value_type = Kind)]
    pub kind: String,
    /// What it is computed from: stored things by id, or the data itself.
    #[schema(value_type = Object)]
    pub inputs: serde_json::Value,
    /// How it is computed; what is left out takes its documented default.
    #[serde(default = "empty_object")]
    #[schema(value_type = Object)]
    pub spec: serde_json::Value,
}

fn empty_object() -> serde_json::Value {
    serde_json::Value::Object(serde_json::Map::new())
}
