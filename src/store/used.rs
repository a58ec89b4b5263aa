//! Which stored trials an analysis uses, as lists say it.

use super::error::StoreResult;
use crate::analysis::ids::{SubjectId, TrialId};
use serde::Deserialize;
use sqlx::SqliteConnection;

/// Selects a [`UsedTrials`] as JSON for the analysis under the alias `n`.
macro_rules! used_trials {
    () => {
        "(SELECT json_object('trials', count(*),
            'trial', iif(count(*) = 1, json_object('id', min(t.id), 'number', min(t.number),
                'session', min(t.session)), NULL),
            'subject', iif(min(p.id) = max(p.id), json_object('id', min(p.id), 'code', min(p.code)), NULL))
          FROM analysis_trials u CROSS JOIN trials t INDEXED BY sqlite_autoindex_trials_1 ON t.id = u.trial_id
            CROSS JOIN subjects p INDEXED BY sqlite_autoindex_subjects_1 ON p.id = t.subject_id
          WHERE u.analysis_id = n.id)"
    };
}
pub(super) use used_trials;

/// The trials that an analysis rests on, in its order.
pub(super) const TRIALS_OF: &str = "SELECT trial_id FROM analysis_trials WHERE analysis_id = $1 ORDER BY position";
/// The plants that it rests on, in its order.
pub(super) const PLANTS_OF: &str = "SELECT plant_id FROM analysis_plants WHERE analysis_id = $1 ORDER BY position";

/// The ids of [`TRIALS_OF`] or [`PLANTS_OF`] an analysis.
pub(super) async fn linked(
    connection: &mut SqliteConnection,
    select: &'static str,
    id: &str,
) -> StoreResult<Vec<String>> {
    Ok(sqlx::query_scalar(select).bind(id).fetch_all(connection).await?)
}

/// The stored trials that an analysis uses.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
pub struct UsedTrials {
    /// How many.
    pub trials: u64,
    /// The trial, where it is one.
    pub trial: Option<TrialName>,
    /// The subject, where all are of one.
    pub subject: Option<SubjectName>,
}

/// A trial by its names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub struct TrialName {
    /// Its id.
    pub id: TrialId,
    /// Its number.
    pub number: i64,
    /// Its session.
    pub session: Option<i64>,
}

/// A subject by its names.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct SubjectName {
    /// Its id.
    pub id: SubjectId,
    /// Its pseudonym.
    pub code: String,
}
