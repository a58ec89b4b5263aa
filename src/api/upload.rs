//! Uploading trials: one as CSV or JSON, many as files of one form.

use super::etag;
use super::extract::{
    Encoding, FromQuery, Id, Integer, Params, QueryText, encoding, from_json, from_value, media_type, off_thread,
    read_body, unsupported,
};
use super::files::{self, File, Read};
use super::idempotency::{IDEMPOTENT_REPLAYED, Idempotency, IdempotencyHeader};
use super::problem::{ApiError, ApiResult};
use super::state::AppState;
use super::subjects::SubjectPath;
use super::trials::{MAX_NUMBER, TrialView, in_range};
use crate::analysis::ids::{PlantId, SubjectId};
use crate::analysis::report::hexadecimal;
use crate::analysis::{Code, Problem, Warning};
use crate::learning::time_domain;
use crate::store::{Created, NewTrial, Plant, StoreError, Subject, TrialFilter, TrialRecord};
use crate::trial::csv::ColumnMapping;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::Response;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use utoipa::{IntoParams, ToSchema};

/// How often numbers are chosen anew when another process takes them at the same time.
const NUMBERING_ATTEMPTS: usize = 5;

/// What the files do not say themselves.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct UploadQuery {
    /// The plant that the trial was recorded on, of the subject's study. Needed unless a form's `metadata` names one for
    /// each file.
    #[param(nullable = false)]
    pub plant: Option<PlantId>,
    /// The trial's number; without it, the next free one within the session (the answer says which). Several files of a
    /// form are numbered from here in succession.
    #[param(minimum = 1, maximum = 1000000000, nullable = false)]
    pub number: Option<i64>,
    /// The session.
    #[param(minimum = 0, maximum = 1000000000, nullable = false)]
    pub session: Option<i64>,
    /// Time between samples in seconds; needed where there is no time column, checked against it where there is one.
    #[param(exclusive_minimum = 0, nullable = false)]
    pub sample_time_s: Option<f64>,
    /// Names of CSV columns where they are not `t,r,u,y,d`: pairs `signal:column` separated by commas, with the signals
    /// `time`, `command`, `control`, `output`, `disturbance`.
    #[param(value_type = Option<String>, nullable = false, example = "command:target,output:cursor")]
    pub columns: Option<ColumnMapping>,
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
        Ok(Self { plant, number, session, sample_time_s, columns })
    }
}

fn columns(text: &str) -> Result<ColumnMapping, Problem> {
    let bad = |why: String| {
        Problem::new(Code::Malformed, "bad query parameter", why)
            .at("query parameter columns")
            .mend("Give pairs such as command:target,output:cursor.")
    };
    let mut mapping = ColumnMapping::default();
    for pair in text.split(',') {
        let Some((signal, column)) = pair.split_once(':') else {
            return Err(bad(format!("'{pair}' is no pair signal:column")));
        };
        let place = match signal.trim() {
            "time" | "t" => &mut mapping.time,
            "command" | "r" => &mut mapping.command,
            "control" | "u" => &mut mapping.control,
            "output" | "y" => &mut mapping.output,
            "disturbance" | "d" => &mut mapping.disturbance,
            other => {
                return Err(bad(format!(
                    "there is no signal '{other}'; there are time, command, control, output and disturbance"
                )));
            }
        };
        if column.trim().is_empty() {
            return Err(bad(format!("the signal '{}' is given no column", signal.trim())));
        }
        if place.replace(column.trim().to_owned()).is_some() {
            return Err(bad(format!("the signal '{}' is given twice", signal.trim())));
        }
    }
    Ok(mapping)
}

/// One file of a form, in its part `metadata`.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"file": "s07_12.csv.gz", "number": 12, "session": 1}))]
pub struct FileMetadata {
    /// The name of one of the files.
    file: String,
    /// The trial's number; without it, as the query says.
    #[schema(value_type = Option<i64>, minimum = 1, maximum = 1000000000)]
    number: Option<Integer>,
    /// The session; without it, as the query says.
    #[schema(value_type = Option<i64>, minimum = 0, maximum = 1000000000)]
    session: Option<Integer>,
    /// The plant; without it, as the query says.
    plant: Option<PlantId>,
}

/// A form with files.
#[derive(Debug, ToSchema)]
#[allow(dead_code, reason = "documents a form")]
pub struct UploadForm {
    /// CSV files, or CSV files packed with gzip (their names end in `.gz`). Every part with a file name is one, whatever
    /// the part's own name.
    #[schema(value_type = Vec<String>, format = Binary)]
    files: Vec<Vec<u8>>,
    /// What the files do not say themselves, file by file; a part of type `application/json`.
    #[schema(nullable = false)]
    metadata: Option<Vec<FileMetadata>>,
}

