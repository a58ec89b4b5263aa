//! Bytes by key.

use super::key::Key;
use std::fmt;
use std::io::{self, Read, Write};

/// Takes in the bytes under a key, of which there are so many.
pub type ReadBytes<'a> = dyn FnMut(&mut (dyn Read + Send), u64) -> io::Result<()> + 'a;

/// Gives the bytes that are to be kept.
pub type WriteBytes<'a> = dyn FnMut(&mut dyn Write) -> io::Result<()> + 'a;

/// Bytes by key.
///
/// A store may lose what it was given, at any time: it is made again. It must not give anything else.
pub trait ByteStore: fmt::Debug + Send + Sync {
    /// Gives the bytes under a key to `read`, once, and says whether there were any, all of them were taken, and they
    /// are those that were saved. What `read` made of them is to be thrown away otherwise, so they may be checked while
    /// they are read.
    ///
    /// `read` fails with [`io::ErrorKind::Interrupted`] where it was asked to stop, and otherwise where the bytes make
    /// no sense.
    fn load(&self, key: &Key, read: &mut ReadBytes<'_>) -> bool;

    /// Keeps what `write` writes under a key, in place of what was there before; nothing where it fails.
    fn save(&self, key: &Key, write: &mut WriteBytes<'_>);
}
