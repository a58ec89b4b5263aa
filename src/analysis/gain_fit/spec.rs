//! How it is fitted: as written, and checked.

use crate::analysis::contract::Part;
use crate::analysis::inputs::matrix::dense;
use crate::analysis::inverse::structure_spec::{PortWeight, StateWeight, WeightName, structure};
use crate::analysis::problem::Problem;
use crate::analysis::reading::{self, wrong_spec as wrong};
use crate::inverse::Structure;
use crate::likelihood::Noise;
use crate::trial::pointer;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// Orders of the Padé approximation at most.
const MAX_ORDER: usize = 10;
/// Draws of starts, climbs, and draws of gains at most.
const MAX_DRAWS: usize = 10_000;
const MAX_CLIMBS: usize = 100;

/// What is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GainFitWanted {
    /// K of `u = −Kx`, from responses of the closed loop.
    Gain,
    /// K and L of `u = −Kx̂` and the sampled filter `x̂⁺ = Ax̂ + Bu + Ew + L(y − ŷ)`, by the innovation form.
    GainAndFilter,
}

/// What the person knows of the plant's input w.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "GainFitDisturbance")]
pub enum DisturbanceKnowledge {
    /// Nothing: w moves the plant, and the person's filter sees it in the outputs alone.
    UnknownToPerson,
    /// All of it at all times: the filter takes w as the plant does.
    KnownToPerson,
}

/// What noise the person's filter is made for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "GainFitPerceivedNoise")]
pub enum PerceivedNoise {
    /// Any: nothing is assumed. K and L are found from the control, which must be recorded.
    Free,
    /// The true one: the filter's innovations are white. An assumption that outputs alone cannot test well.
    True,
}

/// What is known of the covariance of the noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
#[schemars(rename = "GainFitNoise")]
pub enum NoiseSpec {
    /// `full` (any covariance), `diagonal` (independent outputs) or `scalar` (one variance).
    #[schemars(title = "Form")]
    Name(NoiseName),
    /// The covariance itself.
    #[schemars(title = "Covariance")]
    Known {
        /// Rows, p×p, positive definite, in products of the units of the outputs.
        covariance: Vec<Vec<f64>>,
    },
}

/// A form of the covariance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "GainFitNoiseName")]
pub enum NoiseName {
    /// Any covariance.
    Full,
    /// Independent outputs.
    Diagonal,
    /// One variance for all outputs.
    Scalar,
}

/// What the trials start from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "GainFitInitialState")]
pub enum InitialState {
    /// At rest.
    Rest,
    /// As the trials say.
    Given,
    /// Anywhere: every trial's is estimated along.
    Estimated,
}

/// A delay between state and control, as a Padé approximation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "GainFitDelay")]
pub struct PersonDelaySpec {
    /// Order of the approximation, 1 to 10. Default: 5.
    #[serde(default = "five")]
    pub order: usize,
    /// The delay in seconds where it is known; null for a parameter `tau` of the fit. Default: null.
    #[serde(default)]
    pub seconds: Option<f64>,
}

fn five() -> usize {
    5
}

/// A first-order lag of the muscle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "GainFitLag")]
pub struct PersonLagSpec {
    /// The time constant in seconds where it is known; null for a parameter `t_w` of the fit. Default: null.
    #[serde(default)]
    pub seconds: Option<f64>,
}

/// The question put to the gains that were found: for which cost are they optimal?
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(rename = "GainFitOptimalityQuestion")]
pub struct OptimalitySpec {
    /// Q: `"full"`, `"diagonal"` or `{"pattern": [[true, ..], ..]}`. Default: full.
    pub state_weight: StateWeight,
    /// R: `"full"`, `"diagonal"`, `{"fixed": [[..]]}` or `{"pattern": ..}`. Default: full.
    pub port_weight: PortWeight,
    /// Whether Q may be singular. Default: false.
    pub semidefinite: bool,
    /// Draws from the distribution of the estimate, each of which is put the same question. Default: 200.
    pub draws: usize,
}

impl Default for OptimalitySpec {
    fn default() -> Self {
        Self {
            state_weight: StateWeight::Name(WeightName::Full),
            port_weight: PortWeight::Name(WeightName::Full),
            semidefinite: false,
            draws: 200,
        }
    }
}

impl OptimalitySpec {
    /// What is known of the weights of n states and m controls.
    pub(super) fn structure(&self, n: usize, m: usize) -> Result<Structure, Problem> {
        structure(&self.state_weight, &self.port_weight, self.semidefinite, [n, m], "/spec/optimality")
    }
}

/// What the gain is held to be, in a fit beside the free one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
#[schemars(rename = "GainFitConstraint")]
pub enum OptimalConstraint {
    /// `optimal`: the regulator of a cost that weighs every state by a weight of its own, with R the identity.
    #[schemars(title = "Name")]
    Name(ConstraintName),
    /// The same with a structure.
    #[schemars(title = "Structure")]
    Structured {
        /// The cost.
        optimal: OptimalSetting,
    },
}

/// The name of a constraint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "GainFitConstraintName")]
pub enum ConstraintName {
    /// K is optimal for some cost.
    Optimal,
}

