//! Inputs that are trials: by id, or carried in the request itself.
//!
//! ```json
//! {"trial": "ID"}
//! {"trials": ["ID", "ID"]}
//! {"trial": {"sample_time_s": 0.02, "r": [..], "u": [..], "y": [..], "d": [..]}, "plant": {"num": [..], "den": [..]}}
//! {"trials": [{"sample_time_s": 0.02, "r": [..], ..}, ..], "plant": {..}}
//! ```
//! A stored trial brings the plant that it was recorded on. Trials in the request have one plant between them.

use super::ids::TrialId;
use super::inputs::{Library, References, StoredTrial};
use super::problem::{Code, Problem};
use super::report::{hexadecimal, sha256_json};
use super::trial_problem;
use crate::control::Model;
use crate::trial::{Limits, Trial, json, write};
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

/// Checked inputs; the models of plants are checked by whoever uses them.
#[derive(Debug, Clone, PartialEq)]
pub enum TrialInputs {
    /// Stored trials, at least one, without repeats.
    Stored {
        /// Their ids.
        ids: Vec<TrialId>,
        /// Whether the request had `trials` rather than `trial`.
        many: bool,
    },
    /// Trials in the request, at least one.
    Inline {
        /// The trials with their content hashes.
        trials: Vec<(Arc<Trial>, String)>,
        /// The plant that all of them were recorded on.
        plant: Option<Model>,
        /// Whether the request had `trials` rather than `trial`.
        many: bool,
    },
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
}

impl TrialInputs {
    /// Checks the `inputs` of a request.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(inputs: &Value, plant: PlantNeed) -> Result<Self, Problem> {
        let Value::Object(members) = inputs else {
            return Err(invalid("the inputs are no object".to_owned(), "/inputs"));
        };
        if let Some(name) = members.keys().find(|name| !["trial", "trials", "plant"].contains(&name.as_str())) {
            return Err(invalid(
                format!("there is no input {name:?} beside trials"),
                format!("/inputs/{}", escape(name)),
            )
            .mend("Inputs are trial or trials, and plant where the trials are in the request."));
        }
        match (members.get("trial"), members.get("trials")) {
            (Some(trial), None) => Self::parse_all(std::slice::from_ref(trial), false, members, plant),
            (None, Some(Value::Array(trials))) => Self::parse_all(trials, true, members, plant),
            (None, Some(_)) => Err(invalid("trials is no array".to_owned(), "/inputs/trials")),
            (Some(_), Some(_)) => {
                Err(invalid("there are both trial and trials".to_owned(), "/inputs").mend("Give one of the two."))
            }
            (None, None) => Err(invalid("there is no trial".to_owned(), "/inputs")
                .mend("Give trial (one) or trials (an array): ids of stored trials, or the signals themselves.")),
        }
    }

    fn parse_all(trials: &[Value], many: bool, members: &Map<String, Value>, need: PlantNeed) -> Result<Self, Problem> {
        if trials.is_empty() {
            return Err(invalid("the list of trials is empty".to_owned(), "/inputs/trials"));
        }
        if trials.len() > MAX_TRIALS {
            let detail = format!("there are {} trials, {MAX_TRIALS} at most can be combined", trials.len());
            return Err(invalid(detail, "/inputs/trials"));
        }
        if let Some(i) = trials.iter().position(|trial| trial.is_string() != trials[0].is_string()) {
            return Err(invalid("ids and signals are mixed".to_owned(), pointer(many, i))
                .mend("Name only stored trials, or give the signals of all."));
        }
        if trials[0].is_string() {
            if members.contains_key("plant") {
                return Err(invalid("a stored trial brings its own plant".to_owned(), "/inputs/plant")
                    .mend("Leave the plant out."));
            }
            return Self::parse_ids(trials, many);
        }
        let plant = match members.get("plant") {
            None | Some(Value::Null) if need == PlantNeed::Optional => None,
            None | Some(Value::Null) => {
                return Err(invalid("there is no plant".to_owned(), "/inputs").mend(
                    "Give the plant that the trial was recorded on: {\"num\", \"den\", \"sample_time_s\"} or {\"a\", \"b\", \
                     \"c\", \"d\", \"sample_time_s\"}.",
                ));
            }
            Some(model) => Some(parse_model(model, "/inputs/plant")?),
        };
        let mut parsed = Vec::with_capacity(trials.len());
        for (i, value) in trials.iter().enumerate() {
            if !value.is_object() {
                let detail = "a trial is the id of a stored one, or an object with its signals".to_owned();
                return Err(invalid(detail, pointer(many, i)));
            }
            let trial = json::from_value(value, &Limits::default())
                .map_err(|error| trial_problem::problem(&error, &pointer(many, i)))?;
            let sha256 = hexadecimal(&trial.content_sha256());
            if let Some(twin) = parsed.iter().position(|(_, other)| *other == sha256) {
                return Err(twice(many, twin, i));
            }
            parsed.push((Arc::new(trial), sha256));
        }
        Ok(Self::Inline { trials: parsed, plant, many })
    }

    fn parse_ids(trials: &[Value], many: bool) -> Result<Self, Problem> {
        let mut ids: Vec<TrialId> = Vec::with_capacity(trials.len());
        let mut seen = BTreeMap::new();
        for (i, value) in trials.iter().enumerate() {
            let text = value.as_str().unwrap_or_default();
            let id: TrialId = text.parse().map_err(|_| {
                invalid(format!("{text:?} is no id of a trial"), pointer(many, i)).mend("Ids are UUIDs.")
            })?;
            if let Some(twin) = seen.insert(id, i) {
                return Err(twice(many, twin, i));
            }
            ids.push(id);
        }
        Ok(Self::Stored { ids, many })
    }

    /// How many trials there are.
    #[must_use]
    pub fn count(&self) -> usize {
        match self {
            Self::Stored { ids, .. } => ids.len(),
            Self::Inline { trials, .. } => trials.len(),
        }
    }

    /// The stored trials among them.
    #[must_use]
    pub fn references(&self) -> References {
        match self {
            Self::Stored { ids, .. } => References { trials: ids.clone(), plants: Vec::new() },
            Self::Inline { .. } => References::default(),
        }
    }

    /// The plant given in the request, for checking it before anything is queued.
    #[must_use]
    pub fn inline_plant(&self) -> Option<&Model> {
        match self {
            Self::Stored { .. } => None,
            Self::Inline { plant, .. } => plant.as_ref(),
        }
    }

    /// The canonical `inputs`: parsing them again gives equal inputs.
    #[must_use]
    pub fn to_value(&self) -> Value {
        let mut members = Map::new();
        let (values, many): (Vec<Value>, bool) = match self {
            Self::Stored { ids, many } => (ids.iter().map(|id| json!(id)).collect(), *many),
            Self::Inline { trials, many, .. } => (trials.iter().map(|(t, _)| write::json_value(t)).collect(), *many),
        };
        if many {
            members.insert("trials".to_owned(), Value::Array(values));
        } else {
            members.extend(values.into_iter().take(1).map(|value| ("trial".to_owned(), value)));
        }
        if let Some(plant) = self.inline_plant() {
            members.insert("plant".to_owned(), json!(plant));
        }
        Value::Object(members)
    }

    /// The trials themselves, in the order of the request.
    ///
    /// # Errors
    /// `not_found` for a stored trial that is gone, with its pointer; `invalid` for two stored trials with the same
    /// content, which would count one recording twice.
    pub fn resolve(&self, library: &Library) -> Result<Vec<ResolvedTrial>, Problem> {
        match self {
            Self::Inline { trials, plant, many } => Ok(trials
                .iter()
                .enumerate()
                .map(|(i, (trial, sha256))| ResolvedTrial {
                    name: pointer(*many, i),
                    id: None,
                    sha256: sha256.clone(),
                    recording: Recording::Inline { trial: Arc::clone(trial), plant: plant.clone() },
                })
                .collect()),
            Self::Stored { ids, many } => {
                let mut resolved: Vec<ResolvedTrial> = Vec::with_capacity(ids.len());
                let mut hashes = BTreeSet::new();
                for (i, id) in ids.iter().enumerate() {
                    let stored = library.trial(*id).map_err(|problem| problem.at(pointer(*many, i)))?;
                    if !hashes.insert(stored.sha256.clone()) {
                        let twin = resolved.iter().position(|other| other.sha256 == stored.sha256).unwrap_or(0);
                        return Err(twice(*many, twin, i));
                    }
                    resolved.push(ResolvedTrial {
                        name: pointer(*many, i),
                        id: Some(*id),
                        sha256: stored.sha256.clone(),
                        recording: Recording::Stored(Arc::clone(stored)),
                    });
                }
                Ok(resolved)
            }
        }
    }
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

