//! The fit of a person whose gain is held to be optimal, beside the free one, and the test between them.

use super::answer::{Found, no_fit};
use super::spec::OptimalConstraint;
use crate::analysis::contract::Failure;
use crate::analysis::inputs::matrix::{dense, rows};
use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_spec as wrong;
use crate::control::lyapunov::Clock;
use crate::ctl::{Ctl, Phase};
use crate::inverse::fit::{FitError as NearestError, FitSettings, fit as nearest};
use crate::inverse::{Gains, QSign, Structure};
use crate::likelihood::optimal::{Null, OptimalPerson, plain_start, ratio_test};
use crate::likelihood::uncertainty::Uncertainty;
use crate::likelihood::{FitError, LoopModel as _, Settings, fit};
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where the constraint is.
const AT: &str = "/spec/constraint";
/// Starts beside the one from the nearest optimal gain.
const DRAWS: usize = 20;
/// Starts that are climbed from at least.
const CLIMBS: usize = 5;
/// Condition numbers up to which the nearest optimal gain is looked for, as a start.
const CONDITIONS: [f64; 3] = [1e2, 1e4, 1e6];
/// A weight of that start below this share of the largest is lifted to it: its logarithm is where the search begins.
const LEAST_START: f64 = 1e-6;
/// A free fit that is less likely than the optimal one by more than this has not arrived.
const BEHIND: f64 = 1e-3;

/// A weight of a state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitFittedWeight")]
pub struct FittedWeight {
    /// The state.
    pub state: String,
    /// The weight, on the scale of `control_weight`, in the unit of the cost over the state's squared; 0 where the cone
    /// of optimal gains ends.
    pub value: f64,
    /// The standard error of its natural logarithm, dimensionless; null at zero, and where the data do not determine
    /// all parameters.
    pub log_standard_error: Option<f64>,
    /// Its interval, to first order in the logarithm, in the unit of the value; null as the error.
    pub interval: Option<[f64; 2]>,
}

/// What the ratio of the likelihoods is held against.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "GainFitRatioNull")]
pub enum RatioNull {
    /// Chi-square: fewer weights than gains, none of them at zero.
    ChiSquare,
    /// A mixture of chi-squares, from 20,000 draws: some weights are at zero, where the cone of optimal gains ends.
    Mixture,
    /// Always zero: as many weights as gains, none of them at zero, so that every gain nearby is optimal too. The
    /// p-value is 1, and speaks neither for nor against.
    Zero,
}

/// A person whose gain is optimal, fitted to the same trials.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitOptimalPerson")]
pub struct OptimalPersonResult {
    /// The weights of the states, in their order.
    pub weights: Vec<FittedWeight>,
    /// R, m×m, which is held: the scale of the cost, in its unit over those of two controls.
    pub control_weight: Vec<Vec<f64>>,
    /// K of these weights, m×n, in the unit of the control per unit of the state.
    pub k: Vec<Vec<f64>>,
    /// Natural logarithm of the likelihood's density, for outputs in their units.
    pub log_likelihood: f64,
    /// Twice the difference of the log likelihoods, of the free gain and of this one; dimensionless.
    pub ratio: f64,
    /// The probability, dimensionless, of a larger ratio for a person who is optimal; null where it is not known
    /// (`reason`).
    pub p_value: Option<f64>,
    /// What it is held against; null as `p_value`.
    pub null_distribution: Option<RatioNull>,
    /// The degrees of freedom of the chi-square; null for others.
    pub degrees_of_freedom: Option<usize>,
    /// The share of the mixture that is zero, dimensionless; null for others.
    pub share_at_zero: Option<f64>,
    /// Why there is no p-value; null where there is one.
    pub reason: Option<String>,
    /// Starts that were climbed from.
    pub climbs: usize,
    /// How many of them ended at this likelihood.
    pub agreeing: usize,
}

