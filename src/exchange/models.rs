//! The models and matrices of a report, as python-control and MATLAB take them.
//!
//! Every system that a report holds is found by its form and named by its place (`refined_feedforward`); nothing about
//! a kind of analysis is known here. The time base stands beside the coefficients in three ways, since each program
//! asks for another, and so does the response at a few frequencies: a loader can see that it has read the same system.

use super::write::mat::{self, MatValue};
use crate::analysis::{Code, Problem, Report};
use crate::control::{Model, System};
use crate::num::Complex64;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Members whose systems are alternatives to the answer, and many.
const ALTERNATIVES: [&str; 3] = ["near_optimal", "equivalent", "delayed"];

/// Segments of a place that say nothing.
const SILENT: [&str; 2] = ["rational", "model"];

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
    /// Systems by name.
    pub models: BTreeMap<String, ExportedModel>,
    /// Matrices by name.
    pub matrices: BTreeMap<String, ExportedMatrix>,
    /// The estimated parameters with their errors, in the order of the report.
    pub parameters: Vec<ExportedParameter>,
    /// The covariance of the parameters in that order, in products of their units; null where the report has none: then
    /// the standard errors are all that is known.
    pub covariance: Option<Vec<Vec<f64>>>,
}

/// A place in a result: the segments of its pointer.
type Place = Vec<String>;

fn systems(value: &Value, place: &mut Place, found: &mut Vec<(Place, Value, Option<f64>)>) {
    match value {
        Value::Object(members) => {
            for (name, member) in members.iter().filter(|(name, _)| !ALTERNATIVES.contains(&name.as_str())) {
                place.push(name.clone());
                let is_system = member.get("den").is_some() && member.get("num").is_some();
                if is_system {
                    // A delay stands beside the system, under its name or (of a reduction) alone.
                    let beside = members.get(&format!("{name}_delay_s"));
                    let beside = beside.or(members.get("delay_s").filter(|_| name == "model"));
                    found.push((place.clone(), member.clone(), beside.and_then(Value::as_f64)));
                } else {
                    systems(member, place, found);
                }
                place.pop();
            }
        }
        // Long arrays are numbers.
        Value::Array(members) if members.iter().any(|member| member.is_object() || member.is_array()) => {
            for (i, member) in members.iter().enumerate() {
                place.push(i.to_string());
                if member.get("den").is_some() && member.get("num").is_some() {
                    found.push((place.clone(), member.clone(), None));
                } else if !member.as_array().is_some_and(|own| own.iter().all(Value::is_number)) {
                    systems(member, place, found);
                }
                place.pop();
            }
        }
        _ => {}
    }
}

fn name(place: &[String]) -> String {
    let said: Vec<&str> = place.iter().map(String::as_str).filter(|segment| !SILENT.contains(segment)).collect();
    said.join("_")
}

fn response(system: &System) -> ModelResponse {
    let [from, to] = match system.sample_time_s() {
        None => CONTINUOUS_RAD_S,
        Some(period) => [CONTINUOUS_RAD_S[0].min(0.01 * PI / period), OF_NYQUIST * PI / period],
    };
    let at = |k: usize| from * (to / from).powf(k as f64 / (CHECKS - 1) as f64);
    let omega: Vec<f64> = (0..CHECKS).map(at).collect();
    let values = omega.iter().map(|omega| (*omega, system.response(*omega)));
    // A pole on the axis has no response.
    let finite: Vec<(f64, Complex64)> = values.filter(|(_, z)| z.re.is_finite() && z.im.is_finite()).collect();
    ModelResponse {
        omega_rad_s: finite.iter().map(|(omega, _)| *omega).collect(),
        value: finite.iter().map(|(_, z)| [z.re, z.im]).collect(),
    }
}

