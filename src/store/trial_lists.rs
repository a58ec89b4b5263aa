//! Trials: several at a time.

use super::error::StoreResult;
use super::lists::{Filter, Order};
use super::nouns::{fetch, must_exist};
use super::open::Store;
use super::records::{Page, Subject, TrialFilter, TrialRecord};
use crate::analysis::ids::{StudyId, SubjectId};

/// By subject (in the order they were added), session and number.
pub(super) const IN_ORDER: &str = "ORDER BY n.subject_id, n.session IS NOT NULL, n.session, n.number, n.id";

/// By what trials are listed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum TrialKey {
    /// When they were uploaded.
    #[default]
    Created,
    /// Session, then number; those without a session come first.
    Number,
    /// The subject's pseudonym, then session and number.
    Subject,
    /// The mean of |r − y|.
    MeanAbsError,
    /// The root mean square of r − y.
    RmsError,
    /// The largest |y|.
    MaxAbsOutput,
}

impl TrialKey {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Created, Self::Number, Self::Subject, Self::MeanAbsError, Self::RmsError, Self::MaxAbsOutput];

    /// Its name in documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Created => "created",
            Self::Number => "number",
            Self::Subject => "subject",
            Self::MeanAbsError => "mean_abs_error",
            Self::RmsError => "rms_error",
            Self::MaxAbsOutput => "max_abs_output",
        }
    }

    fn keys(self) -> &'static [&'static str] {
        match self {
            Self::Created => &[],
            Self::Number => &["coalesce(n.session, -1)", "n.number"],
            Self::Subject => {
                &["(SELECT p.code FROM subjects p WHERE p.id = n.subject_id)", "coalesce(n.session, -1)", "n.number"]
            }
            Self::MeanAbsError => &["coalesce(n.metrics ->> 'mean_abs_error', -1.0)"],
            Self::RmsError => &["coalesce(n.metrics ->> 'rms_error', -1.0)"],
            Self::MaxAbsOutput => &["n.max_abs_output"],
        }
    }
}

/// In which order trials are listed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TrialOrder {
    /// By what.
    pub by: TrialKey,
    /// From the greatest to the least.
    pub descending: bool,
}

impl TrialOrder {
    pub(super) fn order(self) -> Order {
        Order { keys: self.by.keys(), descending: self.descending }
    }
}

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
    let found = match filter.excluded {
        Some(true) => found.plain("n.excluded IS NOT NULL"),
        Some(false) => found.plain("n.excluded IS NULL"),
        None => found,
    };
    if filter.only_divergent {
        return found.plain("n.max_abs_output > s.display_limit");
    }
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

    /// A page of the trials of a study that match a filter, in an order.
    ///
    /// # Errors
    /// [`StoreError::NotFound`](super::StoreError::NotFound) (study),
    /// [`StoreError::Conflict`](super::StoreError::Conflict) (`cursor_gone`), the database's own.
    pub async fn listed_trials(
        &self,
        study: StudyId,
        filter: &TrialFilter,
        order: TrialOrder,
        page: Page,
    ) -> StoreResult<Vec<TrialRecord>> {
        let mut tx = self.snapshot().await?;
        must_exist(&mut tx, study).await?;
        self.sorted_page(&mut tx, &matching(study, filter), order.order(), page).await
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
