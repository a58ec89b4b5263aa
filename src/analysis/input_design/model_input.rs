//! The model whose parameters an experiment is to tell, as people write it: of the catalogue, or formulas in the
//! request.

use super::refusal::{TITLE, wrong};
use crate::analysis::problem::Problem;
use crate::analysis::reading;
use crate::plants::head_neck::Axis;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// Names of a model of the catalogue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "InputDesignModelName")]
pub enum ModelName {
    /// Seated balance on a robot's seat (Priess 2015, chapter 5); the input is the torque on the seat, N m.
    SeatedBalance,
    /// The head tracking a target (Priess 2015, chapter 2); the input is the target's angle, rad.
    HeadNeck,
    /// Two masses in a chain (Zhang 2015, equations 3.1 to 3.3), of m1, m2, c1, c2, k1 and k2; the input is the force
    /// on the second.
    TwoMass,
    /// The linear drive of a manipulandum (Qiu 2021, section IV.B), of mass and damping; the input is its force.
    LinearDrive,
    /// Gain, zero, damping and stiffness, with a minimum-phase zero (Zhang 2015, equation 5.4).
    MinimumPhase,
    /// The same with a nonminimum-phase zero (equation 5.5).
    NonminimumPhase,
    /// The same with a slow one (equation 5.6).
    SlowNonminimumPhase,
    /// A velocity: a gain.
    Integrator,
    /// A force on a unit mass with unit damping: mass and damping.
    DampedDoubleIntegrator,
}

/// A model of the catalogue.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "InputDesignNamedModel")]
pub struct NamedModel {
    /// Its name.
    pub name: ModelName,
    /// Values that differ from the tables', by name, in SI units (N m/rad, kg, s, …).
    #[serde(default)]
    pub values: BTreeMap<String, f64>,
    /// The parameters that the experiment is to tell. Default: k1 … k4, j1, j2, l1, l12, l2, tau and t_w of seated
    /// balance, k_p, k_d, k_i and tau of the head, all of the others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub free: Option<Vec<String>>,
    /// The state at the beginning: of seated balance α₁, α̇₁, α₂, α̇₂; of the others but the head their own states; in
    /// rad and rad/s, m and m/s. Default: at rest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub initial: Option<Vec<f64>>,
    /// Order of the Padé approximation of the delay, of seated balance and the head. Default: 5.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay_order: Option<usize>,
    /// About which axis the head turns, of the head. Default: flexion_extension.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis: Option<Axis>,
}

/// A parameter of a model in the request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "InputDesignModelParameter")]
pub struct ModelParameter {
    /// Its name, as formulas call it.
    pub name: String,
    /// Its value, in a unit of its own.
    pub value: f64,
    /// Whether the experiment is to tell it. Default: true.
    #[serde(default = "yes")]
    pub free: bool,
    /// The least value that a fit may give it, in the same unit. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lower: Option<f64>,
    /// The largest value that a fit may give it, in the same unit. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub upper: Option<f64>,
}

fn yes() -> bool {
    true
}

/// An entry of a matrix: a number, or a formula in the parameters such as `"-(k + k_h)/m"`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
#[schemars(rename = "InputDesignEntry")]
pub enum Entry {
    /// A number.
    #[schemars(title = "Number")]
    Number(f64),
    /// A formula: numbers, names, `+ - * / ^`, parentheses, `sin`, `cos`, `pi`.
    #[schemars(title = "Formula")]
    Formula(String),
}

/// A model in the request: `x⁺ = Ax + Bu`, `y = Cx + Du`, `x(0) = x₀`, with entries that are formulas in the
/// parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "InputDesignFormulaModel")]
pub struct FormulaModel {
    /// The parameters.
    pub parameters: Vec<ModelParameter>,
    /// A, n×n: in the unit of `x⁺` per unit of the state, so 1/s of it in continuous time.
    pub a: Vec<Vec<Entry>>,
    /// B, n×m: in the unit of `x⁺` per unit of the input.
    pub b: Vec<Vec<Entry>>,
    /// C, p×n: in the unit of the output per unit of the state.
    pub c: Vec<Vec<Entry>>,
    /// D, p×m: in the unit of the output per unit of the input. Default: zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub d: Option<Vec<Vec<Entry>>>,
    /// x₀, n entries in the units of the states. Default: at rest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub initial: Option<Vec<Entry>>,
    /// Names of the outputs. Default: y1, y2, ….
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outputs: Option<Vec<String>>,
    /// Sample time in seconds; null in continuous time, whose inputs are held between samples.
    #[serde(default)]
    pub sample_time_s: Option<f64>,
}

/// A model as written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
#[schemars(rename = "InputDesignModel")]
pub enum ModelInput {
    /// Of the catalogue.
    #[schemars(title = "NamedModel")]
    Named(NamedModel),
    /// In the request.
    #[schemars(title = "FormulaModel")]
    Formulas(FormulaModel),
}

impl ModelInput {
    /// Reads the member `model` of the inputs.
    pub(super) fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        const FORMS: &str = "Give {\"name\": \"seated_balance\", \"head_neck\" or that of a plant, ..}, or matrices a, \
            b and c of numbers and formulas with their parameters.";
        let members = value.as_object().ok_or_else(|| wrong("the model is no object", at).mend(FORMS))?;
        // One form or the other, so that errors speak of the form that is meant.
        if members.contains_key("name") {
            reading::read(value, at, TITLE).map(Self::Named)
        } else {
            reading::read(value, at, TITLE).map(Self::Formulas)
        }
        .map_err(|problem| problem.mend(FORMS))
    }
}
