//! Volition identifies the control law, and the intent, behind recorded human motion.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod analysis;
pub mod api;
pub mod app;
pub mod cache;
pub mod cli;
pub mod config;
pub mod control;
pub mod convex;
pub mod ctl;
pub mod excite;
pub mod identify;
pub mod inverse;
pub mod jobs;
pub mod learning;
pub mod likelihood;
pub mod num;
pub mod person;
pub mod plants;
pub mod response;
pub mod simulate;
pub mod store;
pub mod telemetry;
pub mod trial;
pub mod two_stimulus;
pub mod worker;
