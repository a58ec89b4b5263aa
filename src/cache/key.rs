//! What something was made from, as one number.

use sha2::{Digest, Sha256};
use std::fmt::Write as _;

/// Names something in a [`ByteStore`](super::ByteStore) by its kind and the SHA-256 of everything that it depends on,
/// the code included: two things with the same key are interchangeable.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Key {
    kind: &'static str,
    sha256: [u8; 32],
}

impl Key {
    /// What it is: a word in lower-case letters.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        self.kind
    }

    /// The hash of what it was made from.
    #[must_use]
    pub fn sha256(&self) -> &[u8; 32] {
        &self.sha256
    }

    /// The hash in lower-case hexadecimal.
    #[must_use]
    pub fn hexadecimal(&self) -> String {
        self.sha256.iter().fold(String::with_capacity(64), |mut text, byte| {
            // Writing to a String cannot fail.
            let _ = write!(text, "{byte:02x}");
            text
        })
    }
}

/// Hashes what a key depends on: every member goes into the hash with its length or a tag before it, so that no two
/// lists of members look alike, and numbers go in bit by bit.
pub(crate) struct KeyHasher {
    kind: &'static str,
    hash: Sha256,
}

impl KeyHasher {
    /// Of a kind of thing, made by this program.
    pub(crate) fn new(kind: &'static str) -> Self {
        let mut made = Self { kind, hash: Sha256::new() };
        made.text(kind);
        made.text(env!("CARGO_PKG_VERSION"));
        // The version of a program that is being worked on stays the same: see build.rs.
        made.text(env!("VOLITION_TREES_CODE"));
        made
    }

    pub(crate) fn key(self) -> Key {
        Key { kind: self.kind, sha256: self.hash.finalize().into() }
    }

    pub(crate) fn number(&mut self, number: u64) {
        self.hash.update(number.to_le_bytes());
    }

    pub(crate) fn length(&mut self, length: usize) {
        self.number(length as u64);
    }

    pub(crate) fn real(&mut self, x: f64) {
        self.number(x.to_bits());
    }

    pub(crate) fn text(&mut self, text: &str) {
        self.length(text.len());
        self.hash.update(text);
    }

    pub(crate) fn reals(&mut self, values: &[f64]) {
        self.length(values.len());
        values.iter().for_each(|x| self.real(*x));
    }
}
