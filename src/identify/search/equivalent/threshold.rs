//! Which candidates the data cannot tell from the best one.

use crate::identify::identifiability::{Structure, equations};
use crate::identify::problem::Problem;
use crate::num::distributions::f_quantile;

/// The level of the set: the probability that it would hold the true controllers, were they of the pool's structure
/// and the noise normal, equal and independent.
pub const LEVEL: f64 = 0.95;

/// Up to which cost a candidate is statistically equivalent to the best one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Threshold {
    /// The limit over the smallest cost J*, as the F distribution gives it.
    pub ratio: f64,
    /// Candidates that cost at most this belong to the set.
    pub limit: f64,
    /// Real equations n.
    pub equations: usize,
    /// Free coefficients q.
    pub unknowns: usize,
}

impl Threshold {
    /// `J ≤ J* (1 + q/(n − q) F₀.₉₅(q, n − q))`, with n real equations (two a line, one where everything is real) and
    /// all q free coefficients of both controllers, but never finer than the rounding of costs:
    /// `J ≤ J* + rounding`. `None` where no equation is left over, since any cost could then be chance.
    ///
    /// The likelihood region of nonlinear least squares (Beale 1960; Seber & Wild 1989, chapter 5). The
    /// noise's variance is estimated from the residuals of the best candidate itself, so that leakage, which makes all
    /// residuals larger, widens the set.
    #[must_use]
    pub fn new(problem: &Problem, structure: Structure, smallest_cost: f64) -> Option<Self> {
        let (n, q) = (equations(problem), structure.unknowns());
        let left = n.checked_sub(q).filter(|left| *left > 0)? as f64;
        let ratio = 1.0 + q as f64 / left * f_quantile(LEVEL, q as f64, left);
        let limit = (ratio * smallest_cost).max(smallest_cost + problem.rounding());
        limit.is_finite().then_some(Self { ratio, limit, equations: n, unknowns: q })
    }
}
