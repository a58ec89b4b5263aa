//! How a worker behaves.

use crate::jobs::{BadPolicy, LeasePolicy};
use serde::{Deserialize, Serialize};

/// How a worker behaves; unchecked until [`WorkerSettings::lease_policy`] has looked at it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorkerSettings {
    /// Its name in logs and in the problem of a job whose workers died. Default: host name and process id.
    pub worker_name: String,
    /// Analyses at once. Default 1: each already uses every compute thread.
    pub concurrency: usize,
    /// Threads of each analysis; 0 (the default) for one on each processor.
    pub compute_threads: usize,
    /// Seconds after which a worker that gave no sign counts as dead. Default 15.
    pub lease_s: f64,
    /// Seconds between signs of life, which also write progress; at most half a lease. Default 3.
    pub heartbeat_s: f64,
    /// Seconds between looks for work that other processes queued. Default 1.
    pub poll_s: f64,
    /// How many workers may die of an analysis before it fails. Default 5.
    pub max_attempts: u32,
    /// Seconds that running analyses are given to finish at shutdown. Default 10.
    pub drain_s: f64,
    /// Seconds that a computation is given to notice that it was told to stop. Kernels look several times a second; one
    /// that does not is left behind, so that it does not hold up the queue. Default 5.
    pub stop_grace_s: f64,
    /// Seconds that an analysis may take in all; null (the default) for no limit.
    pub deadline_s: Option<f64>,
}

impl Default for WorkerSettings {
    fn default() -> Self {
        Self {
            worker_name: format!("{}-{}", host_name(), std::process::id()),
            concurrency: 1,
            compute_threads: 0,
            lease_s: 15.0,
            heartbeat_s: 3.0,
            poll_s: 1.0,
            max_attempts: 5,
            drain_s: 10.0,
            stop_grace_s: 5.0,
            deadline_s: None,
        }
    }
}

fn host_name() -> String {
    #[cfg(unix)]
    {
        rustix::system::uname().nodename().to_string_lossy().into_owned()
    }
    #[cfg(not(unix))]
    {
        "host".to_owned()
    }
}

impl WorkerSettings {
    /// Checks every field.
    ///
    /// # Errors
    /// [`BadPolicy`] names the first field that cannot work.
    pub fn lease_policy(&self) -> Result<LeasePolicy, BadPolicy> {
        let bad = |field, reason: String| Err(BadPolicy { field, reason });
        if self.worker_name.is_empty() || self.worker_name.len() > 200 {
            return bad("worker_name", format!("must have 1 to 200 bytes, not {}", self.worker_name.len()));
        }
        if !(1..=1024).contains(&self.concurrency) {
            return bad("concurrency", format!("must be from 1 to 1024, not {}", self.concurrency));
        }
        if self.compute_threads > 4096 {
            return bad("compute_threads", format!("must be at most 4096, not {}", self.compute_threads));
        }
        if !(0.01..=3600.0).contains(&self.poll_s) {
            return bad("poll_s", format!("must be from 0.01 to 3600, not {}", self.poll_s));
        }
        if !(0.0..=86_400.0).contains(&self.drain_s) {
            return bad("drain_s", format!("must be from 0 to 86400, not {}", self.drain_s));
        }
        if !(0.001..=3600.0).contains(&self.stop_grace_s) {
            return bad("stop_grace_s", format!("must be from 0.001 to 3600, not {}", self.stop_grace_s));
        }
        if let Some(deadline_s) = self.deadline_s
            && !(0.001..=1e8).contains(&deadline_s)
        {
            return bad("deadline_s", format!("must be from 0.001 to 1e8, not {deadline_s}"));
        }
        LeasePolicy::new(self.lease_s, self.heartbeat_s, self.max_attempts)
    }
}
