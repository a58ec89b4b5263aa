//! How much a reader takes before it gives up.

/// Bounds that are enforced while reading, so that a small file that unpacks to a large one never fills the memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Samples per trial at most.
    pub max_rows: usize,
    /// Bytes at most, counted after decompression.
    pub max_bytes: u64,
}

impl Default for Limits {
    /// 2 million rows (over an hour at 500 Hz) and 256 MiB.
    fn default() -> Self {
        Self { max_rows: 2_000_000, max_bytes: 256 * 1024 * 1024 }
    }
}
