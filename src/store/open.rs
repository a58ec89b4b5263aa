//! Opening the database, and its two pools.

use super::clock::Clock;
use super::damage::Damage;
use super::error::{StoreError, StoreResult, Trouble};
use super::migrate::{explain, prepare};
use super::place::{Place, TemporaryDirectory, check_file};
use super::reserve::Reserve;
use super::watch::Watch;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{Connection as _, Sqlite, SqliteConnection, Transaction};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock, Weak};
use std::time::{Duration, Instant};
use tokio::sync::{Mutex, Notify, Semaphore};

/// How long a statement waits for another process's lock before it fails.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);

/// Connections that read.
const READERS: u32 = 4;

/// Writes that wait for the connection or are under way; others wait before, where they can still be forgotten.
const WRITES_AT_ONCE: usize = 64;

/// What the write-ahead log is cut back to once it is folded in.
const LOG_BYTES: &str = "67108864";

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
    opened: Instant,
    replaced: Arc<AtomicU64>,
    pub(super) place: Place,
    /// Room kept for a full disk; none where nobody asked for it.
    pub(super) reserve: OnceLock<Arc<Reserve>>,
    /// Held by every write that is under way.
    pub(super) writes: Arc<Semaphore>,
    /// When the latest successful look at readiness began.
    pub(super) ready: Mutex<Option<Instant>>,
    /// What was seen of workers' signs of life.
    pub(super) watch: Watch,
    /// Rows that could not be read.
    pub(super) damage: Damage,
    /// Work entered the queue, as far as this process knows.
    work: Arc<Notify>,
    /// A deletion's traces may still be in the write-ahead log.
    pub(super) log_due: AtomicBool,
    /// Somebody waits to vacuum.
    pub(super) scrub_planned: AtomicBool,
    /// Removed last, after the pools.
    _temporary: Option<TemporaryDirectory>,
}

/// Connections are looked at before they are lent. A commit that fails on a full disk has rolled back in SQLite but not
/// in sqlx, which then refuses every later transaction on that connection: it is closed, and a new one opened.
fn pool(connections: u32, replaced: &Arc<AtomicU64>) -> SqlitePoolOptions {
    let replaced = Arc::clone(replaced);
    SqlitePoolOptions::new().max_connections(connections).acquire_timeout(Duration::from_secs(60)).before_acquire(
        move |connection, _| {
            let sound = !connection.is_in_transaction();
            if !sound {
                replaced.fetch_add(1, Ordering::Relaxed);
                tracing::warn!("a connection was left within a transaction; another takes its place");
            }
            Box::pin(async move { Ok(sound) })
        },
    )
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
            .pragma("journal_size_limit", LOG_BYTES)
            .foreign_keys(true)
            .busy_timeout(BUSY_TIMEOUT)
            // See `scrub` for what this does and does not do.
            .pragma("secure_delete", "ON")
            // Sorting a person's rows must not leave copies in temporary files.
            .pragma("temp_store", "MEMORY");
        let cannot_open = |error: StoreError| explain(&file, error);
        let replaced = Arc::new(AtomicU64::new(0));
        let writer =
            pool(1, &replaced).connect_with(options.clone()).await.map_err(|error| cannot_open(error.into()))?;
        prepare(&writer, &file).await.map_err(cannot_open)?;
        let readers = pool(READERS, &replaced)
            .connect_with(options.pragma("query_only", "ON"))
            .await
            .map_err(|error| cannot_open(error.into()))?;
        let inner = Inner {
            writer,
            readers,
            clock,
            opened: Instant::now(),
            replaced,
            place: Place::of(&file),
            reserve: OnceLock::new(),
            writes: Arc::new(Semaphore::new(WRITES_AT_ONCE)),
            ready: Mutex::new(None),
            watch: Watch::default(),
            damage: Damage::default(),
            work: Arc::new(Notify::new()),
            // A process that was killed between a deletion and its scrubbing left the rest to us.
            log_due: AtomicBool::new(true),
            scrub_planned: AtomicBool::new(false),
            _temporary: temporary,
        };
        let store = Self { inner: Arc::new(inner) };
        match store.judge_unjudged().await {
            // People can read all the same, and the rest is judged at the next start.
            Err(error) if error.trouble() == Some(Trouble::Full) => {
                tracing::error!(%error, "earlier reports could not be judged");
            }
            judged => judged?,
        }
        store.scrub_if_due().await;
        Ok(store)
    }

    /// Keeps so many bytes beside the database, in a file that is deleted when the disk is full, so that deleting and
    /// cancelling still work then. It is made again as soon as there is room; until then nothing else is written.
    ///
    /// # Errors
    /// [`StoreError::Full`] where there is no room for it now; it is made later.
    pub async fn keep_reserve(&self, bytes: u64) -> StoreResult<()> {
        if bytes > 0 {
            let file = self.inner.place.file();
            self.inner.reserve.get_or_init(|| Arc::new(Reserve::beside(file, bytes)));
        }
        self.keep_room().await
    }

    /// How many connections were found within a transaction that nobody was in any more, and replaced: one for each
    /// commit that met a full or failing disk, and none for clients that went away.
    #[must_use]
    pub fn count_replaced(&self) -> u64 {
        self.inner.replaced.load(Ordering::Relaxed)
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

    /// The time of day in microseconds.
    #[must_use]
    pub(crate) fn now_us(&self) -> i64 {
        self.inner.clock.now_us()
    }

    /// The time of day.
    pub(super) fn now(&self) -> time::OffsetDateTime {
        self.inner.clock.now()
    }

    /// A connection beside the pools, for what takes long and must not hold up others.
    pub(super) async fn connection_of_its_own(&self) -> StoreResult<SqliteConnection> {
        self.inner.place.unmoved()?;
        let options = SqliteConnectOptions::new().filename(self.inner.place.file()).busy_timeout(BUSY_TIMEOUT);
        Ok(SqliteConnection::connect_with(&options).await?)
    }

    /// Microseconds that have passed since some moment; the silence of workers is judged by them.
    pub(super) fn passed_us(&self) -> i64 {
        self.inner.clock.passed_us(self.inner.opened)
    }

    /// The connection that writes.
    pub(super) fn writer(&self) -> StoreResult<&SqlitePool> {
        self.inner.place.unmoved()?;
        Ok(&self.inner.writer)
    }

    /// The connections that read.
    pub(super) fn readers(&self) -> StoreResult<&SqlitePool> {
        self.inner.place.unmoved()?;
        Ok(&self.inner.readers)
    }

    /// Begins a read of several statements that see the same state.
    pub(super) async fn snapshot(&self) -> StoreResult<Transaction<'static, Sqlite>> {
        Ok(self.readers()?.begin().await?)
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
