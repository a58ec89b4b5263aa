//! Where everything is kept; the only user of `sqlx`.

pub mod records;

pub use records::*;

use crate::analysis::ids::{AnalysisId, PlantId, StudyId, SubjectId, TrialId};
use crate::analysis::{Kind, Library, Problem, References, Report};
use crate::control::Model;
use crate::jobs::Status;
use crate::trial::Trial;
use std::path::Path;

/// Why the store could not do what was asked.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// There is no such thing.
    #[error("there is no {noun} {id}")]
    NotFound {
        /// The sort of thing.
        noun: &'static str,
        /// Its id.
        id: String,
    },
    /// It contradicts something stored: a code or number already taken, a plant still in use.
    #[error("{detail}")]
    Conflict {
        /// A stable name of the rule broken, such as `subject_code_taken`.
        rule: &'static str,
        /// In words, with the values.
        detail: String,
    },
    /// `If-Match` named another version than the stored one.
    #[error("the {noun} changed since it was read")]
    Stale {
        /// The sort of thing.
        noun: &'static str,
    },
    /// An idempotency key was used before for a different request.
    #[error("the idempotency key was used before for a different request")]
    KeyReused,
    /// Stored bytes do not match their checksum.
    #[error("stored data is damaged: {0}")]
    Damaged(String),
    /// The database failed.
    #[error("the database failed")]
    Database(#[from] sqlx::Error),
    /// The schema could not be brought up to date.
    #[error("the database schema could not be migrated")]
    Migration(#[from] sqlx::migrate::MigrateError),
}

/// A handle to the database; cheap to clone.
#[derive(Debug, Clone)]
pub struct Store {
    // pools
}

/// Result of the store.
pub type StoreResult<T> = Result<T, StoreError>;

#[allow(missing_docs, unused_variables, clippy::todo, clippy::missing_errors_doc)]
impl Store {
    /// Opens (creating and migrating it where needed) the database file; `None` is a private in-memory one.
    pub async fn open(path: Option<&Path>) -> StoreResult<Self> {
        todo!()
    }
    /// Whether a trivial query succeeds (readiness).
    pub async fn ping(&self) -> StoreResult<()> {
        todo!()
    }
    pub async fn close(&self) {
        todo!()
    }

    // ---- studies
    pub async fn create_study(&self, new: NewStudy, key: Option<&IdempotencyKey>) -> StoreResult<Created<Study>> {
        todo!()
    }
    pub async fn study(&self, id: StudyId) -> StoreResult<Study> {
        todo!()
    }
    pub async fn studies(&self, page: Page) -> StoreResult<Vec<Study>> {
        todo!()
    }
    pub async fn patch_study(&self, id: StudyId, patch: StudyPatch, if_match: Option<i64>) -> StoreResult<Study> {
        todo!()
    }
    /// Deletes the study with its plants, subjects, trials and analyses, and overwrites what they held.
    pub async fn delete_study(&self, id: StudyId, if_match: Option<i64>) -> StoreResult<()> {
        todo!()
    }

    // ---- plants
    pub async fn create_plant(
        &self,
        study: StudyId,
        new: NewPlant,
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Created<Plant>> {
        todo!()
    }
    pub async fn plant(&self, id: PlantId) -> StoreResult<Plant> {
        todo!()
    }
    pub async fn plants(&self, study: StudyId, page: Page) -> StoreResult<Vec<Plant>> {
        todo!()
    }
    pub async fn rename_plant(&self, id: PlantId, name: &str, if_match: Option<i64>) -> StoreResult<Plant> {
        todo!()
    }
    /// Refused (`plant_in_use`) while trials were recorded on it.
    pub async fn delete_plant(&self, id: PlantId, if_match: Option<i64>) -> StoreResult<()> {
        todo!()
    }

    // ---- subjects
    pub async fn create_subject(
        &self,
        study: StudyId,
        new: NewSubject,
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Created<Subject>> {
        todo!()
    }
    pub async fn subject(&self, id: SubjectId) -> StoreResult<Subject> {
        todo!()
    }
    pub async fn subjects(&self, study: StudyId, group: Option<&str>, page: Page) -> StoreResult<Vec<Subject>> {
        todo!()
    }
    pub async fn patch_subject(
        &self,
        id: SubjectId,
        patch: SubjectPatch,
        if_match: Option<i64>,
    ) -> StoreResult<Subject> {
        todo!()
    }
    pub async fn delete_subject(&self, id: SubjectId, if_match: Option<i64>) -> StoreResult<()> {
        todo!()
    }

    // ---- trials
    /// Stores all of them or none (one transaction). A trial whose content is already stored for this subject is
    /// returned with `Created::Duplicate` and not stored again; a number already taken within its session by other
    /// content is a conflict (`trial_number_taken`).
    pub async fn create_trials(
        &self,
        subject: SubjectId,
        new: Vec<NewTrial>,
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Vec<Created<TrialRecord>>> {
        todo!()
    }
    pub async fn trial(&self, id: TrialId) -> StoreResult<TrialRecord> {
        todo!()
    }
    pub async fn trials(&self, subject: SubjectId, page: Page) -> StoreResult<Vec<TrialRecord>> {
        todo!()
    }
    /// Other subjects' trials of the same study with this content, for a warning.
    pub async fn same_content(&self, study: StudyId, sha256: &str, except: SubjectId) -> StoreResult<Vec<TrialRecord>> {
        todo!()
    }
    pub async fn patch_trial(&self, id: TrialId, patch: TrialPatch, if_match: Option<i64>) -> StoreResult<TrialRecord> {
        todo!()
    }
    pub async fn delete_trial(&self, id: TrialId, if_match: Option<i64>) -> StoreResult<()> {
        todo!()
    }
    /// The recording itself, bit for bit as uploaded (checksum verified).
    pub async fn trial_signals(&self, id: TrialId) -> StoreResult<Trial> {
        todo!()
    }
    /// Everything that an analysis refers to.
    pub async fn library(&self, references: &References) -> StoreResult<Library> {
        todo!()
    }

    // ---- analyses
    /// Queues an analysis. The request is canonical (defaults filled in); its references must exist (`NotFound` else).
    pub async fn create_analysis(
        &self,
        new: NewAnalysis,
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Created<AnalysisRecord>> {
        todo!()
    }
    /// Queues many in one transaction.
    pub async fn create_analyses(
        &self,
        new: Vec<NewAnalysis>,
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Vec<AnalysisRecord>> {
        todo!()
    }
    pub async fn analysis(&self, id: AnalysisId) -> StoreResult<AnalysisRecord> {
        todo!()
    }
    pub async fn analyses(&self, filter: AnalysisFilter, page: Page) -> StoreResult<Vec<AnalysisRecord>> {
        todo!()
    }
    /// The report's bytes exactly as the worker wrote them; `None` until it succeeded.
    pub async fn report_json(&self, id: AnalysisId) -> StoreResult<Option<String>> {
        todo!()
    }
    /// Cancels a queued analysis at once, flags a running one, leaves a finished one as it is.
    pub async fn request_cancel(&self, id: AnalysisId) -> StoreResult<AnalysisRecord> {
        todo!()
    }
    /// Deletes an analysis; a running one is abandoned by its worker at its next heartbeat.
    pub async fn delete_analysis(&self, id: AnalysisId) -> StoreResult<()> {
        todo!()
    }
    /// The trials of a study that match a filter.
    pub async fn matching_trials(&self, study: StudyId, filter: &TrialFilter) -> StoreResult<Vec<TrialRecord>> {
        todo!()
    }
    /// Succeeded single-trial reports of this kind for each trial given, oldest first.
    pub async fn reports_of_trials(&self, trials: &[TrialId], kind: Kind) -> StoreResult<Vec<TrialReport>> {
        todo!()
    }
    /// How many analyses there are in each status.
    pub async fn count_by_status(&self) -> StoreResult<Vec<(Status, u64)>> {
        todo!()
    }

    // ---- leases (used by the worker only); every write matches id + running + lease token
    /// Takes the oldest available queued analysis, counting an attempt. One `UPDATE … RETURNING`.
    pub async fn claim(&self, worker: &str, lease_s: f64) -> StoreResult<Option<Claim>> {
        todo!()
    }
    /// Extends the lease and writes progress; `Held::Lost` when the lease is somebody else's or the row is gone.
    pub async fn heartbeat(&self, lease: &Lease, progress: crate::num::Progress, lease_s: f64) -> StoreResult<Held> {
        todo!()
    }
    /// Finishes with a report; false when the lease was lost.
    pub async fn succeed(&self, lease: &Lease, report: &Report) -> StoreResult<bool> {
        todo!()
    }
    /// Finishes with a problem; false when the lease was lost.
    pub async fn fail(&self, lease: &Lease, problem: &Problem) -> StoreResult<bool> {
        todo!()
    }
    /// Marks a running analysis cancelled; false when the lease was lost.
    pub async fn confirm_cancel(&self, lease: &Lease) -> StoreResult<bool> {
        todo!()
    }
    /// Hands the work back (shutdown) without counting the attempt.
    pub async fn release(&self, lease: &Lease) -> StoreResult<bool> {
        todo!()
    }
    /// Returns analyses whose lease ran out to the end of the queue, or fails those whose attempts are used up.
    pub async fn rescue(&self, max_attempts: u32) -> StoreResult<Rescued> {
        todo!()
    }
}

/// The plant model of a plant record, parsed.
pub type PlantModel = Model;
