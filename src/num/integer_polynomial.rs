//! Polynomials with integer coefficients: exact values, and proofs of sign on [0, 1] by Bernstein's coefficients.
//!
//! A polynomial lies between the least and the largest of its coefficients in Bernstein's basis; halving the interval
//! by de Casteljau's scheme brings them to the polynomial quadratically (Farouki, Comput. Aided Geom. Des. 29, 379–419,
//! 2012).

use num_bigint::{BigInt, Sign};

/// A real number `mantissa · 2^exponent`, for ranges beyond those of a double.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Scaled {
    /// Zero, or of magnitude 1 to 2.
    mantissa: f64,
    exponent: i64,
}

impl Scaled {
    pub(crate) fn new(value: f64, exponent: i64) -> Self {
        if value == 0.0 || !value.is_finite() {
            return Self { mantissa: value, exponent: 0 };
        }
        let shift = i64::from(exponent_of(value));
        // In two steps: a subnormal number is more than 2¹⁰²³ below 1.
        let half = shift / 2;
        let mantissa = value * (-half as f64).exp2() * (-(shift - half) as f64).exp2();
        Self { mantissa, exponent: exponent + shift }
    }

    pub(crate) fn of(value: &BigInt) -> Self {
        let bits = value.bits();
        let shift = bits.saturating_sub(64);
        let top = (value.magnitude() >> shift).iter_u64_digits().next().unwrap_or(0) as f64;
        Self::new(if value.sign() == Sign::Minus { -top } else { top }, shift as i64)
    }

    pub(crate) fn times(self, other: Self) -> Self {
        Self::new(self.mantissa * other.mantissa, self.exponent + other.exponent)
    }

    /// The quotient; infinite or NaN for a divisor of zero.
    pub(crate) fn over(self, other: Self) -> Self {
        Self::new(self.mantissa / other.mantissa, self.exponent - other.exponent)
    }

    /// As a double, infinite or zero beyond its range.
    pub(crate) fn value(self) -> f64 {
        let exponent = self.exponent.clamp(-2200, 2200);
        let half = exponent / 2;
        self.mantissa * (half as f64).exp2() * ((exponent - half) as f64).exp2()
    }

    pub(crate) fn is_zero(self) -> bool {
        self.mantissa == 0.0
    }

    /// The larger of two positive numbers.
    pub(crate) fn max(self, other: Self) -> Self {
        if self.over(other).value() >= 1.0 { self } else { other }
    }

    /// The smaller of two positive numbers.
    pub(crate) fn min(self, other: Self) -> Self {
        if self.over(other).value() >= 1.0 { other } else { self }
    }
}

/// `⌊log₂ |value|⌋` of a finite number other than 0.
fn exponent_of(value: f64) -> i32 {
    let exponent = ((value.to_bits() >> 52) & 0x7ff) as i32;
    if exponent == 0 { exponent_of(value * 64f64.exp2()) - 64 } else { exponent - 1023 }
}

/// `p(k/2^d)·2^(dn)` of a polynomial of degree n, from x⁰ up.
pub(crate) fn value_at(p: &[BigInt], numerator: &BigInt, halvings: u64) -> BigInt {
    let n = p.len().saturating_sub(1);
    let mut sum = BigInt::ZERO;
    for (i, coefficient) in p.iter().enumerate().rev() {
        sum = sum * numerator + (coefficient << (halvings * (n - i) as u64));
    }
    sum
}

/// A polynomial on an interval of [0, 1], by its Bernstein coefficients up to a common positive factor.
#[derive(Debug, Clone)]
pub(crate) struct Piece {
    coefficients: Vec<BigInt>,
    /// Every coefficient is exact up to this many units.
    error: u64,
    /// The interval is `[k, k + 1]/2^d`.
    pub numerator: BigInt,
    /// d.
    pub halvings: u64,
}

