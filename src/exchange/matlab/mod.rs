//! MATLAB's files of level 4 and 5, read here: small, bounded, and with structs.
//!
//! Formats: The MathWorks, *MAT-File Format* (level 4; level 5 of versions 5 to 7.2). Numbers are stored in the
//! smallest type that holds them: their class stands elsewhere, and does not matter here, where all become doubles.
//! Nothing is allocated before it is known to be in the file: products of dimensions are checked, compressed elements
//! are unpacked within a budget over the whole file, and nesting ends at a depth.

mod bytes;
mod error;
mod level4;
mod level5;

use super::variables::Variables;
use crate::analysis::Problem;
pub use error::MatError;

/// What a file of MATLAB is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// Level 4.
    Four,
    /// Level 5: compressed (version 7) or not.
    Five,
}

/// Whether bytes are of a file of MATLAB, and which; level 4 has no mark of its own.
#[must_use]
pub fn recognise(head: &[u8]) -> Option<Level> {
    if level5::is_one(head) {
        Some(Level::Five)
    } else if level4::is_one(head) {
        Some(Level::Four)
    } else {
        None
    }
}

/// The variables of a file.
///
/// # Errors
/// Where it is damaged, or unpacks to more than `max_bytes`.
pub fn read(file: &[u8], level: Level, max_bytes: u64) -> Result<Variables, Problem> {
    let read = match level {
        Level::Four => level4::read(file, max_bytes),
        Level::Five => level5::read(file, max_bytes),
    };
    read.map_err(MatError::problem)
}
