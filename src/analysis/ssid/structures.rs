//! Several structures over the same pool family, compared.

use super::refined::{KnownNoise, problem_of};
use super::spec::CheckedSpec;
use crate::analysis::contract::Failure;
use crate::analysis::report::Warning;
use crate::control::System;
use crate::ctl::Ctl;
use crate::identify::refine::{Criteria, RefineError, Refinement, Setup, Start};
use crate::identify::search::{Automatic, PreparedPools};
use crate::identify::ssid::{Settings, SsidError, Weights, identify};
use crate::response::{FrequencyData, RepeatKind, Repeats};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Structures of one comparison at most.
pub(super) const MAX_STRUCTURES: usize = 24;

/// Degrees of freedom of the lines' variances from which they are taken as known.
const MANY_DEGREES: f64 = 30.0;

/// Degrees of a structure; what is left out is as in the spec itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StructureSpec {
    /// Degree of the feedforward numerator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feedforward_numerator_degree: Option<usize>,
    /// Degree of the feedforward denominator; the order of an FIR feedforward.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feedforward_denominator_degree: Option<usize>,
    /// Degree of the feedback numerator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feedback_numerator_degree: Option<usize>,
    /// Degree of the feedback denominator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub feedback_denominator_degree: Option<usize>,
}

/// The likelihood of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Likelihood {
    /// Circular complex Gaussian noise with the variance known at each line; lines weighted by its inverse.
    KnownVariance,
    /// Circular complex Gaussian noise of one variance at all lines, estimated; lines weighted alike.
    CommonVarianceEstimated,
}

/// A structure's row.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StructureRow {
    /// Its degrees: feedforward numerator and denominator, feedback numerator and denominator.
    pub degrees: [usize; 4],
    /// J of the pool's best candidate, in the weights of the comparison.
    pub pool_cost: Option<f64>,
    /// Of the refined controllers; null where there are none.
    pub criteria: Option<Criteria>,
    /// Why not.
    pub reason: Option<String>,
}

/// The comparison. The main answer keeps the structure of the spec, whatever is chosen here.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StructureComparison {
    /// The likelihood behind AIC and BIC.
    pub likelihood: Likelihood,
    /// Row by row, in the order of the spec.
    pub rows: Vec<StructureRow>,
    /// The row with the smallest AIC among those without an active constraint; null where there is none.
    pub aic_choice: Option<usize>,
    /// With the smallest BIC.
    pub bic_choice: Option<usize>,
    /// With the smallest sum of squared errors of lines left out.
    pub cross_validation_choice: Option<usize>,
    /// With the smallest mean squared error of trials (or segments) left out.
    #[serde(default)]
    pub repeats_choice: Option<usize>,
    /// What `cross_validation_over_repeats` leaves out; null where there is a single segment, or frequency data in the
    /// request.
    #[serde(default)]
    pub repeats: Option<RepeatKind>,
    /// Parts that are left out, one after the other.
    #[serde(default)]
    pub folds: usize,
}

/// Identifies and refines every structure.
#[expect(clippy::too_many_arguments, reason = "one call, of what the run has at hand")]
pub(super) fn compare(
    spec: &CheckedSpec,
    plant: &System,
    data: &FrequencyData,
    noise: Option<&KnownNoise>,
    repeats: Option<&Repeats>,
    sample_time_s: Option<f64>,
    pools: &dyn PreparedPools,
    ctl: &Ctl,
) -> Result<StructureComparison, Failure> {
    let noise = noise.filter(|n| n.degrees_of_freedom >= MANY_DEGREES && data.variance.is_some());
    let folds = repeats.map_or(&[][..], |r| &r.folds);
    let mut rows = Vec::new();
    for recipe in &spec.structures {
        let _one_of_them = ctl.scope(1.0 / spec.structures.len() as f64);
        let structure = recipe.structure();
        let degrees = [
            structure.feedforward_numerator,
            structure.feedforward_denominator,
            structure.feedback_numerator,
            structure.feedback_denominator,
        ];
        let settings = Settings {
            recipe: recipe.clone(),
            weights: if noise.is_some() { Weights::InverseVariance } else { Weights::Uniform },
            sample_time_s,
            max_candidates: spec.max_candidates,
        };
        let mut row = StructureRow { degrees, pool_cost: None, criteria: None, reason: None };
        let search = Automatic { method: spec.search, pools };
        match identify(plant, data, &settings, &search, ctl) {
            Err(SsidError::Stopped(stopped)) => return Err(Failure::Stopped(stopped)),
            // The incumbent of one structure of many is no answer.
            Err(SsidError::Interrupted(interrupted)) => return Err(Failure::Stopped(interrupted.stopped)),
            Err(error) => row.reason = Some(error.to_string()),
            Ok(found) => {
                row.pool_cost = Some(found.optimum.cost);
                let problem = problem_of(&found, structure);
                let refined = match &problem {
                    Err(reason) => Err(reason.clone()),
                    Ok(problem) => {
                        let margin_per_s = found.stability_margin;
                        let setup = Setup { problem, plant: &found.plant, structure, margin_per_s };
                        match Refinement::new(setup, &Start::of(&found.feedforward, &found.feedback), ctl) {
                            Err(RefineError::Stopped(stopped)) => return Err(Failure::Stopped(stopped)),
                            Err(error) => Err(error.to_string()),
                            Ok(refinement) => {
                                let noise = noise.and_then(|n| n.at_lines(&found));
                                Ok(refinement.criteria(noise.as_ref(), folds, ctl).map_err(Failure::Stopped)?)
                            }
                        }
                    }
                };
                match refined {
                    Ok(criteria) => row.criteria = Some(criteria),
                    Err(reason) => row.reason = Some(reason),
                }
            }
        }
        rows.push(row);
    }
    let least = |of: fn(&Criteria) -> Option<f64>| {
        rows.iter()
            .enumerate()
            .filter_map(|(i, row)| row.criteria.as_ref().filter(|c| c.is_regular).and_then(of).map(|value| (i, value)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(i, _)| i)
    };
    Ok(StructureComparison {
        likelihood: if noise.is_some() { Likelihood::KnownVariance } else { Likelihood::CommonVarianceEstimated },
        aic_choice: least(|c| Some(c.aic)),
        bic_choice: least(|c| Some(c.bic)),
        cross_validation_choice: least(|c| c.cross_validation),
        repeats_choice: least(|c| c.cross_validation_over_repeats),
        repeats: repeats.map(|r| r.kind),
        folds: folds.len(),
        rows,
    })
}

/// Says where a criterion would choose another structure than the spec's.
pub(super) fn warn(comparison: &StructureComparison, own: [usize; 4], warnings: &mut Vec<Warning>) {
    for (name, choice) in [
        ("AIC", comparison.aic_choice),
        ("BIC", comparison.bic_choice),
        ("cross-validation over lines", comparison.cross_validation_choice),
        ("cross-validation over trials or segments", comparison.repeats_choice),
    ] {
        if let Some(degrees) = choice.map(|i| comparison.rows[i].degrees).filter(|d| *d != own) {
            warnings.push(Warning::new(
                "another_structure_preferred",
                format!(
                    "{name} prefers the degrees {degrees:?} (feedforward numerator and denominator, feedback numerator \
                     and denominator) to those of the answer, {own:?}"
                ),
            ));
        }
    }
}
