//! Uploading trials: one as a file or JSON, many as files of one form.

mod assign;
mod files;
mod keep;
mod preview;

use super::answer::created;
use super::etag;
use super::extract::{
    Encoding, FromQuery, Id, Integer, Params, QueryText, encoding, media_type, off_thread, read_body, unsupported,
};
use super::idempotency::{IDEMPOTENT_REPLAYED, Idempotency, IdempotencyHeader};
use super::problem::{ApiResult, internal};
use super::state::AppState;
use super::studies::saved_of;
use super::subjects::SubjectPath;
use super::trials::{MAX_NUMBER, TrialView};
use crate::analysis::ids::{PlantId, SubjectId};
use crate::analysis::{Code, Problem, Warning};
use crate::exchange::{Options, Resampling, TimeUnit, Understood, options};
use crate::store::{Created, Plant, StudyReading};
use crate::trial::csv::ColumnMapping;
use crate::trial::json::TrialDocument;
use assign::{Wanted, assignments, plants, with_metadata};
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::Response;
use files::File;
use keep::{parse_all, remarks, store};
pub(crate) use preview::{Preview, Wish, preview, sent_files, stand_beside};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use utoipa::IntoParams;

/// What the files do not say themselves.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct UploadQuery {
    /// The plant that the trial was recorded on, of the subject's study. Needed unless a form's `metadata` names one
    /// for each file.
    #[param(nullable = false)]
    pub(crate) plant: Option<PlantId>,
    /// The trial's number; without it, the next free one within the session (the answer says which). Several files of a
    /// form are numbered from here in succession.
    #[param(minimum = 1, maximum = 1000000000, nullable = false)]
    pub(crate) number: Option<i64>,
    /// The session.
    #[param(minimum = 0, maximum = 1000000000, nullable = false)]
    pub(crate) session: Option<i64>,
    /// Time between samples in seconds; needed where there is no time column, checked against it where there is one.
    #[param(exclusive_minimum = 0, nullable = false)]
    pub(crate) sample_time_s: Option<f64>,
    /// Which column or variable is which signal, where they are not named `t,r,u,y,d`: pairs `signal:column` separated
    /// by commas, with the signals `t` (or `time`), `r` (`command`), `u` (`control`), `y` (`output`) and `d`
    /// (`disturbance`), and columns by name, or by position from 1.
    #[param(value_type = Option<String>, nullable = false, example = "r:target,y:cursor")]
    pub(crate) columns: Option<ColumnMapping>,
    /// What the time column counts: `s`, `ms`, `us`, `ns`, or `samples` (then `sample_time_s` is needed). Without it,
    /// what the file says, or seconds.
    #[param(value_type = Option<String>, nullable = false, pattern = "^(s|ms|us|ns|samples)$", example = "ms")]
    pub(crate) time_unit: Option<TimeUnit>,
    /// `linear`: samples that are not evenly spaced are brought to a grid of `sample_time_s` (or the usual step), on
    /// straight lines. It then stands with the trial as a warning. Without it they are refused.
    #[param(value_type = Option<String>, nullable = false, pattern = "^(linear)$", example = "linear")]
    pub(crate) resample: Option<Resampling>,
}

impl UploadQuery {
    /// What is said of the files.
    fn options(&self, saved: &StudyReading) -> Options {
        Options {
            // Checked when it was kept.
            saved: saved_of(saved).unwrap_or_default(),
            columns: self.columns.clone().unwrap_or_default(),
            time_unit: self.time_unit,
            sample_time_s: self.sample_time_s,
            resample: self.resample,
            ..Options::default()
        }
    }
}

impl FromQuery for UploadQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let plant = query.id("plant")?;
        let number = query.integer("number", 1, MAX_NUMBER)?;
        let session = query.integer("session", 0, MAX_NUMBER)?;
        let sample_time_s = query.number("sample_time_s")?;
        if let Some(bad) = sample_time_s.filter(|value| *value <= 0.0) {
            return Err(Problem::new(Code::Malformed, "bad query parameter", format!("the sample time is {bad} s"))
                .at("query parameter sample_time_s")
                .mend("Give a positive number of seconds."));
        }
        let columns = query.take("columns")?.map(|text| columns(&text)).transpose()?;
        let time_unit = one_of(query, "time_unit")?;
        let resample = one_of(query, "resample")?;
        Ok(Self { plant, number, session, sample_time_s, columns, time_unit, resample })
    }
}

fn one_of<T: std::str::FromStr<Err = String>>(query: &mut QueryText, name: &'static str) -> Result<Option<T>, Problem> {
    let Some(text) = query.take(name)? else { return Ok(None) };
    text.parse().map(Some).map_err(|why: String| {
        Problem::new(Code::Malformed, "bad query parameter", why)
            .at(format!("query parameter {name}"))
            .mend("Give one of these.")
    })
}

