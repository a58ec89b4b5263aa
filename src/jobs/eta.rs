//! How long a running job, or a whole run of like ones, will still take.

use crate::ctl::Progress;

/// Estimates the time left from the mean rate since the present count began.
///
/// A computation may count several times over (a phase of lines, then a phase of candidates): when the total changes or
/// the count goes back, a new phase began at the latest observation at which the old one was still going, and its rate
/// is measured from there. Times are microseconds of whatever clock the caller has; the estimator has none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EtaEstimator {
    phase_began_us: i64,
    observed_us: i64,
    progress: Progress,
}

impl EtaEstimator {
    /// An estimator for work that begins now.
    #[must_use]
    pub fn begin(at_us: i64) -> Self {
        Self { phase_began_us: at_us, observed_us: at_us, progress: Progress::default() }
    }

    /// An estimator as it was when it was last stored.
    #[must_use]
    pub fn resume(phase_began_us: i64, observed_us: i64, progress: Progress) -> Self {
        Self { phase_began_us, observed_us, progress }
    }

    /// Takes note of how far the work is.
    pub fn observe(&mut self, at_us: i64, progress: Progress) {
        if progress.total != self.progress.total || progress.done < self.progress.done {
            self.phase_began_us = self.observed_us;
        }
        self.observed_us = at_us;
        self.progress = progress;
    }

    /// When the present count began.
    #[must_use]
    pub(crate) fn phase_began_us(&self) -> i64 {
        self.phase_began_us
    }

    /// Seconds left, `elapsed · (total − done)/done`; `None` while nothing is known: no total, nothing done yet, or a
    /// clock that went backwards.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn eta_s(&self) -> Option<f64> {
        let Progress { done, total } = self.progress;
        let elapsed_us = self.observed_us.saturating_sub(self.phase_began_us);
        if done == 0 || done > total || elapsed_us <= 0 {
            return None;
        }
        Some(elapsed_us as f64 * 1e-6 * ((total - done) as f64 / done as f64))
    }
}

/// Seconds until a run of like analyses is finished, if it goes on as it does: the median of what the latest took, for
/// those that wait and half of it for those under way, shared by as many as are under way. 0 where nothing is left;
/// `None` while none has finished, or where nobody works on them.
///
/// A median, since the first of a run makes what the others share; and not the rate since the beginning, which a night
/// without a server would spoil.
#[must_use]
#[allow(clippy::cast_precision_loss)]
pub fn run_eta_s(latest_s: &[f64], queued: u64, running: u64) -> Option<f64> {
    if queued + running == 0 {
        return Some(0.0);
    }
    let mut sorted = latest_s.to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = *sorted.get(sorted.len() / 2)?;
    (running > 0).then(|| median * (queued as f64 / running as f64 + 0.5))
}
