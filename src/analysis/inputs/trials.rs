//! Inputs that are trials: by id, or carried in the request itself.
//!
//! ```json
//! {"trial": "ID"}
//! {"trials": ["ID", "ID"]}
//! {"trial": {"sample_time_s": 0.02, "r": [..], "u": [..], "y": [..], "d": [..]}, "plant": {"num": [..], "den": [..]}}
//! {"trials": [{"sample_time_s": 0.02, "r": [..], ..}, ..], "plant": {..}}
//! ```
//! A stored trial brings the plant that it was recorded on. Trials in the request have one plant between them.

use super::library::{Library, References, StoredTrial};
use super::plant::parse_model;
use super::trial_problem;
use crate::analysis::contract::{Inputs, Part};
use crate::analysis::ids::TrialId;
use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_inputs as invalid;
use crate::analysis::report::sha256_json;
use crate::control::Model;
use crate::num::hexadecimal::hexadecimal;
use crate::trial::json::TrialDocument;
use crate::trial::{Limits, Trial, json, pointer, write};
use schemars::JsonSchema;
use serde::{Serialize, Serializer};
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Trials of one request at most.
pub const MAX_TRIALS: usize = 10_000;

/// Whether trials in the request must come with a plant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlantNeed {
    /// The computation uses the plant.
    Required,
    /// It does not; a plant may be given all the same, and is kept.
    Optional,
}

/// A trial of a request.
#[derive(Debug, Clone, PartialEq, JsonSchema)]
#[schemars(untagged)]
pub enum TrialInput {
    /// The id of a stored trial.
    Stored(TrialId),
    /// The signals themselves.
    #[schemars(with = "TrialDocument")]
    Inline(InlineTrial),
}

/// A trial in the request, with the SHA-256 of its content in hexadecimal.
#[derive(Debug, Clone, PartialEq)]
pub struct InlineTrial {
    trial: Arc<Trial>,
    sha256: String,
}

impl Serialize for TrialInput {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Stored(id) => id.serialize(serializer),
            Self::Inline(inline) => write::json_value(&inline.trial).serialize(serializer),
        }
    }
}

/// One trial or several: all stored, without repeats, or all in the request. The models of plants are checked by
/// whoever uses them.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct TrialInputs {
    /// One trial; either this or `trials`.
    #[serde(skip_serializing_if = "Option::is_none")]
    trial: Option<TrialInput>,
    /// Several trials, at least one; either this or `trial`.
    #[serde(skip_serializing_if = "Option::is_none")]
    trials: Option<Vec<TrialInput>>,
    /// The plant that trials in the request were recorded on. A stored trial brings its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    plant: Option<Model>,
}

/// A trial at hand.
#[derive(Debug, Clone)]
pub struct ResolvedTrial {
    /// Where it is in the request, as a JSON pointer: `/inputs/trial`, `/inputs/trials/3`.
    pub name: String,
    /// Its id, where it is a stored one.
    pub id: Option<TrialId>,
    /// SHA-256 of its content, in hexadecimal.
    pub sha256: String,
    recording: Recording,
}

#[derive(Debug, Clone)]
enum Recording {
    Stored(Arc<StoredTrial>),
    Inline { trial: Arc<Trial>, plant: Option<Model> },
}

impl ResolvedTrial {
    /// The recording.
    #[must_use]
    pub fn trial(&self) -> &Trial {
        match &self.recording {
            Recording::Stored(stored) => &stored.trial,
            Recording::Inline { trial, .. } => trial,
        }
    }

    /// The plant it was recorded on; `None` only where plants are [`PlantNeed::Optional`].
    #[must_use]
    pub fn plant(&self) -> Option<&Model> {
        match &self.recording {
            Recording::Stored(stored) => Some(&stored.plant),
            Recording::Inline { plant, .. } => plant.as_ref(),
        }
    }

    /// Whether |y| passed the study's display limit; false where no study says so.
    #[must_use]
    pub fn divergent(&self) -> bool {
        matches!(&self.recording, Recording::Stored(stored) if stored.divergent)
    }

    /// Why somebody excluded it; `None` where nobody did.
    #[must_use]
    pub fn excluded(&self) -> Option<&str> {
        match &self.recording {
            Recording::Stored(stored) => stored.excluded.as_deref(),
            Recording::Inline { .. } => None,
        }
    }
}

