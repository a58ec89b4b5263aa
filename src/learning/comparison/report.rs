//! What a comparison of a study's groups answers.

use super::metric::{GroupMetric, PairMetric};
use super::multiple::Correction;
use super::people::CurveForm;
use super::people_counts::{GroupCounts, PairCounts};
use super::series::PracticeAxis;
use crate::learning::inputs::{PlantName, Remark, SpecChoice};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The settings, as used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ComparisonSettings {
    /// What a person's first and last value are.
    pub curve: CurveForm,
    /// How p-values are adjusted.
    pub correction: Correction,
    /// Whether people whose value is an extrapolation are left out of means and tests.
    pub leave_out_extrapolated: bool,
    /// Trials that retention averages over at the end and at the start of a session, at most.
    pub retention_trials: usize,
    /// The threshold on |u| of the first deliberate control, in units of u.
    pub right_control_threshold: f64,
    /// The seed of random allocations, where there are too many for all of them.
    pub seed: u64,
}

/// One group on one plant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ComparedGroup {
    /// The group; null for subjects without one.
    pub group: Option<String>,
    /// The plant.
    pub plant: PlantName,
    /// The spec whose identifications are compared; null where no trial is identified.
    pub spec: Option<SpecChoice>,
    /// Its axis of practice: from the first to the last trial of this group and of those that it is compared with.
    pub practice: PracticeAxis,
    /// People.
    pub people: usize,
    /// Each metric: curves, means, changes.
    pub metrics: Vec<GroupMetric>,
    /// Divergent trials and first controls.
    pub counts: GroupCounts,
}

/// Two groups.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ComparedPair {
    /// The index of the first group among `groups`.
    pub first: usize,
    /// The index of the second, from which the first is subtracted.
    pub second: usize,
    /// Each metric.
    pub metrics: Vec<PairMetric>,
    /// Divergent trials and first controls.
    pub counts: PairCounts,
}

/// How many tests each p-value was adjusted for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Families {
    /// Differences between groups: metrics × contrasts × pairs.
    pub differences: usize,
    /// Changes within groups.
    pub changes: usize,
    /// Differences of counts.
    pub counts: usize,
}

/// The comparison of a study's groups.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StudyComparison {
    /// The settings, as used.
    pub settings: ComparisonSettings,
    /// Every group on every plant it worked with.
    pub groups: Vec<ComparedGroup>,
    /// Every pair of different groups: on each plant that both worked with, and where they share none, across plants.
    pub pairs: Vec<ComparedPair>,
    /// How many tests the p-values are adjusted for, family by family.
    pub families: Families,
    /// What was found, and what so many people can and cannot show, sentence by sentence.
    pub findings: Vec<String>,
    /// What must be read before using the numbers.
    pub remarks: Vec<Remark>,
}
