//! Whether the gains that were found are optimal for a cost, how surely, and for which.
//!
//! The estimate is drawn from its normal distribution (gains and parameters of the plant together), and each draw is
//! put the question of `inverse_lqr`. The share of draws with weights is the probability that the gains are optimal at
//! all, with the interval of Clopper and Pearson (1934); the weights of those draws, on the scale on which R has the
//! mean eigenvalue 1, give the intervals of Q and R.

use super::spec::OptimalitySpec;
use super::trajectory::shares_of;
use crate::analysis::contract::Failure;
use crate::analysis::inputs::matrix::rows;
use crate::analysis::inverse::shares::SharesResult;
use crate::control::lyapunov::Clock;
use crate::ctl::Ctl;
use crate::inverse::fit::{FitSettings, fit};
use crate::inverse::lqr::{InverseError, gain_factor};
use crate::inverse::{Gains, Settings, Verdict, inverse_lqr, reading};
use crate::num::distributions::{beta_i, chi_square_cdf};
use crate::num::rng;
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_distr::StandardNormal;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Condition numbers of the nearest optimal gain.
const CONDITIONS: [f64; 3] = [1e2, 1e4, 1e6];

/// A weight with its interval, on the scale on which R has the mean eigenvalue 1: `Q_ij` in `[u]²/([x_i][x_j])`, R
/// dimensionless where controls have one unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitWeightInterval")]
pub struct WeightInterval {
    /// Of the estimate itself, in those units; null where that has no cost.
    pub estimate: Option<Vec<Vec<f64>>>,
    /// Lower ends, entry by entry, in those units.
    pub lower: Vec<Vec<f64>>,
    /// Upper ends, entry by entry, in those units.
    pub upper: Vec<Vec<f64>>,
}

/// The nearest optimal gain, in the metric of the estimate's own covariance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitNearestOptimal")]
pub struct NearestOptimal {
    /// Q, n×n, in the unit of the cost over those of two states; the cost is free up to its scale.
    pub q: Vec<Vec<f64>>,
    /// R, m×m, in the unit of the cost over those of two controls.
    pub r: Vec<Vec<f64>>,
    /// Its gain, m×n, in the unit of the control per unit of the state.
    pub k: Vec<Vec<f64>>,
    /// `(K̂ − K)ᵀ Cov⁻¹ (K̂ − K)`, dimensionless.
    pub distance_squared: f64,
    /// Probability, dimensionless, of a larger distance between an estimate and the true gain, by chi-square with as
    /// many degrees as K has entries: where it is large, the data do not speak against an optimal gain.
    pub p_value: f64,
    /// The condition number that the weights were held to, dimensionless.
    pub condition_number: f64,
}

/// Whether a gain is optimal for a quadratic cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitVerdict")]
#[serde(rename_all = "snake_case")]
pub enum OptimalityVerdict {
    /// It is, for weights that exist.
    Feasible,
    /// It is not, for any weights.
    Infeasible,
    /// The boundary is nearer than the digits of the data.
    Boundary,
    /// The question has no sense there, or found no answer.
    None,
}

/// What the gains say about a cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainFitOptimality")]
pub struct OptimalityResult {
    /// Of the estimate itself; `none` comes with its reason.
    pub verdict: OptimalityVerdict,
    /// Why there is no verdict; null where there is one.
    pub reason: Option<String>,
    /// ‖ΔK‖/‖K‖ up to the boundary as in `inverse_lqr`, dimensionless; null where there is no verdict, or no
    /// certificate.
    pub relative_change: Option<f64>,
    /// c* as in `inverse_lqr`, dimensionless: the factor on the whole gain at which it becomes optimal; null where no
    /// factor helps, and with several controls.
    pub c_star: Option<f64>,
    /// `max t` as in `inverse_lqr`, scaled and so dimensionless, which decides nothing; null where there is no verdict,
    /// or the structure leaves nothing.
    pub t_star_scaled: Option<f64>,
    /// Dimension of the space of weights that satisfy the equalities, null where there is no verdict; above 1 the gain
    /// leaves the cost open, and the best conditioned is given.
    pub unknowns: Option<usize>,
    /// Draws put the question.
    pub draws: usize,
    /// Draws with weights.
    pub feasible: usize,
    /// Draws for which working precision does not decide.
    pub undecided: usize,
    /// Draws whose plant or loop leaves the question without sense (an unstable loop, an uncontrollable plant); they
    /// count as not optimal.
    pub senseless: usize,
    /// `feasible/draws`, dimensionless; null without draws.
    pub probability: Option<f64>,
    /// Its interval for the number of draws, dimensionless; null without draws.
    pub probability_interval: Option<[f64; 2]>,
    /// Q on the scale on which R has the mean eigenvalue 1; null with fewer than 20 feasible draws.
    pub q: Option<WeightInterval>,
    /// R on that scale; null as Q.
    pub r: Option<WeightInterval>,
    /// The nearest gain with a cost, where the estimate itself has none; null otherwise, or where it was not found.
    pub nearest: Option<NearestOptimal>,
    /// Shares of that cost (of the estimate, or else of the nearest optimal gain) along the trajectory of each trial,
    /// in the states of the plant and the control that reaches it, as the fitted loop makes them: what the person paid
    /// for. Null along a trajectory that costs nothing; empty where there is no cost.
    pub trial_shares: Vec<Option<SharesResult>>,
    /// The same along all trials together; null where there is no cost, or it is zero.
    pub trajectory_shares: Option<SharesResult>,
}

