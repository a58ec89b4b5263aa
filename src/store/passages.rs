//! When analyses came, were taken up and ended.

use super::error::StoreResult;
use super::open::Store;
use super::rows::get;

/// When an analysis came, was taken up and ended, in hours before now (negative).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passage {
    /// When it was asked for.
    pub created_h: f64,
    /// When its present or last attempt began; `None` before the first.
    pub started_h: Option<f64>,
    /// When it ended; `None` while it waits or runs.
    pub finished_h: Option<f64>,
    /// Whether it ended with a problem.
    pub failed: bool,
}

impl Store {
    /// The analyses that are not finished, or were finished within the last hours.
    ///
    /// # Errors
    /// The database's own.
    pub async fn passages(&self, hours: f64) -> StoreResult<Vec<Passage>> {
        const MICROSECONDS: f64 = 3.6e9;
        let now = self.now_us();
        let rows = sqlx::query(
            "SELECT created_at, CASE WHEN status <> 'queued' THEN started_at END AS started_at, finished_at,
                    status = 'failed' AS failed
             FROM analyses WHERE finished_at IS NULL OR finished_at >= $1",
        )
        .bind(now.saturating_sub((hours * MICROSECONDS) as i64))
        .fetch_all(self.readers()?)
        .await?;
        let before = |at: i64| (at - now) as f64 / MICROSECONDS;
        rows.iter()
            .map(|row| {
                Ok(Passage {
                    created_h: before(get(row, "created_at")?),
                    started_h: get::<Option<i64>>(row, "started_at")?.map(before),
                    finished_h: get::<Option<i64>>(row, "finished_at")?.map(before),
                    failed: get(row, "failed")?,
                })
            })
            .collect()
    }
}
