//! What a study's files do not say themselves, as it is kept.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What the files of a study do not say themselves: taken for each, as far as an upload says nothing else.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct StudyReading {
    /// Which column or variable is which signal: pairs such as `r:Target,y:Cursor`; null where files name their
    /// signals.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub columns: Option<String>,
    /// What time columns count: `s`, `ms`, `us`, `ns` or `samples`; null where files say, or count seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_unit: Option<String>,
    /// Time between samples in seconds, for files without times; null where they have times.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_time_s: Option<f64>,
    /// How samples that are not evenly spaced are brought to a grid: `linear`; null where they are refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resample: Option<String>,
}