fn exported(place: &[String], value: Value, beside: Option<f64>) -> Option<ExportedModel> {
    let model: Model = serde_json::from_value(value).ok()?;
    let Model::TransferFunction(mut own) = model else { return None };
    let delay_s = own.delay_s.take().or(beside).unwrap_or(0.0);
    let system = Model::TransferFunction(own.clone()).check().ok()?;
    let (time_base, dt) = match own.sample_time_s {
        None => (ModelTimeBase::Continuous, 0.0),
        Some(period) => (ModelTimeBase::Discrete, period),
    };
    Some(ExportedModel {
        pointer: place.iter().map(|segment| format!("/{segment}")).collect(),
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

fn parameters(result: &Value) -> Vec<ExportedParameter> {
    let best = result.get("best").and_then(Value::as_u64).and_then(|best| usize::try_from(best).ok());
    let fitted = best.and_then(|best| result.get("fits")?.get(best)?.get("parameters"));
    let list = [result.get("parameters"), result.pointer("/refined/uncertainty/parameters"), fitted];
    let list = list.into_iter().flatten().find_map(Value::as_array);
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
    list.into_iter().flatten().filter_map(one).collect()
}

/// The systems of a report by their names.
#[must_use]
pub fn models(result: &Value) -> BTreeMap<String, ExportedModel> {
    let mut found = Vec::new();
    systems(result, &mut Vec::new(), &mut found);
    let named = found.into_iter().filter_map(|(place, value, beside)| {
        let own = exported(&place, value, beside)?;
        Some((name(&place), own))
    });
    named.collect()
}

/// What other programs compute with.
///
/// # Errors
/// `not_found` where the report has neither systems nor matrices.
pub fn export(report: &Report) -> Result<ModelExport, Problem> {
    let result = &report.result;
    let (models, matrices) = (models(result), matrices(result));
    if models.is_empty() && matrices.is_empty() {
        let why = format!("a result of {} has no models and no matrices", report.kind);
        return Err(Problem::new(Code::NotFound, "no models", why).mend("Read the report instead."));
    }
    Ok(ModelExport {
        kind: report.kind.to_string(),
        spec_sha256: report.provenance.spec_sha256.clone(),
        result_sha256: report.provenance.result_sha256.clone(),
        product_version: report.provenance.product_version.clone(),
        models,
        matrices,
        parameters: parameters(result),
        covariance: matrix(result.get("covariance")),
    })
}

fn optional(value: Option<f64>) -> MatValue {
    MatValue::number(value.unwrap_or(f64::NAN))
}

/// As a file of MATLAB: a struct for each system (`num`, `den`, `Ts`, `delay_s`, `time_base`, and the response to
/// compare with), a variable for each matrix and its covariance, and `volition`, which says where it is from.
#[must_use]
pub fn mat(export: &ModelExport) -> Vec<u8> {
    let text = |text: &str| MatValue::Text(text.to_owned());
    let mut variables = Vec::new();
    for (name, own) in &export.models {
        let part = |at: usize| own.response.value.iter().map(|z| z[at]).collect::<Vec<_>>();
        let fields = [
            ("num", MatValue::row(&own.num)),
            ("den", MatValue::row(&own.den)),
            ("Ts", MatValue::number(own.dt)),
            ("delay_s", MatValue::number(own.delay_s)),
            ("time_base", text(own.time_base.name())),
            ("omega_rad_s", MatValue::row(&own.response.omega_rad_s)),
            ("response_re", MatValue::row(&part(0))),
            ("response_im", MatValue::row(&part(1))),
            ("pointer", text(&own.pointer)),
        ];
        let fields = fields.map(|(name, value)| (name.to_owned(), value));
        variables.push((name.clone(), MatValue::Struct(fields.into())));
    }
    for (name, own) in &export.matrices {
        variables.push((name.clone(), MatValue::Matrix(own.value.clone())));
        if let Some(covariance) = &own.covariance {
            variables.push((format!("{name}_covariance"), MatValue::Matrix(covariance.clone())));
        }
    }
    let estimates: Vec<Vec<f64>> = export
        .parameters
        .iter()
        .map(|own| {
            let [low, high] = own.interval_95.unwrap_or([f64::NAN; 2]);
            vec![own.value.unwrap_or(f64::NAN), own.standard_error.unwrap_or(f64::NAN), low, high]
        })
        .collect();
    let names: Vec<&str> = export.parameters.iter().map(|own| own.name.as_str()).collect();
    let about = vec![
        ("kind".to_owned(), text(&export.kind)),
        ("spec_sha256".to_owned(), text(&export.spec_sha256)),
        ("result_sha256".to_owned(), text(&export.result_sha256)),
        ("product_version".to_owned(), text(&export.product_version)),
        ("parameter_names".to_owned(), text(&names.join(","))),
        ("parameters".to_owned(), MatValue::Matrix(estimates)),
        ("covariance".to_owned(), export.covariance.clone().map_or(optional(None), MatValue::Matrix)),
    ];
    variables.push(("volition".to_owned(), MatValue::Struct(about)));
    mat::write(&variables)
}
