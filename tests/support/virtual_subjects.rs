//! Virtual subjects of another simulator: 60 trials and the truth behind them
//! (`tests/data/virtual_subjects/README.md`).

use std::path::{Path, PathBuf};

/// The folder of the trials.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/virtual_subjects")
}
