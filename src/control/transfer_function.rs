//! Single-input single-output rational transfer functions.

use super::time_base::TimeBase;
use crate::num::Polynomial;
use crate::num::linalg::NoConvergence;
use num_complex::Complex64;

/// `N(x)/D(x)` with real coefficients in descending powers of `x = s` or `x = z`.
///
/// The denominator is never zero and every coefficient is finite. Common factors are kept as given: a cancellation
/// that is exact on paper is not in floating point, and a hidden unstable mode must stay visible.
#[derive(Debug, Clone, PartialEq)]
pub struct TransferFunction<T> {
    num: Polynomial,
    den: Polynomial,
    time: T,
}

/// Coefficients that are no transfer function.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TransferFunctionError {
    /// All coefficients of the denominator are zero, or there are none.
    #[error("the denominator is zero")]
    ZeroDenominator,
    /// A coefficient is NaN or infinite.
    #[error("coefficient {index} of the {part} is not finite")]
    NotFinite {
        /// `num` or `den`.
        part: &'static str,
        /// Position in descending powers, from 0.
        index: usize,
    },
    /// No numerator coefficient was given.
    #[error("the numerator has no coefficient")]
    EmptyNumerator,
}

impl<T: TimeBase> TransferFunction<T> {
    /// From coefficients in descending powers.
    ///
    /// # Errors
    /// [`TransferFunctionError`] for an empty or zero denominator, an empty numerator, or a coefficient that is not
    /// finite.
    pub fn new(num: &[f64], den: &[f64], time: T) -> Result<Self, TransferFunctionError> {
        for (part, coefficients) in [("num", num), ("den", den)] {
            if let Some(index) = coefficients.iter().position(|c| !c.is_finite()) {
                return Err(TransferFunctionError::NotFinite { part, index });
            }
        }
        if num.is_empty() {
            return Err(TransferFunctionError::EmptyNumerator);
        }
        let den = Polynomial::new(den);
        if den.is_zero() {
            return Err(TransferFunctionError::ZeroDenominator);
        }
        Ok(Self { num: Polynomial::new(num), den, time })
    }

    /// The numerator.
    #[must_use]
    pub fn num(&self) -> &Polynomial {
        &self.num
    }

    /// The denominator.
    #[must_use]
    pub fn den(&self) -> &Polynomial {
        &self.den
    }

    /// The time base.
    #[must_use]
    pub fn time(&self) -> T {
        self.time
    }

    /// Degree of the denominator minus degree of the numerator; negative for an improper transfer function.
    #[must_use]
    pub(crate) fn relative_degree(&self) -> i64 {
        self.den.degree() as i64 - self.num.degree() as i64
    }

    /// The value at a point of the complex plane; not finite at a pole.
    #[must_use]
    pub fn eval(&self, x: Complex64) -> Complex64 {
        self.num.eval(x) / self.den.eval(x)
    }

    /// The frequency response at the angular frequency `omega_rad_s`; not finite where a pole lies there.
    #[must_use]
    pub fn response(&self, omega_rad_s: f64) -> Complex64 {
        self.eval(self.time.point(omega_rad_s))
    }

    /// The roots of the denominator.
    ///
    /// # Errors
    /// [`NoConvergence`] if the eigenvalue iteration fails.
    pub fn poles(&self) -> Result<Vec<Complex64>, NoConvergence> {
        self.den.roots()
    }

    /// The roots of the numerator.
    ///
    /// # Errors
    /// [`NoConvergence`] if the eigenvalue iteration fails.
    pub fn zeros(&self) -> Result<Vec<Complex64>, NoConvergence> {
        self.num.roots()
    }
}
