//! A linear mixed model on single trials.
//!
//! `y = β₀ + β₁ x + β₂ g + β₃ g x + b₀ + b₁ x + ε` with `x = exp(−(k − 1)/τ)` (τ given), `(b₀, b₁)` of each person
//! normal with covariance Ψ, and ε normal with variance σ² equal in all trials; restricted maximum likelihood (Laird &
//! Ware 1982).
//!
//! With `Ψ = σ² L Lᵀ`, `V = I + Z L Lᵀ Zᵀ` and σ² concentrated out, minus twice the restricted log-likelihood is
//! `(n − p) ln(rss/(n − p)) + Σ ln det V + ln det XᵀV⁻¹X`. Its gradient in `L Lᵀ` is
//! `Σ [ZᵀV⁻¹Z − ZᵀV⁻¹X (XᵀV⁻¹X)⁻¹ XᵀV⁻¹Z − ZᵀV⁻¹r rᵀV⁻¹Z/σ²]`: function values alone would fix variances to six digits.

use crate::num::distributions::{student_t, student_t_two_sided};
use crate::num::newton;
use nalgebra::{Matrix2, Matrix4, Matrix4x2, Vector2, Vector4};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where the search starts: the entries of L.
const STARTS: [[f64; 3]; 3] = [[1.0, 0.0, 1.0], [2.0, -1.0, 1.0], [0.1, 0.0, 0.1]];
/// The fixed effects.
const FIXED: usize = 4;

/// A trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrialRow {
    /// The person's index.
    pub person: usize,
    /// Whether the person belongs to the second group.
    pub second: bool,
    /// The trial's number.
    pub k: f64,
    /// The value.
    pub value: f64,
}

/// The fitted model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MixedModel {
    /// τ in trials, shared by all people and taken for known.
    pub tau_trials: f64,
    /// β: asymptote and amplitude of the first group, and what the second has more of each.
    pub coefficients: Vec<f64>,
    /// Standard errors of β, `√diag σ²(XᵀV⁻¹X)⁻¹`.
    pub standard_errors: Vec<f64>,
    /// Covariance of β, by rows.
    pub covariance: Vec<Vec<f64>>,
    /// σ², in the squared unit of the metric.
    pub residual_variance: f64,
    /// Ψ: covariance between people of asymptote and amplitude, by rows.
    pub random_covariance: Vec<Vec<f64>>,
    /// Minus twice the restricted log-likelihood, without its constant.
    pub minus_twice_restricted_log_likelihood: f64,
    /// Trials.
    pub n: usize,
    /// People.
    pub people: usize,
}

/// Why there is no model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NoModel {
    /// Too little data.
    #[error("{people} people with {trials} trials do not determine four fixed effects and three variances")]
    TooLittle {
        /// People.
        people: usize,
        /// Trials.
        trials: usize,
    },
    /// The search found no maximum.
    #[error("the restricted likelihood has no maximum that the search could settle on")]
    NotConverged,
}

/// What a person's trials add to the sums.
struct Person {
    zz: Matrix2<f64>,
    /// XᵀZ.
    xz: Matrix4x2<f64>,
    zy: Vector2<f64>,
}

struct Sums {
    people: Vec<Person>,
    xx: Matrix4<f64>,
    xy: Vector4<f64>,
    yy: f64,
    n: usize,
}

struct Point {
    value: f64,
    gradient: Matrix2<f64>,
    beta: Vector4<f64>,
    sigma2: f64,
    covariance: Matrix4<f64>,
}

impl Sums {
    fn new(rows: &[TrialRow], people: usize, tau: f64) -> Self {
        let blank = || Person { zz: Matrix2::zeros(), xz: Matrix4x2::zeros(), zy: Vector2::zeros() };
        let mut sums = Self {
            people: (0..people).map(|_| blank()).collect(),
            xx: Matrix4::zeros(),
            xy: Vector4::zeros(),
            yy: 0.0,
            n: rows.len(),
        };
        for row in rows {
            let decay = (-(row.k - 1.0) / tau).exp();
            let z = Vector2::new(1.0, decay);
            let g = f64::from(row.second);
            let x = Vector4::new(1.0, decay, g, g * decay);
            let person = &mut sums.people[row.person];
            person.zz += z * z.transpose();
            person.xz += x * z.transpose();
            person.zy += z * row.value;
            sums.xx += x * x.transpose();
            sums.xy += x * row.value;
            sums.yy += row.value * row.value;
        }
        sums
    }

