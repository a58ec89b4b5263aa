//! A trial's recording, bit for bit as it was uploaded.

use super::etag::{ETag, IfNoneMatch, is_known, not_modified};
use super::extract::{Id, Params};
use super::forms::{AcceptForm, Form, FormQuery};
use super::problem::ApiResult;
use super::sequences::{self, WaveQuery};
use super::state::AppState;
use super::trials::TrialPath;
use crate::analysis::ids::TrialId;
use crate::exchange::write::Sequence;
use crate::trial::{Channel, Trial, write};
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::Serialize;
use std::io::{self, BufWriter, Write};
use tokio::sync::mpsc;

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

/// The forms of a recording.
const FORMS: &[Form] = &[Form::Csv, Form::Json, Form::Mat, Form::Npz, Form::Wav];

/// Downloads the recording, bit for bit as uploaded: every number reads back as the same double.
///
/// CSV, JSON, MATLAB and NumPy have every recorded column. Sound has one, the command unless another is named, in
/// single precision, divided by what a sample of 1 stands for, which is said in the file and in Volition-Full-Scale.
#[utoipa::path(get, path = "/v1/trials/{trial}/signals", tag = "trials", operation_id = "read_signals",
    params(TrialPath, FormQuery, WaveQuery, AcceptForm, IfNoneMatch),
    responses(
        (status = 200,
            description = "The recorded columns. As CSV, the header Volition-Sample-Time-S carries the sample time.",
            content(
                (String = "text/csv", example = "t,r,u,y\r\n0.0,0.0,0.0,0.0\r\n"),
                (SignalsDocument = "application/json"), (String = "application/x-matlab-data"),
                (String = "application/x-npz"), (String = "audio/wav"))),
        (status = 406, description = "None of the forms is acceptable."),
        (status = 422, description = "The recording is no sound: no such column, a rate that is no whole number, or a \
            sample above full scale.")))]
pub(crate) async fn read(
    State(state): State<AppState>,
    Id(id): Id<TrialId>,
    Params((form, wave)): Params<(FormQuery, WaveQuery)>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let form = form.choose(&headers, FORMS)?;
    let record = state.store.trial(id).await?;
    if !matches!(form, Form::Csv | Form::Json) {
        let trial = state.store.trial_signals(id).await?;
        let wave = wave.or_column(Channel::Command.letter());
        return sequences::answer(&headers, form, &id.to_string(), Sequence::of_trial(&trial), wave).await;
    }
    // The recording never changes, and these bytes are a function of it.
    let tag = ETag::of_name(&format!("{}-{}", &record.sha256, form.name()));
    if is_known(&headers, &tag) {
        return Ok(not_modified(&tag));
    }
    let trial = state.store.trial_signals(id).await?;
    let name = format!("attachment; filename=\"{id}.{}\"", form.name());
    let response_headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static(form.media_type())),
        (header::ETAG, tag.value()),
        (header::CACHE_CONTROL, super::etag::NO_CACHE),
        (header::VARY, HeaderValue::from_static("accept")),
        (
            SAMPLE_TIME,
            HeaderValue::from_str(&format!("{:?}", trial.sample_time_s)).unwrap_or(HeaderValue::from_static("")),
        ),
        (header::CONTENT_DISPOSITION, HeaderValue::from_str(&name).unwrap_or(HeaderValue::from_static("attachment"))),
    ];
    Ok((response_headers, stream(trial, form)).into_response())
}

/// The text, written on a blocking thread as fast as the client takes it.
fn stream(trial: Trial, form: Form) -> Body {
    let (sender, mut receiver) = mpsc::channel::<io::Result<Bytes>>(CHUNKS_AHEAD);
    tokio::task::spawn_blocking(move || {
        let mut out = BufWriter::with_capacity(CHUNK, Sender(sender));
        let written = match form {
            Form::Json => write::json(&trial, &mut out),
            _ => write::csv(&trial, &mut out),
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