/// The weighed states and R of a constraint, checked against the plant's n states and m controls.
pub(super) fn checked(
    constraint: &OptimalConstraint,
    names: &[String],
    controls: usize,
) -> Result<(Vec<usize>, DMatrix<f64>), Problem> {
    let setting = constraint.setting();
    let weighed = match &setting.weighed_states {
        None => (0..names.len()).collect(),
        Some(wanted) => {
            let mut found = Vec::new();
            for (i, name) in wanted.iter().enumerate() {
                let at = format!("{AT}/optimal/weighed_states/{i}");
                let Some(state) = names.iter().position(|own| own == name) else {
                    return Err(wrong(format!("there is no state {name:?}"), at)
                        .mend(format!("The states are {}.", names.join(", "))));
                };
                if found.contains(&state) {
                    return Err(wrong(format!("{name:?} is named twice"), at));
                }
                found.push(state);
            }
            found.sort_unstable();
            found
        }
    };
    if weighed.is_empty() {
        return Err(wrong("a cost that weighs no state has no regulator", format!("{AT}/optimal/weighed_states"))
            .mend("Name a state at least, or leave the member out for all of them."));
    }
    let r = match &setting.control_weight {
        None => DMatrix::identity(controls, controls),
        Some(rows) => {
            let at = format!("{AT}/optimal/control_weight");
            let found = dense(rows, "R", &at)?;
            let is_symmetric = found.is_square() && (&found - found.transpose()).amax() <= 1e-10 * found.amax();
            if found.nrows() != controls || !is_symmetric || found.clone().cholesky().is_none() {
                let detail = format!("R must be {controls}x{controls}, symmetric and positive definite");
                return Err(wrong(detail, at));
            }
            found
        }
    };
    Ok((weighed, r))
}

/// Fits the optimal person, and tests it against the free gain.
pub(super) fn held(
    found: &Found<'_>,
    constraint: &OptimalConstraint,
    ctl: &Ctl,
) -> Result<OptimalPersonResult, Failure> {
    let Found { spec, source, assembled, settings, experiment, estimate, uncertainty } = found;
    let [n, m, ..] = assembled.sizes;
    let names = source.state_names(n);
    let (weighed, control_weight) = checked(constraint, &names, m)?;
    let clock = if assembled.sample_time_s.is_none() { Clock::Continuous } else { Clock::Sampled };
    let start = start(found, &weighed, &control_weight, clock, ctl)?;
    let person = OptimalPerson {
        free: assembled.model.as_ref(),
        plant: &assembled.plant,
        clock,
        names: weighed.iter().map(|state| format!("weight of {}", names[*state])).collect(),
        weighed,
        control_weight,
        start,
    };
    let gains = n * m;
    let rest = &estimate.theta[gains..];
    let bounds = person.limits().into_iter().take(person.start.len()).chain(settings.bounds[gains..].iter().copied());
    let own = Settings {
        noise: settings.noise.clone(),
        bounds: bounds.collect(),
        start: Some(person.start.iter().chain(rest).copied().collect()),
        draws: DRAWS,
        climbs: settings.climbs.max(CLIMBS),
        seed: settings.seed,
    };
    let same_trials = experiment.with_model(&person);
    let fitted = fit(&same_trials, &own, ctl).map_err(|error| match error {
        FitError::NoStart { .. } => Problem::new(
            crate::analysis::problem::Code::NotIdentifiable,
            "no optimal person",
            "no weights of this structure make the loop stable within the bounds",
        )
        .at(AT)
        .mend("Weigh more states: a mode that no weight sees stays as the plant has it.")
        .into(),
        other => no_fit(&other),
    })?;
    ctl.check()?;
    let known = Uncertainty::new(&same_trials, &fitted, &own.noise, &own.bounds);
    let ratio = fitted.deviance - estimate.deviance;
    let test = uncertainty
        .covariance
        .as_ref()
        .and_then(|covariance| ratio_test(&person, &fitted.theta, covariance, ratio, spec.seed));
    let reason = if ratio < -BEHIND {
        Some(format!(
            "the optimal gain is likelier than the free one by {:.3}: the free fit has not arrived; take more climbs",
            -0.5 * ratio
        ))
    } else if estimate.is_exact {
        Some("the model explains the outputs down to rounding, so that the ratio has no distribution".to_owned())
    } else if test.is_none() {
        Some("the data do not determine all parameters of the free fit".to_owned())
    } else {
        None
    };
    let (errors, width) = (known.standard_errors(), known.half_width(spec.confidence));
    let at_zero: Vec<bool> = (0..person.weighed.len())
        .map(|i| test.as_ref().is_some_and(|test| test.at_zero[i]) || known.at_bound[i] < 0)
        .collect();
    let weight = |(i, state): (usize, &usize)| {
        let is_zero = at_zero[i];
        let value = fitted.theta[i].exp();
        let error = errors.as_ref().map(|errors| errors[i]).filter(|_| !is_zero);
        FittedWeight {
            state: names[*state].clone(),
            value: if is_zero { 0.0 } else { value },
            log_standard_error: error,
            interval: error.map(|e| [value * (-width * e).exp(), value * (width * e).exp()]),
        }
    };
    let test = test.filter(|_| reason.is_none());
    let numbers = (experiment.samples() * experiment.outputs()) as f64;
    let k = person.gain(&fitted.theta).ok_or_else(|| no_fit(&FitError::NotFinite))?;
    Ok(OptimalPersonResult {
        weights: person.weighed.iter().enumerate().map(weight).collect(),
        control_weight: rows(&person.control_weight),
        k: rows(&k),
        log_likelihood: -0.5 * (fitted.deviance + numbers * (2.0 * std::f64::consts::PI).ln()),
        ratio: ratio.max(0.0),
        p_value: test.as_ref().map(|test| test.p_value),
        null_distribution: test.as_ref().map(|test| match test.null {
            Null::ChiSquare(_) => RatioNull::ChiSquare,
            Null::Mixture { .. } => RatioNull::Mixture,
            Null::Zero => RatioNull::Zero,
        }),
        degrees_of_freedom: test.as_ref().and_then(|test| match test.null {
            Null::ChiSquare(degrees) => Some(degrees),
            _ => None,
        }),
        share_at_zero: test.as_ref().and_then(|test| match test.null {
            Null::Mixture { inside, .. } => Some(inside),
            _ => None,
        }),
        reason,
        climbs: fitted.climbs,
        agreeing: fitted.agreeing,
    })
}

