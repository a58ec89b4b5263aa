//! Numbers: polynomials, small dense linear algebra, statistics and seeded random streams.
//!
//! Nothing here knows about control theory, files, clocks or threads.

pub(crate) mod characteristic;
pub mod distributions;
pub mod dual;
pub mod expression;
pub mod fourier;
pub(crate) mod hermite;
pub mod hexadecimal;
pub(crate) mod integer_polynomial;
pub mod least_squares;
pub mod linalg;
pub(crate) mod newton;
pub(crate) mod noncentral_t;
pub(crate) mod nonnegative;
pub mod poly;
pub mod rng;
pub(crate) mod roots;
pub mod schur;
pub mod stats;

pub use num_complex::Complex64;
pub use poly::Polynomial;
