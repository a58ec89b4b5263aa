//! Trials: one at a time.

use super::blocking::off_runtime;
use super::error::{StoreError, StoreResult, breaks_unique};
use super::idempotency::{or_deleted, remember, replay};
use super::nouns::{Change, Noun, fetch};
use super::on_plant::OnPlant;
use super::open::Store;
use super::records::{Created, IdempotencyKey, NewTrial, Subject, TrialPatch, TrialRecord};
use super::rows::{get, json, json_verified, parsed, sha256, signed, time, to_json, unsigned};
use super::signals::{Packed, pack};
use crate::analysis::ids::{PlantId, SubjectId, TrialId};
use crate::num::hexadecimal::hexadecimal;
use sqlx::SqliteConnection;
use sqlx::sqlite::SqliteRow;
use uuid::Uuid;

/// Sample times of one recording in two formats differ by no more than this share: digits of a printed time column.
const SAME_SAMPLE_TIME: f64 = 1e-3;

impl Noun for TrialRecord {
    type Id = TrialId;
    const NAME: &'static str = "trial";
    const TABLE: &'static str = "trials";
    const SELECT: &'static str =
        // The order of the join and the indexes are said: with many studies the database may take it for better the
        // other way round, and with one it goes through all of them for each trial, also once there are more.
        "SELECT n.*, s.display_limit,
            (SELECT p.code FROM subjects p INDEXED BY sqlite_autoindex_subjects_1 WHERE p.id = n.subject_id)
                AS subject_code,
            (SELECT g.name FROM plants g INDEXED BY sqlite_autoindex_plants_1 WHERE g.id = n.plant_id) AS plant_name
         FROM trials n CROSS JOIN studies s INDEXED BY sqlite_autoindex_studies_1 ON s.id = n.study_id";

    fn from_row(row: &SqliteRow) -> StoreResult<Self> {
        let max_abs_output: f64 = get(row, "max_abs_output")?;
        let display_limit: Option<f64> = get(row, "display_limit")?;
        Ok(Self {
            id: parsed(row, "id")?,
            study: parsed(row, "study_id")?,
            subject: parsed(row, "subject_id")?,
            subject_code: get(row, "subject_code")?,
            plant: parsed(row, "plant_id")?,
            plant_name: get(row, "plant_name")?,
            number: get(row, "number")?,
            session: get(row, "session")?,
            sample_time_s: get(row, "sample_time_s")?,
            samples: unsigned(row, "samples")?,
            has_disturbance: get(row, "has_disturbance")?,
            sha256: get(row, "sha256")?,
            max_abs_output,
            divergent: display_limit.is_some_and(|limit| max_abs_output > limit),
            metrics: match get::<Option<&str>>(row, "metrics_sha256")? {
                Some(_) => json_verified(row, "metrics", "metrics_sha256")?,
                // Stored before there was a hash.
                None => json(row, "metrics")?,
            },
            warnings: json(row, "warnings")?,
            units: json(row, "units")?,
            note: get(row, "note")?,
            excluded: get(row, "excluded")?,
            version: get(row, "version")?,
            created_at: time(row, "created_at")?,
            updated_at: time(row, "updated_at")?,
        })
    }

    fn id(&self) -> TrialId {
        self.id
    }

    fn version(&self) -> i64 {
        self.version
    }
}

fn number_taken(error: sqlx::Error, number: i64, session: Option<i64>) -> StoreError {
    let lists = ["trials.subject_id, trials.session, trials.number", "trials.subject_id, trials.number"];
    if breaks_unique(&error, &lists) {
        let place = session.map_or_else(|| "without a session".to_owned(), |session| format!("in session {session}"));
        let detail = format!("the subject has another trial number {number} {place}");
        return StoreError::Conflict { rule: "trial_number_taken", detail };
    }
    error.into()
}

pub(super) fn pack_all(new: Vec<NewTrial>) -> StoreResult<Vec<(NewTrial, Vec<Packed>)>> {
    new.into_iter()
        .map(|new| {
            let found = hexadecimal(&new.trial.content_sha256());
            if found != new.sha256 {
                // Stored, it could never be read back: the hash is checked then.
                let why = format!(
                    "trial {}: the hash given, {}, is not that of its content, {found}",
                    new.number, new.sha256
                );
                return Err(StoreError::Damaged(why));
            }
            let packed = pack(&new.trial)?;
            Ok((new, packed))
        })
        .collect()
}

