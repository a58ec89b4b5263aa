//! How the design is put: as written, and checked against the model.

use super::model::Model;
use super::wrong;
use crate::analysis::inverse::matrix;
use crate::analysis::problem::{Code, Problem};
use crate::excite::design::Criterion;
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Samples at most.
pub(super) const MAX_SAMPLES: usize = 2_000;
/// Records simulated and fitted at most.
const MAX_REPLICATES: usize = 2_000;
/// Steps at most.
const MAX_STEPS: usize = 2_000;

/// A largest magnitude, or a range.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Limit {
    /// The largest magnitude.
    Magnitude(f64),
    /// Least and largest value.
    Range([f64; 2]),
}

impl Limit {
    pub(super) fn range(self) -> [f64; 2] {
        match self {
            Self::Magnitude(most) => [-most, most],
            Self::Range(range) => range,
        }
    }
}

/// A limit on the difference of two outputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DifferenceLimit {
    /// The outputs: the first less the second.
    pub of: [String; 2],
    /// The limit.
    pub limit: Limit,
}

/// How predictable the input may be: its normalised autocorrelation stays within `tolerance` of a reference at the lags 1 to `lags`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AutocorrelationSpec {
    /// β. Default: 0.16.
    #[serde(default = "tolerance")]
    pub tolerance: f64,
    /// γ: steps aim at β − γ. Default: an eighth of β.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub margin: Option<f64>,
    /// The largest lag, in samples. Default: half of the record less 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lags: Option<usize>,
    /// The reference at the lags 1, 2, …. Default: the autocorrelation of each start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<Vec<f64>>,
}

fn tolerance() -> f64 {
    0.16
}

/// What the input must keep to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LimitsSpec {
    /// On every sample of the input.
    pub input: Limit,
    /// On the change of the input from sample to sample. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub input_change: Option<f64>,
    /// On outputs of the model, by name; measured or not, so that the person's torque is one of them.
    #[serde(default)]
    pub outputs: BTreeMap<String, Limit>,
    /// On differences of outputs.
    #[serde(default)]
    pub differences: Vec<DifferenceLimit>,
    /// On the autocorrelation. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub autocorrelation: Option<AutocorrelationSpec>,
}

/// Simulated records that are fitted anew, to check the predicted standard deviations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MonteCarloSpec {
    /// Records, of each of the two inputs. Default: 100.
    #[serde(default = "replicates")]
    pub replicates: usize,
    /// Seed of the noise. Default: 1.
    #[serde(default = "seed")]
    pub seed: u64,
}

fn replicates() -> usize {
    100
}
fn seed() -> u64 {
    1
}

/// The spec of `input_design`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InputDesignSpec {
    /// Length of the record in samples, N: 10 to 2,000.
    pub samples: usize,
    /// Sample time in seconds; that of the model, where it is a sampled one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sample_time_s: Option<f64>,
    /// What is made large. Default: `d`.
    #[serde(default = "criterion")]
    pub criterion: Criterion,
    /// Names of the measured outputs. Default: both angles of seated balance, the angle of the head, all outputs of a model in the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<Vec<String>>,
    /// Covariance of the noise of the measured outputs, samples being independent. Default: the identity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_covariance: Option<Vec<Vec<f64>>>,
    /// Scales of parameters for the scaled criteria, by name. Default: their magnitudes.
    #[serde(default)]
    pub scales: BTreeMap<String, f64>,
    /// Which input is designed, from 0; the others stay zero. Default: 0.
    #[serde(default)]
    pub input: usize,
    /// What the input must keep to.
    pub limits: LimitsSpec,
    /// Whether starts that break a limit are scaled down until they fit. Default: false.
    #[serde(default)]
    pub scale_to_fit: bool,
    /// δ_u: the largest change of a sample in a step. Default: a fortieth of the input's largest magnitude.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trust_region: Option<f64>,
    /// Relative growth of a step at which the climb ends. Default: 1e-3.
    #[serde(default = "growth")]
    pub tolerance: f64,
    /// Steps at most, from each start. Default: 200.
    #[serde(default = "steps")]
    pub max_steps: usize,
    /// Simulated records that are fitted anew. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub monte_carlo: Option<MonteCarloSpec>,
}

fn criterion() -> Criterion {
    Criterion::D
}
fn growth() -> f64 {
    1e-3
}
fn steps() -> usize {
    200
}

/// A checked spec.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CheckedSpec {
    pub written: InputDesignSpec,
    pub sample_time_s: f64,
    /// Places of the measured outputs.
    pub measured: Vec<usize>,
    pub covariance: DMatrix<f64>,
    pub scales: Vec<f64>,
    pub radius: f64,
}

