//! From a request to a loop in one time base, with its stimuli.

use super::inputs::{COMMAND, DISTURBANCE, INITIAL, PLANT, PREVIEW, SimulateInputs};
use crate::analysis::contract::Failure;
use crate::analysis::excitation::signal_input::{Column, SignalInput};
use crate::analysis::inputs::library::Library;
use crate::analysis::inputs::plant::check_delayed_plant;
use crate::analysis::inputs::trials::{ResolvedTrial, TrialInputs};
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::wrong_inputs as wrong;
use crate::control::discretise::zero_order_hold;
use crate::control::model::{StateSpaceModel, whole_samples};
use crate::control::{Continuous, Discrete, Model, ModelError, System, TransferFunction};
use crate::ctl::Ctl;
use crate::simulate::closed_loop::{ClosedLoop, Delays, LoopDefect, Part, Unstable, free_motion};
use nalgebra::DVector;

/// Sample times that differ by more than this share are not the same.
const SAME_SAMPLE_TIME: f64 = 1e-5;

/// Samples that are simulated at most.
const MOST_SAMPLES: usize = 500_000;

/// A loop at hand, with what drives it.
pub(super) struct Assembly {
    /// The loop; stable.
    pub closed: ClosedLoop,
    /// Of the signals.
    pub time: Discrete,
    /// r.
    pub command: Vec<f64>,
    /// d; empty for none.
    pub disturbance: Vec<f64>,
    /// How the plant moves without input: derivatives of its output, or samples.
    pub initial: Vec<f64>,
    /// What was recorded under the same command: control and output.
    pub recorded: Option<[Vec<f64>; 2]>,
    /// Whether the trial that is the command has a disturbance that is not simulated.
    pub disturbance_left_out: bool,
}

/// The recorded trial that is the command.
fn trial(inputs: &SimulateInputs, library: &Library) -> Result<Option<ResolvedTrial>, Problem> {
    let SignalInput::Trial(signal) = inputs.command.signal() else { return Ok(None) };
    let resolved = TrialInputs::one(signal.trial.clone()).resolve(library);
    Ok(resolved.map_err(|problem| problem.at(format!("{COMMAND}/trial")))?.into_iter().next())
}

/// The plant: the one given, or that of the trial.
///
/// # Errors
/// A [`Problem`] where it is gone, or the trial has none.
pub(super) fn plant(inputs: &SimulateInputs, library: &Library) -> Result<Model, Problem> {
    if let Some(plant) = &inputs.plant {
        return plant.model(library);
    }
    trial(inputs, library)?.and_then(|trial| trial.plant().cloned()).ok_or_else(|| {
        wrong("there is no plant, and the trial in the request brings none", PLANT)
            .mend("Give the plant beside the command.")
    })
}

/// A system with the delay behind it.
type Delayed = (System, f64);

fn in_samples(system: Delayed, time: Discrete, at: &str, what: &str) -> Result<System, Problem> {
    let (system, delay_s) = system;
    let unusable = |detail: String| wrong(detail, at);
    let samples = whole_samples(delay_s, time.period_s()).map_err(|error: ModelError| {
        unusable(format!("in a sampled loop of {} s {what}: {error}", time.period_s()))
            .mend("Give a delay of whole samples, or all parts in continuous time.")
    })?;
    let sampled = match system {
        System::Discrete(_) => return Ok(system),
        System::Continuous(tf) if tf.den().degree() == 0 && tf.num().degree() == 0 => {
            TransferFunction::new(tf.num().coefficients(), tf.den().coefficients(), time)
                .map_err(|error| unusable(error.to_string()))?
        }
        System::Continuous(tf) if what == "the plant" => zero_order_hold(&tf, time).map_err(|error| {
            unusable(error.to_string()).mend("Give all parts in continuous time, or the plant sampled.")
        })?,
        System::Continuous(_) => {
            let detail = format!("{what} is in continuous time, and the loop is sampled every {} s", time.period_s());
            return Err(unusable(detail).mend("Give both controllers in one time base."));
        }
    };
    let den = [sampled.den().coefficients(), &vec![0.0; samples]].concat();
    let delayed = TransferFunction::new(sampled.num().coefficients(), &den, time);
    delayed.map(System::Discrete).map_err(|error| unusable(error.to_string()))
}

/// Nothing, in continuous time.
fn nothing() -> Result<Delayed, Problem> {
    let zero = TransferFunction::new(&[0.0], &[1.0], Continuous);
    zero.map(|zero| (System::Continuous(zero), 0.0)).map_err(|error| wrong(error.to_string(), "/inputs"))
}

