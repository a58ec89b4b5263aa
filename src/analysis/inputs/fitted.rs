//! Trials that are fitted, and others that the result is only simulated on.

use super::library::{Library, References};
use super::plant::check_delayed_plant;
use super::trials::{PlantNeed, ResolvedTrial, TrialInput, TrialInputs, inputs_sha256};
use crate::analysis::contract::{Inputs, Part};
use crate::analysis::problem::{Code, Problem};
use crate::control::{Model, System};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Where trials to validate on are in a request.
const HELD_OUT: &str = "/inputs/validate_on";

/// Sample times that differ by more than this share are not the same.
const SAME_SAMPLE_TIME: f64 = 1e-5;

/// Trials that are fitted, and others that the result is only simulated on: `{"trial": ID, "validate_on": [ID, ..]}`,
/// or signals in both places.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct FittedTrials {
    /// What is fitted.
    #[serde(flatten)]
    fitted: TrialInputs,
    /// Trials that the result is only simulated on: none that is fitted, on the same plant.
    #[serde(skip_serializing_if = "Option::is_none")]
    validate_on: Option<Vec<TrialInput>>,
}

/// [`FittedTrials`] at hand, all on one plant and none in both places.
pub struct Resolved {
    /// The plant of all of them.
    pub plant: System,
    /// The delay behind it in seconds; 0 in sampled time.
    pub plant_delay_s: f64,
    /// Those that are fitted.
    pub fitted: Vec<ResolvedTrial>,
    /// Those that are held out.
    pub held_out: Vec<ResolvedTrial>,
}

impl Resolved {
    /// For kinds that compute with rational plants alone.
    ///
    /// # Errors
    /// `invalid` where the plant has a delay in continuous time.
    pub fn refuse_plant_delay(&self) -> Result<(), Problem> {
        if self.plant_delay_s <= 0.0 {
            return Ok(());
        }
        let detail =
            format!("the plant has a delay of {} s, which only ssid takes in continuous time", self.plant_delay_s);
        Err(Problem::new(Code::Invalid, "plant with a delay", detail)
            .at("/inputs")
            .mend("Give the plant in sampled time, with a delay of whole samples."))
    }
}

fn not_held_out(detail: String, at: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "not held out", detail)
        .at(at)
        .mend("Keep them apart: a model explains best what it was fitted to.")
}

/// Problems of `trials` belong to `validate_on` there.
fn moved(mut problem: Problem) -> Problem {
    problem.location = problem.location.map(|at| at.replacen("/inputs/trials", HELD_OUT, 1));
    problem
}

impl FittedTrials {
    /// Reads the inputs of a request.
    ///
    /// # Errors
    /// A [`Problem`] with the pointer of what is wrong.
    pub fn parse(inputs: &Value) -> Result<Self, Problem> {
        let mut members = inputs.clone();
        let validate_on = members.as_object_mut().and_then(|members| members.remove("validate_on"));
        let fitted = TrialInputs::parse(&members, PlantNeed::Required)?;
        let Some(validate_on) = validate_on.filter(|list| !list.is_null()) else {
            return Ok(Self { fitted, validate_on: None });
        };
        let mut request = json!({"trials": validate_on});
        if let (Some(plant), true) = (inputs.get("plant"), fitted.inline_plant().is_some()) {
            request["plant"] = plant.clone();
        }
        let held_out = TrialInputs::parse(&request, PlantNeed::Required).map_err(moved)?;
        let known = fitted.references().trials;
        if let Some(i) = held_out.references().trials.iter().position(|id| known.contains(id)) {
            let detail = format!("{HELD_OUT}/{i} is fitted too, and a fit is no validation of itself");
            return Err(not_held_out(detail, format!("{HELD_OUT}/{i}")));
        }
        Ok(Self { fitted, validate_on: Some(held_out.trials().to_vec()) })
    }

    /// The plant given in the request.
    #[must_use]
    pub fn inline_plant(&self) -> Option<&Model> {
        self.fitted.inline_plant()
    }

