//! The signals of trials as matrices, of the request or stored.

use super::inputs::{GainFitInputs, GainFitTrial, GainFitTrialInput};
use super::known_plant::PlantSource;
use super::plant::LARGEST;
use crate::analysis::inputs::library::Library;
use crate::analysis::inputs::recorded;
use crate::analysis::inputs::sampled_signal::SampledSignal;
use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_inputs as wrong;
use nalgebra::DMatrix;

/// The signals of a trial as matrices, samples × channels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Signals {
    pub sample_time_s: f64,
    pub input: DMatrix<f64>,
    pub output: DMatrix<f64>,
    pub control: Option<DMatrix<f64>>,
    pub initial_state: Option<Vec<f64>>,
}

impl Signals {
    fn of_request(trial: &GainFitTrial, at: &str) -> Result<Self, Problem> {
        let period = trial.sample_time_s;
        if !(period > 0.0 && period.is_finite()) {
            return Err(wrong(
                format!("the sample time is {period}, and must be a positive number of seconds"),
                format!("{at}/sample_time_s"),
            ));
        }
        let checked = |written: &SampledSignal, name: &str| written.checked(name, LARGEST, &format!("{at}/{name}"));
        let input = checked(&trial.input, "input")?;
        let output = checked(&trial.output, "output")?;
        let control = trial.control.as_ref().map(|control| checked(control, "control")).transpose()?;
        recorded::as_long(&output, &[("input", Some(&input)), ("control", control.as_ref())], at)?;
        let initial_state = trial.initial_state.clone();
        if initial_state.iter().flatten().any(|v| v.is_nan() || v.abs() > LARGEST) {
            return Err(wrong(format!("an entry is larger than {LARGEST:e}"), format!("{at}/initial_state")));
        }
        Ok(Self { sample_time_s: period, input, output, control, initial_state })
    }
}

/// The signals in the request; `None` where its trials are stored ones.
///
/// # Errors
/// A [`Problem`] with the pointer of the signal, or of the trial that is there twice.
pub(super) fn of_request(inputs: &GainFitInputs) -> Result<Option<Vec<Signals>>, Problem> {
    let mut signals = Vec::new();
    for (i, trial) in inputs.trials().iter().enumerate() {
        let GainFitTrialInput::Inline(trial) = trial else { return Ok(None) };
        let at = inputs.place(i);
        let found = Signals::of_request(trial, &at)?;
        recorded::add(&mut signals, found, &at)?;
    }
    Ok(Some(signals))
}

/// The signals of stored trials, with the plant of the request or else the one that all were recorded on. A trial's
/// disturbance is the input where it has one, its command otherwise.
///
/// # Errors
/// `not_found` for a trial that is gone, `invalid` for trials of different plants or the same recording twice.
pub(super) fn of_library(inputs: &GainFitInputs, library: &Library) -> Result<(PlantSource, Vec<Signals>), Problem> {
    let mut plant = inputs.plant.clone().map(PlantSource::Written);
    let mut signals = Vec::new();
    for (i, trial) in inputs.trials().iter().enumerate() {
        let GainFitTrialInput::Stored(id) = trial else { continue };
        let at = inputs.place(i);
        let stored = recorded::stored(library, *id, &at)?;
        let model = PlantSource::Stored(stored.plant.clone());
        if inputs.plant.is_none() && plant.get_or_insert_with(|| model.clone()) != &model {
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
        recorded::add(&mut signals, found, &at)?;
    }
    let plant = plant.ok_or_else(|| wrong("there is no trial", "/inputs/trials"))?;
    Ok((plant, signals))
}
