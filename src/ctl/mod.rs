//! The handle between a computation and whoever waits for it.
//!
//! A kernel calls [`Ctl::check`] often enough to stop within half a second and reports its progress with
//! [`Ctl::set_total`] and [`Ctl::advance`]; a search for a smallest cost tells with [`Ctl::set_bracket`] how near it
//! is. Whoever waits calls [`Ctl::stop`], [`Ctl::progress`] and [`Ctl::bracket`]. There is no clock here: a deadline is
//! somebody with a clock calling `stop(StopReason::Deadline)`.

mod bracket;

pub use bracket::Bracket;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Why a computation was asked to stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum StopReason {
    /// A person cancelled the analysis.
    Cancelled = 1,
    /// The time that the analysis was given has passed.
    Deadline = 2,
    /// Nobody waits for the result any more; whatever is computed now would be thrown away.
    Withdrawn = 3,
    /// The process is going down and hands the work back.
    Shutdown = 4,
}

/// The computation stopped early because it was asked to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("stopped before the end ({0:?})")]
pub struct Stopped(pub StopReason);

/// How far a computation has come, in units of its own choosing (candidates, trials, frequencies).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Progress {
    /// Units finished.
    pub done: u64,
    /// Units in all; 0 while it is not known yet.
    pub total: u64,
}

/// Shared between the threads of one computation and its watcher.
#[derive(Debug, Default)]
pub struct Ctl {
    stop: Arc<AtomicU8>,
    done: AtomicU64,
    total: AtomicU64,
    bracket: Mutex<Option<Bracket>>,
}

/// Whether a computation was asked to stop, for a callback of a library that outlives the borrow of its [`Ctl`].
#[derive(Debug, Clone)]
pub struct StopFlag(Arc<AtomicU8>);

impl StopFlag {
    /// Whether somebody asked the computation to stop.
    #[must_use]
    pub fn is_raised(&self) -> bool {
        self.0.load(Ordering::Relaxed) != 0
    }
}

impl Ctl {
    /// A handle that nobody has stopped yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks the computation to stop. The first reason given is the one that counts.
    pub fn stop(&self, reason: StopReason) {
        // A failed exchange means that an earlier reason stands, which is what is wanted.
        let _ = self.stop.compare_exchange(0, reason as u8, Ordering::Relaxed, Ordering::Relaxed);
    }

    /// The same question for a callback.
    #[must_use]
    pub fn stop_flag(&self) -> StopFlag {
        StopFlag(Arc::clone(&self.stop))
    }

    /// `Err` once somebody asked the computation to stop.
    ///
    /// # Errors
    /// [`Stopped`] with the first reason given to [`Ctl::stop`].
    pub fn check(&self) -> Result<(), Stopped> {
        match self.stop.load(Ordering::Relaxed) {
            0 => Ok(()),
            1 => Err(Stopped(StopReason::Cancelled)),
            2 => Err(Stopped(StopReason::Deadline)),
            3 => Err(Stopped(StopReason::Withdrawn)),
            _ => Err(Stopped(StopReason::Shutdown)),
        }
    }

    /// Says how many units there are in all, and starts counting from none.
    pub fn set_total(&self, total: u64) {
        self.done.store(0, Ordering::Relaxed);
        self.total.store(total, Ordering::Relaxed);
    }

    /// Says that `units` more are finished.
    pub fn advance(&self, units: u64) {
        self.done.fetch_add(units, Ordering::Relaxed);
    }

    /// How far the computation has come.
    #[must_use]
    pub fn progress(&self) -> Progress {
        let total = self.total.load(Ordering::Relaxed);
        Progress { done: self.done.load(Ordering::Relaxed).min(total), total }
    }

    /// Forgets the bracket: a new search begins. Whoever calls a search does this, the search itself only tells.
    pub fn begin_search(&self) {
        *self.held() = None;
    }

    /// Adds what a search has found and proven to what is known: the incumbent only falls (its index with it), the
    /// bound only rises. What is no number is passed over. Takes a lock, so not for every candidate.
    pub fn set_bracket(&self, bracket: Bracket) {
        let Some(bracket) = bracket.checked() else { return };
        let mut held = self.held();
        *held = Some(held.map_or(bracket, |before| before.and(bracket)));
    }

    /// How near the search under way is, or the last one was; `None` before anything is found.
    #[must_use]
    pub fn bracket(&self) -> Option<Bracket> {
        *self.held()
    }

    fn held(&self) -> MutexGuard<'_, Option<Bracket>> {
        // A plain value: whole whenever the lock is free.
        self.bracket.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_reason_stands() {
        let ctl = Ctl::new();
        assert_eq!(ctl.check(), Ok(()));
        ctl.stop(StopReason::Cancelled);
        ctl.stop(StopReason::Deadline);
        assert_eq!(ctl.check(), Err(Stopped(StopReason::Cancelled)));
    }

    #[test]
    fn progress_never_passes_the_total() {
        let ctl = Ctl::new();
        ctl.set_total(10);
        ctl.advance(7);
        ctl.advance(7);
        assert_eq!(ctl.progress(), Progress { done: 10, total: 10 });
    }

    #[test]
    fn the_gap_only_shrinks_until_a_new_search_begins() {
        let ctl = Ctl::new();
        assert_eq!(ctl.bracket(), None);
        ctl.set_bracket(Bracket { incumbent: f64::NAN, bound: 0.0, index: 1 });
        assert_eq!(ctl.bracket(), None);
        ctl.set_bracket(Bracket { incumbent: 2.0, bound: 1.0, index: 3 });
        ctl.set_bracket(Bracket { incumbent: 8.0, bound: 1.5, index: 4 });
        ctl.set_total(9);
        assert_eq!(ctl.bracket(), Some(Bracket { incumbent: 2.0, bound: 1.5, index: 3 }));
        ctl.begin_search();
        assert_eq!(ctl.bracket(), None);
    }
}