impl Assembly {
    /// Brings everything to one time base and refuses what cannot be simulated.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong, or having been stopped.
    pub(super) fn new(inputs: &SimulateInputs, library: &Library, ctl: &Ctl) -> Result<Self, Failure> {
        let model = plant(inputs, library)?;
        let command = inputs.command.signal().resolve(library, COMMAND, ctl)?;
        let time = Discrete::new(command.sample_time_s)
            .map_err(|error| wrong(error.to_string(), format!("{COMMAND}/sample_time_s")))?;
        if command.values.len() > MOST_SAMPLES {
            let detail =
                format!("the command has {} samples; {MOST_SAMPLES} at most are simulated", command.values.len());
            return Err(Problem::new(Code::Unaffordable, "too many samples", detail)
                .at(COMMAND)
                .mend("Shorten it, or lengthen its sample time.")
                .into());
        }
        let disturbance = match &inputs.disturbance {
            None => Vec::new(),
            Some(disturbance) => {
                let d = disturbance.signal().resolve(library, DISTURBANCE, ctl)?;
                same_grid(d.values.len(), d.sample_time_s, command.values.len(), time)?;
                d.values
            }
        };
        let closed = closed_loop(inputs, &model, time)?;
        let initial = initial(inputs, &model, &closed)?;
        let trial = trial(inputs, library)?;
        let recorded = trial.as_ref().and_then(|trial| recorded(inputs, trial, command.values.len(), time));
        let disturbance_left_out = inputs.disturbance.is_none()
            && trial.is_some_and(|trial| {
                trial.trial().signals.disturbance.as_ref().is_some_and(|d| d.iter().any(|d| *d != 0.0))
            });
        Ok(Self { closed, time, command: command.values, disturbance, initial, recorded, disturbance_left_out })
    }
}

fn same_grid(samples: usize, sample_time_s: f64, expected: usize, time: Discrete) -> Result<(), Problem> {
    if (sample_time_s / time.period_s() - 1.0).abs() > SAME_SAMPLE_TIME {
        let detail =
            format!("the disturbance is sampled every {sample_time_s} s, the command every {} s", time.period_s());
        return Err(wrong(detail, DISTURBANCE).mend("Give both one sample time."));
    }
    if samples != expected {
        let detail = format!("the disturbance has {samples} samples, the command {expected}");
        return Err(wrong(detail, DISTURBANCE).mend("Give both one length."));
    }
    Ok(())
}

/// The loop in one time base; stable.
fn closed_loop(inputs: &SimulateInputs, model: &Model, time: Discrete) -> Result<ClosedLoop, Problem> {
    let part = |model: &Option<Model>, at: &str| match model {
        None => nothing(),
        Some(model) => check_delayed_plant(model, at),
    };
    const FEEDFORWARD: &str = "/inputs/feedforward";
    const FEEDBACK: &str = "/inputs/feedback";
    let parts = [
        (check_delayed_plant(model, PLANT)?, PLANT, "the plant"),
        (part(&inputs.feedforward, FEEDFORWARD)?, FEEDFORWARD, "the feedforward"),
        (part(&inputs.feedback, FEEDBACK)?, FEEDBACK, "the feedback"),
    ];
    let sampled = parts.iter().find_map(|((system, _), at, what)| Some((system.sample_time_s()?, *at, *what)));
    let [plant, feedforward, feedback] = parts;
    let closed = match sampled {
        None => {
            let delays = Delays {
                plant_s: plant.0.1,
                feedforward_s: feedforward.0.1,
                feedback_s: feedback.0.1,
                preview_s: inputs.preview_s,
            };
            ClosedLoop::new(plant.0.0, feedforward.0.0, feedback.0.0, delays)
        }
        Some((own, at, what)) => {
            if (own / time.period_s() - 1.0).abs() > SAME_SAMPLE_TIME {
                let detail = format!("{what} is sampled every {own} s, the command every {} s", time.period_s());
                return Err(Problem::new(Code::Invalid, "different sample times", detail)
                    .at(format!("{at}/sample_time_s"))
                    .mend("Give the command at the loop's sample time, or the loop in continuous time."));
            }
            let own = Discrete::new(own).map_err(|error| wrong(error.to_string(), at))?;
            let samples = inputs.preview_s / own.period_s();
            if (samples - samples.round()).abs() > 1e-6 * samples.max(1.0) {
                let detail = format!("{} s are {samples} samples of {} s", inputs.preview_s, own.period_s());
                return Err(wrong(detail, PREVIEW).mend("In a sampled loop give a preview of whole samples."));
            }
            let plant = in_samples(plant.0, own, plant.1, plant.2)?;
            let feedforward = in_samples(feedforward.0, own, feedforward.1, feedforward.2)?;
            let feedback = in_samples(feedback.0, own, feedback.1, feedback.2)?;
            ClosedLoop::new(plant, feedforward, feedback, Delays { preview_s: inputs.preview_s, ..Delays::default() })
        }
    };
    let closed = closed.map_err(|defect| no_loop(&defect, time))?;
    closed.slowest_pole().map_err(|error| unstable(&error))?;
    Ok(closed)
}

