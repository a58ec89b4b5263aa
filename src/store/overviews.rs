//! What pages list: studies with their counts, and the latest analyses.

use super::error::StoreResult;
use super::nouns::select;
use super::open::Store;
use super::records::{AnalysisRecord, FirstTrial, Study, StudyOverview};
use super::rows::{get, parsed, time, to_json, unsigned};
use crate::analysis::ids::{AnalysisId, StudyId};
use crate::jobs::Status;
use sqlx::sqlite::SqliteRow;
use std::collections::BTreeMap;

impl Store {
    /// The studies with what is in them, the newest first, at most `limit`.
    ///
    /// # Errors
    /// The database's own.
    pub async fn study_overviews(&self, limit: u32) -> StoreResult<Vec<StudyOverview>> {
        let mut tx = self.snapshot().await?;
        let rows = sqlx::query(select::<Study>("ORDER BY n.id DESC LIMIT $1")).bind(limit).fetch_all(&mut *tx).await?;
        let mut overviews = Vec::with_capacity(rows.len());
        for row in &rows {
            // One that is damaged is noted, and the others are shown.
            let Some(study) = self.sound::<Study>(row)? else { continue };
            let counts = sqlx::query(
                "SELECT (SELECT count(*) FROM subjects WHERE study_id = $1) AS subjects,
                    (SELECT count(*) FROM trials WHERE study_id = $1) AS trials,
                    (SELECT count(DISTINCT u.trial_id) FROM analyses a JOIN analysis_trials u ON u.analysis_id = a.id
                     WHERE a.study_id = $1 AND a.status = 'succeeded') AS analysed,
                    (SELECT count(*) FROM analyses WHERE study_id = $1 AND status = 'queued') AS queued,
                    (SELECT count(*) FROM analyses WHERE study_id = $1 AND status = 'running') AS running,
                    (SELECT count(*) FROM analyses WHERE study_id = $1 AND status = 'failed') AS failed,
                    max((SELECT updated_at FROM studies WHERE id = $1),
                        coalesce((SELECT max(updated_at) FROM subjects WHERE study_id = $1), 0),
                        coalesce((SELECT max(updated_at) FROM trials WHERE study_id = $1), 0),
                        coalesce((SELECT max(updated_at) FROM analyses WHERE study_id = $1), 0)) AS changed_at",
            )
            .bind(study.id.to_string())
            .fetch_one(&mut *tx)
            .await?;
            overviews.push(StudyOverview {
                subjects: unsigned(&counts, "subjects")?,
                trials: unsigned(&counts, "trials")?,
                analysed: unsigned(&counts, "analysed")?,
                queued: unsigned(&counts, "queued")?,
                running: unsigned(&counts, "running")?,
                failed: unsigned(&counts, "failed")?,
                changed_at: time(&counts, "changed_at")?,
                study,
            });
        }
        Ok(overviews)
    }

    /// The latest analyses in a status, of one study where it is given: the newest first, at most `limit`.
    ///
    /// # Errors
    /// The database's own.
    pub async fn latest_analyses(
        &self,
        study: Option<StudyId>,
        status: Status,
        limit: u32,
    ) -> StoreResult<Vec<AnalysisRecord>> {
        let rows = sqlx::query(select::<AnalysisRecord>(
            "WHERE n.status = $1 AND ($2 IS NULL OR n.study_id = $2) ORDER BY n.id DESC LIMIT $3",
        ))
        .bind(status.name())
        .bind(study.map(|id| id.to_string()))
        .bind(limit)
        .fetch_all(self.readers()?)
        .await?;
        let sound = rows.iter().filter_map(|row| self.sound::<AnalysisRecord>(row).transpose());
        sound.collect()
    }

    /// The first trial of each of these analyses that has one: what people call them by.
    ///
    /// # Errors
    /// The database's own.
    pub async fn first_trials(&self, analyses: &[AnalysisId]) -> StoreResult<BTreeMap<AnalysisId, FirstTrial>> {
        let names: Vec<String> = analyses.iter().map(ToString::to_string).collect();
        let rows = sqlx::query(
            "SELECT u.analysis_id AS id, s.code, t.number,
                (SELECT count(*) FROM analysis_trials v WHERE v.analysis_id = u.analysis_id) AS trials
             FROM json_each($1) e CROSS JOIN analysis_trials u ON u.analysis_id = e.value AND u.position = 0
                CROSS JOIN trials t ON t.id = u.trial_id CROSS JOIN subjects s ON s.id = t.subject_id",
        )
        .bind(to_json(&names)?)
        .fetch_all(self.readers()?)
        .await?;
        let one = |row: &SqliteRow| {
            let named =
                FirstTrial { code: get(row, "code")?, number: get(row, "number")?, trials: unsigned(row, "trials")? };
            Ok((parsed(row, "id")?, named))
        };
        rows.iter().map(one).collect()
    }

    /// How many trials of a study each kind of analysis has succeeded for, by the kind's name.
    ///
    /// # Errors
    /// The database's own.
    pub async fn trials_by_kind(&self, study: StudyId) -> StoreResult<Vec<(String, u64)>> {
        let rows = sqlx::query(
            "SELECT a.kind AS kind, count(DISTINCT u.trial_id) AS trials
             FROM analyses a JOIN analysis_trials u ON u.analysis_id = a.id
             WHERE a.study_id = $1 AND a.status = 'succeeded' GROUP BY a.kind",
        )
        .bind(study.to_string())
        .fetch_all(self.readers()?)
        .await?;
        rows.iter().map(|row| Ok((get(row, "kind")?, unsigned(row, "trials")?))).collect()
    }
}