impl CheckedSpec {
    pub fn parse(spec: &Value, model: &Model) -> Result<Self, Problem> {
        let members = spec.as_object().ok_or_else(|| wrong("the spec is no object", "/spec"))?;
        let mut written: InputDesignSpec = read(members)?;
        let wrong = |detail: String, field: &str| wrong(detail, format!("/spec/{field}"));
        if !(10..=MAX_SAMPLES).contains(&written.samples) {
            return Err(wrong(
                format!("there are {} samples; 10 to {MAX_SAMPLES} are taken", written.samples),
                "samples",
            ));
        }
        let sample_time_s = match (written.sample_time_s, model.sample_time_s()) {
            (Some(own), Some(models)) if own != models => {
                return Err(wrong(
                    format!("the sample time is {own} s, and that of the model {models} s"),
                    "sample_time_s",
                )
                .mend("Leave it out: a sampled model has its own."));
            }
            (None, None) => {
                return Err(wrong("the model is continuous, and no sample time is given".to_owned(), "sample_time_s")
                    .mend("Give the time between samples in seconds."));
            }
            (own, models) => models.or(own).unwrap_or_default(),
        };
        if !(sample_time_s > 0.0 && sample_time_s.is_finite()) {
            return Err(wrong(format!("{sample_time_s} is no positive number of seconds"), "sample_time_s"));
        }
        written.sample_time_s = Some(sample_time_s);
        if written.input >= model.inputs {
            return Err(wrong(format!("there is no input {}: the model has {}", written.input, model.inputs), "input"));
        }
        let place = |name: &str, field: String| {
            model.outputs.iter().position(|known| known == name).ok_or_else(|| {
                wrong(format!("the model has no output {name:?}"), &field)
                    .mend(format!("Its outputs are {}.", model.outputs.join(", ")))
            })
        };
        let names = written.measured.get_or_insert_with(|| model.measured.clone());
        let measured: Vec<usize> =
            names.iter().enumerate().map(|(i, name)| place(name, format!("measured/{i}"))).collect::<Result<_, _>>()?;
        if measured.is_empty() || (0..measured.len()).any(|i| measured[..i].contains(&measured[i])) {
            return Err(wrong("no output is measured, or one of them twice".to_owned(), "measured"));
        }
        let p = measured.len();
        let covariance = match &written.noise_covariance {
            None => DMatrix::identity(p, p),
            Some(rows) => {
                let found = matrix(&json!(rows), "the covariance", "/spec/noise_covariance")?;
                if found.shape() != (p, p) {
                    return Err(wrong(
                        format!("the covariance is {}x{} and must be {p}x{p}", found.nrows(), found.ncols()),
                        "noise_covariance",
                    ));
                }
                let asymmetric = (&found - found.transpose()).norm() > 1e-10 * found.norm();
                let factor = if asymmetric { None } else { found.clone().cholesky() };
                if !factor.is_some_and(|f| f.l_dirty().diagonal().iter().all(|d| d.is_normal())) {
                    return Err(wrong(
                        "the covariance is not symmetric and positive definite".to_owned(),
                        "noise_covariance",
                    ));
                }
                found
            }
        };
        let parameters = model.names();
        if let Some(name) = written.scales.keys().find(|name| !parameters.contains(name)) {
            return Err(wrong(format!("there is no free parameter {name:?}"), &format!("scales/{name}"))
                .mend(format!("The free parameters are {}.", parameters.join(", "))));
        }
        let scaled = matches!(written.criterion, Criterion::ScaledT | Criterion::ScaledA);
        let mut scales = Vec::new();
        for (name, value) in parameters.iter().zip(model.nominal()) {
            let scale = written.scales.get(name).copied().unwrap_or(value.abs());
            let matters = written.scales.contains_key(name) || (scaled && scale == 0.0);
            if matters && !(scale > 0.0 && scale < 1e60) {
                return Err(wrong(format!("the scale of {name} is {scale}, and must be positive"), "scales")
                    .mend("Give a scale for every parameter that is zero."));
            }
            scales.push(if scale > 0.0 { scale } else { 1.0 });
        }
        let range = |limit: Limit, field: &str| -> Result<[f64; 2], Problem> {
            let [lower, upper] = limit.range();
            if lower < upper && lower.abs() < 1e60 && upper.abs() < 1e60 {
                Ok([lower, upper])
            } else {
                Err(wrong(format!("from {lower} to {upper} there is nothing: the limit contradicts itself"), field)
                    .mend("Give a positive magnitude, or a range [least, largest]."))
            }
        };
        let [lower, upper] = range(written.limits.input, "limits/input")?;
        if let Some(change) = written.limits.input_change
            && !(change > 0.0 && change < 1e60)
        {
            return Err(wrong(format!("the largest change is {change}, and must be positive"), "limits/input_change"));
        }
        for (name, limit) in &written.limits.outputs {
            let field = format!("limits/outputs/{name}");
            place(name, field.clone())?;
            range(*limit, &field)?;
        }
        for (i, difference) in written.limits.differences.iter().enumerate() {
            for (j, name) in difference.of.iter().enumerate() {
                place(name, format!("limits/differences/{i}/of/{j}"))?;
            }
            if difference.of[0] == difference.of[1] {
                return Err(wrong(
                    "the difference of an output to itself is zero".to_owned(),
                    &format!("limits/differences/{i}/of"),
                ));
            }
            range(difference.limit, &format!("limits/differences/{i}/limit"))?;
        }
        if let Some(correlation) = &mut written.limits.autocorrelation {
            let field = "limits/autocorrelation";
            let beta = correlation.tolerance;
            if !(beta > 0.0 && beta < 2.0) {
                return Err(wrong(
                    format!("the tolerance is {beta}, and must lie between 0 and 2"),
                    &format!("{field}/tolerance"),
                ));
            }
            let margin = *correlation.margin.get_or_insert(beta / 8.0);
            if !(margin >= 0.0 && margin < beta) {
                return Err(wrong(
                    format!("the margin is {margin}, and must be from 0 to below the tolerance {beta}"),
                    &format!("{field}/margin"),
                ));
            }
            let given = correlation.reference.as_ref().map(Vec::len);
            let lags = *correlation.lags.get_or_insert(given.unwrap_or(written.samples / 2 - 1));
            if lags == 0 || lags >= written.samples {
                return Err(wrong(
                    format!("lags up to {lags} of {} samples; 1 to {} are taken", written.samples, written.samples - 1),
                    &format!("{field}/lags"),
                ));
            }
            if let Some(reference) = &correlation.reference
                && (reference.len() != lags || !reference.iter().all(|r| r.abs() <= 1.0))
            {
                return Err(wrong(
                    format!("the reference has {} numbers, and must have {lags} between −1 and 1", reference.len()),
                    &format!("{field}/reference"),
                ));
            }
        }
        let radius = *written.trust_region.get_or_insert(lower.abs().max(upper.abs()) / 40.0);
        if !(radius > 0.0 && radius < 1e60) {
            return Err(wrong(format!("the trust region is {radius}, and must be positive"), "trust_region"));
        }
        if !(written.tolerance > 0.0 && written.tolerance < 1.0) {
            return Err(wrong(
                format!("the tolerance is {}, and must lie between 0 and 1", written.tolerance),
                "tolerance",
            ));
        }
        if !(1..=MAX_STEPS).contains(&written.max_steps) {
            return Err(wrong(
                format!("there are {} steps; 1 to {MAX_STEPS} are made", written.max_steps),
                "max_steps",
            ));
        }
        if let Some(monte_carlo) = &written.monte_carlo
            && !(10..=MAX_REPLICATES).contains(&monte_carlo.replicates)
        {
            let code = if monte_carlo.replicates > MAX_REPLICATES { Code::Unaffordable } else { Code::Invalid };
            return Err(Problem::new(
                code,
                "unusable number of records",
                format!("there are {} records; 10 to {MAX_REPLICATES} are simulated", monte_carlo.replicates),
            )
            .at("/spec/monte_carlo/replicates"));
        }
        Ok(Self { written, sample_time_s, measured, covariance, scales, radius })
    }
}

fn read(members: &Map<String, Value>) -> Result<InputDesignSpec, Problem> {
    for needed in ["samples", "limits"] {
        if !members.contains_key(needed) {
            return Err(wrong(format!("there is no {needed}"), "/spec")
                .mend("Give samples and limits, {\"input\": ..} at least."));
        }
    }
    // One at a time first, beside what is needed, since the deserialiser does not say where it stopped.
    let plain = json!({"samples": 10, "limits": {"input": 1.0}});
    for (name, value) in members {
        let mut alone = plain.clone();
        alone[name.as_str()] = value.clone();
        if let Err(error) = serde_json::from_value::<InputDesignSpec>(alone) {
            let location = format!("/spec/{}", name.replace('~', "~0").replace('/', "~1"));
            return Err(wrong(error.to_string(), location));
        }
    }
    serde_json::from_value(Value::Object(members.clone())).map_err(|error| wrong(error.to_string(), "/spec"))
}