/// The structure of the cost that K is held to be optimal for.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(rename = "GainFitOptimalSetting")]
pub struct OptimalSetting {
    /// The states that Q weighs, by name: `x1`, `x2`, .., or those of the catalogue's plant. Default: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weighed_states: Option<Vec<String>>,
    /// R, m×m, which is the scale of the cost and not estimated, in its unit over those of two controls. Default: the
    /// identity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control_weight: Option<Vec<Vec<f64>>>,
}

impl OptimalConstraint {
    /// The structure, all defaults where none is written.
    pub(super) fn setting(&self) -> OptimalSetting {
        match self {
            Self::Name(ConstraintName::Optimal) => OptimalSetting::default(),
            Self::Structured { optimal } => optimal.clone(),
        }
    }
}

/// The spec of `gain_fit`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GainFitSpec {
    /// `gain` (default) or `gain_and_filter`.
    pub estimate: GainFitWanted,
    /// What the person knows of the plant's input w; for `gain_and_filter`. Default: `unknown_to_person`.
    pub disturbance: DisturbanceKnowledge,
    /// What noise the person's filter is made for; for `gain_and_filter`. Default: `free`.
    pub perceived_noise: PerceivedNoise,
    /// A delay in the person. Default: none.
    pub delay: Option<PersonDelaySpec>,
    /// A lag in the person. Default: none.
    pub muscle_lag: Option<PersonLagSpec>,
    /// Parameters of the plant that are fitted. Default: all of a plant in the request, none of the catalogue's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub free: Option<Vec<String>>,
    /// `[lower, upper]` by the name of a parameter, in its unit; null for no bound. Default: none, and 1 ms to 1 s for
    /// `tau` and `t_w`.
    pub bounds: BTreeMap<String, [Option<f64>; 2]>,
    /// A start beside the drawn ones, with a value for every parameter in its unit. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<BTreeMap<String, f64>>,
    /// `full` (default), `diagonal`, `scalar` or `{"covariance": [[..]]}`.
    pub noise: NoiseSpec,
    /// `rest`, `given` or `estimated`. Default: given where the trials have it, otherwise estimated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub initial_state: Option<InitialState>,
    /// The level of the intervals, above 0 and below 1. Default: 0.95.
    pub confidence: f64,
    /// Points drawn as starts, 1 to 10,000. Default: 60.
    pub draws: usize,
    /// How many of them, the likeliest, are climbed from, 1 to 100. Default: 6.
    pub climbs: usize,
    /// The seed of all draws. Default: 1.
    pub seed: u64,
    /// Whether and how the gains are asked for their cost; null for not at all.
    pub optimality: Option<OptimalitySpec>,
    /// What the gain is held to be in a fit of its own beside the free one, with the ratio test between them:
    /// `optimal`, or `{"optimal": {"weighed_states": ["x1"]}}`; for `gain`. Default: nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub constraint: Option<OptimalConstraint>,
}

impl Default for GainFitSpec {
    fn default() -> Self {
        Self {
            estimate: GainFitWanted::Gain,
            disturbance: DisturbanceKnowledge::UnknownToPerson,
            perceived_noise: PerceivedNoise::Free,
            delay: None,
            muscle_lag: None,
            free: None,
            bounds: BTreeMap::new(),
            start: None,
            noise: NoiseSpec::Name(NoiseName::Full),
            initial_state: None,
            confidence: 0.95,
            draws: 60,
            climbs: 6,
            seed: 1,
            optimality: Some(OptimalitySpec::default()),
            constraint: None,
        }
    }
}

impl Part for GainFitSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        if !value.is_object() {
            return Err(wrong("the spec is no object", at));
        }
        reading::read(value, at, "unusable spec")
    }
}

impl GainFitSpec {
    /// Checks it, as far as the plant does not matter.
    pub(super) fn check(&self) -> Result<(), Problem> {
        if !(self.confidence > 0.0 && self.confidence < 1.0) {
            return Err(wrong(
                format!("the level is {}, and must lie between 0 and 1", self.confidence),
                "/spec/confidence",
            ));
        }
        for (name, value, most) in [("draws", self.draws, MAX_DRAWS), ("climbs", self.climbs, MAX_CLIMBS)] {
            if !(1..=most).contains(&value) {
                return Err(wrong(format!("{name} is {value}; 1 to {most} are taken"), format!("/spec/{name}")));
            }
        }
        if let Some(draws) = self.optimality.as_ref().map(|o| o.draws).filter(|draws| *draws > MAX_DRAWS) {
            return Err(wrong(format!("draws is {draws}; at most {MAX_DRAWS} are taken"), "/spec/optimality/draws"));
        }
        if let Some(delay) = &self.delay {
            if !(1..=MAX_ORDER).contains(&delay.order) {
                return Err(wrong(
                    format!("the order is {}; 1 to {MAX_ORDER} are taken", delay.order),
                    "/spec/delay/order",
                ));
            }
            positive(delay.seconds, "/spec/delay/seconds")?;
        }
        if let Some(lag) = &self.muscle_lag {
            positive(lag.seconds, "/spec/muscle_lag/seconds")?;
        }
        if self.estimate == GainFitWanted::GainAndFilter {
            if self.constraint.is_some() {
                return Err(wrong("gain and filter together are not held to be optimal here", "/spec/constraint")
                    .mend("Fit costs and noises by lqg_fit, or estimate the gain alone."));
            }
            for (name, is_given) in [("delay", self.delay.is_some()), ("muscle_lag", self.muscle_lag.is_some())] {
                if is_given {
                    return Err(wrong(
                        "gain and filter together are those of a controller without delay and lag",
                        format!("/spec/{name}"),
                    )
                    .mend("Put them into the plant's matrices, or estimate the gain alone."));
                }
            }
        }
        for (name, [lower, upper]) in &self.bounds {
            let [low, high] = [lower.unwrap_or(f64::NEG_INFINITY), upper.unwrap_or(f64::INFINITY)];
            let is_range = low < high;
            if !is_range {
                return Err(wrong(
                    format!("the bounds {low} and {high} of {name} cross"),
                    pointer::member("/spec/bounds", name),
                ));
            }
        }
        if let Some(free) = &self.free
            && let Some(i) = (0..free.len()).find(|i| free[..*i].contains(&free[*i]))
        {
            return Err(wrong(format!("{:?} is named twice", free[i]), format!("/spec/free/{i}")));
        }
        Ok(())
    }

