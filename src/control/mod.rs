//! Linear time-invariant systems whose time base is part of their type.
//!
//! Frequencies are angular (rad/s) throughout; matrices of state space models carry the textbook letters A, B, C, D.

pub mod model;
pub mod time_base;
pub mod transfer_function;

pub use model::{Model, ModelError, System};
pub use time_base::{Continuous, Discrete, TimeBase};
pub use transfer_function::TransferFunction;
