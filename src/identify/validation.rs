//! How well an identified loop predicts a trial, by simulation from the command alone.

use crate::control::simulate::SimulationError;
use crate::control::{Continuous, Discrete, System, TransferFunction};
use crate::num::fourier::RealTransform;
use crate::num::stats::accounted_for;
use crate::person::two_degrees_of_freedom::{LoopResponse, TwoDegreesOfFreedom};
use crate::trial::Trial;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A band with less than this share of the recording's power holds nothing but the rounding of its transform.
const ROUNDING: f64 = 1e-24;

/// A sampled model and a trial whose sample times differ by more than this share are not of one kind.
const SAMPLE_TIME_TOLERANCE: f64 = 1e-5;

/// The share of a signal's variation that a simulation explains.
///
/// `1 − Σ (x − x̂)² / Σ (x − mean x)²` over all samples: 1 for a perfect simulation, 0 for one no better than the
/// signal's mean, negative for a worse one. The simulation starts from rest and is driven by the command, and by the
/// disturbance where one was recorded, never by the recorded control or output: a one-step prediction would flatter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SimulatedVaf {
    /// Of the output y, over all frequencies.
    pub output: f64,
    /// Of the control u; null where the model has none to simulate.
    pub control: Option<f64>,
    /// Of the output's sinusoids on the lines `k/(N T)` within the band; null where there is none, or nothing moves
    /// there.
    pub output_in_band: Option<f64>,
    /// The same of the control.
    pub control_in_band: Option<f64>,
    /// Why `control` is null.
    pub control_unavailable: Option<String>,
}

/// Why nothing could be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ValidationError {
    /// Plant and controllers do not share one time base.
    #[error("the plant and the controllers do not share one time base")]
    MixedTimeBases,
    /// The model is sampled at another rate than the trial.
    #[error("the model is sampled every {model_s} s, the trial every {trial_s} s")]
    SampleTime {
        /// Of the model.
        model_s: f64,
        /// Of the trial.
        trial_s: f64,
    },
    /// The loop cannot be simulated.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// A recorded signal is constant: there is no variation to explain.
    #[error("the recorded output is constant, so there is no variation to account for")]
    ConstantOutput,
}

/// The control and the output of the loop, simulated from rest on a trial's command (and disturbance).
///
/// # Errors
/// [`ValidationError`] where the loop cannot be simulated on this trial.
pub fn simulated_loop(
    trial: &Trial,
    plant: &System,
    feedforward: &System,
    feedback: &System,
) -> Result<LoopResponse, ValidationError> {
    match (plant, feedforward, feedback) {
        (System::Continuous(g), System::Continuous(ff), System::Continuous(fb)) => continuous(trial, g, ff, fb),
        (System::Discrete(g), System::Discrete(ff), System::Discrete(fb)) => sampled(trial, g, ff, fb),
        _ => Err(ValidationError::MixedTimeBases),
    }
}

/// Simulates the loop on a trial's command (and disturbance) and compares with the recording, over all frequencies and
/// within a band in rad/s: above the lines that it was fitted to a model is whatever its structure makes it.
///
/// # Errors
/// [`ValidationError`] where the loop cannot be simulated on this trial, or the output never moves.
pub fn simulated_vaf(
    trial: &Trial,
    plant: &System,
    feedforward: &System,
    feedback: &System,
    band_rad_s: [f64; 2],
) -> Result<SimulatedVaf, ValidationError> {
    let response = simulated_loop(trial, plant, feedforward, feedback)?;
    let output = accounted_for(&trial.signals.output, &response.output).ok_or(ValidationError::ConstantOutput)?;
    let (control, control_unavailable) = match &response.control {
        None => (None, Some("the feedforward is improper, so the model's control is no function of time".to_owned())),
        Some(simulated) => match accounted_for(&trial.signals.control, simulated) {
            Some(share) => (Some(share), None),
            None => (None, Some("the recorded control is constant".to_owned())),
        },
    };
    let lines = lines_within(band_rad_s, trial);
    let output_in_band = explained_on(&trial.signals.output, &response.output, &lines);
    let control_in_band =
        response.control.as_ref().and_then(|simulated| explained_on(&trial.signals.control, simulated, &lines));
    Ok(SimulatedVaf { output, control, output_in_band, control_in_band, control_unavailable })
}

/// The lines of the whole record's grid within a band, its edges to half a line, 0 Hz excepted.
fn lines_within([low, high]: [f64; 2], trial: &Trial) -> std::ops::Range<usize> {
    let step = std::f64::consts::TAU / (trial.samples() as f64 * trial.sample_time_s);
    let last = trial.samples() / 2;
    let line = |omega: f64| (omega / step).round().clamp(0.0, last as f64) as usize;
    line(low).max(1)..line(high) + 1
}

/// The share explained of what is on some lines.
fn explained_on(recorded: &[f64], simulated: &[f64], lines: &std::ops::Range<usize>) -> Option<f64> {
    let missed: Vec<f64> = recorded.iter().zip(simulated).map(|(x, y)| x - y).collect();
    if missed.iter().any(|x| !x.is_finite()) || lines.is_empty() {
        return None;
    }
    let transform = RealTransform::new(missed.len());
    let (recorded, missed) = (transform.of(recorded), transform.of(&missed));
    let power = |grid: &[Complex64]| grid.get(lines.clone()).map(|own| own.iter().map(|x| x.norm_sqr()).sum::<f64>());
    let (all, left) = (power(&recorded)?, power(&missed)?);
    let share = 1.0 - left / all;
    let total: f64 = recorded.iter().map(|x| x.norm_sqr()).sum();
    (all > ROUNDING * total && share.is_finite()).then_some(share)
}

