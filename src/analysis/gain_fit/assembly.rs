//! The loop of plant and person that trials are fitted with.

use super::known_plant::{KnownPlant, PlantSource};
use super::signals::Signals;
use super::spec::{DisturbanceKnowledge, GainFitSpec, GainFitWanted, InitialState, PerceivedNoise};
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::{wrong_inputs as wrong_input, wrong_spec};
use crate::control::{Continuous, Discrete, StateSpace, discretise};
use crate::likelihood::{Experiment, ExperimentError, Innovation, LoopModel, Predicted, Record, Settings};
use crate::person::state_feedback::{PlantModel, StateFeedback, Timing};
use nalgebra::{DMatrix, DVector};

/// Parameters of a fit at most.
const MAX_PARAMETERS: usize = 120;

/// A plant with the model of the loop that it makes.
pub(super) struct Loop {
    pub plant: KnownPlant,
    pub model: Box<dyn LoopModel>,
    /// n, m, q, p.
    pub sizes: [usize; 4],
    /// The time base of K; sampled where the filter is estimated too.
    pub sample_time_s: Option<f64>,
    pub time: Discrete,
    pub is_continuous: bool,
    /// Where K and L are estimated: what their filter predicts.
    pub filter: Option<Filter>,
}

/// How K and L are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Filter {
    pub predicted: Predicted,
    /// Whether the person knows the plant's input; false also where the plant has none.
    pub is_told: bool,
}

impl Filter {
    /// Whether other gains make the same controller and nothing recorded tells them apart: K and L are seen through it
    /// alone.
    pub(super) fn is_ambiguous(&self) -> bool {
        self.predicted == Predicted::Control && !self.is_told
    }
}

impl Loop {
    /// The loop of plant and person for these signals; `place` gives the pointer of a trial.
    ///
    /// # Errors
    /// A [`Problem`] with the pointer of what does not fit the others.
    pub(super) fn new(
        source: &PlantSource,
        spec: &GainFitSpec,
        signals: &[Signals],
        place: &dyn Fn(usize) -> String,
    ) -> Result<Self, Problem> {
        let plant = source.check(spec.free.as_deref())?;
        let [n, m, q, p] = plant.sizes();
        let period = signals.first().map_or(f64::NAN, |s| s.sample_time_s);
        if let Some(i) = signals.iter().position(|s| s.sample_time_s != period) {
            let detail =
                format!("the sample time is {} s, and {period} s in the first trial", signals[i].sample_time_s);
            return Err(wrong_input(detail, format!("{}/sample_time_s", place(i))));
        }
        let time = Discrete::new(period)
            .map_err(|error| wrong_input(error.to_string(), format!("{}/sample_time_s", place(0))))?;
        if let Some(own) = source.sample_time_s().filter(|own| (own / period - 1.0).abs() > 1e-9) {
            return Err(wrong_input(
                format!("the plant is sampled every {own} s and the trials every {period} s"),
                "/inputs/plant/sample_time_s",
            ));
        }
        let is_continuous = source.sample_time_s().is_none();
        let both = spec.estimate == GainFitWanted::GainAndFilter;
        let has_control = signals.iter().all(|s| s.control.is_some());
        if let Some(i) = signals.iter().position(|s| s.control.is_some() != has_control) {
            return Err(wrong_input("some trials have a control and others none", format!("{}/control", place(i))));
        }
        let columns = |i: usize, name: &str, found: usize, expected: usize| {
            if found == expected {
                return Ok(());
            }
            Err(wrong_input(
                format!(
                    "the {name} has {found} columns and must have {expected} ({n} states, {m} controls, {q} inputs, \
                     {p} outputs of the plant)"
                ),
                format!("{}/{name}", place(i)),
            ))
        };
        for (i, s) in signals.iter().enumerate() {
            columns(i, "input", s.input.ncols(), q)?;
            columns(i, "output", s.output.ncols(), p)?;
            if both && let Some(control) = &s.control {
                columns(i, "control", control.ncols(), m)?;
            }
            if let Some(state) = s.initial_state.as_ref().filter(|state| state.len() != n) {
                let detail = format!("the initial state has {} entries and the plant {n} states", state.len());
                return Err(wrong_input(detail, format!("{}/initial_state", place(i))));
            }
        }
        let timing = |seconds: Option<f64>, usual: f64| seconds.map_or(Timing::Free(usual), Timing::Known);
        let delay = spec.delay.as_ref().map(|d| (d.order, timing(d.seconds, 0.05)));
        let lag = spec.muscle_lag.as_ref().map(|l| timing(l.seconds, 0.1));
        let filter = if both { Some(filter(&plant, spec, has_control)?) } else { None };
        let model: Box<dyn LoopModel> = if let Some(Filter { predicted, is_told }) = filter {
            Box::new(Innovation { plant: plant.clone(), continuous: is_continuous, predicted, is_told })
        } else if is_continuous {
            Box::new(StateFeedback { plant: plant.clone(), time: Continuous, delay, lag })
        } else {
            for (name, is_given) in [("delay", delay.is_some()), ("muscle_lag", lag.is_some())] {
                if is_given {
                    return Err(wrong_spec(
                        "a sampled plant takes no delay or lag in continuous time",
                        format!("/spec/{name}"),
                    )
                    .mend("Give the plant in continuous time, or put the delay into its states."));
                }
            }
            Box::new(StateFeedback { plant: plant.clone(), time, delay: None, lag: None })
        };
        let names = model.names();
        if names.len() > MAX_PARAMETERS {
            return Err(wrong_spec(
                format!("there are {} parameters; at most {MAX_PARAMETERS} are fitted", names.len()),
                "/inputs/plant",
            ));
        }
        if let Some(i) = (0..names.len()).find(|i| names[..*i].contains(&names[*i])) {
            return Err(wrong_input(
                format!("the name {:?} is that of a gain, or taken already", names[i]),
                "/inputs/plant/parameters",
            )
            .mend("Rename the parameter."));
        }
        let sample_time_s = if both || !is_continuous { Some(period) } else { None };
        Ok(Self { plant, model, sizes: [n, m, q, p], sample_time_s, time, is_continuous, filter })
    }

