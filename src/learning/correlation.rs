//! Correlation of two quantities over trials.

use crate::num::stats::mean;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Fewer pairs than this always correlate.
const FEWEST: usize = 3;

/// How two quantities go together. Trials of one subject are not independent, so no p-value is given.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Correlation {
    /// Pairs.
    pub n: usize,
    /// Pearson's r (linear); null with fewer than three pairs or where a quantity is constant.
    pub pearson: Option<f64>,
    /// Spearman's ρ (monotonic; ties share their mean rank); null as before.
    pub spearman: Option<f64>,
}

/// Pearson's and Spearman's coefficients of the pairs.
#[must_use]
pub fn correlation(pairs: &[(f64, f64)]) -> Correlation {
    let n = pairs.len();
    let x: Vec<f64> = pairs.iter().map(|p| p.0).collect();
    let y: Vec<f64> = pairs.iter().map(|p| p.1).collect();
    let spearman = pearson(&ranks(&x), &ranks(&y));
    Correlation { n, pearson: pearson(&x, &y), spearman }
}

fn pearson(x: &[f64], y: &[f64]) -> Option<f64> {
    if x.len() < FEWEST {
        return None;
    }
    let (x_mean, y_mean) = (mean(x)?, mean(y)?);
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for (a, b) in x.iter().zip(y) {
        xx += (a - x_mean).powi(2);
        yy += (b - y_mean).powi(2);
        xy += (a - x_mean) * (b - y_mean);
    }
    let r = (xy / xx.sqrt()) / yy.sqrt();
    // Rounding may pass ±1 by a bit.
    r.is_finite().then(|| r.clamp(-1.0, 1.0))
}

/// Ranks from 1, ties sharing the mean of theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    let mut from = 0;
    while from < order.len() {
        let tied = order[from..].iter().take_while(|i| values[**i] == values[order[from]]).count();
        let shared = from as f64 + 0.5 * (tied as f64 + 1.0);
        for i in &order[from..from + tied] {
            ranks[*i] = shared;
        }
        from += tied;
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_of_known_samples() {
        // Sums by hand: Sxx = 10, Syy = 6, Sxy = 6.
        let pairs = [(1.0, 2.0), (2.0, 4.0), (3.0, 5.0), (4.0, 4.0), (5.0, 5.0)];
        let c = correlation(&pairs);
        assert!((c.pearson.unwrap() - 6.0 / 60.0_f64.sqrt()).abs() < 1e-15);
        // Ranks of y: 1, 2.5, 4.5, 2.5, 4.5; Syy = 9, Sxy = 7.
        assert!((c.spearman.unwrap() - 7.0 / 90.0_f64.sqrt()).abs() < 1e-15);
        assert_eq!(c.n, 5);
        let cubic: Vec<_> = (0..9).map(|i| (f64::from(i), f64::from(i).powi(3))).collect();
        let c = correlation(&cubic);
        assert!((c.spearman.unwrap() - 1.0).abs() < 1e-12 && c.pearson.unwrap() < 0.95, "{c:?}");
    }

    #[test]
    fn too_few_or_constant_values_have_none() {
        assert_eq!(correlation(&[(1.0, 2.0), (2.0, 3.0)]).pearson, None);
        let c = correlation(&[(1.0, 2.0), (1.0, 3.0), (1.0, 5.0)]);
        assert_eq!((c.pearson, c.spearman), (None, None));
    }
}
