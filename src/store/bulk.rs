//! Many analyses at once: all of them, or only those that are missing.

use super::analyses::{insert, rests_on};
use super::error::{StoreError, StoreResult};
use super::idempotency::{or_deleted, remember, replay};
use super::nouns::fetch;
use super::open::Store;
use super::records::{AnalysisRecord, IdempotencyKey, NewAnalysis};
use super::rows::{parsed, sha256, to_json};
use super::used::{TRIALS_OF, linked};
use crate::analysis::ids::{AnalysisId, TrialId};
use crate::jobs::Status;
use sqlx::SqliteConnection;
use std::collections::BTreeSet;

/// Which of the analyses that are asked for are made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Only {
    /// Those that nobody has asked for in the same words, or that failed or were cancelled.
    Missing,
    /// All of them, once more.
    All,
}

/// An analysis that was asked for in the same words before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Existing {
    /// The analysis.
    pub id: AnalysisId,
    /// Its first trial.
    pub trial: TrialId,
    /// Where it stands.
    pub status: Status,
}

/// An analysis that was made.
#[derive(Debug, Clone, PartialEq)]
pub struct Made {
    /// The analysis.
    pub analysis: AnalysisRecord,
    /// The first trial that it rests on.
    pub trial: Option<TrialId>,
}

/// What became of a request for many.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Bulk {
    /// Those that were made, now or by the same request before.
    pub made: Vec<Made>,
    /// Those that were there.
    pub existing: Vec<Existing>,
    /// Whether the same request with the same key had been answered before, so that nothing was made now.
    pub replayed: bool,
}

/// What was asked for in the same words before, and has a report or will have one; the newest of several.
async fn same(connection: &mut SqliteConnection, new: &NewAnalysis) -> StoreResult<Option<Existing>> {
    let Some(trial) = rests_on(connection, new).await?.trials.into_iter().next() else { return Ok(None) };
    let row = sqlx::query(
        "SELECT n.id, n.status FROM analysis_trials u CROSS JOIN analyses n ON n.id = u.analysis_id
         WHERE u.trial_id = $1 AND n.request_sha256 = $2 AND n.status IN ('queued', 'running', 'succeeded')
         ORDER BY n.id DESC LIMIT 1",
    )
    .bind(&trial)
    .bind(sha256(&to_json(&new.request)?))
    .fetch_optional(connection)
    .await?;
    let Some(row) = row else { return Ok(None) };
    let status = super::analyses::status(&row)?;
    Ok(Some(Existing { id: parsed(&row, "id")?, trial: trial_id(&trial)?, status }))
}

async fn made(connection: &mut SqliteConnection, analysis: AnalysisRecord) -> StoreResult<Made> {
    let first = linked(connection, TRIALS_OF, &analysis.id.to_string()).await?.into_iter().next();
    Ok(Made { analysis, trial: first.as_deref().map(trial_id).transpose()? })
}

fn trial_id(text: &str) -> StoreResult<TrialId> {
    text.parse().map_err(|error| StoreError::Damaged(format!("the trial {text}: {error}")))
}

impl Store {
    /// Queues many in one transaction: all or none. Their idempotency key is scoped by the study of the first.
    ///
    /// # Errors
    /// As [`Store::create_analysis`].
    pub async fn create_analyses(
        &self,
        new: Vec<NewAnalysis>,
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Vec<AnalysisRecord>> {
        let bulk = self.create_bulk(new, Only::All, key).await?;
        Ok(bulk.made.into_iter().map(|made| made.analysis).collect())
    }

    /// Queues many in one transaction, or those of them that are missing: all or none. Whoever asks at the same time
    /// waits, so that nothing is queued twice.
    ///
    /// # Errors
    /// As [`Store::create_analysis`].
    pub async fn create_bulk(
        &self,
        new: Vec<NewAnalysis>,
        only: Only,
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Bulk> {
        // Nothing is made, so there is nothing to repeat: a later request may well find trials that match.
        let Some(first) = new.first() else { return Ok(Bulk::default()) };
        let scope = format!("studies/{}/analyses", first.study.map(|id| id.to_string()).unwrap_or_default());
        let (store, key) = (self.clone(), key.cloned());
        self.uninterrupted(async move { store.write_bulk(&scope, &new, only, key.as_ref()).await }).await
    }

    async fn write_bulk(
        &self,
        scope: &str,
        new: &[NewAnalysis],
        only: Only,
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Bulk> {
        let mut tx = self.begin().await?;
        let mut bulk = Bulk::default();
        if let Some(ids) = replay(&mut tx, scope, key).await? {
            for id in &ids {
                let analysis = or_deleted(fetch(&mut tx, id).await)?;
                bulk.made.push(made(&mut tx, analysis).await?);
            }
            bulk.replayed = true;
            if only == Only::Missing {
                let made: BTreeSet<AnalysisId> = bulk.made.iter().map(|made| made.analysis.id).collect();
                for new in new {
                    bulk.existing.extend(same(&mut tx, new).await?.filter(|found| !made.contains(&found.id)));
                }
            }
            return Ok(bulk);
        }
        let now = self.now_us();
        for new in new {
            let found = if only == Only::Missing { same(&mut tx, new).await? } else { None };
            match found {
                Some(found) => bulk.existing.push(found),
                None => {
                    let analysis = insert(&mut tx, new, now).await?;
                    bulk.made.push(made(&mut tx, analysis).await?);
                }
            }
        }
        let ids: Vec<String> = bulk.made.iter().map(|made| made.analysis.id.to_string()).collect();
        remember(&mut tx, scope, key, &ids, now).await?;
        tx.commit().await?;
        if !bulk.made.is_empty() {
            self.announce_work();
        }
        Ok(bulk)
    }
}
