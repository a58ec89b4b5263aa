//! How far the quantities of reports may be used: written when an analysis finishes, read without opening a report.

use super::error::{StoreError, StoreResult};
use super::open::Store;
use super::rows::{get, json, parsed, to_json};
use crate::analysis::Report;
use crate::analysis::estimates::{QuantityTrust, quantities};
use crate::analysis::ids::{AnalysisId, StudyId, TrialId};
use crate::control::Model;
use crate::trust::RULE_VERSION;
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;

/// Analyses judged anew in one transaction, after a change of the rule: others may write in between.
const AT_ONCE: i64 = 50;

/// A quantity as an analysis of a trial has it.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredTrust {
    /// The trial.
    pub trial: TrialId,
    /// The analysis.
    pub analysis: AnalysisId,
    /// SHA-256 of its spec.
    pub spec_sha256: String,
    /// How many trials the analysis combines.
    pub trials: u64,
    /// The quantity, and how far it may be used.
    pub quantity: QuantityTrust,
}

/// Which quantities of a study's trials.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TrustFilter {
    /// Only this trial.
    pub trial: Option<TrialId>,
    /// Only this quantity.
    pub quantity: Option<String>,
    /// Only by this estimator, by name.
    pub estimator: Option<String>,
}

fn quantity(row: &SqliteRow) -> StoreResult<QuantityTrust> {
    let id: String = get(row, "analysis_id")?;
    let damaged = |why: String| StoreError::Damaged(format!("the trust of analysis {id} {why}"));
    let estimator: String = get(row, "estimator")?;
    let estimator = match estimator.as_str() {
        "" => None,
        name => Some(
            serde_json::from_value(serde_json::Value::from(name))
                .map_err(|_| damaged(format!("names an unknown estimator '{name}'")))?,
        ),
    };
    let ends: (Option<f64>, Option<f64>) = (get(row, "low")?, get(row, "high")?);
    Ok(QuantityTrust {
        position: usize::try_from(get::<i64>(row, "position")?).unwrap_or_default(),
        estimator,
        value: get(row, "value")?,
        interval_95: ends.0.zip(ends.1).map(|(low, high)| [low, high]),
        trust: json(row, "trust")?,
    })
}

/// Judges a report and writes what was found, in place of what was there.
pub(super) async fn write(connection: &mut SqliteConnection, id: AnalysisId, report: &Report) -> StoreResult<()> {
    // The plant that the trials were recorded on, unless the analysis names one.
    let model: Option<String> = sqlx::query_scalar(
        "SELECT p.model FROM analysis_plants u JOIN plants p ON p.id = u.plant_id WHERE u.analysis_id = $1
         UNION ALL
         SELECT p.model FROM analysis_trials u JOIN trials t ON t.id = u.trial_id JOIN plants p ON p.id = t.plant_id
         WHERE u.analysis_id = $1 LIMIT 1",
    )
    .bind(id.to_string())
    .fetch_optional(&mut *connection)
    .await?;
    let model = model.and_then(|text| serde_json::from_str::<Model>(&text).ok());
    sqlx::query("DELETE FROM analysis_trust WHERE analysis_id = $1")
        .bind(id.to_string())
        .execute(&mut *connection)
        .await?;
    super::estimates::write(connection, id, report, model.as_ref()).await?;
    for own in quantities(report, model.as_ref()) {
        sqlx::query(
            "INSERT INTO analysis_trust (analysis_id, position, estimator, quantity, value, low, high, level, trust)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9) ON CONFLICT DO NOTHING",
        )
        .bind(id.to_string())
        .bind(i64::try_from(own.position).unwrap_or_default())
        .bind(own.estimator.map_or("", |estimator| estimator.name()))
        .bind(&own.trust.quantity)
        .bind(own.value.filter(|value| value.is_finite()))
        .bind(own.interval_95.map(|ends| ends[0]))
        .bind(own.interval_95.map(|ends| ends[1]))
        .bind(own.trust.level.name())
        .bind(to_json(&own.trust)?)
        .execute(&mut *connection)
        .await?;
    }
    sqlx::query("UPDATE analyses SET trust_rule = $2 WHERE id = $1")
        .bind(id.to_string())
        .bind(i64::from(RULE_VERSION))
        .execute(&mut *connection)
        .await?;
    Ok(())
}

