//! What the commands do: the parts put together.

pub mod backup;
pub mod bundle;
pub mod check;
pub mod compare;
pub mod demo;
pub mod exit;
pub mod figures;
pub mod import;
pub mod manual;
pub mod recordings;
pub mod run;
pub mod serve;
pub mod table;

use crate::api::{AppState, router};
use crate::store::{Page, Store};
use anyhow::bail;
use std::future::Future;
use tower::ServiceExt as _;

/// The answers that commands read are far smaller.
const MOST_ANSWER_BYTES: usize = 256 << 20;

/// Studies looked at in one step.
const PAGE: u32 = 500;

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

/// Percent-encoded.
pub(crate) fn encoded(text: &str) -> String {
    let one = |byte: u8| match byte {
        b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' | b',' => char::from(byte).to_string(),
        other => format!("%{other:02X}"),
    };
    text.bytes().map(one).collect()
}

/// The id of the study with this id or name.
pub(crate) async fn find_study(store: &Store, wanted: &str) -> anyhow::Result<String> {
    let mut after = None;
    let mut found = Vec::new();
    loop {
        let page = store.studies(Page { after, limit: PAGE }).await?;
        found.extend(page.iter().filter(|s| s.name == wanted || s.id.to_string() == wanted).map(|s| s.id.to_string()));
        match page.last() {
            Some(last) if page.len() == PAGE as usize => after = Some(last.id.0),
            _ => break,
        }
    }
    match found.as_slice() {
        [] => bail!("there is no study {wanted:?}"),
        [one] => Ok(one.clone()),
        several => bail!("{} studies are called {wanted:?}: give an id ({})", several.len(), several.join(", ")),
    }
}

/// Runs a future on a new runtime to its end.
///
/// # Errors
/// What the future says, or that the runtime could not start.
pub fn block_on<T>(future: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    tokio::runtime::Builder::new_multi_thread().enable_all().build()?.block_on(future)
}
