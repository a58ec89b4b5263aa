//! Gains from trials: kind `gain_fit`.
//!
//! ```json
//! {"kind": "gain_fit",
//!  "inputs": {"plant": {"name": "seated_balance", "values": {"m1": 60}},
//!             "trials": [{"sample_time_s": 0.1, "input": [6, 6, -6], "output": [[0, 0], [0.01, 0.002], [0.02, 0.003]]}]},
//!  "spec": {"delay": {"seconds": 0.0252}, "muscle_lag": {}, "free": ["k_h"], "bounds": {"k_h": [1, 100]}}}
//! {"kind": "gain_fit",
//!  "inputs": {"plant": {"a": [[0, 1], [4, 0]], "b": [[0], [1]]}, "trials": [{"sample_time_s": 0.02, "input": [1], "output": [[0, 0]]}]}}
//! ```
//! The method is that of [`gain_fit`](crate::likelihood); what was found is then put the question of
//! [`inverse`](crate::inverse), with its uncertainty ([`optimality`]).

mod findings;
mod inputs;
pub mod optimality;
mod plant;
mod problems;
mod result;
mod spec;
#[cfg(test)]
mod tests;
mod trajectory;

use super::inputs::{Library, References};
use super::inverse::rows;
use super::kind::{Kind, Request};
use super::plan::Failure;
use super::problem::Problem;
use super::report::{Report, Warning};
use crate::control::lyapunov::Clock;
use crate::control::{Continuous, Discrete};
use crate::ctl::Ctl;
use crate::likelihood::uncertainty::Uncertainty;
use crate::likelihood::{Estimate, Experiment, Innovation, LoopModel, Record, Settings, fit, residuals};
use crate::num::linalg;
use crate::person::state_feedback::{PlantModel, StateFeedback, Timing};
use inputs::Signals;
pub use inputs::{GainFitInputs, GainFitTrial};
use nalgebra::{DMatrix, DVector};
pub use optimality::{NearestOptimal, OptimalityResult, WeightInterval};
use plant::{KnownPlant, WrittenPlant};
pub use plant::{MatrixPlant, NamedPlant, PlantParameter};
use problems::{wrong_input, wrong_spec};
pub use result::{
    FitConvergenceResult, FittedOutputResult, FittedParameterResult, GainFitResult, GainIdentifiabilityResult,
    InverseInputsResult, InverseLqgInputsResult,
};
use serde_json::json;
pub use spec::{
    GainFitSpec, GainFitWanted, InitialState, NoiseName, NoiseSpec, OptimalitySpec, PersonDelaySpec, PersonLagSpec,
};

/// Version of [`GainFitResult`].
const RESULT_VERSION: u32 = 1;
/// A remaining step below this, in standard errors, is none.
const ARRIVED: f64 = 0.01;
/// A gradient below this has arrived where there are no standard errors.
const FLAT: f64 = 1e-6;
/// A condition number of the information above this deserves a warning.
const NEARLY_SINGULAR: f64 = 1e6;
/// Whiteness is doubted below this probability.
const DOUBTFUL: f64 = 1e-3;
/// Components of a combination below this are left out of its words.
const WORTH_SAYING: f64 = 0.1;
/// Parameters of a fit at most.
const MAX_PARAMETERS: usize = 120;

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    inputs: Box<GainFitInputs>,
    spec: Box<GainFitSpec>,
}

/// A plant with the model of the loop that it makes.
struct Loop {
    plant: KnownPlant,
    model: Box<dyn LoopModel>,
    /// n, m, q, p.
    sizes: [usize; 4],
    /// The time base of K; sampled where the filter is estimated too.
    sample_time_s: Option<f64>,
    time: Discrete,
    is_continuous: bool,
}

