//! Work that blocks, away from the threads that serve requests.

use super::error::StoreResult;

/// Runs packing, hashing or reading of files away from the runtime's own threads.
pub(super) async fn off_runtime<T: Send + 'static>(
    work: impl FnOnce() -> StoreResult<T> + Send + 'static,
) -> StoreResult<T> {
    match tokio::task::spawn_blocking(work).await {
        Ok(outcome) => outcome,
        Err(error) if error.is_panic() => std::panic::resume_unwind(error.into_panic()),
        Err(_) => Err(sqlx::Error::PoolClosed.into()),
    }
}
