//! Reports of finished analyses.

use super::error::{StoreError, StoreResult};
use super::lists::{Filter, Value};
use super::nouns::Noun as _;
use super::open::Store;
use super::records::{AnalysisRecord, TrialReport, TrialReports};
use super::rows::{get, parsed, sha256, time, to_json};
use crate::analysis::ids::{AnalysisId, StudyId, TrialId};
use crate::analysis::{Kind, Report};
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::Arc;
use time::OffsetDateTime;

const NOUN: &str = AnalysisRecord::NAME;

/// Trials asked about in one statement.
const AT_ONCE: usize = 500;

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

/// The order of the joins is said: left to itself, the database begins with every analysis that succeeded, once for
/// each trial. The text names the trials (a JSON list), the kind, and whether analyses of several are asked for.
pub(super) const REPORTS_OF_TRIALS: &str = "SELECT u.trial_id, a.id, a.spec_sha256, a.created_at, u.position
     FROM json_each($1) t CROSS JOIN analysis_trials u ON u.trial_id = t.value
        CROSS JOIN analyses a ON a.id = u.analysis_id
     WHERE +a.kind = $2 AND +a.status = 'succeeded'
        AND EXISTS (SELECT 1 FROM analysis_trials v WHERE v.analysis_id = a.id AND v.position > 0) = $3
     ORDER BY t.key, a.id";

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

    /// Succeeded reports of this kind for each trial given: in the order of `trials`, each trial's oldest first. Only
    /// those of analyses of a single trial, or, with `joint`, only those of analyses that combine several, which say
    /// something of each of them only where their result goes trial by trial.
    ///
    /// # Errors
    /// The database's own. A report that is damaged is named beside the others.
    pub async fn reports_of_trials(&self, trials: &[TrialId], kind: Kind, joint: bool) -> StoreResult<TrialReports> {
        let mut tx = self.snapshot().await?;
        let mut all = TrialReports::default();
        // A report of many trials is read once.
        let mut reports: BTreeMap<AnalysisId, Option<Arc<Report>>> = BTreeMap::new();
        for some in trials.chunks(AT_ONCE) {
            let names: Vec<String> = some.iter().map(ToString::to_string).collect();
            let rows = sqlx::query(REPORTS_OF_TRIALS)
                .bind(to_json(&names)?)
                .bind(kind.name())
                .bind(joint)
                .fetch_all(&mut *tx)
                .await?;
            for row in &rows {
                let id: AnalysisId = parsed(row, "id")?;
                let report = match reports.entry(id) {
                    Entry::Occupied(read) => read.into_mut(),
                    Entry::Vacant(unread) => unread.insert(match one(&mut tx, id).await {
                        Ok(report) => Some(Arc::new(report)),
                        Err(StoreError::Damaged(why)) => {
                            self.inner().damage.note(NOUN, &id.to_string(), &why);
                            all.damaged.push((id, why));
                            None
                        }
                        Err(error) => return Err(error),
                    }),
                };
                let Some(report) = report else { continue };
                all.found.push(TrialReport {
                    trial: parsed(row, "trial_id")?,
                    position: usize::try_from(get::<i64>(row, "position")?).unwrap_or_default(),
                    analysis: id,
                    spec_sha256: get(row, "spec_sha256")?,
                    created_at: time(row, "created_at")?,
                    report: Arc::clone(report),
                });
            }
        }
        Ok(all)
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