    /// The noise, for so many outputs.
    pub(super) fn noise(&self, outputs: usize) -> Result<Noise, Problem> {
        Ok(match &self.noise {
            NoiseSpec::Name(NoiseName::Full) => Noise::Full,
            NoiseSpec::Name(NoiseName::Diagonal) => Noise::Diagonal,
            NoiseSpec::Name(NoiseName::Scalar) => Noise::Scalar,
            NoiseSpec::Known { covariance } => {
                const AT: &str = "/spec/noise/covariance";
                let found = dense(covariance, "the covariance", AT)?;
                if found.shape() != (outputs, outputs) {
                    let (rows, columns) = found.shape();
                    return Err(wrong(
                        format!("the covariance is {rows}x{columns} and must be {outputs}x{outputs}"),
                        AT,
                    ));
                }
                let asymmetric = (&found - found.transpose()).norm() > 1e-10 * found.norm();
                if asymmetric || found.iter().any(|v| !v.is_finite()) || found.clone().cholesky().is_none() {
                    return Err(wrong("the covariance is not symmetric and positive definite", AT));
                }
                Noise::Known(found)
            }
        })
    }

    /// The bounds of parameters with these names and limits.
    pub(super) fn bounds(&self, names: &[String], limits: &[[f64; 2]]) -> Result<Vec<[f64; 2]>, Problem> {
        if let Some(name) = self.bounds.keys().find(|name| !names.contains(name)) {
            return Err(wrong(format!("there is no parameter {name:?}"), pointer::member("/spec/bounds", name))
                .mend(format!("The parameters are {}.", names.join(", "))));
        }
        let one = |(name, [least, most]): (&String, &[f64; 2])| {
            let usual = if name == "tau" || name == "t_w" { [1e-3, 1.0] } else { [*least, *most] };
            let [lower, upper] = match self.bounds.get(name) {
                None => usual,
                Some([lower, upper]) => [lower.unwrap_or(usual[0]), upper.unwrap_or(usual[1])],
            };
            // Never beyond what the model is defined for.
            let bounds = [lower.max(*least), upper.min(*most)];
            if bounds[0] < bounds[1] {
                Ok(bounds)
            } else {
                Err(wrong(
                    format!(
                        "the bounds {lower} and {upper} of {name} leave nothing of {least} to {most}, where the model \
                         is defined"
                    ),
                    pointer::member("/spec/bounds", name),
                ))
            }
        };
        names.iter().zip(limits).map(one).collect()
    }

    /// The start of the user's, in the order of the parameters.
    pub(super) fn start(&self, names: &[String], bounds: &[[f64; 2]]) -> Result<Option<Vec<f64>>, Problem> {
        let Some(start) = &self.start else { return Ok(None) };
        if let Some(name) = start.keys().find(|name| !names.contains(name)) {
            return Err(wrong(format!("there is no parameter {name:?}"), pointer::member("/spec/start", name))
                .mend(format!("The parameters are {}.", names.join(", "))));
        }
        let mut values = Vec::new();
        for (name, [lower, upper]) in names.iter().zip(bounds) {
            let at = pointer::member("/spec/start", name);
            let value = *start.get(name).ok_or_else(|| wrong(format!("the start has no {name}"), at.clone()))?;
            if !(lower..=upper).contains(&&value) {
                return Err(wrong(
                    format!("the start of {name} is {value}, outside its bounds {lower} and {upper}"),
                    at,
                ));
            }
            values.push(value);
        }
        Ok(Some(values))
    }
}

fn positive(seconds: Option<f64>, at: &str) -> Result<(), Problem> {
    match seconds {
        Some(value) if !(1e-6..=1e3).contains(&value) => {
            Err(wrong(format!("{value} s is no time between 1e-6 and 1000 s"), at))
        }
        _ => Ok(()),
    }
}
