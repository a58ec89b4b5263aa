//! What is simulated: a plant, controllers with their delays, a command, noise.

use crate::analysis::contract::{Inputs, Part};
use crate::analysis::excitation::signal_input::SignalInput;
use crate::analysis::ids::PlantId;
use crate::analysis::inputs::library::{Library, References};
use crate::analysis::inputs::plant::{check_delayed_plant, parse_model};
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::{object, only, read, wrong_inputs as wrong};
use crate::analysis::report::sha256_json;
use crate::control::Model;
use crate::control::model::TransferFunctionModel;
use crate::plants::catalogue;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Where the parts are in a request.
pub(super) const PLANT: &str = "/inputs/plant";
pub(super) const COMMAND: &str = "/inputs/command";
pub(super) const DISTURBANCE: &str = "/inputs/disturbance";
pub(super) const PREVIEW: &str = "/inputs/preview_s";
pub(super) const INITIAL: &str = "/inputs/initial_state";

/// States given at most.
const MOST_STATES: usize = 1000;

/// Preview and time constants at most, s.
const LONGEST_S: f64 = 1e3;

/// Standard deviations at most, in the unit of their signal.
const LARGEST: f64 = 1e12;

/// The plant that is simulated.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum SimulatedPlant {
    /// A plant of the catalogue, by name.
    #[schemars(title = "CataloguePlant")]
    Catalogue(catalogue::Plant),
    /// The id of a stored plant.
    #[schemars(title = "StoredPlant")]
    Stored(PlantId),
    /// A model, with its delay.
    #[schemars(title = "ModelPlant")]
    Model(Model),
}

/// A signal from outside: a sequence to be made, samples, or a column of a trial. `{"trial": ID}` stands for the
/// trial's command r where a command is asked for, and for its disturbance d where a disturbance is.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub struct StimulusInput(SignalInput);

/// A trial for short.
#[derive(JsonSchema)]
#[schemars(deny_unknown_fields, title = "StimulusOfTrial")]
#[allow(dead_code, reason = "documents a short form that is never written")]
struct StimulusOfTrial {
    /// The trial: the id of a stored one, or the signals themselves.
    trial: crate::analysis::inputs::trials::TrialInput,
}

/// Gaussian noise, drawn at every sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "SimulateNoiseSource")]
#[serde(deny_unknown_fields)]
pub struct NoiseSource {
    /// Standard deviation, in the unit of the signal that it is added to.
    pub sd: f64,
    /// Time constant τ in seconds of a noise that is coloured by one pole, x⁺ = a x + s √(1 − a²) ε with
    /// a = e^(−T/τ): AR(1). Default: 0, white from sample to sample.
    #[serde(default)]
    pub time_constant_s: f64,
}

/// Where noise comes in; what is left out is none.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NoiseInput {
    /// The remnant: part of the control u that no law explains. The loop answers to it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remnant: Option<NoiseSource>,
    /// Error of perception: the person sees y + n. The loop answers to it, the recorded y has it not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub perception: Option<NoiseSource>,
    /// Noise of the sensor: in the recorded y alone, which nobody in the loop sees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measurement: Option<NoiseSource>,
}

