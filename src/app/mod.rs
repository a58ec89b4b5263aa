//! What the commands do: the parts put together.

pub mod compare;
pub mod demo;
pub mod import;
pub mod run;
pub mod serve;

use crate::api::{AppState, router};
use crate::store::Store;
use std::future::Future;
use tower::ServiceExt as _;

/// The answers that commands read are far smaller.
const MOST_ANSWER_BYTES: usize = 256 << 20;

/// What the API answered.
pub(crate) enum Answer {
    /// With success.
    Body(Vec<u8>),
    /// With a problem document.
    Problem(Vec<u8>),
}

/// The answer of the API itself to a read, without a network: what a command prints is what a client reads.
///
/// # Errors
/// When there is no answer.
pub(crate) async fn ask(store: &Store, path: &str) -> anyhow::Result<Answer> {
    let request =
        axum::http::Request::get(path).header(axum::http::header::HOST, "localhost").body(axum::body::Body::empty())?;
    let response = router(AppState::new(store.clone())).oneshot(request).await?;
    let is_success = response.status().is_success();
    let body = axum::body::to_bytes(response.into_body(), MOST_ANSWER_BYTES).await?.to_vec();
    Ok(if is_success { Answer::Body(body) } else { Answer::Problem(body) })
}

/// Runs a future on a new runtime to its end.
///
/// # Errors
/// What the future says, or that the runtime could not start.
pub fn block_on<T>(future: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    tokio::runtime::Builder::new_multi_thread().enable_all().build()?.block_on(future)
}
