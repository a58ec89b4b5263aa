//! How far one quantity of every trial of a study may be used: subjects down, trials across.

use super::inputs::{Estimator, PlantName, Remark, SpecChoice};
use crate::trust::{Level, MeanTrust, Trust, of_mean};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A trial's quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrustGridCell {
    /// The trial's id.
    pub trial: String,
    /// Its number.
    pub number: i64,
    /// Its session.
    pub session: Option<i64>,
    /// The analysis that the value comes from; null where it was measured, or is not identified.
    pub analysis: Option<String>,
    /// The value in its own unit; null where there is none.
    pub value: Option<f64>,
    /// Its 95 % interval in the same unit; null where there is none.
    pub interval_95: Option<[f64; 2]>,
    /// How far it may be used.
    #[serde(flatten)]
    pub trust: Trust,
}

/// A subject's trials on one plant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrustGridRow {
    /// The subject's id.
    pub subject: String,
    /// Its pseudonym.
    pub code: String,
    /// Its group.
    pub group: Option<String>,
    /// The plant.
    pub plant: PlantName,
    /// Its trials, by session and number.
    pub trials: Vec<TrustGridCell>,
}

/// One quantity of every trial of a study, with how far it may be used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StudyTrust {
    /// The quantity by its name.
    pub quantity: String,
    /// How the controllers were estimated; null of what was measured.
    pub estimator: Option<Estimator>,
    /// The spec whose identifications are shown; null where no trial is identified.
    pub spec: Option<SpecChoice>,
    /// Which version of the rule judged.
    pub rule: u32,
    /// How many values there are at each level.
    pub counts: TrustCounts,
    /// How far a mean over all values may be used.
    pub all: MeanTrust,
    /// The subjects, by group, plant and pseudonym.
    pub rows: Vec<TrustGridRow>,
    /// What must be read before using the numbers.
    pub remarks: Vec<Remark>,
}

/// How many values there are at each level.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TrustCounts {
    /// Without a value.
    pub not_identified: usize,
    /// Nothing speaks against them.
    pub ok: usize,
    /// To be read.
    pub read: usize,
    /// Not to be used.
    pub do_not_use: usize,
}

impl TrustCounts {
    /// Of several levels.
    #[must_use]
    pub fn of(levels: &[Level]) -> Self {
        let count = |level: Level| levels.iter().filter(|own| **own == level).count();
        Self {
            not_identified: count(Level::NotIdentified),
            ok: count(Level::Ok),
            read: count(Level::Read),
            do_not_use: count(Level::DoNotUse),
        }
    }
}

impl StudyTrust {
    /// Of a study's rows.
    #[must_use]
    pub fn new(
        quantity: &str,
        estimator: Option<Estimator>,
        spec: Option<SpecChoice>,
        mut rows: Vec<TrustGridRow>,
    ) -> Self {
        rows.sort_by(|a, b| (&a.group, &a.plant, &a.code, &a.subject).cmp(&(&b.group, &b.plant, &b.code, &b.subject)));
        for row in &mut rows {
            row.trials.sort_by(|a, b| (a.session, a.number, &a.trial).cmp(&(b.session, b.number, &b.trial)));
        }
        let levels: Vec<Level> = rows.iter().flat_map(|row| &row.trials).map(|cell| cell.trust.level).collect();
        let known: Vec<Level> = levels.iter().copied().filter(|level| *level != Level::NotIdentified).collect();
        Self {
            quantity: quantity.to_owned(),
            estimator,
            remarks: spec.iter().filter_map(SpecChoice::remark).collect(),
            spec,
            rule: crate::trust::RULE_VERSION,
            counts: TrustCounts::of(&levels),
            all: of_mean(&known),
            rows,
        }
    }
}
