//! What trials say about learning: time-domain metrics, distances from the inverse dynamics, curves over trials, groups.

pub mod time_domain;
