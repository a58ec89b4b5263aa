//! The candidates that the data cannot tell from the best one, in a report.

use crate::analysis::report::Warning;
use crate::control::{Model, System};
use crate::ctl::{Ctl, Stopped};
use crate::identify::equivalent::{self as identify, Asked, NoSet, equivalent_set};
use crate::identify::held::Held;
use crate::identify::search::{BandNorms, ExtremeMember, LEVEL, NormRange};
use crate::identify::ssid::{Identified, Searched};
use crate::learning::frequency_domain::{norm_feedback, norm_feedforward_plant_minus_one};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A set of this share of the pool, or more, determines nothing.
const MOST_OF_THE_POOL: f64 = 0.5;

/// In larger pools ranges are looked for only if asked.
const RANGED: u64 = 100_000;

/// What is found out about the statistically equivalent set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EquivalentSpec {
    /// Nothing.
    None,
    /// The share of the pool, counted in pools of up to 10⁸ candidates, of larger ones from random feedback
    /// controllers, with an interval; and the ranges of the norms in pools of up to 10⁵ candidates.
    #[default]
    Automatic,
    /// The same, with the ranges in pools of any size: those of appendix B may take hours.
    Ranges,
    /// The same, and every candidate is counted: appendix B takes half an hour.
    Counted,
}

/// A member of the set at an end of a range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EquivalentMember {
    /// Its index in the pool; of several with the same norm the lowest.
    pub index: u64,
    /// J, by QR.
    pub cost: f64,
    /// The norm.
    pub norm: f64,
    /// Gff.
    pub feedforward: Model,
    /// Gfb.
    pub feedback: Model,
}

/// The exact range of a norm over the whole set: no candidate of the pool that costs at most `cost_limit` has a norm
/// outside of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EquivalentRange {
    /// The smallest norm; null where every member's is infinite.
    pub least: Option<EquivalentMember>,
    /// The largest norm; null where a member's is infinite.
    pub largest: Option<EquivalentMember>,
}

/// Every candidate of the pool that the data cannot tell from the best one.
///
/// `J ≤ cost_limit = J* (1 + q/(n − q) F₀.₉₅(q, n − q))`, n being the equations, q all free coefficients of both
/// controllers, J* the smallest cost, but never finer than the rounding of costs (Beale 1960; Seber & Wild 1989,
/// chapter 5).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EquivalentSet {
    /// The level of the F distribution.
    pub level: f64,
    /// `1 + q/(n − q) F(q, n − q)`.
    pub cost_ratio: f64,
    /// Members cost at most this.
    pub cost_limit: f64,
    /// Real equations n.
    pub equations: usize,
    /// Free coefficients q.
    pub unknowns: usize,
    /// Members, a controller without feedback with every feedback denominator; null where the share is sampled.
    pub count: Option<u64>,
    /// Members over candidates of the pool.
    pub share: f64,
    /// The share lies between these with a probability of 95 % or more, whatever its distribution over the pool (Maurer
    /// & Pontil 2009, theorem 4); both are alike where it is counted.
    pub share_interval: [f64; 2],
    /// Feedback controllers that were drawn, each with all its feedforward denominators; 0 where every candidate was
    /// counted.
    pub draws: u64,
    /// Of ‖Gfb‖ over the band of `metrics`, of all members, by branch and bound over the whole pool; null where it was
    /// not looked for, and where the feedback is held at zero.
    pub norm_feedback: Option<EquivalentRange>,
    /// Of ‖Gff G − 1‖ over the band of `metrics`, likewise; null where the feedforward is held at zero.
    pub norm_feedforward_plant_minus_one: Option<EquivalentRange>,
    /// Why a range is null; null where none is.
    pub norms_reason: Option<String>,
}

/// The norms of a report.
#[derive(Debug)]
struct Norms<'a> {
    plant: &'a System,
    band_rad_s: [f64; 2],
}

impl BandNorms for Norms<'_> {
    fn band_rad_s(&self) -> [f64; 2] {
        self.band_rad_s
    }

    fn feedback(&self, feedback: &System) -> f64 {
        norm_feedback(feedback, self.band_rad_s).unwrap_or(f64::INFINITY)
    }

    fn feedforward_plant_minus_one(&self, feedforward: &System) -> f64 {
        norm_feedforward_plant_minus_one(self.plant, feedforward, self.band_rad_s).unwrap_or(f64::INFINITY)
    }
}

impl From<&ExtremeMember> for EquivalentMember {
    fn from(member: &ExtremeMember) -> Self {
        Self {
            index: member.index,
            cost: member.cost,
            norm: member.norm,
            feedforward: member.feedforward.to_model(),
            feedback: member.feedback.to_model(),
        }
    }
}

