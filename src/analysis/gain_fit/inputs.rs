//! What is fitted: trials, and the plant that the person controlled.

use super::plant::{LARGEST, WrittenPlant, stray};
use super::problems::wrong_input as wrong;
use crate::analysis::ids::TrialId;
use crate::analysis::inputs::{Library, References};
use crate::analysis::inverse::matrix;
use crate::analysis::problem::Problem;
use crate::analysis::report::sha256_json;
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Trials at most.
const MAX_TRIALS: usize = 1000;

/// A trial in the request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GainFitTrial {
    /// Time between samples in seconds, the same in all trials.
    pub sample_time_s: f64,
    /// What the experimenter did, held between samples: one row of q numbers per sample, or a plain list where q is 1.
    #[schemars(with = "Vec<Vec<f64>>")]
    pub input: Value,
    /// What was measured: one row of p numbers per sample, or a plain list where p is 1.
    #[schemars(with = "Vec<Vec<f64>>")]
    pub output: Value,
    /// What the person did, one row of m numbers per sample; only for `gain_and_filter`. Default: not recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<Vec<Vec<f64>>>")]
    pub control: Option<Value>,
    /// The state of the plant at the first sample, n numbers. Default: not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub initial_state: Option<Vec<f64>>,
}

/// The signals of a trial as matrices, samples × channels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Signals {
    pub sample_time_s: f64,
    pub input: DMatrix<f64>,
    pub output: DMatrix<f64>,
    pub control: Option<DMatrix<f64>>,
    pub initial_state: Option<Vec<f64>>,
}

#[derive(Debug, Clone, PartialEq)]
enum Trials {
    Inline(Vec<Signals>),
    Stored(Vec<TrialId>),
}

/// Checked inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct GainFitInputs {
    written: Map<String, Value>,
    plant: Option<WrittenPlant>,
    trials: Trials,
    many: bool,
}

/// A signal as a list, or as one row per sample.
fn signal(value: &Value, name: &str, at: &str) -> Result<DMatrix<f64>, Problem> {
    let found = match value.as_array().and_then(|rows| rows.first()) {
        Some(first) if !first.is_array() => {
            let rows: Vec<Value> = value.as_array().into_iter().flatten().map(|v| json!([v])).collect();
            matrix(&Value::Array(rows), name, at)
        }
        _ => matrix(value, name, at),
    }?;
    if found.nrows() < 2 || found.ncols() == 0 {
        let detail = format!(
            "the {name} has {} samples of {} numbers; 2 samples at least are needed",
            found.nrows(),
            found.ncols()
        );
        return Err(wrong(detail, at));
    }
    for i in 0..found.nrows() {
        if let Some(value) = found.row(i).iter().find(|v| v.is_nan() || v.abs() > LARGEST) {
            let detail = format!("the {name} is {value:e} at sample {i}; magnitudes up to {LARGEST:e} are taken");
            return Err(wrong(detail, format!("{at}/{i}")));
        }
    }
    Ok(found)
}

fn inline(value: &Value, at: &str) -> Result<Signals, Problem> {
    let Value::Object(members) = value else {
        return Err(wrong("a trial is the id of a stored one, or an object with its signals", at));
    };
    let known = ["sample_time_s", "input", "output", "control", "initial_state"];
    if let Some(name) = stray(members, &known) {
        return Err(wrong(format!("a trial has no {name:?}"), at).mend(format!("It has: {}.", known.join(", "))));
    }
    let part = |name: &str| {
        members
            .get(name)
            .filter(|v| !v.is_null())
            .ok_or_else(|| wrong(format!("the trial has no {name}"), format!("{at}/{name}")))
    };
    let period = part("sample_time_s")?;
    let sample_time_s = period.as_f64().filter(|v| *v > 0.0 && v.is_finite()).ok_or_else(|| {
        wrong(
            format!("the sample time is {period}, and must be a positive number of seconds"),
            format!("{at}/sample_time_s"),
        )
    })?;
    let input = signal(part("input")?, "input", &format!("{at}/input"))?;
    let output = signal(part("output")?, "output", &format!("{at}/output"))?;
    let control = members.get("control").filter(|v| !v.is_null());
    let control = control.map(|v| signal(v, "control", &format!("{at}/control"))).transpose()?;
    for (name, other) in [("input", Some(&input)), ("control", control.as_ref())] {
        if let Some(other) = other.filter(|other| other.nrows() != output.nrows()) {
            let detail = format!("the {name} has {} samples and the output has {}", other.nrows(), output.nrows());
            return Err(wrong(detail, format!("{at}/{name}")));
        }
    }
    let initial_state = match members.get("initial_state").filter(|v| !v.is_null()) {
        None => None,
        Some(value) => {
            let at = format!("{at}/initial_state");
            let state: Vec<f64> =
                serde_json::from_value(value.clone()).map_err(|error| wrong(error.to_string(), at.clone()))?;
            if state.iter().any(|v| v.is_nan() || v.abs() > LARGEST) {
                return Err(wrong(format!("an entry is larger than {LARGEST:e}"), at));
            }
            Some(state)
        }
    };
    Ok(Signals { sample_time_s, input, output, control, initial_state })
}

/// Plant, signals, and content hashes by JSON pointer.
type Resolved = (WrittenPlant, Vec<Signals>, BTreeMap<String, String>);

