//! From gains to the costs for which they are optimal (Priess 2015, chapters 3 and 4).
//!
//! Given a plant (A, B) and a stabilising gain K of u = −Kx, [`lqr::inverse_lqr`] decides whether weights Q ≻ 0 and R ≻
//! 0 exist for which K is the linear-quadratic regulator, names the best conditioned ones, and proves what it says: by
//! Kalman's inequality where there is one input, by a certificate for either side where there are several, and by
//! solving the forward problem. Where no weights exist, [`fit`] finds those whose regulator comes nearest. Filters are
//! the dual case ([`estimator`]), and [`reading`] says what the weights mean.
//!
//! The unknowns are (P, R). The equality `BᵀP = RK` (`BᵀPA = (BᵀPB + R)K` in sampled time) leaves a subspace of
//! dimension `((n − m)² + n + m)/2` at least, and `Q = KᵀRK − AᵀP − PA` follows: rounding K never makes the equalities
//! inconsistent, so that feasibility is a question of cones alone.
#![allow(non_snake_case)]

mod balance;
mod condition;
pub mod estimator;
pub mod fit;
pub mod gains;
pub mod lqr;
mod margin;
mod proof;
mod reach;
pub mod reading;
mod rounding;
mod space;
mod staircase;
mod structure;
mod verdict;

pub use gains::{Gains, GainsError, Knowledge, Role};
pub use lqr::{InverseLqr, Settings, inverse_lqr};
pub use proof::{Proof, ReturnDifference};
pub use reach::Targets;
pub use structure::{QSign, Structure, StructureError};
pub use verdict::{Decision, Evidence, Refutation, Verdict};
