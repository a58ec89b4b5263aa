//! Sizes of differences between people: Welch's interval, Hedges' g, and what so many people could have shown.

use super::random_effects::{Difference, satterthwaite};
use crate::num::distributions::{ln_gamma, student_t};
use crate::num::noncentral_t;
use crate::num::roots::root;
use crate::num::stats::{mean, standard_deviation};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A standardised difference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HedgesG {
    /// g: the difference of means over the pooled standard deviation of people, corrected for small samples.
    pub g: f64,
    /// The exact correction `J = Γ(ν/2)/(√(ν/2) Γ((ν − 1)/2))` that g has over d.
    pub correction: f64,
    /// The pooled standard deviation of people (with the errors of their values), in the unit of the metric.
    pub pooled_sd: f64,
    /// The 95 % interval of the uncorrected d, from the noncentral t distribution; null where the difference is so many
    /// standard deviations that it cannot be computed.
    #[schemars(with = "Option<Vec<f64>>")]
    pub d_interval95: Option<[f64; 2]>,
}

/// Hedges' g of `second − first` (Hedges 1981); `None` with fewer than three people, an empty group or no spread.
#[must_use]
pub fn hedges_g(first: &[f64], second: &[f64]) -> Option<HedgesG> {
    let (n, m) = (first.len() as f64, second.len() as f64);
    let degrees = n + m - 2.0;
    if first.is_empty() || second.is_empty() || degrees < 1.0 {
        return None;
    }
    let squares = |values: &[f64]| standard_deviation(values).map_or(0.0, |sd| sd * sd * (values.len() - 1) as f64);
    let pooled_sd = ((squares(first) + squares(second)) / degrees).sqrt();
    let d = (mean(second)? - mean(first)?) / pooled_sd;
    // With one degree of freedom J is 0: the corrected g says nothing.
    let correction = if degrees > 1.0 {
        (ln_gamma(0.5 * degrees) - ln_gamma(0.5 * (degrees - 1.0))).exp() / (0.5 * degrees).sqrt()
    } else {
        0.0
    };
    if !d.is_finite() {
        return None;
    }
    let scale = (1.0 / n + 1.0 / m).sqrt();
    let limit = |p: f64| noncentral_t::noncentrality(d / scale, degrees, p).map(|delta| delta * scale);
    let d_interval95 = limit(0.975).zip(limit(0.025)).map(|(low, high)| [low, high]);
    Some(HedgesG { g: correction * d, correction, pooled_sd, d_interval95 })
}

/// Welch's difference of plain means, `second − first`: people count equally, whatever their errors.
#[must_use]
pub fn welch(first: &[f64], second: &[f64]) -> Option<Difference> {
    let part = |values: &[f64]| {
        let n = values.len() as f64;
        Some((mean(values)?, standard_deviation(values)? / n.sqrt(), n - 1.0))
    };
    satterthwaite(part(first)?, part(second)?)
}

/// The true difference, in standard deviations of people, that a two-sided t test at 5 % with as many people finds in
/// 80 % of studies; `None` with fewer than three people or an empty group.
#[must_use]
pub fn detectable_difference(first: usize, second: usize) -> Option<f64> {
    let degrees = (first + second).checked_sub(2).filter(|d| *d > 0)? as f64;
    if first == 0 || second == 0 {
        return None;
    }
    let critical = student_t(0.95, degrees);
    let power = |delta: f64| {
        1.0 - noncentral_t::cdf(critical, degrees, delta) + noncentral_t::cdf(-critical, degrees, delta) - 0.8
    };
    let delta = root(power, 0.0, critical + 20.0 * (1.0 + critical / degrees.sqrt()))?;
    Some(delta * (1.0 / first as f64 + 1.0 / second as f64).sqrt())
}
