//! What the commands do: the parts put together.

pub mod demo;
pub mod import;
pub mod run;
pub mod serve;

use std::future::Future;

/// Runs a future on a new runtime to its end.
///
/// # Errors
/// What the future says, or that the runtime could not start.
pub fn block_on<T>(future: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    tokio::runtime::Builder::new_multi_thread().enable_all().build()?.block_on(future)
}
