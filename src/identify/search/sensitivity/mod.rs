//! The exact search for pools whose feedback controllers can be listed: branch and bound over clusters of like
//! sensitivities, with every feedforward denominator by itself. `bound/kernel.rs` derives the bound.

pub(crate) mod bound;
pub(super) mod build;
pub(super) mod search;
