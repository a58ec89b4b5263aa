//! The statistically equivalent set: every candidate that the data cannot tell from the best one.
//!
//! With a free feedforward numerator the command alone says little about the feedback, and the set is where that shows:
//! it may be most of the pool. So it is never listed; its share of the pool and the ranges of the norms over all of it
//! are what is known of it.

use super::search::{BandNorms, EquivalentRanges, Question, Share, Threshold, ranges, share};
use super::ssid::{Identified, Searched};
use crate::ctl::{Ctl, Stopped};

/// The set.
#[derive(Debug, Clone, PartialEq)]
pub struct EquivalentSet {
    /// What makes a candidate a member.
    pub threshold: Threshold,
    /// How much of the pool it is.
    pub share: Share,
    /// How far its members differ; `None` where that was not asked for.
    pub ranges: Option<EquivalentRanges>,
}

/// What is asked about the set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Asked {
    /// Whether the ranges of the norms.
    pub ranges: bool,
    /// Whether members are counted however large the pool is.
    pub count: bool,
}

/// Why there is no set.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoSet {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// Any cost could be chance.
    #[error("the lines give as many equations as there are unknown coefficients, so that any cost could be chance")]
    NothingLeft,
    /// Which candidates are stable with the plant's delay is not known of all of them.
    #[error("which candidates are stable with the plant's delay is known of those that fit best only")]
    PlantDelay,
}

/// The set of an identification, with the ranges of these norms over it if asked for.
///
/// # Errors
/// [`NoSet`].
pub fn equivalent_set(
    found: &Identified,
    searched: &Searched,
    norms: &dyn BandNorms,
    asked: Asked,
    ctl: &Ctl,
) -> Result<EquivalentSet, NoSet> {
    if found.plant_delay_s > 0.0 {
        return Err(NoSet::PlantDelay);
    }
    let Searched { problem, pool, prepared, structure } = searched;
    let threshold = Threshold::new(problem, *structure, found.optimum.cost).ok_or(NoSet::NothingLeft)?;
    let (limit, best) = (threshold.limit, found.optimum.index);
    let question = Question { problem, pool, plant: &found.plant, limit, best, norms, held: structure.held };
    let ranges = if asked.ranges {
        let _ranges = ctl.scope(RANGES);
        Some(ranges(&question, prepared.as_ref(), ctl)?)
    } else {
        None
    };
    let _sharing = ctl.scope(1.0);
    Ok(EquivalentSet { threshold, share: share(&question, asked.count, ctl)?, ranges })
}

/// The share of the time that the ranges take.
const RANGES: f64 = 0.7;
