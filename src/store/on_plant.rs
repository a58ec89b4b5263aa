//! A trial that turns out to have been recorded on another plant.

use crate::analysis::Warning;
use crate::analysis::ids::PlantId;

/// A plant that a trial was recorded on after all, with what follows from it.
#[derive(Debug, Clone, PartialEq)]
pub struct OnPlant {
    /// The plant, of the same study.
    pub plant: PlantId,
    /// Time-domain metrics on this plant, a JSON object.
    pub metrics: serde_json::Value,
    /// What must be read before the trial is used.
    pub warnings: Vec<Warning>,
}
