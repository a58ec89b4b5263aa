//! The real command in real processes: killed, restarted, drained, given bad input.

mod command_line;
mod excitation;
mod harness;
mod kill;
mod restart;
mod resume;
