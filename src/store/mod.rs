//! Where everything is kept; the only user of `sqlx`.
//!
//! SQLite in WAL mode with `synchronous=FULL`: what a method returned is on disk. One connection writes, each time in a
//! `BEGIN IMMEDIATE` transaction, so that a read followed by a write cannot be overtaken; a small pool reads. Other
//! processes may have the same file open (a `worker` beside a `serve`).
//!
//! **Deleting really deletes.** `secure_delete` overwrites what rows held, the write-ahead log is folded in and
//! truncated, and `VACUUM` clears stale copies out of the pages, so that neither file still holds the bytes: before the
//! deletion returns where the database is small, within seconds where it is large. Deleting a study takes its plants,
//! subjects, trials and analyses; deleting a subject takes the trials; deleting a trial (or plant) takes the analyses
//! that used it, reports and all. A plant on which trials were recorded cannot be deleted.
//!
//! **The analysis row is the job.** Its legal transitions are in [`crate::jobs`]; every write by a worker matches id,
//! `running` and lease token, so that a worker which comes late can never win.
//!
//! **Disks fail.** Connections are looked at before they are lent, since a commit that fails on a full disk leaves them
//! within a transaction; writes run in tasks that nobody drops; a reserve lets people delete and cancel on a full disk;
//! a file that is gone or replaced is not written to ([`StoreError::trouble`] says which it is). Damaged rows are left
//! out of lists and named.
//!
//! **Clocks are set.** Nothing that happens to work depends on the time of day; see [`watch`] and the column `place`.
//!
//! **Idempotency keys** are scoped by route and parent (`studies/{id}/plants`). The same key with the same request
//! answers with what the first one made; with another request it is [`StoreError::KeyReused`]; where that was deleted
//! since, it is a conflict (`idempotent_result_deleted`), never made anew.

mod analyses;
mod backup;
mod blocking;
mod bulk;
mod claims;
mod clock;
mod copy;
mod damage;
mod drafts;
mod error;
mod estimates;
mod idempotency;
mod leases;
mod library;
mod lists;
mod migrate;
mod nouns;
mod on_plant;
mod open;
mod overviews;
mod passages;
mod place;
mod plans;
mod plants;
mod queue;
mod reading;
mod records;
mod reports;
mod reserve;
mod rows;
mod scrub;
mod signals;
mod studies;
mod subjects;
mod transfer;
mod trial_lists;
mod trials;
mod trust;
mod units;
mod upkeep;
mod used;
mod verify;
mod watch;
mod writing;

pub use backup::Manifest;
pub use bulk::{Bulk, Existing, Made, Only};
pub use claims::{Claim, Heartbeat, Lease, LeaseState, Rescued};
pub use clock::Clock;
pub use drafts::{Draft, DraftFile, DraftTrial, Drafted};
pub use error::{StoreError, StoreResult, Trouble};
pub use nouns::{Change, Noun};
pub use on_plant::OnPlant;
pub use open::Store;
pub use passages::Passage;
pub use reading::StudyReading;
pub use records::*;
pub use reports::{ReportFilter, StudyReport, StudyReports};
pub use transfer::{StoredAnalysis, StoredRow, StudyTable, TakingIn};
pub use trial_lists::{TrialKey, TrialOrder};
pub use trust::{StoredTrust, TrustFilter};
pub use units::{SignalUnits, UnitsChange};
pub use used::{SubjectName, TrialName, UsedTrials};
pub use verify::{Finding, Verified, verify_file};