async fn insert(
    connection: &mut SqliteConnection,
    subject: &str,
    study: &str,
    new: &NewTrial,
    packed: &[Packed],
    now: i64,
) -> StoreResult<String> {
    must_be_of_study(connection, new.plant, study).await?;
    let id = Uuid::now_v7().to_string();
    let metrics = to_json(&new.metrics)?;
    sqlx::query(
        "INSERT INTO trials (id, study_id, subject_id, plant_id, number, session, sample_time_s, samples,
            has_disturbance, sha256, max_abs_output, metrics, created_at, updated_at, warnings, signals_sha256,
            metrics_sha256)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $13, $14, $15, $16)",
    )
    .bind(&id)
    .bind(study)
    .bind(subject)
    .bind(new.plant.to_string())
    .bind(new.number)
    .bind(new.session)
    .bind(new.trial.sample_time_s)
    .bind(signed(new.trial.samples() as u64))
    .bind(new.trial.signals.disturbance.is_some())
    .bind(&new.sha256)
    .bind(new.max_abs_output)
    .bind(&metrics)
    .bind(now)
    .bind(to_json(&new.warnings)?)
    .bind(hexadecimal(&new.trial.signals_sha256()))
    .bind(sha256(&metrics))
    .execute(&mut *connection)
    .await
    .map_err(|error| number_taken(error, new.number, new.session))?;
    for column in packed {
        sqlx::query(
            "INSERT INTO trial_signals (trial_id, channel, codec, samples, sha256, data)
             VALUES ($1, $2, $3, $4, $5, $6)",
        )
        .bind(&id)
        .bind(&column.channel)
        .bind(&column.codec)
        .bind(column.samples)
        .bind(&column.sha256)
        .bind(&column.data)
        .execute(&mut *connection)
        .await?;
    }
    Ok(id)
}

/// Puts a trial on another plant; a conflict where an analysis used it, since a report names the plant that it was
/// computed with.
async fn put_on_plant(connection: &mut SqliteConnection, before: &TrialRecord, on: &OnPlant) -> StoreResult<()> {
    if on.plant == before.plant {
        return Ok(());
    }
    let id = before.id.to_string();
    let used: i64 = sqlx::query_scalar("SELECT count(*) FROM analysis_trials WHERE trial_id = $1")
        .bind(&id)
        .fetch_one(&mut *connection)
        .await?;
    if used > 0 {
        let analyses = if used == 1 { "analysis was" } else { "analyses were" };
        let detail = format!("{used} {analyses} computed from the trial on its present plant");
        return Err(StoreError::Conflict { rule: "trial_in_use", detail });
    }
    must_be_of_study(connection, on.plant, &before.study.to_string()).await?;
    let metrics = to_json(&on.metrics)?;
    sqlx::query("UPDATE trials SET plant_id = $2, metrics = $3, metrics_sha256 = $4, warnings = $5 WHERE id = $1")
        .bind(&id)
        .bind(on.plant.to_string())
        .bind(&metrics)
        .bind(sha256(&metrics))
        .bind(to_json(&on.warnings)?)
        .execute(connection)
        .await?;
    Ok(())
}

/// `NotFound` where the study has no such plant.
async fn must_be_of_study(connection: &mut SqliteConnection, plant: PlantId, study: &str) -> StoreResult<()> {
    let found: Option<i64> = sqlx::query_scalar("SELECT 1 FROM plants WHERE id = $1 AND study_id = $2")
        .bind(plant.to_string())
        .bind(study)
        .fetch_optional(connection)
        .await?;
    found.map(drop).ok_or_else(|| StoreError::not_found("plant", plant))
}

/// Stores a trial of a subject, unless its content is stored already.
pub(super) async fn keep(
    connection: &mut SqliteConnection,
    subject: &str,
    study: &str,
    (new, columns): &(NewTrial, Vec<Packed>),
    now: i64,
) -> StoreResult<Created<TrialRecord>> {
    // The same signals in another format have another content hash: a time column, or a sample time written with other
    // digits. At another rate they are another recording.
    let known: Option<String> = sqlx::query_scalar(
        "SELECT id FROM trials WHERE subject_id = $1 AND (sha256 = $2
            OR (signals_sha256 = $3 AND abs(sample_time_s - $4) <= $5 * $4))
         ORDER BY sha256 <> $2, id LIMIT 1",
    )
    .bind(subject)
    .bind(&new.sha256)
    .bind(hexadecimal(&new.trial.signals_sha256()))
    .bind(new.trial.sample_time_s)
    .bind(SAME_SAMPLE_TIME)
    .fetch_optional(&mut *connection)
    .await?;
    match known {
        Some(id) => Ok(Created::Duplicate(fetch(connection, id).await?)),
        None => {
            let id = insert(connection, subject, study, new, columns, now).await?;
            Ok(Created::New(fetch(connection, id).await?))
        }
    }
}

