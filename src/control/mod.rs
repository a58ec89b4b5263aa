//! Linear time-invariant systems whose time base is part of their type.
//!
//! Frequencies are angular (rad/s) throughout; matrices of state space models carry the textbook letters A, B, C, D.

pub mod bode;
pub mod conversion;
pub mod delay;
pub mod discretise;
pub(crate) mod double_double;
pub mod exponential;
pub mod lqg;
pub mod lyapunov;
pub mod matrix_fraction;
pub mod model;
pub mod multivariable;
pub mod pade;
pub mod parametric;
pub mod polynomial_matrix;
pub mod riccati;
pub mod simulate;
pub mod stability;
pub mod state_space;
pub mod stochastic;
pub mod structural;
pub mod time_base;
pub mod transfer_function;
pub mod twins;

pub use matrix_fraction::{LeftFraction, RightFraction};
pub use model::{Model, ModelError, ModelShape, System};
pub use multivariable::{Multivariable, MultivariableModel, MultivariableSystem};
pub use parametric::ParametricModel;
pub use polynomial_matrix::PolynomialMatrix;
pub use state_space::StateSpace;
pub use time_base::{Continuous, Discrete, TimeBase};
pub use transfer_function::TransferFunction;
