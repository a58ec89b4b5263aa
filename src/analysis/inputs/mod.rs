//! Inputs that several kinds share: stored things, trials, frequency data, plants.

pub mod data;
pub mod earlier;
pub mod fitted;
pub mod frequency_problem;
pub mod library;
pub mod matrix;
pub mod plant;
pub mod pool_problem;
pub(super) mod recorded;
pub mod sampled_signal;
pub mod trial_problem;
pub mod trials;
