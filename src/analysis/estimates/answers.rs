//! The answers of a report, one for each trial and estimator.

use super::{About, identification};
use crate::analysis::{Analysis as _, Kind, Report};
use crate::analysis::{prediction_error, ssid, two_stimulus};
use crate::control::Model;
use crate::learning::inputs::{Estimator, Identification};
use serde_json::Value;

/// What a report says of a trial by an estimator, or why it cannot be read.
pub(super) struct Answer {
    /// The trial's place among those of the analysis, from 0.
    pub(super) position: usize,
    pub(super) estimator: Estimator,
    pub(super) found: Result<Identification, String>,
}

/// The estimators that a kind of analysis answers by.
fn estimators(kind: Kind) -> &'static [Estimator] {
    if kind == ssid::Plan::KIND {
        &[Estimator::Ssid, Estimator::SsidRefined]
    } else if kind == two_stimulus::Plan::KIND {
        &[Estimator::TwoStimulus]
    } else if kind == prediction_error::Plan::KIND {
        &[Estimator::PredictionError]
    } else {
        &[]
    }
}

/// Every answer of a report about trials on `plant`. Of a report about several trials only what it says trial by trial,
/// or once for all of them. The answers do not know their analysis.
pub(super) fn answers(report: &Report, plant: Option<&Model>) -> Vec<Answer> {
    let trials = report.result.get("trials").and_then(Value::as_array).map_or(1, Vec::len);
    let mut all = Vec::new();
    for estimator in estimators(report.kind) {
        let positions = if *estimator == Estimator::PredictionError { trials } else { 1 };
        for position in 0..positions {
            let about = About { analysis: "", spec_sha256: &report.provenance.spec_sha256, position, report };
            if let Some(found) = identification(*estimator, about, plant).transpose() {
                all.push(Answer { position, estimator: *estimator, found });
            }
        }
    }
    all
}
