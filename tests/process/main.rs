//! The real command in real processes: killed, restarted, drained, given bad input.
#![allow(clippy::unwrap_used, missing_docs)]

mod command_line;
mod harness;
mod kill;
mod restart;
