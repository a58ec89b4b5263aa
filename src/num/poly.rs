//! Real polynomials, coefficients in descending powers (as MATLAB and python-control write them).

use super::linalg;
use num_complex::Complex64;

/// A real polynomial `c[0] x^n + … + c[n]`, never empty, with no leading zero unless it is the zero polynomial.
#[derive(Debug, Clone, PartialEq)]
pub struct Polynomial(Vec<f64>);

impl Polynomial {
    /// From coefficients in descending powers; leading zeros are dropped, and no coefficient means zero.
    #[must_use]
    pub fn new(descending: impl Into<Vec<f64>>) -> Self {
        let mut coefficients: Vec<f64> = descending.into();
        let leading = coefficients.iter().take_while(|c| **c == 0.0).count();
        coefficients.drain(..leading.min(coefficients.len().saturating_sub(1)));
        if coefficients.is_empty() {
            coefficients.push(0.0);
        }
        Self(coefficients)
    }

    /// The monic polynomial with these roots. Complex roots must come in conjugate pairs; the imaginary rounding of
    /// the product is dropped.
    #[must_use]
    pub fn from_roots(roots: &[Complex64]) -> Self {
        let mut product = vec![Complex64::new(1.0, 0.0)];
        for root in roots {
            product.push(Complex64::new(0.0, 0.0));
            for i in (1..product.len()).rev() {
                let shifted = product[i - 1] * root;
                product[i] -= shifted;
            }
        }
        Self::new(product.into_iter().map(|c| c.re).collect::<Vec<_>>())
    }

    /// The coefficients in descending powers.
    #[must_use]
    pub fn coefficients(&self) -> &[f64] {
        &self.0
    }

    /// The degree; 0 for constants, the zero polynomial included.
    #[must_use]
    pub fn degree(&self) -> usize {
        self.0.len() - 1
    }

    /// The coefficient of the highest power.
    #[must_use]
    pub fn leading(&self) -> f64 {
        self.0[0]
    }

    /// Whether it is the zero polynomial.
    #[must_use]
    pub fn is_zero(&self) -> bool {
        self.0 == [0.0]
    }

    /// The value at `x` (Horner).
    #[must_use]
    pub fn eval(&self, x: Complex64) -> Complex64 {
        self.0.iter().fold(Complex64::new(0.0, 0.0), |sum, c| sum * x + c)
    }

    /// The product with a number.
    #[must_use]
    pub fn scale(&self, factor: f64) -> Self {
        Self::new(self.0.iter().map(|c| c * factor).collect::<Vec<_>>())
    }

    /// The sum of two polynomials.
    #[must_use]
    pub fn add(&self, other: &Self) -> Self {
        let (long, short) = if self.0.len() >= other.0.len() { (self, other) } else { (other, self) };
        let mut sum = long.0.clone();
        let offset = long.0.len() - short.0.len();
        for (s, c) in sum[offset..].iter_mut().zip(&short.0) {
            *s += c;
        }
        Self::new(sum)
    }

    /// The product of two polynomials.
    #[must_use]
    pub fn mul(&self, other: &Self) -> Self {
        let mut product = vec![0.0; self.0.len() + other.0.len() - 1];
        for (i, a) in self.0.iter().enumerate() {
            for (j, b) in other.0.iter().enumerate() {
                product[i + j] += a * b;
            }
        }
        Self::new(product)
    }

    /// Quotient and remainder of the division by a polynomial that is not zero: `self = quotient · divisor +
    /// remainder`, the remainder of lower degree than the divisor (zero where that is a constant).
    #[must_use]
    pub(crate) fn divided_by(&self, divisor: &Self) -> (Self, Self) {
        let steps = (self.0.len() + 1).saturating_sub(divisor.0.len());
        let mut remainder = self.0.clone();
        let mut quotient = Vec::with_capacity(steps);
        for i in 0..steps {
            let factor = remainder[i] / divisor.0[0];
            quotient.push(factor);
            for (r, c) in remainder[i..].iter_mut().zip(&divisor.0) {
                *r -= factor * c;
            }
        }
        (Self::new(quotient), Self::new(remainder.split_off(steps)))
    }

