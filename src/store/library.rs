//! Recordings, and everything else that an analysis computes from.

use super::blocking::off_runtime;
use super::error::{StoreError, StoreResult};
use super::nouns::fetch;
use super::open::Store;
use super::records::{Plant, TrialRecord};
use super::rows::get;
use super::signals::{Packed, unpack};
use crate::analysis::ids::TrialId;
use crate::analysis::{Library, References, StoredTrial};
use crate::trial::Trial;
use sqlx::SqliteConnection;
use std::sync::Arc;

pub(super) async fn columns(connection: &mut SqliteConnection, id: &str) -> StoreResult<Vec<Packed>> {
    let rows = sqlx::query("SELECT channel, codec, samples, sha256, data FROM trial_signals WHERE trial_id = $1")
        .bind(id)
        .fetch_all(connection)
        .await?;
    rows.iter()
        .map(|row| {
            Ok(Packed {
                channel: get(row, "channel")?,
                codec: get(row, "codec")?,
                samples: get(row, "samples")?,
                sha256: get(row, "sha256")?,
                data: get(row, "data")?,
            })
        })
        .collect()
}

/// The record and the packed columns as they are at one moment.
async fn packed(store: &Store, id: TrialId) -> StoreResult<(TrialRecord, Vec<Packed>)> {
    let mut tx = store.snapshot().await?;
    let record = fetch(&mut tx, id).await?;
    let columns = columns(&mut tx, &id.to_string()).await?;
    Ok((record, columns))
}

fn unpacked(record: &TrialRecord, columns: &[Packed]) -> StoreResult<Trial> {
    let trial = unpack(&record.id.to_string(), record.sample_time_s, &record.sha256, columns)?;
    if trial.samples() as u64 != record.samples {
        let why = format!("trial {}: it has {} samples, not {}", record.id, trial.samples(), record.samples);
        return Err(StoreError::Damaged(why));
    }
    Ok(trial)
}

impl Store {
    /// The recording itself, bit for bit as uploaded (checksum verified).
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Damaged`], the database's own.
    pub async fn trial_signals(&self, id: TrialId) -> StoreResult<Trial> {
        let (record, columns) = packed(self, id).await?;
        off_runtime(move || unpacked(&record, &columns)).await
    }

    /// Everything that an analysis refers to.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Damaged`], the database's own.
    pub async fn library(&self, references: &References) -> StoreResult<Library> {
        let mut library = Library::default();
        for id in &references.trials {
            // One at a time, so that only one trial is held packed and unpacked at once.
            let (record, columns) = packed(self, *id).await?;
            let plant = self.plant(record.plant).await?.model;
            let divergent = record.divergent;
            let sha256 = record.sha256.clone();
            let warnings = record.warnings.clone();
            let excluded = record.excluded.clone();
            let trial = off_runtime(move || unpacked(&record, &columns)).await?;
            library.trials.insert(*id, Arc::new(StoredTrial { trial, sha256, plant, divergent, excluded, warnings }));
        }
        let mut connection = self.readers()?.acquire().await?;
        for id in &references.plants {
            let plant: Plant = fetch(&mut connection, id).await?;
            library.plants.insert(*id, plant.model);
        }
        Ok(library)
    }
}
