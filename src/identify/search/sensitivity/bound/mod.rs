//! What a trial asks of the clusters: bounds, and the walk through what they leave.

mod block_lanes;
pub(crate) mod bounds;
mod cluster_frame;
mod conclude;
mod controller_bound;
mod controller_lanes;
mod kernel;
mod lines;
#[cfg(test)]
mod proofs;
mod relaxed;
mod verdict;
pub(crate) mod walk;
pub(crate) mod work;
