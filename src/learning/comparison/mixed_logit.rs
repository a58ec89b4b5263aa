//! Logistic regression with a random intercept, for counts that cluster in people.
//!
//! `logit p_i = β₀ + β₁ g_i + s z_i`, z_i standard normal, x_i of n_i trials binomial: maximum likelihood, the integral
//! over z_i by Gauss–Hermite quadrature centred at each person's mode (Pinheiro & Bates 1995). The gradient is the
//! posterior mean of the score over the same nodes.

use super::NotEstimated;
use crate::num::distributions::{NORMAL_95, chi_square_cdf};
use crate::num::{hermite, newton};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

const NODES: usize = 61;
/// Newton steps to a person's mode, which the log posterior has alone.
const MODE_STEPS: usize = 100;

/// A person's count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PersonCount {
    /// Trials that are.
    pub count: usize,
    /// Trials.
    pub of: usize,
    /// Whether the person belongs to the second group.
    pub second: bool,
}

/// The fitted regression.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MixedLogit {
    /// The log odds of the first group's median person.
    pub intercept: f64,
    /// The log odds ratio, second group to first, of people alike in their random intercept.
    pub group: f64,
    /// Its 95 % interval by its standard error (Wald): good with many people only.
    pub group_interval95: [f64; 2],
    /// The standard deviation between people, on the scale of log odds.
    pub sd: f64,
    /// The log-likelihood, without binomial coefficients and the normal constant.
    pub log_likelihood: f64,
    /// Twice the gain in log-likelihood by the group.
    pub likelihood_ratio: f64,
    /// Its p-value, chi-square with one degree: good with many people only.
    pub likelihood_ratio_p: f64,
}

/// Fits the regression.
///
/// # Errors
/// [`NotEstimated`]: in words, why there is no finite estimate.
pub fn mixed_logit(people: &[PersonCount]) -> Result<MixedLogit, NotEstimated> {
    for second in [false, true] {
        let group = people.iter().filter(|p| p.second == second);
        let (count, of) = group.fold((0, 0), |sum, p| (sum.0 + p.count, sum.1 + p.of));
        if count == 0 || count == of {
            let share = if count == 0 { "none" } else { "all" };
            return Err(NotEstimated(format!(
                "in one group {share} of the {of} trials are counted, so that the odds ratio has no finite \
                 estimate; read the permutation test"
            )));
        }
    }
    let rule = hermite::nodes(NODES);
    let start = [0.0, 0.0, 0.6];
    let full = newton::minimise(&start, |q| deviance(people, &rule, [q[0], q[1], q[2]]));
    let alone = newton::minimise(&[0.0, 0.6], |q| {
        let (value, gradient) = deviance(people, &rule, [q[0], 0.0, q[1]])?;
        Some((value, vec![gradient[0], gradient[2]]))
    });
    let (Some(full), Some(alone)) = (full, alone) else {
        return Err(NotEstimated("the likelihood has no maximum that the search could settle on".to_owned()));
    };
    let variance = full.hessian.clone().cholesky().map(|factor| factor.inverse()[(1, 1)]);
    let Some(half) = variance.map(|v| NORMAL_95 * v.sqrt()).filter(|h| h.is_finite()) else {
        return Err(NotEstimated("the information at the maximum is singular".to_owned()));
    };
    let [intercept, group, sd] = full.at[..] else { unreachable!("three parameters") };
    let likelihood_ratio = (2.0 * (alone.value - full.value)).max(0.0);
    Ok(MixedLogit {
        intercept,
        group,
        group_interval95: [group - half, group + half],
        sd: sd.abs(),
        log_likelihood: -full.value,
        likelihood_ratio,
        likelihood_ratio_p: 1.0 - chi_square_cdf(likelihood_ratio, 1.0),
    })
}

fn logistic(eta: f64) -> f64 {
    if eta >= 0.0 { 1.0 / (1.0 + (-eta).exp()) } else { eta.exp() / (1.0 + eta.exp()) }
}

/// `ln(1 + e^η)`.
fn softplus(eta: f64) -> f64 {
    eta.max(0.0) + (-eta.abs()).exp().ln_1p()
}

/// Minus the log-likelihood, and its gradient by (β₀, β₁, s).
fn deviance(people: &[PersonCount], rule: &[(f64, f64)], [b0, b1, s]: [f64; 3]) -> Option<(f64, Vec<f64>)> {
    let mut value = 0.0;
    let mut gradient = [0.0; 3];
    for person in people {
        let (x, n, g) = (person.count as f64, person.of as f64, f64::from(person.second));
        let eta = b0 + b1 * g;
        let curvature = |p: f64| n * s * s * p * (1.0 - p) + 1.0;
        let mut mode = 0.0_f64;
        for _ in 0..MODE_STEPS {
            let p = logistic(eta + s * mode);
            // The curvature is least where p is near 0 or 1: a step longer than that of p = ½ could overshoot.
            let step = ((s * (x - n * p) - mode) / curvature(p)).clamp(-3.0, 3.0);
            mode += step;
            if step.abs() < 1e-13 * (1.0 + mode.abs()) {
                break;
            }
        }
        let width = 1.0 / curvature(logistic(eta + s * mode)).sqrt();
        let terms: Vec<(f64, f64, f64)> = rule
            .iter()
            .map(|(t, w)| {
                let z = mode + std::f64::consts::SQRT_2 * width * t;
                let e = eta + s * z;
                (x * e - n * softplus(e) - 0.5 * z * z + t * t + w.ln(), x - n * logistic(e), z)
            })
            .collect();
        let largest = terms.iter().fold(f64::NEG_INFINITY, |most, t| most.max(t.0));
        let (mut sum, mut by_intercept, mut by_sd) = (0.0, 0.0, 0.0);
        for (log, score, z) in &terms {
            let weight = (log - largest).exp();
            sum += weight;
            by_intercept += weight * score;
            by_sd += weight * score * z;
        }
        value -= largest + sum.ln() + width.ln();
        gradient[0] -= by_intercept / sum;
        gradient[1] -= g * by_intercept / sum;
        gradient[2] -= by_sd / sum;
    }
    value.is_finite().then(|| (value, gradient.to_vec()))
}
