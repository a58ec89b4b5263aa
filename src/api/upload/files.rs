//! Files as they are uploaded, and how they become trials.

use crate::analysis::{Code, Problem};
use crate::api::extract::shortened;
use crate::api::problem::ApiResult;
use crate::api::state::Limits;
use crate::exchange::bids::{self, Sidecar};
use crate::exchange::{self, Options, Reading, archive};
use crate::trial::ReadError;
use crate::trial::gzip::GzipReader;
use axum::body::{Body, Bytes};
use axum::extract::{DefaultBodyLimit, FromRequest, Multipart, Request};
use axum::http::header;
use std::io::Read as _;

/// Rows of all files of one upload together, in multiples of the rows that one may have.
const FULL_FILES: usize = 4;

/// The name of the part that says what the files do not.
const METADATA: &str = "metadata";

/// A file in memory.
#[derive(Debug, Clone)]
pub(super) struct File {
    /// Its name, where it came in a form.
    pub(crate) name: Option<String>,
    /// Whether it is packed.
    pub(crate) gzip: bool,
    /// Whether it is said to be JSON; else its content says what it is.
    pub(crate) json: bool,
    /// Its bytes as they came.
    pub(crate) bytes: Bytes,
    /// What stands in files beside it.
    pub(crate) sidecar: Option<Sidecar>,
}

/// What the files of one upload may still take.
pub(super) struct Budget {
    limits: Limits,
    bytes: u64,
    rows: usize,
}

impl Budget {
    pub(super) fn new(limits: &Limits) -> Self {
        Self { limits: *limits, bytes: limits.max_decompressed_bytes, rows: limits.max_rows.saturating_mul(FULL_FILES) }
    }
}

impl File {
    /// Whether this is the part that describes the others.
    pub(super) fn is_metadata(&self) -> bool {
        self.json && self.name.as_deref() == Some(METADATA)
    }

    /// Reads the trial within what is left of the budget.
    pub(super) fn read(&self, budget: &mut Budget, options: &Options) -> Result<Reading, Problem> {
        let max_rows = budget.limits.max_rows.min(budget.rows);
        let limits = crate::trial::Limits { max_rows, max_bytes: budget.bytes };
        let options = Options { limits, sidecar: self.sidecar.clone(), ..options.clone() };
        let read = if self.json {
            exchange::read_document(&self.bytes, self.gzip, &options)
        } else if self.gzip {
            exchange::read_packed(&self.bytes, &options)
        } else {
            exchange::read(&self.bytes, &options)
        };
        let reading = read.map_err(|problem| self.placed(problem))?;
        budget.bytes = budget.bytes.saturating_sub(reading.bytes);
        budget.rows = budget.rows.saturating_sub(reading.trial.samples());
        Ok(reading)
    }

    /// With the file's name, or the parameter that it is about.
    fn placed(&self, problem: Problem) -> Problem {
        const PARAMETERS: [&str; 4] = ["columns", "time_unit", "sample_time_s", "resample"];
        if let Some(name) = PARAMETERS.into_iter().find(|name| problem.location.as_deref() == Some(name)) {
            return problem.at(format!("query parameter {name}"));
        }
        let Some(name) = &self.name else { return problem };
        let place = match &problem.location {
            None => format!("file '{}'", shortened(name)),
            Some(place) => format!("file '{}', {place}", shortened(name)),
        };
        problem.at(place)
    }
}

/// The files of a body that is no form: itself, or the files of an archived folder; and whether it is such.
pub(super) fn of_body(bytes: Vec<u8>, gzip: bool, limits: &Limits) -> Result<(Vec<File>, bool), Problem> {
    if gzip || !archive::is_folder(&bytes) {
        let file = File { name: None, gzip, json: false, bytes: bytes.into(), sidecar: None };
        return Ok((vec![file], false));
    }
    let files = archive::folder(&bytes, limits.max_decompressed_bytes)?;
    let one = |(name, bytes): (String, Vec<u8>)| File {
        name: Some(name),
        gzip: false,
        json: false,
        bytes: bytes.into(),
        sidecar: None,
    };
    let files = with_sidecars(files.into_iter().map(one).collect())?;
    if files.len() > limits.max_multipart_files {
        let detail = format!("the archive has more than {} files", limits.max_multipart_files);
        return Err(Problem::new(Code::TooLarge, "too many files", detail)
            .at("body")
            .mend("Send the files in several requests."));
    }
    Ok((files, true))
}

/// Where there are tables of Motion-BIDS, they alone, each with what stands beside it; else all files.
pub(super) fn with_sidecars(files: Vec<File>) -> Result<Vec<File>, Problem> {
    let companions = |file: &File| file.name.as_deref().and_then(bids::companions);
    if !files.iter().any(|file| companions(file).is_some()) {
        return Ok(files);
    }
    let mut tables = Vec::new();
    for file in &files {
        if file.is_metadata() {
            tables.push(file.clone());
        }
        if companions(file).is_some() {
            tables.push(File { sidecar: sidecar_of(file, &files)?, ..file.clone() });
        }
    }
    Ok(tables)
}