impl Plan {
    /// Checks a request.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(request: &Request) -> Result<Self, Problem> {
        let inputs = GainFitInputs::parse(&request.inputs)?;
        let spec = GainFitSpec::parse(&request.spec)?;
        let plan = Self { inputs: Box::new(inputs), spec: Box::new(spec) };
        if let (Some(plant), Some(signals)) = (plan.inputs.plant(), plan.inputs.signals()) {
            let assembled = plan.assemble(plant, signals)?;
            plan.settings(&assembled)?;
            plan.experiment(&assembled, signals)?;
        } else if let Some(plant) = plan.inputs.plant() {
            plant.check(plan.spec.free.as_deref())?;
        }
        Ok(plan)
    }

    /// The stored things that it needs.
    #[must_use]
    pub fn references(&self) -> References {
        self.inputs.references()
    }

    /// The request with its defaults filled in; parsing it again gives an equal plan.
    #[must_use]
    pub fn request(&self) -> Request {
        Request { kind: Kind::GainFit.name().to_owned(), inputs: self.inputs.to_value(), spec: json!(self.spec) }
    }

    /// The model that plant, spec and signals make.
    fn assemble(&self, written: &WrittenPlant, signals: &[Signals]) -> Result<Loop, Problem> {
        let spec = &self.spec;
        let plant = written.check(spec.free.as_deref())?;
        let [n, m, q, p] = plant.sizes();
        let period = signals.first().map_or(f64::NAN, |s| s.sample_time_s);
        if let Some(i) = signals.iter().position(|s| s.sample_time_s != period) {
            let detail =
                format!("the sample time is {} s, and {period} s in the first trial", signals[i].sample_time_s);
            return Err(wrong_input(detail, format!("{}/sample_time_s", self.inputs.place(i))));
        }
        let time = Discrete::new(period)
            .map_err(|error| wrong_input(error.to_string(), format!("{}/sample_time_s", self.inputs.place(0))))?;
        if let Some(own) = written.sample_time_s().filter(|own| (own / period - 1.0).abs() > 1e-9) {
            return Err(wrong_input(
                format!("the plant is sampled every {own} s and the trials every {period} s"),
                "/inputs/plant/sample_time_s",
            ));
        }
        let is_continuous = written.sample_time_s().is_none();
        let both = spec.estimate == GainFitWanted::GainAndFilter;
        let has_control = signals.iter().all(|s| s.control.is_some());
        if let Some(i) = signals.iter().position(|s| s.control.is_some() != has_control) {
            return Err(wrong_input(
                "some trials have a control and others none",
                format!("{}/control", self.inputs.place(i)),
            ));
        }
        let columns = |i: usize, name: &str, found: usize, expected: usize| {
            if found == expected {
                return Ok(());
            }
            Err(wrong_input(
                format!(
                    "the {name} has {found} columns and must have {expected} ({n} states, {m} controls, {q} inputs, {p} outputs of the plant)"
                ),
                format!("{}/{name}", self.inputs.place(i)),
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
                return Err(wrong_input(detail, format!("{}/initial_state", self.inputs.place(i))));
            }
        }
        let timing = |seconds: Option<f64>, usual: f64| seconds.map_or(Timing::Free(usual), Timing::Known);
        let delay = spec.delay.as_ref().map(|d| (d.order, timing(d.seconds, 0.05)));
        let lag = spec.muscle_lag.as_ref().map(|l| timing(l.seconds, 0.1));
        let model: Box<dyn LoopModel> = if both {
            Box::new(Innovation { plant: plant.clone(), continuous: is_continuous, control: has_control })
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
        Ok(Loop { plant, model, sizes: [n, m, q, p], sample_time_s, time, is_continuous })
    }

    fn settings(&self, assembled: &Loop) -> Result<Settings, Problem> {
        let names = assembled.model.names();
        let bounds = self.spec.bounds(&names, &assembled.model.limits())?;
        let start = self.spec.start(&names, &bounds)?;
        let (_, outputs) = assembled.model.ports();
        if let Some(optimality) = &self.spec.optimality {
            let [n, m, ..] = assembled.sizes;
            super::inverse::structure(&optimality.inverse(), n, m, "/spec/optimality")?;
        }
        Ok(Settings {
            noise: self.spec.noise(outputs)?,
            bounds,
            start,
            draws: self.spec.draws,
            climbs: self.spec.climbs,
            seed: self.spec.seed,
        })
    }

    fn initial_state(&self, signals: &[Signals]) -> Result<InitialState, Problem> {
        let given = signals.iter().all(|s| s.initial_state.is_some());
        let wanted =
            self.spec.initial_state.unwrap_or(if given { InitialState::Given } else { InitialState::Estimated });
        if wanted == InitialState::Given && !given {
            let i = signals.iter().position(|s| s.initial_state.is_none()).unwrap_or(0);
            return Err(wrong_input(
                "the trial has no initial state",
                format!("{}/initial_state", self.inputs.place(i)),
            )
            .mend("Give one for every trial, or estimate them: {\"initial_state\": \"estimated\"}."));
        }
        Ok(wanted)
    }

    fn experiment<'a>(&self, assembled: &'a Loop, signals: &[Signals]) -> Result<Experiment<'a>, Problem> {
        let wanted = self.initial_state(signals)?;
        let both = self.spec.estimate == GainFitWanted::GainAndFilter;
        let records = signals
            .iter()
            .map(|s| {
                let control = s.control.as_ref().filter(|_| both);
                let beside = |first: &DMatrix<f64>, others: &[Option<&DMatrix<f64>>]| {
                    others.iter().flatten().fold(first.clone(), |all, next| {
                        let columns: Vec<_> =
                            all.column_iter().chain(next.column_iter()).map(|c| c.into_owned()).collect();
                        DMatrix::from_columns(&columns)
                    })
                };
                let stimulus = if both { beside(&s.input, &[Some(&s.output), control]) } else { s.input.clone() };
                let initial = s.initial_state.as_ref().filter(|_| wanted == InitialState::Given);
                Record {
                    stimulus,
                    target: beside(&s.output, &[control]),
                    initial: initial.map(|state| {
                        // The states of delay and lag start at rest.
                        let total = state.len() + self.path_states(assembled);
                        DVector::from_fn(total, |i, _| state.get(i).copied().unwrap_or(0.0))
                    }),
                }
            })
            .collect();
        Experiment::new(assembled.model.as_ref(), assembled.time, records, wanted == InitialState::Estimated)
            .map_err(|error| problems::experiment(&error, |i| self.inputs.place(i)))
    }

    /// States of delays and lags.
    fn path_states(&self, assembled: &Loop) -> usize {
        let each = self.spec.delay.as_ref().map_or(0, |d| d.order) + usize::from(self.spec.muscle_lag.is_some());
        assembled.sizes[1] * each
    }

    /// Computes the report; progress counts climbs and draws.
    ///
    /// # Errors
    /// [`Failure::Stopped`] when `ctl` says so, [`Failure::Problem`] where no start makes the loop stable or the numbers overflow.
    pub fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        let (written, signals, hashes) = self.inputs.resolve(library)?;
        let assembled = self.assemble(&written, &signals)?;
        let settings = self.settings(&assembled)?;
        let experiment = self.experiment(&assembled, &signals)?;
        let asked = self.spec.optimality.as_ref().map_or(0, |o| o.draws);
        ctl.set_total((settings.climbs + asked) as u64);
        let estimate = fit(&experiment, &settings, ctl).map_err(|error| problems::fit(&error))?;
        let uncertainty = Uncertainty::new(&experiment, &estimate, &settings.noise, &settings.bounds);
        let mut warnings = Vec::new();
        let result =
            self.result(&assembled, &written, &settings, &experiment, &estimate, &uncertainty, &mut warnings, ctl)?;
        // Fewer climbs than asked for, where few starts were of use.
        let progress = ctl.progress();
        ctl.advance(progress.total - progress.done);
        let seed = Some(self.spec.seed);
        Ok(Report::new(Kind::GainFit, RESULT_VERSION, json!(result), warnings, json!(self.spec), hashes, seed))
    }

    #[allow(clippy::too_many_arguments)]
    fn result(
        &self,
        assembled: &Loop,
        written: &WrittenPlant,
        settings: &Settings,
        experiment: &Experiment<'_>,
        estimate: &Estimate,
        uncertainty: &Uncertainty,
        warnings: &mut Vec<Warning>,
        ctl: &Ctl,
    ) -> Result<GainFitResult, Failure> {
        let [n, m, _, p] = assembled.sizes;
        let both = self.spec.estimate == GainFitWanted::GainAndFilter;
        let names = assembled.model.names();
        let theta = &estimate.theta;
        let (gains, filters) = (m * n, if both { n * p } else { 0 });
        let errors = uncertainty.standard_errors();
        let width = uncertainty.half_width(self.spec.confidence);
        let parameters: Vec<FittedParameterResult> = names
            .iter()
            .enumerate()
            .map(|(i, name)| {
                let [lower, upper] = settings.bounds[i];
                let error = errors.as_ref().map(|e| e[i]).filter(|_| uncertainty.at_bound[i] == 0);
                let finite = |bound: f64| Some(bound).filter(|b| b.is_finite());
                FittedParameterResult {
                    name: name.clone(),
                    value: theta[i],
                    standard_error: error,
                    interval: error.map(|e| [(theta[i] - width * e).max(lower), (theta[i] + width * e).min(upper)]),
                    bounds: [finite(lower), finite(upper)],
                    at_bound: match uncertainty.at_bound[i] {
                        0 => None,
                        side => Some(if side < 0 { "lower" } else { "upper" }.to_owned()),
                    },
                }
            })
            .collect();
        // Entry (i, j) of K is parameter i n + j; column by column they are j m + i.
        let by_column: Vec<usize> = (0..n).flat_map(|j| (0..m).map(move |i| i * n + j)).collect();
        // Lᵀ column by column is L row by row.
        let of_filter: Vec<usize> = (gains..gains + filters).collect();
        let part = |order: &[usize]| {
            uncertainty
                .covariance
                .as_ref()
                .map(|c| DMatrix::from_fn(order.len(), order.len(), |i, j| c[(order[i], order[j])]))
        };
        let gain_covariance = part(&by_column);
        let at = |theta: &[f64]| question(assembled, both, theta);
        let Some((a, b, k)) = at(theta) else {
            return Err(problems::fit(&crate::likelihood::FitError::NotFinite));
        };
        let (errors_by_trial, sampled) = (
            experiment.errors(&estimate.evaluation.residuals, &estimate.whitening).unwrap_or_default(),
            assembled.model.sampled(theta, assembled.time, false),
        );
        let targets: Vec<&DMatrix<f64>> = experiment.records().iter().map(|r| &r.target).collect();
        let outputs: Vec<FittedOutputResult> = residuals::whiteness(&errors_by_trial, &targets)
            .into_iter()
            .enumerate()
            .map(|(i, white)| FittedOutputResult {
                noise_sd: estimate.covariance[(i, i)].max(0.0).sqrt(),
                fit_percent: white.fit_percent,
                lag_one_correlation: white.lag_one,
                lags: white.lags,
                whiteness_p: white.p_value,
            })
            .collect();
        let poles = sampled
            .and_then(|model| linalg::eigenvalues(model.value.model.a()).ok())
            .map(|poles| poles.iter().map(|p| [p.re, p.im]).collect())
            .unwrap_or_default();
        let converged = estimate.is_exact
            || uncertainty.remaining_step.map_or(uncertainty.gradient_cosine <= FLAT, |step| step <= ARRIVED)
                && uncertainty.bounds_hold;
        let combination = words(&uncertainty.weakest, &names);
        let optimality = match &self.spec.optimality {
            None => None,
            Some(spec) => {
                let observed = self.observed(assembled, theta);
                let started = estimate.evaluation.initials.iter().map(Some).chain(std::iter::repeat(None));
                let along = |(record, initial): (&Record, Option<&DVector<f64>>)| {
                    observed.as_ref()?.along(record, initial.or(record.initial.as_ref()))
                };
                let trajectories: Vec<_> = experiment.records().iter().zip(started).filter_map(along).collect();
                let question = optimality::Question {
                    theta,
                    covariance: uncertainty.covariance.as_ref(),
                    gain_covariance: gain_covariance.as_ref(),
                    at: &at,
                    trajectories: &trajectories,
                    clock: if assembled.sample_time_s.is_none() { Clock::Continuous } else { Clock::Sampled },
                    confidence: self.spec.confidence,
                    seed: self.spec.seed,
                };
                Some(optimality::ask(&question, spec, ctl)?)
            }
        };
        let numbers = (experiment.samples() * experiment.outputs()) as f64;
        let l = both.then(|| rows(&DMatrix::from_row_slice(n, p, &theta[gains..gains + filters])));
        let of_plant = &theta[gains + filters..gains + filters + assembled.plant.names().len()];
        let [state_units, input_units] = written.units();
        let whole = |sample_time_s| {
            let plant = assembled.plant.plant::<f64>(of_plant);
            InverseLqgInputsResult {
                a: rows(&a),
                b: rows(&b),
                c: rows(&plant.c),
                d: rows(&plant.d),
                k: rows(&k),
                l: l.clone().unwrap_or_default(),
                sample_time_s,
                state_names: written.state_names(n),
            }
        };
        let result = GainFitResult {
            k: rows(&k),
            k_covariance: gain_covariance.as_ref().map(rows),
            l: l.clone(),
            l_covariance: part(&of_filter).filter(|_| both).as_ref().map(rows),
            parameters,
            covariance: uncertainty.covariance.as_ref().map(rows),
            noise_covariance: rows(&estimate.covariance),
            log_likelihood: -0.5 * (estimate.deviance + numbers * (2.0 * std::f64::consts::PI).ln()),
            samples: experiment.samples(),
            degrees_of_freedom: uncertainty.degrees,
            convergence: FitConvergenceResult {
                converged,
                gradient_cosine: uncertainty.gradient_cosine,
                remaining_step: uncertainty.remaining_step,
                bounds_hold: uncertainty.bounds_hold,
                usable_starts: estimate.usable,
                draws: settings.draws,
                climbs: estimate.climbs,
                agreeing: estimate.agreeing,
                evaluations: estimate.evaluations,
                rounds: estimate.rounds,
            },
            outputs,
            identifiability: GainIdentifiabilityResult {
                identifiable: uncertainty.covariance.is_some(),
                condition_number: Some(uncertainty.condition).filter(|c| c.is_finite()),
                weakest_combination: combination,
            },
            sampled_poles: poles,
            initial_states: Some(&estimate.evaluation.initials)
                .filter(|states| !states.is_empty())
                .map(|states| states.iter().map(|x| x.iter().copied().collect()).collect()),
            inverse_lqr_inputs: InverseInputsResult {
                a: rows(&a),
                b: rows(&b),
                k: rows(&k),
                sample_time_s: assembled.sample_time_s,
                state_names: written.state_names(n),
                state_units,
                input_units,
            },
            inverse_lqg_inputs: assembled.sample_time_s.filter(|_| both).map(&whole),
            optimality,
        };
        self.warn(&result, estimate, &settings.noise, warnings);
        Ok(result)
    }
}

