//! Files as labs have them, read into checked trials.
//!
//! ```text
//! bytes ─ gzip? ─► format, by content ─► columns ─ names, mapping ─► signals ─ unit of time, gaps ─► trial
//! ```
//! [`read`] recognises what a file is by what stands in it, never by its name, and says in [`Understood`] what it took
//! it for. Nothing is guessed that changes a number: where a file can be read in two ways, it is refused with the row,
//! the reason, and the words that would settle it. [`text`] has the tables, [`matlab`] files of variables
//! and [`variables`] what is taken from them, [`names`] says which column is which
//! signal, [`time`] brings times to seconds and, when asked, to a uniform grid.
//!
//! The way out is simpler: [`tables`] has what a study says as tidy tables, [`models`] what a report found as other
//! programs compute with it, [`mod@write`] the formats of files,
//! [`bundle`] a whole study in one archive.

pub mod archive;
pub mod bids;
pub mod bundle;
mod excel;
mod format;
#[cfg(feature = "hdf5")]
mod hdf5;
pub mod matlab;
pub mod models;
pub mod names;
mod numbers;
mod numpy;
pub mod options;
mod reading;
mod source;
pub mod tables;
pub mod text;
pub mod time;
pub mod understood;
pub mod variables;
pub mod write;

use crate::analysis::{Code, Problem};
use crate::trial::json;
use archive::Archive;
use format::Format;
use matlab::Level;
pub use options::{Options, Resampling, Saved, TimeUnit};
pub use reading::Reading;
use source::Source;
pub use understood::{Understood, UnderstoodColumn};

/// Reads a trial from a file's bytes, which may be packed with gzip.
///
/// # Errors
/// A [`Problem`] with the place in the file, the reason and how to go on. No more is unpacked than `options.limits`
/// allow.
pub fn read(bytes: &[u8], options: &Options) -> Result<Reading, Problem> {
    read_from(&Source::of(bytes), options)
}

/// As [`read`], of bytes that are said to be packed with gzip.
///
/// # Errors
/// As [`read`]; bytes that are not packed are refused.
pub fn read_packed(bytes: &[u8], options: &Options) -> Result<Reading, Problem> {
    read_from(&Source::packed(bytes), options)
}

/// Reads a trial from a JSON document, which may be packed with gzip.
///
/// # Errors
/// As [`read`].
pub fn read_document(bytes: &[u8], is_packed: bool, options: &Options) -> Result<Reading, Problem> {
    options.check()?;
    document(&if is_packed { Source::packed(bytes) } else { Source::of(bytes) }, options)
}

fn read_from(source: &Source<'_>, options: &Options) -> Result<Reading, Problem> {
    options.check()?;
    let head = source.head(options.limits.max_bytes)?;
    let max_bytes = options.limits.max_bytes;
    let format = Format::of(&head.bytes)?;
    if matches!(format, Format::Json) {
        return document(source, options);
    }
    let options = &options.completed();
    match format {
        Format::Json => document(source, options),
        Format::Text => text::read(source, &head, options),
        Format::Numpy => {
            let variables = numpy::array(&source.whole(max_bytes)?)?;
            variables::read(&variables, Understood::of("numpy", "An array of NumPy."), options)
        }
        Format::Hdf5 => hierarchical(source.whole(max_bytes)?, options),
        Format::Zip => archived(&source.whole(max_bytes)?, options),
        Format::Matlab(level) => {
            let variables = matlab::read(&source.whole(max_bytes)?, level, max_bytes)?;
            let (name, words) = match level {
                Level::Four => ("matlab_4", "A file of MATLAB, level 4."),
                Level::Five => ("matlab_5", "A file of MATLAB, level 5 (versions 5 to 7.2)."),
            };
            variables::read(&variables, Understood::of(name, words), options)
        }
    }
}

/// A trial from HDF5: a file of MATLAB 7.3, or a plain one.
#[cfg(feature = "hdf5")]
fn hierarchical(bytes: Vec<u8>, options: &Options) -> Result<Reading, Problem> {
    let (variables, kind) = hdf5::read(bytes, options.limits.max_bytes)?;
    let understood = match kind {
        hdf5::Kind::Matlab => Understood::of("matlab_7_3", "A file of MATLAB, version 7.3."),
        hdf5::Kind::Plain => Understood::of("hdf5", "A file of HDF5."),
    };
    variables::read(&variables, understood, options)
}

#[cfg(not(feature = "hdf5"))]
fn hierarchical(_: Vec<u8>, _: &Options) -> Result<Reading, Problem> {
    Err(Problem::new(
        Code::Malformed,
        "a format that is not read",
        "the file is HDF5 (MATLAB 7.3 among others), and this program was built without the feature hdf5",
    )
    .mend("Save it for an earlier MATLAB: save('trial.mat', 't', 'r', 'u', 'y', '-v7')."))
}

/// A trial from an archive: of NumPy, of Excel, or of a folder with one recording.
fn archived(bytes: &[u8], options: &Options) -> Result<Reading, Problem> {
    let max_bytes = options.limits.max_bytes;
    let archive = Archive::open(bytes, max_bytes)?;
    match archive.kind() {
        archive::Kind::Numpy => {
            let variables = numpy::arrays(archive)?;
            variables::read(&variables, Understood::of("numpy", "Arrays of NumPy."), options)
        }
        archive::Kind::Excel => {
            // Its own reader knows no bounds: the archive is unpacked once within them.
            let mut archive = archive;
            for at in 0..archive.names().len() {
                archive.file(at)?;
            }
            let unpacked = archive.unpacked();
            let sheet = excel::sheet(bytes, options.limits.max_rows, max_bytes)?;
            let others = match sheet.others {
                0 => String::new(),
                others => format!(" (of {} sheets, the one with numbers)", others + 1),
            };
            let words = format!("The sheet {:?} of Excel{others}", sheet.name);
            let reading = text::read_sheet(&sheet.text, &words, options)?;
            Ok(Reading { bytes: unpacked, ..reading })
        }
        archive::Kind::Folder => {
            let files = archive::folder(bytes, max_bytes)?;
            let [(name, file)] = files.as_slice() else {
                return Err(Problem::new(
                    Code::Malformed,
                    "several files",
                    format!("the archive has {} files, and a trial is one", files.len()),
                )
                .mend(
                    "Send the archive to a server, which takes each file for a trial, or unpack and import the folder.",
                ));
            };
            // Packed or not.
            if Source::of(file).head(max_bytes)?.bytes.starts_with(archive::MARK) {
                return Err(Problem::new(Code::Malformed, "an archive in an archive", format!("{name} is one again"))
                    .mend("Send the inner archive."));
            }
            read(file, options).map_err(|problem| {
                let place = problem.location.as_ref().map_or_else(|| name.clone(), |place| format!("{name}, {place}"));
                problem.at(place)
            })
        }
    }
}

/// A trial as JSON.
fn document(source: &Source<'_>, options: &Options) -> Result<Reading, Problem> {
    options.refuse_for_documents()?;
    let mut counted = source.open();
    let trial = json::read(&mut counted, options.sample_time_s, &options.limits).map_err(Problem::from)?;
    let bytes = counted.count();
    let understood = Understood::document(&trial);
    Ok(Reading { trial, understood, ignored_columns: Vec::new(), warnings: Vec::new(), bytes })
}