    /// The derivative.
    #[must_use]
    pub(crate) fn derivative(&self) -> Self {
        let degree = self.degree();
        let terms = self.0[..degree].iter().enumerate().map(|(i, c)| c * (degree - i) as f64);
        Self::new(terms.collect::<Vec<_>>())
    }

    /// All roots, as the eigenvalues of the balanced companion matrix; none for constants.
    ///
    /// # Errors
    /// [`linalg::NoConvergence`] if the eigenvalue iteration fails or a coefficient is not finite.
    pub fn roots(&self) -> Result<Vec<Complex64>, linalg::NoConvergence> {
        // Roots at zero are exact; the companion matrix of the rest is then invertible.
        let at_zero = if self.is_zero() { 0 } else { self.0.iter().rev().take_while(|c| **c == 0.0).count() };
        let reduced = &self.0[..self.0.len() - at_zero];
        let n = reduced.len() - 1;
        let mut roots = vec![Complex64::new(0.0, 0.0); at_zero];
        if n > 0 {
            let companion = nalgebra::DMatrix::from_fn(n, n, |row, column| match (row, column) {
                (0, j) => -reduced[j + 1] / reduced[0],
                (i, j) if i == j + 1 => 1.0,
                _ => 0.0,
            });
            roots.extend(linalg::eigenvalues(&companion)?);
        }
        Ok(roots)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotient_times_divisor_and_remainder_give_the_dividend() {
        let p = |c: &[f64]| Polynomial::new(c);
        for (a, b) in [
            (p(&[2.0, -3.0, 1.0, 5.0]), p(&[4.0, 1.0])),
            (p(&[1.0, 2.0]), p(&[1.0, 0.0, 1.0])),
            (p(&[1.0, 2.0]), p(&[4.0])),
            (p(&[0.0]), p(&[1.0, 1.0])),
            (p(&[1.0, 0.0, 0.0, 0.0]), p(&[2.0, 0.0, 1.0])),
        ] {
            let (q, r) = a.divided_by(&b);
            assert!(r.is_zero() || r.degree() < b.degree(), "{r:?}");
            assert_eq!(q.mul(&b).add(&r), a);
        }
        assert_eq!(p(&[2.0, 3.0, 4.0]).derivative(), p(&[4.0, 3.0]));
        assert!(p(&[2.0]).derivative().is_zero());
    }

    #[test]
    fn leading_zeros_are_dropped() {
        assert_eq!(Polynomial::new(vec![0.0, 0.0, 2.0]).coefficients(), [2.0]);
        assert!(Polynomial::new(Vec::new()).is_zero());
        assert!(Polynomial::new(vec![0.0, 0.0]).is_zero());
    }

    #[test]
    fn products_and_sums_line_up_their_powers() {
        let a = Polynomial::new(vec![1.0, 2.0]);
        let b = Polynomial::new(vec![3.0, 0.0, -1.0]);
        assert_eq!(a.mul(&b).coefficients(), [3.0, 6.0, -1.0, -2.0]);
        assert_eq!(a.add(&b).coefficients(), [3.0, 1.0, 1.0]);
    }

    #[test]
    fn the_polynomial_vanishes_at_its_roots() {
        // (s + 1)(s^2 + 3.6 s + 4) s^2
        let p = Polynomial::new(vec![1.0, 4.6, 7.6, 4.0, 0.0, 0.0]);
        let roots = p.roots().unwrap();
        assert_eq!(roots.len(), 5);
        assert!(roots.iter().all(|r| p.eval(*r).norm() < 1e-12), "{roots:?}");
        assert_eq!(roots.iter().filter(|r| r.norm() == 0.0).count(), 2);
    }
}
