//! Where what takes long to make is kept: content keys, stores of bytes, and how values become bytes.
//!
//! A [`Key`] is the hash of everything that a thing was made from, the code included, so that nothing has to be kept in
//! step with anything. This room has no files: whoever has them gives a [`ByteStore`].

mod byte_store;
pub(crate) mod codec;
mod key;
mod statistics;

pub use byte_store::{ByteStore, ReadBytes, WriteBytes};
pub use key::Key;
pub(crate) use key::KeyHasher;
pub use statistics::{CacheCounters, CacheStatistics, Origins};
