//! The handle between a computation and whoever waits for it.
//!
//! A kernel calls [`Ctl::check`] often enough to stop within half a second and reports its progress with
//! [`Ctl::set_total`] and [`Ctl::advance`]; a search for a smallest cost tells with [`Ctl::set_bracket`] how near it
//! is. Whoever calls several kernels names the phases of the whole with [`Ctl::enter`]. Whoever waits calls [`Ctl::stop`], [`Ctl::progress`] and [`Ctl::bracket`]. There is no clock here: a deadline is
//! somebody with a clock calling `stop(StopReason::Deadline)`.

mod bracket;
mod progress;

pub use bracket::Bracket;
pub use progress::{Phase, Progress, UnknownPhase};
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

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

/// Shared between the threads of one computation and its watcher.
#[derive(Debug, Default)]
pub struct Ctl {
    stop: AtomicU8,
    /// Units finished; counted by every thread, so apart from the rest.
    done: AtomicU64,
    course: Mutex<Course>,
    bracket: Mutex<Option<Bracket>>,
}

/// Where in the whole computation the present count stands.
#[derive(Debug, Default)]
struct Course {
    /// The present phase, with what was said of it last.
    progress: Progress,
    /// Whether a phase was entered; until then there is one that covers everything.
    entered: bool,
    /// The present count is part `.0` of `.1` alike in the phase.
    part: (u64, u64),
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

    /// Begins a phase that takes about `share` of the whole computation's time, from 0 to 1; the phase before is over.
    pub fn enter(&self, phase: Phase, share: f64) {
        let mut course = held(&self.course);
        let from = if course.entered { course.progress.to } else { 0.0 };
        let to = (from + share.max(0.0)).min(1.0);
        let fraction = course.progress.fraction.max(from);
        self.done.store(0, Ordering::Relaxed);
        *course =
            Course { progress: Progress { phase, done: 0, total: 0, from, to, fraction }, entered: true, part: (0, 1) };
    }

    /// Says that the counts to come are part `index` (from 0) of `parts` of like length in the present phase.
    pub fn part(&self, index: u64, parts: u64) {
        held(&self.course).part = (index.min(parts), parts.max(1));
        self.set_total(0);
    }

    /// Says how many units there are in all, and starts counting from none.
    pub fn set_total(&self, total: u64) {
        // Under the lock, so that nobody sees the units of one count in the total of another.
        let mut course = held(&self.course);
        self.done.store(0, Ordering::Relaxed);
        course.progress.total = total;
    }

    /// Says that `units` more are finished.
    pub fn advance(&self, units: u64) {
        self.done.fetch_add(units, Ordering::Relaxed);
    }

    /// How far the computation has come.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn progress(&self) -> Progress {
        let mut course = held(&self.course);
        let (index, parts) = (course.part.0 as f64, course.part.1.max(1) as f64);
        let progress = &mut course.progress;
        progress.done = self.done.load(Ordering::Relaxed).min(progress.total);
        let within = ((index + progress::share(progress.done, progress.total)) / parts).min(1.0);
        progress.fraction = progress.fraction.max(progress.from + (progress.to - progress.from) * within);
        *progress
    }

    /// Forgets the bracket: a new search begins. Whoever calls a search does this, the search itself only tells.
    pub fn begin_search(&self) {
        *held(&self.bracket) = None;
    }

    /// Adds what a search has found and proven to what is known: the incumbent only falls (its index with it), the
    /// bound only rises. What is no number is passed over. Takes a lock, so not for every candidate.
    pub fn set_bracket(&self, bracket: Bracket) {
        let Some(bracket) = bracket.checked() else { return };
        let mut known = held(&self.bracket);
        *known = Some(known.map_or(bracket, |before| before.and(bracket)));
    }

    /// How near the search under way is, or the last one was; `None` before anything is found.
    #[must_use]
    pub fn bracket(&self) -> Option<Bracket> {
        *held(&self.bracket)
    }
}

/// A lock on plain values, which are whole whenever it is free.
fn held<T>(lock: &Mutex<T>) -> MutexGuard<'_, T> {
    lock.lock().unwrap_or_else(PoisonError::into_inner)
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
        assert_eq!(ctl.progress(), Progress::of_units(10, 10));
    }

    #[test]
    fn the_fraction_of_the_whole_never_falls() {
        let ctl = Ctl::new();
        assert_eq!(ctl.progress(), Progress::default());
        ctl.enter(Phase::Preparation, 0.25);
        ctl.set_total(4);
        ctl.advance(2);
        assert_eq!(
            ctl.progress(),
            Progress { phase: Phase::Preparation, done: 2, total: 4, from: 0.0, to: 0.25, fraction: 0.125 }
        );
        ctl.enter(Phase::Search, 0.5);
        assert_eq!((ctl.progress().done, ctl.progress().total, ctl.progress().fraction), (0, 0, 0.25));
        for part in 0..2 {
            ctl.part(part, 2);
            ctl.set_total(10);
            ctl.advance(5);
            assert_eq!(ctl.progress().fraction, 0.25 + 0.5 * (part as f64 + 0.5) / 2.0);
        }
        // A count that begins again, with nothing said of parts.
        ctl.set_total(1000);
        assert_eq!(ctl.progress().fraction, 0.625);
        ctl.enter(Phase::Fit, 3.0);
        assert_eq!((ctl.progress().from, ctl.progress().to), (0.75, 1.0));
        ctl.set_total(1);
        ctl.advance(1);
        assert_eq!(ctl.progress().fraction, 1.0);
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
