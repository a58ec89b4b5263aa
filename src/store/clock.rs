//! What time it is.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use time::OffsetDateTime;

/// Where the store gets the time from. Leases are judged by it, so all processes on one database must agree on it to
/// within a fraction of the lease.
#[derive(Debug, Clone, Default)]
pub enum Clock {
    /// The system's clock.
    #[default]
    System,
    /// A clock that stands still until it is moved: microseconds since 1970 UTC. For tests of leases and waits.
    Manual(Arc<AtomicI64>),
}

impl Clock {
    /// Microseconds since 1970 UTC.
    #[must_use]
    pub(crate) fn now_us(&self) -> i64 {
        match self {
            Self::System => micros(OffsetDateTime::now_utc()),
            Self::Manual(now) => now.load(Ordering::SeqCst),
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
