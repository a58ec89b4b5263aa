//! The real command in real processes: killed, restarted, drained, given bad input.

mod command_line;
mod conveniences;
mod disk;
mod excitation;
pub mod harness;
mod kill;
mod restart;
mod resume;
