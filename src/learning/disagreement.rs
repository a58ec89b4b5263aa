//! Estimators on the same trials: where they contradict each other.

use super::curves::PlantCurve;
use super::inputs::{Estimator, Identification, NormIntervals, Remark, TrialInput};
use std::collections::BTreeMap;

type Of = fn(&NormIntervals) -> Option<[f64; 2]>;

/// The norms that are compared.
const NORMS: [(&str, Of); 3] = [
    ("‖Gfb‖", |i| i.norm_feedback),
    ("‖Gff − G⁻¹‖", |i| i.norm_feedforward_minus_inverse),
    ("‖Gff G − 1‖", |i| i.norm_feedforward_plant_minus_one),
];

/// Where the interval of a trial shown and that of another estimator do not meet, a remark for each norm and estimator.
/// An estimator without intervals says nothing that could be contradicted.
pub(super) fn estimators_disagree(curve: &PlantCurve, trials: &[&TrialInput]) -> Vec<Remark> {
    // By estimator and norm: trials that both give an interval, and those among them that are apart.
    let mut counts: BTreeMap<(Estimator, usize), [usize; 2]> = BTreeMap::new();
    for point in &curve.points {
        let Some(trial) = trials.iter().find(|trial| trial.trial == point.trial) else { continue };
        let mut newest: BTreeMap<Estimator, &Identification> = BTreeMap::new();
        for other in &trial.by_other_estimators {
            let kept = newest.entry(other.estimator).or_insert(other);
            if other.analysis > kept.analysis {
                *kept = other;
            }
        }
        for (estimator, other) in newest {
            for (norm, (_, of)) in NORMS.iter().enumerate() {
                let (Some(shown), Some(theirs)) = (of(&point.intervals_95), of(&other.intervals)) else { continue };
                let count = counts.entry((estimator, norm)).or_default();
                count[0] += 1;
                count[1] += usize::from(shown[1] < theirs[0] || theirs[1] < shown[0]);
            }
        }
    }
    counts
        .into_iter()
        .filter(|(_, [_, apart])| *apart > 0)
        .map(|((estimator, norm), [both, apart])| {
            Remark::new(
                "estimators_disagree_on_trials",
                format!(
                    "{} of {} and {} differ beyond their intervals in {apart} of {both} trials on {}",
                    NORMS[norm].0,
                    curve.estimator.name(),
                    estimator.name(),
                    curve.plant.name
                ),
            )
        })
        .collect()
}
