//! What `inverse_lqr`, `inverse_lqe` and `inverse_lqg` share: inverse optimal control of one half of a controller.
//!
//! A filter is the dual of a regulator: its question is put as one about the regulator of (Aᵀ, Cᵀ) with the gain Lᵀ,
//! and the answer gets the letters of a filter. The method is that of [`inverse`](crate::inverse). An infeasible
//! verdict is a result: it comes with its certificate, and with the weights whose gain comes nearest.

pub(in crate::analysis) mod answer;
mod doubts;
mod evidence;
pub mod filter;
mod findings;
pub mod found_by;
pub(in crate::analysis) mod half;
pub(in crate::analysis) mod members;
pub mod parts;
pub(in crate::analysis) mod problems;
mod reading;
pub mod regulator;
pub mod shares;
pub mod spec;
pub mod structure_spec;
mod units;
mod warnings;
pub mod written;

#[cfg(test)]
mod cases;
#[cfg(test)]
mod tests;