impl GainFitInputs {
    /// Checks the `inputs` of a request.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(inputs: &Value) -> Result<Self, Problem> {
        let Value::Object(members) = inputs else {
            return Err(wrong("the inputs are no object", "/inputs"));
        };
        if let Some(name) = stray(members, &["plant", "trial", "trials"]) {
            return Err(wrong(format!("there is no input {name:?}"), format!("/inputs/{name}"))
                .mend("Inputs are plant, and trial or trials."));
        }
        let present = |name: &str| members.get(name).filter(|v| !v.is_null());
        let (list, many) = match (present("trial"), present("trials")) {
            (Some(trial), None) => (vec![trial.clone()], false),
            (None, Some(Value::Array(trials))) => (trials.clone(), true),
            (None, Some(_)) => return Err(wrong("trials is no array", "/inputs/trials")),
            (Some(_), Some(_)) => return Err(wrong("there are both trial and trials", "/inputs")),
            (None, None) => {
                return Err(wrong("there is no trial", "/inputs")
                    .mend("Give trials: ids of stored ones, or objects with sample_time_s, input and output."));
            }
        };
        if list.is_empty() || list.len() > MAX_TRIALS {
            return Err(wrong(
                format!("there are {} trials; 1 to {MAX_TRIALS} are taken", list.len()),
                "/inputs/trials",
            ));
        }
        if let Some(i) = list.iter().position(|trial| trial.is_string() != list[0].is_string()) {
            return Err(wrong("ids and signals are mixed", place(many, i)));
        }
        let plant = present("plant").map(WrittenPlant::parse).transpose()?;
        let trials = if list[0].is_string() {
            let mut ids: Vec<TrialId> = Vec::new();
            for (i, value) in list.iter().enumerate() {
                let text = value.as_str().unwrap_or_default();
                let id: TrialId = text.parse().map_err(|_| {
                    wrong(format!("{text:?} is no id of a trial"), place(many, i)).mend("Ids are UUIDs.")
                })?;
                if ids.contains(&id) {
                    return Err(wrong("this trial is named twice", place(many, i))
                        .mend("Twice the same noise is no second measurement."));
                }
                ids.push(id);
            }
            Trials::Stored(ids)
        } else {
            if plant.is_none() {
                return Err(wrong("there is no plant", "/inputs/plant").mend(
                    "Give the plant that the person controlled: {\"name\": \"seated_balance\"} or its matrices.",
                ));
            }
            let mut parsed: Vec<Signals> = Vec::new();
            for (i, value) in list.iter().enumerate() {
                let found = inline(value, &place(many, i))?;
                if parsed.contains(&found) {
                    return Err(wrong("this is the same recording as an earlier one", place(many, i))
                        .mend("Twice the same noise is no second measurement."));
                }
                parsed.push(found);
            }
            Trials::Inline(parsed)
        };
        let mut written = Map::new();
        if let Some(plant) = &plant {
            written.insert("plant".to_owned(), plant.to_value());
        }
        let name = if many { "trials" } else { "trial" };
        written.insert(name.to_owned(), members.get(name).cloned().unwrap_or_default());
        Ok(Self { written, plant, trials, many })
    }

    /// The place of a trial.
    pub(super) fn place(&self, index: usize) -> String {
        place(self.many, index)
    }

    pub(super) fn to_value(&self) -> Value {
        Value::Object(self.written.clone())
    }

    pub(super) fn references(&self) -> References {
        match &self.trials {
            Trials::Inline(_) => References::default(),
            Trials::Stored(ids) => References { trials: ids.clone(), plants: Vec::new() },
        }
    }

    /// The plant in the request.
    pub(super) fn plant(&self) -> Option<&WrittenPlant> {
        self.plant.as_ref()
    }

    /// The signals in the request; `None` where they are stored.
    pub(super) fn signals(&self) -> Option<&[Signals]> {
        match &self.trials {
            Trials::Inline(signals) => Some(signals),
            Trials::Stored(_) => None,
        }
    }

    /// Plant, signals, and content hashes, with stored trials fetched. A stored trial's disturbance is the input where it has one, its
    /// command otherwise.
    pub(super) fn resolve(&self, library: &Library) -> Result<Resolved, Problem> {
        let mut hashes: BTreeMap<String, String> =
            self.written.iter().map(|(name, value)| (format!("/inputs/{name}"), sha256_json(value))).collect();
        let ids = match &self.trials {
            Trials::Inline(signals) => {
                let plant = self.plant.clone().ok_or_else(|| wrong("there is no plant", "/inputs/plant"))?;
                return Ok((plant, signals.clone(), hashes));
            }
            Trials::Stored(ids) => ids,
        };
        let mut plant = self.plant.clone();
        let mut signals: Vec<Signals> = Vec::new();
        for (i, id) in ids.iter().enumerate() {
            let at = place(self.many, i);
            let stored = library.trial(*id).map_err(|problem| problem.at(at.clone()))?;
            hashes.insert(at.clone(), stored.sha256.clone());
            let model = WrittenPlant::Stored(stored.plant.clone());
            if self.plant.is_none() && plant.get_or_insert_with(|| model.clone()) != &model {
                return Err(wrong("this trial was recorded on another plant than the first", at));
            }
            let recorded = &stored.trial.signals;
            let column = |values: &[f64]| DMatrix::from_column_slice(values.len(), 1, values);
            let found = Signals {
                sample_time_s: stored.trial.sample_time_s,
                input: column(recorded.disturbance.as_deref().unwrap_or(&recorded.command)),
                output: column(&recorded.output),
                control: Some(column(&recorded.control)),
                initial_state: None,
            };
            if signals.contains(&found) {
                return Err(wrong("this is the same recording as an earlier one", at)
                    .mend("Twice the same noise is no second measurement."));
            }
            signals.push(found);
        }
        let plant = plant.ok_or_else(|| wrong("there is no trial", "/inputs/trials"))?;
        Ok((plant, signals, hashes))
    }
}

fn place(many: bool, index: usize) -> String {
    if many { format!("/inputs/trials/{index}") } else { "/inputs/trial".to_owned() }
}
