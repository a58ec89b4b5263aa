//! Inputs that a design begins with.

use super::model::ModelInput;
use super::spec::CheckedSpec;
use super::wrong;
use crate::analysis::problem::Problem;
use crate::ctl::Ctl;
use crate::excite::sequence::{CheckedSequence, SequenceError, SequenceSpec};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Starts at most.
const MOST: usize = 20;

/// A start: samples, or a sequence to be made with the design's sample time. A longer one is cut, a periodic shorter one repeated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum StartInput {
    /// N samples.
    Samples(Vec<f64>),
    /// A sequence.
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

#[derive(Debug, Clone, PartialEq)]
enum Start {
    Samples(Vec<f64>),
    Sequence(Box<CheckedSequence>),
}

/// Checked starts.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Starts(Vec<Start>);

impl Starts {
    pub fn parse(value: Option<&Value>, spec: &CheckedSpec) -> Result<Self, Problem> {
        const FORMS: &str =
            "Give a list of starts, each an array of samples or a sequence {\"generator\": .., \"sample_time_s\": ..}.";
        let list = value
            .and_then(Value::as_array)
            .ok_or_else(|| wrong("there is no list of starts", "/inputs/starts").mend(FORMS))?;
        if !(1..=MOST).contains(&list.len()) {
            return Err(wrong(format!("there are {} starts; 1 to {MOST} are taken", list.len()), "/inputs/starts"));
        }
        let samples = spec.written.samples;
        let starts = list.iter().enumerate().map(|(i, value)| {
            let at = format!("/inputs/starts/{i}");
            if value.is_array() {
                let values: Vec<f64> =
                    serde_json::from_value(value.clone()).map_err(|error| wrong(error.to_string(), at.clone()))?;
                if values.len() != samples {
                    return Err(wrong(format!("there are {} samples, and the record has {samples}", values.len()), at));
                }
                return Ok(Start::Samples(values));
            }
            let written: SequenceSpec = serde_json::from_value(value.clone())
                .map_err(|error| wrong(error.to_string(), at.clone()).mend(FORMS))?;
            if written.sample_time_s != spec.sample_time_s {
                return Err(wrong(
                    format!(
                        "the sequence is sampled every {} s, the record every {} s",
                        written.sample_time_s, spec.sample_time_s
                    ),
                    format!("{at}/sample_time_s"),
                ));
            }
            let checked = written.check().map_err(|error| sequence(&error, &at))?;
            if checked.samples() < samples && checked.spec().period_s().is_none() {
                return Err(wrong(
                    format!("the sequence has {} samples, and the record {samples}", checked.samples()),
                    at,
                )
                .mend("Make it longer."));
            }
            Ok(Start::Sequence(Box::new(checked)))
        });
        starts.collect::<Result<_, _>>().map(Self)
    }

    pub fn written(&self) -> Value {
        let one = |start: &Start| match start {
            Start::Samples(samples) => json!(samples),
            Start::Sequence(sequence) => json!(sequence.spec()),
        };
        Value::Array(self.0.iter().map(one).collect())
    }

    /// The samples of every start.
    pub fn sampled(&self, samples: usize, ctl: &Ctl) -> Result<Vec<Vec<f64>>, crate::analysis::Failure> {
        let mut all = Vec::new();
        for (i, start) in self.0.iter().enumerate() {
            all.push(match start {
                Start::Samples(values) => values.clone(),
                Start::Sequence(sequence_start) => {
                    let made = sequence_start.sample(ctl).map_err(|error| match error {
                        SequenceError::Stopped(stopped) => crate::analysis::Failure::Stopped(stopped),
                        error => sequence(&error, &format!("/inputs/starts/{i}")).into(),
                    })?;
                    // Whole periods where there is one; of a period that is no whole number of samples, what there is.
                    let values = made.one_period().unwrap_or(&made.values);
                    values.iter().copied().cycle().take(samples).collect()
                }
            });
        }
        Ok(all)
    }
}

fn sequence(error: &SequenceError, at: &str) -> Problem {
    wrong(error.to_string(), error.field().map_or_else(|| at.to_owned(), |field| format!("{at}/{field}")))
}
