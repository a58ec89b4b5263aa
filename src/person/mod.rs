//! Models of a person in the loop with a known plant.

pub mod state_feedback;
pub mod two_degrees_of_freedom;

pub use two_degrees_of_freedom::TwoDegreesOfFreedom;
