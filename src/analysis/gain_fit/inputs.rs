//! What is fitted: trials, and the plant that the person controlled.

use super::plant::GainFitPlant;
use crate::analysis::contract::{Inputs, Part, members_sha256};
use crate::analysis::ids::TrialId;
use crate::analysis::inputs::library::{Library, References};
use crate::analysis::inputs::recorded::{self, needed, place};
use crate::analysis::inputs::sampled_signal::SampledSignal;
use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_inputs as wrong;
use crate::trial::pointer;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// What gains are fitted to: one trial or several, all stored or all in the request, and the plant that the person
/// controlled.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct GainFitInputs {
    /// The plant. Default: that of the stored trials; trials in the request need one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plant: Option<GainFitPlant>,
    /// One trial; either this or `trials`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trial: Option<GainFitTrialInput>,
    /// Several trials, 1 to 1000; either this or `trial`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trials: Option<Vec<GainFitTrialInput>>,
}

/// A trial of a request.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum GainFitTrialInput {
    /// The id of a stored trial. Its disturbance is the input where it has one, its command otherwise.
    #[schemars(title = "StoredTrial")]
    Stored(TrialId),
    /// The signals themselves.
    #[schemars(title = "InlineTrial")]
    Inline(GainFitTrial),
}

/// A trial in the request, sampled at equal intervals.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct GainFitTrial {
    /// Time between samples in seconds, the same in all trials.
    pub sample_time_s: f64,
    /// What the experimenter did, in the units of the plant's input w, held between samples: one row of q numbers per
    /// sample, or a plain list where q is 1.
    pub input: SampledSignal,
    /// What was measured, in the units of the plant's outputs: one row of p numbers per sample, or a plain list where p
    /// is 1.
    pub output: SampledSignal,
    /// What the person did, in the units of the plant's controls, one row of m numbers per sample; only for
    /// `gain_and_filter`. Default: not recorded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control: Option<SampledSignal>,
    /// The state of the plant at the first sample, n numbers in the units of its states. Default: not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub initial_state: Option<Vec<f64>>,
}

impl GainFitInputs {
    /// The trials, in the order of the request.
    #[must_use]
    pub fn trials(&self) -> &[GainFitTrialInput] {
        match &self.trials {
            Some(trials) => trials,
            None => self.trial.as_slice(),
        }
    }

    /// Where a trial is in the request, as a JSON pointer.
    pub(super) fn place(&self, index: usize) -> String {
        place(self.trials.is_some(), index)
    }

    fn stored(&self) -> impl Iterator<Item = (usize, TrialId)> {
        self.trials().iter().enumerate().filter_map(|(i, trial)| match trial {
            GainFitTrialInput::Stored(id) => Some((i, *id)),
            GainFitTrialInput::Inline(_) => None,
        })
    }
}

impl Part for GainFitInputs {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        let Value::Object(members) = value else {
            return Err(wrong("the inputs are no object", at));
        };
        if let Some(name) = stray(members, &["plant", "trial", "trials"]) {
            return Err(wrong(format!("there is no input {name:?}"), pointer::member(at, name))
                .mend("Inputs are plant, and trial or trials."));
        }
        let present = |name: &str| members.get(name).filter(|v| !v.is_null());
        let (list, many) = recorded::listed(members, "sample_time_s, input and output", at)?;
        let plant = present("plant").map(GainFitPlant::read).transpose()?;
        if plant.is_none() && !list[0].is_string() {
            return Err(no_plant());
        }
        let mut trials: Vec<GainFitTrialInput> = Vec::with_capacity(list.len());
        for (i, value) in list.iter().enumerate() {
            let at = place(many, i);
            trials.push(match value.as_str() {
                Some(text) => {
                    let id = recorded::id(text, &at)?;
                    if trials.contains(&GainFitTrialInput::Stored(id)) {
                        return Err(wrong("this trial is named twice", at)
                            .mend("Twice the same noise is no second measurement."));
                    }
                    GainFitTrialInput::Stored(id)
                }
                None => GainFitTrialInput::Inline(GainFitTrial::read(value, &at)?),
            });
        }
        Ok(if many {
            Self { plant, trial: None, trials: Some(trials) }
        } else {
            Self { plant, trial: trials.pop(), trials: None }
        })
    }
}

impl Inputs for GainFitInputs {
    fn references(&self) -> References {
        References { trials: self.stored().map(|(_, id)| id).collect(), ..References::default() }
    }

    /// Of each member, and of the content of each stored trial.
    fn sha256(&self, library: &Library) -> Result<BTreeMap<String, String>, Problem> {
        let mut hashes = members_sha256(self);
        for (i, id) in self.stored() {
            let at = self.place(i);
            let stored = recorded::stored(library, id, &at)?;
            hashes.insert(at, stored.sha256.clone());
        }
        Ok(hashes)
    }
}

impl GainFitTrial {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        let Value::Object(members) = value else {
            return Err(wrong("a trial is the id of a stored one, or an object with its signals", at));
        };
        let known = ["sample_time_s", "input", "output", "control", "initial_state"];
        if let Some(name) = stray(members, &known) {
            return Err(wrong(format!("a trial has no {name:?}"), at).mend(format!("It has: {}.", known.join(", "))));
        }
        let present = |name: &str| members.get(name).filter(|v| !v.is_null());
        let signal = |value: &Value, name: &str| SampledSignal::read(value, name, &format!("{at}/{name}"));
        let state = |value: &Value| {
            serde_json::from_value(value.clone())
                .map_err(|error| wrong(error.to_string(), format!("{at}/initial_state")))
        };
        Ok(Self {
            sample_time_s: recorded::sample_time_s(members, at)?,
            input: signal(needed(members, "input", at)?, "input")?,
            output: signal(needed(members, "output", at)?, "output")?,
            control: present("control").map(|value| signal(value, "control")).transpose()?,
            initial_state: present("initial_state").map(state).transpose()?,
        })
    }
}

/// Trials in the request without a plant.
pub(super) fn no_plant() -> Problem {
    wrong("there is no plant", "/inputs/plant")
        .mend("Give the plant that the person controlled: {\"name\": \"seated_balance\"} or its matrices.")
}

/// A member of an object that is not known.
fn stray<'a>(members: &'a Map<String, Value>, known: &[&str]) -> Option<&'a String> {
    members.keys().find(|name| !known.contains(&name.as_str()))
}
