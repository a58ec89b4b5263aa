//! Archives whose bytes follow from their files alone.

use std::io::{Cursor, Seek, Write};
use zip::result::ZipResult;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// Rights that every file has.
const RIGHTS: u32 = 0o644;

/// What is said of every file: packed, no time, plain rights.
fn options() -> SimpleFileOptions {
    SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .compression_level(Some(6))
        .last_modified_time(DateTime::default())
        .unix_permissions(RIGHTS)
}

/// Adds a file.
///
/// # Errors
/// Those of the writer, and a name that stands there already.
pub fn add<W: Write + Seek>(archive: &mut ZipWriter<W>, name: &str, bytes: &[u8]) -> ZipResult<()> {
    archive.start_file(name, options())?;
    archive.write_all(bytes)?;
    Ok(())
}

/// An archive in memory, its files in the order of their names.
#[must_use]
pub fn write(mut files: Vec<(String, Vec<u8>)>) -> Vec<u8> {
    files.sort_by(|a, b| a.0.cmp(&b.0));
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in &files {
        // Writing to memory does not fail, and columns have different names.
        let _ = add(&mut archive, name, bytes);
    }
    archive.finish().map(Cursor::into_inner).unwrap_or_default()
}