    fn at(&self, factor: &Matrix2<f64>) -> Option<Point> {
        let (mut a, mut b, mut total, mut log_determinant) = (self.xx, self.xy, self.yy, 0.0);
        let mut inner = Vec::with_capacity(self.people.len());
        for person in &self.people {
            let k = Matrix2::identity() + factor.transpose() * person.zz * factor;
            log_determinant += k.determinant().ln();
            let m = factor * k.try_inverse()? * factor.transpose();
            a -= person.xz * m * person.xz.transpose();
            b -= person.xz * m * person.zy;
            total -= person.zy.dot(&(m * person.zy));
            inner.push(m);
        }
        let cholesky = a.cholesky()?;
        let inverse = cholesky.inverse();
        let beta = inverse * b;
        let degrees = (self.n - FIXED) as f64;
        let rss = total - b.dot(&beta);
        let sigma2 = rss / degrees;
        if sigma2.is_nan() || sigma2 <= 0.0 {
            return None;
        }
        let value = degrees * sigma2.ln() + log_determinant + cholesky.determinant().ln();
        let mut gradient = Matrix2::zeros();
        for (person, m) in self.people.iter().zip(&inner) {
            // ZᵀV⁻¹ of Z, X and the residuals: ZᵀV⁻¹ = (I − ZᵀZ M) Zᵀ.
            let left = Matrix2::identity() - person.zz * m;
            let zx = left * person.xz.transpose();
            let zr = left * (person.zy - person.xz.transpose() * beta);
            gradient += left * person.zz - zx * inverse * zx.transpose() - zr * zr.transpose() / sigma2;
        }
        Some(Point { value, gradient, beta, sigma2, covariance: inverse * sigma2 })
    }
}

fn lower(q: &[f64]) -> Matrix2<f64> {
    Matrix2::new(q[0], 0.0, q[1], q[2])
}

/// Fits the model; people are numbered from 0.
///
/// # Errors
/// [`NoModel`].
///
/// # Panics
/// If a row names a person beyond `people`, which is a mistake of the caller.
pub fn mixed_model(rows: &[TrialRow], people: usize, tau_trials: f64) -> Result<MixedModel, NoModel> {
    let too_little = NoModel::TooLittle { people, trials: rows.len() };
    // With one trial each, the two random effects of a person cannot be told from the residual.
    if people < FIXED || rows.len() < people + FIXED {
        return Err(too_little);
    }
    let sums = Sums::new(rows, people, tau_trials);
    // The unit of y would decide how small a step of ln is; relative to σ² nothing depends on it.
    let evaluate = |q: &[f64]| {
        let factor = lower(q);
        let point = sums.at(&factor)?;
        let slope = point.gradient * factor * 2.0;
        Some((point.value, vec![slope[(0, 0)], slope[(1, 0)], slope[(1, 1)]]))
    };
    let found = STARTS.iter().filter_map(|start| newton::minimise(start, evaluate));
    let best = found.min_by(|a, b| a.value.total_cmp(&b.value)).ok_or(NoModel::NotConverged)?;
    let factor = lower(&best.at);
    let point = sums.at(&factor).ok_or(too_little)?;
    let random = factor * factor.transpose() * point.sigma2;
    Ok(MixedModel {
        tau_trials,
        coefficients: point.beta.iter().copied().collect(),
        standard_errors: point.covariance.diagonal().iter().map(|v| v.sqrt()).collect(),
        covariance: (0..FIXED).map(|i| point.covariance.row(i).iter().copied().collect()).collect(),
        residual_variance: point.sigma2,
        random_covariance: (0..2).map(|i| random.row(i).iter().copied().collect()).collect(),
        minus_twice_restricted_log_likelihood: point.value,
        n: rows.len(),
        people,
    })
}

/// A difference between groups from the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelDifference {
    /// The difference, in the unit of the metric.
    pub difference: f64,
    /// Its standard error.
    pub standard_error: f64,
    /// The 95 % interval with Student's t of `people − 2` degrees.
    pub interval95: [f64; 2],
    /// The two-sided p-value of 0.
    pub p: f64,
}

impl MixedModel {
    /// The difference between groups of `asymptotes` times the asymptote plus `decay` times the amplitude: at trial k
    /// these are 1 and `exp(−(k − 1)/τ)`.
    ///
    /// People and not trials are what is drawn, so that Student's t has as many degrees as there are people less the
    /// two means of a group.
    #[must_use]
    pub fn difference(&self, asymptotes: f64, decay: f64) -> Option<ModelDifference> {
        let [_, _, group, group_decay] = self.coefficients[..] else { return None };
        let c = |i: usize, j: usize| self.covariance.get(i).and_then(|row| row.get(j)).copied();
        let variance =
            asymptotes * asymptotes * c(2, 2)? + 2.0 * asymptotes * decay * c(2, 3)? + decay * decay * c(3, 3)?;
        let (difference, standard_error) = (asymptotes * group + decay * group_decay, variance.max(0.0).sqrt());
        let degrees = self.people.checked_sub(2)? as f64;
        if !(standard_error > 0.0 && degrees > 0.0) {
            return None;
        }
        let half = student_t(0.95, degrees) * standard_error;
        let interval95 = [difference - half, difference + half];
        let p = student_t_two_sided(difference / standard_error, degrees);
        Some(ModelDifference { difference, standard_error, interval95, p })
    }
}