/// A recording as JSON.
#[derive(Debug, ToSchema)]
#[schema(as = NewTrial, example = json!({"sample_time_s": 0.02, "r": [0.0, 0.5, 1.0], "u": [0.0, 0.2, 0.4], "y": [0.0, 0.1, 0.3]}))]
#[allow(dead_code, reason = "documents what the trial reader takes")]
pub struct NewTrialBody {
    /// Time between samples, in seconds; may be left out where there is `t`.
    #[schema(exclusive_minimum = 0)]
    sample_time_s: Option<f64>,
    /// Time in seconds.
    t: Option<Vec<f64>>,
    /// Command.
    r: Vec<f64>,
    /// Control.
    u: Vec<f64>,
    /// Output.
    y: Vec<f64>,
    /// Disturbance at the plant's input.
    d: Option<Vec<f64>>,
}

/// An uploaded trial.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct UploadedTrial {
    #[serde(flatten)]
    trial: TrialView,
    /// The file that it came from, where it was one of a form.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    file: Option<String>,
    /// Whether this subject had a trial with this content already; that one is shown, and nothing was stored.
    duplicate: bool,
    /// Whether the number was chosen by the server.
    number_assigned: bool,
    /// Columns of the file that are no signals, by name.
    ignored_columns: Vec<String>,
    /// What must be read before using the trial.
    warnings: Vec<Warning>,
}

/// The trials of a form, in the order of its files.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct UploadedTrials {
    items: Vec<UploadedTrial>,
}

/// What is uploaded, by media type.
enum Kind {
    Csv,
    Json,
    Form { boundary: String },
}

impl Kind {
    fn of(headers: &HeaderMap) -> Result<Self, Problem> {
        match media_type(headers).as_deref() {
            Some("text/csv") => Ok(Self::Csv),
            Some("application/json") => Ok(Self::Json),
            Some("multipart/form-data") => {
                let text = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
                files::boundary(text).map(|boundary| Self::Form { boundary })
            }
            _ => Err(unsupported(headers, "text/csv, application/json or multipart/form-data")),
        }
    }
}

/// Uploads trials: all of a request or none.
///
/// CSV has a header row that names the columns `t,r,u,y[,d]`; other columns are left out and reported. Sample times are
/// checked against the time column. The same content sent again for the same subject is recognised by its hash and not
/// stored twice. The body may be packed (`Content-Encoding: gzip`).
#[utoipa::path(post, path = "/v1/subjects/{subject}/trials", tag = "trials", operation_id = "upload_trials",
    params(SubjectPath, UploadQuery, IdempotencyHeader),
    request_body(content(
        (String = "text/csv", example = "t,r,u,y\n0.00,0.0,0.0,0.0\n0.02,0.5,0.2,0.1\n0.04,1.0,0.4,0.3\n"),
        (NewTrialBody = "application/json"), (UploadForm = "multipart/form-data"))),
    responses(
        (status = 201, description = "Stored; Location names a single trial. A form is answered by a list.",
            body = inline(Uploaded)),
        (status = 200, description = "All of the content was stored before; nothing was stored now.", body = inline(Uploaded)),
        (status = 409, description = "The number is taken by another trial of the session.")))]
