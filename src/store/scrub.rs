//! Deleting so that nothing is left on disk.
//!
//! Three layers hold traces of a deleted row, and each has its remedy:
//! - the row itself and its blobs: `secure_delete` overwrites them as part of the deletion;
//! - the write-ahead log: folded in and truncated right after it;
//! - stale copies in the unused middle of pages, which SQLite leaves when it moves rows between pages and
//!   `secure_delete` does not reach (`rebuildPage` in SQLite 3.51; our tests find them): only `VACUUM`, which writes
//!   every page anew.
//!
//! A small database is vacuumed before the deletion returns. A large one, where that takes seconds and stops other
//! writes, a little later, so that a series of deletions shares one; the debt is counted in `PRAGMA user_version`,
//! within the deletion's own transaction, and whoever opens the database next pays it if this process dies.

use super::clock::span_us;
use super::error::StoreResult;
use super::open::Store;
use sqlx::{Connection, Sqlite, SqliteConnection, Transaction};
use std::future::Future;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Databases up to this size are vacuumed at once: some 0.3 s on a laptop's disk.
const AT_ONCE_BYTES: i64 = 32 << 20;

/// How long a large database waits for further deletions.
const PAUSE: Duration = Duration::from_secs(5);

impl Store {
    /// Turns a write into one after which something must be gone.
    pub(super) async fn begin_erasing(
        &self,
        mut tx: Transaction<'static, Sqlite>,
    ) -> StoreResult<Transaction<'static, Sqlite>> {
        let debt = debt(&mut tx).await?;
        set_debt(&mut tx, debt.saturating_add(1)).await?;
        Ok(tx)
    }

    /// The outcome of a deletion, once its traces are cleared away.
    pub(super) async fn erased<T>(&self, deletion: impl Future<Output = StoreResult<T>>) -> StoreResult<T> {
        let outcome = deletion.await?;
        self.inner().log_due.store(true, Ordering::SeqCst);
        self.scrub_if_due().await;
        Ok(outcome)
    }

    /// Clears every trace of earlier deletions away, however large the database is. Writes wait meanwhile; reads do
    /// not.
    ///
    /// # Errors
    /// The database's own; the debt then stays.
    pub async fn scrub(&self) -> StoreResult<()> {
        let mut connection = self.writer()?.acquire().await?;
        let owed = debt(&mut connection).await?;
        if owed > 0 {
            let begin = Instant::now();
            // The copy that VACUUM makes on its way: in memory where it is small.
            let temporary = if size(&mut connection).await? <= 8 * AT_ONCE_BYTES { "MEMORY" } else { "FILE" };
            sqlx::query(sqlx::AssertSqlSafe(format!("PRAGMA temp_store = {temporary}")))
                .execute(&mut *connection)
                .await?;
            sqlx::query("VACUUM").execute(&mut *connection).await?;
            let took_s = begin.elapsed().as_secs_f64();
            // While nobody could write, nobody could renew a lease either. Nor may another process's deletion since
            // then be forgotten.
            let mut tx = connection.begin_with("BEGIN IMMEDIATE").await?;
            settle(&mut tx, owed, span_us(took_s)).await?;
            tx.commit().await?;
            tracing::debug!(took_s, "traces of deletions were vacuumed away");
        }
        drop(connection);
        self.inner().log_due.store(true, Ordering::SeqCst);
        self.truncate_log().await;
        Ok(())
    }

    /// Clears traces away at once where that is quick, else in a while. After each deletion, and on the way of each
    /// rescue, which pays what an earlier attempt could not.
    pub(super) async fn scrub_if_due(&self) {
        match self.owes_and_is_small().await {
            Ok((true, true)) => return self.scrub_or_warn().await,
            Ok((false, _)) => {}
            Ok((true, false)) => {
                if !self.inner().scrub_planned.swap(true, Ordering::SeqCst) {
                    self.scrub_later();
                }
            }
            Err(error) => tracing::warn!(%error, "traces of deletions could not be looked for; trying again later"),
        }
        if self.inner().log_due.load(Ordering::SeqCst) {
            self.truncate_log().await;
        }
    }

    fn scrub_later(&self) {
        let inner = self.downgrade();
        tokio::spawn(async move {
            tokio::time::sleep(PAUSE).await;
            // Where nobody has the database open any more, the next to open it does it.
            let Some(store) = inner.upgrade().map(Self::from_inner) else { return };
            store.inner().scrub_planned.store(false, Ordering::SeqCst);
            store.scrub_or_warn().await;
        });
    }

    async fn scrub_or_warn(&self) {
        if let Err(error) = self.scrub().await {
            tracing::warn!(%error, "traces of deletions could not be cleared away; trying again later");
        }
    }

    async fn owes_and_is_small(&self) -> StoreResult<(bool, bool)> {
        let mut connection = self.readers()?.acquire().await?;
        Ok((debt(&mut connection).await? > 0, size(&mut connection).await? <= AT_ONCE_BYTES))
    }

    /// Folds the write-ahead log into the file and truncates it.
    ///
    /// A reader that holds an old state can prevent that; then it stays due, and the next deletion or rescue (each
    /// worker makes one every few seconds) tries again.
    async fn truncate_log(&self) {
        let outcome = async {
            let cut = sqlx::query_as::<_, (i64, i64, i64)>("PRAGMA wal_checkpoint(TRUNCATE)");
            StoreResult::Ok(cut.fetch_one(self.writer()?).await?)
        }
        .await;
        self.inner().log_due.store(!matches!(outcome, Ok((0, _, _))), Ordering::SeqCst);
        match outcome {
            Ok((0, _, _)) => {}
            Ok(_) => tracing::warn!("a reader kept the write-ahead log from being truncated; trying again later"),
            Err(error) => tracing::warn!(%error, "the write-ahead log could not be truncated; trying again later"),
        }
    }
}

/// How many deletions left traces.
async fn debt(connection: &mut SqliteConnection) -> StoreResult<i64> {
    Ok(sqlx::query_scalar("PRAGMA user_version").fetch_one(connection).await?)
}

async fn set_debt(connection: &mut SqliteConnection, debt: i64) -> StoreResult<()> {
    // A pragma takes no parameters; this one is 32 bits wide.
    let debt = debt.clamp(0, i64::from(i32::MAX));
    sqlx::query(sqlx::AssertSqlSafe(format!("PRAGMA user_version = {debt}"))).execute(connection).await?;
    Ok(())
}

async fn settle(connection: &mut SqliteConnection, paid: i64, pause_us: i64) -> StoreResult<()> {
    let owed = debt(connection).await?;
    set_debt(connection, owed - paid).await?;
    // Seen as a sign of life of every worker, none of which could give one.
    sqlx::query(
        "UPDATE analyses SET beat = beat + 1, lease_expires_at = lease_expires_at + $1 WHERE status = 'running'",
    )
    .bind(pause_us)
    .execute(connection)
    .await?;
    Ok(())
}

async fn size(connection: &mut SqliteConnection) -> StoreResult<i64> {
    let pages: i64 = sqlx::query_scalar("PRAGMA page_count").fetch_one(&mut *connection).await?;
    let page: i64 = sqlx::query_scalar("PRAGMA page_size").fetch_one(connection).await?;
    Ok(pages.saturating_mul(page))
}
