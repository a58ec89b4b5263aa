//! The candidates that fit nearly as well as the best one, in a report.

use crate::analysis::report::Warning;
use crate::control::Model;
use crate::identify::family::Member;
use crate::identify::problem::NEAR;
use crate::identify::search::MOST_NEAR;
use crate::identify::ssid::Identified;
use crate::learning::frequency_domain::controller_metrics_delayed;
use num_complex::Complex64;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Norms that vary by more than this factor over the family are worth a warning.
const WIDE: f64 = 1.25;

/// A candidate that fits nearly as well as the best one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NearCandidate {
    /// Its index in the pool.
    pub index: u64,
    /// J, by QR.
    pub cost: f64,
    /// Gff.
    pub feedforward: Model,
    /// Gfb.
    pub feedback: Model,
    /// ‖Gfb‖ over the band of `metrics`; null where it is infinite.
    pub norm_feedback: Option<f64>,
    /// ‖Gff G − 1‖ over the band; null where it is infinite.
    pub norm_feedforward_plant_minus_one: Option<f64>,
}

/// The spread of the family at a frequency line: smallest and largest value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SpreadAtLine {
    /// Angular frequency in rad/s.
    pub omega_rad_s: f64,
    /// Of |Gfb|; null where a member has a pole there.
    pub feedback: Option<[f64; 2]>,
    /// Of |Gff G − 1|; null where a member has a pole there.
    pub feedforward_plant_minus_one: Option<[f64; 2]>,
}

/// How far the controllers of the family differ: smallest and largest value of each quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FamilySpread {
    /// Of ‖Gfb‖ over the band; null where a member's is infinite.
    pub norm_feedback: Option<[f64; 2]>,
    /// Of ‖Gff G − 1‖ over the band; null where a member's is infinite.
    pub norm_feedforward_plant_minus_one: Option<[f64; 2]>,
    /// Line by line.
    pub lines: Vec<SpreadAtLine>,
}

/// Candidates that fit nearly as well: how flat the optimum is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NearOptimal {
    /// Within this share of the smallest cost, or within `rounding` of it.
    pub within: f64,
    /// A difference of costs that rounding alone can make; candidates that fit exactly are all within it.
    #[serde(default)]
    pub rounding: f64,
    /// How many, the best one included; a controller without feedback counts with every feedback denominator.
    pub count: u64,
    /// The best of them, the best one first; of equal costs the lowest index first. A controller without feedback is
    /// here once.
    pub family: Vec<NearCandidate>,
    /// Whether the family holds every candidate within that share or rounding, and not only the best ones.
    pub family_is_complete: bool,
    /// How far they differ.
    pub spread: FamilySpread,
}

/// Smallest and largest of values that are all there and finite.
fn range(values: impl Iterator<Item = Option<f64>>) -> Option<[f64; 2]> {
    let values: Option<Vec<f64>> = values.map(|v| v.filter(|v| v.is_finite())).collect();
    values?.into_iter().fold(None, |range, v| match range {
        None => Some([v, v]),
        Some([low, high]) => Some([low.min(v), high.max(v)]),
    })
}

impl NearOptimal {
    /// Of an identification; norms over a band in rad/s, which is known to make sense.
    pub(super) fn new(found: &Identified, band_rad_s: (f64, f64)) -> Self {
        let family: Vec<NearCandidate> =
            found.family.par_iter().map(|member| near(found, member, band_rad_s)).collect();
        let lines = found
            .lines
            .iter()
            .map(|(line, _)| {
                let plant = line.plant * Complex64::from_polar(1.0, -line.omega_rad_s * found.plant_delay_s);
                let distance = |m: &Member| (m.feedforward.response(line.omega_rad_s) * plant - 1.0).norm();
                SpreadAtLine {
                    omega_rad_s: line.omega_rad_s,
                    feedback: range(found.family.iter().map(|m| Some(m.feedback.response(line.omega_rad_s).norm()))),
                    feedforward_plant_minus_one: range(found.family.iter().map(|m| Some(distance(m)))),
                }
            })
            .collect();
        let spread = FamilySpread {
            norm_feedback: range(family.iter().map(|c| c.norm_feedback)),
            norm_feedforward_plant_minus_one: range(family.iter().map(|c| c.norm_feedforward_plant_minus_one)),
            lines,
        };
        let count = found.optimum.near_optimal;
        let is_whole = family.len() < MOST_NEAR || family.len() as u64 >= count;
        let family_is_complete = is_whole && !found.optimum.near_is_cut;
        Self { within: NEAR, rounding: found.rounding, count, family_is_complete, family, spread }
    }

    /// Says where nearly equal fits mean different controllers.
    pub(super) fn warn(&self, warnings: &mut Vec<Warning>) {
        let wide = |range: Option<[f64; 2]>| range.filter(|[low, high]| *high > WIDE * low);
        let mut said = Vec::new();
        for (name, range) in
            [("‖Gfb‖", self.spread.norm_feedback), ("‖Gff G − 1‖", self.spread.norm_feedforward_plant_minus_one)]
        {
            if let Some([low, high]) = wide(range) {
                said.push(format!("{name} from {low:.3} to {high:.3}"));
            }
        }
        if !said.is_empty() {
            let which = if self.family_is_complete {
                format!("the {} candidates", self.family.len())
            } else {
                format!("the best {} of the {} candidates", self.family.len(), self.count)
            };
            warnings.push(Warning::new(
                "flat_optimum",
                format!(
                    "{which} within {:.0} % of the smallest cost, or within rounding of it, have {}: the data hardly \
                     tell them apart",
                    100.0 * self.within,
                    said.join(" and ")
                ),
            ));
        }
    }
}

fn near(found: &Identified, member: &Member, band_rad_s: (f64, f64)) -> NearCandidate {
    // The band was good for the best candidate, so an error can only be none.
    let metrics = controller_metrics_delayed(
        &found.plant,
        found.plant_delay_s,
        &member.feedforward,
        &member.feedback,
        band_rad_s,
    )
    .ok();
    NearCandidate {
        index: member.index,
        cost: member.cost,
        feedforward: member.feedforward.to_model(),
        feedback: member.feedback.to_model(),
        norm_feedback: metrics.as_ref().and_then(|m| m.norm_feedback),
        norm_feedforward_plant_minus_one: metrics.as_ref().and_then(|m| m.norm_feedforward_plant_minus_one),
    }
}
