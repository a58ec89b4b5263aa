//! What a loop answers to a step, from an initial state, and to sinusoids.

use super::assembly::Assembly;
use super::result::{FreeResponse, FrequencyResponses, StepResponse, gain_and_phase};
use crate::analysis::problem::{Code, Problem};
use crate::control::bode::log_grid;
use crate::control::{Continuous, Discrete, System, TransferFunction};
use crate::ctl::{Ctl, Stopped};
use crate::learning::bode::Response;
use crate::learning::frequency_domain::{ControllerMetrics, controller_metrics_of};
use crate::num::Complex64;
use crate::num::stats::mean;
use crate::simulate::closed_loop::{ClosedLoop, Delays, Drive, LoopResponses, Simulator, SimulatorError};
use std::f64::consts::TAU;

/// Samples of a response at most.
const MOST_SAMPLES: usize = 20_000;

/// Length of a response by default, s.
const LENGTH_S: f64 = 10.0;

/// The band of frequency responses by default, Hz.
const BAND_HZ: [f64; 2] = [0.01, 10.0];

/// Samples of step and free responses.
///
/// # Errors
/// Of more than there may be.
pub(super) fn response_samples(response_s: Option<f64>, time: Discrete) -> Result<usize, Problem> {
    let samples = |seconds: f64| (seconds / time.period_s() + 1e-9).floor() + 1.0;
    match response_s {
        None => Ok((samples(LENGTH_S) as usize).clamp(2, MOST_SAMPLES)),
        Some(seconds) if samples(seconds) > MOST_SAMPLES as f64 || samples(seconds) < 2.0 => {
            let detail = format!("{seconds} s are {} samples; 2 to {MOST_SAMPLES} are shown", samples(seconds));
            Err(Problem::new(Code::Invalid, "unusable spec", detail).at("/spec/response_s"))
        }
        Some(seconds) => Ok(samples(seconds) as usize),
    }
}

fn times(samples: usize, time: Discrete) -> Vec<f64> {
    (0..samples).map(|k| k as f64 * time.period_s()).collect()
}

/// How many samples of a command give so many of an answer, with what is only seen ahead of time.
fn with_preview(closed: &ClosedLoop, samples: usize, time: Discrete) -> usize {
    samples + (closed.delays().preview_s / time.period_s()).ceil() as usize + 1
}

/// By how much y would move, mean over the samples, if stimuli were smooth between their samples and not straight: a
/// third of what leaving out every second sample does. `None` in sampled time, and where that cannot be told.
///
/// # Errors
/// [`Stopped`].
pub(super) fn between_samples(assembly: &Assembly, output: &[f64], ctl: &Ctl) -> Result<Option<f64>, Stopped> {
    let Assembly { closed, time, command, disturbance, initial, .. } = assembly;
    let Ok(twice) = Discrete::new(2.0 * time.period_s()) else { return Ok(None) };
    if closed.plant().sample_time_s().is_some() {
        return Ok(None);
    }
    let thin = |x: &[f64]| -> Vec<f64> { x.iter().step_by(2).copied().collect() };
    let (command, disturbance) = (thin(command), thin(disturbance));
    let drive = Drive { command: &command, disturbance: &disturbance, initial, ..Drive::default() };
    let coarse = Simulator::new(closed, twice, command.len()).and_then(|mut simulator| simulator.refine(&drive, ctl));
    let coarse = match coarse {
        Ok((found, _)) => found.output,
        Err(SimulatorError::Stopped(stopped)) => return Err(stopped),
        // A delay that a sample of twice the length does not resolve, or a command of three samples.
        Err(_) => return Ok(None),
    };
    let moved: Vec<f64> = coarse.iter().zip(output.iter().step_by(2)).map(|(a, b)| (a - b).abs() / 3.0).collect();
    Ok(mean(&moved))
}

/// The answers of loop and plant to unit steps.
///
/// # Errors
/// [`SimulatorError`].
pub(super) fn step_response(
    closed: &ClosedLoop,
    time: Discrete,
    samples: usize,
    ctl: &Ctl,
) -> Result<StepResponse, SimulatorError> {
    let command = vec![1.0; with_preview(closed, samples, time)];
    let drive = Drive { command: &command, ..Drive::default() };
    let (found, _) = Simulator::new(closed, time, command.len())?.refine(&drive, ctl)?;
    let plant = match alone(closed) {
        None => None,
        Some(plant) => match Simulator::new(&plant, time, command.len())?.refine(&drive, ctl) {
            Ok((found, _)) => Some(found.output[..samples].to_vec()),
            Err(SimulatorError::Stopped(stopped)) => return Err(stopped.into()),
            Err(_) => None,
        },
    };
    let (y, u) = (found.output[..samples].to_vec(), found.control.map(|u| u[..samples].to_vec()));
    Ok(StepResponse { t: times(samples, time), plant, y, u })
}

