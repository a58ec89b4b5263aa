//! How the time of an analysis is shared out.

use super::equivalent::EquivalentSpec;
use super::spec::CheckedSpec;

/// The share of the time that frequency data take.
pub(super) const DATA: f64 = 0.02;

/// How the time is shared out, about.
pub(super) struct Shares {
    pub search: f64,
    pub equivalent: f64,
    pub delays: f64,
    pub refinement: f64,
    pub structures: f64,
    pub restrictions: f64,
}

impl Shares {
    /// By what is asked for: searches take about as long as each other, a refinement little beside them, and every draw
    /// of a bootstrap as much as a refinement.
    pub(super) fn of(spec: &CheckedSpec) -> Self {
        let used = &spec.used;
        let delays = used.delay.as_ref().map_or(0, |delays| delays.pairs().len()) as f64;
        let draws = used.bootstrap.map_or(0, |bootstrap| bootstrap.draws) as f64;
        let refinement = if spec.refine { 0.02 * (1.0 + draws) } else { 0.0 };
        let structures = spec.structures.len() as f64;
        let equivalent = if used.equivalent == Some(EquivalentSpec::None) { 0.0 } else { 1.0 };
        let restrictions = spec.restrictions.len() as f64;
        let whole = 1.0 + equivalent + delays + refinement + structures + restrictions;
        let share = |part: f64| (1.0 - DATA) * part / whole;
        Self {
            search: share(1.0),
            equivalent: share(equivalent),
            delays: share(delays),
            refinement: share(refinement),
            structures: share(structures),
            restrictions: share(restrictions),
        }
    }
}
