//! Between which two values the smallest cost lies, while it is still looked for.

/// The state of a search for the smallest of costs that are not negative: `bound ≤ smallest cost ≤ incumbent`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bracket {
    /// The smallest cost found so far, or an upper bound of it that rounding allows for.
    pub incumbent: f64,
    /// What every candidate is proven to cost at least.
    pub bound: f64,
    /// The candidate with that cost, by its index.
    pub index: u64,
}

impl Bracket {
    /// `(incumbent − bound)/incumbent`, from 1 (nothing is proven) to 0 (nothing is cheaper).
    #[must_use]
    pub fn gap(&self) -> f64 {
        if self.incumbent > 0.0 { ((self.incumbent - self.bound) / self.incumbent).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// Both pieces of knowledge together: the smaller incumbent (the present one of two alike), the larger bound.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let better = if other.incumbent < self.incumbent { other } else { self };
        Self { bound: self.bound.max(other.bound).min(better.incumbent), ..better }
    }

    /// Without what is no number: `None` where nothing was found, a bound of 0 where none is proven.
    #[must_use]
    pub fn checked(self) -> Option<Self> {
        if !self.incumbent.is_finite() {
            return None;
        }
        let incumbent = self.incumbent.max(0.0);
        let bound = if self.bound.is_finite() { self.bound.clamp(0.0, incumbent) } else { 0.0 };
        Some(Self { incumbent, bound, index: self.index })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knowledge_adds_up_and_is_never_lost() {
        let first = Bracket { incumbent: 4.0, bound: 1.0, index: 7 };
        let second = Bracket { incumbent: 3.0, bound: 0.5, index: 9 };
        let both = Bracket { incumbent: 3.0, bound: 1.0, index: 9 };
        assert_eq!((first.and(second), second.and(first)), (both, both));
        assert_eq!(both.and(Bracket { index: 1, ..both }), both, "of two alike the present one stays");
        assert_eq!(both.and(Bracket { incumbent: 5.0, bound: 3.5, index: 2 }).bound, 3.0, "rounding");
        assert!((first.gap() - 0.75).abs() < 1e-15);
        assert_eq!(Bracket { incumbent: 0.0, bound: 0.0, index: 0 }.gap(), 0.0);
    }

    #[test]
    fn what_is_no_number_claims_nothing() {
        assert_eq!(Bracket { incumbent: f64::INFINITY, bound: 1.0, index: 0 }.checked(), None);
        assert_eq!(Bracket { incumbent: f64::NAN, bound: 1.0, index: 0 }.checked(), None);
        for bound in [f64::NAN, f64::NEG_INFINITY, f64::INFINITY, -1.0] {
            let checked = Bracket { incumbent: 2.0, bound, index: 5 }.checked();
            assert_eq!(checked, Some(Bracket { incumbent: 2.0, bound: 0.0, index: 5 }), "{bound}");
        }
    }
}