impl NoiseInput {
    /// Sources by their names.
    pub(super) fn sources(&self) -> [(&'static str, Option<NoiseSource>); 3] {
        [("remnant", self.remnant), ("perception", self.perception), ("measurement", self.measurement)]
    }

    /// Whether any noise is drawn.
    pub(super) fn is_drawn(&self) -> bool {
        self.sources().iter().any(|(_, source)| source.is_some_and(|source| source.sd > 0.0))
    }
}

/// A loop and what drives it: u = Gff r + Gfb (r − y) + remnant, y = G (u + d).
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct SimulateInputs {
    /// The plant G. Default: that of the stored trial that is the command.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plant: Option<SimulatedPlant>,
    /// The feedforward Gff from command to control, with its delay. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedforward: Option<Model>,
    /// The feedback Gfb from error to control, with its delay. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedback: Option<Model>,
    /// How far ahead the feedforward sees the command, in seconds. The last so many seconds of the command are seen and
    /// not simulated. Default: 0.
    #[serde(default)]
    pub preview_s: f64,
    /// The command r.
    pub command: StimulusInput,
    /// The disturbance d that is added to the control at the plant's input, as long as the command. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub disturbance: Option<StimulusInput>,
    /// Noise. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub noise: Option<NoiseInput>,
    /// Where the plant starts: of state space matrices their state; of a transfer function its output and the output's
    /// derivatives without input (in sampled time: its first samples), in the units of y per power of a second, from
    /// the first on as many as are not zero. Default: at rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub initial_state: Option<Vec<f64>>,
}

impl StimulusInput {
    /// The signal in full.
    #[must_use]
    pub fn signal(&self) -> &SignalInput {
        &self.0
    }

    fn parse(value: &Value, channel: &str, at: &str) -> Result<Self, Problem> {
        let mut value = value.clone();
        if let Some(members) = value.as_object_mut()
            && members.contains_key("trial")
            && !members.contains_key("channel")
        {
            members.insert("channel".to_owned(), json!(channel));
        }
        SignalInput::parse(&value, at).map(Self)
    }
}

impl JsonSchema for StimulusInput {
    fn schema_name() -> Cow<'static, str> {
        "SimulateStimulus".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let forms = [generator.subschema_for::<SignalInput>(), generator.subschema_for::<StimulusOfTrial>()];
        json_schema!({
            "anyOf": forms,
            "description": "A sequence to be made, samples, or a column of a trial; a trial alone stands for its \
                            command, or for its disturbance.",
        })
    }
}

impl SimulatedPlant {
    fn parse(value: &Value) -> Result<Self, Problem> {
        let Some(text) = value.as_str() else {
            let model = parse_model(value, PLANT)?;
            check_delayed_plant(&model, PLANT)?;
            return Ok(Self::Model(model));
        };
        if let Ok(id) = text.parse() {
            return Ok(Self::Stored(id));
        }
        catalogue::Plant::by_name(text)
            .map(Self::Catalogue)
            .map_err(|error| wrong(error.to_string(), PLANT).mend("Give a name, the id of a stored plant, or a model."))
    }

    /// As a model.
    ///
    /// # Errors
    /// `not_found` for a stored plant that is gone.
    pub fn model(&self, library: &Library) -> Result<Model, Problem> {
        Ok(match self {
            Self::Catalogue(plant) => Model::TransferFunction(TransferFunctionModel::from(&plant.transfer_function())),
            Self::Model(model) => model.clone(),
            Self::Stored(id) => library.plant(*id).map_err(|problem| problem.at(PLANT))?.clone(),
        })
    }
}

/// A controller, each problem with its place; a delay below zero is a preview.
fn controller(value: &Value, name: &str) -> Result<Model, Problem> {
    let at = format!("/inputs/{name}");
    let model = parse_model(value, &at)?;
    if let Model::TransferFunction(TransferFunctionModel { delay_s: Some(delay_s), .. }) = &model
        && *delay_s < 0.0
    {
        let detail = format!("a delay of {delay_s} s would need the future of its input");
        let problem = Problem::new(Code::Invalid, "not causal", detail).at(format!("{at}/delay_s"));
        return Err(if name == "feedforward" {
            problem.mend(format!("Leave it out, and give \"preview_s\": {} beside it.", -delay_s))
        } else {
            problem.mend("A feedback answers to errors that have been: give a delay of zero or more.")
        });
    }
    model.check_delayed().map_err(|error| wrong(error.to_string(), at))?;
    Ok(model)
}

fn number(value: f64, least: f64, most: f64, at: String) -> Result<f64, Problem> {
    if (least..=most).contains(&value) {
        Ok(value)
    } else {
        Err(wrong(format!("{value} does not lie within {least} to {most}"), at))
    }
}

