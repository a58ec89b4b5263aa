//! Trials: several at a time.

use super::error::StoreResult;
use super::lists::Filter;
use super::nouns::{fetch, must_exist};
use super::open::Store;
use super::records::{Page, Subject, TrialFilter, TrialRecord};
use crate::analysis::ids::{StudyId, SubjectId};

/// By subject (in the order they were added), session and number.
pub(super) const IN_ORDER: &str = "ORDER BY n.subject_id, n.session IS NOT NULL, n.session, n.number, n.id";

/// Those of a subject.
pub(super) fn of_subject(subject: SubjectId) -> Filter {
    Filter::default().and("n.subject_id = ?", Some(subject.to_string()))
}

/// Those that match a filter.
pub(super) fn matching(study: StudyId, filter: &TrialFilter) -> Filter {
    // A subject has few trials beside a study: where one is asked for, the study is only looked at.
    let of_study = if filter.subject.is_some() { "+n.study_id = ?" } else { "n.study_id = ?" };
    let found = Filter::default()
        .and("n.subject_id = ?", filter.subject.map(|id| id.to_string()))
        .and(of_study, Some(study.to_string()))
        .and(
            "EXISTS (SELECT 1 FROM subjects p WHERE p.id = n.subject_id AND p.group_name = ?)",
            filter.group.as_deref(),
        )
        .and("+n.plant_id = ?", filter.plant.map(|id| id.to_string()))
        .and("n.session = ?", filter.session)
        .and("n.number >= ?", filter.number_from)
        .and("n.number <= ?", filter.number_to);
    if filter.include_divergent {
        return found;
    }
    found.plain("(s.display_limit IS NULL OR n.max_abs_output <= s.display_limit)")
}

impl Store {
    /// A page of a subject's trials, in the order in which they were uploaded.
    ///
    /// # Errors
    /// [`StoreError::NotFound`](super::StoreError::NotFound) (subject), the database's own.
    pub async fn trials(&self, subject: SubjectId, page: Page) -> StoreResult<Vec<TrialRecord>> {
        let mut tx = self.snapshot().await?;
        fetch::<Subject>(&mut tx, subject).await?;
        self.page_of(&mut tx, &of_subject(subject), page).await
    }

    /// Other subjects' trials of the same study with this content, for a warning.
    ///
    /// # Errors
    /// The database's own.
    pub async fn same_content(&self, study: StudyId, sha256: &str, except: SubjectId) -> StoreResult<Vec<TrialRecord>> {
        let filter = Filter::default()
            .and("n.study_id = ?", Some(study.to_string()))
            .and("n.sha256 = ?", Some(sha256))
            .and("n.subject_id <> ?", Some(except.to_string()));
        self.trials_in(&filter, "ORDER BY n.id").await
    }

    /// The trials of a study that match a filter, by subject (in the order they were added), session and number.
    ///
    /// # Errors
    /// [`StoreError::NotFound`](super::StoreError::NotFound) (study), the database's own.
    pub async fn matching_trials(&self, study: StudyId, filter: &TrialFilter) -> StoreResult<Vec<TrialRecord>> {
        must_exist(&mut *self.readers()?.acquire().await?, study).await?;
        self.trials_in(&matching(study, filter), IN_ORDER).await
    }

    async fn trials_in(&self, filter: &Filter, order: &str) -> StoreResult<Vec<TrialRecord>> {
        let mut connection = self.readers()?.acquire().await?;
        let rows = filter.rows(&mut connection, filter.select::<TrialRecord>(&[], order), &[]).await?;
        let mut found = Vec::with_capacity(rows.len());
        for row in &rows {
            found.extend(self.sound(row)?);
        }
        Ok(found)
    }
}
