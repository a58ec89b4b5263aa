//! Opening the database, its two pools, and what every write has in common.

use super::clock::Clock;
use super::error::{StoreError, StoreResult, primary_code};
use sqlx::migrate::{MigrateError, Migration, MigrationType, Migrator};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{SqlSafeStr as _, Sqlite, Transaction};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Weak};
use std::time::Duration;
use tokio::sync::Notify;

/// The migrations, by version. The macro of sqlx that reads the folder would compile SQLite a second time.
const MIGRATIONS: [(i64, &str, &str); 5] = [
    (1, "studies trials analyses", include_str!("../../migrations/0001_studies_trials_analyses.sql")),
    (2, "brackets", include_str!("../../migrations/0002_brackets.sql")),
    (3, "trial warnings", include_str!("../../migrations/0003_trial_warnings.sql")),
    (4, "phases", include_str!("../../migrations/0004_phases.sql")),
    (5, "trust", include_str!("../../migrations/0005_trust.sql")),
];

fn migrator() -> Migrator {
    let migration = |(version, description, sql): (i64, &'static str, &'static str)| {
        Migration::new(version, description.into(), MigrationType::Simple, sql.into_sql_str(), false)
    };
    Migrator::with_migrations(MIGRATIONS.map(migration).to_vec())
}

/// `PRAGMA application_id` of our files ("VOLT"); the first migration writes it.
const APPLICATION_ID: i64 = 0x564F_4C54;

/// How long a statement waits for another process's lock before it fails.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);

/// Connections that read.
const READERS: u32 = 4;

/// A handle to the database; cheap to clone.
#[derive(Debug, Clone)]
pub struct Store {
    inner: Arc<Inner>,
}

#[derive(Debug)]
pub(super) struct Inner {
    writer: SqlitePool,
    readers: SqlitePool,
    clock: Clock,
    /// Work entered the queue, as far as this process knows.
    work: Arc<Notify>,
    /// A deletion's traces may still be in the write-ahead log.
    pub(super) log_due: AtomicBool,
    /// Somebody waits to vacuum.
    pub(super) scrub_planned: AtomicBool,
    /// Removed last, after the pools.
    _temporary: Option<TemporaryDirectory>,
}

impl Store {
    /// Opens (creating and migrating it where needed) the database file; `None` is a private temporary one, removed
    /// with the last handle.
    ///
    /// # Errors
    /// [`StoreError::CannotOpen`] where the path is a directory, is not ours, or cannot be read and written, or was
    /// written by a newer version; [`StoreError::Migration`] where its schema cannot be brought up to date.
    pub async fn open(path: Option<&Path>) -> StoreResult<Self> {
        Self::open_with_clock(path, Clock::System).await
    }

    /// [`Store::open`] with a clock of the caller's.
    ///
    /// # Errors
    /// As [`Store::open`].
    pub async fn open_with_clock(path: Option<&Path>, clock: Clock) -> StoreResult<Self> {
        let (file, temporary) = match path {
            Some(path) => (path.to_owned(), None),
            None => {
                let directory = TemporaryDirectory::create()?;
                (directory.0.join("volition.db"), Some(directory))
            }
        };
        check_file(&file)?;
        let options = SqliteConnectOptions::new()
            .filename(&file)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .foreign_keys(true)
            .busy_timeout(BUSY_TIMEOUT)
            // See `scrub` for what this does and does not do.
            .pragma("secure_delete", "ON")
            // Sorting a person's rows must not leave copies in temporary files.
            .pragma("temp_store", "MEMORY");
        let cannot_open = |error: StoreError| explain(&file, error);
        let writer = SqlitePoolOptions::new()
            .max_connections(1)
            .acquire_timeout(Duration::from_secs(60))
            .connect_with(options.clone())
            .await
            .map_err(|error| cannot_open(error.into()))?;
        prepare(&writer, &file).await.map_err(cannot_open)?;
        let readers = SqlitePoolOptions::new()
            .max_connections(READERS)
            .acquire_timeout(Duration::from_secs(60))
            .connect_with(options.pragma("query_only", "ON"))
            .await
            .map_err(|error| cannot_open(error.into()))?;
        let inner = Inner {
            writer,
            readers,
            clock,
            work: Arc::new(Notify::new()),
            // A process that was killed between a deletion and its scrubbing left the rest to us.
            log_due: AtomicBool::new(true),
            scrub_planned: AtomicBool::new(false),
            _temporary: temporary,
        };
        let store = Self { inner: Arc::new(inner) };
        store.judge_unjudged().await?;
        store.scrub_if_due().await;
        Ok(store)
    }

    /// Whether a trivial query succeeds (readiness).
    ///
    /// # Errors
    /// The database's own.
    pub async fn ping(&self) -> StoreResult<()> {
        sqlx::query("SELECT count(*) FROM studies WHERE id = ''").execute(self.readers()).await?;
        Ok(())
    }

