//! Files of recordings, for commands: read by the one reader, within the limits of an upload.

use crate::analysis::{Code, Problem};
use crate::exchange::{self, Options, Reading, Resampling, TimeUnit, bids, options};
use crate::trial::csv::ColumnMapping;
use crate::trial::write;
use clap::Args;
use serde::Deserialize;
use serde_json::Value;
use std::fs::File;
use std::io::Read as _;
use std::path::Path;

/// A packed file is no larger than what it unpacks to may be.
const MAX_FILE_BYTES: u64 = 256 << 20;

/// What files do not say themselves.
#[derive(Debug, Clone, Default, PartialEq, Args)]
pub struct ReadingArgs {
    /// Which column is which signal, where they are not named t, r, u, y, d: pairs such as r:Target,y:Cursor, with
    /// columns by name, or by position from 1.
    #[arg(long, value_name = "SIGNAL:COLUMN,..", value_parser = options::columns)]
    pub columns: Option<ColumnMapping>,
    /// What the time column counts: s, ms, us, ns, or samples (which needs --sample-time). Without it, what the file
    /// says, or seconds.
    #[arg(long, value_name = "UNIT")]
    pub time_unit: Option<TimeUnit>,
    /// Time between samples in seconds, for files without times; checked against the times of others.
    #[arg(long, value_name = "SECONDS")]
    pub sample_time: Option<f64>,
    /// Bring samples that are not evenly spaced to a grid of --sample-time (or the usual step), by straight lines:
    /// linear.
    #[arg(long, value_name = "HOW")]
    pub resample: Option<Resampling>,
}

impl ReadingArgs {
    /// As the reader takes it.
    #[must_use]
    pub fn options(&self) -> Options {
        Options {
            columns: self.columns.clone().unwrap_or_default(),
            time_unit: self.time_unit,
            sample_time_s: self.sample_time,
            resample: self.resample,
            ..Options::default()
        }
    }
}

/// Reads a recording, with the files beside it that Motion-BIDS puts there.
///
/// # Errors
/// Where the file cannot be read, or is no recording.
pub fn read(path: &Path, options: &Options) -> Result<Reading, Problem> {
    let companions = path.file_name().and_then(|name| bids::companions(&name.to_string_lossy()));
    let beside = companions.map(|names| names.map(|name| path.with_file_name(name)));
    let Some([channels, description]) = beside.filter(|[channels, _]| channels.is_file()) else {
        return exchange::read(&bytes(path)?, options);
    };
    let named = |path: &Path| path.display().to_string();
    let of_description = if description.is_file() { Some(bytes(&description)?) } else { None };
    let sidecar = bids::sidecar(
        (&named(&channels), &bytes(&channels)?),
        of_description
            .as_ref()
            .map(|bytes| (named(&description), bytes))
            .as_ref()
            .map(|(n, b)| (n.as_str(), b.as_slice())),
    )?;
    exchange::read(&bytes(path)?, &Options { sidecar: Some(sidecar), ..options.clone() })
}

fn bytes(path: &Path) -> Result<Vec<u8>, Problem> {
    let unreadable = |error: std::io::Error| {
        Problem::new(Code::Malformed, "the file cannot be read", error.to_string())
            .at(path.display().to_string())
            .mend("Give the path of a recording.")
    };
    let file = File::open(path).map_err(unreadable)?;
    let mut bytes = Vec::new();
    file.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        let detail = format!("the file has more than {MAX_FILE_BYTES} bytes");
        return Err(Problem::new(Code::TooLarge, "too many bytes", detail)
            .at(path.display().to_string())
            .mend("Split the recording into trials, or resample it."));
    }
    Ok(bytes)
}

/// A trial of a request that is a file: its path, or the path with what the file does not say.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TrialFile {
    file: String,
    columns: Option<String>,
    time_unit: Option<TimeUnit>,
    sample_time_s: Option<f64>,
    resample: Option<Resampling>,
}

/// Puts recordings in the place of the files that a request names as its trials: `{"trial": "s01.csv"}`, or
/// `{"trial": {"file": "s01.csv", "columns": "r:Target", "time_unit": "ms"}}`, relative to `folder`.
///
/// # Errors
/// With the place in the request, where a file is no recording.
pub fn put_in(inputs: &mut Value, folder: &Path, at: &str) -> Result<(), Problem> {
    match inputs {
        Value::Object(members) => {
            for (name, value) in members.iter_mut() {
                let at = format!("{at}/{name}");
                match (name.as_str(), value) {
                    ("trial", value) => put_one(value, folder, &at)?,
                    ("trials", Value::Array(trials)) => {
                        for (i, trial) in trials.iter_mut().enumerate() {
                            put_one(trial, folder, &format!("{at}/{i}"))?;
                        }
                    }
                    (_, value @ (Value::Object(_) | Value::Array(_))) => put_in(value, folder, &at)?,
                    _ => {}
                }
            }
        }
        Value::Array(values) => {
            // Long lists are numbers.
            for (i, value) in values.iter_mut().enumerate().filter(|(_, value)| value.is_object()) {
                put_in(value, folder, &format!("{at}/{i}"))?;
            }
        }
        _ => {}
    }
    Ok(())
}

fn put_one(trial: &mut Value, folder: &Path, at: &str) -> Result<(), Problem> {
    let of_file = match &*trial {
        // An id names a stored trial.
        Value::String(text) if uuid::Uuid::try_parse(text).is_err() => {
            TrialFile { file: text.clone(), columns: None, time_unit: None, sample_time_s: None, resample: None }
        }
        Value::Object(members) if members.contains_key("file") => {
            serde_json::from_value(trial.clone()).map_err(|error| {
                Problem::new(Code::Malformed, "no file of a recording", error.to_string()).at(at).mend(
                    "Write {\"file\": PATH}, and where they are needed \"columns\", \"time_unit\", \"sample_time_s\" \
                     and \"resample\".",
                )
            })?
        }
        _ => return Ok(()),
    };
    let TrialFile { file, columns, time_unit, sample_time_s, resample } = of_file;
    let columns = columns.map(|text| options::columns(&text)).transpose().map_err(|why| {
        Problem::new(Code::Malformed, "bad columns", why)
            .at(format!("{at}/columns"))
            .mend("Give pairs such as r:target.")
    })?;
    let options =
        Options { columns: columns.unwrap_or_default(), time_unit, sample_time_s, resample, ..Options::default() };
    let reading = read(&folder.join(&file), &options).map_err(|problem| {
        let inside = problem.location.as_ref().map_or_else(String::new, |place| format!(", {place}"));
        problem.at(format!("{at}, file {file}{inside}"))
    })?;
    *trial = write::json_value(&reading.trial);
    Ok(())
}
