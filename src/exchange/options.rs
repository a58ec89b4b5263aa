//! What the person who has the file says of it.

use super::bids::Sidecar;
use crate::analysis::{Code, Problem};
use crate::trial::csv::ColumnMapping;
use crate::trial::{Channel, Limits};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// What a time column counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum TimeUnit {
    /// Seconds.
    #[serde(rename = "s")]
    Seconds,
    /// Milliseconds.
    #[serde(rename = "ms")]
    Milliseconds,
    /// Microseconds.
    #[serde(rename = "us")]
    Microseconds,
    /// Nanoseconds.
    #[serde(rename = "ns")]
    Nanoseconds,
    /// Samples; their rate comes from the sample time.
    #[serde(rename = "samples")]
    Samples,
}

impl TimeUnit {
    /// As it is written.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Seconds => "s",
            Self::Milliseconds => "ms",
            Self::Microseconds => "us",
            Self::Nanoseconds => "ns",
            Self::Samples => "samples",
        }
    }

    /// How many of it make a second; `None` for samples.
    #[must_use]
    pub fn per_second(self) -> Option<f64> {
        match self {
            Self::Seconds => Some(1.0),
            Self::Milliseconds => Some(1e3),
            Self::Microseconds => Some(1e6),
            Self::Nanoseconds => Some(1e9),
            Self::Samples => None,
        }
    }

    /// The unit that a header means, as people write it.
    #[must_use]
    pub fn as_written(text: &str) -> Option<Self> {
        match text.trim().to_lowercase().as_str() {
            "s" | "sec" | "secs" | "second" | "seconds" | "sekunden" => Some(Self::Seconds),
            "ms" | "msec" | "millisec" | "millisecond" | "milliseconds" => Some(Self::Milliseconds),
            // The micro sign, and the Greek letter.
            "us" | "usec" | "\u{b5}s" | "\u{3bc}s" | "microsecond" | "microseconds" => Some(Self::Microseconds),
            "ns" | "nsec" | "nanosecond" | "nanoseconds" => Some(Self::Nanoseconds),
            "sample" | "samples" | "frame" | "frames" => Some(Self::Samples),
            _ => None,
        }
    }
}

impl FromStr for TimeUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        [Self::Seconds, Self::Milliseconds, Self::Microseconds, Self::Nanoseconds, Self::Samples]
            .into_iter()
            .find(|unit| unit.name() == text)
            .ok_or_else(|| format!("'{text}' is no unit of time; there are s, ms, us, ns and samples"))
    }
}

/// How values come to a grid on which they were not recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Resampling {
    /// On a straight line between the two samples beside.
    Linear,
}

impl FromStr for Resampling {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "linear" => Ok(Self::Linear),
            other => Err(format!("'{other}' is no way to resample; there is linear")),
        }
    }
}

/// What was said once of all files of a study.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Saved {
    /// Which column is which signal.
    pub columns: ColumnMapping,
    /// What time columns count.
    pub time_unit: Option<TimeUnit>,
    /// Time between samples in seconds.
    pub sample_time_s: Option<f64>,
    /// How uneven times are brought to a uniform grid.
    pub resample: Option<Resampling>,
}

impl Saved {
    /// From what people write; a column mapping as pairs `signal:column`.
    ///
    /// # Errors
    /// The member that cannot be read, and why.
    pub fn parse(
        columns: Option<&str>,
        time_unit: Option<&str>,
        sample_time_s: Option<f64>,
        resample: Option<&str>,
    ) -> Result<Self, (&'static str, String)> {
        if let Some(bad) = sample_time_s.filter(|value| !(value.is_normal() && *value > 0.0)) {
            return Err(("sample_time_s", format!("the sample time is {bad} s, and must be positive")));
        }
        Ok(Self {
            columns: columns.map(self::columns).transpose().map_err(|why| ("columns", why))?.unwrap_or_default(),
            time_unit: time_unit.map(str::parse).transpose().map_err(|why| ("time_unit", why))?,
            sample_time_s,
            resample: resample.map(str::parse).transpose().map_err(|why| ("resample", why))?,
        })
    }
}

/// What the person who has the file says of it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Which column is which signal, by name or by position; without, columns are taken by the names of signals.
    pub columns: ColumnMapping,
    /// What the time column counts; without, what its header says, or seconds.
    pub time_unit: Option<TimeUnit>,
    /// Time between samples in seconds.
    pub sample_time_s: Option<f64>,
    /// Whether, and how, uneven times are brought to a uniform grid.
    pub resample: Option<Resampling>,
    /// What stands beside the file.
    pub sidecar: Option<Sidecar>,
    /// What was said once of all files of a study: taken where nothing is said of this one, and not by documents.
    pub saved: Saved,
    /// How much is read.
    pub limits: Limits,
}