impl TrialInputs {
    /// Reads the inputs of a request.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(inputs: &Value, plant: PlantNeed) -> Result<Self, Problem> {
        let Value::Object(members) = inputs else {
            return Err(invalid("the inputs are no object", "/inputs"));
        };
        if let Some(name) = members.keys().find(|name| !["trial", "trials", "plant"].contains(&name.as_str())) {
            return Err(invalid(format!("there is no input {name:?} beside trials"), pointer::member("/inputs", name))
                .mend("Inputs are trial or trials, and plant where the trials are in the request."));
        }
        match (members.get("trial"), members.get("trials")) {
            (Some(trial), None) => {
                let (mut trials, plant) = parse_all(std::slice::from_ref(trial), false, members, plant)?;
                Ok(Self { trial: trials.pop(), trials: None, plant })
            }
            (None, Some(Value::Array(trials))) => {
                let (trials, plant) = parse_all(trials, true, members, plant)?;
                Ok(Self { trial: None, trials: Some(trials), plant })
            }
            (None, Some(_)) => Err(invalid("trials is no array", "/inputs/trials")),
            (Some(_), Some(_)) => {
                Err(invalid("there are both trial and trials", "/inputs").mend("Give one of the two."))
            }
            (None, None) => Err(invalid("there is no trial", "/inputs")
                .mend("Give trial (one) or trials (an array): ids of stored trials, or the signals themselves.")),
        }
    }

    /// One trial that was read before, without a plant.
    #[must_use]
    pub fn one(trial: TrialInput) -> Self {
        Self { trial: Some(trial), trials: None, plant: None }
    }

    /// Several trials that were read before.
    pub(super) fn several(trials: Vec<TrialInput>, plant: Option<Model>) -> Self {
        Self { trial: None, trials: Some(trials), plant }
    }

    /// The trials, in the order of the request.
    #[must_use]
    pub fn trials(&self) -> &[TrialInput] {
        match &self.trials {
            Some(trials) => trials,
            None => self.trial.as_slice(),
        }
    }

    fn many(&self) -> bool {
        self.trials.is_some()
    }

    /// The plant given in the request, for checking it before anything is queued.
    #[must_use]
    pub fn inline_plant(&self) -> Option<&Model> {
        self.plant.as_ref()
    }

    /// The trials themselves, in the order of the request.
    ///
    /// # Errors
    /// `not_found` for a stored trial that is gone, with its pointer; `invalid` for two stored trials with the same
    /// content, which would count one recording twice.
    pub fn resolve(&self, library: &Library) -> Result<Vec<ResolvedTrial>, Problem> {
        let mut resolved: Vec<ResolvedTrial> = Vec::with_capacity(self.trials().len());
        let mut hashes = BTreeSet::new();
        for (i, input) in self.trials().iter().enumerate() {
            let name = place(self.many(), i);
            let (id, sha256, recording) = match input {
                TrialInput::Inline(inline) => {
                    let (trial, plant) = (Arc::clone(&inline.trial), self.plant.clone());
                    (None, inline.sha256.clone(), Recording::Inline { trial, plant })
                }
                TrialInput::Stored(id) => {
                    let stored = library.trial(*id).map_err(|problem| problem.at(name.clone()))?;
                    (Some(*id), stored.sha256.clone(), Recording::Stored(Arc::clone(stored)))
                }
            };
            if !hashes.insert(sha256.clone()) {
                let twin = resolved.iter().position(|other| other.sha256 == sha256).unwrap_or(0);
                return Err(twice(self.many(), twin, i));
            }
            resolved.push(ResolvedTrial { name, id, sha256, recording });
        }
        Ok(resolved)
    }
}

impl Part for TrialInputs {
    /// Without a plant, where none is given: kinds that need one read with [`TrialInputs::parse`].
    fn read(value: &Value, _at: &str) -> Result<Self, Problem> {
        Self::parse(value, PlantNeed::Optional)
    }
}

