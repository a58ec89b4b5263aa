//! From the request to the design and the records of the fit.

use super::inputs::LqgFitInputs;
use super::refused::check;
use super::signals::{Sampled, Signals};
use super::spec::{LqgFitBelief, LqgFitControl, LqgFitDisturbance, LqgFitFirstGain, LqgFitInitialState, LqgFitSpec};
use super::target::{Conditioned, conditioned};
use super::terms::{Terms, semidefinite};
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::{wrong_inputs, wrong_spec as wrong};
use crate::control::Discrete;
use crate::likelihood::lqg::{
    Design, FilterStart, Horizon, Plant, Problem as Trials, Record, RecordError, Recorded, Start, Term, Timing,
};
use crate::num::linalg;
use nalgebra::{DMatrix, DVector};

/// States at most, with the line that what is sensed goes through where it is delayed.
const MAX_STATES: usize = 40;
/// A delay is a whole number of samples up to this share of one.
const WHOLE: f64 = 1e-6;
/// Controls of a horizon at most where noise grows with them: all gains are found together.
const MAX_COUPLED: usize = 500;

/// The design of a fit with its records.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Assembled {
    pub design: Design,
    pub records: Vec<Record>,
    pub time: Discrete,
    /// What the recorded control was taken for.
    pub control: LqgFitControl,
    /// States that costs and beliefs are about, without the line that what is sensed goes through.
    pub states: usize,
}

impl Assembled {
    /// Design and records of a request with these signals; `place` gives the pointer of a trial.
    ///
    /// # Errors
    /// A [`Problem`] with the pointer of what is wrong, or of what these records cannot tell.
    pub(super) fn new(
        inputs: &LqgFitInputs,
        spec: &LqgFitSpec,
        signals: &[Signals],
        place: &dyn Fn(usize) -> String,
    ) -> Result<Self, Problem> {
        let period = signals.first().map_or(f64::NAN, |s| s.sample_time_s);
        if let Some(i) = signals.iter().position(|s| s.sample_time_s != period) {
            let detail =
                format!("the sample time is {} s, and {period} s in the first trial", signals[i].sample_time_s);
            return Err(wrong_inputs(detail, format!("{}/sample_time_s", place(i))));
        }
        let at_period = format!("{}/sample_time_s", place(0));
        let written = Sampled::new(&inputs.plant, "plant", period, &at_period)?;
        let internal = inputs
            .internal_model
            .as_ref()
            .map(|model| Sampled::new(model, "internal_model", period, &at_period))
            .transpose()?;
        if let Some(model) = &internal {
            fits(model, &written)?;
        }
        let control = used_control(spec, signals, place)?;
        let terms = Terms::new(spec, &written, internal.as_ref().unwrap_or(&written))?;
        let believed = internal.map(|model| model.plant);
        let Conditioned { sampled, internal, terms: all } = match &spec.target {
            None => Conditioned { internal: believed, terms: terms.terms.clone(), sampled: written.clone() },
            Some(target) => conditioned(target.state, &written, believed, &terms.terms)?,
        };
        let horizon = horizon(spec, signals, place)?;
        let undelayed = design(&sampled, internal, &terms, all, spec, control, horizon)?;
        check(&undelayed, spec)?;
        let [n, m, p, q] = undelayed.sizes();
        let states = undelayed.internal().a.nrows();
        let delay = delay(spec, period)?;
        if n.max(states) + delay * p > MAX_STATES {
            let detail = format!(
                "a delay of {delay} samples of {p} outputs with {n} states makes more than {MAX_STATES} states together"
            );
            return Err(Problem::new(Code::Unaffordable, "too many states", detail)
                .at("/spec/sensory_delay_s")
                .mend("Resample the trials more coarsely."));
        }
        let outputs = undelayed.outputs();
        let mut records = Vec::new();
        for (i, s) in signals.iter().enumerate() {
            let samples = s.output.nrows();
            let disturbance = s.disturbance.clone().unwrap_or_else(|| DMatrix::zeros(samples, q));
            let used = s.control.as_ref().filter(|_| control != LqgFitControl::NotUsed);
            for (name, found, expected) in
                [("disturbance", Some(&disturbance), q), ("output", Some(&s.output), outputs), ("control", used, m)]
            {
                if let Some(found) = found.filter(|found| found.ncols() != expected) {
                    let detail = format!(
                        "the {name} has {} columns and must have {expected} ({n} states, {m} controls, {outputs} \
                         recorded outputs, {q} disturbances of the plant)",
                        found.ncols()
                    );
                    return Err(wrong_inputs(detail, format!("{}/{name}", place(i))));
                }
            }
            let mut measured = DMatrix::zeros(samples, undelayed.channels());
            measured.columns_mut(0, outputs).copy_from(&s.output);
            if let Some(used) = used {
                measured.columns_mut(outputs, m).copy_from(used);
            }
            let mut record = Record { disturbance, measured, initial: None };
            record.initial = initial(&undelayed, spec, s, &record, &place(i))?
                .map(|state| starts(&undelayed, spec, &state, &record, delay * p));
            records.push(record);
        }
        let design = undelayed.delayed(delay);
        let numbers = records.iter().map(|r| r.measured.len()).sum::<usize>();
        let unknowns = design.free().count();
        if numbers <= 2 * unknowns {
            let detail = format!("{numbers} numbers were measured in all; {unknowns} unknowns need more");
            return Err(wrong_inputs(detail, "/inputs").mend("Record longer trials or more of them."));
        }
        Trials::new(&design, &records).map_err(|error| unusable(&error, place))?;
        Ok(Self { design, records, time: sampled.time, control, states })
    }
}

