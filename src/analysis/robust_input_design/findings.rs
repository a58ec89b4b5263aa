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
    if difference.verdict == RobustVerdict::NotDistinguished {
        warnings.push(Warning::new("null_result", conclusion(nominal, robust, difference)));
    }
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
        let [lower, upper] = fresh.optimism.interval;
        if !(lower..=upper).contains(&0.0) {
            warnings.push(Warning::new(
                "draws_too_few",
                format!(
                    "the search put the cost of the {name} experiment's worst subject {:.4} ({lower:.4} to {upper:.4}) \
                     from what fresh draws give, {:.4}, and that of all subjects at {:.4}: it knew its own draws too \
                     well; give more draws",
                    -fresh.optimism.mean,
                    fresh.cost,
                    worst.cost()
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

/// What came of the comparison, in a sentence.
pub(super) fn conclusion(nominal: &FreshResult, robust: &FreshResult, difference: &DifferenceResult) -> String {
    let [lower, upper] = difference.interval;
    let figures = format!(
        "with fresh draws its worst subject costs {:.4} where the nominal experiment's costs {:.4}, a difference of \
         {:.4} ({lower:.4} to {upper:.4})",
        robust.cost, nominal.cost, difference.mean
    );
    match difference.verdict {
        RobustVerdict::RobustBetter => format!("The robust experiment spares its worst subject: {figures}."),
        RobustVerdict::NotDistinguished => {
            format!("Null result: the robust experiment is not distinguished from the nominal one: {figures}.")
        }
        RobustVerdict::RobustWorse => format!("The robust experiment is worse than the nominal one: {figures}."),
    }
}