pub async fn upload(
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
    let _permit = state.uploads.clone().acquire_owned().await.map_err(|_| super::problem::internal())?;
    let bytes = read_body(&state, &headers, body).await?;
    let key = idempotency.key(&bytes);

    let is_form = matches!(kind, Kind::Form { .. });
    let files = unpacked(&state, kind, packing, bytes).await?;
    let (files, metadata) = with_metadata(files)?;
    let wanted = assignments(&files, metadata, &query)?;
    let plants = plants(&state, &subject, &wanted).await?;
    let read = {
        let (limits, query) = (state.limits, query.clone());
        let models: Vec<Arc<Plant>> = wanted.iter().map(|w| plants[&w.plant].clone()).collect();
        off_thread(move || parse_all(files, &models, &limits, &query)).await??
    };

    let (numbers, outcome) = store(&state, &subject, &wanted, &read, key.as_ref()).await?;
    let mut items = Vec::with_capacity(outcome.len());
    for (((made, read), number), wanted) in outcome.iter().zip(read).zip(numbers).zip(&wanted) {
        let record = made.clone().into_inner();
        let mut warnings = read.warnings;
        warnings.extend(remarks(&state, &subject, made, &record, wanted, number).await?);
        items.push(UploadedTrial {
            number_assigned: wanted.number.is_none() && !matches!(made, Created::Duplicate(_)),
            duplicate: matches!(made, Created::Duplicate(_)),
            trial: TrialView::from(record),
            file: read.name,
            ignored_columns: read.ignored_columns,
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
        let item = items.into_iter().next().ok_or_else(super::problem::internal)?;
        let location = format!("/v1/trials/{}", item.trial.id);
        super::created(etag::tagged(status, &item)?, location)
    };
    // The body also says what was done, so it is no representation that could be revalidated.
    response.headers_mut().remove(header::ETAG);
    if replayed {
        response.headers_mut().insert(IDEMPOTENT_REPLAYED, HeaderValue::from_static("true"));
    }
    Ok(response)
}

/// One trial, or the trials of a form.
#[derive(Debug, ToSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "documents the two forms of the answer")]
pub enum Uploaded {
    /// Of CSV or JSON.
    One(UploadedTrial),
    /// Of a form.
    Many(UploadedTrials),
}

/// The files of a request, in memory and as they came, but for a packed form.
async fn unpacked(state: &AppState, kind: Kind, packing: Encoding, bytes: Vec<u8>) -> ApiResult<Vec<File>> {
    let gzip = packing == Encoding::Gzip;
    match kind {
        Kind::Csv => Ok(vec![File { name: None, gzip, json: false, bytes: bytes.into() }]),
        Kind::Json => Ok(vec![File { name: None, gzip, json: true, bytes: bytes.into() }]),
        Kind::Form { boundary } => {
            let limits = state.limits;
            let bytes = if gzip {
                off_thread(move || files::unpack(&bytes, limits.max_decompressed_bytes)).await??
            } else {
                bytes
            };
            files::of_form(bytes.into(), &boundary, &limits).await
        }
    }
}

/// Parts the metadata from the files proper.
fn with_metadata(mut files: Vec<File>) -> Result<(Vec<File>, Vec<FileMetadata>), Problem> {
    let Some(at) = files.iter().position(|file| file.is_metadata()) else { return Ok((files, Vec::new())) };
    let part = files.remove(at);
    let within = |problem: Problem| {
        let place = format!("part metadata, {}", problem.location.clone().unwrap_or_default());
        problem.at(place)
    };
    let entries: Vec<serde_json::Value> = from_json(&part.bytes).map_err(within)?;
    let metadata = entries
        .iter()
        .enumerate()
        .map(|(i, entry)| from_value(entry, &format!("/{i}")).map_err(within))
        .collect::<Result<_, _>>()?;
    Ok((files, metadata))
}

/// What is known of a trial besides its recording.
#[derive(Debug, Clone)]
struct Wanted {
    plant: PlantId,
    /// Where the plant was named.
    plant_at: String,
    number: Option<i64>,
    session: Option<i64>,
}

fn assignments(files: &[File], metadata: Vec<FileMetadata>, query: &UploadQuery) -> Result<Vec<Wanted>, Problem> {
    let mut by_file: BTreeMap<String, (usize, FileMetadata)> = BTreeMap::new();
    for (i, entry) in metadata.into_iter().enumerate() {
        let bad = |field: &str, why: String| {
            Problem::new(Code::Invalid, "bad metadata", why).at(format!("part metadata, /{i}/{field}"))
        };
        if !files.iter().any(|file| file.name.as_deref() == Some(&entry.file)) {
            return Err(bad("file", format!("the form has no file named '{}'", entry.file)));
        }
        if let Some(Integer(number)) = entry.number {
            in_range(number, 1, &format!("part metadata, /{i}/number"))?;
        }
        if let Some(Integer(session)) = entry.session {
            in_range(session, 0, &format!("part metadata, /{i}/session"))?;
        }
        let file = entry.file.clone();
        if by_file.insert(file, (i, entry)).is_some() {
            return Err(bad("file", "the file has an entry already".to_owned()));
        }
    }
    let mut succession = query.number;
    let mut wanted = Vec::with_capacity(files.len());
    for file in files {
        let entry = file.name.as_ref().and_then(|name| by_file.get(name));
        let own = entry.map(|(_, entry)| entry);
        let number = own.and_then(|entry| entry.number).map(|Integer(n)| n).or_else(|| {
            let number = succession?;
            succession = Some(number + 1);
            Some(number)
        });
        let (plant, plant_at) = match (entry, query.plant) {
            (Some((i, FileMetadata { plant: Some(plant), .. })), _) => (*plant, format!("part metadata, /{i}/plant")),
            (_, Some(plant)) => (plant, "query parameter plant".to_owned()),
            (_, None) => {
                return Err(Problem::new(
                    Code::Malformed,
                    "no plant",
                    match &file.name {
                        Some(name) => format!("no plant is given for the file '{name}'"),
                        None => "no plant is given".to_owned(),
                    },
                )
                .at("query parameter plant")
                .mend("Give ?plant=ID, the plant that the trial was recorded on."));
            }
        };
        let session = own.and_then(|entry| entry.session).map(|Integer(s)| s).or(query.session);
        wanted.push(Wanted { plant, plant_at, number, session });
    }
    Ok(wanted)
}

/// The plants named, each of the subject's study and with one input and one output.
async fn plants(state: &AppState, subject: &Subject, wanted: &[Wanted]) -> ApiResult<BTreeMap<PlantId, Arc<Plant>>> {
    let mut plants = BTreeMap::new();
    for Wanted { plant: id, plant_at, .. } in wanted {
        if plants.contains_key(id) {
            continue;
        }
        let bad = |why: String| Problem::new(Code::Invalid, "no such plant in the study", why).at(plant_at.clone());
        let plant = match state.store.plant(*id).await {
            Ok(plant) => plant,
            Err(StoreError::NotFound { .. }) => return Err(bad(format!("there is no plant {id}")).into()),
            Err(other) => return Err(other.into()),
        };
        if plant.study != subject.study {
            return Err(bad(format!("the plant {id} is of another study than the subject")).into());
        }
        if let Err(error) = plant.model.check() {
            return Err(Problem::new(Code::Invalid, "not a plant of one input and one output", error.to_string())
                .at(plant_at.clone())
                .into());
        }
        plants.insert(*id, Arc::new(plant));
    }
    Ok(plants)
}

/// A file that was read, with what was measured.
struct Parsed {
    name: Option<String>,
    trial: crate::trial::Trial,
    sha256: String,
    metrics: serde_json::Value,
    max_abs_output: f64,
    ignored_columns: Vec<String>,
    warnings: Vec<Warning>,
}

fn parse_all(
    files: Vec<File>,
    plants: &[Arc<Plant>],
    limits: &super::state::Limits,
    query: &UploadQuery,
) -> Result<Vec<Parsed>, Problem> {
    let mut budget = files::Budget::new(limits);
    let mut parsed = Vec::with_capacity(files.len());
    for (file, plant) in files.into_iter().zip(plants) {
        let columns = query.columns.clone().unwrap_or_default();
        let Read { trial, ignored_columns } = file.read(&mut budget, columns, query.sample_time_s)?;
        let measured = time_domain::metrics(&trial, &plant.model);
        let metrics = serde_json::to_value(&measured).map_err(|error| {
            tracing::error!(%error, "metrics could not be written");
            super::problem::internal()
        })?;
        let mut warnings = Vec::new();
        if let Some(period) = plant.model.sample_time_s()
            && (period - trial.sample_time_s).abs() > 1e-9 * period
        {
            warnings.push(Warning::new(
                "sample_time_differs",
                format!(
                    "the trial's sample time is {} s, that of its plant '{}' is {period} s",
                    trial.sample_time_s, plant.name
                ),
            ));
        }
        parsed.push(Parsed {
            name: file.name,
            sha256: hexadecimal(&trial.content_sha256()),
            max_abs_output: measured.max_abs_output,
            trial,
            metrics,
            ignored_columns,
            warnings,
        });
    }
    Ok(parsed)
}

/// Stores the trials; where numbers were left to the server and another process took them meanwhile, with others.
async fn store(
    state: &AppState,
    subject: &Subject,
    wanted: &[Wanted],
    parsed: &[Parsed],
    key: Option<&crate::store::IdempotencyKey>,
) -> ApiResult<(Vec<i64>, Vec<Created<TrialRecord>>)> {
    let assigned = wanted.iter().any(|w| w.number.is_none());
    let _alone = if assigned { Some(state.numbering.lock().await) } else { None };
    for attempt in 1.. {
        let numbers = numbers(state, subject, wanted, parsed).await?;
        let new = wanted
            .iter()
            .zip(parsed)
            .zip(&numbers)
            .map(|((wanted, parsed), number)| NewTrial {
                plant: wanted.plant,
                number: *number,
                session: wanted.session,
                trial: parsed.trial.clone(),
                sha256: parsed.sha256.clone(),
                max_abs_output: parsed.max_abs_output,
                metrics: parsed.metrics.clone(),
            })
            .collect();
        match state.store.create_trials(subject.id, new, key).await {
            Ok(outcome) => return Ok((numbers, outcome)),
            Err(StoreError::Conflict { rule: "trial_number_taken", .. })
                if assigned && attempt < NUMBERING_ATTEMPTS => {}
            Err(StoreError::Conflict { rule: rule @ "trial_number_taken", detail }) => {
                let problem = Problem::new(Code::Conflict, rule.replace('_', " "), detail)
                    .at("query parameter number")
                    .mend("Give another number or session, or none for the next free one.");
                return Err(problem.into());
            }
            Err(error) => return Err(error.into()),
        }
    }
    Err(ApiError::from(super::problem::internal()))
}

/// The numbers asked for; for the others the next free ones of the session, leaving out content that is stored already.
async fn numbers(state: &AppState, subject: &Subject, wanted: &[Wanted], parsed: &[Parsed]) -> ApiResult<Vec<i64>> {
    let mut stored = Vec::new();
    if wanted.iter().any(|w| w.number.is_none()) {
        let filter = TrialFilter { subject: Some(subject.id), include_divergent: true, ..TrialFilter::default() };
        stored = state.store.matching_trials(subject.study, &filter).await?;
    }
    let mut known: BTreeSet<&str> = stored.iter().map(|trial| trial.sha256.as_str()).collect();
    let mut last: BTreeMap<Option<i64>, i64> = BTreeMap::new();
    let taken = stored.iter().map(|trial| (trial.session, trial.number));
    let asked = wanted.iter().filter_map(|w| Some((w.session, w.number?)));
    for (session, number) in taken.chain(asked) {
        let last = last.entry(session).or_insert(0);
        *last = number.max(*last);
    }
    let mut numbers = Vec::with_capacity(wanted.len());
    for (wanted, parsed) in wanted.iter().zip(parsed) {
        let is_new = known.insert(&parsed.sha256);
        numbers.push(match wanted.number {
            Some(number) => number,
            None => {
                let last = last.entry(wanted.session).or_insert(0);
                *last += i64::from(is_new);
                (*last).max(1)
            }
        });
    }
    Ok(numbers)
}

/// What a scientist must know about a trial that was just stored, or not.
async fn remarks(
    state: &AppState,
    subject: &Subject,
    made: &Created<TrialRecord>,
    record: &TrialRecord,
    wanted: &Wanted,
    number: i64,
) -> ApiResult<Vec<Warning>> {
    let mut warnings = Vec::new();
    if matches!(made, Created::Duplicate(_)) {
        let mut message = format!("this recording is stored already as trial {}", record.number);
        if let Some(session) = record.session {
            message.push_str(&format!(" of session {session}"));
        }
        if wanted.number.is_some_and(|_| number != record.number)
            || (wanted.session.is_some() && wanted.session != record.session)
            || wanted.plant != record.plant
        {
            message.push_str("; the number, session or plant given now differ from it and were not used");
        }
        warnings.push(Warning::new("duplicate_content", message));
    } else if wanted.number.is_none() {
        warnings.push(Warning::new(
            "number_assigned",
            format!("no number was given; the next free one, {}, was taken", record.number),
        ));
    }
    let others = state.store.same_content(subject.study, &record.sha256, subject.id).await?;
    if !others.is_empty() {
        let named: Vec<String> =
            others.iter().take(5).map(|trial| format!("{} of subject {}", trial.id, trial.subject)).collect();
        warnings.push(Warning::new(
            "content_of_another_subject",
            format!("the same recording is stored for other subjects too: trial {}", named.join(", trial ")),
        ));
    }
    if record.divergent {
        warnings.push(Warning::new(
            "divergent",
            format!(
                "|y| reaches {}, beyond the study's display limit: the trial is kept, and left out of learning curves",
                record.max_abs_output
            ),
        ));
    }
    Ok(warnings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn column_names_are_read_pair_by_pair() {
        let mapping = columns("command:target, y:cursor:px").unwrap();
        assert_eq!(mapping.command.as_deref(), Some("target"));
        assert_eq!(mapping.output.as_deref(), Some("cursor:px"));
        for bad in ["", "command", "speed:v", "command:", "r:a,command:b"] {
            assert_eq!(columns(bad).unwrap_err().location.as_deref(), Some("query parameter columns"), "{bad}");
        }
    }
}
