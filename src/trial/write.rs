//! Writing trials, so that reading gives back the same bits.
//!
//! Every number is written with the fewest digits that read back as the same double, negative zero included.

use super::signals::{Channel, Trial};
use std::io::{self, Write};

/// Writes the recorded columns as CSV, with lines that end in CR LF as RFC 4180 has it.
///
/// A trial that came without a time column is written without one; its sample time must travel beside the file.
///
/// # Errors
/// Those of `out`.
pub fn csv(trial: &Trial, mut out: impl Write) -> io::Result<()> {
    let columns: Vec<(Channel, &[f64])> = columns(trial).collect();
    let header: Vec<&str> = columns.iter().map(|(channel, _)| channel.letter()).collect();
    write!(out, "{}\r\n", header.join(","))?;
    for sample in 0..trial.samples() {
        for (i, (_, column)) in columns.iter().enumerate() {
            if i > 0 {
                out.write_all(b",")?;
            }
            write!(out, "{:?}", column[sample])?;
        }
        out.write_all(b"\r\n")?;
    }
    out.flush()
}

/// Writes `{"sample_time_s", "t"?, "r", "u", "y", "d"?}`.
///
/// # Errors
/// Those of `out`.
pub fn json(trial: &Trial, mut out: impl Write) -> io::Result<()> {
    write!(out, "{{\"sample_time_s\":{:?}", trial.sample_time_s)?;
    for (channel, column) in columns(trial) {
        write!(out, ",\"{}\":[", channel.letter())?;
        for (i, value) in column.iter().enumerate() {
            if i > 0 {
                out.write_all(b",")?;
            }
            write!(out, "{value:?}")?;
        }
        out.write_all(b"]")?;
    }
    out.write_all(b"}")?;
    out.flush()
}

/// The same document as a JSON value.
#[must_use]
pub fn json_value(trial: &Trial) -> serde_json::Value {
    let mut document = serde_json::Map::new();
    document.insert("sample_time_s".to_owned(), trial.sample_time_s.into());
    for (channel, column) in columns(trial) {
        document.insert(channel.letter().to_owned(), column.to_vec().into());
    }
    document.into()
}

fn columns(trial: &Trial) -> impl Iterator<Item = (Channel, &[f64])> {
    Channel::ALL.into_iter().filter_map(|channel| trial.signals.channel(channel).map(|column| (channel, column)))
}
