//! The columns of the feedforward.
//!
//! A command that ends at half a hertz determines few numbers of a response sampled at 50 Hz: its lags are nearly
//! collinear, and rounding of a recorded command to five digits hides all of them but four or five. The weights of the
//! lags are therefore polynomials in the lag, over a window from `ahead` samples in the future to `behind` in the past,
//! which averages that rounding away. A window that has samples on both sides of the present is no claim of
//! a look-ahead: at these frequencies a look-ahead and a derivative are the same.
//!
//! Whether the feedforward is the inverse of the plant is the question, and the poles of that inverse are the plant's
//! zeros. Those that are stable and slow reach beyond any window, so there are columns with these poles too: the
//! command divided by Z(q), the polynomial of the slow stable zeros, at as many lags as there are zeros.

use super::lags::Lags;
use super::orthonormal::orthonormalise;
use super::tall::blocks;
use crate::control::System;
use crate::ctl::{Ctl, Stopped};
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use std::ops::Range;

/// A zero is slow when it forgets less than this share of its state in a sample.
const SLOW: f64 = 0.5;

/// The columns of the feedforward.
#[derive(Debug, Clone, PartialEq)]
pub struct FeedforwardBasis {
    ahead: usize,
    /// Weights of the lags −ahead … behind − 1, one column a term: orthonormal polynomials.
    weights: DMatrix<f64>,
    /// Z in ascending powers of q⁻¹, `[1]` without slow zeros.
    zeros: Vec<f64>,
}

impl FeedforwardBasis {
    /// The basis of these lags, with the slow stable zeros of a plant as poles.
    #[must_use]
    pub fn new(lags: &Lags, zeros: Vec<f64>) -> Self {
        let (window, terms) = (lags.window(), lags.terms);
        let place = |i: usize| if window < 2 { 0.0 } else { 2.0 * i as f64 / (window - 1) as f64 - 1.0 };
        // Legendre polynomials, so that no digits are lost before the columns are made orthonormal on the samples.
        let mut columns = DMatrix::zeros(window, terms);
        for i in 0..window {
            let (mut before, mut here) = (0.0, 1.0);
            for degree in 0..terms {
                columns[(i, degree)] = here;
                let n = degree as f64;
                (before, here) = (here, ((2.0 * n + 1.0) * place(i) * here - n * before) / (n + 1.0));
            }
        }
        // A few hundred rows: nothing that must be stopped.
        let weights = orthonormalise(&[&columns], &Ctl::new()).map_or(columns, |found| found.q);
        Self { ahead: lags.ahead, weights, zeros }
    }

    /// The number of columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.weights.ncols() + self.poles()
    }

    /// How many poles the columns have.
    #[must_use]
    pub fn poles(&self) -> usize {
        self.zeros.len() - 1
    }

    /// The columns for the rows of a command. What was before its first sample is taken as zero, as in a trial that
    /// starts from rest.
    ///
    /// # Errors
    /// [`Stopped`].
    pub(super) fn design(&self, command: &[f64], rows: &Range<usize>, ctl: &Ctl) -> Result<DMatrix<f64>, Stopped> {
        let terms = self.weights.ncols();
        let slow = recursion(&self.zeros, command);
        let mut design = DMatrix::zeros(rows.len(), self.columns());
        for (j, mut column) in design.column_iter_mut().enumerate() {
            for block in blocks(rows.len()) {
                ctl.check()?;
                for i in block {
                    let t = rows.start + i;
                    column[i] = if j < terms {
                        // Sample t + ahead has lag −ahead, the first weight.
                        let newest = t + self.ahead;
                        self.weights.column(j).iter().enumerate().map(|(k, w)| w * command[newest - k]).sum()
                    } else {
                        slow[t - (j - terms)]
                    };
                }
            }
        }
        Ok(design)
    }

    /// The response of each column, `Σ_k w_k e^{−jω(k − ahead)T}` or `e^{−jωkT}/Z`, at ω T in rad.
    #[must_use]
    pub(super) fn responses(&self, omega_t: f64) -> DVector<Complex64> {
        let (window, terms) = self.weights.shape();
        let turn = |lag: f64| Complex64::from_polar(1.0, -omega_t * lag);
        let lags: Vec<Complex64> = (0..window).map(|k| turn(k as f64 - self.ahead as f64)).collect();
        let z: Complex64 = self.zeros.iter().enumerate().map(|(k, c)| *c * turn(k as f64)).sum();
        DVector::from_fn(self.columns(), |j, _| {
            if j < terms {
                lags.iter().enumerate().map(|(k, lag)| *lag * self.weights[(k, j)]).sum()
            } else {
                turn((j - terms) as f64) / z
            }
        })
    }

    /// The weights of the lags −ahead … behind − 1, and those of the command divided by Z at the lags 0, 1, ….
    #[must_use]
    pub fn lag_weights(&self, coefficients: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let terms = self.weights.ncols();
        let window = &self.weights * DVector::from_column_slice(&coefficients[..terms]);
        (window.iter().copied().collect(), coefficients[terms..].to_vec())
    }

    /// The most samples ahead.
    #[must_use]
    pub fn ahead(&self) -> usize {
        self.ahead
    }

    /// Z in ascending powers of q⁻¹.
    #[must_use]
    pub fn zeros(&self) -> &[f64] {
        &self.zeros
    }
}

