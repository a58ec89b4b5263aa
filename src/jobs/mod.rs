//! The life of an analysis as a job: status, transitions, leases, attempts. Pure: no clock, no storage.
//!
//! ```text
//!                 claim (+1 attempt)            succeed
//!   ┌────────┐ ───────────────────► ┌─────────┐ ───────────────► succeeded
//!   │ queued │                      │ running │ ───────────────► failed
//!   └────────┘ ◄─────────────────── └─────────┘  fail;
//!        │      release (−1 attempt),   │        worker died and no attempt is left
//!        │      worker died             │
//!        │                              │ cancellation confirmed; released or worker died
//!        │ cancel                       │ after cancellation was requested
//!        └────────────► cancelled ◄─────┘
//! ```
//!
//! [`Job::apply`] is the one place that says which transition is legal; the CHECK constraints in `migrations/` say the
//! same to every other writer, and `tests/store.rs` compares the two.

mod eta;
mod policy;
mod state;

pub use eta::{EtaEstimator, run_eta_s};
pub use policy::{Backoff, BadPolicy, LeasePolicy};
pub use state::{Event, IllegalTransition, Job, Status};