impl Inputs for TrialInputs {
    fn references(&self) -> References {
        let stored = |input: &TrialInput| if let TrialInput::Stored(id) = input { Some(*id) } else { None };
        References { trials: self.trials().iter().filter_map(stored).collect(), ..References::default() }
    }

    fn sha256(&self, library: &Library) -> Result<BTreeMap<String, String>, Problem> {
        Ok(inputs_sha256(&self.resolve(library)?, false))
    }
}

type Parsed = (Vec<TrialInput>, Option<Model>);

fn parse_all(trials: &[Value], many: bool, members: &Map<String, Value>, need: PlantNeed) -> Result<Parsed, Problem> {
    if trials.is_empty() {
        return Err(invalid("the list of trials is empty", "/inputs/trials"));
    }
    if trials.len() > MAX_TRIALS {
        let detail = format!("there are {} trials, {MAX_TRIALS} at most can be combined", trials.len());
        return Err(invalid(detail, "/inputs/trials"));
    }
    if let Some(i) = trials.iter().position(|trial| trial.is_string() != trials[0].is_string()) {
        return Err(invalid("ids and signals are mixed", place(many, i))
            .mend("Name only stored trials, or give the signals of all."));
    }
    if trials[0].is_string() {
        if members.contains_key("plant") {
            return Err(invalid("a stored trial brings its own plant", "/inputs/plant").mend("Leave the plant out."));
        }
        return Ok((parse_ids(trials, many)?, None));
    }
    let plant = match members.get("plant") {
        None | Some(Value::Null) if need == PlantNeed::Optional => None,
        None | Some(Value::Null) => {
            return Err(invalid("there is no plant", "/inputs").mend(
                "Give the plant that the trial was recorded on: {\"num\", \"den\", \"sample_time_s\"} or {\"a\", \
                 \"b\", \"c\", \"d\", \"sample_time_s\"}.",
            ));
        }
        Some(model) => Some(parse_model(model, "/inputs/plant")?),
    };
    let mut parsed: Vec<InlineTrial> = Vec::with_capacity(trials.len());
    for (i, value) in trials.iter().enumerate() {
        if !value.is_object() {
            return Err(invalid("a trial is the id of a stored one, or an object with its signals", place(many, i)));
        }
        let trial = json::from_value(value, &Limits::default())
            .map_err(|error| trial_problem::problem(&error, &place(many, i)))?;
        let sha256 = hexadecimal(&trial.content_sha256());
        if let Some(twin) = parsed.iter().position(|other| other.sha256 == sha256) {
            return Err(twice(many, twin, i));
        }
        parsed.push(InlineTrial { trial: Arc::new(trial), sha256 });
    }
    Ok((parsed.into_iter().map(TrialInput::Inline).collect(), plant))
}

fn parse_ids(trials: &[Value], many: bool) -> Result<Vec<TrialInput>, Problem> {
    let mut ids = Vec::with_capacity(trials.len());
    let mut seen = BTreeMap::new();
    for (i, value) in trials.iter().enumerate() {
        let text = value.as_str().unwrap_or_default();
        let id: TrialId = text
            .parse()
            .map_err(|_| invalid(format!("{text:?} is no id of a trial"), place(many, i)).mend("Ids are UUIDs."))?;
        if let Some(twin) = seen.insert(id, i) {
            return Err(twice(many, twin, i));
        }
        ids.push(TrialInput::Stored(id));
    }
    Ok(ids)
}

/// SHA-256 of each trial by its name, and of each plant by the name and `/plant`, where the computation uses plants.
///
/// The hash of a plant is that of its JSON with sorted keys.
#[must_use]
pub fn inputs_sha256(trials: &[ResolvedTrial], with_plants: bool) -> BTreeMap<String, String> {
    let mut hashes = BTreeMap::new();
    for trial in trials {
        hashes.insert(trial.name.clone(), trial.sha256.clone());
        if let Some(plant) = trial.plant().filter(|_| with_plants) {
            hashes.insert(format!("{}/plant", trial.name), sha256_json(&json!(plant)));
        }
    }
    hashes
}

fn place(many: bool, index: usize) -> String {
    if many { format!("/inputs/trials/{index}") } else { "/inputs/trial".to_owned() }
}

