//! Rows that could not be read: left out of lists, never in silence.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

/// Rows remembered at most; a file with more is beyond counting.
const MOST: usize = 10_000;

/// Damaged rows met since the program was started, by what they are and their ids; each is logged once.
#[derive(Debug, Default)]
pub(super) struct Damage {
    met: Mutex<BTreeSet<(String, String)>>,
}

impl Damage {
    /// Notes that a row is damaged.
    pub(super) fn note(&self, noun: &str, id: &str, why: &str) {
        let mut met = self.met.lock().unwrap_or_else(PoisonError::into_inner);
        if met.len() < MOST && met.insert((noun.to_owned(), id.to_owned())) {
            tracing::error!(noun, id, why, "a stored row is damaged and left out of lists; volition verify names all");
        }
    }

    /// All that were met.
    pub(super) fn met(&self) -> BTreeSet<(String, String)> {
        self.met.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
