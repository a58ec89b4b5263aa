//! Numbers: polynomials, small dense linear algebra, statistics, seeded random streams, and the handle
//! ([`Ctl`]) through which a long computation is watched and stopped.
//!
//! Nothing here knows about control theory, files, clocks or threads.

mod bracket;
pub mod ctl;
pub mod distributions;
pub mod dual;
pub mod expression;
pub mod fourier;
pub mod least_squares;
pub mod linalg;
mod nonnegative;
pub mod poly;
pub mod rng;
pub mod schur;
pub mod stats;

pub use bracket::Bracket;
pub use ctl::{Ctl, Progress, StopReason, Stopped};
pub use num_complex::Complex64;
pub use poly::Polynomial;
