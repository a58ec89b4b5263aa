//! Runs a loop, and refines the steps of a loop with delays until they no longer matter.

use super::closed::ClosedLoop;
use super::continuous::Continuous;
use super::sampled::Sampled;
use crate::control::Discrete;
use crate::control::simulate::SimulationError;
use crate::ctl::{Ctl, Stopped};

/// Steps are halved until that changes u and y by less than this share of their peaks.
const TOLERANCE: f64 = 1e-5;

/// Steps of a run at most; beyond it they are not halved.
const MOST_STEPS: usize = 4_000_000;

/// Steps within a sample at most.
const MOST_STEPS_OF_A_SAMPLE: usize = 512;

/// What drives a loop, sample by sample. An empty slice is none; beyond its end a signal keeps its last value.
#[derive(Debug, Clone, Copy, Default)]
pub struct Drive<'a> {
    /// Command r.
    pub command: &'a [f64],
    /// Disturbance d, added to the control at the plant's input.
    pub disturbance: &'a [f64],
    /// Remnant w, part of the control.
    pub remnant: &'a [f64],
    /// Error of perception n: the person sees y + n.
    pub perception: &'a [f64],
    /// How the plant moves without any input: its output and the output's derivatives at the start (sampled: its first
    /// samples), at most as many as the plant has poles, zeros after them. Before the start nobody saw an error.
    pub initial: &'a [f64],
}

/// The value of a sample.
pub(super) fn sample(signal: &[f64], k: usize) -> f64 {
    signal.get(k).or(signal.last()).copied().unwrap_or(0.0)
}

/// Signals of a loop.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// Control u with its remnant; `None` where a controller differentiates, so that u has no samples.
    pub control: Option<Vec<f64>>,
    /// Output y, as the plant has it.
    pub output: Vec<f64>,
}

/// How far signals moved when the steps were last halved, at most; 0 of a loop that is propagated exactly. The error
/// that is left is smaller: it falls with the square of the step.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct NumericalError {
    /// In y, in its unit.
    pub output: f64,
    /// In u, in its unit.
    pub control: f64,
    /// Whether both are below 1e-5 of the peaks.
    pub is_within_tolerance: bool,
}

/// Why a loop was not simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulatorError {
    /// The signals overflow, or a part has no realisation.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// The command ends before the feedforward, which looks ahead, has begun.
    #[error("the feedforward looks ahead by {lead_s} s, and the command takes {command_s} s")]
    Preview {
        /// Preview less delay of the feedforward.
        lead_s: f64,
        /// Length of the command.
        command_s: f64,
    },
    /// A delay that steps within a sample cannot resolve.
    #[error("the delay around the loop, {delay_s} s, is a small part of the sample time of {sample_time_s} s")]
    ShortDelay {
        /// Of plant and feedback.
        delay_s: f64,
        /// Of the command.
        sample_time_s: f64,
    },
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

enum Engine<'a> {
    Sampled(Sampled<'a>),
    Continuous(Box<Continuous>),
}

/// A loop made ready for commands of some length and sample time.
pub struct Simulator<'a> {
    closed: &'a ClosedLoop,
    time: Discrete,
    engine: Engine<'a>,
    samples: usize,
}

impl<'a> Simulator<'a> {
    /// For commands of `command_samples` samples. A sampled loop has its own sample time, which must be this one.
    ///
    /// # Errors
    /// [`SimulatorError`].
    pub fn new(closed: &'a ClosedLoop, time: Discrete, command_samples: usize) -> Result<Self, SimulatorError> {
        let delays = closed.delays();
        let period = time.period_s();
        let last = command_samples.saturating_sub(1);
        let command_s = last as f64 * period;
        let (engine, lead) = match Sampled::new(closed) {
            Some(sampled) => {
                let lead = sampled.preview() as f64;
                (Engine::Sampled(sampled), lead)
            }
            None => {
                let steps = Continuous::least_steps(delays, period)
                    .ok_or(SimulatorError::ShortDelay { delay_s: delays.around_s(), sample_time_s: period })?;
                let continuous = Continuous::new(closed, time, steps)?;
                (Engine::Continuous(Box::new(continuous)), (delays.preview_s - delays.feedforward_s).max(0.0) / period)
            }
        };
        let usable = (last as f64 - lead + 1e-9).floor();
        if usable < 1.0 {
            return Err(SimulatorError::Preview { lead_s: lead * period, command_s });
        }
        Ok(Self { closed, time, engine, samples: usable as usize + 1 })
    }

    /// Samples of the signals: those of the command, without the last ones that are only seen ahead of time.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Steps within a sample.
    #[must_use]
    pub fn steps_of_a_sample(&self) -> usize {
        match &self.engine {
            Engine::Sampled(_) => 1,
            Engine::Continuous(continuous) => continuous.steps(),
        }
    }

    /// The signals.
    ///
    /// # Errors
    /// [`SimulatorError`].
    pub fn run(&self, drive: &Drive, ctl: &Ctl) -> Result<Simulated, SimulatorError> {
        match &self.engine {
            Engine::Sampled(sampled) => sampled.run(drive, self.samples, ctl),
            Engine::Continuous(continuous) => continuous.run(drive, self.samples, ctl),
        }
    }

    /// The signals, with steps halved (for later runs too) until that no longer moves them.
    ///
    /// # Errors
    /// [`SimulatorError`].
    pub fn refine(&mut self, drive: &Drive, ctl: &Ctl) -> Result<(Simulated, NumericalError), SimulatorError> {
        let mut found = self.run(drive, ctl)?;
        let mut error = NumericalError { is_within_tolerance: true, ..NumericalError::default() };
        while let Engine::Continuous(continuous) = &self.engine {
            let steps = 2 * continuous.steps();
            let is_more = steps <= MOST_STEPS_OF_A_SAMPLE && steps.saturating_mul(self.samples) <= MOST_STEPS;
            if continuous.is_exact() || !is_more {
                if !continuous.is_exact() && error.output == 0.0 && error.control == 0.0 {
                    error.is_within_tolerance = false;
                }
                break;
            }
            let finer = Continuous::new(self.closed, self.time, steps)?;
            self.engine = Engine::Continuous(Box::new(finer));
            let next = self.run(drive, ctl)?;
            let (output, is_near) = moved(&found.output, &next.output);
            let (control, is_also) = match (&found.control, &next.control) {
                (Some(before), Some(after)) => moved(before, after),
                _ => (0.0, true),
            };
            found = next;
            error = NumericalError { output, control, is_within_tolerance: is_near && is_also };
            if error.is_within_tolerance {
                break;
            }
        }
        Ok((found, error))
    }
}

/// The largest difference, and whether it is small beside the peak.
fn moved(before: &[f64], after: &[f64]) -> (f64, bool) {
    let peak = after.iter().fold(0.0_f64, |peak, x| peak.max(x.abs()));
    let largest = before.iter().zip(after).fold(0.0_f64, |largest, (a, b)| largest.max((a - b).abs()));
    (largest, largest <= TOLERANCE * peak)
}
