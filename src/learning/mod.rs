//! What trials say about learning: time-domain metrics, distances from the inverse dynamics, curves over trials, groups.

pub mod frequency_domain;
mod quadrature;
pub mod time_domain;