fn no_loop(defect: &LoopDefect, time: Discrete) -> Problem {
    let problem = |title: &str, part: Part| {
        Problem::new(Code::Invalid, title, defect.to_string()).at(format!("/inputs/{}", part.name()))
    };
    match defect {
        LoopDefect::TimeBase { part, .. } => {
            problem("different sample times", *part).mend("Give all parts in one time base.")
        }
        LoopDefect::Improper { part, .. } => problem("improper", *part)
            .mend("Give it more poles, above the frequencies that matter: divide by (s/ω + 1) as often as it takes."),
        LoopDefect::NonCausal { samples } => problem("not causal", Part::Feedforward).mend(format!(
            "Append {samples} zeros to its denominator, and give \"preview_s\": {}: the same feedforward, that looks \
             ahead.",
            *samples as f64 * time.period_s()
        )),
        LoopDefect::Algebraic => {
            problem("algebraic loop", Part::Feedback).mend("Give the feedback a delay or a lag, or another gain.")
        }
        LoopDefect::Neutral => problem("no lag in the loop", Part::Feedback)
            .mend("Give the feedback a lag (one pole more than zeros), as muscles have."),
    }
}

fn unstable(error: &Unstable) -> Problem {
    let place = match error {
        Unstable::Pole { part: Some(part), .. } => format!("/inputs/{}", part.name()),
        _ => "/inputs/feedback".to_owned(),
    };
    Problem::new(Code::Invalid, "unstable loop", error.to_string()).at(place).mend(
        "Its signals would grow without bound. Lower the feedback's gain or delay, or give a feedback that stabilises \
         the plant; a plant that integrates needs one to stay where it is.",
    )
}

/// How the plant moves from its initial state, as the simulation takes it.
fn initial(inputs: &SimulateInputs, model: &Model, closed: &ClosedLoop) -> Result<Vec<f64>, Problem> {
    let Some(given) = &inputs.initial_state else { return Ok(Vec::new()) };
    let poles = closed.plant().den().degree();
    let time = match closed.plant() {
        System::Continuous(_) => None,
        System::Discrete(tf) => Some(tf.time()),
    };
    let short = |states: usize| {
        let detail = format!("there are {} numbers, and the plant has {states} states", given.len());
        Err(wrong(detail, INITIAL).mend("Give one for each state, or of a transfer function as many at most."))
    };
    let overflow = || wrong("the plant's motion from there overflows", INITIAL);
    match model {
        Model::StateSpace(matrices) => {
            if given.len() != matrices.a.len() {
                return short(matrices.a.len());
            }
            let motion = of_state(matrices, given, time, poles).ok_or_else(overflow)?;
            Ok(motion)
        }
        Model::TransferFunction(_) => {
            let (system, _) = check_delayed_plant(model, PLANT)?;
            let own = system.den().degree();
            if given.len() > own {
                return short(own);
            }
            match (&system, time) {
                (System::Continuous(continuous), Some(time)) => {
                    free_motion(continuous, given, time, poles).ok_or_else(overflow)
                }
                _ => Ok(given.clone()),
            }
        }
    }
}

/// `C Aᵏ x₀` for `count` values of k: derivatives in continuous time, samples in sampled time.
fn of_state(matrices: &StateSpaceModel, state: &[f64], time: Option<Discrete>, count: usize) -> Option<Vec<f64>> {
    let plant = matrices.check(Continuous).ok()?;
    let step = match (time, matrices.sample_time_s) {
        (Some(time), None) => crate::control::discretise::zero_order_hold_state_space(&plant, time).ok()?.a().clone(),
        _ => plant.a().clone(),
    };
    let mut x = DVector::from_column_slice(state);
    let motion: Vec<f64> = (0..count)
        .map(|_| {
            let y = (plant.c() * &x)[0];
            x = &step * &x;
            y
        })
        .collect();
    motion.iter().all(|y| y.is_finite()).then_some(motion)
}

/// Control and output that were recorded under the command, where that is the command of a trial.
fn recorded(inputs: &SimulateInputs, trial: &ResolvedTrial, samples: usize, time: Discrete) -> Option<[Vec<f64>; 2]> {
    let SignalInput::Trial(signal) = inputs.command.signal() else { return None };
    if signal.channel != Column::R {
        return None;
    }
    let start = (signal.excerpt.start_s.unwrap_or(0.0) / time.period_s()).round() as usize;
    let signals = &trial.trial().signals;
    let part = |x: &[f64]| x.get(start..start + samples).map(<[f64]>::to_vec);
    Some([part(&signals.control)?, part(&signals.output)?])
}
