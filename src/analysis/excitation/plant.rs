//! The plant of a request: a model, the id of a stored one, or the mass and damping of a linear drive.

use super::problems;
use crate::analysis::ids::PlantId;
use crate::analysis::inputs::library::Library;
use crate::analysis::inputs::plant::{check_plant, parse_model};
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::{read, wrong_inputs as wrong};
use crate::analysis::report::sha256_json;
use crate::control::model::TransferFunctionModel;
use crate::control::{Discrete, Model};
use crate::excite::path::{Discretisation, SampledPlant};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// `P(s) = 1/(m s² + c s)` from force to position: the linear drive of a manipulandum.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MassDamper {
    /// m, kg.
    pub mass_kg: f64,
    /// c, N s/m; may be 0.
    pub damping_ns_per_m: f64,
}

/// A plant of a request.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum PlantInput {
    /// A linear drive.
    #[schemars(title = "MassDamperPlant")]
    MassDamper(MassDamper),
    /// A model in the request.
    #[schemars(title = "ModelPlant")]
    Model(Model),
    /// The id of a stored plant.
    #[schemars(title = "StoredPlant")]
    Stored(PlantId),
}

impl PlantInput {
    /// Checks it as far as it goes without its surroundings.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(value: &Value, at: &str) -> Result<Self, Problem> {
        if let Some(text) = value.as_str() {
            return text
                .parse()
                .map(Self::Stored)
                .map_err(|_| wrong(format!("{text:?} is no id of a plant"), at).mend("Ids are UUIDs."));
        }
        if value.get("mass_kg").is_some() || value.get("damping_ns_per_m").is_some() {
            let drive: MassDamper = read(value, at, "unusable plant")?;
            let probe =
                Discrete::new(1e-3).map_err(|error| Problem::new(Code::Internal, "no probe", error.to_string()))?;
            SampledPlant::mass_damper(drive.mass_kg, drive.damping_ns_per_m, probe).map_err(|e| problems::path(&e))?;
            return Ok(Self::MassDamper(drive));
        }
        let model = parse_model(value, at)?;
        check_plant(&model, at)?;
        Ok(Self::Model(model))
    }

    /// The stored plant that it names.
    #[must_use]
    pub fn id(&self) -> Option<PlantId> {
        if let Self::Stored(id) = self { Some(*id) } else { None }
    }

    /// SHA-256 of its content: of a stored plant that of its model.
    ///
    /// # Errors
    /// `not_found` for a stored plant that is gone.
    pub fn sha256(&self, library: &Library, at: &str) -> Result<String, Problem> {
        Ok(sha256_json(&match self {
            Self::MassDamper(drive) => json!(drive),
            Self::Model(model) => json!(model),
            Self::Stored(id) => json!(library.plant(*id).map_err(|problem| problem.at(at))?),
        }))
    }

    /// The plant as signals of this sample time see it.
    ///
    /// # Errors
    /// A [`Problem`] where it is gone, or cannot be sampled so.
    pub fn sample(
        &self,
        library: &Library,
        how: Discretisation,
        time: Discrete,
        at: &str,
    ) -> Result<SampledPlant, Problem> {
        let model = match self {
            Self::MassDamper(MassDamper { mass_kg, damping_ns_per_m }) => {
                if how == Discretisation::ZeroOrderHold {
                    return SampledPlant::mass_damper(*mass_kg, *damping_ns_per_m, time)
                        .map_err(|e| problems::path(&e));
                }
                let den = vec![*mass_kg, *damping_ns_per_m, 0.0];
                &Model::TransferFunction(TransferFunctionModel {
                    num: vec![1.0],
                    den,
                    sample_time_s: None,
                    delay_s: None,
                })
            }
            Self::Model(model) => model,
            Self::Stored(id) => library.plant(*id).map_err(|problem| problem.at(at))?,
        };
        SampledPlant::new(&check_plant(model, at)?, how, time).map_err(|e| problems::path(&e))
    }
}
