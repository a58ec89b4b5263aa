//! Where pools and trees wait for the next process.
//!
//! What a search builds before it looks at a trial depends on the plant, the pool and the lines alone, and takes up to a minute. A
//! [`Shelf`] keeps it as bytes under a [`Key`], the hash of everything that it was made from. This layer has no files: whoever has them
//! gives it a shelf.

mod key;
mod wire;

use std::fmt;
use std::io::{self, Read, Write};

pub use key::Key;
pub(super) use key::Maker;
pub(super) use wire::{Plain, Record, Sink, Slice, Source, bad, put_all};

/// Takes in the bytes under a key, of which there are so many.
pub type Reading<'a> = dyn FnMut(&mut (dyn Read + Send), u64) -> io::Result<()> + 'a;

/// Gives the bytes that are to be kept.
pub type Writing<'a> = dyn FnMut(&mut dyn Write) -> io::Result<()> + 'a;

/// Bytes by key.
///
/// A shelf may lose what it was given, at any time: it is made again. It must not give anything else.
pub trait Shelf: fmt::Debug + Send + Sync {
    /// Gives the bytes under a key to `read`, once, and says whether there were any, all of them were taken, and they are those that
    /// were saved. What `read` made of them is to be thrown away otherwise, so they may be checked while they are read.
    ///
    /// `read` fails with [`io::ErrorKind::Interrupted`] where it was asked to stop, and otherwise where the bytes make no sense.
    fn load(&self, key: &Key, read: &mut Reading<'_>) -> bool;

    /// Keeps what `write` writes under a key, in place of what was there before; nothing where it fails.
    fn save(&self, key: &Key, write: &mut Writing<'_>);
}