    /// How it is fitted.
    ///
    /// # Errors
    /// A [`Problem`] of the spec: bounds, start, noise, or the structure of the weights.
    pub(super) fn settings(&self, spec: &GainFitSpec) -> Result<Settings, Problem> {
        let names = self.model.names();
        let bounds = spec.bounds(&names, &self.model.limits())?;
        let start = spec.start(&names, &bounds)?;
        let (_, outputs) = self.model.ports();
        if let Some(optimality) = &spec.optimality {
            let [n, m, ..] = self.sizes;
            optimality.structure(n, m)?;
        }
        Ok(Settings {
            noise: spec.noise(outputs)?,
            bounds,
            start,
            draws: spec.draws,
            climbs: spec.climbs,
            seed: spec.seed,
        })
    }

    /// The trials of the fit.
    ///
    /// # Errors
    /// A [`Problem`] with the pointer of a trial that does not fit, or of all where they say too little or too much.
    pub(super) fn experiment(
        &self,
        spec: &GainFitSpec,
        signals: &[Signals],
        place: &dyn Fn(usize) -> String,
    ) -> Result<Experiment<'_>, Problem> {
        let wanted = initial_state(spec, signals, place)?;
        let predicted = self.filter.map(|filter| filter.predicted);
        let records = signals
            .iter()
            .map(|s| {
                let control = s.control.as_ref().filter(|_| predicted.is_some());
                let beside = |first: &DMatrix<f64>, others: &[Option<&DMatrix<f64>>]| {
                    others.iter().flatten().fold(first.clone(), |all, next| {
                        let columns: Vec<_> =
                            all.column_iter().chain(next.column_iter()).map(|c| c.into_owned()).collect();
                        DMatrix::from_columns(&columns)
                    })
                };
                let stimulus = match predicted {
                    Some(_) => beside(&s.input, &[Some(&s.output), control]),
                    None => s.input.clone(),
                };
                let target = match (predicted, control) {
                    (Some(Predicted::Control), Some(control)) => control.clone(),
                    _ => beside(&s.output, &[control]),
                };
                let initial = s.initial_state.as_ref().filter(|_| wanted == InitialState::Given);
                Record {
                    stimulus,
                    target,
                    initial: initial.map(|state| {
                        // The states of delay and lag start at rest.
                        let total = state.len() + self.path_states(spec);
                        DVector::from_fn(total, |i, _| state.get(i).copied().unwrap_or(0.0))
                    }),
                }
            })
            .collect();
        Experiment::new(self.model.as_ref(), self.time, records, wanted == InitialState::Estimated)
            .map_err(|error| unusable_trials(&error, place))
    }

    /// States of delays and lags.
    fn path_states(&self, spec: &GainFitSpec) -> usize {
        let each = spec.delay.as_ref().map_or(0, |d| d.order) + usize::from(spec.muscle_lag.is_some());
        self.sizes[1] * each
    }

    /// Whether K and L are estimated.
    pub(super) fn both(&self) -> bool {
        self.filter.is_some()
    }

    /// A, B and K at θ, in the time base of K; `None` where the plant is not defined.
    pub(super) fn at(&self, theta: &[f64]) -> Option<(DMatrix<f64>, DMatrix<f64>, DMatrix<f64>)> {
        let [n, m, _, p] = self.sizes;
        let first = m * n + if self.both() { n * p } else { 0 };
        let of_plant = theta.get(first..first + self.plant.names().len())?;
        let within = of_plant.iter().zip(self.plant.limits()).all(|(v, [low, high])| (low..=high).contains(v));
        if !within {
            return None;
        }
        let plant = self.plant.plant::<f64>(of_plant);
        let k = DMatrix::from_row_slice(m, n, &theta[..m * n]);
        if !(self.both() && self.is_continuous) {
            return Some((plant.a, plant.b, k));
        }
        // K belongs to the samples.
        let (c, d) = (DMatrix::identity(n, n), DMatrix::zeros(n, m));
        let model = StateSpace::new(plant.a, plant.b, c, d, Continuous).ok()?;
        let sampled = discretise::zero_order_hold_state_space(&model, self.time).ok()?;
        Some((sampled.a().clone(), sampled.b().clone(), k))
    }
}

