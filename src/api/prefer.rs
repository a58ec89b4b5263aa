//! `Prefer: wait=SECONDS` (RFC 7240): an answer that waits a while for what was asked for.

use super::problem::ApiResult;
use super::state::AppState;
use crate::analysis::ids::AnalysisId;
use crate::store::AnalysisRecord;
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderName, HeaderValue};
use axum::response::Response;
use std::convert::Infallible;
use std::time::Duration;
use tokio::time::Instant;
use utoipa::IntoParams;

/// The request header.
pub(super) const PREFER: HeaderName = HeaderName::from_static("prefer");
/// The response header that says which preferences were followed.
pub(super) const PREFERENCE_APPLIED: HeaderName = HeaderName::from_static("preference-applied");

/// Pauses between looks at the analysis: short ones at first, since many analyses take milliseconds. Workers may be
/// other processes, so nothing else could tell.
const FIRST_PAUSE: Duration = Duration::from_millis(10);
const LAST_PAUSE: Duration = Duration::from_millis(250);

/// Header that asks the answer to wait.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "documents a header that the extractor reads")]
pub(crate) struct PreferHeader {
    /// `wait=SECONDS`: answer when the analysis is finished, or when so many seconds have passed; 60 at most. The
    /// answer's `Preference-Applied` says how long it would have waited. Other preferences are passed over.
    #[param(rename = "Prefer", required = false, nullable = false, value_type = Option<String>, example = "wait=10")]
    prefer: Option<String>,
}

/// How long the client lets an answer wait; `None` where it does not ask for that.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Prefer(Option<u64>);

impl Prefer {
    /// From the header's text: a preference that is not understood is to be passed over (RFC 7240, section 2).
    fn read(text: &str) -> Option<u64> {
        text.split([',', ';']).find_map(|preference| {
            let (name, value) = preference.split_once('=')?;
            if !name.trim().eq_ignore_ascii_case("wait") {
                return None;
            }
            value.trim().trim_matches('"').parse().ok()
        })
    }

    /// The analysis as it is when it is finished, or when the time is over.
    ///
    /// # Errors
    /// Where it was deleted meanwhile; the database's own.
    pub(super) async fn awaited(self, state: &AppState, id: AnalysisId) -> ApiResult<AnalysisRecord> {
        let mut record = state.store.analysis(id).await?;
        let Some(seconds) = self.bounded(state) else { return Ok(record) };
        let until = Instant::now() + Duration::from_secs(seconds);
        let mut pause = FIRST_PAUSE;
        while !record.status.is_final() && Instant::now() < until {
            tokio::select! {
                () = state.shutdown.cancelled() => break,
                () = tokio::time::sleep_until(until.min(Instant::now() + pause)) => {}
            }
            pause = (2 * pause).min(LAST_PAUSE);
            record = state.store.analysis(id).await?;
        }
        Ok(record)
    }

    /// Whether it asks for anything.
    pub(super) fn asks(self) -> bool {
        self.0.is_some()
    }

    fn bounded(self, state: &AppState) -> Option<u64> {
        Some(self.0?.min(state.limits.max_wait.as_secs()))
    }

    /// Says in the answer that it was followed.
    pub(super) fn applied(self, state: &AppState, mut response: Response) -> Response {
        if let Some(seconds) = self.bounded(state)
            && let Ok(value) = HeaderValue::from_str(&format!("wait={seconds}"))
        {
            response.headers_mut().insert(PREFERENCE_APPLIED, value);
        }
        response
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Prefer {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        let texts = parts.headers.get_all(PREFER).iter().filter_map(|value| value.to_str().ok());
        Ok(Self(texts.filter_map(Self::read).next()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_wait_in_seconds_is_followed() {
        for (text, seconds) in [
            ("wait=2", Some(2)),
            ("respond-async, wait=10", Some(10)),
            ("Wait=\"5\"; x=1", Some(5)),
            ("wait", None),
            ("wait=soon", None),
            ("wait=-1", None),
            ("wait=1.5", None),
            ("await=3", None),
            ("", None),
        ] {
            assert_eq!(Prefer::read(text), seconds, "{text}");
        }
    }
}
