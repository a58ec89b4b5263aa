//! What time it is.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Instant;
use time::OffsetDateTime;

/// Where the store gets the time from: the time of day, which is written down for people and may be set at any moment,
/// and a time that only passes, by which the silence of workers is judged.
#[derive(Debug, Clone, Default)]
pub enum Clock {
    /// The system's clocks.
    #[default]
    System,
    /// Clocks that stand still until they are moved, both at once: microseconds since 1970 UTC. For tests.
    Manual(Arc<AtomicI64>),
    /// The same, moved one by one: a time of day that is set while time passes.
    Apart {
        /// The time of day, in microseconds since 1970 UTC.
        day: Arc<AtomicI64>,
        /// Microseconds that have passed.
        passed: Arc<AtomicI64>,
    },
}

impl Clock {
    /// The time of day in microseconds since 1970 UTC.
    #[must_use]
    pub(crate) fn now_us(&self) -> i64 {
        match self {
            Self::System => micros(OffsetDateTime::now_utc()),
            Self::Manual(now) | Self::Apart { day: now, .. } => now.load(Ordering::SeqCst),
        }
    }

    /// The time of day.
    #[must_use]
    pub(super) fn now(&self) -> OffsetDateTime {
        // Out of range only some 290,000 years from 1970.
        OffsetDateTime::from_unix_timestamp_nanos(i128::from(self.now_us()) * 1000)
            .unwrap_or(OffsetDateTime::UNIX_EPOCH)
    }

    /// Microseconds since some moment before this store was opened. They stand still while the machine sleeps, as its
    /// workers do.
    #[must_use]
    pub(super) fn passed_us(&self, opened: Instant) -> i64 {
        match self {
            Self::System => i64::try_from(opened.elapsed().as_micros()).unwrap_or(i64::MAX),
            Self::Manual(now) | Self::Apart { passed: now, .. } => now.load(Ordering::SeqCst),
        }
    }
}

/// A time as the database holds it.
pub(super) fn micros(time: OffsetDateTime) -> i64 {
    // Out of range only some 290,000 years from 1970.
    i64::try_from(time.unix_timestamp_nanos() / 1000).unwrap_or(i64::MAX)
}

/// A duration in seconds as whole microseconds.
#[allow(clippy::cast_possible_truncation)]
pub(super) fn span_us(seconds: f64) -> i64 {
    (seconds * 1e6).round() as i64
}
