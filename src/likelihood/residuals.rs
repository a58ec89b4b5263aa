//! Whether the residuals are the white noise that the intervals assume.

use crate::num::distributions::chi_square_cdf;
use nalgebra::DMatrix;

/// Lags at most.
const LAGS: usize = 20;

/// The residuals of one output, of all trials.
#[derive(Debug, Clone, PartialEq)]
pub struct Whiteness {
    /// Correlation of neighbouring residuals.
    pub lag_one: f64,
    /// Lags of the test.
    pub lags: usize,
    /// `Σ_trials N(N + 2) Σ_l r_l²/(N − l)` (Ljung and Box 1978).
    pub statistic: f64,
    /// Probability of a larger one if the noise is white.
    pub p_value: f64,
    /// `100 (1 − ‖y − ŷ‖/‖y − ȳ‖)`: the share of the output that is explained, in percent.
    pub fit_percent: f64,
}

/// For each output, from residuals and targets trial by trial (samples × outputs).
#[must_use]
pub fn whiteness(errors: &[DMatrix<f64>], targets: &[&DMatrix<f64>]) -> Vec<Whiteness> {
    let outputs = errors.first().map_or(0, |e| e.ncols());
    let one = |output: usize| {
        let shortest = errors.iter().map(|e| e.nrows()).min().unwrap_or(0);
        let lags = LAGS.min(shortest / 4).max(1);
        let (mut statistic, mut products, mut squares) = (0.0, 0.0, 0.0);
        let (mut left, mut spread) = (0.0, 0.0);
        for (error, target) in errors.iter().zip(targets) {
            let e = error.column(output);
            let n = e.len();
            let power = e.norm_squared().max(f64::MIN_POSITIVE);
            for lag in 1..=lags.min(n.saturating_sub(1)) {
                let r = (lag..n).map(|k| e[k] * e[k - lag]).sum::<f64>() / power;
                statistic += (n * (n + 2)) as f64 * r * r / (n - lag) as f64;
                if lag == 1 {
                    products += r * power;
                }
            }
            squares += power;
            let y = target.column(output);
            left += power;
            spread += y.add_scalar(-y.mean()).norm_squared();
        }
        Whiteness {
            lag_one: products / squares,
            lags,
            statistic,
            p_value: (1.0 - chi_square_cdf(statistic, (lags * errors.len()) as f64)).clamp(0.0, 1.0),
            fit_percent: if spread > 0.0 { 100.0 * (1.0 - (left / spread).sqrt()) } else { 0.0 },
        }
    };
    (0..outputs).map(one).collect()
}