/// Where the weights start: those of the nearest gain that has some, in the metric of the estimate.
fn start(
    found: &Found<'_>,
    weighed: &[usize],
    control_weight: &DMatrix<f64>,
    clock: Clock,
    ctl: &Ctl,
) -> Result<Vec<f64>, Failure> {
    let Found { assembled, settings, estimate, uncertainty, .. } = found;
    ctl.enter(Phase::Fit, 0.2);
    let plain = || plain_start(&assembled.plant, clock, weighed.len(), settings.seed);
    let Some((a, b, k)) = assembled.at(&estimate.theta) else { return Ok(plain()) };
    let Ok(gains) = Gains::regulator(&a, &b, &k, clock) else { return Ok(plain()) };
    let (n, m) = (a.nrows(), b.ncols());
    let pattern = DMatrix::from_fn(n, n, |i, j| i == j && weighed.contains(&i));
    // Entry (i, j) of K is parameter i n + j; column by column they are j m + i.
    let by_column: Vec<usize> = (0..n).flat_map(|j| (0..m).map(move |i| i * n + j)).collect();
    let covariance = uncertainty.covariance.as_ref();
    let part = covariance.map(|c| DMatrix::from_fn(n * m, n * m, |i, j| c[(by_column[i], by_column[j])]));
    let wanted = FitSettings {
        structure: Structure {
            q_pattern: Some(pattern),
            r: Some(control_weight.clone()),
            q_sign: QSign::Semidefinite,
            ..Structure::default()
        },
        condition_numbers: CONDITIONS.to_vec(),
        metric: part.and_then(|c| c.cholesky()).map(|factor| factor.inverse()),
        seed: settings.seed,
        ..FitSettings::default()
    };
    let best = match nearest(&gains, &wanted, ctl) {
        Ok(found) => found.curve.last().map(|point| (point.q.clone(), point.r.clone())),
        Err(NearestError::Stopped(stopped)) => return Err(stopped.into()),
        Err(_) => None,
    };
    let Some((q, r)) = best else { return Ok(plain()) };
    // R of the fit is the one held, up to its scale.
    let scale = control_weight.trace() / r.trace();
    let largest = q.diagonal().amax();
    if !(scale.is_finite() && scale > 0.0 && largest > 0.0) {
        return Ok(plain());
    }
    Ok(weighed.iter().map(|state| (q[(*state, *state)].max(LEAST_START * largest) * scale).ln()).collect())
}
