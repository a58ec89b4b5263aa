//! What is judged.

use crate::analysis::contract::{Inputs, Part};
use crate::analysis::excitation::plant::PlantInput;
use crate::analysis::excitation::signal_input::{SignalInput, TrialSignal, trial_input};
use crate::analysis::inputs::library::{Library, References};
use crate::analysis::inputs::plant::parse_model;
use crate::analysis::inputs::trials::TrialInput;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{object, only, wrong_inputs as wrong};
use crate::analysis::report::sha256_json;
use crate::control::Model;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::Serialize;
use serde_json::{Value, json};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// A signal, and the plant or the loop that it passes through.
///
/// A plant alone is driven by the signal; with a controller the signal is the position asked for of their loop.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields, title = "ExcitationOfSignal")]
pub struct SignalAndPath {
    /// The signal.
    pub signal: SignalInput,
    /// The plant that it passes through. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plant: Option<PlantInput>,
    /// The controller of a loop with the plant. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub controller: Option<Model>,
}

/// A trial for short: the command that was given, and the output that answers to it.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields, title = "ExcitationOfTrial")]
pub struct TrackingTrial {
    /// The trial: `{"trial": ID}` stands for `{"signal": {"trial": ID, "channel": "r", "to": "y"}}`.
    pub trial: TrialInput,
}

/// What is judged, always written in full: a [`TrackingTrial`] is read too, so that one analysis can be asked for of
/// every trial of a study.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub struct ExcitationQualityInputs(SignalAndPath);

impl ExcitationQualityInputs {
    /// In full.
    #[must_use]
    pub fn judged(&self) -> &SignalAndPath {
        &self.0
    }
}

impl From<TrackingTrial> for SignalAndPath {
    fn from(TrackingTrial { trial }: TrackingTrial) -> Self {
        Self { signal: SignalInput::Trial(Box::new(TrialSignal::tracking(trial))), plant: None, controller: None }
    }
}

impl JsonSchema for ExcitationQualityInputs {
    fn schema_name() -> Cow<'static, str> {
        "ExcitationQualityInputs".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let forms = [generator.subschema_for::<SignalAndPath>(), generator.subschema_for::<TrackingTrial>()];
        json_schema!({"anyOf": forms, "description": "A signal with what it passes through, or a trial."})
    }
}

impl Part for ExcitationQualityInputs {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        let members = object(value, "the inputs", at)?;
        let signal = match (members.get("signal"), members.get("trial")) {
            (None, Some(trial)) => {
                only(members, &["trial"], at)?;
                return Ok(Self(TrackingTrial { trial: trial_input(trial, at)? }.into()));
            }
            (Some(signal), _) => {
                only(members, &["signal", "plant", "controller"], at)?;
                SignalInput::parse(signal, "/inputs/signal")?
            }
            (None, None) => {
                return Err(wrong("there is no signal", "/inputs/signal")
                    .mend("Give a generator, a trial or samples as the signal."));
            }
        };
        let present = |name: &str| members.get(name).filter(|value| !value.is_null());
        let plant = present("plant").map(|value| PlantInput::parse(value, "/inputs/plant")).transpose()?;
        if present("controller").is_some() && plant.is_none() {
            return Err(wrong("there is a controller, and no plant", "/inputs/controller")
                .mend("Give the plant that it controls."));
        }
        let controller = present("controller").map(|value| parse_model(value, "/inputs/controller")).transpose()?;
        Ok(Self(SignalAndPath { signal, plant, controller }))
    }
}

impl Inputs for ExcitationQualityInputs {
    fn references(&self) -> References {
        let mut references = self.0.signal.references();
        references.plants.extend(self.0.plant.as_ref().and_then(PlantInput::id));
        references
    }

    fn sha256(&self, library: &Library) -> Result<BTreeMap<String, String>, Problem> {
        const SIGNAL: &str = "/inputs/signal";
        const PLANT: &str = "/inputs/plant";
        let mut hashes = BTreeMap::from([(SIGNAL.to_owned(), self.0.signal.sha256(library, SIGNAL)?)]);
        if let Some(plant) = &self.0.plant {
            hashes.insert(PLANT.to_owned(), plant.sha256(library, PLANT)?);
        }
        if let Some(controller) = &self.0.controller {
            hashes.insert("/inputs/controller".to_owned(), sha256_json(&json!(controller)));
        }
        Ok(hashes)
    }
}
