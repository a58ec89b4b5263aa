//! The candidates that the data cannot tell from the best one: how many there are, and how far they differ.

mod best;
mod clusters;
mod controllers;
mod denominators;
mod models;
mod norms;
mod pair;
mod products;
pub(super) mod question;
pub(super) mod ranges;
pub(super) mod share;
pub(super) mod threshold;
mod walk;
