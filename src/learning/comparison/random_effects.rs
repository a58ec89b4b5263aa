//! Means over people whose values have errors: random effects by restricted maximum likelihood, intervals by Knapp and
//! Hartung.
//!
//! `y_i = β₀ (+ β₁ g_i) + u_i + e_i`, var e_i = v_i known, var u_i = τ². With `w_i = 1/(v_i + τ²)`, β is the weighted
//! least-squares estimate and τ² the root of the derivative of the restricted likelihood, `tr P = yᵀP²y`, `P = W − W X
//! (XᵀWX)⁻¹ XᵀW` (Raudenbush 2009). Standard errors are those of weighted least squares times the root of `q = Σ w
//! r²/(k − p)`, with Student's t of k − p degrees (Knapp & Hartung 2003): with few people z intervals hold far less
//! than they say.

use crate::num::distributions::{chi_square_cdf, chi_square_quantile, student_t, student_t_two_sided};
use crate::num::roots::root;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Values of τ² tried before the refinement, equally spaced on the log scale over this many decades.
const GRID: usize = 400;
const DECADES: f64 = 9.0;
/// Variances that differ by less than this share are equal, which has a closed form.
const EQUAL: f64 = 1e-12;

/// A coefficient with its interval.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "MeanOverPeople")]
pub struct Coefficient {
    /// The value, in the unit of the metric.
    pub value: f64,
    /// Its standard error after Knapp and Hartung.
    pub standard_error: f64,
    /// The 95 % interval with Student's t.
    pub interval95: [f64; 2],
    /// The interval with the Knapp–Hartung factor forced to 1 or more: wider, and only safe.
    pub interval95_factor_at_least_one: [f64; 2],
    /// The two-sided p-value of 0.
    pub p: f64,
    /// The standard error without the factor. Only for comparison: its z interval fails with few people.
    pub standard_error_plain: f64,
}

/// A fitted mean or difference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RandomEffects {
    /// People.
    pub k: usize,
    /// τ², the variance between people, in the squared unit of the metric. 0 does not say that people are alike: read
    /// the interval.
    pub tau2: f64,
    /// The 95 % interval of τ² from the Q profile (Viechtbauer 2007); null where the people differ less than their
    /// errors allow by chance (below the 2.5 % point), so that no τ² fits.
    #[schemars(with = "Option<Vec<f64>>")]
    pub tau2_interval95: Option<[f64; 2]>,
    /// Degrees of freedom.
    pub degrees_of_freedom: usize,
    /// The factor q.
    pub knapp_hartung_factor: f64,
    /// The mean; with a second one, the difference between groups that share τ².
    pub coefficients: Vec<Coefficient>,
    /// Cochran's Q, `Σ r²/v` around the fixed-effect fit; null where errors are not known.
    pub q: Option<f64>,
    /// The probability of a larger Q among people who are alike.
    pub q_p: Option<f64>,
}

/// Why there is no mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NoMean {
    /// Too few people.
    #[error("{found} people with a value, and {needed} are needed for an interval")]
    TooFew {
        /// People with a value.
        found: usize,
        /// People needed.
        needed: usize,
    },
    /// All values are equal, or, of a difference, all within each group.
    #[error("all people have the same value, which says nothing of the spread between people")]
    NoSpread,
    /// Not finite.
    #[error("the values are too large or too different in precision to be averaged")]
    NotFinite,
}

/// What weighted least squares gives for one τ².
struct Fit {
    weights: Vec<f64>,
    beta: [f64; 2],
    /// `(XᵀWX)⁻¹`.
    covariance: [[f64; 2]; 2],
    /// Half of the log determinant of `XᵀWX`.
    half_log_determinant: f64,
    /// `Σ w r²`.
    weighted_rss: f64,
    residuals: Vec<f64>,
}

struct Data<'a> {
    y: &'a [f64],
    v: &'a [f64],
    /// 0 or 1 for each person; `None` for a mean alone.
    group: Option<&'a [f64]>,
}

