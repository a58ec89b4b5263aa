//! A file that only takes room, so that people can delete and cancel when the disk is full.

use super::error::is_no_room;
use super::place::{beside, create_private};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Bytes written at once.
const CHUNK: usize = 64 << 10;

/// The room that is kept. It is there, or it was given away; processes on one database share the file.
#[derive(Debug)]
pub(super) struct Reserve {
    file: PathBuf,
    bytes: u64,
    /// One makes it at a time.
    making: Mutex<()>,
}

/// Whether the room is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kept {
    /// It is, or cannot be for other reasons than a full disk.
    Yes,
    /// There is no room for it.
    NoRoom,
}

impl Reserve {
    pub(super) fn beside(database: &Path, bytes: u64) -> Self {
        Self { file: beside(database, ".reserve"), bytes, making: Mutex::new(()) }
    }

    /// Whether the room is kept already; asked before every write.
    pub(super) fn is_there(&self) -> bool {
        std::fs::metadata(&self.file).is_ok_and(|found| found.len() == self.bytes)
    }

    /// Gives the room away; false where there was none to give.
    pub(super) fn give(&self) -> bool {
        match std::fs::remove_file(&self.file) {
            Ok(()) => {
                tracing::warn!(file = %self.file.display(), "the disk is full; the reserve was given away");
                true
            }
            Err(_) => false,
        }
    }

    /// Makes sure that it is there.
    pub(super) fn keep(&self) -> Kept {
        if self.is_there() {
            return Kept::Yes;
        }
        let _making = self.making.lock().unwrap_or_else(PoisonError::into_inner);
        if self.is_there() {
            return Kept::Yes;
        }
        match self.make() {
            Ok(()) => Kept::Yes,
            Err(error) => {
                let _ = std::fs::remove_file(&self.file);
                if is_no_room(&error) {
                    return Kept::NoRoom;
                }
                tracing::warn!(file = %self.file.display(), %error, "no room can be kept for a full disk");
                Kept::Yes
            }
        }
    }

    fn make(&self) -> std::io::Result<()> {
        let _ = std::fs::remove_file(&self.file);
        let mut file = create_private(&self.file)?;
        // Zeros take no room on file systems that compress, nor do holes.
        let mut word: u64 = 0x9E37_79B9_7F4A_7C15;
        let mut left = self.bytes;
        while left > 0 {
            let many = usize::try_from(left).unwrap_or(CHUNK).min(CHUNK);
            let noise = std::iter::from_fn(|| {
                word ^= word << 13;
                word ^= word >> 7;
                word ^= word << 17;
                Some(word.to_le_bytes())
            });
            let chunk: Vec<u8> = noise.flatten().take(many).collect();
            file.write_all(&chunk)?;
            left -= many as u64;
        }
        file.sync_all()
    }
}
