//! Files that are looked at before they are stored: read as an upload reads them, one by one, so that one that cannot
//! be
//! read stops no other.

use super::files::{self, Budget, File};
use super::keep::{Said, parse};
use crate::analysis::{Code, Problem, Warning};
use crate::api::extract::{media_type, off_thread, read_body, unsupported};
use crate::api::problem::{ApiResult, internal};
use crate::api::state::{AppState, Limits};
use crate::exchange::{Options, Understood, archive, bids};
use crate::store::{NewTrial, Plant};
use axum::body::Body;
use axum::http::{HeaderMap, header};

/// Bytes of all files that are looked at together, unpacked from an archive.
const MOST_BYTES: usize = 256 << 20;

/// What is said of a file.
#[derive(Debug, Clone)]
pub(crate) struct Wish {
    /// The plant it was recorded on.
    pub(crate) plant: Plant,
    /// The trial's number.
    pub(crate) number: Option<i64>,
    /// The session.
    pub(crate) session: Option<i64>,
    /// Which column is which signal, and what the time counts.
    pub(crate) options: Options,
}

/// What a file was read as.
#[derive(Debug, Clone)]
pub(crate) struct Preview {
    /// The trial, to be stored.
    pub(crate) new: NewTrial,
    /// What the file was taken for.
    pub(crate) understood: Understood,
    /// Columns that are no signals, by name.
    pub(crate) ignored_columns: Vec<String>,
    /// What must be read before using the trial.
    pub(crate) warnings: Vec<Warning>,
}

/// The files of a form, by name and as they came; an archived folder is taken apart.
///
/// # Errors
/// Where the body is no form with files, or too large.
pub(crate) async fn sent_files(state: &AppState, headers: &HeaderMap, body: Body) -> ApiResult<Vec<(String, Vec<u8>)>> {
    if media_type(headers).as_deref() != Some("multipart/form-data") {
        return Err(unsupported(headers, "multipart/form-data").into());
    }
    let text = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let boundary = files::boundary(text)?;
    let _permit = state.uploads.clone().acquire_owned().await.map_err(|_| internal())?;
    let bytes = read_body(state, headers, body).await?;
    let limits = state.limits;
    let sent = files::of_form(bytes.into(), &boundary, &limits).await?;
    off_thread(move || taken_apart(sent, &limits)).await?
}

fn taken_apart(sent: Vec<File>, limits: &Limits) -> ApiResult<Vec<(String, Vec<u8>)>> {
    let mut all = Vec::new();
    for file in sent {
        let name = file.name.unwrap_or_default();
        // An archive that cannot be opened is a file that is refused, beside the others.
        match archive::is_folder(&file.bytes).then(|| archive::folder(&file.bytes, limits.max_decompressed_bytes)) {
            Some(Ok(inner)) => all.extend(inner),
            Some(Err(_)) | None => all.push((name, file.bytes.to_vec())),
        }
    }
    if all.len() > limits.max_multipart_files {
        let detail =
            format!("there are {} files, and {} are looked at together", all.len(), limits.max_multipart_files);
        return Err(Problem::new(Code::TooLarge, "too many files", detail)
            .at("body")
            .mend("Send them in several portions.")
            .into());
    }
    let bytes: usize = all.iter().map(|(_, bytes)| bytes.len()).sum();
    if bytes > MOST_BYTES {
        let detail = format!("the files have {bytes} bytes, and {MOST_BYTES} are looked at together");
        return Err(Problem::new(Code::TooLarge, "too much at once", detail)
            .at("body")
            .mend("Send them in several portions.")
            .into());
    }
    Ok(all)
}

/// Reads files as an upload would, each with what is said of it; where nothing is said of one, it stands beside another
/// and is left out.
pub(crate) fn preview(
    named: Vec<(String, Vec<u8>)>,
    wishes: &[Option<Wish>],
    limits: &Limits,
) -> Vec<Option<Result<Preview, Problem>>> {
    let mut budget = Budget::new(limits);
    let one = |(name, bytes): (String, Vec<u8>)| File {
        name: Some(name),
        gzip: false,
        json: false,
        bytes: bytes.into(),
        sidecar: None,
    };
    let files: Vec<File> = named.into_iter().map(one).collect();
    files
        .iter()
        .zip(wishes)
        .map(|(file, wish)| {
            let wish = wish.as_ref()?;
            let parsed = beside(file, &files)
                .and_then(|file| parse(&file, &mut budget, &wish.options, &wish.plant, [wish.number, wish.session]));
            Some(parsed.map(|(new, Said { ignored_columns, understood, warnings, .. })| Preview {
                new,
                understood,
                ignored_columns,
                warnings,
            }))
        })
        .collect()
}

/// A file with what stands in files beside it.
fn beside(file: &File, all: &[File]) -> Result<File, Problem> {
    let sidecar = files::sidecar_of(file, all)?;
    Ok(File { sidecar, ..file.clone() })
}

/// Of files that were sent together, by name, which ones stand beside a recording and are none themselves.
pub(crate) fn stand_beside(names: &[&str]) -> Vec<bool> {
    let is_table = |name: &str| bids::companions(name).is_some();
    let has_tables = names.iter().any(|name| is_table(name));
    names.iter().map(|name| has_tables && !is_table(name)).collect()
}