    /// The trials to validate on.
    fn held_out(&self) -> Option<TrialInputs> {
        self.validate_on.clone().map(|trials| TrialInputs::several(trials, self.inline_plant().cloned()))
    }

    /// Finds the trials and checks what only they can tell: one plant, its sample time, and none that is fitted and
    /// held out at once.
    ///
    /// # Errors
    /// A [`Problem`] with the place of the trial.
    pub fn resolve(&self, library: &Library) -> Result<Resolved, Problem> {
        let fitted = self.fitted.resolve(library)?;
        let (plant, plant_delay_s) = common_plant(&fitted)?;
        check_sample_times(&plant, &fitted)?;
        let mut held_out = match self.held_out() {
            None => return Ok(Resolved { plant, plant_delay_s, fitted, held_out: Vec::new() }),
            Some(inputs) => inputs.resolve(library).map_err(moved)?,
        };
        for trial in &mut held_out {
            trial.name = trial.name.replacen("/inputs/trials", HELD_OUT, 1);
            if let Some(twin) = fitted.iter().find(|other| other.sha256 == trial.sha256) {
                let detail =
                    format!("{} is fitted too ({}), and a fit is no validation of itself", trial.name, twin.name);
                return Err(not_held_out(detail, trial.name.clone()));
            }
        }
        if common_plant(&held_out)? != (plant.clone(), plant_delay_s) {
            let detail = "the trials to validate on were recorded on another plant than those that are fitted";
            return Err(Problem::new(Code::Invalid, "different plants", detail).at(HELD_OUT));
        }
        check_sample_times(&plant, &held_out)?;
        Ok(Resolved { plant, plant_delay_s, fitted, held_out })
    }
}

impl Part for FittedTrials {
    fn read(value: &Value, _at: &str) -> Result<Self, Problem> {
        Self::parse(value)
    }
}

impl Inputs for FittedTrials {
    fn references(&self) -> References {
        let mut references = self.fitted.references();
        references.trials.extend(self.held_out().iter().flat_map(|inputs| inputs.references().trials));
        references
    }

    /// Of trials that are fitted with the plant, of those that are not without.
    fn sha256(&self, library: &Library) -> Result<BTreeMap<String, String>, Problem> {
        let Resolved { fitted, held_out, .. } = self.resolve(library)?;
        let mut hashes = inputs_sha256(&fitted, true);
        hashes.extend(inputs_sha256(&held_out, false));
        Ok(hashes)
    }
}

/// The plant that all trials were recorded on, with its delay.
fn common_plant(trials: &[ResolvedTrial]) -> Result<(System, f64), Problem> {
    let mut common: Option<((System, f64), &str)> = None;
    for trial in trials {
        let Some(model) = trial.plant() else {
            return Err(Problem::new(Code::Invalid, "no plant", format!("{} has no plant", trial.name)).at("/inputs"));
        };
        let plant = check_delayed_plant(model, &trial.name)?;
        match &common {
            None => common = Some((plant, &trial.name)),
            Some((first, _)) if *first == plant => {}
            Some((_, name)) => {
                let detail = format!("{} and {name} were recorded on different plants", trial.name);
                return Err(Problem::new(Code::Invalid, "different plants", detail)
                    .at(trial.name.clone())
                    .mend("Identify them apart: averaging responses needs one plant."));
            }
        }
    }
    common
        .map(|(plant, _)| plant)
        .ok_or_else(|| Problem::new(Code::Invalid, "no trial", "there is no trial to identify from").at("/inputs"))
}

/// A sampled plant must have the trials' sample time.
fn check_sample_times(plant: &System, trials: &[ResolvedTrial]) -> Result<(), Problem> {
    let Some(period) = plant.sample_time_s() else { return Ok(()) };
    for trial in trials {
        let own = trial.trial().sample_time_s;
        if (own - period).abs() > SAME_SAMPLE_TIME * period {
            let detail = format!("the plant is sampled every {period} s, the trial every {own} s");
            return Err(Problem::new(Code::Invalid, "different sample times", detail)
                .at(trial.name.clone())
                .mend("Give the plant at the trial's sample time, or in continuous time."));
        }
    }
    Ok(())
}
