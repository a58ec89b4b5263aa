//! A person and a plant simulated: kind `simulate`.
//!
//! ```json
//! {"kind": "simulate",
//!  "inputs": {"plant": "minimum_phase",
//!             "feedforward": {"num": [25, 90, 100], "den": [1, 52.2, 110]},
//!             "feedback": {"num": [1], "den": [0.1, 1], "delay_s": 0.15},
//!             "command": {"generator": {"kind": "chirp", "preset": "zhang2015_section_5_2"}, "sample_time_s": 0.02},
//!             "noise": {"remnant": {"sd": 0.1, "time_constant_s": 0.2}}},
//!  "spec": {"seed": 7}}
//! ```
//! The method is that of [`closed_loop`](crate::simulate::closed_loop).

mod assembly;
mod inputs;
mod realisations;
mod responses;
mod result;
mod spec;

use super::contract::{Analysis, Failure, Outcome, Samples};
use super::inputs::library::Library;
use super::kind::Kind;
use super::problem::{Code, Problem};
use super::report::Warning;
use crate::ctl::{Ctl, Phase};
use crate::num::stats::{accounted_for, mean};
use crate::simulate::closed_loop::{Simulator, SimulatorError};
use assembly::Assembly;
pub use inputs::{NoiseInput, NoiseSource, SimulateInputs, SimulatedPlant, StimulusInput};
use realisations::{Draw, NO_CONTROL, Signals};
pub use result::{
    FreeResponse, FrequencyResponses, NumericalErrorResult, PoleResult, RealisationsResult, RecordedResult,
    SignalsResult, SimulateResult, Spread, StepResponse,
};
use serde_json::Value;
pub use spec::SimulateSpec;

/// Of more than this share of the mean error, what stimuli do between their samples deserves a warning.
const KINKS: f64 = 0.01;

/// What counts as rounding beside the peak of y.
const ROUNDING: f64 = 1e-6;

/// Samples of a signal that are shown at most.
const MOST_SHOWN: usize = 100_000;

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: SimulateInputs,
    spec: SimulateSpec,
}

impl Analysis for Plan {
    const KIND: Kind = Kind::named("simulate");
    const TITLE: &'static str = "Simulation of a person and a plant";
    const SUMMARY: &'static str = "What a person with given controllers does on a plant: the signals of the closed \
        loop with delays, preview, noise and an initial state under a command that is made, given or was recorded; the \
        metrics of a trial with their spread over the noise, step and free responses, and the frequency responses of \
        all parts (Zhang 2015, sections 3.4 and 5.5).";
    const RESULT_VERSION: u32 = 1;
    const EXAMPLE: &'static str = include_str!("example.json");

    type Inputs = SimulateInputs;
    type Spec = SimulateSpec;
    type Result = SimulateResult;

    fn check(inputs: SimulateInputs, spec: SimulateSpec) -> Result<Self, Problem> {
        spec.check()?;
        Ok(Self { inputs, spec })
    }

    fn inputs(&self) -> &SimulateInputs {
        &self.inputs
    }

    fn spec(&self) -> &SimulateSpec {
        &self.spec
    }

    /// That of the noise, or of the command where only that is drawn.
    fn seed(&self) -> Option<u64> {
        let is_noisy = self.inputs.noise.is_some_and(|noise| noise.is_drawn());
        if is_noisy { Some(self.spec.seed) } else { self.inputs.command.signal().seed() }
    }

    /// Output, command and control.
    fn samples(result: &Value) -> Option<Samples> {
        let signals = &result["signals"];
        let step = signals["sample_time_s"].as_f64()? * signals["every"].as_f64()?;
        let column = |name: &'static str| (name, &signals[name]);
        Samples::named(&step.into(), &[column("r"), column("u"), column("y"), column("d")])
    }