impl Data<'_> {
    fn columns(&self) -> usize {
        1 + usize::from(self.group.is_some())
    }

    fn indicator(&self, i: usize) -> f64 {
        self.group.map_or(0.0, |g| g[i])
    }

    fn fit(&self, tau2: f64) -> Fit {
        let weights: Vec<f64> = self.v.iter().map(|v| 1.0 / (v + tau2)).collect();
        let (mut a, mut b, mut d, mut p, mut q) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (i, w) in weights.iter().enumerate() {
            let g = self.indicator(i);
            a += w;
            b += w * g;
            d += w * g * g;
            p += w * self.y[i];
            q += w * g * self.y[i];
        }
        let (covariance, determinant) = if self.group.is_some() {
            let determinant = a * d - b * b;
            ([[d / determinant, -b / determinant], [-b / determinant, a / determinant]], determinant)
        } else {
            ([[1.0 / a, 0.0], [0.0, 0.0]], a)
        };
        let beta = covariance.map(|row| row[0] * p + row[1] * q);
        let residual = |(i, y): (usize, &f64)| y - beta[0] - beta[1] * self.indicator(i);
        let residuals: Vec<f64> = self.y.iter().enumerate().map(residual).collect();
        let weighted_rss = weights.iter().zip(&residuals).map(|(w, r)| w * r * r).sum();
        Fit { weights, beta, covariance, half_log_determinant: 0.5 * determinant.ln(), weighted_rss, residuals }
    }

    /// The restricted log-likelihood without its constant.
    fn likelihood(&self, tau2: f64) -> f64 {
        let fit = self.fit(tau2);
        0.5 * fit.weights.iter().map(|w| w.ln()).sum::<f64>() - fit.half_log_determinant - 0.5 * fit.weighted_rss
    }

    /// −2 times the derivative of the restricted likelihood: `tr P − yᵀP²y`.
    fn score(&self, tau2: f64) -> f64 {
        let Fit { weights, covariance, residuals, .. } = self.fit(tau2);
        let (mut sum, mut a, mut b, mut d, mut quadratic) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (i, w) in weights.iter().enumerate() {
            let g = self.indicator(i);
            sum += w;
            a += w * w;
            b += w * w * g;
            d += w * w * g * g;
            quadratic += (w * residuals[i]).powi(2);
        }
        let [[c00, c01], [_, c11]] = covariance;
        sum - (c00 * a + 2.0 * c01 * b + c11 * d) - quadratic
    }

    fn tau2(&self) -> f64 {
        let degrees = (self.y.len() - self.columns()) as f64;
        let (least, largest) = self.v.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), v| (a.min(*v), b.max(*v)));
        if largest - least <= EQUAL * largest {
            // Equal errors: the residual variance less that of the errors.
            let spread: f64 = self.fit(1.0).residuals.iter().map(|r| r * r).sum();
            return (spread / degrees - largest).max(0.0);
        }
        let spread: f64 = self.fit(largest).residuals.iter().map(|r| r * r).sum();
        let top = 10.0 * (spread / degrees + largest);
        // τ² = 0 is tried first; without an error for some person it is no candidate.
        let zero = (least > 0.0).then_some(0.0);
        let steps = (0..GRID).map(|i| top * 10.0_f64.powf(-DECADES * (1.0 - i as f64 / (GRID - 1) as f64)));
        let grid: Vec<f64> = zero.into_iter().chain(steps).collect();
        let likelihood: Vec<f64> = grid.iter().map(|t| self.likelihood(*t)).collect();
        let best = (0..grid.len()).max_by(|a, b| likelihood[*a].total_cmp(&likelihood[*b])).unwrap_or(0);
        if best == 0 && self.score(grid[0]) >= 0.0 {
            return grid[0];
        }
        let (low, high) = (grid[best.saturating_sub(1)], grid[(best + 1).min(grid.len() - 1)]);
        root(|t| self.score(t), low, high).unwrap_or(grid[best])
    }

    /// The τ² at which `Σ w r²`, which falls with τ², has the value.
    fn tau2_at(&self, q: f64) -> f64 {
        let excess = |t: f64| self.fit(t).weighted_rss - q;
        let least = self.v.iter().copied().fold(f64::INFINITY, f64::min);
        if least > 0.0 && excess(0.0) <= 0.0 {
            return 0.0;
        }
        let largest = self.v.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let (mut low, mut high) = (if least > 0.0 { 0.0 } else { 1e-12 * largest }, largest);
        while excess(high) > 0.0 && high < 1e300 {
            low = high;
            high *= 2.0;
        }
        root(excess, low, high).unwrap_or(low)
    }
}

