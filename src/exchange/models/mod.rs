//! The models and matrices of a report, as python-control and MATLAB take them.
//!
//! Every system that a report holds is found by its form and named by its place (`refined_feedforward`); nothing about
//! a kind of analysis is known here. The time base stands beside the coefficients in three ways, since each program
//! asks for another, and so does the response at a few frequencies: a loader can see that it has read the same system.
//! [`found`] finds the systems, [`multivariable`] has those with several inputs and outputs, [`files`] writes MATLAB's.

mod files;
mod found;
mod multivariable;

pub use files::mat;
pub use multivariable::{ExportedStateSpace, ExportedTransferMatrix, MatrixResponse};

use crate::analysis::{Code, Problem, Report};
use crate::control::{Model, System};
use crate::num::Complex64;
use found::Found;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Matrices at the top of a result.
const MATRICES: [&str; 11] = ["k", "l", "q", "r", "w", "v", "p", "a", "b", "c", "d"];

/// Frequencies at which the response is told.
const CHECKS: usize = 9;

/// The ends of those frequencies in continuous time, in rad/s.
const CONTINUOUS_RAD_S: [f64; 2] = [0.05, 20.0];

/// The share of the fastest frequency that a sampled system can have, at which those of one end.
const OF_NYQUIST: f64 = 0.9;

/// In which time a model is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ModelTimeBase {
    /// Coefficients are of powers of s.
    Continuous,
    /// Coefficients are of powers of z.
    Discrete,
}

impl ModelTimeBase {
    fn name(self) -> &'static str {
        match self {
            Self::Continuous => "continuous",
            Self::Discrete => "discrete",
        }
    }
}

/// The response of a model without its delay, for a loader to compare with its own.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ModelResponse {
    /// Angular frequencies in rad/s.
    pub omega_rad_s: Vec<f64>,
    /// The response at each as `[re, im]`, in the unit of the model's output per unit of its input.
    pub value: Vec<[f64; 2]>,
}

/// A linear system of a report.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ExportedModel {
    /// Where it stands in the result, as a JSON pointer.
    pub pointer: String,
    /// In which time it is.
    pub time_base: ModelTimeBase,
    /// Time between samples in seconds; null in continuous time.
    pub sample_time_s: Option<f64>,
    /// The same as python-control (`dt`) and MATLAB (`Ts`) write it, in seconds: 0 in continuous time.
    pub dt: f64,
    /// Numerator coefficients, descending powers.
    pub num: Vec<f64>,
    /// Denominator coefficients, descending powers.
    pub den: Vec<f64>,
    /// The pure delay behind it in seconds, which is no part of `num` and `den`; 0 where there is none.
    pub delay_s: f64,
    /// The response of `num/den`.
    pub response: ModelResponse,
}

/// A matrix of a report.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ExportedMatrix {
    /// Its rows, in the units that the kind of analysis documents.
    pub value: Vec<Vec<f64>>,
    /// The covariance of its entries, in the order that the kind of analysis documents, in products of their units;
    /// null where there is none.
    pub covariance: Option<Vec<Vec<f64>>>,
}

/// An estimated coefficient, gain, delay or other number.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ExportedParameter {
    /// Its name in the report; of a controller's coefficient such as `feedback_denominator[1]`, counted from the
    /// highest power.
    pub name: String,
    /// The estimate in its own unit.
    pub value: Option<f64>,
    /// Its standard error in the same unit; null where there is none.
    pub standard_error: Option<f64>,
    /// Its 95 % interval in the same unit; null where there is none.
    pub interval_95: Option<[f64; 2]>,
}

/// Everything of a report that other programs compute with.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ModelExport {
    /// The kind of analysis.
    pub kind: String,
    /// SHA-256 of its spec.
    pub spec_sha256: String,
    /// SHA-256 of its result.
    pub result_sha256: String,
    /// Version of the program that computed it.
    pub product_version: String,
    /// Systems of one input and one output by name.
    pub models: BTreeMap<String, ExportedModel>,
    /// Systems in state space by name.
    pub state_space: BTreeMap<String, ExportedStateSpace>,
    /// Matrices of transfer functions by name.
    pub transfer_matrices: BTreeMap<String, ExportedTransferMatrix>,
    /// Matrices by name.
    pub matrices: BTreeMap<String, ExportedMatrix>,
    /// The estimated parameters with their errors, in the order of the report.
    pub parameters: Vec<ExportedParameter>,
    /// The covariance of the parameters in that order, in products of their units; null where the report has none: then
    /// the standard errors are all that is known.
    pub covariance: Option<Vec<Vec<f64>>>,
}

/// The angular frequencies in rad/s at which the response of a system with this sample time is told.
fn frequencies(sample_time_s: Option<f64>) -> impl Iterator<Item = f64> {
    let [from, to] = match sample_time_s {
        None => CONTINUOUS_RAD_S,
        Some(period) => [CONTINUOUS_RAD_S[0].min(0.01 * PI / period), OF_NYQUIST * PI / period],
    };
    (0..CHECKS).map(move |k| from * (to / from).powf(k as f64 / (CHECKS - 1) as f64))
}

