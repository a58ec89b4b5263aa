//! Weights whose regulator comes nearest to a gain for which none is optimal (Priess 2015, §3.2.2).
//!
//! `min f = vec(K(Q, R) − K_e)ᵀ M vec(K(Q, R) − K_e)` with `I ⪯ blkdiag(Q, R) ⪯ κI`. Without κ the least value is
//! usually not attained: R or Q drifts to lower rank, for gains that come ever nearer. A residual that needs an ever
//! larger condition number is worth knowing, so the answer is the curve f(κ). A fit ends with its converged points, or
//! with the evaluations of f that it is allowed.

mod allowance;
mod barrier;
mod curve;
mod descent;
mod objective;
mod starts;

pub use curve::{CROSS_TERM, Fit, FitError, FitPoint, FitSettings, Unbounded, fit, fits};
pub use descent::{Descent, DescentError, DescentSettings, descent};
pub use objective::{Evaluation, Objective};
pub use starts::{CrossTerm, smallest_cross_term};

pub(super) use barrier::refine;