/// What K and L are found from.
///
/// # Errors
/// A [`Problem`] where the signals cannot tell them under what the spec assumes.
fn filter(plant: &KnownPlant, spec: &GainFitSpec, has_control: bool) -> Result<Filter, Problem> {
    let nominal = plant.plant::<f64>(&plant.nominal());
    let has_input = nominal.e.iter().chain(nominal.f.iter()).any(|v| *v != 0.0);
    let is_told = spec.disturbance == DisturbanceKnowledge::KnownToPerson && has_input;
    let suits = spec.perceived_noise == PerceivedNoise::True;
    let refused =
        |detail: &str, mend: &str| Err(wrong_spec(detail.to_owned(), "/spec/perceived_noise").mend(mend.to_owned()));
    if !suits && !has_control {
        return refused(
            "outputs alone do not tell the gain from the filter of a person whose noise is not known: several pairs \
             explain them equally well, with gains that differ by factors",
            "Record the control. Or assume that the person's filter suits the true noise and knows the input: \
             {\"perceived_noise\": \"true\", \"disturbance\": \"known_to_person\"}.",
        );
    }
    if suits && has_input && !is_told {
        return refused(
            "the innovations of a person who does not know the plant's input are not white, whatever noise the filter \
             is made for",
            "Record the control and take {\"perceived_noise\": \"free\"}, or say that the person knows the input: \
             {\"disturbance\": \"known_to_person\"}.",
        );
    }
    let predicted = match (suits, has_control) {
        (false, _) => Predicted::Control,
        (true, true) => Predicted::OutputAndControl,
        (true, false) => Predicted::Output,
    };
    if predicted == Predicted::Control && !plant.names().is_empty() {
        return Err(wrong_spec(
            format!(
                "from the control alone {} would be what the person takes the plant for, and not the plant's own",
                plant.names().join(", ")
            ),
            "/spec/free",
        )
        .mend("Hold the plant: {\"free\": []}. Fit its parameters apart, from the outputs and the control."));
    }
    Ok(Filter { predicted, is_told })
}

/// What the trials start from.
fn initial_state(
    spec: &GainFitSpec,
    signals: &[Signals],
    place: &dyn Fn(usize) -> String,
) -> Result<InitialState, Problem> {
    let given = signals.iter().all(|s| s.initial_state.is_some());
    let wanted = spec.initial_state.unwrap_or(if given { InitialState::Given } else { InitialState::Estimated });
    if wanted == InitialState::Given && !given {
        let i = signals.iter().position(|s| s.initial_state.is_none()).unwrap_or(0);
        return Err(wrong_input("the trial has no initial state", format!("{}/initial_state", place(i)))
            .mend("Give one for every trial, or estimate them: {\"initial_state\": \"estimated\"}."));
    }
    Ok(wanted)
}

/// Trials that do not fit the model.
fn unusable_trials(error: &ExperimentError, place: &dyn Fn(usize) -> String) -> Problem {
    let new = |code, location: String| Problem::new(code, "unusable trials", error.to_string()).at(location);
    match error {
        ExperimentError::Empty | ExperimentError::Silent => new(Code::Invalid, "/inputs/trials".to_owned()),
        ExperimentError::TooLong { .. } => new(Code::Unaffordable, "/inputs/trials".to_owned()),
        ExperimentError::TooShort { .. } => new(Code::Invalid, "/inputs/trials".to_owned())
            .mend("Record longer trials or more of them, or fit fewer parameters."),
        ExperimentError::Size { trial, signal, .. } => {
            let part = match *signal {
                "stimulus" => "input",
                "target" => "output",
                _ => "initial_state",
            };
            new(Code::Invalid, format!("{}/{part}", place(*trial)))
        }
    }
}
