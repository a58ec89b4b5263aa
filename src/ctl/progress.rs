//! How far a computation has come, in named phases.

use schemars::JsonSchema;
use serde::Serialize;
use std::fmt;
use std::str::FromStr;

/// What a computation is at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// The whole computation, where it has no parts worth telling apart.
    #[default]
    Computing,
    /// The signals become what the method works with: frequency data, spectra, a regression.
    Data,
    /// What can be reused is made, or read from where it is kept: pools, trees, generated people.
    Preparation,
    /// Candidates are compared.
    Search,
    /// The best is improved, or parameters are fitted.
    Fit,
    /// Intervals, by repeated fits, profiles or fresh draws.
    Intervals,
    /// The answer is checked by a second method, or judged on other data.
    Verification,
}

impl Phase {
    /// Every phase, in the order in which most computations have them.
    pub const ALL: [Self; 7] =
        [Self::Computing, Self::Data, Self::Preparation, Self::Search, Self::Fit, Self::Intervals, Self::Verification];

    /// Its name in documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Computing => "computing",
            Self::Data => "data",
            Self::Preparation => "preparation",
            Self::Search => "search",
            Self::Fit => "fit",
            Self::Intervals => "intervals",
            Self::Verification => "verification",
        }
    }
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// No phase has this name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is no phase of a computation")]
pub struct UnknownPhase(String);

impl FromStr for Phase {
    type Err = UnknownPhase;

    fn from_str(text: &str) -> Result<Self, UnknownPhase> {
        Self::ALL.into_iter().find(|phase| phase.name() == text).ok_or_else(|| UnknownPhase(text.to_owned()))
    }
}

/// How far a computation has come.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// What it is at.
    pub phase: Phase,
    /// Units of the present count that are finished (candidates, trials, frequencies).
    pub done: u64,
    /// Units of the present count in all; 0 while it is not known.
    pub total: u64,
    /// The share of the whole computation that is done when the phase begins.
    pub from: f64,
    /// The share of the whole computation that is done when the phase ends.
    pub to: f64,
    /// The share of the whole computation that is done; it never falls.
    pub fraction: f64,
}

impl Progress {
    /// `done` of `total` units of a computation in one phase.
    #[must_use]
    pub fn of_units(done: u64, total: u64) -> Self {
        Self { done: done.min(total), total, fraction: share(done, total), ..Self::default() }
    }
}

impl Default for Progress {
    /// Nothing is done.
    fn default() -> Self {
        Self { phase: Phase::Computing, done: 0, total: 0, from: 0.0, to: 1.0, fraction: 0.0 }
    }
}

/// `done/total` as a share from 0 to 1; 0 while the total is not known.
#[allow(clippy::cast_precision_loss)]
pub(super) fn share(done: u64, total: u64) -> f64 {
    if total == 0 { 0.0 } else { (done as f64 / total as f64).min(1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_lead_back_to_their_phases() {
        for phase in Phase::ALL {
            assert_eq!(phase.name().parse(), Ok(phase));
            assert_eq!(serde_json::json!(phase), phase.name());
        }
        assert_eq!("thinking".parse::<Phase>(), Err(UnknownPhase("thinking".to_owned())));
    }
}
