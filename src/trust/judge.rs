//! From what is known of a quantity to how far it may be used.

use super::level::{Level, Reason, Trust};
use super::rule::{CONSTANTS, advice};
use serde::{Deserialize, Serialize};

/// What sort of quantity is judged: not every row is about every quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sort {
    /// Of the feedback.
    Feedback,
    /// Of the feedforward.
    Feedforward,
    /// The share of a simulation, which is what it is: it has no interval and no spread.
    Share,
}

/// Whether the recorded output follows from the control through the plant.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Agreement {
    /// As far as is known, it does.
    #[default]
    Agrees,
    /// More is left over than noise should leave.
    Loose,
    /// It does not.
    Foreign,
}

/// What an analysis says of everything that it identified from a trial.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Whether the recorded output follows from the control.
    pub agreement: Agreement,
    /// Whether a warning says that the simulation fails, or that the loop is unstable.
    pub simulation_fails: bool,
    /// Share of the output's variation that the simulated controllers explain; none where it was not simulated.
    pub simulated_share: Option<f64>,
    /// Why the stimuli do not tell the feedback from the feedforward, where they do not.
    pub feedback_not_told: Option<String>,
    /// The smallest p of the tests of its residuals, adjusted by Holm.
    pub residual_p: Option<f64>,
    /// Why the search did not arrive, where it did not.
    pub not_converged: Option<String>,
    /// What holds the answer back.
    pub held_back: Vec<String>,
    /// Which warnings say that the form of the model holds the answer back.
    pub form_moves_answer: Vec<String>,
    /// Least and greatest ‖Gfb‖ among candidates that fit nearly as well.
    pub spread_feedback: Option<[f64; 2]>,
    /// The same of ‖Gff G − 1‖.
    pub spread_distance: Option<[f64; 2]>,
}

/// A quantity that was identified from a trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate<'a> {
    /// Its name.
    pub quantity: &'a str,
    /// What sort it is of.
    pub sort: Sort,
    /// Its value; none where there is none.
    pub value: Option<f64>,
    /// Its 95 % interval.
    pub interval: Option<[f64; 2]>,
    /// Why there is no interval, or no value.
    pub reason: Option<&'a str>,
    /// Least and greatest value among candidates that fit nearly as well.
    pub spread: Option<[f64; 2]>,
}

/// The worst of what was found about a quantity; `fallback` is what stands where nothing was.
#[must_use]
pub fn worst_of(quantity: &str, mut found: Vec<Reason>, fallback: &str) -> Trust {
    found.sort_by_key(|reason| std::cmp::Reverse(reason.level));
    let mut found = found.into_iter();
    let worst = found.next().unwrap_or_else(|| Reason {
        level: Level::Ok,
        code: fallback.to_owned(),
        because: if fallback == "measured" { "measured, not identified" } else { "nothing speaks against it" }
            .to_owned(),
    });
    Trust {
        quantity: quantity.to_owned(),
        level: worst.level,
        advice: advice(&worst.code).to_owned(),
        code: worst.code,
        because: worst.because,
        also: found.collect(),
    }
}

fn reason(level: Level, code: &str, because: impl Into<String>) -> Reason {
    Reason { level, code: code.to_owned(), because: because.into() }
}

/// Why nothing of a trial is to be used, whatever was identified from it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LeftOut<'a> {
    /// Whether its output passed the display limit.
    divergent: bool,
    /// Why somebody excluded it.
    excluded: Option<&'a str>,
}

impl<'a> LeftOut<'a> {
    /// Of a trial that is divergent or not, excluded or not.
    #[must_use]
    pub fn of(divergent: bool, excluded: Option<&'a str>) -> Self {
        Self { divergent, excluded }
    }

    pub(super) fn reasons(self) -> Vec<Reason> {
        let divergent =
            self.divergent.then(|| reason(Level::DoNotUse, "divergent", "the output passed the display limit"));
        let excluded = self.excluded.map(|why| reason(Level::DoNotUse, "excluded", format!("excluded: {why}")));
        excluded.into_iter().chain(divergent).collect()
    }
}

impl From<bool> for LeftOut<'_> {
    fn from(divergent: bool) -> Self {
        Self { divergent, excluded: None }
    }
}

/// The trust in something that was measured in time.
#[must_use]
pub fn measured<'a>(quantity: &str, trial: impl Into<LeftOut<'a>>) -> Trust {
    worst_of(quantity, trial.into().reasons(), "measured")
}

/// The trust in something that nothing was identified of.
#[must_use]
pub fn not_identified(quantity: &str, why: &str) -> Trust {
    worst_of(quantity, vec![reason(Level::NotIdentified, "not_identified", why)], "ok")
}

