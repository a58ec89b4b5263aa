//! Takes analyses from the queue, computes them, writes what came out.
//!
//! ```text
//! claim ──► parse ──► fetch inputs ──► compute on an own rayon pool ──► write the outcome
//!              │            ten times a second: cancelled? lease lost?  │
//!              └── heartbeat: sign of life and progress written ────────┘
//! ```
//!
//! - **Never on the runtime's threads.** Each analysis has an operating system thread and a rayon pool of its own, at a
//!   lower priority than the server's, so that polling stays quick under full load.
//! - **A panic is fenced.** It becomes a `failed` analysis whose problem names the analysis; the log has the panic's
//!   text.
//! - **A death is not.** The lease runs out, any worker's rescue puts the analysis back at the end of the queue, and
//!   after `max_attempts` deaths it fails with `worker_died`.
//! - **Pools and trees** that analyses share are kept in memory by a [`PoolMemo`], and in a [`cache`] on disk for the
//!   next process.
//! - **Shutdown** stops claiming, gives running work `drain_s` to finish, then hands the rest back without counting the
//!   attempt.

pub mod cache;
pub mod compute;
mod execute;
mod pool_memo;
mod runner;
mod settings;
mod task;

pub use cache::Folder;
pub use compute::{Timing, run_plan};
pub use execute::{Analyses, Execute, Work};
pub use pool_memo::PoolMemo;
pub use runner::{Drained, Worker};
pub use settings::WorkerSettings;
