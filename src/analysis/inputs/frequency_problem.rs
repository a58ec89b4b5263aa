//! Settings of frequency data as people write them, and what can be wrong with them and with the data, as problems.

use super::trials::ResolvedTrial;
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading;
use crate::response::{CheckedSettings, FrequencyError, FrequencySettings, SettingsError, Stimulus};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

/// Reads settings; `pointer` is where they are in the request (`/spec`).
///
/// # Errors
/// An `invalid` [`Problem`] that names the field.
pub fn read_settings(members: &Map<String, Value>, pointer: &str) -> Result<FrequencySettings, Problem> {
    reading::members(members, pointer, "unusable setting")
}

/// Reads a spec all of whose members may be left out, one of which is `frequency`.
///
/// # Errors
/// An `invalid` [`Problem`] that names the field, of the settings too.
pub fn read_spec<T: DeserializeOwned>(value: &Value, at: &str) -> Result<T, Problem> {
    if let Some(Value::Object(settings)) = value.get("frequency") {
        read_settings(settings, &format!("{at}/frequency"))?;
    }
    reading::spec(value, at)
}

/// Checks settings; `pointer` is where they are in the request.
///
/// # Errors
/// An `invalid` [`Problem`] that names the field.
pub fn check_settings(settings: &FrequencySettings, pointer: &str) -> Result<CheckedSettings, Problem> {
    settings.clone().check().map_err(|error| settings_problem(&error, pointer))
}

fn settings_problem(error: &SettingsError, pointer: &str) -> Problem {
    Problem::new(Code::Invalid, "unusable setting", error.reason.clone()).at(format!("{pointer}{}", error.field))
}

/// The problem that keeps `trials` from having frequency data under the settings at `pointer`.
///
/// [`FrequencyError::Stopped`] is no problem; it is for the caller to tell apart.
#[must_use]
pub fn problem(error: &FrequencyError, trials: &[ResolvedTrial], pointer: &str) -> Problem {
    let place = |trial: usize| trials.get(trial).map_or_else(|| "/inputs".to_owned(), |trial| trial.name.clone());
    let new = |code, title: &str| Problem::new(code, title, error.to_string());
    match error {
        FrequencyError::Stopped(_) => new(Code::Internal, "stopped"),
        FrequencyError::Settings(error) => settings_problem(error, pointer),
        FrequencyError::NoTrial => new(Code::Invalid, "no trial").at("/inputs"),
        FrequencyError::SampleTimesDiffer { trial, .. } => new(Code::Invalid, "different sample times")
            .at(place(*trial))
            .mend("Combine only trials with the same sample time, or resample them."),
        FrequencyError::LineAboveNyquist { line, .. } => new(Code::Invalid, "line above the Nyquist frequency")
            .at(format!("{pointer}/lines/frequency_hz/{line}"))
            .mend("Leave it out, or record with a shorter sample time."),
        FrequencyError::LinesTooClose { line, named, windowed, least_hz, length_s, below_hz, frequency_hz } => {
            let at = if *named { format!("{pointer}/lines/frequency_hz/{line}") } else { format!("{pointer}/lines") };
            let longer = length_s * least_hz / (frequency_hz - below_hz);
            let window = if *windowed { ", or the rectangular window on whole periods" } else { "" };
            let advice = format!("Leave one of them out, use segments of {longer:.3} s or more{window}.");
            new(Code::Invalid, "lines that cannot be told apart").at(at).mend(advice)
        }
        FrequencyError::SegmentOutside { segment, .. } => new(Code::Invalid, "segment outside the record")
            .at(format!("{pointer}/segments/{segment}"))
            .mend("Name segments within the record, in seconds from its first sample."),
        FrequencyError::SegmentTooShort { .. } => new(Code::Invalid, "segment too short")
            .at(format!("{pointer}/segments"))
            .mend("Use fewer or longer segments."),
        FrequencyError::UnequalSegments { .. } => new(Code::Invalid, "segments of unequal length")
            .at(format!("{pointer}/segments"))
            .mend("Use segments of one length, or name the lines."),
        FrequencyError::NoDisturbance { trial } => new(Code::Invalid, "no disturbance recorded")
            .at(place(*trial))
            .mend("Take the command as the input, or leave the trial out."),
        FrequencyError::NoPower { trial, input, other_has_power } => {
            let advice = match (input, other_has_power) {
                (_, false) => "Leave this trial out, or name lines that its stimulus excites.",
                (Stimulus::Command, true) => {
                    "Leave this trial out, or ask for the frequency_response with \"input\": \"disturbance\"."
                }
                (Stimulus::Disturbance, true) => {
                    "Leave this trial out, or ask for the frequency_response with \"input\": \"command\"."
                }
            };
            new(Code::NotIdentifiable, "no power in the input").at(place(*trial)).mend(advice)
        }
        FrequencyError::NothingExcited { .. } => new(Code::NotIdentifiable, "no excited line")
            .at(format!("{pointer}/lines"))
            .mend("Widen the band, lower power_threshold or floor_ratio, or name the lines."),
    }
}
