//! Motion-BIDS: tables without names, whose names, units and rate stand in two files beside them.
//!
//! Source: Jeung et al. (2024), *Motion-BIDS: an extension to the brain imaging data structure to organize motion data
//! for reproducible research*, Scientific Data 11, 716; BIDS 1.9.

use crate::analysis::{Code, Problem};
use crate::trial::csv::{Delimiter, split};
use serde::Deserialize;

/// How a table's name ends; that of its channels and of its description are this with other ends.
const TABLE: &str = "_motion.tsv";

/// What stands beside a table.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sidecar {
    /// Names of the columns, in their order.
    pub names: Vec<String>,
    /// Their units.
    pub units: Vec<Option<String>>,
    /// The channel of times, where one is of the type LATENCY.
    pub latency: Option<String>,
    /// Time between samples, in seconds.
    pub sample_time_s: Option<f64>,
}

/// The names of the two files beside a table of motion, those of its channels and of its description; `None` where the
/// name is not one of such a table.
#[must_use]
pub fn companions(name: &str) -> Option<[String; 2]> {
    let stem = name.strip_suffix(".gz").unwrap_or(name).strip_suffix(TABLE)?;
    Some([format!("{stem}_channels.tsv"), format!("{stem}_motion.json")])
}

#[derive(Deserialize)]
struct Description {
    #[serde(rename = "SamplingFrequency")]
    sampling_frequency: Option<f64>,
}

fn wrong(file: &str, why: impl Into<String>, mend: &str) -> Problem {
    Problem::new(Code::Malformed, "damaged Motion-BIDS sidecar", why).at(file).mend(mend)
}

/// Reads what stands beside a table: its channels (with their name), and its description where there is one.
///
/// # Errors
/// Where they cannot be read, or disagree.
pub fn sidecar(channels: (&str, &[u8]), description: Option<(&str, &[u8])>) -> Result<Sidecar, Problem> {
    let (name, bytes) = channels;
    let text = std::str::from_utf8(bytes).map_err(|_| wrong(name, "it is not UTF-8", "Save it as UTF-8."))?;
    let mut lines = text.trim_start_matches('\u{feff}').lines();
    let header = split(lines.next().unwrap_or_default(), Delimiter::Tab).unwrap_or_default();
    let column = |wanted: &str| header.iter().position(|name| name.trim() == wanted);
    let Some(of_name) = column("name") else {
        return Err(wrong(
            name,
            "it has no column \"name\"",
            "Name its columns name, component, type, tracked_point, units.",
        ));
    };
    let mut sidecar = Sidecar::default();
    let mut rate = None;
    for (at, line) in lines.enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let cells = split(line, Delimiter::Tab).unwrap_or_default();
        let cell = |wanted: &str| {
            let text = cells.get(column(wanted)?)?.trim();
            (!text.is_empty() && text != "n/a").then_some(text)
        };
        let Some(channel) = cells.get(of_name).map(|cell| cell.trim()).filter(|cell| !cell.is_empty()) else {
            return Err(wrong(name, format!("row {} names no channel", at + 2), "Give every channel a name."));
        };
        if cell("type") == Some("LATENCY") {
            sidecar.latency = Some(channel.to_owned());
        }
        sidecar.names.push(channel.to_owned());
        sidecar.units.push(cell("units").map(str::to_owned));
        let own = cell("sampling_frequency").and_then(|text| text.parse::<f64>().ok());
        match (rate, own) {
            (Some(first), Some(own)) if first != own => {
                let why = format!("channels have the rates {first} and {own} Hz, and a trial has one");
                return Err(wrong(name, why, "Resample the channels to one rate."));
            }
            (None, own) => rate = own,
            _ => {}
        }
    }
    if let Some((name, bytes)) = description {
        let description: Description = serde_json::from_slice(bytes)
            .map_err(|error| wrong(name, error.to_string(), "It is a JSON object with SamplingFrequency, a number."))?;
        match (rate, description.sampling_frequency) {
            (Some(of_channels), Some(own)) if of_channels != own => {
                let why = format!("SamplingFrequency is {own} Hz, and the channels say {of_channels} Hz");
                return Err(wrong(name, why, "Correct one of them."));
            }
            (None, own) => rate = own,
            _ => {}
        }
    }
    if let Some(bad) = rate.filter(|rate| !(rate.is_normal() && *rate > 0.0)) {
        return Err(wrong(name, format!("the rate is {bad} Hz"), "Give the samples in a second."));
    }
    sidecar.sample_time_s = rate.map(|rate| 1.0 / rate);
    Ok(sidecar)
}
