//! The variance of an averaged response; the formulas are those of the parent module.

use super::settings::{Average, Window};
use num_complex::Complex64;

/// A stimulus is dark on a line where it has less than this fraction of the power of its strongest line.
const DARK: f64 = 1e-6;

/// How far from a line its noise is looked for, in lines.
const REACH: usize = 16;

/// How many dark lines are used at most, and are needed at least.
const DARK_LINES: std::ops::RangeInclusive<usize> = 4..=12;

/// The averaged response of the pairs `(R, Y)`, and its variance where there are two pairs or more.
///
/// `None` where no pair has an input. Pairs without one (`R = 0`) count for nothing.
pub(super) fn average(pairs: &[(Complex64, Complex64)], how: Average) -> Option<(Complex64, Option<f64>)> {
    let n = pairs.len() as f64;
    match how {
        Average::Ratios => {
            let ratios: Vec<Complex64> = pairs.iter().map(|(r, y)| y / r).collect();
            if ratios.is_empty() {
                return None;
            }
            let h = ratios.iter().sum::<Complex64>() / n;
            let scatter: f64 = ratios.iter().map(|ratio| (ratio - h).norm_sqr()).sum();
            Some((h, (pairs.len() >= 2).then(|| scatter / (n * (n - 1.0)))))
        }
        Average::CrossSpectra => {
            let power: f64 = pairs.iter().map(|(r, _)| r.norm_sqr()).sum();
            if power <= 0.0 {
                return None;
            }
            let h = pairs.iter().map(|(r, y)| r.conj() * y).sum::<Complex64>() / power;
            let residual: f64 = pairs.iter().map(|(r, y)| (y - h * r).norm_sqr()).sum();
            Some((h, (pairs.len() >= 2).then(|| residual / ((n - 1.0) * power))))
        }
    }
}

/// The share of the output's power that the averaged response explains, `|Σ R̄Y|² / (Σ|R|² Σ|Y|²)`; `None` of fewer
/// than two pairs (of which it is 1, whatever they are) or of an output without power.
pub(super) fn coherence(pairs: &[(Complex64, Complex64)]) -> Option<f64> {
    let cross: Complex64 = pairs.iter().map(|(r, y)| r.conj() * y).sum();
    let input: f64 = pairs.iter().map(|(r, _)| r.norm_sqr()).sum();
    let output: f64 = pairs.iter().map(|(_, y)| y.norm_sqr()).sum();
    (pairs.len() >= 2 && input > 0.0 && output > 0.0).then(|| (cross.norm_sqr() / (input * output)).min(1.0))
}

/// Grid lines on which none of the stimuli has power, spread by the window included.
pub(super) fn dark_lines(stimuli_power: &[Vec<f64>], window: Window) -> Vec<bool> {
    let lines = stimuli_power.first().map_or(0, Vec::len);
    let mut dark = vec![true; lines];
    for power in stimuli_power {
        let threshold = DARK * power.iter().copied().fold(0.0, f64::max);
        for (k, _) in power.iter().enumerate().filter(|(_, p)| **p > threshold) {
            let from = k.saturating_sub(window.half_width());
            let to = (k + window.half_width()).min(lines - 1);
            dark[from..=to].fill(false);
        }
    }
    if let Some(zero) = dark.first_mut() {
        // Means and slow drifts live here; they are no sample of the noise at other lines.
        *zero = false;
    }
    dark
}

/// The mean of `|Y|²` over the dark lines nearest to line `k`; `None` where there are fewer than four nearby.
pub(super) fn noise_power(output: &[Complex64], dark: &[bool], k: usize) -> Option<f64> {
    let mut sum = 0.0;
    let mut count = 0;
    for distance in 1..=REACH {
        for line in [k.checked_sub(distance), k.checked_add(distance)].into_iter().flatten() {
            if dark.get(line) == Some(&true) && count < *DARK_LINES.end() {
                sum += output[line].norm_sqr();
                count += 1;
            }
        }
    }
    (count >= *DARK_LINES.start()).then(|| sum / count as f64)
}
