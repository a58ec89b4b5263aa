//! The search for the most likely parameters.

use super::experiment::{Evaluation, Experiment};
use super::noise::Noise;
use crate::ctl::{Ctl, Phase, Stopped};
use crate::num::least_squares::{self, LeastSquares, LeastSquaresError, Options};
use crate::num::rng;
use nalgebra::{DMatrix, DVector};

/// The loop must have its poles within this radius.
const STABLE: f64 = 1.0 - 1e-9;
/// The stationarity measure of the weighted problems.
const GRADIENT: f64 = 1e-9;
/// Reweightings of one start at most.
const ROUNDS: usize = 60;
/// A change of the deviance (twice the log-likelihood) below this ends the reweighting.
const SETTLED: f64 = 1e-9;
/// Evaluations of one weighted problem at most.
const EVALUATIONS: usize = 80;
/// Answers whose deviances differ by less are the same answer.
const SAME_DEVIANCE: f64 = 1e-3;

/// How it is fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// What is known of the noise.
    pub noise: Noise,
    /// Bounds of each parameter, within the limits of the model; infinite where there is none.
    pub bounds: Vec<[f64; 2]>,
    /// A start of the user's, which is tried beside the drawn ones.
    pub start: Option<Vec<f64>>,
    /// Points drawn; the likeliest are climbed from.
    pub draws: usize,
    /// How many are climbed from.
    pub climbs: usize,
    /// The seed of the draws.
    pub seed: u64,
}

/// The most likely parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// θ̂.
    pub theta: Vec<f64>,
    /// Σ̂.
    pub covariance: DMatrix<f64>,
    /// `Σ̂^{−1/2}`.
    pub whitening: DMatrix<f64>,
    /// Residuals, whitened by it, with their derivatives.
    pub evaluation: Evaluation,
    /// The deviance: `N log det Σ̂ + tr(Σ̂⁻¹S)`.
    pub deviance: f64,
    /// Whether the residuals are nothing but rounding.
    pub is_exact: bool,
    /// Draws with a stable loop and a finite likelihood, of all draws.
    pub usable: usize,
    /// Climbs made.
    pub climbs: usize,
    /// Climbs that ended at this likelihood.
    pub agreeing: usize,
    /// Evaluations of the model in all climbs.
    pub evaluations: usize,
    /// Rounds of reweighting of the best climb.
    pub rounds: usize,
    /// Why the last weighted problem of the best climb stopped.
    pub stop: least_squares::Stop,
}

/// Why there is no estimate.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FitError {
    /// Somebody asked to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// No draw makes the loop stable.
    #[error("none of {draws} starts makes the loop stable within the bounds")]
    NoStart {
        /// Draws.
        draws: usize,
    },
    /// No climb came to an end at a finite likelihood.
    #[error("the likelihood is not finite anywhere near the starts")]
    NotFinite,
}

/// One weighted problem: Σ held.
struct Weighted<'a> {
    experiment: &'a Experiment<'a>,
    whitening: &'a DMatrix<f64>,
    bounds: &'a [[f64; 2]],
}

impl LeastSquares for Weighted<'_> {
    fn unknowns(&self) -> usize {
        self.bounds.len()
    }

    fn equations(&self) -> usize {
        self.experiment.samples() * self.experiment.outputs()
    }

    fn evaluate(&self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) -> bool {
        let Some(found) = self.experiment.evaluate(x, self.whitening, jacobian.is_some()) else { return false };
        *residuals = found.residuals;
        if let Some(jacobian) = jacobian {
            *jacobian = found.jacobian;
        }
        true
    }

    fn bounds(&self) -> Vec<[f64; 2]> {
        self.bounds.to_vec()
    }

    fn is_feasible(&self, x: &[f64]) -> bool {
        self.experiment.spectral_radius(x).is_some_and(|radius| radius < STABLE)
    }
}

