//! Numbers of double-double precision: the unevaluated sum of two `f64` (Dekker, Numer. Math. 18, 224–242, 1971).
//!
//! Recursive filters need them: poles near z = 1, as fast sampling makes them, amplify each rounding by 1/D(1), which
//! is 10⁹ for an ordinary plant of fourth order at 500 Hz.

/// `high + low`, with `|low|` at most half a unit in the last place of `high`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct DoubleDouble {
    high: f64,
    low: f64,
}

impl DoubleDouble {
    fn quick_sum(high: f64, low: f64) -> Self {
        let sum = high + low;
        Self { high: sum, low: low - (sum - high) }
    }

    pub(crate) fn value(self) -> f64 {
        self.high
    }

    /// What the value lacks.
    pub(crate) fn rest(self) -> f64 {
        self.low
    }

    /// With the product of two numbers more.
    pub(crate) fn add_product(self, x: f64, y: f64) -> Self {
        let product = x * y;
        self.add(Self { high: product, low: x.mul_add(y, -product) })
    }

    pub(crate) fn add(self, other: Self) -> Self {
        let sum = self.high + other.high;
        let part = sum - self.high;
        let error = (self.high - (sum - part)) + (other.high - part);
        Self::quick_sum(sum, error + self.low + other.low)
    }

    pub(crate) fn sub(self, other: Self) -> Self {
        self.add(Self { high: -other.high, low: -other.low })
    }

    /// The product with a number.
    pub(crate) fn mul(self, factor: f64) -> Self {
        let product = self.high * factor;
        let error = self.high.mul_add(factor, -product);
        Self::quick_sum(product, error + self.low * factor)
    }

    /// The product with another.
    pub(crate) fn times(self, other: Self) -> Self {
        let product = self.high * other.high;
        let error = self.high.mul_add(other.high, -product) + (self.high * other.low + self.low * other.high);
        Self::quick_sum(product, error)
    }

    /// The quotient by another.
    pub(crate) fn over(self, divisor: Self) -> Self {
        let quotient = self.high / divisor.high;
        let rest = self.sub(divisor.mul(quotient));
        let next = rest.high / divisor.high;
        let last = rest.sub(divisor.mul(next)).high / divisor.high;
        Self::quick_sum(quotient, next).add(last.into())
    }

    /// The quotient by a number.
    pub(crate) fn div(self, divisor: f64) -> Self {
        let quotient = self.high / divisor;
        let remainder = (-quotient).mul_add(divisor, self.high) + self.low;
        Self::quick_sum(quotient, remainder / divisor)
    }
}

impl From<f64> for DoubleDouble {
    fn from(high: f64) -> Self {
        Self { high, low: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::DoubleDouble;

    #[test]
    fn quotients_and_products_undo_each_other() {
        let third = DoubleDouble::from(1.0).over(DoubleDouble::from(3.0));
        let one = third.times(DoubleDouble::from(3.0)).sub(DoubleDouble::from(1.0));
        assert!(one.value().abs() < 1e-31, "{one:?}");
        let square = third.times(third).over(third).sub(third);
        assert!(square.value().abs() < 1e-31, "{square:?}");
        // 10000000200000001 lies halfway between two doubles.
        assert_eq!(DoubleDouble::default().add_product(1e8 + 1.0, 1e8 + 1.0).rest(), 1.0);
    }

    #[test]
    fn what_a_single_f64_would_lose_is_kept() {
        let sum = DoubleDouble::from(1e16).add(1.0.into()).sub(1e16.into());
        assert_eq!(sum.value(), 1.0);
        let third = DoubleDouble::from(1.0).div(3.0);
        assert_eq!(third.mul(3.0).sub(1.0.into()).value(), 0.0);
        let product = DoubleDouble::from(1.0 + f64::EPSILON).mul(1.0 - f64::EPSILON).sub(1.0.into());
        assert_eq!(product.value(), -f64::EPSILON * f64::EPSILON);
    }
}
