//! The `volition` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    volition::cli::run()
}
