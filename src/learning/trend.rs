//! First against last trials, and an exponential description of what lies between.

use crate::num::stats::mean;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Fewer points than this carry no exponential: three parameters would go through three points whatever they are.
const FEWEST_FOR_FIT: usize = 5;
/// Rates searched, per trial, on a logarithmic grid before the refinement.
const RATES: usize = 120;

/// How a quantity changed over the trials of a curve. A description: nothing here is a test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Trend {
    /// Trials that have the quantity.
    pub n: usize,
    /// Its first value.
    pub first: Option<f64>,
    /// Its last value; null where there is only one.
    pub last: Option<f64>,
    /// How many trials at each end the following means take; null where there are fewer than two trials.
    pub averaged: Option<usize>,
    /// Mean over the first ones.
    pub mean_of_first: Option<f64>,
    /// Mean over the last ones.
    pub mean_of_last: Option<f64>,
    /// Mean of the last over mean of the first; null where that is not finite.
    pub ratio: Option<f64>,
    /// A least-squares exponential; null with fewer than five trials or none that differ.
    pub exponential: Option<ExponentialFit>,
}

/// `value ≈ asymptote + amplitude · exp(−rate (position − first position))`, by least squares.
///
/// A description of the points only. Human learning curves often follow no exponential: read `r_squared` first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ExponentialFit {
    /// The value approached.
    pub asymptote: f64,
    /// The distance from it at the first trial.
    pub amplitude: f64,
    /// Per trial.
    pub rate_per_trial: f64,
    /// Share of the variance over trials that the curve describes.
    pub r_squared: f64,
    /// Whether the rate lies at the edge of the searched range (`0.1/span` to 5 per trial): then only the shape of a
    /// line or of a single step was found, and asymptote and rate mean nothing on their own.
    pub rate_at_bound: bool,
}

/// The trend of `(position, value)` in order of position, averaging over at most `ends` trials at each end.
#[must_use]
pub fn trend(series: &[(f64, f64)], ends: usize) -> Trend {
    let values: Vec<f64> = series.iter().map(|p| p.1).collect();
    let n = values.len();
    let averaged = (n >= 2).then(|| ends.min(n / 2).max(1));
    let mean_of_first = averaged.and_then(|k| mean(&values[..k]));
    let mean_of_last = averaged.and_then(|k| mean(&values[n - k..]));
    let ratio = mean_of_first.zip(mean_of_last).map(|(first, last)| last / first).filter(|r| r.is_finite());
    Trend {
        n,
        first: values.first().copied(),
        last: if n >= 2 { values.last().copied() } else { None },
        averaged,
        mean_of_first,
        mean_of_last,
        ratio,
        exponential: exponential(series),
    }
}

/// For each rate the other two parameters are a linear least-squares problem, so only the rate is searched: on a grid
/// first, since the residual can have several minima, then by golden section around the best.
fn exponential(series: &[(f64, f64)]) -> Option<ExponentialFit> {
    if series.len() < FEWEST_FOR_FIT {
        return None;
    }
    let (start, end) = (series.first()?.0, series.last()?.0);
    let span = end - start;
    let centre = mean(&series.iter().map(|p| p.1).collect::<Vec<_>>())?;
    let total: f64 = series.iter().map(|p| (p.1 - centre).powi(2)).sum();
    // Values equal to rounding have no shape.
    if span <= 0.0 || total <= f64::EPSILON * centre * centre {
        return None;
    }
    let (low, high) = ((0.1 / span).ln(), 5.0_f64.ln().max((1.0 / span).ln()));
    let residual = |log_rate: f64| amplitude_and_residual(series, start, log_rate.exp()).map_or(total, |f| f.2);
    let grid = |i: usize| low + (high - low) * i as f64 / (RATES - 1) as f64;
    let best = (0..RATES).min_by(|a, b| residual(grid(*a)).total_cmp(&residual(grid(*b))))?;
    let (mut a, mut b) = (grid(best.saturating_sub(1)), grid((best + 1).min(RATES - 1)));
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    for _ in 0..60 {
        let (c, d) = (b - golden * (b - a), a + golden * (b - a));
        if residual(c) <= residual(d) { b = d } else { a = c }
    }
    let log_rate = 0.5 * (a + b);
    let (asymptote, amplitude, remaining) = amplitude_and_residual(series, start, log_rate.exp())?;
    let margin = 1e-3 * (high - low);
    Some(ExponentialFit {
        asymptote,
        amplitude,
        rate_per_trial: log_rate.exp(),
        r_squared: 1.0 - remaining / total,
        rate_at_bound: log_rate < low + margin || log_rate > high - margin,
    })
    .filter(|f| [f.asymptote, f.amplitude, f.r_squared].iter().all(|v| v.is_finite()))
}