/// Feasible draws that an interval needs.
const ENOUGH: usize = 20;

/// The question at a point of the parameters: A, B, K and their time base; `None` where the plant is not defined.
pub(super) type At<'a> = dyn Fn(&[f64]) -> Option<(DMatrix<f64>, DMatrix<f64>, DMatrix<f64>)> + Sync + 'a;

/// The estimate as the question needs it.
pub(super) struct Question<'a> {
    pub theta: &'a [f64],
    /// Of all parameters.
    pub covariance: Option<&'a DMatrix<f64>>,
    /// Of K, column by column.
    pub gain_covariance: Option<&'a DMatrix<f64>>,
    pub at: &'a At<'a>,
    /// States and controls of every trial.
    pub trajectories: &'a [(DMatrix<f64>, DMatrix<f64>)],
    pub clock: Clock,
    pub confidence: f64,
    pub seed: u64,
}

/// The bounds of Clopper and Pearson for `k` of `n`.
pub(super) fn binomial_interval(k: usize, n: usize, level: f64) -> [f64; 2] {
    let tail = 0.5 * (1.0 - level);
    let (k, n) = (k as f64, n as f64);
    // The quantile of the beta distribution, by bisection.
    let quantile = |probability: f64, a: f64, b: f64| {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if beta_i(a, b, middle) < probability { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    };
    let lower = if k == 0.0 { 0.0 } else { quantile(tail, k, n - k + 1.0) };
    let upper = if k == n { 1.0 } else { quantile(1.0 - tail, k + 1.0, n - k) };
    [lower, upper]
}

/// Asks.
pub(super) fn ask(question: &Question<'_>, spec: &OptimalitySpec, ctl: &Ctl) -> Result<OptimalityResult, Failure> {
    let mut result = OptimalityResult {
        verdict: OptimalityVerdict::None,
        reason: None,
        relative_change: None,
        c_star: None,
        t_star_scaled: None,
        unknowns: None,
        draws: 0,
        feasible: 0,
        undecided: 0,
        senseless: 0,
        probability: None,
        probability_interval: None,
        q: None,
        r: None,
        nearest: None,
        trial_shares: Vec::new(),
        trajectory_shares: None,
    };
    let Some((a, b, k)) = (question.at)(question.theta) else {
        result.reason = Some("the plant is not defined at the estimate".to_owned());
        return Ok(result);
    };
    let settings = Settings { structure: spec.structure(a.nrows(), b.ncols())?, ..Settings::default() };
    let gains = match Gains::regulator(&a, &b, &k, question.clock) {
        Ok(gains) => gains,
        Err(error) => {
            result.reason = Some(error.to_string());
            return Ok(result);
        }
    };
    let mut estimate = None;
    match inverse_lqr(&gains, &settings, ctl) {
        Ok(answer) => {
            result.verdict = answer.verdict.into();
            result.t_star_scaled = answer.t_star_scaled;
            result.unknowns = Some(answer.unknowns);
            result.relative_change = answer.decision.relative_change.filter(|v| v.is_finite());
            result.c_star = gain_factor(&gains, &answer.decision, ctl).or_else(|error| match error {
                InverseError::Stopped(stopped) => Err(Failure::Stopped(stopped)),
                _ => Ok(None),
            })?;
            estimate = answer.weights.filter(|_| accepted(answer.verdict, &settings)).map(|w| (w.q, w.r));
        }
        Err(InverseError::Stopped(stopped)) => return Err(stopped.into()),
        Err(error) => result.reason = Some(error.to_string()),
    }
    if estimate.is_none() && result.verdict == OptimalityVerdict::Infeasible {
        result.nearest = nearest(&gains, &settings, question, ctl)?;
    }
    let read = |rows: &[Vec<f64>]| DMatrix::from_fn(rows.len(), rows.len(), |i, j| rows[i][j]);
    let cost = estimate.clone().or_else(|| result.nearest.as_ref().map(|near| (read(&near.q), read(&near.r))));
    if let Some((q, r)) = cost {
        (result.trial_shares, result.trajectory_shares) = shares_of(&q, &r, question.trajectories);
    }
    if let Some(root) = question.covariance.filter(|_| spec.draws > 0).map(square_root) {
        draw(question, &settings, &root, spec.draws, estimate, &mut result, ctl)?;
    }
    Ok(result)
}

impl From<Verdict> for OptimalityVerdict {
    fn from(verdict: Verdict) -> Self {
        match verdict {
            Verdict::Feasible => Self::Feasible,
            Verdict::Infeasible => Self::Infeasible,
            Verdict::Boundary => Self::Boundary,
        }
    }
}

/// Whether a verdict with weights says yes.
fn accepted(verdict: Verdict, settings: &Settings) -> bool {
    verdict == Verdict::Feasible || (verdict == Verdict::Boundary && settings.accepts_boundary())
}

/// F with `F Fᵀ` the matrix; parameters without variance have none in F.
fn square_root(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let eigen = covariance.clone().symmetric_eigen();
    let roots = eigen.eigenvalues.map(|v| v.max(0.0).sqrt());
    &eigen.eigenvectors * DMatrix::from_diagonal(&roots)
}

fn draw(
    question: &Question<'_>,
    settings: &Settings,
    root: &DMatrix<f64>,
    draws: usize,
    estimate: Option<(DMatrix<f64>, DMatrix<f64>)>,
    result: &mut OptimalityResult,
    ctl: &Ctl,
) -> Result<(), Failure> {
    let mut stream = rng::stream(question.seed, "gain fit optimality");
    ctl.set_total(draws as u64);
    let mut weights: Vec<(DMatrix<f64>, DMatrix<f64>)> = Vec::new();
    for _ in 0..draws {
        ctl.check()?;
        let z = DVector::from_fn(root.ncols(), |_, _| stream.sample::<f64, _>(StandardNormal));
        let moved = root * z;
        let theta: Vec<f64> = question.theta.iter().zip(moved.iter()).map(|(t, d)| t + d).collect();
        result.draws += 1;
        let gains = (question.at)(&theta).and_then(|(a, b, k)| Gains::regulator(&a, &b, &k, question.clock).ok());
        match gains.map(|gains| inverse_lqr(&gains, settings, ctl)) {
            None => result.senseless += 1,
            Some(Err(InverseError::Stopped(stopped))) => return Err(stopped.into()),
            Some(Err(_)) => result.undecided += 1,
            Some(Ok(answer)) if accepted(answer.verdict, settings) && answer.weights.is_some() => {
                result.feasible += 1;
                weights.extend(answer.weights.map(|w| {
                    let (q, r, _) = reading::normalised(&w.q, &w.r);
                    (q, r)
                }));
            }
            Some(Ok(answer)) => result.undecided += usize::from(answer.verdict == Verdict::Boundary),
        }
        ctl.advance(1);
    }
    result.probability = Some(result.feasible as f64 / result.draws as f64);
    result.probability_interval = Some(binomial_interval(result.feasible, result.draws, question.confidence));
    if weights.len() >= ENOUGH {
        let own = estimate.map(|(q, r)| {
            let (q, r, _) = reading::normalised(&q, &r);
            (q, r)
        });
        let qs: Vec<&DMatrix<f64>> = weights.iter().map(|w| &w.0).collect();
        let rs: Vec<&DMatrix<f64>> = weights.iter().map(|w| &w.1).collect();
        result.q = Some(interval(own.as_ref().map(|w| &w.0), &qs, question.confidence));
        result.r = Some(interval(own.as_ref().map(|w| &w.1), &rs, question.confidence));
    }
    Ok(())
}

/// Quantiles of each entry.
fn interval(estimate: Option<&DMatrix<f64>>, draws: &[&DMatrix<f64>], level: f64) -> WeightInterval {
    let quantile = |i: usize, j: usize, share: f64| {
        let mut values: Vec<f64> = draws.iter().map(|m| m[(i, j)]).collect();
        values.sort_by(f64::total_cmp);
        let at = share * (values.len() - 1) as f64;
        let (low, rest) = (at.floor() as usize, at.fract());
        values[low] + rest * (values[(low + 1).min(values.len() - 1)] - values[low])
    };
    let (n, m) = draws.first().map_or((0, 0), |d| d.shape());
    let tail = 0.5 * (1.0 - level);
    let all = |share: f64| (0..n).map(|i| (0..m).map(|j| quantile(i, j, share)).collect()).collect();
    WeightInterval { estimate: estimate.map(rows), lower: all(tail), upper: all(1.0 - tail) }
}

fn nearest(
    gains: &Gains,
    settings: &Settings,
    question: &Question<'_>,
    ctl: &Ctl,
) -> Result<Option<NearestOptimal>, Failure> {
    let Some(metric) = question.gain_covariance.and_then(|c| c.clone().cholesky()).map(|f| f.inverse()) else {
        return Ok(None);
    };
    let wanted = FitSettings {
        structure: settings.structure.clone(),
        condition_numbers: CONDITIONS.to_vec(),
        metric: Some(metric),
        seed: question.seed,
        ..FitSettings::default()
    };
    let found = match fit(gains, &wanted, ctl) {
        Ok(found) => found,
        Err(crate::inverse::fit::FitError::Stopped(stopped)) => return Err(stopped.into()),
        Err(_) => return Ok(None),
    };
    Ok(found.curve.last().map(|best| NearestOptimal {
        q: rows(&best.q),
        r: rows(&best.r),
        k: rows(&best.k),
        distance_squared: best.residual,
        p_value: (1.0 - chi_square_cdf(best.residual, (gains.states() * gains.ports()) as f64)).clamp(0.0, 1.0),
        condition_number: best.condition_number,
    }))
}
