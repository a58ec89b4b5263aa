//! What learning curves are made from: plain values that any store can fill in.

use super::frequency_domain::ControllerMetrics;
use super::time_domain::TimeDomainMetrics;
use crate::control::System;
use crate::trust::Evidence;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A subject with everything recorded from it.
#[derive(Debug, Clone, PartialEq)]
pub struct SubjectInput {
    /// Its id.
    pub subject: String,
    /// Its pseudonym.
    pub code: String,
    /// Its group.
    pub group: Option<String>,
    /// Its trials, in any order.
    pub trials: Vec<TrialInput>,
}

/// A trial.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialInput {
    /// Its id.
    pub trial: String,
    /// Its number, unique within subject and session.
    pub number: i64,
    /// Its session.
    pub session: Option<i64>,
    /// The plant it was recorded on.
    pub plant: PlantName,
    /// Whether |y| passed the display limit.
    pub divergent: bool,
    /// Why somebody excluded it, where somebody did.
    pub excluded: Option<String>,
    /// Its metrics in the time domain.
    pub metrics: TimeDomainMetrics,
    /// Every succeeded identification of this trial by the estimator that is shown, in any order.
    pub identifications: Vec<Identification>,
    /// Those by the other estimators, which it is compared with.
    pub by_other_estimators: Vec<Identification>,
}

/// A plant, by id and name.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
pub struct PlantName {
    /// Its id.
    pub id: String,
    /// Its name.
    pub name: String,
}

/// How controllers were estimated.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Estimator {
    /// The best candidate of a pool, of kind `ssid`.
    #[default]
    Ssid,
    /// Its refinement.
    SsidRefined,
    /// Kind `two_stimulus`, line by line.
    TwoStimulus,
    /// Kind `prediction_error`.
    PredictionError,
}

impl Estimator {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Ssid, Self::SsidRefined, Self::TwoStimulus, Self::PredictionError];

    /// Its name in documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Ssid => "ssid",
            Self::SsidRefined => "ssid_refined",
            Self::TwoStimulus => "two_stimulus",
            Self::PredictionError => "prediction_error",
        }
    }
}

/// What one identification found.
#[derive(Debug, Clone, PartialEq)]
pub struct Identification {
    /// The id of the analysis. Ids sort by age (UUIDv7), so the greatest one is the newest.
    pub analysis: String,
    /// SHA-256 of its spec: equal for identifications done in the same way.
    pub spec_sha256: String,
    /// How it was estimated.
    pub estimator: Estimator,
    /// Plant and controllers as transfer functions, where the estimator gives them.
    pub controllers: Option<IdentifiedControllers>,
    /// The norms over the identified band, where the report has them.
    pub metrics: Option<ControllerMetrics>,
    /// Standard errors of the norms, where the estimator gives them.
    pub standard_errors: StandardErrors,
    /// The 95 % intervals of the norms, where it gives them.
    pub intervals: NormIntervals,
    /// Share of the variance of y that a simulation with the identified controllers explains (1 is all of it).
    pub variance_accounted_for: Option<f64>,
    /// The cost J at the argmin.
    pub cost: Option<f64>,
    /// What its report says of the trust in it.
    pub evidence: Evidence,
}

impl Identification {
    /// One of which nothing is known yet but how it was done and what its report says of the trust in it.
    #[must_use]
    pub fn unread(analysis: &str, spec_sha256: &str, estimator: Estimator, evidence: Evidence) -> Self {
        Self {
            analysis: analysis.to_owned(),
            spec_sha256: spec_sha256.to_owned(),
            estimator,
            controllers: None,
            metrics: None,
            standard_errors: StandardErrors::default(),
            intervals: NormIntervals::default(),
            variance_accounted_for: None,
            cost: None,
            evidence,
        }
    }
}

/// Plant and controllers of an identification, in one time base.
#[derive(Debug, Clone, PartialEq)]
pub struct IdentifiedControllers {
    /// The plant, in the time base of the controllers.
    pub plant: System,
    /// Gff.
    pub feedforward: System,
    /// Gfb.
    pub feedback: System,
}

/// Standard errors of the norms of one identification, each in the unit of its norm.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct StandardErrors {
    /// Of ‖Gfb‖.
    pub norm_feedback: Option<f64>,
    /// Of ‖Gff − G⁻¹‖.
    pub norm_feedforward_minus_inverse: Option<f64>,
    /// Of ‖Gff G − 1‖.
    pub norm_feedforward_plant_minus_one: Option<f64>,
}

