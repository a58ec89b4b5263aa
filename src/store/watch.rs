//! Who has gone silent.
//!
//! A running analysis carries a counter that each sign of life raises. Whoever looks for dead workers remembers the
//! counter and when it last moved, by a clock of its own that only passes: nobody compares the time of day of two
//! moments or of two machines, so a clock that is set neither kills a worker that lives nor lets one that died go
//! unnoticed. After a start nothing is known, and the first rescue comes one lease later.

use super::claims::Lease;
use crate::analysis::ids::AnalysisId;
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// Who did not look for so long was stopped, and the workers perhaps with it: it begins to watch anew.
const BLIND_US: i64 = 15_000_000;

/// What one process has seen.
#[derive(Debug, Default)]
pub(super) struct Watch {
    seen: Mutex<HashMap<AnalysisId, Sign>>,
}

/// A sign of life, and how long it has been the last.
#[derive(Debug)]
struct Sign {
    token: String,
    beat: i64,
    since_us: i64,
    looked_us: i64,
}

/// A running analysis as the database has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Running {
    pub(super) lease: Lease,
    /// Signs of life so far.
    pub(super) beat: i64,
    /// How long it may be silent.
    pub(super) lease_us: i64,
}

impl Watch {
    /// A worker of this process begins.
    pub(super) fn begin(&self, lease: &Lease, beat: i64, now_us: i64) {
        let sign = Sign { token: lease.token.clone(), beat, since_us: now_us, looked_us: now_us };
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).insert(lease.analysis, sign);
    }

    /// Nothing is known any more: nobody could write for a while, so nobody could give a sign.
    pub(super) fn forget(&self) {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// Those of the running that were seen to be silent for a lease.
    pub(super) fn silent(&self, running: Vec<Running>, now_us: i64) -> Vec<Running> {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let mut before = std::mem::take(&mut *seen);
        running
            .into_iter()
            .filter(|now| {
                let Lease { analysis, token } = &now.lease;
                let blind_us = BLIND_US.max(now.lease_us / 2);
                let sign = before
                    .remove(analysis)
                    .filter(|sign| sign.token == *token && sign.beat == now.beat)
                    .filter(|sign| now_us.saturating_sub(sign.looked_us) <= blind_us)
                    .map_or(
                        Sign { token: token.clone(), beat: now.beat, since_us: now_us, looked_us: now_us },
                        |sign| Sign { looked_us: now_us, ..sign },
                    );
                let is_silent = now_us.saturating_sub(sign.since_us) >= now.lease_us;
                seen.insert(*analysis, sign);
                is_silent
            })
            .collect()
    }
}