/// Whether a person's model fits the plant.
fn fits(model: &Sampled, plant: &Sampled) -> Result<(), Problem> {
    let sizes = |s: &Sampled| [s.plant.b.ncols(), s.plant.c.nrows(), s.plant.e.ncols()];
    let (found, expected) = (sizes(model), sizes(plant));
    for ((letter, port), (found, expected)) in
        [("b", "controls"), ("c", "sensed outputs"), ("e", "disturbances")].iter().zip(found.iter().zip(&expected))
    {
        if found != expected {
            let detail = format!("the person's model has {found} {port}, and the plant {expected}");
            return Err(wrong_inputs(detail, format!("/inputs/internal_model/{letter}")));
        }
    }
    let (own, n) = (model.plant.a.nrows(), plant.plant.a.nrows());
    if own < n {
        let detail = format!("the person's model has {own} states, and the plant {n}, which must be its first ones");
        return Err(wrong_inputs(detail, "/inputs/internal_model/a"));
    }
    Ok(())
}

/// The delay in samples.
fn delay(spec: &LqgFitSpec, period: f64) -> Result<usize, Problem> {
    let samples = spec.sensory_delay_s / period;
    let whole = samples.round();
    if (samples - whole).abs() > WHOLE {
        let detail = format!(
            "the delay of {} s is {samples:.3} samples of {period} s, and no whole number",
            spec.sensory_delay_s
        );
        return Err(wrong(detail, "/spec/sensory_delay_s")
            .mend(format!("Take {} s, or resample the trials.", whole.max(0.0) * period)));
    }
    if whole > MAX_STATES as f64 {
        let detail = format!("the delay has {whole} samples; {MAX_STATES} states with it are taken");
        return Err(Problem::new(Code::Unaffordable, "too many states", detail).at("/spec/sensory_delay_s"));
    }
    Ok(whole as usize)
}

