//! Bringing the schema of a file up to date, after a copy of it as it was.

use super::copy::copy_into;
use super::error::{StoreError, StoreResult, Trouble, primary_code};
use super::place::beside;
use sqlx::migrate::{MigrateError, Migration, MigrationType, Migrator};
use sqlx::sqlite::SqlitePool;
use sqlx::{SqlSafeStr as _, SqliteConnection};
use std::path::Path;

/// The migrations, by version. The macro of sqlx that reads the folder would compile SQLite a second time.
const MIGRATIONS: [(i64, &str, &str); 11] = [
    (1, "studies trials analyses", include_str!("../../migrations/0001_studies_trials_analyses.sql")),
    (2, "brackets", include_str!("../../migrations/0002_brackets.sql")),
    (3, "trial warnings", include_str!("../../migrations/0003_trial_warnings.sql")),
    (4, "phases", include_str!("../../migrations/0004_phases.sql")),
    (5, "trust", include_str!("../../migrations/0005_trust.sql")),
    (10, "durable", include_str!("../../migrations/0010_durable.sql")),
    (11, "estimates", include_str!("../../migrations/0011_estimates.sql")),
    (12, "drafts", include_str!("../../migrations/0012_drafts.sql")),
    (15, "study reading", include_str!("../../migrations/0015_study_reading.sql")),
    (18, "trials left out", include_str!("../../migrations/0018_trials_left_out.sql")),
    (26, "estimates again", include_str!("../../migrations/0026_estimates_again.sql")),
];

/// `PRAGMA application_id` of our files ("VOLT"); the first migration writes it.
pub(super) const APPLICATION_ID: i64 = 0x564F_4C54;

fn migrator() -> Migrator {
    let migration = |(version, description, sql): (i64, &'static str, &'static str)| {
        Migration::new(version, description.into(), MigrationType::Simple, sql.into_sql_str(), false)
    };
    Migrator::with_migrations(MIGRATIONS.map(migration).to_vec())
}

/// The last step of the schema that this program knows.
pub(super) fn newest_step() -> i64 {
    MIGRATIONS.iter().map(|(version, ..)| *version).max().unwrap_or_default()
}

/// The last step of the schema that a file has; 0 where it has none.
pub(super) async fn step(connection: &mut SqliteConnection) -> StoreResult<i64> {
    let has_steps: i64 =
        sqlx::query_scalar("SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = '_sqlx_migrations'")
            .fetch_one(&mut *connection)
            .await?;
    if has_steps == 0 {
        return Ok(0);
    }
    let newest: Option<i64> =
        sqlx::query_scalar("SELECT max(version) FROM _sqlx_migrations").fetch_one(connection).await?;
    Ok(newest.unwrap_or_default())
}

/// Whether a file holds our tables, or nothing yet.
pub(super) async fn is_ours(connection: &mut SqliteConnection) -> StoreResult<bool> {
    let application: i64 = sqlx::query_scalar("PRAGMA application_id").fetch_one(&mut *connection).await?;
    let tables: i64 = sqlx::query_scalar("SELECT count(*) FROM sqlite_master").fetch_one(connection).await?;
    Ok(application == APPLICATION_ID || (application == 0 && tables == 0))
}

/// Makes sure that the file is ours, and brings its schema up to date under the write lock.
pub(super) async fn prepare(writer: &SqlitePool, file: &Path) -> StoreResult<()> {
    let cannot = |reason: String| StoreError::CannotOpen { path: file.display().to_string(), reason };
    let foreign = || cannot("it is an SQLite database of another program".to_owned());
    let mut connection = writer.acquire().await?;
    if !is_ours(&mut connection).await? {
        return Err(foreign());
    }
    let before = step(&mut connection).await?;
    if before > 0 && before < newest_step() {
        keep_copy(&mut connection, file, before).await?;
    }
    drop(connection);
    let mut tx = writer.begin_with("BEGIN IMMEDIATE").await?;
    if !is_ours(&mut tx).await? {
        return Err(foreign());
    }
    // Within the transaction, so that two processes that start together do not migrate at once.
    migrator().run(&mut *tx).await.map_err(|error| match error {
        MigrateError::VersionMissing(version) | MigrateError::VersionTooNew(version, _) => cannot(format!(
            "it was written by a newer version of this program (its schema has step {version}, unknown here); \
             run that version, or restore an older backup"
        )),
        other => other.into(),
    })?;
    tx.commit().await?;
    Ok(())
}

/// Keeps the file as it is before a step of its schema, under a name that says which step it has.
async fn keep_copy(connection: &mut SqliteConnection, file: &Path, step: i64) -> StoreResult<()> {
    let copy = beside(file, &format!(".step{step}"));
    // The copy of an earlier try, or of another process that starts at this moment, is as good.
    if copy.exists() {
        return Ok(());
    }
    match copy_into(connection, &copy).await {
        Ok(()) => {
            tracing::info!(copy = %copy.display(), step, "kept as it was before its schema is brought up to date");
            Ok(())
        }
        Err(error) if error.trouble() == Some(Trouble::Full) => Err(StoreError::CannotOpen {
            path: file.display().to_string(),
            reason: "there is no room for a copy of it, which is made before its schema is changed; free as much as \
                it takes"
                .to_owned(),
        }),
        Err(error) => Err(error),
    }
}

/// Says in words what SQLite says in codes.
pub(super) fn explain(file: &Path, error: StoreError) -> StoreError {
    let StoreError::Database(sqlx::Error::Database(cause)) = &error else { return error };
    let reason = match primary_code(cause.as_ref()) {
        Some(26) => "it is not a database".to_owned(),
        Some(11) => format!("it is damaged ({cause}); restore a backup"),
        Some(8 | 14) => format!("it, or the directory it is in, cannot be written ({cause})"),
        Some(13) => "the disk is full".to_owned(),
        Some(5) => "another program holds a lock on it".to_owned(),
        _ => return error,
    };
    StoreError::CannotOpen { path: file.display().to_string(), reason }
}
