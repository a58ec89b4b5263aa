//! Frequency grids and Bode data.

use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Gain and phase over frequency.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Bode {
    /// Angular frequencies, rad/s.
    pub omega_rad_s: Vec<f64>,
    /// `20 log₁₀ |H|`; null where the response is zero or infinite (a zero or a pole on the frequency axis).
    pub gain_db: Vec<Option<f64>>,
    /// Phase in degrees, unwrapped along the grid from a first value in (−180, 180]: neighbours differ by at most 180;
    /// null where the gain is. A grid coarser than the phase turns can be unwrapped wrongly, as anywhere.
    pub phase_deg: Vec<Option<f64>>,
}

/// `count` frequencies from `from` to `to` (both included, rad/s), equally spaced on a logarithmic scale.
///
/// One frequency is `from`; the ends must be positive.
#[must_use]
pub fn log_grid(from: f64, to: f64, count: usize) -> Vec<f64> {
    let mut grid: Vec<f64> = linear_grid(from.ln(), to.ln(), count).into_iter().map(f64::exp).collect();
    // The ends are what was asked for, not what the exponential of a logarithm rounds to.
    if let Some(last) = grid.last_mut() {
        *last = to;
    }
    if let Some(first) = grid.first_mut() {
        *first = from;
    }
    grid
}

/// `count` frequencies from `from` to `to` (both included), equally spaced. One frequency is `from`.
#[must_use]
pub(crate) fn linear_grid(from: f64, to: f64, count: usize) -> Vec<f64> {
    let last = count.saturating_sub(1);
    (0..count)
        .map(|i| if i == last && i > 0 { to } else { from + (to - from) * i as f64 / last.max(1) as f64 })
        .collect()
}

/// Bode data of a frequency response sampled on a grid.
///
/// # Panics
/// If the two have different lengths, which is a mistake of the caller.
#[must_use]
pub fn bode(omega_rad_s: &[f64], response: &[Complex64]) -> Bode {
    assert_eq!(omega_rad_s.len(), response.len(), "a response and its grid");
    let exists = |h: &Complex64| h.is_finite() && h.norm() > 0.0;
    Bode {
        omega_rad_s: omega_rad_s.to_vec(),
        gain_db: response.iter().map(|h| exists(h).then(|| 20.0 * h.norm().log10())).collect(),
        phase_deg: unwrapped_phase_deg(response),
    }
}

/// The unwrapped phase in degrees of a frequency response along its grid; see [`Bode::phase_deg`].
#[must_use]
pub(crate) fn unwrapped_phase_deg(response: &[Complex64]) -> Vec<Option<f64>> {
    let mut before: Option<f64> = None;
    response
        .iter()
        .map(|h| {
            if !h.is_finite() || h.norm() == 0.0 {
                return None;
            }
            let wrapped = h.arg().to_degrees();
            let phase = before.map_or(wrapped, |b| wrapped - 360.0 * ((wrapped - b) / 360.0).round());
            before = Some(phase);
            Some(phase)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_phase_of_a_delay_is_a_line() {
        let omega = linear_grid(0.0, 40.0, 401);
        let response: Vec<Complex64> = omega.iter().map(|w| Complex64::from_polar(2.0, -0.5 * w)).collect();
        let bode = bode(&omega, &response);
        for (w, phase) in omega.iter().zip(&bode.phase_deg) {
            assert!((phase.unwrap() + (0.5 * w).to_degrees()).abs() < 1e-9);
        }
        assert!(bode.gain_db.iter().all(|g| (g.unwrap() - 20.0 * 2.0_f64.log10()).abs() < 1e-12));
    }

    #[test]
    fn what_does_not_exist_is_null_and_does_not_break_the_unwrapping() {
        let zero = Complex64::new(0.0, 0.0);
        let response = [Complex64::from_polar(1.0, 3.0), zero, Complex64::from_polar(1.0, -3.0)];
        let bode = bode(&[1.0, 2.0, 3.0], &response);
        assert_eq!(bode.gain_db[1], None);
        assert_eq!(bode.phase_deg[1], None);
        assert!((bode.phase_deg[2].unwrap() - (360.0 - 3.0_f64.to_degrees())).abs() < 1e-12);
    }

    #[test]
    fn grids_hit_both_ends() {
        assert_eq!(log_grid(0.1, 10.0, 3), [0.1, log_grid(0.1, 10.0, 3)[1], 10.0]);
        assert!((log_grid(0.1, 10.0, 3)[1] - 1.0).abs() < 1e-15);
        assert_eq!(linear_grid(1.0, 2.0, 3), [1.0, 1.5, 2.0]);
        assert_eq!(linear_grid(1.0, 2.0, 1), [1.0]);
        assert!(linear_grid(1.0, 2.0, 0).is_empty());
    }
}