fn continuous(
    trial: &Trial,
    plant: &TransferFunction<Continuous>,
    feedforward: &TransferFunction<Continuous>,
    feedback: &TransferFunction<Continuous>,
) -> Result<LoopResponse, ValidationError> {
    let system = TwoDegreesOfFreedom::new(plant.clone(), feedforward.clone(), feedback.clone())
        .map_err(|_| ValidationError::MixedTimeBases)?;
    let disturbance = trial.signals.disturbance.as_deref();
    Ok(system.simulate(&trial.signals.command, disturbance, trial.sample_time_s)?)
}

fn sampled(
    trial: &Trial,
    plant: &TransferFunction<Discrete>,
    feedforward: &TransferFunction<Discrete>,
    feedback: &TransferFunction<Discrete>,
) -> Result<LoopResponse, ValidationError> {
    let (model_s, trial_s) = (plant.time().period_s(), trial.sample_time_s);
    if (model_s - trial_s).abs() > SAMPLE_TIME_TOLERANCE * trial_s {
        return Err(ValidationError::SampleTime { model_s, trial_s });
    }
    let system = TwoDegreesOfFreedom::new(plant.clone(), feedforward.clone(), feedback.clone())
        .map_err(|_| ValidationError::MixedTimeBases)?;
    Ok(system.simulate(&trial.signals.command, trial.signals.disturbance.as_deref())?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trial::Signals;

    fn sampled_system(num: &[f64], den: &[f64]) -> System {
        System::Discrete(TransferFunction::new(num, den, Discrete::new(0.1).unwrap()).unwrap())
    }

    fn recorded(disturbance: Option<Vec<f64>>) -> (Trial, [System; 3]) {
        let systems = [
            sampled_system(&[0.2], &[1.0, -0.8]),
            sampled_system(&[0.7, 0.1], &[1.0, 0.0]),
            sampled_system(&[0.5], &[1.0]),
        ];
        let [System::Discrete(g), System::Discrete(ff), System::Discrete(fb)] = &systems else { unreachable!() };
        let system = TwoDegreesOfFreedom::new(g.clone(), ff.clone(), fb.clone()).unwrap();
        let command: Vec<f64> = (0..200).map(|i| (0.1 * f64::from(i)).sin()).collect();
        let response = system.simulate(&command, disturbance.as_deref()).unwrap();
        let signals =
            Signals { time_s: None, command, control: response.control.unwrap(), output: response.output, disturbance };
        (Trial::new(0.1, signals).unwrap(), systems)
    }

    #[test]
    fn the_loop_that_made_a_trial_explains_all_of_it_with_or_without_disturbance() {
        let disturbance: Vec<f64> = (0..200).map(|i| (0.37 * f64::from(i)).cos()).collect();
        for disturbance in [None, Some(disturbance)] {
            let (trial, [g, ff, fb]) = recorded(disturbance);
            let vaf = simulated_vaf(&trial, &g, &ff, &fb, [0.1, 30.0]).unwrap();
            assert!((vaf.output - 1.0).abs() < 1e-12 && (vaf.control.unwrap() - 1.0).abs() < 1e-12, "{vaf:?}");
        }
    }

    #[test]
    fn what_is_above_the_band_does_not_count_within_it() {
        let slow: Vec<f64> = (0..400).map(|i| (std::f64::consts::TAU * 5.0 * f64::from(i) / 400.0).sin()).collect();
        let wild: Vec<f64> = slow
            .iter()
            .enumerate()
            .map(|(i, x)| 0.5 * x + 20.0 * (std::f64::consts::TAU * 90.0 * i as f64 / 400.0).cos())
            .collect();
        assert!((explained_on(&slow, &wild, &(1..21)).unwrap() - 0.75).abs() < 1e-12);
        assert!(accounted_for(&slow, &wild).unwrap() < -100.0);
        assert_eq!(explained_on(&slow, &wild, &(30..40)), None);
    }

    #[test]
    fn what_cannot_be_simulated_is_said() {
        let (trial, [g, ff, fb]) = recorded(None);
        let continuous = System::Continuous(TransferFunction::new(&[1.0], &[1.0, 1.0], Continuous).unwrap());
        assert_eq!(simulated_vaf(&trial, &continuous, &ff, &fb, [0.1, 1.0]), Err(ValidationError::MixedTimeBases));
        let slow = |system: &System| {
            let (num, den) = (system.num().coefficients(), system.den().coefficients());
            System::Discrete(TransferFunction::new(num, den, Discrete::new(0.2).unwrap()).unwrap())
        };
        let error = simulated_vaf(&trial, &slow(&g), &slow(&ff), &slow(&fb), [0.1, 1.0]).unwrap_err();
        assert_eq!(error, ValidationError::SampleTime { model_s: 0.2, trial_s: 0.1 });
    }
}