/// The end that all trials share.
fn horizon(
    spec: &LqgFitSpec,
    signals: &[Signals],
    place: &dyn Fn(usize) -> String,
) -> Result<Option<Horizon>, Problem> {
    let Some(written) = &spec.horizon else { return Ok(None) };
    let samples = signals.first().map_or(0, |s| s.output.nrows());
    if let Some(i) = signals.iter().position(|s| s.output.nrows() != samples) {
        let detail = format!(
            "the trial has {} samples and the first one {samples}: trials of unequal length have no common gains under \
             a horizon that ends",
            signals[i].output.nrows()
        );
        return Err(wrong_inputs(detail, format!("{}/output", place(i)))
            .mend("Fit trials of one length together, or leave the horizon out."));
    }
    if spec.control_dependent_noise.is_some() && samples > MAX_COUPLED {
        let detail = format!("{samples} samples under noise of the control; {MAX_COUPLED} at most are taken");
        return Err(Problem::new(Code::Unaffordable, "horizon too long", detail).at("/spec/horizon"));
    }
    let filter = match (&written.initial_covariance, written.first_gain) {
        (None, _) => FilterStart::Settled,
        (Some(_), LqgFitFirstGain::Own) => FilterStart::BeforeFirst,
        (Some(_), LqgFitFirstGain::OfSecond) => FilterStart::BeforeSecond,
    };
    if spec.control_dependent_noise.is_some() && filter != FilterStart::BeforeFirst {
        return Err(wrong(
            "gains under noise of the control follow from the person's covariance before the first sample",
            "/spec/horizon/initial_covariance",
        )
        .mend("Give it, an empty list where the person knows the first state, and {\"first_gain\": \"own\"}."));
    }
    Ok(Some(Horizon { steps: samples.saturating_sub(1).max(1), filter }))
}

/// The state at the first sample, where the spec says that it is known and not zero.
fn initial(
    design: &Design,
    spec: &LqgFitSpec,
    signals: &Signals,
    record: &Record,
    at: &str,
) -> Result<Option<DVector<f64>>, Problem> {
    let [n, ..] = design.sizes();
    let given = signals.initial_state.as_ref();
    match (spec.initial_state, given) {
        (LqgFitInitialState::Rest | LqgFitInitialState::Settled | LqgFitInitialState::FirstSample, Some(_)) => Err(
            wrong_inputs("the trial has an initial state, and the spec does not use it", format!("{at}/initial_state"))
                .mend("Ask for it: {\"initial_state\": \"given\"}."),
        ),
        (LqgFitInitialState::Rest | LqgFitInitialState::Settled, None) => Ok(None),
        (LqgFitInitialState::Given, None) => {
            Err(wrong_inputs("the trial has no initial state", format!("{at}/initial_state")))
        }
        (LqgFitInitialState::Given, Some(values)) => {
            if values.len() != n || values.iter().any(|v| !v.is_finite()) {
                let detail = format!("the initial state has {} entries and must have {n} numbers", values.len());
                return Err(wrong_inputs(detail, format!("{at}/initial_state")));
            }
            Ok(Some(DVector::from_column_slice(values)))
        }
        (LqgFitInitialState::FirstSample, None) => {
            let [rows, through] = design.recorded_rows();
            let outputs = record.measured.view((0, 0), (1, rows.nrows())).transpose();
            let shown = outputs - through * record.disturbance.row(0).transpose();
            let solved = linalg::least_squares(rows, &DVector::from_column_slice(shown.as_slice()));
            solved.map(|(state, _)| Some(state)).ok_or_else(|| {
                wrong("the recorded outputs do not determine all states at the first sample", "/spec/initial_state")
                    .mend("Give the initial states, or let the trials start at rest.")
            })
        }
    }
}

/// State and belief of a start, with the line that what is sensed goes through, which has been at it for long.
fn starts(design: &Design, spec: &LqgFitSpec, state: &DVector<f64>, record: &Record, line: usize) -> [DVector<f64>; 2] {
    let own = design.internal();
    let d = record.disturbance.row(0).transpose();
    let mut belief = DVector::zeros(own.a.nrows());
    match spec.target {
        // The person's model has the target among its states.
        Some(target) => {
            let mut rest = state.iter();
            let shared = state.len() + 1;
            for (i, entry) in belief.iter_mut().take(shared).enumerate() {
                *entry = if i == target.state { d[0] } else { rest.next().copied().unwrap_or(0.0) };
            }
        }
        None => belief.rows_mut(0, state.len()).copy_from(state),
    }
    let behind = |x: &DVector<f64>, sensed: DVector<f64>| {
        let times = if sensed.is_empty() { 0 } else { line / sensed.len() };
        DVector::from_iterator(
            x.len() + line,
            x.iter().copied().chain(std::iter::repeat_n(sensed.as_slice(), times).flatten().copied()),
        )
    };
    let told = f64::from(u8::from(design.is_told));
    let sensed = &design.plant.c * state + &design.plant.d * &d;
    let expected = &own.c * &belief + &own.d * &d * told;
    [behind(state, sensed), behind(&belief, expected)]
}

