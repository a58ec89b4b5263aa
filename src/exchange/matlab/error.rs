//! Why a file of MATLAB cannot be read.

use crate::analysis::{Code, Problem};
use crate::trial::ReadError;

/// The deepest nesting of structs and cells.
pub(super) const MAX_DEPTH: usize = 32;

/// Values (arrays, texts, structs, cells) of one file at most.
pub(super) const MAX_VALUES: usize = 1_000_000;

/// Why a file cannot be read. Bytes count from 0, within the element that is read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MatError {
    /// It ends within something.
    #[error("the file ends in the middle of {0}")]
    Truncated(&'static str),
    /// A type of data that is none.
    #[error("{0} has the type {1}, which is none of numbers")]
    Type(&'static str, u32),
    /// Dimensions that no array has.
    #[error("an array has the dimensions {0:?}, which its data do not fill")]
    Dimensions(Vec<i64>),
    /// Too deep.
    #[error("structs and cells are nested more than {MAX_DEPTH} deep")]
    Depth,
    /// Too many values.
    #[error("there are more than {MAX_VALUES} arrays, texts, structs and cells")]
    Values,
    /// More than the limit.
    #[error("it unpacks to more than {0} bytes, the most that a file may hold")]
    TooLarge(u64),
    /// A compressed element that is not.
    #[error("a compressed variable cannot be unpacked: {0}")]
    Packed(String),
    /// Something that is not as the format has it.
    #[error("{0}")]
    Malformed(&'static str),
}

impl MatError {
    pub(super) fn problem(self) -> Problem {
        match self {
            Self::TooLarge(limit) => ReadError::TooManyBytes { limit }.into(),
            Self::Values | Self::Depth => Problem::new(Code::TooLarge, "too much in one file", self.to_string()).mend(
                "Save the signals of one trial as variables of their own: save('trial.mat', 't', 'r', 'u', 'y').",
            ),
            error => Problem::new(Code::Malformed, "damaged MATLAB file", error.to_string())
                .mend("Send the whole file again, or save it anew: save('trial.mat', 't', 'r', 'u', 'y')."),
        }
    }
}
