//! The exact search by branch and bound over pairs of clusters: of feedback controllers, as products of poles, zeros
//! and gains, and of feedforward denominators.

pub(crate) mod codec;
mod feedback_lanes;
mod kernel;
mod lines;
mod ranges;
pub(super) mod search;
pub(crate) mod tree;
pub(super) mod trees;
mod walk;