fn noise(value: &Value) -> Result<NoiseInput, Problem> {
    const AT: &str = "/inputs/noise";
    let noise: NoiseInput = read(value, AT, "unusable noise")?;
    for (name, source) in noise.sources() {
        if let Some(source) = source {
            number(source.sd, 0.0, LARGEST, format!("{AT}/{name}/sd"))?;
            number(source.time_constant_s, 0.0, LONGEST_S, format!("{AT}/{name}/time_constant_s"))?;
        }
    }
    Ok(noise)
}

impl Part for SimulateInputs {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        const KNOWN: [&str; 8] =
            ["plant", "feedforward", "feedback", "preview_s", "command", "disturbance", "noise", "initial_state"];
        let members = object(value, "the inputs", at)?;
        only(members, &KNOWN, at)?;
        let present = |name: &str| members.get(name).filter(|value| !value.is_null());
        let command = present("command").ok_or_else(|| {
            wrong("there is no command", COMMAND).mend("Give a generator, samples or a trial as the command.")
        })?;
        let command = StimulusInput::parse(command, "r", COMMAND)?;
        let disturbance = present("disturbance").map(|d| StimulusInput::parse(d, "d", DISTURBANCE)).transpose()?;
        let plant = present("plant").map(SimulatedPlant::parse).transpose()?;
        if plant.is_none() && !matches!(command.signal(), SignalInput::Trial(_)) {
            return Err(wrong("there is no plant", PLANT)
                .mend("Give the name of a plant of the catalogue, the id of a stored one, or a model."));
        }
        let preview_s: f64 = present("preview_s").map_or(Ok(0.0), |value| read(value, PREVIEW, "unusable preview"))?;
        number(preview_s, 0.0, LONGEST_S, PREVIEW.to_owned())?;
        let initial_state: Option<Vec<f64>> =
            present("initial_state").map(|value| read(value, INITIAL, "unusable initial state")).transpose()?;
        if let Some(state) = &initial_state
            && !(1..=MOST_STATES).contains(&state.len())
        {
            return Err(wrong(format!("there are {} numbers; 1 to {MOST_STATES} are taken", state.len()), INITIAL));
        }
        Ok(Self {
            plant,
            feedforward: present("feedforward").map(|value| controller(value, "feedforward")).transpose()?,
            feedback: present("feedback").map(|value| controller(value, "feedback")).transpose()?,
            preview_s,
            command,
            disturbance,
            noise: present("noise").map(noise).transpose()?,
            initial_state,
        })
    }
}

impl Inputs for SimulateInputs {
    fn references(&self) -> References {
        let mut references = self.command.signal().references();
        for id in self.disturbance.iter().flat_map(|d| d.signal().references().trials) {
            if !references.trials.contains(&id) {
                references.trials.push(id);
            }
        }
        if let Some(SimulatedPlant::Stored(id)) = &self.plant {
            references.plants.push(*id);
        }
        references
    }

    fn sha256(&self, library: &Library) -> Result<BTreeMap<String, String>, Problem> {
        let mut hashes = BTreeMap::from([(COMMAND.to_owned(), self.command.signal().sha256(library, COMMAND)?)]);
        if let Some(disturbance) = &self.disturbance {
            hashes.insert(DISTURBANCE.to_owned(), disturbance.signal().sha256(library, DISTURBANCE)?);
        }
        let model = super::assembly::plant(self, library)?;
        hashes.insert(PLANT.to_owned(), sha256_json(&json!(model)));
        let others = json!({"feedforward": self.feedforward, "feedback": self.feedback, "noise": self.noise,
            "preview_s": self.preview_s, "initial_state": self.initial_state});
        for (name, value) in others.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null()) {
            hashes.insert(format!("/inputs/{name}"), sha256_json(value));
        }
        Ok(hashes)
    }
}
