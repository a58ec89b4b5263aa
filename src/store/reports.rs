//! Reports of finished analyses.

use super::error::{StoreError, StoreResult};
use super::nouns::Noun as _;
use super::open::Store;
use super::records::{AnalysisRecord, TrialReport};
use super::rows::{get, parsed, sha256, time};
use crate::analysis::ids::{AnalysisId, TrialId};
use crate::analysis::{Kind, Report};
use sqlx::sqlite::SqliteRow;
use std::collections::BTreeMap;
use std::sync::Arc;

const NOUN: &str = AnalysisRecord::NAME;

/// The report's text, its hash verified.
fn verified(row: &SqliteRow) -> StoreResult<Option<String>> {
    let Some(text) = get::<Option<String>>(row, "report")? else { return Ok(None) };
    let (found, stored) = (sha256(&text), get::<Option<String>>(row, "report_sha256")?);
    if stored.as_deref() != Some(&found) {
        let id: String = get(row, "id")?;
        let stored = stored.unwrap_or_default();
        return Err(StoreError::Damaged(format!("the report of {NOUN} {id} has the hash {found}, not {stored}")));
    }
    Ok(Some(text))
}

impl Store {
    /// The report's bytes exactly as the worker wrote them; `None` until it succeeded.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Damaged`], the database's own.
    pub async fn report_json(&self, id: AnalysisId) -> StoreResult<Option<String>> {
        let row = sqlx::query("SELECT id, report, report_sha256 FROM analyses WHERE id = $1")
            .bind(id.to_string())
            .fetch_optional(self.readers())
            .await?
            .ok_or_else(|| StoreError::not_found(NOUN, id))?;
        verified(&row)
    }

    /// Succeeded reports of this kind for each trial given: in the order of `trials`, each trial's oldest first. Only
    /// those of analyses of a single trial, or, with `joint`, only those of analyses that combine several, which say
    /// something of each of them only where their result goes trial by trial.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], the database's own.
    pub async fn reports_of_trials(
        &self,
        trials: &[TrialId],
        kind: Kind,
        joint: bool,
    ) -> StoreResult<Vec<TrialReport>> {
        let mut tx = self.snapshot().await?;
        let mut found = Vec::new();
        // A report of many trials is read once.
        let mut reports: BTreeMap<AnalysisId, Arc<Report>> = BTreeMap::new();
        for trial in trials {
            let rows = sqlx::query(
                "SELECT a.id, a.spec_sha256, a.created_at, u.position
                 FROM analysis_trials u JOIN analyses a ON a.id = u.analysis_id
                 WHERE u.trial_id = $1 AND a.kind = $2 AND a.status = 'succeeded'
                   AND ((SELECT count(*) FROM analysis_trials v WHERE v.analysis_id = a.id) > 1) = $3
                 ORDER BY a.id",
            )
            .bind(trial.to_string())
            .bind(kind.name())
            .bind(joint)
            .fetch_all(&mut *tx)
            .await?;
            for row in &rows {
                let id: AnalysisId = parsed(row, "id")?;
                let report = match reports.get(&id) {
                    Some(report) => Arc::clone(report),
                    None => {
                        let row = sqlx::query("SELECT id, report, report_sha256 FROM analyses WHERE id = $1")
                            .bind(id.to_string())
                            .fetch_one(&mut *tx)
                            .await?;
                        let damaged = |why: String| StoreError::Damaged(format!("the report of {NOUN} {id} {why}"));
                        let text = verified(&row)?.ok_or_else(|| damaged("is missing".to_owned()))?;
                        let report: Report =
                            serde_json::from_str(&text).map_err(|why| damaged(format!("is none: {why}")))?;
                        Arc::clone(reports.entry(id).or_insert_with(|| Arc::new(report)))
                    }
                };
                found.push(TrialReport {
                    trial: *trial,
                    position: usize::try_from(get::<i64>(row, "position")?).unwrap_or_default(),
                    analysis: id,
                    spec_sha256: get(row, "spec_sha256")?,
                    created_at: time(row, "created_at")?,
                    report,
                });
            }
        }
        Ok(found)
    }
}
