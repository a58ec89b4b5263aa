//! What reading a file gives.

use super::understood::Understood;
use crate::analysis::Warning;
use crate::trial::Trial;

/// A recording, and what was made of its file.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// The recording.
    pub trial: Trial,
    /// What the file was taken for.
    pub understood: Understood,
    /// Columns of the file that are no signal of a trial, by name, in file order.
    pub ignored_columns: Vec<String>,
    /// What was done to the recording on the way, which must be known wherever it is used.
    pub warnings: Vec<Warning>,
    /// Bytes read, after unpacking.
    pub bytes: u64,
}
