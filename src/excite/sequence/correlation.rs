//! How a signal resembles itself later, and how well the past predicts it.

use crate::ctl::{Ctl, Stopped};
use crate::num::fourier;
use crate::num::linalg::{self, NoConvergence};
use nalgebra::{DMatrix, DVector};

/// Values of the past that a prediction uses.
const TAPS: usize = 24;

/// Singular values below this share of the largest are dependence, not information.
const DEPENDENT: f64 = 1e-10;

/// `R(j) = Σ_k x_k x_{k+j}/N` for j = 0 … `lags − 1` of a periodic signal, given one period of N samples; j runs
/// around.
///
/// # Errors
/// [`Stopped`].
pub fn periodic_autocorrelation(period: &[f64], lags: usize, ctl: &Ctl) -> Result<Vec<f64>, Stopped> {
    let n = period.len();
    if n == 0 {
        return Ok(Vec::new());
    }
    let lines = fourier::real_transform_in_parts(period, ctl)?;
    let power: Vec<_> = lines.iter().map(|x| (x * x.conj()).re.into()).collect();
    let one = fourier::inverse_real_in_parts(&power, n, ctl)?;
    Ok((0..lags).map(|j| one[j % n] / n as f64).collect())
}

/// `R(j) = Σ_{k ≥ j} x_k x_{k−j}` for j = 0 … `lags − 1`, the sum over what the record holds (Priess 2015, equation
/// 5.8), not divided by the number of terms.
///
/// # Errors
/// [`Stopped`].
pub fn autocorrelation(record: &[f64], lags: usize, ctl: &Ctl) -> Result<Vec<f64>, Stopped> {
    let n = record.len();
    if n == 0 {
        return Ok(vec![0.0; lags]);
    }
    // Zeros behind the record keep its ends from meeting.
    let mut padded = record.to_vec();
    padded.resize((2 * n).next_power_of_two(), 0.0);
    let around = periodic_autocorrelation(&padded, lags.min(n), ctl)?;
    let scale = padded.len() as f64;
    Ok((0..lags).map(|j| around.get(j).map_or(0.0, |r| r * scale)).collect())
}

/// The share of a signal's variance that the best linear predictor explains `horizon` samples ahead, from 24 values of
/// the past that are `spacing` samples apart: `R² = ρᵀ P⁻¹ ρ / R(0)` with `P_ij = R((i − j)·spacing)` and `ρ_i =
/// R(horizon + i·spacing)`.
///
/// `around` is the autocorrelation of the signal without its mean, for at least `horizon + 23·spacing + 1` lags. 0 for
/// a signal that nothing predicts, 1 for a sinusoid; 0 for a constant.
///
/// # Errors
/// [`NoConvergence`] where the singular values cannot be found.
///
/// # Panics
/// If there are too few lags, which is a mistake of the caller.
pub fn predictability(around: &[f64], horizon: usize, spacing: usize) -> Result<f64, NoConvergence> {
    assert!(around.len() > lags_needed(horizon, spacing) - 1, "{} lags of an autocorrelation", around.len());
    let has_power = around[0] > 0.0;
    if !has_power {
        return Ok(0.0);
    }
    let gram = DMatrix::from_fn(TAPS, TAPS, |i, j| around[i.abs_diff(j) * spacing] / around[0]);
    let cross = DVector::from_fn(TAPS, |i, _| around[horizon + i * spacing] / around[0]);
    let (u, sigma, _) = linalg::svd(&gram)?;
    let projected = u.tr_mul(&cross);
    let explained: f64 =
        projected.iter().zip(&sigma).filter(|(_, s)| **s > DEPENDENT * sigma[0]).map(|(p, s)| p * p / s).sum();
    Ok(explained.clamp(0.0, 1.0))
}

/// Lags that [`predictability`] looks at.
#[must_use]
pub fn lags_needed(horizon: usize, spacing: usize) -> usize {
    horizon + (TAPS - 1) * spacing + 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::rng::stream;
    use rand::RngExt;

    #[test]
    fn the_fast_sums_are_the_sums() {
        let mut random = stream(5, "correlation");
        for n in [7_usize, 60, 242] {
            let x: Vec<f64> = (0..n).map(|_| random.random::<f64>() - 0.4).collect();
            let ctl = Ctl::new();
            let around = periodic_autocorrelation(&x, n, &ctl).unwrap();
            let along = autocorrelation(&x, n + 3, &ctl).unwrap();
            for j in 0..n {
                let circular = (0..n).map(|k| x[k] * x[(k + j) % n]).sum::<f64>() / n as f64;
                let open: f64 = (j..n).map(|k| x[k] * x[k - j]).sum();
                assert!((around[j] - circular).abs() < 1e-14 && (along[j] - open).abs() < 1e-12);
            }
            assert_eq!(along[n..], [0.0; 3]);
        }
    }

    #[test]
    fn a_sinusoid_is_predicted_and_white_noise_is_not() {
        let n = 1000;
        let sine: Vec<f64> = (0..n).map(|k| (0.02 * std::f64::consts::PI * f64::from(k)).sin()).collect();
        let r = periodic_autocorrelation(&sine, 500, &Ctl::new()).unwrap();
        assert!(predictability(&r, 7, 3).unwrap() > 1.0 - 1e-6);
        let mut white = vec![0.0; 500];
        white[0] = 1.0;
        assert_eq!(predictability(&white, 7, 3).unwrap(), 0.0);
        // A first-order process with ρ(j) = a^j has R² = a^{2h}, however the past is spaced.
        let a: f64 = 0.97;
        let r: Vec<f64> = (0..500).map(|j| a.powi(j)).collect();
        assert!((predictability(&r, 10, 4).unwrap() - a.powi(20)).abs() < 1e-9);
        assert_eq!(predictability(&[0.0; 500], 10, 4).unwrap(), 0.0);
    }
}
