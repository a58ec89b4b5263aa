//! Which lines of an estimate are good for something.

use super::job::Removal;
use super::removal::Local;
use num_complex::Complex64;

/// A line is usable if its error is at most this share of its response, or of the median response where its own is
/// smaller.
const USABLE: f64 = 0.2;

/// Nor is it where the data do not tell the response from the transient, and this share of it may be transient.
const UNTOLD: f64 = 0.02;

/// Line by line, as [`Estimate::usable`](super::Estimate::usable) says.
pub(super) fn usable(
    h: &[Option<Complex64>],
    variance: &[Option<f64>],
    leakage: &[Option<f64>],
    local: &[Option<Local>],
    removal: Removal,
) -> Vec<bool> {
    let mut sizes: Vec<f64> = h.iter().flatten().map(|h| h.norm()).collect();
    sizes.sort_by(f64::total_cmp);
    let typical = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
    let is_usable = |i: usize| {
        let Some(h) = h[i] else { return false };
        let (size, left) = (h.norm().max(typical), leakage[i].unwrap_or(0.0));
        let is_told = local[i].as_ref().is_none_or(|line| line.is_told) || removal != Removal::Local;
        let error = variance[i].unwrap_or(0.0) + left * left;
        error.sqrt() <= USABLE * size && (is_told || left <= UNTOLD * size)
    };
    (0..h.len()).map(is_usable).collect()
}
