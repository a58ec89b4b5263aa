//! What was found about one half, before it is written.

use crate::inverse::InverseLqr;
use crate::inverse::fit::{CrossTerm, Descent, Fit};

/// What was found about a half.
pub(super) struct Findings {
    /// The verdict, with the weights where they exist.
    pub answer: InverseLqr,
    /// The nearest optimal gain, where this one is optimal for no cost.
    pub fitted: Option<Fit>,
    /// The cost with the smallest cross term, beside the fit and without a structure.
    pub cross_term: Option<CrossTerm>,
    /// The descent, where it was asked for.
    pub descent: Option<Descent>,
}