fn columns(text: &str) -> Result<ColumnMapping, Problem> {
    options::columns(text).map_err(|why| {
        Problem::new(Code::Malformed, "bad query parameter", why)
            .at("query parameter columns")
            .mend("Give pairs such as r:target,y:cursor.")
    })
}

/// One file of a form, in its part `metadata`.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(example = serde_json::json!({"file": "s07_12.csv.gz", "number": 12, "session": 1}))]
pub(crate) struct FileMetadata {
    /// The name of one of the files.
    file: String,
    /// The trial's number; without it, as the query says.
    #[schemars(with = "Option<i64>", range(min = 1, max = 1000000000))]
    number: Option<Integer>,
    /// The session; without it, as the query says.
    #[schemars(with = "Option<i64>", range(min = 0, max = 1000000000))]
    session: Option<Integer>,
    /// The plant; without it, as the query says.
    plant: Option<PlantId>,
}

/// A form with files.
#[derive(Debug, JsonSchema)]
#[allow(dead_code, reason = "documents a form")]
pub(crate) struct UploadForm {
    /// Recordings in any format that is read, packed with gzip or not. Every part with a file name is one, whatever the
    /// part's own name.
    #[schemars(with = "Vec<String>", extend("format" = "binary"))]
    files: Vec<Vec<u8>>,
    /// What the files do not say themselves, file by file; a part of type `application/json`.
    metadata: Option<Vec<FileMetadata>>,
}

/// An uploaded trial.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct UploadedTrial {
    #[serde(flatten)]
    trial: TrialView,
    /// The file that it came from, where it was one of a form.
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<String>,
    /// Whether this subject had a trial with this content already; that one is shown, and nothing was stored.
    duplicate: bool,
    /// Whether the number was chosen by the server.
    number_assigned: bool,
    /// Columns of the file that are no signals, by name.
    ignored_columns: Vec<String>,
    /// What the file was taken for.
    understood: Understood,
    /// What must be read before using the trial.
    warnings: Vec<Warning>,
}

/// The trials of a form, in the order of its files.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub(crate) struct UploadedTrials {
    /// They, in the order of the files.
    items: Vec<UploadedTrial>,
}

/// Media types of recordings. What a file is, its content says: clients name the same file in many ways.
const FILES: [&str; 6] = [
    "text/csv",
    "text/tab-separated-values",
    "text/plain",
    "application/octet-stream",
    "application/zip",
    "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
];

/// What is uploaded, by media type.
enum Kind {
    /// A recording, whose content says what it is.
    File,
    Json,
    Form {
        boundary: String,
    },
}

impl Kind {
    fn of(headers: &HeaderMap) -> ApiResult<Self> {
        match media_type(headers).as_deref() {
            Some("application/json") => Ok(Self::Json),
            Some("multipart/form-data") => {
                let text = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
                Ok(Self::Form { boundary: files::boundary(text)? })
            }
            Some(media) if FILES.contains(&media) => Ok(Self::File),
            _ => {
                let wanted = format!("{}, application/json or multipart/form-data", FILES.join(", "));
                Err(unsupported(headers, &wanted).into())
            }
        }
    }
}

/// Uploads trials: all of a request or none.
///
/// A file is recognised by its content: a table as text (commas, semicolons, tabs, spaces; decimal point or comma;
/// UTF-8, UTF-16 or an encoding of Windows), MATLAB (4 to 7.3), HDF5, NumPy (`.npy`, `.npz`), Excel (`.xlsx`) or JSON.
/// A zip archive of a folder is taken as a form of its files, and tables of Motion-BIDS with the files beside them.
/// Columns are named `t,r,u,y[,d]` or mapped by `columns`; others are left out and reported, and `understood` says what
/// the file was taken for. Sample times are checked against the time column. The same content sent again for the same
/// subject is recognised by its hash and not stored twice. The body may be packed (`Content-Encoding: gzip`).
#[utoipa::path(post, path = "/v1/subjects/{subject}/trials", tag = "trials", operation_id = "upload_trials",
    params(SubjectPath, UploadQuery, IdempotencyHeader),
    request_body(content(
        (String = "text/csv", example = "t,r,u,y\n0.00,0.0,0.0,0.0\n0.02,0.5,0.2,0.1\n0.04,1.0,0.4,0.3\n"),
        (String = "text/tab-separated-values"), (String = "text/plain"), (String = "application/octet-stream"),
        (String = "application/zip"),
        (String = "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet"),
        (TrialDocument = "application/json"), (UploadForm = "multipart/form-data"))),
    responses(
        (status = 201, description = "Stored; Location names a single trial. A form is answered by a list.",
            body = inline(Uploaded)),
        (status = 200, description = "All of the content was stored before; nothing was stored now.",
            body = inline(Uploaded)),
        (status = 409, description = "The number is taken by another trial of the session.")))]