impl Options {
    pub(super) fn check(&self) -> Result<(), Problem> {
        match self.sample_time_s.filter(|value| !(value.is_normal() && *value > 0.0)) {
            Some(bad) => Err(Problem::new(
                Code::Invalid,
                "unusable sample time",
                format!("the sample time is {bad} s, and must be positive and finite"),
            )
            .at("sample_time_s")
            .mend("Give the time between samples in seconds.")),
            None => Ok(()),
        }
    }

    /// With what was said of all files of the study, where nothing is said of this one. Columns go together.
    pub(super) fn completed(&self) -> Self {
        let Saved { columns, time_unit, sample_time_s, resample } = &self.saved;
        let own = self.columns != ColumnMapping::default();
        Self {
            columns: if own { self.columns.clone() } else { columns.clone() },
            time_unit: self.time_unit.or(*time_unit),
            sample_time_s: self.sample_time_s.or(*sample_time_s),
            resample: self.resample.or(*resample),
            saved: Saved::default(),
            ..self.clone()
        }
    }

    /// A document of our own says itself what it holds.
    pub(super) fn refuse_for_documents(&self) -> Result<(), Problem> {
        let given = [
            ("columns", self.columns != ColumnMapping::default()),
            ("time_unit", self.time_unit.is_some()),
            ("resample", self.resample.is_some()),
        ];
        match given.into_iter().find(|(_, is_given)| *is_given) {
            Some((name, _)) => Err(Problem::new(
                Code::Malformed,
                "not for JSON",
                format!("the file is a JSON document, and {name} is for tables"),
            )
            .at(name)
            .mend("Leave it out, and name the arrays t, r, u, y and d, with t in seconds.")),
            None => Ok(()),
        }
    }
}

/// A mapping as [`columns`] reads it.
#[must_use]
pub fn written(mapping: &ColumnMapping) -> String {
    let pairs = Channel::ALL.into_iter().filter_map(|c| Some(format!("{}:{}", c.letter(), mapping.name(c)?)));
    pairs.collect::<Vec<_>>().join(",")
}

/// Reads pairs `signal:column` separated by commas, with `t`, `r`, `u`, `y`, `d` or the signals' words.
///
/// # Errors
/// What is wrong with which pair.
pub fn columns(text: &str) -> Result<ColumnMapping, String> {
    let mut mapping = ColumnMapping::default();
    // A comma within brackets is part of a path, such as M(:,2).
    let mut depth = 0_i32;
    let between_pairs = |c: char| {
        depth += i32::from(c == '(') - i32::from(c == ')');
        c == ',' && depth <= 0
    };
    for pair in text.split(between_pairs) {
        let Some((signal, column)) = pair.split_once(':') else {
            return Err(format!("'{pair}' is no pair signal:column"));
        };
        let (signal, column) = (signal.trim(), column.trim());
        let Some(channel) = Channel::ALL.into_iter().find(|c| c.letter() == signal || super::names::word(*c) == signal)
        else {
            return Err(format!(
                "there is no signal '{signal}'; there are t (time), r (command), u (control), y (output) and d \
                 (disturbance)"
            ));
        };
        if column.is_empty() {
            return Err(format!("the signal '{signal}' is given no column"));
        }
        if mapping.name_mut(channel).replace(column.to_owned()).is_some() {
            return Err(format!("the signal '{signal}' is given twice"));
        }
    }
    Ok(mapping)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn column_names_are_read_pair_by_pair() {
        let mapping = columns("command:target, y:cursor:px").unwrap();
        assert_eq!(mapping.command.as_deref(), Some("target"));
        assert_eq!(mapping.output.as_deref(), Some("cursor:px"));
        for (bad, why) in [
            ("", "'' is no pair signal:column"),
            ("command", "'command' is no pair signal:column"),
            ("speed:v", "there is no signal 'speed'"),
            ("command:", "the signal 'command' is given no column"),
            ("r:a,command:b", "the signal 'command' is given twice"),
        ] {
            let said = columns(bad).unwrap_err();
            assert!(said.starts_with(why), "{bad}: {said}");
        }
    }

    #[test]
    fn units_of_time_are_read_as_people_write_them() {
        for (text, unit) in
            [("ms", TimeUnit::Milliseconds), ("\u{b5}s", TimeUnit::Microseconds), ("Sec", TimeUnit::Seconds)]
        {
            assert_eq!(TimeUnit::as_written(text), Some(unit), "{text}");
        }
        assert_eq!(TimeUnit::as_written("min"), None);
        let said = "msec".parse::<TimeUnit>().unwrap_err();
        assert!(said.starts_with("'msec' is no unit of time"), "{said}");
    }
}