/// A point of the search.
struct Climbed {
    theta: Vec<f64>,
    deviance: f64,
    rounds: usize,
    evaluations: usize,
    stop: least_squares::Stop,
}

/// The share that the climbs take of the time of a whole analysis, which draws starts before and judges the answer
/// after.
const CLIMBS_SHARE: f64 = 0.5;

/// Finds the most likely parameters.
///
/// # Errors
/// [`FitError`].
pub fn fit(experiment: &Experiment<'_>, settings: &Settings, ctl: &Ctl) -> Result<Estimate, FitError> {
    let mut starts = drawn(experiment, settings, ctl)?;
    let usable = starts.len();
    if starts.is_empty() {
        return Err(FitError::NoStart { draws: settings.draws });
    }
    starts.sort_by(|x, y| x.0.total_cmp(&y.0));
    // The user's own start is climbed from however unlikely it looks.
    let mut chosen: Vec<Vec<f64>> = settings.start.iter().cloned().collect();
    for (_, start) in starts {
        if chosen.len() < settings.climbs && !chosen.contains(&start) {
            chosen.push(start);
        }
    }
    let mut ended: Vec<Climbed> = Vec::new();
    ctl.enter(Phase::Fit, CLIMBS_SHARE);
    ctl.set_total(chosen.len() as u64);
    for start in &chosen {
        if let Some(found) = climb(experiment, settings, start, ctl)? {
            ended.push(found);
        }
        ctl.advance(1);
    }
    let evaluations = ended.iter().map(|c| c.evaluations).sum();
    let climbs = chosen.len();
    let best = ended.iter().min_by(|x, y| x.deviance.total_cmp(&y.deviance)).ok_or(FitError::NotFinite)?;
    let agreeing = ended.iter().filter(|c| c.deviance - best.deviance <= SAME_DEVIANCE).count();
    let mut estimate = finish(experiment, settings, best, ctl)?.ok_or(FitError::NotFinite)?;
    estimate.usable = usable;
    estimate.climbs = climbs;
    estimate.agreeing = agreeing;
    estimate.evaluations = evaluations;
    Ok(estimate)
}

/// The likelihood at the best point, with all that follows from it.
fn finish(
    experiment: &Experiment<'_>,
    settings: &Settings,
    best: &Climbed,
    ctl: &Ctl,
) -> Result<Option<Estimate>, Stopped> {
    let sizes = experiment.sizes();
    let unit = DMatrix::identity(experiment.outputs(), experiment.outputs());
    let Some((scatter, covariance)) = covariance_at(experiment, settings, &best.theta, &unit) else { return Ok(None) };
    ctl.check()?;
    // Once more with the weights that belong to the point: initial states depend on them.
    let again = match settings.noise {
        Noise::Scalar => Some((scatter, covariance)),
        _ => Noise::whitening(&covariance).and_then(|first| covariance_at(experiment, settings, &best.theta, &first)),
    };
    ctl.check()?;
    let Some((scatter, covariance)) = again else { return Ok(None) };
    let whitened = Noise::whitening(&covariance)
        .and_then(|whitening| Some((experiment.evaluate(&best.theta, &whitening, true)?, whitening)));
    let Some((evaluation, whitening)) = whitened else { return Ok(None) };
    Ok(Some(Estimate {
        theta: best.theta.clone(),
        deviance: settings.noise.deviance(&scatter, experiment.samples(), sizes),
        is_exact: Noise::is_rounding(&scatter, experiment.samples(), sizes),
        covariance,
        whitening,
        evaluation,
        usable: 0,
        climbs: 0,
        agreeing: 0,
        evaluations: 0,
        rounds: best.rounds,
        stop: best.stop,
    }))
}

/// S and Σ̂ at θ, with the initial states weighted by `whitening`.
fn covariance_at(
    experiment: &Experiment<'_>,
    settings: &Settings,
    theta: &[f64],
    whitening: &DMatrix<f64>,
) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
    let found = experiment.evaluate(theta, whitening, false)?;
    let scatter = experiment.scatter(&found.residuals, whitening)?;
    let covariance = settings.noise.covariance(&scatter, experiment.samples(), experiment.sizes());
    Some((scatter, covariance))
}