/// A model of a plant as JSON; whether it is a usable system is checked by [`Model`] itself.
///
/// # Errors
/// `invalid`, with what is wrong with the form that it comes nearest to.
pub fn parse_model(value: &Value, location: &str) -> Result<Model, Problem> {
    serde_json::from_value::<Model>(value.clone()).map_err(|_| {
        // An untagged enum says only that nothing fits; the form that was meant says what does not.
        let meant: Result<(), serde_json::Error> = if value.get("a").is_some() {
            serde_json::from_value::<crate::control::model::StateSpaceModel>(value.clone()).map(|_| ())
        } else {
            serde_json::from_value::<crate::control::model::TransferFunctionModel>(value.clone()).map(|_| ())
        };
        let why = meant.err().map_or_else(|| "it has neither form".to_owned(), |error| error.to_string());
        invalid(format!("this is no model: {why}"), location).mend(
            "A model is {\"num\": [..], \"den\": [..], \"sample_time_s\": null} in descending powers, or {\"a\", \"b\", \
             \"c\", \"d\", \"sample_time_s\"} with row-major nested arrays.",
        )
    })
}

fn pointer(many: bool, index: usize) -> String {
    if many { format!("/inputs/trials/{index}") } else { "/inputs/trial".to_owned() }
}

fn invalid(detail: String, location: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "unusable inputs", detail).at(location)
}

fn twice(many: bool, twin: usize, index: usize) -> Problem {
    invalid(format!("this is the same recording as {}", pointer(many, twin)), pointer(many, index))
        .mend("Name each recording once: twice the same noise is no second measurement.")
}

/// A name within a JSON pointer (RFC 6901).
fn escape(name: &str) -> String {
    name.replace('~', "~0").replace('/', "~1")
}

#[cfg(test)]
mod tests {
    use super::*;

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
            let canonical = parsed.to_value();
            assert_eq!(TrialInputs::parse(&canonical, PlantNeed::Required).unwrap(), parsed);
            assert_eq!(TrialInputs::parse(&canonical, PlantNeed::Required).unwrap().to_value(), canonical);
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
