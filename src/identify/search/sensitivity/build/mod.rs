//! What does not depend on what was measured: the list of controllers, their clusters, and the blocks of feedforward
//! denominators.

pub(crate) mod cluster;
pub(crate) mod clusters;
pub(crate) mod codec;
pub(crate) mod denominators;
mod deviations;
mod extent;
mod line_lanes;
mod members;
mod principal;
#[cfg(test)]
mod proofs;
mod sample;
pub(crate) mod size;
mod tree_builder;