/// The trust in an estimate.
#[must_use]
pub fn judge<'a>(estimate: &Estimate<'_>, evidence: &Evidence, trial: impl Into<LeftOut<'a>>) -> Trust {
    let Some(value) = estimate.value else {
        return not_identified(estimate.quantity, estimate.reason.unwrap_or("it has no value"));
    };
    let mut found: Vec<Reason> = trial.into().reasons();
    recording(evidence, &mut found);
    simulation(estimate, evidence, &mut found);
    if estimate.sort != Sort::Share {
        interval(estimate, value, &mut found);
        spread(estimate, &mut found);
        if let Some(why) = &evidence.feedback_not_told {
            let level = if estimate.sort == Sort::Feedback { Level::DoNotUse } else { Level::Read };
            found.push(reason(level, "feedback_not_told", why.as_str()));
        }
        residuals(evidence, &mut found);
        if !evidence.held_back.is_empty() {
            let what = evidence.held_back.join(", ");
            found.push(reason(Level::Read, "held_back", format!("held back by {what}")));
        }
        if !evidence.form_moves_answer.is_empty() {
            let what = evidence.form_moves_answer.join(", ");
            found.push(reason(Level::Read, "form_moves_answer", format!("warned of: {what}")));
        }
    }
    if let Some(why) = &evidence.not_converged {
        found.push(reason(Level::Read, "not_converged", why.as_str()));
    }
    worst_of(estimate.quantity, found, "ok")
}

fn recording(evidence: &Evidence, found: &mut Vec<Reason>) {
    match evidence.agreement {
        Agreement::Agrees => {}
        Agreement::Loose => found.push(reason(
            Level::Read,
            "output_loosely_from_control",
            "more of the output than noise should leave does not follow from the control through the plant",
        )),
        Agreement::Foreign => found.push(reason(
            Level::DoNotUse,
            "output_not_from_control",
            "the output does not follow from the control through the plant",
        )),
    }
}

/// A simulation is the only check of an estimate without an interval. With one, the interval says how far the value may
/// be used: on simulated people the loop of controllers whose norms are right within it is unstable in most trials.
fn simulation(estimate: &Estimate<'_>, evidence: &Evidence, found: &mut Vec<Reason>) {
    let share = evidence.simulated_share;
    let fails = if estimate.interval.is_some() { Level::Read } else { Level::DoNotUse };
    if evidence.simulation_fails || share.is_some_and(|share| share <= CONSTANTS.simulated_share_do_not_use) {
        let because = "simulated, the controllers explain none of the output";
        found.push(reason(fails, "simulation_fails", because));
    } else if let Some(share) = share.filter(|share| *share < CONSTANTS.simulated_share_read) {
        let because = format!("simulated, the controllers explain {:.0} % of the output", 100.0 * share);
        found.push(reason(Level::Read, "simulation_weak", because));
    }
}

fn interval(estimate: &Estimate<'_>, value: f64, found: &mut Vec<Reason>) {
    let Some([low, high]) = estimate.interval else {
        let why = estimate.reason.unwrap_or("the estimator gives none");
        found.push(reason(Level::Read, "no_interval", format!("no interval: {why}")));
        return;
    };
    let half = 0.5 * (high - low);
    let words = || format!("its 95 % interval runs from {low:.3} to {high:.3}");
    if half > CONSTANTS.half_width_do_not_use * value || high > CONSTANTS.interval_ratio_do_not_use * low {
        found.push(reason(Level::DoNotUse, "interval_too_wide", words()));
    } else if half > CONSTANTS.half_width_read * value {
        found.push(reason(Level::Read, "interval_wide", words()));
    }
}

fn spread(estimate: &Estimate<'_>, found: &mut Vec<Reason>) {
    let Some([low, high]) = estimate.spread else { return };
    let words = || format!("candidates that fit nearly as well have {low:.3} to {high:.3}");
    if high > CONSTANTS.spread_do_not_use * low {
        found.push(reason(Level::DoNotUse, "spread_too_wide", words()));
    } else if high > CONSTANTS.spread_read * low {
        found.push(reason(Level::Read, "spread_wide", words()));
    }
}

fn residuals(evidence: &Evidence, found: &mut Vec<Reason>) {
    let Some(p) = evidence.residual_p.filter(|p| *p < CONSTANTS.residual_p_read) else { return };
    let code = if p < CONSTANTS.residual_p_do_not_use { "interval_refused" } else { "interval_doubtful" };
    found.push(reason(Level::Read, code, format!("the tests of the residuals have p {p:.2e}")));
}

#[cfg(test)]
mod tests;