/// `x/Z(q)` from rest; Z in ascending powers of q⁻¹ with a leading 1.
pub(super) fn recursion(z: &[f64], x: &[f64]) -> Vec<f64> {
    let mut out: Vec<f64> = Vec::with_capacity(x.len());
    for (t, value) in x.iter().enumerate() {
        let past: f64 = z.iter().enumerate().skip(1).take(t).map(|(k, c)| c * out[t - k]).sum();
        out.push(value - past);
    }
    out
}

/// The polynomial Z of the plant's slow stable zeros, in ascending powers of q⁻¹ at the sample time: `[1]` where there
/// are none, or where the plant's zeros cannot be computed.
#[must_use]
pub fn slow_zeros(plant: &System, sample_time_s: f64) -> Vec<f64> {
    let zeros = plant.zeros().unwrap_or_default();
    let sampled = zeros.into_iter().filter_map(|zero| match plant.sample_time_s() {
        None => (zero.re < 0.0).then(|| (zero * sample_time_s).exp()),
        // Of a sampled plant at its own rate, brought to the working one.
        Some(period) if zero.norm() > 0.0 => Some((zero.ln() * (sample_time_s / period)).exp()),
        Some(_) => None,
    });
    // A real zero on the negative axis comes from sampling, and its logarithm is no rate.
    let slow: Vec<Complex64> =
        sampled.filter(|z| z.norm() < 1.0 && z.norm() > SLOW && z.re > 0.0 && z.re.is_finite()).collect();
    let mut polynomial = vec![Complex64::from(1.0)];
    for zero in slow {
        let mut next = polynomial.clone();
        next.push(Complex64::default());
        for (k, c) in polynomial.iter().enumerate() {
            next[k + 1] -= zero * c;
        }
        polynomial = next;
    }
    polynomial.into_iter().map(|c| c.re).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Continuous, TransferFunction};

    fn lags() -> Lags {
        Lags { autoregressive: 2, moving_average: 0, feedback: [4, 17], ahead: 3, behind: 9, terms: 5 }
    }

    #[test]
    fn columns_answer_a_sinusoid_as_their_responses_say() {
        let basis = FeedforwardBasis::new(&lags(), vec![1.0, -1.7, 0.73]);
        let omega_t = 0.11;
        let wave: Vec<f64> = (0..900).map(|t| (omega_t * f64::from(t)).cos()).collect();
        // Late rows, so that the poles have forgotten the start.
        let rows = 800..850;
        let columns = basis.design(&wave, &rows, &Ctl::new()).unwrap();
        let responses = basis.responses(omega_t);
        assert_eq!((columns.ncols(), responses.len()), (7, 7));
        for (j, response) in responses.iter().enumerate() {
            for (i, t) in rows.clone().enumerate() {
                let expected = (response * Complex64::from_polar(1.0, omega_t * t as f64)).re;
                assert!((columns[(i, j)] - expected).abs() < 1e-11 * (1.0 + response.norm()), "{j} {t}");
            }
        }
    }

    #[test]
    fn as_many_terms_as_lags_are_all_lags() {
        let full = FeedforwardBasis::new(&Lags { terms: 12, ..lags() }, vec![1.0]);
        assert_eq!(full.columns(), 12);
        let defect = (&full.weights * full.weights.transpose() - DMatrix::identity(12, 12)).norm();
        assert!(defect < 1e-12, "{defect}");
    }

    #[test]
    fn slow_stable_zeros_become_poles_and_others_do_not() {
        let plant = |num: &[f64]| System::Continuous(TransferFunction::new(num, &[1.0, 3.6, 4.0], Continuous).unwrap());
        let one = slow_zeros(&plant(&[2.0, 4.4]), 0.02);
        assert!(one.len() == 2 && (one[1] + (-2.2_f64 * 0.02).exp()).abs() < 1e-12, "{one:?}");
        assert_eq!(slow_zeros(&plant(&[-2.0, 4.4]), 0.02), [1.0]);
        assert_eq!(slow_zeros(&plant(&[1.0, 100.0]), 0.02), [1.0]);
        let pair = slow_zeros(&plant(&[1.0, 3.33, 6.5]), 0.02);
        assert!(pair.len() == 3 && (pair[2] - (-3.33_f64 * 0.02).exp()).abs() < 1e-12, "{pair:?}");
    }
}