/// What stands beside a table of Motion-BIDS.
pub(super) fn sidecar_of(file: &File, all: &[File]) -> Result<Option<Sidecar>, Problem> {
    let find = |name: &str| all.iter().find(|file| file.name.as_deref() == Some(name)).map(|file| file.bytes.clone());
    let Some([channels, description]) = file.name.as_deref().and_then(bids::companions) else { return Ok(None) };
    let Some(bytes) = find(&channels) else { return Ok(None) };
    let beside = find(&description);
    let description = beside.as_ref().map(|bytes| (description.as_str(), &bytes[..]));
    Ok(Some(bids::sidecar((&channels, &bytes), description)?))
}

/// Unpacks gzip in memory, up to a limit.
pub(super) fn unpack(packed: &[u8], max_bytes: u64) -> Result<Vec<u8>, Problem> {
    let mut bytes = Vec::new();
    let mut source = GzipReader::new(packed).take(max_bytes.saturating_add(1));
    source.read_to_end(&mut bytes).map_err(|error| Problem::from(ReadError::from(error)))?;
    if bytes.len() as u64 > max_bytes {
        return Err(ReadError::TooManyBytes { limit: max_bytes }.into());
    }
    Ok(bytes)
}

/// The boundary of a form, from its media type.
pub(super) fn boundary(content_type: &str) -> Result<String, Problem> {
    let found = content_type.split(';').skip(1).find_map(|parameter| {
        let (name, value) = parameter.split_once('=')?;
        name.trim().eq_ignore_ascii_case("boundary").then(|| value.trim().trim_matches('"').to_owned())
    });
    match found {
        Some(boundary) if (1..=70).contains(&boundary.len()) => Ok(boundary),
        _ => Err(Problem::new(Code::Malformed, "no boundary", "the form's media type names no boundary")
            .at("header Content-Type")
            .mend("Let the HTTP client write the Content-Type of forms.")),
    }
}

/// The files of a form, its metadata among them.
pub(super) async fn of_form(bytes: Bytes, boundary: &str, limits: &Limits) -> ApiResult<Vec<File>> {
    let mut request = Request::builder()
        .header(header::CONTENT_TYPE, format!("multipart/form-data; boundary=\"{boundary}\""))
        .body(Body::from(bytes))
        .map_err(|error| malformed(&error.to_string()))?;
    // The bytes are in memory and within the limits already.
    DefaultBodyLimit::disable().apply(&mut request);
    let mut form = Multipart::from_request(request, &()).await.map_err(|error| malformed(&error.body_text()))?;
    let mut files: Vec<File> = Vec::new();
    while let Some(field) = form.next_field().await.map_err(|error| malformed(&error.body_text()))? {
        let part = field.name().unwrap_or_default().to_owned();
        let named = field.file_name().map(str::to_owned);
        let is_metadata = part == METADATA;
        let packed = |name: &str| name.to_ascii_lowercase().ends_with(".gz");
        let gzip = named.as_deref().is_some_and(packed)
            || field.content_type().is_some_and(|media| matches!(media, "application/gzip" | "application/x-gzip"));
        let bytes = field.bytes().await.map_err(|error| malformed(&error.body_text()))?;
        let file = match (is_metadata, named) {
            (true, _) => File { name: Some(METADATA.to_owned()), gzip: false, json: true, bytes, sidecar: None },
            (false, Some(name)) if !name.is_empty() => {
                File { name: Some(name), gzip, json: false, bytes, sidecar: None }
            }
            (false, _) => {
                return Err(Problem::new(
                    Code::Malformed,
                    "a part without file name",
                    format!("the part '{}' is no file and not named metadata", shortened(&part)),
                )
                .at(format!("part {}", shortened(&part)))
                .mend("Send files (curl -F file=@trial.csv) and at most one part named metadata.")
                .into());
            }
        };
        if files.iter().any(|other| other.name == file.name) {
            let name = shortened(file.name.as_deref().unwrap_or_default());
            return Err(Problem::new(Code::Malformed, "a file name twice", format!("two parts are named '{name}'"))
                .at(format!("file '{name}'"))
                .mend("Give each file a name of its own.")
                .into());
        }
        files.push(file);
        if files.iter().filter(|file| !file.is_metadata()).count() > limits.max_multipart_files {
            return Err(Problem::new(
                Code::TooLarge,
                "too many files",
                format!("the form has more than {} files", limits.max_multipart_files),
            )
            .at("body")
            .mend("Send the files in several requests.")
            .into());
        }
    }
    if files.iter().all(File::is_metadata) {
        return Err(Problem::new(Code::Malformed, "no files", "the form has no file")
            .at("body")
            .mend("Send at least one file: curl -F file=@trial.csv.")
            .into());
    }
    Ok(files)
}

fn malformed(why: &str) -> Problem {
    Problem::new(Code::Malformed, "unreadable form", why.to_owned()).at("body")
}
