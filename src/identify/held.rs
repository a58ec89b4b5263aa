//! A controller that is held at zero: the hypotheses that a person uses no feedback, or no feedforward.
//!
//! Zhang 2015 (section 5.5, C_ff and C_fb) designs a feedforward without feedback and a feedback without feedforward.
//! Both are special cases of identification. Without feedback the loop is `G̃ = G Gff`, and a candidate is a
//! feedforward denominator. Without feedforward `G̃ = G Gfb/(1 + G Gfb)`, and with the sensitivity `S = 1/(1 + G Gfb)`
//! a candidate costs `J = Σ weight |S − (1 − H)|²`, with nothing to solve for. The designs themselves are
//! identifications with `H = 1` at every line.

use crate::num::distributions::f_cdf;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The controller that is held at zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "HeldController")]
pub enum Held {
    /// `Gfb = 0`: the control follows from the command alone, `u = Gff r`.
    Feedback,
    /// `Gff = 0`: the control follows from the error alone, `u = Gfb (r − y)`.
    Feedforward,
}

impl Held {
    /// The controller, in words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Feedback => "feedback",
            Self::Feedforward => "feedforward",
        }
    }
}

/// A fit, as the F statistic of a restriction takes it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fitted {
    /// J.
    pub cost: f64,
    /// Free coefficients.
    pub unknowns: usize,
}

/// The F statistic of a restriction, `((J_r − J)/q)/(J/(n − p))`, with J and p of the fit of both controllers, J_r that
/// of the fit with one held at zero, q the coefficients that it has less, and n real equations.
///
/// Nobody promises that it has the F distribution. Where a controller is zero, its poles and zeros are no parameters of
/// anything (Davies 1977), so that q is too large a count for them; candidates lie on a grid; and leakage is no noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "RestrictionF")]
pub struct RestrictionF {
    /// The statistic, without unit: 0 where the restriction costs nothing.
    pub statistic: f64,
    /// q, coefficients that the restriction takes away.
    pub numerator_degrees: usize,
    /// n − p, equations left over by the fit of both controllers.
    pub denominator_degrees: usize,
    /// The probability of a larger statistic under F(q, n − p), without unit: what a table would say, and no tested
    /// size.
    pub nominal_p_value: f64,
}

/// Why there is no statistic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NoStatistic {
    /// Nothing is left over to compare with.
    #[error("the lines give no more equations than the fit of both controllers has coefficients")]
    NothingLeft,
    /// The full fit leaves nothing.
    #[error("the fit of both controllers is exact to rounding, and any restriction infinitely worse")]
    Exact,
    /// The pools are not nested, or a refinement ended in a local optimum.
    #[error("the restricted fit costs less: what was searched for both controllers does not hold it")]
    NotNested,
}

/// The F statistic of a restriction; costs within `rounding` of zero are zero.
///
/// # Errors
/// [`NoStatistic`].
pub fn restriction_f(
    full: Fitted,
    restricted: Fitted,
    equations: usize,
    rounding: f64,
) -> Result<RestrictionF, NoStatistic> {
    let left = equations.checked_sub(full.unknowns).filter(|left| *left > 0).ok_or(NoStatistic::NothingLeft)?;
    let fewer = full.unknowns.checked_sub(restricted.unknowns).filter(|q| *q > 0).ok_or(NoStatistic::NotNested)?;
    if restricted.cost < full.cost - rounding {
        return Err(NoStatistic::NotNested);
    }
    // Written so that NaN fails too.
    let has_residual = full.cost > rounding;
    if !has_residual {
        return Err(NoStatistic::Exact);
    }
    let (q, left_over) = (fewer as f64, left as f64);
    let statistic = ((restricted.cost - full.cost).max(0.0) / q) / (full.cost / left_over);
    Ok(RestrictionF {
        statistic,
        numerator_degrees: fewer,
        denominator_degrees: left,
        nominal_p_value: 1.0 - f_cdf(statistic, q, left_over),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_statistic_is_that_of_a_table() {
        let full = Fitted { cost: 2.0, unknowns: 6 };
        // F.95(2, 20) = 3.4928: J_r = J (1 + 2·3.4928/20).
        let restricted = Fitted { cost: 2.0 * (1.0 + 2.0 * 3.492_828 / 20.0), unknowns: 4 };
        let found = restriction_f(full, restricted, 26, 1e-20).unwrap();
        assert_eq!((found.numerator_degrees, found.denominator_degrees), (2, 20));
        assert!((found.statistic - 3.492_828).abs() < 1e-9, "{found:?}");
        assert!((found.nominal_p_value - 0.05).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn what_has_none_says_why() {
        let full = Fitted { cost: 2.0, unknowns: 6 };
        let of = |full, cost, unknowns, n| restriction_f(full, Fitted { cost, unknowns }, n, 1e-12).unwrap_err();
        assert_eq!(of(full, 3.0, 4, 6), NoStatistic::NothingLeft);
        assert_eq!(of(full, 1.9, 4, 20), NoStatistic::NotNested);
        assert_eq!(of(Fitted { cost: 1e-13, ..full }, 3.0, 4, 20), NoStatistic::Exact);
        assert_eq!(restriction_f(full, Fitted { cost: 2.0, unknowns: 4 }, 20, 0.0).unwrap().statistic, 0.0);
    }
}
