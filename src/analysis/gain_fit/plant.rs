//! The plant of a fit as people write it: of the catalogue, or matrices in the request.

use crate::analysis::inputs::matrix::read_rows;
use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_inputs as wrong;
use crate::plants::ParametricPlant;
use crate::plants::seated_balance::{Drive, Output};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// Entries of larger magnitude would overflow in products of a few matrices.
pub(super) const LARGEST: f64 = 1e60;

/// The plant that the person controlled.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum GainFitPlant {
    /// A plant of the catalogue.
    #[schemars(title = "NamedPlant")]
    Named(NamedPlant),
    /// Matrices.
    #[schemars(title = "MatrixPlant")]
    Matrices(MatrixPlant),
}

/// A plant of the catalogue.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "GainFitNamedPlant")]
pub struct NamedPlant {
    /// Its name: `seated_balance`.
    pub name: ParametricPlant,
    /// Values that differ from Table 5.1's, by name: stiffnesses in N m/rad, dampings in N m s/rad, masses in kg,
    /// inertias in kg m², lengths in m. Free parameters are started there.
    #[serde(default)]
    pub values: BTreeMap<String, f64>,
    /// What moves the seat: `torque` (default) or `rotation`.
    #[serde(default = "torque")]
    pub drive: Drive,
    /// What the columns of the trials' outputs are. Default: both angles.
    #[serde(default = "angles")]
    pub outputs: Vec<Output>,
}

fn torque() -> Drive {
    Drive::Torque
}

fn angles() -> Vec<Output> {
    vec![Output::LowerAngle, Output::UpperAngle]
}

/// A parameter that a plant in the request is affine in.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "GainFitPlantParameter")]
pub struct PlantParameter {
    /// Its name.
    pub name: String,
    /// Its value where it is not fitted, and a start where it is; in a unit of its own.
    pub nominal: f64,
    /// What a unit of it adds to A, n×n, in the unit of A per unit of the parameter. Default: nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub a: Option<Vec<Vec<f64>>>,
    /// What a unit of it adds to B, n×m, in the unit of B per unit of the parameter. Default: nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub b: Option<Vec<Vec<f64>>>,
    /// What a unit of it adds to C, p×n, in the unit of C per unit of the parameter. Default: nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub c: Option<Vec<Vec<f64>>>,
    /// What a unit of it adds to D, p×m, in the unit of D per unit of the parameter. Default: nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub d: Option<Vec<Vec<f64>>>,
    /// What a unit of it adds to E, n×q, in the unit of E per unit of the parameter. Default: nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub e: Option<Vec<Vec<f64>>>,
    /// What a unit of it adds to F, p×q, in the unit of F per unit of the parameter. Default: nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub f: Option<Vec<Vec<f64>>>,
}

/// A plant as matrices, `x⁺ = Ax + Bu + Ew`, `y = Cx + Du + Fw`, with `u = −Kx`; w is what the experimenter does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "GainFitMatrixPlant")]
pub struct MatrixPlant {
    /// A, n×n: in the unit of `x⁺` per unit of the state, so 1/s of it in continuous time.
    pub a: Vec<Vec<f64>>,
    /// B, n×m: in the unit of `x⁺` per unit of the control.
    pub b: Vec<Vec<f64>>,
    /// C, p×n: in the unit of the output per unit of the state. Default: the identity, all states measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub c: Option<Vec<Vec<f64>>>,
    /// D, p×m: in the unit of the output per unit of the control. Default: zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub d: Option<Vec<Vec<f64>>>,
    /// E, n×q: in the unit of `x⁺` per unit of the input w. Default: B, an input that is added to the control.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub e: Option<Vec<Vec<f64>>>,
    /// F, p×q: in the unit of the output per unit of the input w. Default: zero; D where E is B.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub f: Option<Vec<Vec<f64>>>,
    /// Sample time in seconds; null in continuous time.
    #[serde(default)]
    pub sample_time_s: Option<f64>,
    /// Parameters that the matrices are affine in.
    #[serde(default)]
    pub parameters: Vec<PlantParameter>,
}

impl GainFitPlant {
    /// Reads the member `plant` of the inputs.
    pub(super) fn read(value: &Value) -> Result<Self, Problem> {
        const AT: &str = "/inputs/plant";
        let read = |error: serde_json::Error| {
            wrong(error.to_string(), AT).mend(
                "Give {\"name\": \"seated_balance\", \"values\": {..}, \"drive\", \"outputs\"}, or {\"a\", \"b\", \
                 \"c\", \"d\", \"e\", \"f\", \"sample_time_s\", \"parameters\"} with row-major nested arrays.",
            )
        };
        if value.get("name").is_some() {
            return serde_json::from_value(value.clone()).map(Self::Named).map_err(read);
        }
        for name in ["a", "b", "c", "d", "e", "f"] {
            // The matrices first, one by one, since the deserialiser does not say which row or entry is wrong.
            if let Some(rows) = value.get(name).filter(|rows| !rows.is_null()) {
                read_rows(rows, &name.to_uppercase(), &format!("{AT}/{name}"))?;
            }
        }
        serde_json::from_value(value.clone()).map(Self::Matrices).map_err(read)
    }
}
