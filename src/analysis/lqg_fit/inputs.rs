//! What is fitted: the plant that the person controlled, and trials.

use crate::analysis::contract::{Inputs, Part, members_sha256};
use crate::analysis::ids::TrialId;
use crate::analysis::inputs::library::{Library, References};
use crate::analysis::inputs::recorded::{self, needed, place};
use crate::analysis::inputs::sampled_signal::SampledSignal;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{self, only, wrong_inputs as wrong};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// What costs and noises are fitted to: the plant that the person controlled, in the states that the costs are about,
/// and one trial or several, all stored or all in the request.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct LqgFitInputs {
    /// The plant, also of stored trials: which states a cost is about only its writer knows.
    pub plant: LqgFitPlant,
    /// What the person takes the plant for, where that is something else: of as many controls, disturbances and sensed
    /// outputs. Its first states are those of the plant. Costs and perceived noises are of its states. Default: the
    /// plant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub internal_model: Option<LqgFitPlant>,
    /// One trial; either this or `trials`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trial: Option<LqgFitTrialInput>,
    /// Several trials, 1 to 1000; either this or `trial`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trials: Option<Vec<LqgFitTrialInput>>,
}

/// The plant, `x⁺ = Ax + B(u + m) + Ed + w`, `y = Cx + Dd + v`; in continuous time u and d are held between samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LqgFitPlant {
    /// A, n×n: in the unit of `x⁺` per unit of the state, so 1/s of it in continuous time.
    pub a: Vec<Vec<f64>>,
    /// B, n×m: in the unit of `x⁺` per unit of the control.
    pub b: Vec<Vec<f64>>,
    /// C, p×n: in the unit of the output per unit of the state. Default: the identity, all states sensed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub c: Option<Vec<Vec<f64>>>,
    /// E, n×q: in the unit of `x⁺` per unit of the disturbance. Default: B, a disturbance that is added to the control.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub e: Option<Vec<Vec<f64>>>,
    /// D, p×q: in the unit of the output per unit of the disturbance; what the person sees of it at once. Default:
    /// zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub d: Option<Vec<Vec<f64>>>,
    /// C_r, r×n, where an instrument (`instrument_variance`) recorded other outputs than those that are sensed: in the
    /// unit of the recorded output per unit of the state. Default: C, with D.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub c_recorded: Option<Vec<Vec<f64>>>,
    /// Sample time in seconds; null in continuous time.
    #[serde(default)]
    pub sample_time_s: Option<f64>,
}

/// A trial of a request.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum LqgFitTrialInput {
    /// The id of a stored trial. Its disturbance is d where it has one, its command otherwise.
    #[schemars(title = "StoredTrial")]
    Stored(TrialId),
    /// The signals themselves.
    #[schemars(title = "InlineTrial")]
    Inline(LqgFitTrial),
}

/// A trial in the request, sampled at equal intervals.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct LqgFitTrial {
    /// Time between samples in seconds, the same in all trials.
    pub sample_time_s: f64,
    /// d, what the experimenter did, held between samples: one row of q numbers per sample, or a plain list where q is
    /// 1; in the units of the plant's disturbance. Default: nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub disturbance: Option<SampledSignal>,
    /// y, one row of p numbers per sample, or a plain list where p is 1; in the units of the plant's outputs.
    pub output: SampledSignal,
    /// u, one row of m numbers per sample, or a plain list where m is 1; in the units of the plant's controls. Default:
    /// not recorded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control: Option<SampledSignal>,
    /// The n states at the first sample, in their units, where `initial_state` is `given`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub initial_state: Option<Vec<f64>>,
}

impl LqgFitInputs {
    /// The trials, in the order of the request.
    #[must_use]
    pub fn trials(&self) -> &[LqgFitTrialInput] {
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
            LqgFitTrialInput::Stored(id) => Some((i, *id)),
            LqgFitTrialInput::Inline(_) => None,
        })
    }
}

impl Part for LqgFitInputs {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        let members = reading::object(value, "the value of inputs", at)?;
        only(members, &["plant", "internal_model", "trial", "trials"], at)?;
        let present = |name: &str| members.get(name).filter(|v| !v.is_null());
        let plant = present("plant").ok_or_else(|| {
            wrong("there is no plant", "/inputs/plant")
                .mend("Give the plant that the person controlled, in the states that the costs are about: a, b, c, e.")
        })?;
        let plant = reading::read(plant, "/inputs/plant", "unusable inputs")?;
        let internal_model = present("internal_model")
            .map(|model| reading::read(model, "/inputs/internal_model", "unusable inputs"))
            .transpose()?;
        let (list, many) = recorded::listed(members, "sample_time_s, output and control", at)?;
        let mut trials: Vec<LqgFitTrialInput> = Vec::with_capacity(list.len());
        for (i, value) in list.iter().enumerate() {
            let at = place(many, i);
            let trial = match value.as_str() {
                Some(text) => LqgFitTrialInput::Stored(recorded::id(text, &at)?),
                None => LqgFitTrialInput::Inline(LqgFitTrial::read(value, &at)?),
            };
            recorded::add(&mut trials, trial, &at)?;
        }
        let (trial, trials) = if many { (None, Some(trials)) } else { (trials.pop(), None) };
        Ok(Self { plant, internal_model, trial, trials })
    }
}

impl Inputs for LqgFitInputs {
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

impl LqgFitTrial {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        let members = reading::object(value, "a trial that is no id", at)?;
        only(members, &["sample_time_s", "disturbance", "output", "control", "initial_state"], at)?;
        let present = |name: &str| members.get(name).filter(|v| !v.is_null());
        let signal = |value: &Value, name: &str| SampledSignal::read(value, name, &format!("{at}/{name}"));
        Ok(Self {
            sample_time_s: recorded::sample_time_s(members, at)?,
            disturbance: present("disturbance").map(|value| signal(value, "disturbance")).transpose()?,
            output: signal(needed(members, "output", at)?, "output")?,
            control: present("control").map(|value| signal(value, "control")).transpose()?,
            initial_state: present("initial_state")
                .map(|value| reading::read(value, &format!("{at}/initial_state"), "unusable inputs"))
                .transpose()?,
        })
    }
}
