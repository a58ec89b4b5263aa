//! What is designed for, and what the design begins with, as people write it.

use super::model_input::ModelInput;
use super::refusal::{TITLE, wrong};
use crate::analysis::contract::{Inputs, Part};
use crate::analysis::problem::Problem;
use crate::analysis::reading;
use crate::excite::sequence::SequenceSpec;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Starts at most.
const MOST: usize = 20;
/// The forms of a start.
pub(super) const FORMS: &str =
    "Give a list of starts, each an array of samples or a sequence {\"generator\": .., \"sample_time_s\": ..}.";

/// A start: samples, or a sequence to be made with the design's sample time. A longer one is cut, a periodic shorter
/// one repeated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "InputDesignStart")]
#[serde(untagged)]
pub enum StartInput {
    /// N samples, in the unit of the model's input.
    #[schemars(title = "Samples")]
    Samples(Vec<f64>),
    /// A sequence, in the unit of the model's input.
    #[schemars(title = "Sequence")]
    Sequence(Box<SequenceSpec>),
}

/// The inputs of `input_design`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InputDesignInputs {
    /// The model.
    pub model: ModelInput,
    /// Inputs that the design begins with, 1 to 20; the best end of all climbs is the answer.
    pub starts: Vec<StartInput>,
}

impl Part for InputDesignInputs {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        let members = value.as_object().ok_or_else(|| wrong("the inputs are no object", at))?;
        for name in members.keys() {
            if !matches!(name.as_str(), "model" | "starts") {
                return Err(
                    wrong(format!("input_design takes no input {name:?}"), at).mend("It takes model and starts.")
                );
            }
        }
        let model = members.get("model").ok_or_else(|| {
            wrong("there is no model", at).mend("Give a model of the catalogue by name, or matrices.")
        })?;
        let model = ModelInput::read(model, &format!("{at}/model"))?;
        let list = members
            .get("starts")
            .and_then(Value::as_array)
            .ok_or_else(|| wrong("there is no list of starts", format!("{at}/starts")).mend(FORMS))?;
        if !(1..=MOST).contains(&list.len()) {
            let detail = format!("there are {} starts; 1 to {MOST} are taken", list.len());
            return Err(wrong(detail, format!("{at}/starts")));
        }
        let start = |(i, value): (usize, &Value)| {
            let at = format!("{at}/starts/{i}");
            // One form or the other, so that errors speak of the form that is meant.
            if value.is_array() {
                reading::read(value, &at, TITLE).map(StartInput::Samples)
            } else {
                let read = reading::read(value, &at, TITLE).map(|spec| StartInput::Sequence(Box::new(spec)));
                read.map_err(|problem| problem.mend(FORMS))
            }
        };
        Ok(Self { model, starts: list.iter().enumerate().map(start).collect::<Result<_, _>>()? })
    }
}

impl Inputs for InputDesignInputs {}
