//! `volition demo`: the whole road on a simulated study.

pub mod simulate;
pub mod tables;
