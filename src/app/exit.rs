//! How commands end: the same codes everywhere, which scripts rely on.

use crate::config::ConfigError;
use std::process::ExitCode;

/// What was asked for was tried and failed, or something is damaged.
pub(crate) const FAILED: u8 = 1;
/// What was asked for makes no sense: a flag, a setting, a document, a file.
pub(crate) const REFUSED: u8 = 2;
/// Somebody interrupted it (Ctrl-C), as shells write it: 128 and the number of the signal.
pub(crate) const INTERRUPTED: u8 = 130;

/// Somebody interrupted it.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
pub(crate) struct Interrupted;

/// The code that belongs to an error.
#[must_use]
pub fn code_of(error: &anyhow::Error) -> ExitCode {
    ExitCode::from(if error.is::<Interrupted>() {
        INTERRUPTED
    } else if error.is::<ConfigError>() {
        REFUSED
    } else {
        FAILED
    })
}