/// Asymptote, amplitude and squared residual for a fixed rate.
fn amplitude_and_residual(series: &[(f64, f64)], start: f64, rate: f64) -> Option<(f64, f64, f64)> {
    let n = series.len() as f64;
    let shape = |x: f64| (-rate * (x - start)).exp();
    let (mut x_mean, mut y_mean) = (0.0, 0.0);
    for (x, y) in series {
        x_mean += shape(*x) / n;
        y_mean += y / n;
    }
    let (mut xx, mut xy) = (0.0, 0.0);
    for (x, y) in series {
        xx += (shape(*x) - x_mean).powi(2);
        xy += (shape(*x) - x_mean) * (y - y_mean);
    }
    if xx <= 0.0 {
        return None;
    }
    let amplitude = xy / xx;
    let asymptote = y_mean - amplitude * x_mean;
    let residual = series.iter().map(|(x, y)| (y - asymptote - amplitude * shape(*x)).powi(2)).sum();
    Some((asymptote, amplitude, residual))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exponential_is_recovered() {
        let series: Vec<(f64, f64)> =
            (1..=40).map(|i| (f64::from(i), 0.3 + 0.9 * (-0.12 * f64::from(i - 1)).exp())).collect();
        let fit = trend(&series, 5).exponential.unwrap();
        assert!((fit.asymptote - 0.3).abs() < 1e-5, "{fit:?}");
        assert!((fit.amplitude - 0.9).abs() < 1e-5);
        assert!((fit.rate_per_trial - 0.12).abs() < 1e-5);
        assert!(fit.r_squared > 1.0 - 1e-9 && !fit.rate_at_bound);
    }

    #[test]
    fn noise_without_a_trend_has_a_low_r_squared_and_a_line_sits_at_the_bound() {
        let zigzag: Vec<(f64, f64)> = (0..20).map(|i| (f64::from(i), f64::from(i % 2))).collect();
        assert!(trend(&zigzag, 5).exponential.unwrap().r_squared < 0.2);
        let line: Vec<(f64, f64)> = (0..20).map(|i| (f64::from(i), 5.0 - f64::from(i))).collect();
        assert!(trend(&line, 5).exponential.unwrap().rate_at_bound);
    }

    #[test]
    fn short_and_constant_series() {
        let t = trend(&[], 5);
        assert_eq!((t.n, t.first, t.last, t.averaged, t.exponential), (0, None, None, None, None));
        let t = trend(&[(1.0, 4.0)], 5);
        assert_eq!((t.n, t.first, t.last, t.mean_of_first), (1, Some(4.0), None, None));
        let t = trend(&[(1.0, 4.0), (2.0, 3.0), (3.0, 2.0)], 5);
        assert_eq!((t.averaged, t.mean_of_first, t.mean_of_last, t.ratio), (Some(1), Some(4.0), Some(2.0), Some(0.5)));
        let constant: Vec<(f64, f64)> = (0..9).map(|i| (f64::from(i), 0.1)).collect();
        assert_eq!(trend(&constant, 5).exponential, None);
        let zeros: Vec<(f64, f64)> = (0..9).map(|i| (f64::from(i), 0.0)).collect();
        assert_eq!(trend(&zeros, 5).ratio, None);
    }
}
