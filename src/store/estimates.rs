//! What reports say of trials, kept beside them: written when an analysis finishes, read without opening a report.

use super::error::{StoreError, StoreResult};
use super::nouns::Noun as _;
use super::open::Store;
use super::records::{AnalysisRecord, TrialEstimate, TrialEstimates};
use super::rows::{get, json, parsed, sha256, to_json};
use crate::analysis::Report;
use crate::analysis::estimates::{KeptEstimate, kept};
use crate::analysis::ids::{AnalysisId, TrialId};
use crate::control::Model;
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;

/// Trials asked about in one statement.
const AT_ONCE: usize = 500;

/// The order of the joins is said: left to itself, the database begins with every analysis that succeeded, once for
/// each trial. The text names the trials (a JSON list), and the estimator of which analyses of several trials are asked
/// for; of all others those of one trial.
pub(super) const ESTIMATES_OF_TRIALS: &str = "SELECT u.trial_id, a.id, a.spec_sha256, u.position, e.estimator,
        e.estimate, e.sha256
     FROM json_each($1) t CROSS JOIN analysis_trials u ON u.trial_id = t.value
        CROSS JOIN analyses a ON a.id = u.analysis_id
        CROSS JOIN analysis_estimates e ON e.analysis_id = u.analysis_id AND e.position = u.position
     WHERE +a.status = 'succeeded'
        AND EXISTS (SELECT 1 FROM analysis_trials v WHERE v.analysis_id = a.id AND v.position > 0) = (e.estimator = $2)
     ORDER BY t.key, a.id, e.estimator";

/// Writes what a report about trials on `plant` says of them, in place of what was there.
pub(super) async fn write(
    connection: &mut SqliteConnection,
    id: AnalysisId,
    report: &Report,
    plant: Option<&Model>,
) -> StoreResult<()> {
    sqlx::query("DELETE FROM analysis_estimates WHERE analysis_id = $1")
        .bind(id.to_string())
        .execute(&mut *connection)
        .await?;
    for own in kept(report, plant) {
        let text = to_json(&own.estimate)?;
        sqlx::query(
            "INSERT INTO analysis_estimates (analysis_id, position, estimator, estimate, sha256)
             VALUES ($1, $2, $3, $4, $5)",
        )
        .bind(id.to_string())
        .bind(i64::try_from(own.position).unwrap_or_default())
        .bind(own.estimator.name())
        .bind(&text)
        .bind(sha256(&text))
        .execute(&mut *connection)
        .await?;
    }
    Ok(())
}

/// What is kept in a row, its hash verified.
pub(super) fn verified(row: &SqliteRow) -> StoreResult<KeptEstimate> {
    let (text, stored): (&str, &str) = (get(row, "estimate")?, get(row, "sha256")?);
    let found = sha256(text);
    if found != stored {
        return Err(StoreError::Damaged(format!("what is kept of its report has the hash {found}, not {stored}")));
    }
    json(row, "estimate")
}

impl Store {
    /// What succeeded analyses found of each trial given: in the order of `trials`, each trial's oldest first. Only
    /// analyses of a single trial, but of the estimator `joint` only those that combine several. No report is opened.
    ///
    /// # Errors
    /// The database's own. What is damaged is named beside the rest.
    pub async fn estimates_of_trials(&self, trials: &[TrialId], joint: Option<&str>) -> StoreResult<TrialEstimates> {
        let mut tx = self.snapshot().await?;
        let mut all = TrialEstimates::default();
        for some in trials.chunks(AT_ONCE) {
            let names: Vec<String> = some.iter().map(ToString::to_string).collect();
            let rows = sqlx::query(ESTIMATES_OF_TRIALS)
                .bind(to_json(&names)?)
                .bind(joint.unwrap_or_default())
                .fetch_all(&mut *tx)
                .await?;
            for row in &rows {
                let (analysis, estimator): (AnalysisId, String) = (parsed(row, "id")?, get(row, "estimator")?);
                let estimate = match verified(row) {
                    Ok(estimate) => estimate,
                    Err(StoreError::Damaged(why)) => {
                        self.inner().damage.note(AnalysisRecord::NAME, &analysis.to_string(), &why);
                        all.damaged.push((analysis, estimator, why));
                        continue;
                    }
                    Err(error) => return Err(error),
                };
                all.found.push(TrialEstimate {
                    trial: parsed(row, "trial_id")?,
                    position: usize::try_from(get::<i64>(row, "position")?).unwrap_or_default(),
                    analysis,
                    spec_sha256: get(row, "spec_sha256")?,
                    estimator,
                    estimate,
                });
            }
        }
        Ok(all)
    }
}
