//! First derivatives to working precision: dual numbers `a + b ε` with `ε² = 0`.
//!
//! A function written for any [`Real`] gives its value from `f64` and its derivative from [`Dual`]: evaluated at `x +
//! ε` it returns `f(x) + f'(x) ε`. Unlike a difference quotient nothing cancels.

use std::fmt::Debug;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A number that formulas can be written for: `f64`, or [`Dual`] where the derivative is wanted too.
pub trait Real:
    Copy
    + Debug
    + PartialEq
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + From<f64>
{
    /// The number without its derivative.
    fn value(self) -> f64;
    /// Sine, of an angle in radians.
    fn sin(self) -> Self;
    /// Cosine, of an angle in radians.
    fn cos(self) -> Self;
}

impl Real for f64 {
    fn value(self) -> f64 {
        self
    }

    fn sin(self) -> Self {
        f64::sin(self)
    }

    fn cos(self) -> Self {
        f64::cos(self)
    }
}

/// A number with its derivative.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Dual {
    /// The number.
    pub value: f64,
    /// Its derivative.
    pub slope: f64,
}

#[cfg(test)]
impl Dual {
    /// The variable itself, whose derivative is 1.
    #[must_use]
    pub(crate) fn variable(value: f64) -> Self {
        Self { value, slope: 1.0 }
    }
}

impl From<f64> for Dual {
    fn from(value: f64) -> Self {
        Self { value, slope: 0.0 }
    }
}

impl Add for Dual {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { value: self.value + other.value, slope: self.slope + other.slope }
    }
}

impl Sub for Dual {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { value: self.value - other.value, slope: self.slope - other.slope }
    }
}

impl Mul for Dual {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self { value: self.value * other.value, slope: self.slope * other.value + self.value * other.slope }
    }
}

impl Div for Dual {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let value = self.value / other.value;
        Self { value, slope: (self.slope - value * other.slope) / other.value }
    }
}

impl Neg for Dual {
    type Output = Self;
    fn neg(self) -> Self {
        Self { value: -self.value, slope: -self.slope }
    }
}

impl Real for Dual {
    fn value(self) -> f64 {
        self.value
    }

    fn sin(self) -> Self {
        Self { value: self.value.sin(), slope: self.slope * self.value.cos() }
    }

    fn cos(self) -> Self {
        Self { value: self.value.cos(), slope: -self.slope * self.value.sin() }
    }
}

#[cfg(test)]
mod tests {
    use super::{Dual, Real};

    /// A formula with every operation.
    fn formula<S: Real>(x: S) -> S {
        (x * x - S::from(2.0) / x).sin() + (-x).cos() / (x + S::from(1.0))
    }

    #[test]
    fn the_derivative_is_that_of_the_formula() {
        let x = 0.7_f64;
        let inner = x * x - 2.0 / x;
        let expected = inner.cos() * (2.0 * x + 2.0 / (x * x)) - (x.sin() * (x + 1.0) + x.cos()) / (x + 1.0).powi(2);
        let dual = formula(Dual::variable(x));
        assert_eq!(dual.value, formula(x));
        assert!((dual.slope - expected).abs() < 1e-14, "{} {expected}", dual.slope);
    }
}
