//! What a database that nobody looks after needs from time to time.

use super::clock::span_us;
use super::error::{StoreError, StoreResult};
use super::open::Store;
use std::time::Duration;

/// Rows deleted in one transaction; writers wait meanwhile.
const AT_ONCE: i64 = 5_000;

impl Store {
    /// Deletes idempotency keys older than `kept` and drafts of uploads whose time is over, folds the write-ahead log
    /// in, lets the database look at how its
    /// indexes are filled, and makes the reserve again. Returns how many keys went.
    ///
    /// # Errors
    /// The database's own.
    pub async fn upkeep(&self, keys_kept: Duration) -> StoreResult<u64> {
        let mut gone = 0;
        loop {
            let store = self.clone();
            let some = self.uninterrupted(async move { store.prune_keys(keys_kept).await }).await?;
            gone += some;
            if some < AT_ONCE.unsigned_abs() {
                break;
            }
        }
        self.expire_drafts().await?;
        let store = self.clone();
        self.uninterrupted(async move {
            let mut connection = store.writer()?.acquire().await?;
            // Looks at a few hundred entries of each index, in milliseconds.
            sqlx::raw_sql("PRAGMA analysis_limit = 400; PRAGMA optimize").execute(&mut *connection).await?;
            sqlx::query("PRAGMA wal_checkpoint(PASSIVE)").fetch_all(&mut *connection).await?;
            StoreResult::Ok(())
        })
        .await?;
        match self.keep_room().await {
            Ok(()) | Err(StoreError::Full(_)) => Ok(gone),
            Err(error) => Err(error),
        }
    }

    async fn prune_keys(&self, kept: Duration) -> StoreResult<u64> {
        let mut tx = self.begin_relief().await?;
        let gone = sqlx::query(
            "DELETE FROM idempotency_keys WHERE rowid IN
                (SELECT rowid FROM idempotency_keys WHERE created_at < $1 ORDER BY created_at LIMIT $2)",
        )
        .bind(self.now_us().saturating_sub(span_us(kept.as_secs_f64())))
        .bind(AT_ONCE)
        .execute(&mut *tx)
        .await?;
        tx.commit().await?;
        Ok(gone.rows_affected())
    }
}
