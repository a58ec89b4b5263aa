//! How long a lease lasts, how often it is renewed, how often work is tried again and when.

use std::time::Duration;

/// A setting that cannot work.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field} {reason}")]
pub struct BadPolicy {
    /// The setting, by its name in the configuration.
    pub field: &'static str,
    /// Why it cannot work, with the values.
    pub reason: String,
}

/// Leases and attempts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LeasePolicy {
    lease: Duration,
    heartbeat: Duration,
    max_attempts: u32,
}

impl LeasePolicy {
    /// A checked policy.
    ///
    /// # Errors
    /// [`BadPolicy`] where the lease is not within 50 ms and a day, where less than two heartbeats fit into a lease
    /// (one slow write would then lose the work), or where there is no attempt at all.
    pub fn new(lease_s: f64, heartbeat_s: f64, max_attempts: u32) -> Result<Self, BadPolicy> {
        if !(0.05..=86_400.0).contains(&lease_s) {
            return Err(BadPolicy { field: "lease_s", reason: format!("must be from 0.05 to 86400, not {lease_s}") });
        }
        if !(0.01..=lease_s / 2.0).contains(&heartbeat_s) {
            let reason = format!("must be from 0.01 to half of lease_s ({lease_s}), not {heartbeat_s}");
            return Err(BadPolicy { field: "heartbeat_s", reason });
        }
        if max_attempts == 0 {
            return Err(BadPolicy { field: "max_attempts", reason: "must be at least 1".to_owned() });
        }
        Ok(Self {
            lease: Duration::from_secs_f64(lease_s),
            heartbeat: Duration::from_secs_f64(heartbeat_s),
            max_attempts,
        })
    }

    /// How long a lease lasts when it is not renewed.
    #[must_use]
    pub fn lease(&self) -> Duration {
        self.lease
    }

    /// How often it is renewed.
    #[must_use]
    pub fn heartbeat(&self) -> Duration {
        self.heartbeat
    }

    /// How many workers may die of a job before it fails.
    #[must_use]
    pub fn max_attempts(&self) -> u32 {
        self.max_attempts
    }
}

/// How long rescued work waits before it is offered again.
///
/// It goes to the end of the queue and waits `base · 2^(attempts−1)`, at most `cap`, stretched or shrunk by up to a
/// half by the job's own identity. The end of the queue, so that repeated kills of a process hit different jobs. The
/// wait that differs from job to job, so that a job which kills its process is not offered together with the same
/// bystanders every time until their attempts are used up as well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Backoff {
    /// The wait after the first death.
    pub base: Duration,
    /// The longest wait.
    pub cap: Duration,
}

impl Default for Backoff {
    fn default() -> Self {
        Self { base: Duration::from_secs(1), cap: Duration::from_secs(60) }
    }
}

impl Backoff {
    /// The wait of the job with this identity after so many attempts.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn wait(&self, attempts: u32, identity: u128) -> Duration {
        let doubled = self.base.saturating_mul(1_u32.checked_shl(attempts.saturating_sub(1)).unwrap_or(u32::MAX));
        let whole = doubled.min(self.cap);
        let folded = (identity as u64) ^ ((identity >> 64) as u64) ^ u64::from(attempts).rotate_left(32);
        // The upper 53 bits of a well mixed word make a uniform fraction in [0, 1).
        let fraction = (mix(folded) >> 11) as f64 / (1_u64 << 53) as f64;
        whole.mul_f64(0.5 + fraction)
    }
}

/// The finaliser of SplitMix64: a bijection of 64-bit words in which every bit depends on every other.
fn mix(word: u64) -> u64 {
    let mut z = word.wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}
