//! Unpacking gzip (RFC 1952) on the way, with its defects told apart.

use flate2::bufread::GzDecoder;
use std::io::{self, BufRead, BufReader, Read};

const MAGIC: [u8; 2] = [0x1f, 0x8b];

/// Why bytes are no gzip file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum GzipError {
    /// Not a single byte.
    #[error("the gzip data is empty: not even a header is there")]
    Empty,
    /// It does not begin as gzip does.
    #[error("the data is said to be gzip, but does not begin with a gzip header")]
    NotGzip,
    /// It ends before its end.
    #[error("the gzip data is truncated: it ends after {unpacked_bytes} unpacked bytes, without its checksum")]
    Truncated {
        /// Bytes unpacked until then.
        unpacked_bytes: u64,
    },
    /// A header, a block or a checksum is wrong.
    #[error("the gzip data is corrupted after {unpacked_bytes} unpacked bytes: {reason}")]
    Corrupted {
        /// Bytes unpacked until then.
        unpacked_bytes: u64,
        /// What the decoder says.
        reason: String,
    },
    /// A whole gzip file with something else behind it.
    #[error("after {unpacked_bytes} unpacked bytes the gzip data ends, and other bytes follow")]
    TrailingGarbage {
        /// Bytes unpacked until then.
        unpacked_bytes: u64,
    },
}

/// Reads the unpacked bytes; several gzip members in succession are one file, as RFC 1952 has it.
///
/// Errors are `io::Error`s that carry a [`GzipError`]; a failing source's own errors pass through.
pub struct GzipReader<R> {
    member: Option<GzDecoder<BufReader<R>>>,
    waiting: Option<BufReader<R>>,
    members: u64,
    unpacked: u64,
}

impl<R: Read> GzipReader<R> {
    /// Unpacks `source` as it is read.
    pub fn new(source: R) -> Self {
        Self { member: None, waiting: Some(BufReader::new(source)), members: 0, unpacked: 0 }
    }

    /// Starts the next member; false at the end of the file.
    fn next_member(&mut self) -> io::Result<bool> {
        let Some(mut source) = self.waiting.take() else { return Ok(false) };
        let ahead = source.fill_buf()?;
        if ahead.is_empty() {
            return if self.members == 0 { Err(wrap(GzipError::Empty)) } else { Ok(false) };
        }
        // A source may give a single byte at a time; what is there must agree, the decoder checks the rest.
        let known = ahead.len().min(MAGIC.len());
        if ahead[..known] != MAGIC[..known] {
            return Err(wrap(if self.members == 0 {
                GzipError::NotGzip
            } else {
                GzipError::TrailingGarbage { unpacked_bytes: self.unpacked }
            }));
        }
        self.member = Some(GzDecoder::new(source));
        self.members += 1;
        Ok(true)
    }

    fn explain(&self, error: io::Error) -> io::Error {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => wrap(GzipError::Truncated { unpacked_bytes: self.unpacked }),
            io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData => {
                wrap(GzipError::Corrupted { unpacked_bytes: self.unpacked, reason: error.to_string() })
            }
            _ => error,
        }
    }
}

fn wrap(error: GzipError) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, error)
}

impl<R: Read> Read for GzipReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if buffer.is_empty() {
            return Ok(0);
        }
        loop {
            if self.member.is_none() && !self.next_member()? {
                return Ok(0);
            }
            let Some(member) = self.member.as_mut() else { return Ok(0) };
            match member.read(buffer) {
                Ok(0) => self.waiting = self.member.take().map(GzDecoder::into_inner),
                Ok(count) => {
                    self.unpacked += count as u64;
                    return Ok(count);
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => return Err(error),
                Err(error) => {
                    self.member = None;
                    return Err(self.explain(error));
                }
            }
        }
    }
}