impl Piece {
    /// On [0, 1], with coefficients cut to so many bits below the largest; and the factor between the polynomial and
    /// its coefficients here.
    pub(crate) fn whole(p: &[BigInt], bits: u64) -> (Self, Scaled) {
        let n = p.len().saturating_sub(1);
        let factorials: Vec<BigInt> = (0..=n as u64)
            .scan(BigInt::from(1), |product, i| {
                *product *= i.max(1);
                Some(product.clone())
            })
            .collect();
        // n! b_j = Σ_i a_i (n − i)! j!/(j − i)!.
        let exact: Vec<BigInt> = (0..=n)
            .map(|j| (0..=j).map(|i| &p[i] * &factorials[n - i] * (&factorials[j] / &factorials[j - i])).sum())
            .collect();
        let largest = exact.iter().map(BigInt::bits).max().unwrap_or(0);
        let cut = largest as i64 - bits as i64;
        let factor = Scaled::new(1.0, cut).over(Scaled::of(&factorials[n]));
        let shifted = |b: BigInt| if cut > 0 { b >> cut as u64 } else { b << cut.unsigned_abs() };
        let coefficients = exact.into_iter().map(shifted).collect();
        (Self { coefficients, error: 1, numerator: BigInt::ZERO, halvings: 0 }, factor)
    }

    /// A number that the polynomial does not fall below on the interval, in the units of the coefficients.
    pub(crate) fn lower_bound(&self) -> BigInt {
        self.coefficients.iter().min().map_or(BigInt::ZERO, |least| least - self.error)
    }

    /// Both halves.
    pub(crate) fn halves(mut self) -> [Self; 2] {
        let n = self.coefficients.len() - 1;
        let mut left = Vec::with_capacity(n + 1);
        for k in 0..=n {
            left.push(self.coefficients[0].clone());
            for i in 0..n - k {
                let sum = &self.coefficients[i] + &self.coefficients[i + 1];
                self.coefficients[i] = sum >> 1;
            }
        }
        // What is left of the triangle is its other side, from the top to the bottom row.
        let right = self.coefficients;
        let (error, halvings) = (self.error + n as u64, self.halvings + 1);
        let numerator = self.numerator << 1;
        let next = &numerator + 1;
        [
            Self { coefficients: left, error, numerator, halvings },
            Self { coefficients: right, error, numerator: next, halvings },
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_have_the_values_of_the_whole() {
        // 3 − 20x + 24x² + 7x³: at 0, 1/2 and 1 it is 3, −1/8 and 14.
        let p: Vec<BigInt> = [3, -20, 24, 7].map(BigInt::from).to_vec();
        assert_eq!(value_at(&p, &BigInt::from(1), 1), BigInt::from(-1));
        let (whole, factor) = Piece::whole(&p, 200);
        let unit = |b: &BigInt| Scaled::of(b).times(factor).value();
        let [left, right] = whole.halves();
        let ends = [&left.coefficients[0], &left.coefficients[3], &right.coefficients[0], &right.coefficients[3]];
        for (found, expected) in ends.into_iter().zip([3.0, -0.125, -0.125, 14.0]) {
            assert!((unit(found) - expected).abs() <= 1e-15 * expected.abs(), "{} {expected}", unit(found));
        }
        assert!(left.lower_bound() < BigInt::ZERO && right.numerator == BigInt::from(1));
    }

    #[test]
    fn numbers_beyond_doubles_keep_their_ratios() {
        let (a, b) = (BigInt::from(3) << 5000u32, BigInt::from(-7) << 4990u32);
        let ratio = Scaled::of(&a).over(Scaled::of(&b)).value();
        assert!((ratio + 3.0 / 7.0 * 1024.0).abs() < 1e-12);
        assert_eq!(Scaled::new(5e-324, 1074).value(), 1.0);
        assert_eq!(Scaled::of(&BigInt::ZERO).value(), 0.0);
    }
}