impl From<&NormRange> for EquivalentRange {
    fn from(range: &NormRange) -> Self {
        Self { least: range.least.as_ref().map(Into::into), largest: range.largest.as_ref().map(Into::into) }
    }
}

impl EquivalentRange {
    /// In words.
    fn text(&self, name: &str) -> String {
        match (&self.least, &self.largest) {
            (Some(least), Some(largest)) => format!("{name} from {:.3} to {:.3}", least.norm, largest.norm),
            (Some(least), None) => format!("{name} from {:.3} without an upper end", least.norm),
            _ => format!("{name} infinite"),
        }
    }
}

impl EquivalentSet {
    fn ranges_text(&self) -> String {
        match (&self.norm_feedback, &self.norm_feedforward_plant_minus_one) {
            (Some(feedback), Some(distance)) => {
                format!(", with {} and {}", feedback.text("‖Gfb‖"), distance.text("‖Gff G − 1‖"))
            }
            (Some(feedback), None) => format!(", with {}", feedback.text("‖Gfb‖")),
            (None, Some(distance)) => format!(", with {}", distance.text("‖Gff G − 1‖")),
            (None, None) => String::new(),
        }
    }

    /// Says where the set is most of the pool.
    pub(super) fn warning(&self, pool_size: u64) -> Option<Warning> {
        (self.share >= MOST_OF_THE_POOL).then(|| {
            Warning::new(
                "command_does_not_determine_feedback",
                format!(
                    "the command alone does not determine the feedback: {:.1} % of the pool's {pool_size} candidates \
                     cannot be told from the best one by the F test at {:.0} % ({} equations, {} unknowns){}",
                    100.0 * self.share,
                    100.0 * self.level,
                    self.equations,
                    self.unknowns,
                    self.ranges_text(),
                ),
            )
        })
    }
}

/// The set, or why there is none; what is said of it comes first among the warnings.
pub(super) fn find(
    found: &Identified,
    searched: &Searched,
    spec: EquivalentSpec,
    band_rad_s: [f64; 2],
    warnings: &mut Vec<Warning>,
    ctl: &Ctl,
) -> Result<Result<EquivalentSet, String>, Stopped> {
    if spec == EquivalentSpec::None {
        return Ok(Err("the spec asks for none".to_owned()));
    }
    let norms = Norms { plant: &found.plant, band_rad_s };
    let is_asked = matches!(spec, EquivalentSpec::Ranges | EquivalentSpec::Counted);
    let asked = Asked { ranges: is_asked || found.pool_size <= RANGED, count: spec == EquivalentSpec::Counted };
    match equivalent_set(found, searched, &norms, asked, ctl) {
        Ok(set) => {
            let set = EquivalentSet::new(&set, searched.structure.held);
            let is_about_feedback = searched.structure.held != Some(Held::Feedback);
            if let Some(warning) = set.warning(found.pool_size).filter(|_| is_about_feedback) {
                warnings.insert(0, warning);
            }
            Ok(Ok(set))
        }
        Err(NoSet::Stopped(stopped)) => Err(stopped),
        Err(error) => Ok(Err(error.to_string())),
    }
}

impl EquivalentSet {
    /// With the controller that is held at zero.
    fn new(set: &identify::EquivalentSet, held: Option<Held>) -> Self {
        let identify::EquivalentSet { threshold, share, ranges } = set;
        let norms_reason = match (ranges, held) {
            (None, _) => Some(format!(
                "in pools of more than {RANGED} candidates ranges are looked for with \"equivalent\": \"ranges\""
            )),
            (Some(_), Some(Held::Feedback)) => {
                Some("the feedback is held at zero: ‖Gfb‖ is 0 of every member".to_owned())
            }
            (Some(_), Some(Held::Feedforward)) => {
                Some("the feedforward is held at zero: ‖Gff G − 1‖ is 1 of every member".to_owned())
            }
            (Some(_), None) => None,
        };
        Self {
            level: LEVEL,
            cost_ratio: threshold.ratio,
            cost_limit: threshold.limit,
            equations: threshold.equations,
            unknowns: threshold.unknowns,
            count: share.count,
            share: share.share,
            share_interval: share.interval,
            draws: share.draws,
            norm_feedback: ranges.as_ref().and_then(|r| r.feedback.as_ref()).map(Into::into),
            norm_feedforward_plant_minus_one: ranges
                .as_ref()
                .and_then(|r| r.feedforward_plant_minus_one.as_ref())
                .map(Into::into),
            norms_reason,
        }
    }
}