/// Trials that do not fit the design.
fn unusable(error: &RecordError, place: &dyn Fn(usize) -> String) -> Problem {
    let detail = error.to_string();
    match error {
        RecordError::Empty => wrong_inputs(detail, "/inputs"),
        RecordError::TooLong { .. } | RecordError::TooLarge { .. } => {
            Problem::new(Code::Unaffordable, "too many samples", detail).at("/inputs")
        }
        RecordError::Size { trial, .. } | RecordError::Horizon { trial, .. } | RecordError::Initial { trial, .. } => {
            wrong_inputs(detail, place(*trial))
        }
        RecordError::NotAtRest { trial } => wrong_inputs(detail, format!("{}/control", place(*trial)))
            .mend("Let the trials start anywhere: {\"initial_state\": \"settled\"}."),
    }
}

/// What the recorded control is taken for.
fn used_control(
    spec: &LqgFitSpec,
    signals: &[Signals],
    place: &dyn Fn(usize) -> String,
) -> Result<LqgFitControl, Problem> {
    let without = signals.iter().position(|s| s.control.is_none());
    match (spec.control, without) {
        (Some(LqgFitControl::NotUsed), _) | (None, Some(_)) => {
            if spec.control_variance.is_some() {
                return Err(wrong("no control is used that a variance could belong to", "/spec/control_variance"));
            }
            Ok(LqgFitControl::NotUsed)
        }
        (Some(_), Some(i)) => Err(wrong_inputs("the trial has no control", format!("{}/control", place(i)))
            .mend("Leave the control out of the fit: {\"control\": \"not_used\"}.")),
        (Some(used), None) => Ok(used),
        (None, None) => Ok(LqgFitControl::Commanded),
    }
}

#[allow(clippy::too_many_arguments)]
fn design(
    sampled: &Sampled,
    internal: Option<Plant>,
    scales: &Terms,
    terms: Vec<Term>,
    spec: &LqgFitSpec,
    control: LqgFitControl,
    horizon: Option<Horizon>,
) -> Result<Design, Problem> {
    let plant = sampled.plant.clone();
    let m = plant.b.ncols();
    let outputs = sampled.recorded.as_ref().map_or(plant.c.nrows(), DMatrix::nrows);
    let instrument = spec
        .instrument_variance
        .as_ref()
        .map(|rows| semidefinite(rows, "the covariance of the instrument", outputs, "/spec/instrument_variance"))
        .transpose()?;
    let recorder = spec
        .control_variance
        .as_ref()
        .map(|rows| semidefinite(rows, "the covariance of the control's recorder", m, "/spec/control_variance"))
        .transpose()?
        .unwrap_or_else(|| DMatrix::zeros(m, m));
    let rows = sampled.recorded.clone().map(|c| {
        let through = DMatrix::zeros(c.nrows(), plant.e.ncols());
        [c, through]
    });
    Ok(Design {
        recorded: Recorded {
            rows,
            instrument,
            control: (control != LqgFitControl::NotUsed).then_some(recorder),
            is_applied: control == LqgFitControl::Applied,
        },
        plant,
        internal,
        terms,
        control_weight: scales.control_weight.clone(),
        perceived_measurement_noise: scales.perceived_measurement_noise.clone(),
        is_told: spec.disturbance == LqgFitDisturbance::KnownToPerson,
        timing: match spec.belief {
            LqgFitBelief::Predicted => Timing::Predictor,
            LqgFitBelief::Filtered => Timing::Filter,
        },
        start: match spec.initial_state {
            LqgFitInitialState::Settled => Start::Settled,
            _ => Start::Rest,
        },
        horizon,
        on_the_way: None,
    })
}
