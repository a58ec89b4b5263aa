//! The loop that is designed for.

use crate::analysis::contract::{Inputs, Part};
use crate::analysis::excitation::plant::PlantInput;
use crate::analysis::excitation::signal_input::SignalInput;
use crate::analysis::inputs::library::{Library, References};
use crate::analysis::problem::Problem;
use crate::analysis::reading::{object, only, wrong_inputs as wrong};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;

/// Where the signal and the plant are in a request.
pub(super) const SIGNAL: &str = "/inputs/signal";
pub(super) const PLANT: &str = "/inputs/plant";

/// The plant of the position loop, and the signal that is the position asked for.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct CompensatorDesignInputs {
    /// The plant, from force to position.
    pub plant: PlantInput,
    /// The position asked for.
    pub signal: SignalInput,
}

impl Part for CompensatorDesignInputs {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        let members = object(value, "the inputs", at)?;
        only(members, &["plant", "signal"], at)?;
        let needed =
            |name: &str, place: &str| members.get(name).ok_or_else(|| wrong(format!("there is no {name}"), place));
        let plant = PlantInput::parse(needed("plant", PLANT)?, PLANT)?;
        Ok(Self { plant, signal: SignalInput::parse(needed("signal", SIGNAL)?, SIGNAL)? })
    }
}

impl Inputs for CompensatorDesignInputs {
    fn references(&self) -> References {
        let mut references = self.signal.references();
        references.plants.extend(self.plant.id());
        references
    }

    fn sha256(&self, library: &Library) -> Result<BTreeMap<String, String>, Problem> {
        Ok(BTreeMap::from([
            (SIGNAL.to_owned(), self.signal.sha256(library, SIGNAL)?),
            (PLANT.to_owned(), self.plant.sha256(library, PLANT)?),
        ]))
    }
}
