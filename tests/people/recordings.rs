//! Where the recordings are, and what a file of them holds.

use std::path::{Path, PathBuf};
use volition::trial::ReadTrial;
use volition::trial::csv::{self, Options};
use volition::trial::gzip::GzipReader;

/// The folder of the recordings.
///
/// # Panics
/// Where they are not: a test that has no data has shown nothing.
pub fn folder() -> PathBuf {
    let named = std::env::var_os("VOLITION_CPHS2017").map(PathBuf::from);
    let folder = named.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/cphs2017"));
    let index = folder.join("index.csv");
    assert!(index.is_file(), "{} is not there: VOLITION_CPHS2017 says where the recordings are", index.display());
    folder
}

pub fn read(path: &Path) -> ReadTrial {
    let file = std::fs::File::open(path).unwrap();
    csv::read(GzipReader::new(file), &Options::default()).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