    fn run(&self, library: &Library, ctl: &Ctl) -> Result<Outcome<SimulateResult>, Failure> {
        ctl.enter(Phase::Preparation, 0.1);
        let assembly = Assembly::new(&self.inputs, library, ctl)?;
        let Assembly { closed, time, .. } = &assembly;
        let band_hz = responses::band_hz(self.spec.band_hz, closed, *time)?;
        let norms = responses::norms(closed, self.spec.norm_band_hz, *time)?;
        let response_samples = responses::response_samples(self.spec.response_s, *time)?;
        ctl.enter(Phase::Computing, 0.3);
        let mut simulator = Simulator::new(closed, *time, assembly.command.len()).map_err(failure)?;
        self.check_shown(simulator.samples())?;
        realisations::runs(&simulator)?;
        let mut draw = Draw::new(&self.inputs, self.spec.seed, &assembly);
        let (noiseless, error) = simulator.refine(&draw.drive(), ctl).map_err(failure)?;
        let mut warnings = Vec::new();
        if !error.is_within_tolerance {
            let message = format!(
                "halving the steps still moved y by {:.2e} and u by {:.2e}, more than 1e-5 of their peaks: shorten the \
                 sample time, or the command",
                error.output, error.control
            );
            warnings.push(Warning::new("simulation_not_converged", message));
        }
        let between_samples = responses::between_samples(&assembly, &noiseless.output, ctl)?;
        warnings.extend(kinks(&assembly, &noiseless.output, between_samples));
        let count = if draw.is_noisy { self.spec.realisations } else { 0 };
        realisations::affordable(count, &simulator)?;
        let signals = if count == 0 {
            Signals::new(noiseless, &draw)
        } else {
            draw.noise(0, simulator.samples());
            let found = simulator.run(&draw.drive(), ctl).map_err(failure)?;
            Signals::new(found, &draw)
        };
        let metrics = realisations::metrics(&signals, &assembly)?;
        ctl.enter(Phase::Intervals, 0.5);
        let spread = realisations::spread(&draw, &simulator, &assembly, count, ctl)?;
        ctl.enter(Phase::Computing, 0.1);
        let free_response = if assembly.initial.is_empty() {
            None
        } else {
            let free = responses::free_response(closed, &assembly.initial, *time, response_samples, ctl);
            Some(free.map_err(failure)?)
        };
        if !closed.has_control() {
            warnings.push(Warning::new("control_without_samples", NO_CONTROL.to_owned()));
        }
        if assembly.disturbance_left_out {
            let message = "the trial that gives the command has a disturbance too, and the simulation has none: give \
                           \"disturbance\": {\"trial\": ..} to simulate what was recorded";
            warnings.push(Warning::new("disturbance_left_out", message));
        }
        let result = SimulateResult {
            sample_time_s: closed.plant().sample_time_s(),
            slowest_pole: closed.slowest_pole().ok().flatten().map(PoleResult::from),
            numerical_error: NumericalErrorResult {
                exact: error.is_within_tolerance && error.output == 0.0 && error.control == 0.0,
                steps_of_a_sample: simulator.steps_of_a_sample(),
                output: error.output,
                control: error.control,
                between_samples,
            },
            metrics,
            without_interval: spread.is_none().then(|| {
                "nothing is drawn: the same request gives the same numbers, to the numerical error".to_owned()
            }),
            realisations: spread,
            recorded: recorded(&assembly, &signals),
            norms,
            step_response: responses::step_response(closed, *time, response_samples, ctl).map_err(failure)?,
            free_response,
            frequency_responses: responses::frequency_responses(closed, band_hz, self.spec.points),
            signals: self.shown(signals, &assembly),
        };
        Ok(Outcome::new(result, warnings))
    }
}

impl Plan {
    fn check_shown(&self, samples: usize) -> Result<(), Problem> {
        let shown = samples.div_ceil(self.spec.every);
        if shown <= MOST_SHOWN {
            return Ok(());
        }
        let detail = format!("{shown} samples of each signal would be shown; {MOST_SHOWN} at most are");
        Err(Problem::new(Code::TooLarge, "too many samples", detail)
            .at("/spec/every")
            .mend(format!("Ask for every {}th sample: \"every\": {0}.", samples.div_ceil(MOST_SHOWN))))
    }

    fn shown(&self, signals: Signals, assembly: &Assembly) -> SignalsResult {
        let every = self.spec.every;
        let thin = |x: &[f64]| -> Vec<f64> { x.iter().step_by(every).copied().collect() };
        let samples = signals.output.len();
        let period = assembly.time.period_s();
        SignalsResult {
            sample_time_s: period,
            every,
            samples,
            t: (0..samples).step_by(every).map(|k| k as f64 * period).collect(),
            r: thin(&assembly.command[..samples]),
            u: signals.control.as_deref().map(thin),
            y: thin(&signals.output),
            e: assembly.command.iter().zip(&signals.output).step_by(every).map(|(r, y)| r - y).collect(),
            d: (!assembly.disturbance.is_empty()).then(|| thin(&assembly.disturbance[..samples])),
        }
    }
}

/// How much of the trial that gave the command the simulation explains.
fn recorded(assembly: &Assembly, signals: &Signals) -> Option<RecordedResult> {
    let [u, y] = assembly.recorded.as_ref()?;
    let samples = signals.output.len();
    Some(RecordedResult {
        accounted_for_u: signals.control.as_ref().and_then(|found| accounted_for(&u[..samples], found)),
        accounted_for_y: accounted_for(&y[..samples], &signals.output),
    })
}

/// A warning where what the command does between its samples counts.
fn kinks(assembly: &Assembly, output: &[f64], between_samples: Option<f64>) -> Option<Warning> {
    let moved = between_samples?;
    let errors: Vec<f64> = assembly.command.iter().zip(output).map(|(r, y)| (r - y).abs()).collect();
    let error = mean(&errors)?;
    let peak = output.iter().fold(0.0_f64, |peak, y| peak.max(y.abs()));
    (moved > KINKS * error && moved > ROUNDING * peak).then(|| {
        let message = format!(
            "if the stimuli were smooth and not straight between their samples, y would move by {moved:.2e} in the \
             mean, {:.1} % of the mean error: the controllers amplify what is faster than the samples",
            100.0 * moved / error
        );
        Warning::new("kinks_between_samples", message)
    })
}

fn failure(error: SimulatorError) -> Failure {
    let problem = |code: Code, title: &str, at: &str| Problem::new(code, title, error.to_string()).at(at);
    Failure::Problem(match &error {
        SimulatorError::Stopped(stopped) => return Failure::Stopped(*stopped),
        SimulatorError::Preview { .. } => problem(Code::Invalid, "preview beyond the command", inputs::PREVIEW)
            .mend("Give a longer command, or a shorter preview."),
        SimulatorError::ShortDelay { .. } => problem(Code::Invalid, "unusable delay", "/inputs/feedback")
            .mend("Leave a delay as short as this out, or sample the command faster."),
        SimulatorError::Simulation(_) => problem(Code::Numerical, "the simulation overflows", "/inputs")
            .mend("Choose units in which the numbers are of moderate size."),
    })
}

#[cfg(test)]
mod tests;