/// The mean of `y` with error variances `v` (0 for all where they are not known: then the spread between people holds
/// the errors too), or with `group` (0 or 1) mean of the first and difference to the second with one τ².
///
/// # Errors
/// [`NoMean`].
///
/// # Panics
/// If the lists have different lengths, which is a mistake of the caller.
pub fn random_effects(y: &[f64], v: &[f64], group: Option<&[f64]>) -> Result<RandomEffects, NoMean> {
    assert!(y.len() == v.len() && group.is_none_or(|g| g.len() == y.len()));
    let data = Data { y, v, group };
    let columns = data.columns();
    let in_second = group.map_or(1, |g| g.iter().filter(|g| **g > 0.5).count());
    let in_first = if group.is_some() { y.len() - in_second } else { 1 };
    if y.len() <= columns || in_first == 0 || in_second == 0 {
        return Err(NoMean::TooFew { found: y.len(), needed: columns + 1 });
    }
    let errors_known = v.iter().any(|v| *v > 0.0);
    let tau2 = data.tau2();
    if tau2 == 0.0 && !errors_known {
        return Err(NoMean::NoSpread);
    }
    let fit = data.fit(tau2);
    let degrees = y.len() - columns;
    let factor = fit.weighted_rss / degrees as f64;
    let t = student_t(0.95, degrees as f64);
    let coefficient = |i: usize| {
        let (value, plain) = (fit.beta[i], fit.covariance[i][i].sqrt());
        let standard_error = plain * factor.sqrt();
        let safe = plain * factor.max(1.0).sqrt();
        Coefficient {
            value,
            standard_error,
            interval95: [value - t * standard_error, value + t * standard_error],
            interval95_factor_at_least_one: [value - t * safe, value + t * safe],
            p: student_t_two_sided(value / standard_error, degrees as f64),
            standard_error_plain: plain,
        }
    };
    let coefficients: Vec<Coefficient> = (0..columns).map(coefficient).collect();
    // Values that agree to the last digit leave no error, and an interval of no width would claim to know the mean.
    if coefficients.iter().any(|c| c.standard_error <= 1e-14 * c.value.abs()) {
        return Err(NoMean::NoSpread);
    }
    if coefficients.iter().any(|c| !(c.value.is_finite() && c.standard_error.is_finite() && c.p.is_finite())) {
        return Err(NoMean::NotFinite);
    }
    let all_have_errors = v.iter().all(|v| *v > 0.0);
    let q = all_have_errors.then(|| data.fit(0.0).weighted_rss);
    let [low, high] = [0.025, 0.975].map(|p| chi_square_quantile(p, degrees as f64));
    let tau2_interval95 = match q {
        Some(q) if q < low => None,
        _ => Some([data.tau2_at(high), data.tau2_at(low)]),
    };
    Ok(RandomEffects {
        k: y.len(),
        tau2,
        tau2_interval95,
        degrees_of_freedom: degrees,
        knapp_hartung_factor: factor,
        coefficients,
        q,
        q_p: q.map(|q| 1.0 - chi_square_cdf(q, degrees as f64)),
    })
}

/// A difference of two independent values with Satterthwaite's degrees of freedom.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "MeanDifference")]
pub struct Difference {
    /// The difference, in the unit of the metric.
    pub difference: f64,
    /// Its standard error.
    pub standard_error: f64,
    /// Satterthwaite's degrees of freedom.
    pub degrees_of_freedom: f64,
    /// The 95 % interval with Student's t.
    pub interval95: [f64; 2],
    /// The two-sided p-value of 0.
    pub p: f64,
}

/// `second − first` from values, standard errors and degrees of freedom.
pub(super) fn satterthwaite(first: (f64, f64, f64), second: (f64, f64, f64)) -> Option<Difference> {
    let (a, b) = (first.1 * first.1, second.1 * second.1);
    let standard_error = (a + b).sqrt();
    let degrees_of_freedom = (a + b).powi(2) / (a * a / first.2 + b * b / second.2);
    let difference = second.0 - first.0;
    if !(standard_error > 0.0 && degrees_of_freedom.is_finite() && difference.is_finite()) {
        return None;
    }
    let half = student_t(0.95, degrees_of_freedom) * standard_error;
    Some(Difference {
        difference,
        standard_error,
        degrees_of_freedom,
        interval95: [difference - half, difference + half],
        p: student_t_two_sided(difference / standard_error, degrees_of_freedom),
    })
}

impl Difference {
    /// The difference of two means, each with its own τ² and its Knapp–Hartung error.
    #[must_use]
    pub fn of_means(first: &RandomEffects, second: &RandomEffects) -> Option<Self> {
        let part = |m: &RandomEffects| {
            let mean = m.coefficients.first()?;
            Some((mean.value, mean.standard_error, m.degrees_of_freedom as f64))
        };
        satterthwaite(part(first)?, part(second)?)
    }

    /// The same with factors of 1 or more: the means are never surer than the errors of their values allow.
    #[must_use]
    pub fn of_means_with_factor_at_least_one(first: &RandomEffects, second: &RandomEffects) -> Option<Self> {
        let part = |m: &RandomEffects| {
            let mean = m.coefficients.first()?;
            let error = mean.standard_error_plain * m.knapp_hartung_factor.max(1.0).sqrt();
            Some((mean.value, error, m.degrees_of_freedom as f64))
        };
        satterthwaite(part(first)?, part(second)?)
    }
}
