//! The handle between a computation and whoever waits for it.
//!
//! A kernel calls [`Ctl::check`] often enough to stop within half a second and reports its progress with
//! [`Ctl::set_total`] and [`Ctl::advance`]; a search for a smallest cost tells with [`Ctl::set_bracket`] how near it
//! is. Whoever calls several kernels names the phases with [`Ctl::enter`], and gives a kernel that has phases of its
//! own its share with [`Ctl::scope`]. Whoever waits calls [`Ctl::stop`], [`Ctl::progress`] and [`Ctl::bracket`]. There
//! is no clock here: a deadline is somebody with a clock calling `stop(StopReason::Deadline)`.

mod bracket;
mod progress;

pub use bracket::Bracket;
pub use progress::{Phase, Progress, UnknownPhase};
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

/// Shared between the threads of one computation and its watcher.
#[derive(Debug, Default)]
pub struct Ctl {
    stop: Arc<AtomicU8>,
    /// Units finished; counted by every thread, so apart from the rest.
    done: AtomicU64,
    course: Mutex<Course>,
    bracket: Mutex<Option<Bracket>>,
}

/// Where in the whole computation the present count stands.
#[derive(Debug)]
struct Course {
    /// The present phase, with what was said of it last. Before one is entered there is one that covers everything.
    progress: Progress,
    /// The scopes that are open, the innermost last; the first is the whole.
    scopes: Vec<Extent>,
}

/// The shares of the whole computation that a scope covers.
#[derive(Debug, Clone, Copy)]
struct Extent {
    from: f64,
    to: f64,
    /// How much of it has been given to phases and scopes inside.
    given: f64,
}

impl Default for Course {
    fn default() -> Self {
        Self { progress: Progress::default(), scopes: vec![Extent { from: 0.0, to: 1.0, given: 0.0 }] }
    }
}

impl Course {
    /// Gives the next `share` of the innermost scope away: from where to where in the whole.
    fn give(&mut self, share: f64) -> (f64, f64) {
        let Some(scope) = self.scopes.last_mut() else { unreachable!("the whole is never left") };
        let place = |given: f64| scope.from + (scope.to - scope.from) * given;
        let from = place(scope.given);
        scope.given = (scope.given + share.max(0.0)).min(1.0);
        (from, scope.from + (scope.to - scope.from) * scope.given)
    }
}

/// A part of a computation whose phases count by their shares of this part. It ends when this is dropped.
#[derive(Debug)]
#[must_use]
pub struct Scope<'a>(&'a Ctl);

impl Drop for Scope<'_> {
    fn drop(&mut self) {
        let mut course = held(&self.0.course);
        if course.scopes.len() > 1 {
            course.scopes.pop();
        }
    }
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

    /// Begins a phase that takes about `share`, from 0 to 1, of the time of the whole, or of the innermost [`Scope`];
    /// the phase before is over.
    pub fn enter(&self, phase: Phase, share: f64) {
        let mut course = held(&self.course);
        let (from, to) = course.give(share);
        let fraction = course.progress.fraction.max(from);
        self.done.store(0, Ordering::Relaxed);
        course.progress = Progress { phase, done: 0, total: 0, from, to, fraction };
    }

    /// Begins a part of the computation that takes about `share` of the time of the whole, or of the scope around it,
    /// and has phases of its own.
    pub fn scope(&self, share: f64) -> Scope<'_> {
        let mut course = held(&self.course);
        let (from, to) = course.give(share);
        course.scopes.push(Extent { from, to, given: 0.0 });
        Scope(self)
    }

    /// The computation is done, whatever was foreseen of its phases.
    pub fn finish(&self) {
        held(&self.course).progress.fraction = 1.0;
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
    pub fn progress(&self) -> Progress {
        let mut course = held(&self.course);
        let progress = &mut course.progress;
        progress.done = self.done.load(Ordering::Relaxed).min(progress.total);
        let within = progress::share(progress.done, progress.total);
        progress.fraction = progress.fraction.max(progress.from + (progress.to - progress.from) * within).min(1.0);
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
        ctl.set_total(10);
        ctl.advance(5);
        assert_eq!(ctl.progress().fraction, 0.5);
        // A count that begins again.
        ctl.set_total(1000);
        assert_eq!(ctl.progress().fraction, 0.5);
        // More than there is.
        ctl.enter(Phase::Fit, 3.0);
        assert_eq!((ctl.progress().from, ctl.progress().to), (0.75, 1.0));
        ctl.set_total(1);
        ctl.advance(1);
        assert_eq!(ctl.progress().fraction, 1.0);
    }

    #[test]
    fn shares_of_a_part_are_of_that_part() {
        let ctl = Ctl::new();
        ctl.enter(Phase::Data, 0.5);
        for part in 0..2 {
            let _part = ctl.scope(0.25);
            ctl.enter(Phase::Search, 0.5);
            assert_eq!(ctl.progress().from, 0.5 + 0.25 * f64::from(part));
            {
                let _inner = ctl.scope(0.5);
                ctl.enter(Phase::Fit, 1.0);
                assert_eq!(ctl.progress().to, 0.75 + 0.25 * f64::from(part));
            }
        }
        assert_eq!(ctl.progress().fraction, 0.875);
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