/// The plant with the command as its input.
fn alone(closed: &ClosedLoop) -> Option<ClosedLoop> {
    let gain = |value: f64| match closed.plant() {
        System::Continuous(_) => TransferFunction::new(&[value], &[1.0], Continuous).ok().map(System::Continuous),
        System::Discrete(tf) => TransferFunction::new(&[value], &[1.0], tf.time()).ok().map(System::Discrete),
    };
    let delays = Delays { plant_s: closed.delays().plant_s, ..Delays::default() };
    ClosedLoop::new(closed.plant().clone(), gain(1.0)?, gain(0.0)?, delays).ok()
}

/// The motion from an initial state.
///
/// # Errors
/// [`SimulatorError`].
pub(super) fn free_response(
    closed: &ClosedLoop,
    initial: &[f64],
    time: Discrete,
    samples: usize,
    ctl: &Ctl,
) -> Result<FreeResponse, SimulatorError> {
    let drive = Drive { initial, ..Drive::default() };
    let command_samples = with_preview(closed, samples, time);
    let (found, _) = Simulator::new(closed, time, command_samples)?.refine(&drive, ctl)?;
    let (y, u) = (found.output[..samples].to_vec(), found.control.map(|u| u[..samples].to_vec()));
    Ok(FreeResponse { t: times(samples, time), y, u })
}

/// The band of frequency responses in Hz.
///
/// # Errors
/// Where it passes half the rate of a sampled loop.
pub(super) fn band_hz(asked: Option<[f64; 2]>, closed: &ClosedLoop, time: Discrete) -> Result<[f64; 2], Problem> {
    let nyquist = 0.5 / time.period_s();
    let Some([from, to]) = asked else {
        let to = BAND_HZ[1].min(nyquist);
        return Ok([BAND_HZ[0].min(to / 100.0), to]);
    };
    if closed.plant().sample_time_s().is_some() && to > nyquist * (1.0 + 1e-9) {
        let detail = format!("the band ends at {to} Hz, above half the rate of the loop's samples, {nyquist} Hz");
        return Err(Problem::new(Code::Invalid, "unusable spec", detail).at("/spec/band_hz"));
    }
    Ok([from, to])
}

/// Responses on a logarithmic grid.
pub(super) fn frequency_responses(closed: &ClosedLoop, band_hz: [f64; 2], points: usize) -> FrequencyResponses {
    let omega = log_grid(TAU * band_hz[0], TAU * band_hz[1], points);
    let all: Vec<LoopResponses> = omega.iter().map(|w| closed.responses(*w)).collect();
    let of = |part: fn(&LoopResponses) -> Complex64| -> Response {
        gain_and_phase(&omega, &all.iter().map(part).collect::<Vec<_>>())
    };
    FrequencyResponses {
        plant: of(|r| r.plant),
        feedforward: of(|r| r.feedforward),
        feedback: of(|r| r.feedback),
        feedforward_plant: of(|r| r.feedforward_plant),
        loop_gain: of(|r| r.loop_gain),
        closed_loop: of(|r| r.command_to_output),
        command_to_error: of(|r| r.command_to_error),
        omega_rad_s: omega,
    }
}

/// Norms over a band in Hz, with delays.
///
/// # Errors
/// Where the band passes half the rate of a sampled loop.
pub(super) fn norms(closed: &ClosedLoop, band_hz: [f64; 2], time: Discrete) -> Result<ControllerMetrics, Problem> {
    let wrong = |detail: String| Problem::new(Code::Invalid, "unusable spec", detail).at("/spec/norm_band_hz");
    let nyquist = 0.5 / time.period_s();
    if closed.plant().sample_time_s().is_some() && band_hz[1] > nyquist * (1.0 + 1e-9) {
        let detail =
            format!("the band ends at {} Hz, above half the rate of the loop's samples, {nyquist} Hz", band_hz[1]);
        return Err(wrong(detail));
    }
    controller_metrics_of(
        |omega| closed.plant_fraction(omega),
        |omega| closed.responses(omega).feedforward,
        |omega| closed.responses(omega).feedback,
        (TAU * band_hz[0], TAU * band_hz[1]),
    )
    .map_err(|error| wrong(error.to_string()))
}
