//! What a file was taken for, in JSON and in words.

use crate::trial::{Channel, Trial};
use schemars::JsonSchema;
use serde::Serialize;

/// What an uploaded file was taken for.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Understood {
    /// The format, as its content says: `text`, `json`, `matlab_4`, `matlab_5`, `matlab_7_3`, `hdf5`,
    /// `numpy` or `xlsx`.
    pub format: &'static str,
    /// Encoding of the text, such as `UTF-8` or `windows-1252`; null where the file is none.
    pub encoding: Option<String>,
    /// What stands between cells: `comma`, `semicolon`, `tab`, `bar` or `spaces`; null where the file is no text.
    pub delimiter: Option<&'static str>,
    /// What stands before the decimals of a number: `point` or `comma`; null where the file is no text.
    pub decimal_mark: Option<&'static str>,
    /// The line that names the columns, from 1; null where none does.
    pub header_row: Option<u64>,
    /// The line of the first sample, from 1; null where the file has no lines.
    pub first_row: Option<u64>,
    /// The columns or variables that were taken for signals.
    pub columns: Vec<UnderstoodColumn>,
    /// What the time column counts: `s`, `ms`, `us`, `ns` or `samples`; null where there is no time column.
    pub time_unit: Option<&'static str>,
    /// Whether the samples were brought to another grid than that on which they were recorded.
    pub resampled: bool,
    /// All of this in sentences, and whatever else was noticed.
    pub words: Vec<String>,
}

/// A column that was taken for a signal.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct UnderstoodColumn {
    /// The signal: `t`, `r`, `u`, `y` or `d`.
    pub signal: &'static str,
    /// The name of the column or variable in the file; its position, from 1, where it has none.
    pub name: String,
    /// The unit that the file gives it; null where it gives none.
    pub unit: Option<String>,
}

impl Understood {
    /// Of a file in this format, with nothing known yet.
    #[must_use]
    pub(super) fn new(format: &'static str) -> Self {
        Self {
            format,
            encoding: None,
            delimiter: None,
            decimal_mark: None,
            header_row: None,
            first_row: None,
            columns: Vec::new(),
            time_unit: None,
            resampled: false,
            words: Vec::new(),
        }
    }

    /// Of a file in this format, with a sentence that says so.
    #[must_use]
    pub(super) fn of(format: &'static str, words: &str) -> Self {
        Self { words: vec![words.to_owned()], ..Self::new(format) }
    }

    /// Of a trial as JSON.
    pub(super) fn document(trial: &Trial) -> Self {
        let mut understood = Self::new("json");
        for channel in Channel::ALL {
            if trial.signals.channel(channel).is_some() {
                let name = channel.letter().to_owned();
                understood.columns.push(UnderstoodColumn { signal: channel.letter(), name, unit: None });
            }
        }
        understood.time_unit = trial.signals.time_s.as_ref().map(|_| "s");
        understood.words.push("A trial as JSON.".to_owned());
        understood
    }
}
