//! Bytes of a file, packed or not, which can be read from the start as often as is needed.

use crate::analysis::Problem;
use crate::trial::ReadError;
use crate::trial::gzip::GzipReader;
use std::io::Read;

/// From so many bytes a file is recognised.
const HEAD_BYTES: usize = 64 * 1024;

/// How gzip begins.
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// A file in memory.
pub(super) struct Source<'a> {
    bytes: &'a [u8],
    pub(super) is_packed: bool,
}

/// The beginning of a file, unpacked.
pub(super) struct Head {
    pub(super) bytes: Vec<u8>,
    /// Whether this is all there is.
    pub(super) is_whole: bool,
}

impl<'a> Source<'a> {
    /// Packed, if it looks so.
    pub(super) fn of(bytes: &'a [u8]) -> Self {
        Self { bytes, is_packed: bytes.starts_with(&GZIP) }
    }

    /// Packed, as is said.
    pub(super) fn packed(bytes: &'a [u8]) -> Self {
        Self { bytes, is_packed: true }
    }

    /// The unpacked bytes from the start.
    pub(super) fn open(&self) -> Counted<'a> {
        let inner: Box<dyn Read + 'a> =
            if self.is_packed { Box::new(GzipReader::new(self.bytes)) } else { Box::new(self.bytes) };
        Counted { inner, count: 0 }
    }

    pub(super) fn head(&self, max_bytes: u64) -> Result<Head, Problem> {
        let mut bytes = Vec::new();
        let wanted = (HEAD_BYTES as u64).min(max_bytes.saturating_add(1));
        let mut source = self.open();
        source.by_ref().take(wanted).read_to_end(&mut bytes).map_err(|error| Problem::from(ReadError::from(error)))?;
        let mut next = [0];
        // A defect behind the head is met by whoever reads on.
        let is_whole = (bytes.len() as u64) < wanted || matches!(source.read(&mut next), Ok(0));
        Ok(Head { bytes, is_whole })
    }

    /// All unpacked bytes, within the limit.
    pub(super) fn whole(&self, max_bytes: u64) -> Result<Vec<u8>, Problem> {
        let mut bytes = Vec::new();
        let mut source = self.open().take(max_bytes.saturating_add(1));
        source.read_to_end(&mut bytes).map_err(|error| Problem::from(ReadError::from(error)))?;
        if bytes.len() as u64 > max_bytes {
            return Err(ReadError::TooManyBytes { limit: max_bytes }.into());
        }
        Ok(bytes)
    }
}

/// Counts what passes.
pub(super) struct Counted<'a> {
    inner: Box<dyn Read + 'a>,
    count: u64,
}

impl Counted<'_> {
    pub(super) fn count(&self) -> u64 {
        self.count
    }
}

impl Read for Counted<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.inner.read(buffer)?;
        self.count += read as u64;
        Ok(read)
    }
}
