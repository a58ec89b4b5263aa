//! Trials: several at a time.

use super::error::StoreResult;
use super::open::Store;
use super::records::{Page, TrialFilter, TrialRecord};
use super::studies::must_exist;
use super::trials::trial;
use crate::analysis::ids::{StudyId, SubjectId};

impl Store {
    /// A page of a subject's trials, in the order in which they were uploaded.
    ///
    /// # Errors
    /// [`StoreError::NotFound`](super::StoreError::NotFound) (subject), the database's own.
    pub async fn trials(&self, subject: SubjectId, page: Page) -> StoreResult<Vec<TrialRecord>> {
        let subject = subject.to_string();
        let mut tx = self.snapshot().await?;
        super::subjects::fetch(&mut tx, &subject).await?;
        let rows = sqlx::query(
            "SELECT t.*, s.display_limit FROM trials t JOIN studies s ON s.id = t.study_id
             WHERE t.subject_id = $1 AND t.id > $2 ORDER BY t.id LIMIT $3",
        )
        .bind(&subject)
        .bind(page.after_id())
        .bind(page.limit)
        .fetch_all(&mut *tx)
        .await?;
        rows.iter().map(trial).collect()
    }

    /// Other subjects' trials of the same study with this content, for a warning.
    ///
    /// # Errors
    /// The database's own.
    pub async fn same_content(&self, study: StudyId, sha256: &str, except: SubjectId) -> StoreResult<Vec<TrialRecord>> {
        let rows = sqlx::query(
            "SELECT t.*, s.display_limit FROM trials t JOIN studies s ON s.id = t.study_id
             WHERE t.study_id = $1 AND t.sha256 = $2 AND t.subject_id <> $3 ORDER BY t.id",
        )
        .bind(study.to_string())
        .bind(sha256)
        .bind(except.to_string())
        .fetch_all(self.readers())
        .await?;
        rows.iter().map(trial).collect()
    }

    /// The trials of a study that match a filter, by subject (in the order they were added), session and number.
    ///
    /// # Errors
    /// [`StoreError::NotFound`](super::StoreError::NotFound) (study), the database's own.
    pub async fn matching_trials(&self, study: StudyId, filter: &TrialFilter) -> StoreResult<Vec<TrialRecord>> {
        let mut tx = self.snapshot().await?;
        must_exist(&mut tx, study).await?;
        let rows = sqlx::query(
            "SELECT t.*, s.display_limit FROM trials t
             JOIN studies s ON s.id = t.study_id JOIN subjects p ON p.id = t.subject_id
             WHERE t.study_id = $1
               AND ($2 IS NULL OR p.group_name = $2) AND ($3 IS NULL OR t.subject_id = $3)
               AND ($4 IS NULL OR t.plant_id = $4) AND ($5 IS NULL OR t.session = $5)
               AND ($6 IS NULL OR t.number >= $6) AND ($7 IS NULL OR t.number <= $7)
               AND ($8 OR s.display_limit IS NULL OR t.max_abs_output <= s.display_limit)
             ORDER BY t.subject_id, t.session IS NOT NULL, t.session, t.number, t.id",
        )
        .bind(study.to_string())
        .bind(&filter.group)
        .bind(filter.subject.map(|id| id.to_string()))
        .bind(filter.plant.map(|id| id.to_string()))
        .bind(filter.session)
        .bind(filter.number_from)
        .bind(filter.number_to)
        .bind(filter.include_divergent)
        .fetch_all(&mut *tx)
        .await?;
        rows.iter().map(trial).collect()
    }
}
