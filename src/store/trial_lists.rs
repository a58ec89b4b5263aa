//! Trials: several at a time.

use super::error::StoreResult;
use super::nouns::{each, fetch, must_exist, select};
use super::open::Store;
use super::records::{Page, Subject, TrialFilter, TrialRecord};
use crate::analysis::ids::{StudyId, SubjectId};

impl Store {
    /// A page of a subject's trials, in the order in which they were uploaded.
    ///
    /// # Errors
    /// [`StoreError::NotFound`](super::StoreError::NotFound) (subject), the database's own.
    pub async fn trials(&self, subject: SubjectId, page: Page) -> StoreResult<Vec<TrialRecord>> {
        let mut tx = self.snapshot().await?;
        fetch::<Subject>(&mut tx, subject).await?;
        let rows = sqlx::query(select::<TrialRecord>("WHERE n.subject_id = $1 AND n.id > $2 ORDER BY n.id LIMIT $3"))
            .bind(subject.to_string())
            .bind(page.after_id())
            .bind(page.limit)
            .fetch_all(&mut *tx)
            .await?;
        each(&rows)
    }

    /// Other subjects' trials of the same study with this content, for a warning.
    ///
    /// # Errors
    /// The database's own.
    pub async fn same_content(&self, study: StudyId, sha256: &str, except: SubjectId) -> StoreResult<Vec<TrialRecord>> {
        let rows = sqlx::query(select::<TrialRecord>(
            "WHERE n.study_id = $1 AND n.sha256 = $2 AND n.subject_id <> $3 ORDER BY n.id",
        ))
        .bind(study.to_string())
        .bind(sha256)
        .bind(except.to_string())
        .fetch_all(self.readers())
        .await?;
        each(&rows)
    }

    /// The trials of a study that match a filter, by subject (in the order they were added), session and number.
    ///
    /// # Errors
    /// [`StoreError::NotFound`](super::StoreError::NotFound) (study), the database's own.
    pub async fn matching_trials(&self, study: StudyId, filter: &TrialFilter) -> StoreResult<Vec<TrialRecord>> {
        let mut tx = self.snapshot().await?;
        must_exist(&mut tx, study).await?;
        let rows = sqlx::query(select::<TrialRecord>(
            "JOIN subjects p ON p.id = n.subject_id
             WHERE n.study_id = $1
               AND ($2 IS NULL OR p.group_name = $2) AND ($3 IS NULL OR n.subject_id = $3)
               AND ($4 IS NULL OR n.plant_id = $4) AND ($5 IS NULL OR n.session = $5)
               AND ($6 IS NULL OR n.number >= $6) AND ($7 IS NULL OR n.number <= $7)
               AND ($8 OR s.display_limit IS NULL OR n.max_abs_output <= s.display_limit)
             ORDER BY n.subject_id, n.session IS NOT NULL, n.session, n.number, n.id",
        ))
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
        each(&rows)
    }
}