/// Reports that were never judged, or by another version of the rule, so many at most.
async fn unjudged(connection: &mut SqliteConnection, limit: i64) -> StoreResult<Vec<SqliteRow>> {
    let select = "SELECT id, report FROM analyses
         WHERE status = 'succeeded' AND (trust_rule IS NULL OR trust_rule <> $1) LIMIT $2";
    Ok(sqlx::query(select).bind(i64::from(RULE_VERSION)).bind(limit).fetch_all(connection).await?)
}

impl Store {
    /// Judges the reports that were never judged, or by another version of the rule, so that no list mixes two.
    pub(super) async fn judge_unjudged(&self) -> StoreResult<()> {
        // Nearly always there are none: nobody waits for the write lock then.
        while !unjudged(&mut *self.readers()?.acquire().await?, 1).await?.is_empty() {
            let mut tx = self.begin().await?;
            let rows = unjudged(&mut tx, AT_ONCE).await?;
            for row in &rows {
                let id: AnalysisId = parsed(row, "id")?;
                // A report that cannot be read is found damaged when it is asked for; here it has no quantities.
                let report = get::<Option<String>>(row, "report")?.and_then(|text| serde_json::from_str(&text).ok());
                match report {
                    Some(report) => write(&mut tx, id, &report).await?,
                    None => {
                        sqlx::query("UPDATE analyses SET trust_rule = $2 WHERE id = $1")
                            .bind(id.to_string())
                            .bind(i64::from(RULE_VERSION))
                            .execute(&mut *tx)
                            .await?;
                    }
                }
            }
            tx.commit().await?;
        }
        Ok(())
    }

    /// How far the quantities of an analysis may be used, by trial, estimator and name; nothing before it succeeded.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], the database's own.
    pub async fn trust_of_analysis(&self, id: AnalysisId) -> StoreResult<Vec<QuantityTrust>> {
        let rows =
            sqlx::query("SELECT * FROM analysis_trust WHERE analysis_id = $1 ORDER BY position, estimator, quantity")
                .bind(id.to_string())
                .fetch_all(self.readers()?)
                .await?;
        rows.iter().map(quantity).collect()
    }

    /// What the analyses of a study's trials found, and how far it may be used: by trial, each trial's oldest analysis
    /// first. Reports are not opened.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], the database's own.
    pub async fn trust_of_study(&self, study: StudyId, filter: &TrustFilter) -> StoreResult<Vec<StoredTrust>> {
        let rows = sqlx::query(
            "SELECT q.*, u.trial_id, a.spec_sha256,
                    (SELECT count(*) FROM analysis_trials v WHERE v.analysis_id = q.analysis_id) AS trials
             FROM analyses a JOIN analysis_trust q ON q.analysis_id = a.id
                  JOIN analysis_trials u ON u.analysis_id = q.analysis_id AND u.position = q.position
             WHERE a.study_id = $1 AND ($2 IS NULL OR u.trial_id = $2) AND ($3 IS NULL OR q.quantity = $3)
               AND ($4 IS NULL OR q.estimator = $4)
             ORDER BY u.trial_id, q.analysis_id, q.estimator, q.quantity",
        )
        .bind(study.to_string())
        .bind(filter.trial.map(|id| id.to_string()))
        .bind(&filter.quantity)
        .bind(&filter.estimator)
        .fetch_all(self.readers()?)
        .await?;
        let one = |row: &SqliteRow| {
            Ok(StoredTrust {
                trial: parsed(row, "trial_id")?,
                analysis: parsed(row, "analysis_id")?,
                spec_sha256: get(row, "spec_sha256")?,
                trials: u64::try_from(get::<i64>(row, "trials")?).unwrap_or_default(),
                quantity: quantity(row)?,
            })
        };
        rows.iter().map(one).collect()
    }
}