/// A, B and K at θ, in the time base of K.
fn question(assembled: &Loop, both: bool, theta: &[f64]) -> Option<(DMatrix<f64>, DMatrix<f64>, DMatrix<f64>)> {
    let [n, m, _, p] = assembled.sizes;
    let first = m * n + if both { n * p } else { 0 };
    let of_plant = theta.get(first..first + assembled.plant.names().len())?;
    let within = of_plant.iter().zip(assembled.plant.limits()).all(|(v, [low, high])| (low..=high).contains(v));
    if !within {
        return None;
    }
    let plant = assembled.plant.plant::<f64>(of_plant);
    let k = DMatrix::from_row_slice(m, n, &theta[..m * n]);
    if !(both && assembled.is_continuous) {
        return Some((plant.a, plant.b, k));
    }
    // K belongs to the samples.
    let (c, d) = (DMatrix::identity(n, n), DMatrix::zeros(n, m));
    let model = crate::control::StateSpace::new(plant.a, plant.b, c, d, Continuous).ok()?;
    let sampled = crate::control::discretise::zero_order_hold_state_space(&model, assembled.time).ok()?;
    Some((sampled.a().clone(), sampled.b().clone(), k))
}

/// A combination of parameters in words.
fn words(direction: &[f64], names: &[String]) -> String {
    let mut text = String::new();
    for (value, name) in direction.iter().zip(names).filter(|(v, _)| v.abs() >= WORTH_SAYING) {
        let sign = match (text.is_empty(), *value < 0.0) {
            (true, true) => "−",
            (true, false) => "",
            (false, true) => " − ",
            (false, false) => " + ",
        };
        text.push_str(&format!("{sign}{:.2} {name}", value.abs()));
    }
    text
}
