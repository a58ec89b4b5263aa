//! Convex optimisation over linear matrix inequalities.
//!
//! [`lmi`] is a dense primal-dual method for problems with few unknowns and large blocks, whose iterates stay strictly
//! feasible, so that the answer satisfies every inequality as it stands. [`conic`] states any mixture of equalities,
//! inequalities, second-order and semidefinite cones and hands it to clarabel. [`box_lp`] solves linear programs with
//! few rows over a large box, with its proof. No status is an answer: callers prove theirs on residuals.

mod blas;
pub mod box_lp;
pub mod conic;
pub mod lmi;
pub mod svec;
