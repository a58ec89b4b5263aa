//! Volition identifies the control law, and the intent, behind recorded human motion.
//!
//! A person tracks a command r through a known plant G with the control u. The crate estimates the response of the
//! closed loop from recorded trials, finds the feedforward Gff and the feedback Gfb that explain it, asks for which
//! cost gains are optimal, and designs the experiment that would tell more:
//!
//! ```text
//! u = Gff r + Gfb (r − y)      y = G (u + d)      Gyr = G (Gff + Gfb) / (1 + G Gfb)
//! ```
//!
//! It is the inside of one program, a server with a command line, and not a library with a stable interface.
//! `docs/architecture.md` walks through the rooms in the order in which data pass through them; in short, from the
//! bottom to the top:
//!
//! - [`num`], [`ctl`]: numbers, and how long computations are driven;
//! - [`control`], [`convex`]: linear systems with their time base as a type, matrix equations, convex programs;
//! - [`person`], [`plants`], [`simulate`]: models of people and plants, and simulated studies;
//! - [`trial`], [`response`]: recordings, and frequency data from them;
//! - [`identify`], [`two_stimulus`], [`prediction_error`], [`likelihood`], [`inverse`], [`excite`], [`learning`]:
//!   the mathematics of the kinds of analysis;
//! - [`analysis`]: a request becomes a checked analysis, and that a [`Report`](analysis::Report);
//! - [`exchange`]: files as labs have them, read into trials;
//! - [`jobs`], [`store`], [`worker`], [`api`], [`pages`]: analyses as durable jobs, kept in SQLite, computed by
//!   workers, asked for over HTTP, and looked at in a browser;
//! - [`app`], [`cli`], [`config`], [`telemetry`]: the parts put together.
//!
//! A system has its time base in its type, and cannot meet one of another:
//!
//! ```
//! use volition::control::{Continuous, TransferFunction};
//!
//! // 4/(s + 2) at 2 rad/s: gain √2 at −45°.
//! let plant = TransferFunction::new(&[4.0], &[1.0, 2.0], Continuous)?;
//! let response = plant.response(2.0);
//! assert!((response.norm() - 2.0_f64.sqrt()).abs() < 1e-15);
//! assert!((response.arg().to_degrees() + 45.0).abs() < 1e-12);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
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
pub mod exchange;
pub mod excite;
pub mod figure;
pub mod identify;
pub mod inverse;
pub mod jobs;
pub mod learning;
pub mod likelihood;
pub mod num;
pub mod pages;
pub mod person;
pub mod plants;
pub mod prediction_error;
#[cfg(test)]
mod published;
pub mod response;
pub mod simulate;
pub mod store;
pub mod telemetry;
pub mod trial;
pub mod trust;
pub mod two_stimulus;
pub mod worker;
