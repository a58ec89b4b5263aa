//! Reports of finished analyses.

use super::error::{StoreError, StoreResult};
use super::lists::{Filter, Value};
use super::nouns::Noun as _;
use super::open::Store;
use super::records::AnalysisRecord;
use super::rows::{get, parsed, sha256, time};
use crate::analysis::ids::{AnalysisId, StudyId, TrialId};
use crate::analysis::{Kind, Report};
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;
use time::OffsetDateTime;

const NOUN: &str = AnalysisRecord::NAME;

/// Which reports of a study.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ReportFilter {
    /// Only of this kind.
    pub kind: Option<Kind>,
    /// Only with a spec of this SHA-256, in lower-case hexadecimal.
    pub spec_sha256: Option<String>,
}

/// A report with the trials that it is about.
#[derive(Debug, Clone, PartialEq)]
pub struct StudyReport {
    /// The analysis.
    pub analysis: AnalysisId,
    /// Its trials, in its order.
    pub trials: Vec<TrialId>,
    /// When it was asked for.
    pub created_at: OffsetDateTime,
    /// The report.
    pub report: Report,
}

/// Some reports of a study.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StudyReports {
    /// The oldest first.
    pub found: Vec<StudyReport>,
    /// Analyses whose stored report is damaged, and why.
    pub damaged: Vec<(AnalysisId, String)>,
    /// The last analysis that was looked at; `None` where there was none left.
    pub last: Option<AnalysisId>,
}

/// The report of an analysis that succeeded.
async fn one(connection: &mut SqliteConnection, id: AnalysisId) -> StoreResult<Report> {
    let row = sqlx::query("SELECT id, report, report_sha256 FROM analyses WHERE id = $1")
        .bind(id.to_string())
        .fetch_one(connection)
        .await?;
    let damaged = |why: String| StoreError::Damaged(format!("the report of {NOUN} {id} {why}"));
    let text = verified(&row)?.ok_or_else(|| damaged("is missing".to_owned()))?;
    serde_json::from_str(&text).map_err(|why| damaged(format!("is none: {why}")))
}

/// The report's text, its hash verified.
pub(super) fn verified(row: &SqliteRow) -> StoreResult<Option<String>> {
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
            .fetch_optional(self.readers()?)
            .await?
            .ok_or_else(|| StoreError::not_found(NOUN, id))?;
        verified(&row)
    }

    /// The succeeded reports of a study behind the analysis `after`, the oldest first, so many at most, with the trials
    /// that each is about.
    ///
    /// # Errors
    /// The database's own. A report that is damaged is named beside the others.
    pub async fn reports_of_study(
        &self,
        study: StudyId,
        filter: &ReportFilter,
        after: Option<AnalysisId>,
        limit: u32,
    ) -> StoreResult<StudyReports> {
        let mut tx = self.snapshot().await?;
        let rows = Filter::default()
            .and("n.study_id = ?", Some(study.to_string()))
            .and("n.kind = ?", filter.kind.map(|kind| kind.name()))
            .and("n.spec_sha256 = ?", filter.spec_sha256.as_deref())
            .and("n.id > ?", after.map(|id| id.to_string()))
            .plain("n.status = 'succeeded'");
        let select = rows.of("SELECT n.id, n.created_at FROM analyses n", &[], "ORDER BY n.id LIMIT ?");
        let rows = rows.rows(&mut tx, select, &[Value::Integer(i64::from(limit))]).await?;
        let mut all = StudyReports { last: None, ..StudyReports::default() };
        for row in &rows {
            let id: AnalysisId = parsed(row, "id")?;
            all.last = Some(id);
            let report = match one(&mut tx, id).await {
                Ok(report) => report,
                Err(StoreError::Damaged(why)) => {
                    self.inner().damage.note(NOUN, &id.to_string(), &why);
                    all.damaged.push((id, why));
                    continue;
                }
                Err(error) => return Err(error),
            };
            let trials = sqlx::query("SELECT trial_id FROM analysis_trials WHERE analysis_id = $1 ORDER BY position")
                .bind(id.to_string())
                .fetch_all(&mut *tx)
                .await?;
            let trials = trials.iter().map(|row| parsed(row, "trial_id")).collect::<StoreResult<_>>()?;
            all.found.push(StudyReport { analysis: id, trials, created_at: time(row, "created_at")?, report });
        }
        Ok(all)
    }
}