impl Change for TrialRecord {
    type Patch = TrialPatch;

    // The old note or reason may name a person.
    fn forgets(before: &Self, patch: &TrialPatch) -> bool {
        let is_other_note = patch.note.as_ref().is_some_and(|note| *note != before.note);
        let is_other_reason = patch.excluded.as_ref().is_some_and(|excluded| *excluded != before.excluded);
        is_other_note && !before.note.is_empty() || is_other_reason && before.excluded.is_some()
    }

    async fn update(
        connection: &mut SqliteConnection,
        before: &Self,
        patch: &TrialPatch,
        now: i64,
    ) -> StoreResult<Self> {
        let number = patch.number.unwrap_or(before.number);
        let session = patch.session.unwrap_or(before.session);
        if let Some(on) = &patch.plant {
            put_on_plant(connection, before, on).await?;
        }
        sqlx::query(
            "UPDATE trials SET number = $2, session = $3, units = $5, note = $6, excluded = $7,
                version = version + 1, updated_at = $4
             WHERE id = $1",
        )
        .bind(before.id.to_string())
        .bind(number)
        .bind(session)
        .bind(now)
        .bind(to_json(&before.units.changed(&patch.units))?)
        .bind(patch.note.as_ref().unwrap_or(&before.note))
        .bind(patch.excluded.as_ref().unwrap_or(&before.excluded))
        .execute(&mut *connection)
        .await
        .map_err(|error| number_taken(error, number, session))?;
        fetch(connection, before.id).await
    }
}

impl Store {
    /// Stores all of them or none (one transaction). A trial whose content is already stored for this subject is
    /// returned with [`Created::Duplicate`] and not stored again; a number already taken within its session by other
    /// content is a conflict (`trial_number_taken`).
    ///
    /// # Errors
    /// [`StoreError::NotFound`] (subject; plant, also one of another study), [`StoreError::Conflict`]
    /// (`trial_number_taken`, `idempotent_result_deleted`), [`StoreError::KeyReused`], [`StoreError::Damaged`] where a
    /// hash given is not that of the content, the database's own.
    pub async fn create_trials(
        &self,
        subject: SubjectId,
        new: Vec<NewTrial>,
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Vec<Created<TrialRecord>>> {
        let packed = off_runtime(move || pack_all(new)).await?;
        let (store, key) = (self.clone(), key.cloned());
        self.uninterrupted(async move { store.write_trials(subject, &packed, key.as_ref()).await }).await
    }

    async fn write_trials(
        &self,
        subject: SubjectId,
        packed: &[(NewTrial, Vec<Packed>)],
        key: Option<&IdempotencyKey>,
    ) -> StoreResult<Vec<Created<TrialRecord>>> {
        let scope = format!("subjects/{subject}/trials");
        let subject = subject.to_string();
        let mut tx = self.begin().await?;
        let study = fetch::<Subject>(&mut tx, &subject).await?.study.to_string();
        let mut outcome = Vec::with_capacity(packed.len());
        if let Some(ids) = replay(&mut tx, &scope, key).await? {
            for id in &ids {
                outcome.push(Created::Replayed(or_deleted(fetch(&mut tx, id).await)?));
            }
            return Ok(outcome);
        }
        let now = self.now_us();
        let mut ids = Vec::with_capacity(packed.len());
        for one in packed {
            let made = keep(&mut tx, &subject, &study, one, now).await?;
            ids.push(made.get().id.to_string());
            outcome.push(made);
        }
        remember(&mut tx, &scope, key, &ids, now).await?;
        tx.commit().await?;
        Ok(outcome)
    }

    /// One trial without its signals.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], the database's own.
    pub async fn trial(&self, id: TrialId) -> StoreResult<TrialRecord> {
        self.read(id).await
    }
}
