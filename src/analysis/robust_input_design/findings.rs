//! What a scientist must read beside an experiment.

use super::checked::Checked;
use super::result::{DifferenceResult, FreshResult, RobustVerdict};
use crate::analysis::report::Warning;
use crate::excite::robust::{GAMMA, Outcome};

/// What must be read before using the result.
pub(super) fn warnings(
    checked: &Checked,
    outcome: &Outcome,
    nominal: &FreshResult,
    robust: &FreshResult,
    difference: &DifferenceResult,
) -> Vec<Warning> {
    let mut warnings = Vec::new();
    warnings.push(Warning::new(
        "assumptions_declared",
        "the source leaves out the muscle, the derivative's filter, sample time, length, number of draws, scaling of \
         the noise and the average subject; what stands in their place is listed in `assumptions`, and costs compare \
         only between runs with the same ones",
    ));
    if difference.verdict == RobustVerdict::RobustWorse {
        warnings.push(Warning::new(
            "robust_worse",
            "with fresh draws the robust experiment's worst subject costs more than the nominal one's: the search saw \
             too few draws",
        ));
    }
    if !outcome.closed {
        warnings.push(Warning::new(
            "not_closed",
            format!(
                "after {} rounds the search still met worse subjects than it had taken into account",
                outcome.rounds
            ),
        ));
    }
    for (name, worst, fresh) in [("nominal", &outcome.nominal, nominal), ("robust", &outcome.robust, robust)] {
        let [lower, upper] = fresh.interval;
        if !(lower..=upper).contains(&worst.cost()) {
            warnings.push(Warning::new(
                "draws_too_few",
                format!(
                    "the search put the worst cost of the {name} experiment at {:.4} where fresh draws give {:.4} \
                     ({lower:.4} to {upper:.4}): it knew its own draws too well; give more draws",
                    worst.cost(),
                    fresh.cost
                ),
            ));
        }
        if fresh.not_converged > 0 {
            warnings.push(Warning::new(
                "refits_not_converged",
                format!(
                    "{} of {} fits of the {name} experiment's worst subject did not converge; the best that they found \
                     counts",
                    fresh.not_converged, fresh.draws
                ),
            ));
        }
    }
    let gamma = outcome.robust.gamma;
    for ((name, value), [lower, upper]) in GAMMA.into_iter().zip(gamma).zip(checked.gamma_box) {
        if value == lower || value == upper {
            warnings.push(Warning::new(
                "at_the_edge",
                format!(
                    "the robust {name} is {value}, at the edge of its range: a wider one may hold a better experiment"
                ),
            ));
        }
    }
    warnings
}
