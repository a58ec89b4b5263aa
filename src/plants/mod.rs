//! Known plants, the commands that subjects follow, and simulated subjects.

pub mod catalogue;
pub mod commands;