fn response(system: &System) -> ModelResponse {
    let values = frequencies(system.sample_time_s()).map(|omega| (omega, system.response(omega)));
    // A pole on the axis has no response.
    let finite: Vec<(f64, Complex64)> = values.filter(|(_, z)| z.re.is_finite() && z.im.is_finite()).collect();
    ModelResponse {
        omega_rad_s: finite.iter().map(|(omega, _)| *omega).collect(),
        value: finite.iter().map(|(_, z)| [z.re, z.im]).collect(),
    }
}

impl ModelTimeBase {
    /// The time base, and the sample time in seconds as python-control and MATLAB write it.
    fn of(sample_time_s: Option<f64>) -> (Self, f64) {
        sample_time_s.map_or((Self::Continuous, 0.0), |period| (Self::Discrete, period))
    }
}

fn exported(found: Found) -> Option<ExportedModel> {
    let pointer = found.pointer();
    let model: Model = serde_json::from_value(found.value).ok()?;
    let Model::TransferFunction(mut own) = model else { return None };
    let delay_s = own.delay_s.take().or(found.delay_s).unwrap_or(0.0);
    let system = Model::TransferFunction(own.clone()).check().ok()?;
    let (time_base, dt) = ModelTimeBase::of(own.sample_time_s);
    Some(ExportedModel {
        pointer,
        time_base,
        sample_time_s: own.sample_time_s,
        dt,
        num: own.num,
        den: own.den,
        delay_s,
        response: response(&system),
    })
}

/// Rows of equal length.
fn matrix(value: Option<&Value>) -> Option<Vec<Vec<f64>>> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value?.clone()).ok()?;
    let columns = rows.first()?.len();
    rows.iter().all(|row| row.len() == columns).then_some(rows)
}

fn matrices(result: &Value) -> BTreeMap<String, ExportedMatrix> {
    let inverse = ["", "regulator", "filter", "inverse_lqg_inputs", "inverse_lqr_inputs"];
    let mut found = BTreeMap::new();
    for part in inverse {
        let of = if part.is_empty() { Some(result) } else { result.get(part) };
        for name in MATRICES {
            let Some(value) = matrix(of.and_then(|of| of.get(name))) else { continue };
            let covariance = matrix(of.and_then(|of| of.get(format!("{name}_covariance"))));
            // The same matrix asked on is no other one.
            found.entry(name.to_owned()).or_insert(ExportedMatrix { value, covariance });
        }
    }
    found
}

/// The estimated parameters of a result, and their covariance where it has one of all of them.
fn parameters(result: &Value) -> (Vec<ExportedParameter>, Option<Vec<Vec<f64>>>) {
    let best = result.get("best").and_then(Value::as_u64).and_then(|best| usize::try_from(best).ok());
    let fitted = best.and_then(|best| result.get("fits")?.get(best));
    let owners = [Some(result), result.pointer("/refined/uncertainty"), fitted];
    let listed = |owner: &Value| Some((owner.get("parameters")?.as_array()?.clone(), owner.get("covariance").cloned()));
    let Some((list, covariance)) = owners.into_iter().flatten().find_map(listed) else { return Default::default() };
    let number = |own: &Value, names: [&str; 2]| names.iter().find_map(|name| own.get(name)?.as_f64());
    let one = |own: &Value| {
        let ends = own.get("interval").or(own.get("interval_95")).filter(|ends| !ends.is_null());
        Some(ExportedParameter {
            name: own.get("name")?.as_str()?.to_owned(),
            value: own.get("value").and_then(Value::as_f64),
            standard_error: number(own, ["standard_error", "standard_deviation"]),
            interval_95: ends.and_then(|ends| serde_json::from_value(ends.clone()).ok()),
        })
    };
    let parameters: Vec<ExportedParameter> = list.iter().filter_map(one).collect();
    let count = parameters.len();
    let is_of_all = |rows: &Vec<Vec<f64>>| rows.len() == count && rows.iter().all(|row| row.len() == count);
    (parameters, matrix(covariance.as_ref()).filter(is_of_all))
}

/// The systems of one input and one output of a report by their names.
#[must_use]
pub fn models(result: &Value) -> BTreeMap<String, ExportedModel> {
    let named = found::systems(result).into_iter().filter_map(|own| Some((own.name(), exported(own)?)));
    named.collect()
}

/// What other programs compute with.
///
/// # Errors
/// `not_found` where the report has neither systems nor matrices.
pub fn export(report: &Report) -> Result<ModelExport, Problem> {
    let result = &report.result;
    let (models, matrices) = (models(result), matrices(result));
    let (state_space, transfer_matrices) = multivariable::systems(result);
    let has_systems = !models.is_empty() || !state_space.is_empty() || !transfer_matrices.is_empty();
    if !has_systems && matrices.is_empty() {
        let why = format!("a result of {} has no models and no matrices", report.kind);
        return Err(Problem::new(Code::NotFound, "no models", why).mend("Read the report instead."));
    }
    let (parameters, covariance) = parameters(result);
    Ok(ModelExport {
        kind: report.kind.to_string(),
        spec_sha256: report.provenance.spec_sha256.clone(),
        result_sha256: report.provenance.result_sha256.clone(),
        product_version: report.provenance.product_version.clone(),
        models,
        state_space,
        transfer_matrices,
        matrices,
        parameters,
        covariance,
    })
}
