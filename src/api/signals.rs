//! A trial's recording, bit for bit as it was uploaded.

use super::etag::{ETag, IfNoneMatch, is_known, not_modified};
use super::named::Named;
use super::negotiate::{not_acceptable, preferred};
use super::problem::{ApiResult, RequestCode};
use super::trials::{TrialPath, TrialView};
use crate::analysis::Problem;
use crate::trial::{Trial, write};
use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::Serialize;
use std::io::{self, BufWriter, Write};
use tokio::sync::mpsc;
use utoipa::IntoParams;

/// Bytes written at once.
const CHUNK: usize = 64 << 10;

/// Chunks that wait for a slow client at most.
const CHUNKS_AHEAD: usize = 8;

/// The header that carries the sample time beside a CSV file.
pub(crate) const SAMPLE_TIME: HeaderName = HeaderName::from_static("volition-sample-time-s");

/// Columns of equal length.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(rename = "Signals")]
#[allow(dead_code, reason = "documents what is streamed")]
pub(crate) struct SignalsDocument {
    /// Time between samples, in seconds.
    sample_time_s: f64,
    /// Time in seconds, where it was recorded.
    #[serde(skip_serializing_if = "Option::is_none")]
    t: Option<Vec<f64>>,
    /// Command.
    r: Vec<f64>,
    /// Control.
    u: Vec<f64>,
    /// Output.
    y: Vec<f64>,
    /// Disturbance at the plant's input, where it was recorded.
    #[serde(skip_serializing_if = "Option::is_none")]
    d: Option<Vec<f64>>,
}

/// How signals are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Csv,
    Json,
}

/// Header that chooses between CSV and JSON.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "documents a header that is read from the header map")]
pub(crate) struct AcceptSignals {
    /// `text/csv` (the default) or `application/json`, with quality values as in RFC 9110.
    #[param(rename = "Accept", required = false, nullable = false, value_type = Option<String>, example = "text/csv")]
    accept: Option<String>,
}

/// What a recording can be written as, the default first.
const OFFERED: [&str; 2] = ["text/csv", "application/json"];

/// The format that the client likes best.
fn negotiate(headers: &HeaderMap) -> Result<Format, Problem<RequestCode>> {
    match preferred(headers, &OFFERED) {
        Some("application/json") => Ok(Format::Json),
        Some(_) => Ok(Format::Csv),
        None => Err(not_acceptable(headers, &OFFERED)),
    }
}

/// Downloads the recording, bit for bit as uploaded: every number reads back as the same double.
#[utoipa::path(get, path = "/v1/trials/{trial}/signals", tag = "trials", operation_id = "read_signals",
    params(TrialPath, AcceptSignals, IfNoneMatch),
    responses(
        (status = 200,
            description = "The recorded columns. As CSV, the header Volition-Sample-Time-S carries the sample time.",
            content(
                (String = "text/csv", example = "t,r,u,y\r\n0.0,0.0,0.0,0.0\r\n"),
                (SignalsDocument = "application/json"))),
        (status = 406, description = "Neither text/csv nor application/json is acceptable.")))]
pub(crate) async fn read(Named { state, id, headers }: Named<TrialView>) -> ApiResult<Response> {
    let format = negotiate(&headers)?;
    let record = state.store.trial(id).await?;
    let (suffix, media) = match format {
        Format::Csv => ("csv", "text/csv; charset=utf-8; header=present"),
        Format::Json => ("json", "application/json"),
    };
    // The recording never changes, and these bytes are a function of it.
    let tag = ETag::of_name(&format!("{}-{suffix}", &record.sha256));
    if is_known(&headers, &tag) {
        return Ok(not_modified(&tag));
    }
    let trial = state.store.trial_signals(id).await?;
    let name = format!("attachment; filename=\"{id}.{suffix}\"");
    let response_headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static(media)),
        (header::ETAG, tag.value()),
        (header::CACHE_CONTROL, super::etag::NO_CACHE),
        (header::VARY, HeaderValue::from_static("accept")),
        (
            SAMPLE_TIME,
            HeaderValue::from_str(&format!("{:?}", trial.sample_time_s)).unwrap_or(HeaderValue::from_static("")),
        ),
        (header::CONTENT_DISPOSITION, HeaderValue::from_str(&name).unwrap_or(HeaderValue::from_static("attachment"))),
    ];
    Ok((response_headers, stream(trial, format)).into_response())
}

/// The text, written on a blocking thread as fast as the client takes it.
fn stream(trial: Trial, format: Format) -> Body {
    let (sender, mut receiver) = mpsc::channel::<io::Result<Bytes>>(CHUNKS_AHEAD);
    tokio::task::spawn_blocking(move || {
        let mut out = BufWriter::with_capacity(CHUNK, Sender(sender));
        let written = match format {
            Format::Csv => write::csv(&trial, &mut out),
            Format::Json => write::json(&trial, &mut out),
        };
        // The only error is that the client went away.
        let _ = written.and_then(|()| out.flush());
    });
    Body::from_stream(async_stream::stream! {
        while let Some(chunk) = receiver.recv().await {
            yield chunk;
        }
    })
}

struct Sender(mpsc::Sender<io::Result<Bytes>>);

impl Write for Sender {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let chunk = Bytes::copy_from_slice(bytes);
        self.0.blocking_send(Ok(chunk)).map_err(|_| io::ErrorKind::BrokenPipe)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
