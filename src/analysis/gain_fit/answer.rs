//! What is written of an estimate.

use super::assembly::{Filter, Loop};
use super::known_plant::PlantSource;
use super::optimality;
use super::result::{
    BoundSide, FitConvergenceResult, FittedOutputResult, FittedParameterResult, GainFitResult,
    GainIdentifiabilityResult, InverseInputsResult, InverseLqgInputsResult, TwinResult,
};
use super::spec::GainFitSpec;
use super::trajectory::Observed;
use crate::analysis::contract::Failure;
use crate::analysis::inputs::matrix::rows;
use crate::analysis::problem::{Code, Problem};
use crate::control::lyapunov::Clock;
use crate::control::twins::{self, Twin, TwinsError};
use crate::ctl::Ctl;
use crate::likelihood::uncertainty::Uncertainty;
use crate::likelihood::{Estimate, Experiment, FitError, Predicted, Record, Settings, residuals};
use crate::num::linalg;
use crate::person::state_feedback::PlantModel;
use nalgebra::{DMatrix, DVector};

/// A remaining step below this, in standard errors, is none.
const ARRIVED: f64 = 0.01;
/// A gradient below this has arrived where there are no standard errors.
const FLAT: f64 = 1e-6;
/// Components of a combination below this are left out of its words.
const WORTH_SAYING: f64 = 0.1;

/// An estimate, and what it was made of.
pub(super) struct Found<'a> {
    pub spec: &'a GainFitSpec,
    pub source: &'a PlantSource,
    pub assembled: &'a Loop,
    pub settings: &'a Settings,
    pub experiment: &'a Experiment<'a>,
    pub estimate: &'a Estimate,
    pub uncertainty: &'a Uncertainty,
}

/// Why there is no estimate.
pub(super) fn no_fit(error: &FitError) -> Failure {
    match error {
        FitError::Stopped(stopped) => Failure::Stopped(*stopped),
        FitError::NoStart { .. } => Problem::new(Code::NotIdentifiable, "no stable loop", error.to_string())
            .at("/spec/bounds")
            .mend("Widen the bounds, check the signs of the plant (u = −Kx), or give a start that stabilises it.")
            .into(),
        FitError::NotFinite => Problem::new(Code::Numerical, "no fit", error.to_string())
            .at("/inputs")
            .mend("Choose units in which inputs, outputs and parameters are of moderate size.")
            .into(),
    }
}

impl Found<'_> {
    /// The result, with the question of optimality answered, and why there are no twins where there may be some;
    /// progress counts its draws.
    ///
    /// # Errors
    /// [`Failure::Stopped`] when `ctl` says so, [`Failure::Problem`] where the plant is not defined at the estimate.
    pub(super) fn result(&self, ctl: &Ctl) -> Result<(GainFitResult, Option<TwinsError>), Failure> {
        let Self { spec, source, assembled, settings, experiment, estimate, uncertainty } = *self;
        let [n, m, _, p] = assembled.sizes;
        let both = assembled.both();
        let names = assembled.model.names();
        let theta = &estimate.theta;
        let (gains, filters) = (m * n, if both { n * p } else { 0 });
        let errors = uncertainty.standard_errors();
        let width = uncertainty.half_width(spec.confidence);
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
                        side => Some(if side < 0 { BoundSide::Lower } else { BoundSide::Upper }),
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
        let at = |theta: &[f64]| assembled.at(theta);
        let Some((a, b, k)) = at(theta) else {
            return Err(no_fit(&FitError::NotFinite));
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
                signal: signal(assembled, i),
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
        let optimality = match &spec.optimality {
            None => None,
            Some(asked) => {
                let observed = Observed::new(spec, assembled, theta);
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
                    confidence: spec.confidence,
                    seed: spec.seed,
                };
                Some(optimality::ask(&question, asked, ctl)?)
            }
        };
        let numbers = (experiment.samples() * experiment.outputs()) as f64;
        let l = both.then(|| rows(&DMatrix::from_row_slice(n, p, &theta[gains..gains + filters])));
        let of_plant = &theta[gains + filters..gains + filters + assembled.plant.names().len()];
        let [state_units, input_units] = source.units();
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
                state_names: source.state_names(n),
            }
        };
        let found = self.twins(theta, [&a, &b, &k]);
        let (twins, no_twins) = match found {
            None => (None, None),
            Some(Ok(twins)) => (Some(twins), None),
            Some(Err(error)) => (None, Some(error)),
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
                state_names: source.state_names(n),
                state_units,
                input_units,
            },
            inverse_lqg_inputs: assembled.sample_time_s.filter(|_| both).map(&whole),
            twins,
            optimality,
            optimal: None,
        };
        Ok((result, no_twins))
    }

    /// The twins of K and L, where the fit cannot tell them apart.
    fn twins(&self, theta: &[f64], [a, b, k]: [&DMatrix<f64>; 3]) -> Option<Result<Vec<TwinResult>, TwinsError>> {
        self.assembled.filter.filter(Filter::is_ambiguous)?;
        let [n, m, _, p] = self.assembled.sizes;
        let l = DMatrix::from_row_slice(n, p, &theta[m * n..m * n + n * p]);
        let of_plant = &theta[m * n + n * p..];
        let c = self.assembled.plant.plant::<f64>(&of_plant[..self.assembled.plant.names().len()]).c;
        let found = twins::twins([a, b, &c], k, &l);
        Some(found.map(|twins| twins.iter().map(twin).collect()))
    }
}

fn twin(twin: &Twin) -> TwinResult {
    TwinResult {
        k: rows(&twin.k),
        l: rows(&twin.l),
        regulator_poles: twin.regulator_poles.iter().map(|pole| [pole.re, pole.im]).collect(),
    }
}

/// What is predicted in this place.
fn signal(assembled: &Loop, at: usize) -> String {
    let outputs = match assembled.filter {
        Some(filter) if filter.predicted == Predicted::Control => 0,
        _ => assembled.sizes[3],
    };
    if at < outputs { format!("output {}", at + 1) } else { format!("control {}", at - outputs + 1) }
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
