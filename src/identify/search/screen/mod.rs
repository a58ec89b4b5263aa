//! What a search is asked and answers; one candidate by QR; every candidate, several at a time, by normal equations.

mod block;
pub(crate) mod decide;
pub mod exact;
pub(super) mod exhaustive;
mod kernel;
mod near;
pub(super) mod optimum;
pub(crate) mod systems;
pub(crate) mod within;
