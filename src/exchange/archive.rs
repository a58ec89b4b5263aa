//! Zip archives: of NumPy, of Excel, or of a folder.
//!
//! What stands in an archive about sizes is not believed: files are unpacked within a budget over the whole archive.

use crate::analysis::{Code, Problem};
use crate::trial::ReadError;
use std::io::{Cursor, Read as _};
use zip::ZipArchive;

pub(super) const MARK: &[u8] = b"PK\x03\x04";

/// How an archive without files begins.
pub(super) const MARK_OF_NONE: &[u8] = b"PK\x05\x06";

/// Files of an archive at most.
const MAX_FILES: usize = 10_000;

/// What an archive is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Numpy,
    Excel,
    Folder,
}

/// An archive that is being unpacked.
pub(super) struct Archive<'a> {
    zip: ZipArchive<Cursor<&'a [u8]>>,
    max_bytes: u64,
    left: u64,
}

fn damaged(why: impl std::fmt::Display) -> Problem {
    Problem::new(Code::Malformed, "damaged zip archive", format!("the archive cannot be unpacked: {why}"))
        .mend("Send the whole archive again, without a password, or its files one by one.")
}

impl<'a> Archive<'a> {
    pub(super) fn open(bytes: &'a [u8], max_bytes: u64) -> Result<Self, Problem> {
        let zip = ZipArchive::new(Cursor::new(bytes)).map_err(damaged)?;
        if zip.len() > MAX_FILES {
            let detail = format!("the archive has {} files, and {MAX_FILES} are taken", zip.len());
            return Err(
                Problem::new(Code::TooLarge, "too many files", detail).mend("Send the files in several archives.")
            );
        }
        Ok(Self { zip, max_bytes, left: max_bytes })
    }

    /// The names of all files, in the order of the archive.
    pub(super) fn names(&self) -> Vec<String> {
        let name = |at| self.zip.name_for_index(at).and_then(Result::ok).map_or_else(String::new, |n| n.into_owned());
        (0..self.zip.len()).map(name).collect()
    }

    pub(super) fn kind(&self) -> Kind {
        let names = self.names();
        if names.iter().any(|name| name == "xl/workbook.xml") {
            Kind::Excel
        } else if !names.is_empty() && names.iter().all(|name| name.ends_with(".npy")) {
            Kind::Numpy
        } else {
            Kind::Folder
        }
    }

    /// Unpacks one file.
    pub(super) fn file(&mut self, at: usize) -> Result<Vec<u8>, Problem> {
        let mut bytes = Vec::new();
        let file = self.zip.by_index(at).map_err(damaged)?;
        file.take(self.left.saturating_add(1)).read_to_end(&mut bytes).map_err(damaged)?;
        self.left = self
            .left
            .checked_sub(bytes.len() as u64)
            .ok_or_else(|| Problem::from(ReadError::TooManyBytes { limit: self.max_bytes }))?;
        Ok(bytes)
    }

    /// Bytes that were unpacked.
    pub(super) fn unpacked(&self) -> u64 {
        self.max_bytes - self.left
    }
}

/// Whether the bytes are an archive of a folder, and not of one of the formats that are archives.
#[must_use]
pub fn is_folder(bytes: &[u8]) -> bool {
    bytes.starts_with(MARK) && Archive::open(bytes, 0).is_ok_and(|archive| archive.kind() == Kind::Folder)
}

/// The files of an archived folder, by their paths in it, without what systems put there for themselves.
///
/// # Errors
/// Where the archive is damaged, has no files, or one that leads out of it, or unpacks to more than `max_bytes`.
pub fn folder(bytes: &[u8], max_bytes: u64) -> Result<Vec<(String, Vec<u8>)>, Problem> {
    let mut archive = Archive::open(bytes, max_bytes)?;
    let mut files = Vec::new();
    for (at, name) in archive.names().into_iter().enumerate() {
        if name.starts_with(['/', '\\']) || name.split(['/', '\\']).any(|part| part == "..") {
            let why = format!("the path {name:?} leads outside the archive");
            return Err(Problem::new(Code::Malformed, "a path that leads outside", why).mend("Pack the folder anew."));
        }
        let is_own = name.split('/').any(|part| part.starts_with('.') || part == "__MACOSX" || part == "Thumbs.db");
        if !name.ends_with('/') && !is_own {
            files.push((name, archive.file(at)?));
        }
    }
    if files.is_empty() {
        return Err(Problem::new(Code::Malformed, "no files", "the archive has no file").mend("Send recordings."));
    }
    Ok(files)
}