/// 95 % intervals of the norms, each in the unit of its norm.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NormIntervals {
    /// Of ‖Gfb‖; null where there is none.
    pub norm_feedback: Option<[f64; 2]>,
    /// Of ‖Gff − G⁻¹‖.
    pub norm_feedforward_minus_inverse: Option<[f64; 2]>,
    /// Of ‖Gff G − 1‖.
    pub norm_feedforward_plant_minus_one: Option<[f64; 2]>,
    /// Why one is null, where one is.
    pub reason: Option<String>,
}

/// A remark that a scientist must read before using the numbers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Remark {
    /// A stable name, in `snake_case`.
    pub code: String,
    /// The finding, in words and numbers.
    pub message: String,
}

impl Remark {
    pub(super) fn new(code: &str, message: String) -> Self {
        Self { code: code.to_owned(), message }
    }
}

/// The one way of identifying whose results a curve shows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SpecChoice {
    /// SHA-256 of the chosen spec.
    pub spec_sha256: String,
    /// How many of the trials were identified with it.
    pub trials: usize,
    /// The other specs that some of the trials were identified with, most trials first.
    pub others: Vec<SpecCoverage>,
}

/// How many trials were identified with a spec.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SpecCoverage {
    /// SHA-256 of the spec.
    pub spec_sha256: String,
    /// Trials identified with it.
    pub trials: usize,
}

/// The spec that covers most of the trials; of several, the one used last (by the greatest analysis id). `None` where
/// no trial is identified.
///
/// Results of different specs are never mixed: a step in a curve would show the change of method as learning.
#[must_use]
pub fn choose_spec<'a>(trials: impl IntoIterator<Item = &'a TrialInput>) -> Option<SpecChoice> {
    // Per spec: the trials that it covers and its newest analysis.
    let mut found: BTreeMap<&str, (usize, &str)> = BTreeMap::new();
    for trial in trials {
        let mut newest: BTreeMap<&str, &str> = BTreeMap::new();
        for one in &trial.identifications {
            let entry = newest.entry(&one.spec_sha256).or_insert(&one.analysis);
            *entry = (*entry).max(&one.analysis);
        }
        for (spec, analysis) in newest {
            let entry = found.entry(spec).or_insert((0, analysis));
            *entry = (entry.0 + 1, entry.1.max(analysis));
        }
    }
    let mut ranked: Vec<_> = found.into_iter().map(|(spec, (trials, newest))| (trials, newest, spec)).collect();
    ranked.sort_unstable_by(|a, b| b.cmp(a));
    let mut ranked = ranked.into_iter();
    let (trials, _, spec) = ranked.next()?;
    let others = ranked.map(|(trials, _, spec)| SpecCoverage { spec_sha256: spec.to_owned(), trials }).collect();
    Some(SpecChoice { spec_sha256: spec.to_owned(), trials, others })
}

impl SpecChoice {
    /// The choice of a spec that was asked for by its hash, with the others that exist.
    #[must_use]
    pub fn fixed<'a>(spec_sha256: &str, trials: impl IntoIterator<Item = &'a TrialInput>) -> Self {
        let mut chosen = Self { spec_sha256: spec_sha256.to_owned(), trials: 0, others: Vec::new() };
        if let Some(best) = choose_spec(trials) {
            let best_coverage = SpecCoverage { spec_sha256: best.spec_sha256, trials: best.trials };
            for coverage in std::iter::once(best_coverage).chain(best.others) {
                if coverage.spec_sha256 == spec_sha256 {
                    chosen.trials = coverage.trials;
                } else {
                    chosen.others.push(coverage);
                }
            }
        }
        chosen
    }

    /// A remark where other specs exist, so that nobody takes the choice for the only result.
    #[must_use]
    pub fn remark(&self) -> Option<Remark> {
        if self.others.is_empty() {
            return None;
        }
        let others: Vec<_> =
            self.others.iter().map(|o| format!("{} ({} trials)", short(&o.spec_sha256), o.trials)).collect();
        Some(Remark::new(
            "several_specs",
            format!(
                "trials were identified in several ways; shown is spec {} ({} trials), not {}",
                short(&self.spec_sha256),
                self.trials,
                others.join(", ")
            ),
        ))
    }
}

impl TrialInput {
    /// The newest identification of this trial with the spec.
    #[must_use]
    pub fn identified_with(&self, spec_sha256: &str) -> Option<&Identification> {
        self.identifications.iter().filter(|i| i.spec_sha256 == spec_sha256).max_by(|a, b| a.analysis.cmp(&b.analysis))
    }
}

fn short(hash: &str) -> &str {
    hash.get(..12).unwrap_or(hash)
}