fn twice(many: bool, twin: usize, index: usize) -> Problem {
    invalid(format!("this is the same recording as {}", place(many, twin)), place(many, index))
        .mend("Name each recording once: twice the same noise is no second measurement.")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::problem::Code;

    fn inline(y: f64) -> Value {
        json!({"sample_time_s": 0.5, "r": [1.0, 2.0], "u": [0.0, -0.0], "y": [y, 1e-320]})
    }

    #[test]
    fn canonical_inputs_parse_to_equal_ones() {
        let plant = json!({"num": [1.0], "den": [1.0, 0.0]});
        for inputs in [
            json!({"trial": "0190b3e0-0000-7000-8000-000000000001"}),
            json!({"trials": ["0190b3e0-0000-7000-8000-000000000001", "0190b3e0-0000-7000-8000-000000000002"]}),
            json!({"trial": inline(1.0), "plant": plant}),
            json!({"trials": [inline(1.0), inline(2.0)], "plant": plant}),
        ] {
            let parsed = TrialInputs::parse(&inputs, PlantNeed::Required).unwrap();
            let canonical = json!(parsed);
            assert_eq!(TrialInputs::parse(&canonical, PlantNeed::Required).unwrap(), parsed);
            assert_eq!(json!(TrialInputs::parse(&canonical, PlantNeed::Required).unwrap()), canonical);
        }
    }

    #[test]
    fn every_refusal_names_its_place() {
        let id = "0190b3e0-0000-7000-8000-000000000001";
        let plant = json!({"num": [1.0], "den": [1.0, 0.0]});
        let mut broken = inline(1.0);
        broken["y"][1] = Value::Null;
        for (inputs, location, words) in [
            (json!([]), "/inputs", "no object"),
            (json!({}), "/inputs", "no trial"),
            (json!({"trial": id, "trials": [id]}), "/inputs", "both"),
            (json!({"trials": id}), "/inputs/trials", "no array"),
            (json!({"trials": []}), "/inputs/trials", "empty"),
            (json!({"trial": "x"}), "/inputs/trial", "no id"),
            (json!({"trials": [id, id]}), "/inputs/trials/1", "same recording"),
            (json!({"trials": [id, inline(1.0)]}), "/inputs/trials/1", "mixed"),
            (json!({"trial": id, "plant": plant}), "/inputs/plant", "brings its own"),
            (json!({"trial": id, "a/b": 1}), "/inputs/a~1b", "no input"),
            (json!({"trial": inline(1.0)}), "/inputs", "no plant"),
            (json!({"trial": 3, "plant": plant}), "/inputs/trial", "object with its signals"),
            (json!({"trial": inline(1.0), "plant": {"num": [1.0]}}), "/inputs/plant", "missing field `den`"),
            (json!({"trial": broken, "plant": plant}), "/inputs/trial/y/1", "null"),
            (json!({"trials": [inline(1.0), inline(1.0)], "plant": plant}), "/inputs/trials/1", "same recording"),
        ] {
            let problem = TrialInputs::parse(&inputs, PlantNeed::Required).unwrap_err();
            assert_eq!(problem.location.as_deref(), Some(location), "{inputs} → {problem}");
            assert!(problem.detail.contains(words), "{inputs} → {problem}");
        }
    }

    #[test]
    fn the_same_recording_has_the_same_hash_stored_or_inline() {
        let inputs = TrialInputs::parse(&json!({"trial": inline(1.0)}), PlantNeed::Optional).unwrap();
        let resolved = inputs.resolve(&Library::default()).unwrap();
        let trial = resolved[0].trial().clone();
        let sha256 = hexadecimal(&trial.content_sha256());
        assert_eq!(inputs_sha256(&resolved, true), BTreeMap::from([("/inputs/trial".to_owned(), sha256)]));
    }

    #[test]
    fn a_trial_that_is_gone_is_not_found() {
        let id = "0190b3e0-0000-7000-8000-000000000001";
        let inputs = TrialInputs::parse(&json!({"trials": [id]}), PlantNeed::Required).unwrap();
        assert_eq!(inputs.references().trials.len(), 1);
        let problem = inputs.resolve(&Library::default()).unwrap_err();
        assert_eq!((problem.code, problem.location.as_deref()), (Code::NotFound, Some("/inputs/trials/0")));
    }
}