/// Draws with a stable loop, each with its deviance.
fn drawn(experiment: &Experiment<'_>, settings: &Settings, ctl: &Ctl) -> Result<Vec<(f64, Vec<f64>)>, FitError> {
    let mut stream = rng::stream(settings.seed, "gain fit starts");
    let sizes = experiment.sizes();
    let largest = sizes.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    // Outputs in units of their own size; one that is silent has none.
    let unit = DMatrix::from_diagonal(&DVector::from_iterator(
        sizes.len(),
        sizes.iter().map(|s| s.max(1e-6 * largest).recip()),
    ));
    let mut found = Vec::new();
    ctl.set_total(settings.draws as u64);
    for index in 0..settings.draws {
        ctl.check()?;
        ctl.advance(1);
        let Some(theta) = experiment.model().draw(&mut stream, index, experiment.time(), &settings.bounds) else {
            continue;
        };
        if experiment.spectral_radius(&theta).is_none_or(|radius| radius >= STABLE) {
            continue;
        }
        let Some((scatter, _)) = covariance_at(experiment, settings, &theta, &unit) else { continue };
        let deviance = settings.noise.deviance(&scatter, experiment.samples(), sizes);
        if deviance.is_finite() {
            found.push((deviance, theta));
        }
    }
    Ok(found)
}

/// Reweights and minimises in turn until neither changes anything; `None` where the start is of no use.
fn climb(
    experiment: &Experiment<'_>,
    settings: &Settings,
    start: &[f64],
    ctl: &Ctl,
) -> Result<Option<Climbed>, FitError> {
    let (samples, sizes) = (experiment.samples(), experiment.sizes());
    let unit = DMatrix::identity(experiment.outputs(), experiment.outputs());
    let Some((scatter, mut covariance)) = covariance_at(experiment, settings, start, &unit) else { return Ok(None) };
    ctl.check()?;
    // Far from the answer the errors of all outputs go together, which is no property of the noise.
    if settings.noise == Noise::Full {
        covariance = Noise::Diagonal.covariance(&scatter, samples, sizes);
    }
    let mut theta = start.to_vec();
    let mut deviance = settings.noise.deviance(&scatter, samples, sizes);
    let mut evaluations = 0;
    let options = Options { gradient_tolerance: GRADIENT, residual_floor: 0.0, max_evaluations: EVALUATIONS };
    let mut rounds = 0;
    loop {
        let Some(whitening) = Noise::whitening(&covariance) else { return Ok(None) };
        let weighted = Weighted { experiment, whitening: &whitening, bounds: &settings.bounds };
        let found = match least_squares::minimise(&weighted, &theta, &options, ctl) {
            Ok(found) => found,
            Err(LeastSquaresError::Stopped(stopped)) => return Err(stopped.into()),
            Err(LeastSquaresError::InfeasibleStart | LeastSquaresError::NotFinite) => return Ok(None),
        };
        rounds += 1;
        evaluations += found.residual_evaluations + found.jacobian_evaluations;
        theta = found.x;
        let Some(scatter) = experiment.scatter(&found.residuals, &whitening) else { return Ok(None) };
        let next = settings.noise.deviance(&scatter, samples, sizes);
        let change = deviance - next;
        deviance = next;
        covariance = settings.noise.covariance(&scatter, samples, sizes);
        let is_settled = change.abs() <= SETTLED * (1.0 + deviance.abs()) && rounds > 1;
        let is_rounding = Noise::is_rounding(&scatter, samples, sizes);
        let is_known = matches!(settings.noise, Noise::Known(_)) && found.stop.is_converged();
        if is_settled || is_rounding || is_known || rounds >= ROUNDS {
            return Ok(Some(Climbed { theta, deviance, rounds, evaluations, stop: found.stop }));
        }
    }
}