pub(crate) async fn upload(
    State(state): State<AppState>,
    Id(subject): Id<SubjectId>,
    Params(query): Params<UploadQuery>,
    idempotency: Idempotency,
    headers: HeaderMap,
    body: Body,
) -> ApiResult<Response> {
    let kind = Kind::of(&headers)?;
    let packing = encoding(&headers)?;
    let subject = state.store.subject(subject).await?;
    // Bounds the memory that bodies and parsed trials take together.
    let _permit = state.uploads.clone().acquire_owned().await.map_err(|_| internal())?;
    let bytes = read_body(&state, &headers, body).await?;
    let key = idempotency.key(&bytes);

    let (files, is_form) = unpacked(&state, kind, packing, bytes).await?;
    let (files, metadata) = with_metadata(files)?;
    let wanted = assignments(&files, metadata, &query)?;
    let plants = plants(&state, &subject, &wanted).await?;
    let reading = state.store.study(subject.study).await?.reading;
    let limits = state.limits;
    let with_plants: Vec<(Wanted, Arc<Plant>)> = wanted.iter().map(|w| (w.clone(), plants[&w.plant].clone())).collect();
    let (new, said) = off_thread(move || parse_all(files, &with_plants, &limits, &query.options(&reading))).await??;

    let (numbers, outcome) = store(&state, &subject, &wanted, new, key.as_ref()).await?;
    let mut items = Vec::with_capacity(outcome.len());
    for (((made, said), number), wanted) in outcome.iter().zip(said).zip(numbers).zip(&wanted) {
        let record = made.clone().into_inner();
        let mut warnings = said.warnings;
        warnings.extend(remarks(&state, &subject, made, &record, wanted, number).await?);
        items.push(UploadedTrial {
            number_assigned: wanted.number.is_none() && !matches!(made, Created::Duplicate(_)),
            duplicate: matches!(made, Created::Duplicate(_)),
            trial: TrialView::from(record),
            file: said.name,
            ignored_columns: said.ignored_columns,
            understood: said.understood,
            warnings,
        });
    }
    let status = if outcome.iter().all(|made| matches!(made, Created::Duplicate(_))) {
        StatusCode::OK
    } else {
        StatusCode::CREATED
    };
    let replayed = outcome.iter().any(|made| matches!(made, Created::Replayed(_)));
    let mut response = if is_form {
        etag::tagged(status, &UploadedTrials { items })?
    } else {
        let item = items.into_iter().next().ok_or_else(internal)?;
        let location = format!("/v1/trials/{}", item.trial.id);
        created(etag::tagged(status, &item)?, location)
    };
    // The body also says what was done, so it is no representation that could be revalidated.
    response.headers_mut().remove(header::ETAG);
    if replayed {
        response.headers_mut().insert(IDEMPOTENT_REPLAYED, HeaderValue::from_static("true"));
    }
    Ok(response)
}

/// One trial, or the trials of a form.
#[derive(Debug, JsonSchema)]
#[serde(untagged)]
#[allow(dead_code, clippy::large_enum_variant, reason = "documents the two forms of the answer")]
pub(crate) enum Uploaded {
    /// Of CSV or JSON.
    One(UploadedTrial),
    /// Of a form.
    Many(UploadedTrials),
}

/// The files of a request, in memory and as they came, but for a packed form and an archived folder; and whether they
/// are answered by a list.
async fn unpacked(state: &AppState, kind: Kind, packing: Encoding, bytes: Vec<u8>) -> ApiResult<(Vec<File>, bool)> {
    let gzip = packing == Encoding::Gzip;
    match kind {
        Kind::File => {
            let limits = state.limits;
            Ok(off_thread(move || files::of_body(bytes, gzip, &limits)).await??)
        }
        Kind::Json => Ok((vec![File { name: None, gzip, json: true, bytes: bytes.into(), sidecar: None }], false)),
        Kind::Form { boundary } => {
            let limits = state.limits;
            let bytes = if gzip {
                off_thread(move || files::unpack(&bytes, limits.max_decompressed_bytes)).await??
            } else {
                bytes
            };
            let files = files::of_form(bytes.into(), &boundary, &limits).await?;
            Ok((files::with_sidecars(files)?, true))
        }
    }
}