    /// Waits for what is under way and closes every connection.
    pub async fn close(&self) {
        self.inner.readers.close().await;
        self.inner.writer.close().await;
    }

    /// Told whenever this process puts work into the queue. Other processes' work is found by polling.
    #[must_use]
    pub(crate) fn work_arrived(&self) -> Arc<Notify> {
        Arc::clone(&self.inner.work)
    }

    /// The time, in microseconds, that leases are judged by.
    #[must_use]
    pub(crate) fn now_us(&self) -> i64 {
        self.inner.clock.now_us()
    }

    pub(super) fn writer(&self) -> &SqlitePool {
        &self.inner.writer
    }

    pub(super) fn readers(&self) -> &SqlitePool {
        &self.inner.readers
    }

    /// Begins a write; nobody else can until it ends.
    pub(super) async fn begin(&self) -> StoreResult<Transaction<'static, Sqlite>> {
        Ok(self.inner.writer.begin_with("BEGIN IMMEDIATE").await?)
    }

    /// Begins a read of several statements that see the same state.
    pub(super) async fn snapshot(&self) -> StoreResult<Transaction<'static, Sqlite>> {
        Ok(self.inner.readers.begin().await?)
    }

    /// Tells waiting workers of this process.
    pub(super) fn announce_work(&self) {
        self.inner.work.notify_waiters();
        // Nobody may be waiting right now; leave a permit for whoever comes next.
        self.inner.work.notify_one();
    }

    pub(super) fn inner(&self) -> &Inner {
        &self.inner
    }

    pub(super) fn downgrade(&self) -> Weak<Inner> {
        Arc::downgrade(&self.inner)
    }

    pub(super) fn from_inner(inner: Arc<Inner>) -> Self {
        Self { inner }
    }
}

/// Refuses what SQLite would report badly or not at all, and creates the file so that only its owner can read it.
fn check_file(file: &Path) -> StoreResult<()> {
    let cannot = |reason: String| StoreError::CannotOpen { path: file.display().to_string(), reason };
    match std::fs::metadata(file) {
        Ok(metadata) if metadata.is_dir() => Err(cannot("it is a directory; name a file".to_owned())),
        Ok(metadata) if !metadata.is_file() => Err(cannot("it is not a regular file".to_owned())),
        // Not opened here: closing it again would drop the locks that SQLite may hold on it in this process (POSIX
        // locks belong to process and file, not to the handle).
        Ok(_) => Ok(()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            let mut options = std::fs::OpenOptions::new();
            options.write(true).create_new(true);
            #[cfg(unix)]
            std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
            match options.open(file) {
                Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => {
                    Err(cannot(format!("it cannot be created: {error}")))
                }
                // Created by another process at the same moment is as good.
                _ => Ok(()),
            }
        }
        Err(error) => Err(cannot(error.to_string())),
    }
}

/// Makes sure that the file is ours, and brings its schema up to date under the write lock.
async fn prepare(writer: &SqlitePool, file: &Path) -> StoreResult<()> {
    let cannot = |reason: String| StoreError::CannotOpen { path: file.display().to_string(), reason };
    let mut tx = writer.begin_with("BEGIN IMMEDIATE").await?;
    let application: i64 = sqlx::query_scalar("PRAGMA application_id").fetch_one(&mut *tx).await?;
    let tables: i64 = sqlx::query_scalar("SELECT count(*) FROM sqlite_master").fetch_one(&mut *tx).await?;
    if application != APPLICATION_ID && (application != 0 || tables != 0) {
        return Err(cannot("it is an SQLite database of another program".to_owned()));
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

/// Says in words what SQLite says in codes.
fn explain(file: &Path, error: StoreError) -> StoreError {
    let StoreError::Database(sqlx::Error::Database(cause)) = &error else { return error };
    let reason = match primary_code(cause.as_ref()) {
        Some(26) => "it is not a database".to_owned(),
        Some(11) => format!("it is damaged ({cause}); restore a backup"),
        Some(8 | 14) => format!("it, or the directory it is in, cannot be written ({cause})"),
        Some(5) => "another program holds a lock on it".to_owned(),
        _ => return error,
    };
    StoreError::CannotOpen { path: file.display().to_string(), reason }
}

/// A directory of our own, removed when dropped.
#[derive(Debug)]
struct TemporaryDirectory(PathBuf);

impl TemporaryDirectory {
    fn create() -> StoreResult<Self> {
        let path = std::env::temp_dir().join(format!("volition-{}", uuid::Uuid::now_v7()));
        let mut builder = std::fs::DirBuilder::new();
        #[cfg(unix)]
        std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
        builder.create(&path).map_err(|error| StoreError::CannotOpen {
            path: path.display().to_string(),
            reason: format!("the temporary directory cannot be created: {error}"),
        })?;
        Ok(Self(path))
    }
}

impl Drop for TemporaryDirectory {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.0) {
            tracing::warn!(path = %self.0.display(), %error, "a temporary database was left behind");
        }
    }
}
