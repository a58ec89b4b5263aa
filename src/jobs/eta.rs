//! How long a running job, or a whole run of like ones, will still take.

use crate::ctl::Progress;

/// Estimates the time left from two rates: that of the present phase since it began, for what is left of it, and that
/// of the whole since the beginning, for the phases to come.
///
/// The shares of phases are estimates; what is left of the present phase does not depend on them. A new phase began at
/// the latest observation of the one before, and its count at the latest at which there was none. Times are
/// microseconds of whatever clock the caller has; the estimator has none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EtaEstimator {
    began_us: i64,
    phase_began_us: i64,
    observed_us: i64,
    progress: Progress,
}

impl EtaEstimator {
    /// An estimator for work that begins now.
    #[must_use]
    pub fn begin(at_us: i64) -> Self {
        Self::resume(at_us, at_us, at_us, Progress::default())
    }

    /// An estimator as it was when it was last stored.
    #[must_use]
    pub fn resume(began_us: i64, phase_began_us: i64, observed_us: i64, progress: Progress) -> Self {
        Self { began_us, phase_began_us, observed_us, progress }
    }

    /// Takes note of how far the work is.
    pub fn observe(&mut self, at_us: i64, progress: Progress) {
        let is_new = (progress.phase, progress.from) != (self.progress.phase, self.progress.from);
        // A count begins no earlier than the last time it was seen not to have begun.
        let begins = self.progress.total == 0 && progress.total > 0 && self.progress.fraction <= progress.from;
        if is_new || begins {
            self.phase_began_us = self.observed_us;
        }
        self.observed_us = at_us;
        self.progress = progress;
    }

    /// When the present phase began.
    #[must_use]
    pub(crate) fn phase_began_us(&self) -> i64 {
        self.phase_began_us
    }

    /// Seconds left, `t_p (p₁ − f)/(f − p₀) + t (1 − p₁)/f`, for the fraction f, a phase from p₀ to p₁ that has taken
    /// t_p, and a whole that has taken t; `None` while nothing is known: nothing done yet, or a clock that went
    /// backwards.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn eta_s(&self) -> Option<f64> {
        let Progress { from, to, fraction, .. } = self.progress;
        let seconds = |since_us: i64| self.observed_us.saturating_sub(since_us) as f64 * 1e-6;
        let (whole, phase) = (seconds(self.began_us), seconds(self.phase_began_us));
        if !(fraction > from && phase > 0.0 && whole > 0.0) {
            return None;
        }
        Some(phase * (to - fraction).max(0.0) / (fraction - from) + whole * (1.0 - to) / fraction)
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
