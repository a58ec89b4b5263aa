//! What a report says of a trial, as it is kept beside the report: so that nobody who draws a curve opens reports.

use super::answers::{Answer, answers};
use crate::analysis::Report;
use crate::control::model::TransferFunctionModel;
use crate::control::{Model, System};
use crate::learning::frequency_domain::ControllerMetrics;
use crate::learning::inputs::{Estimator, Identification, IdentifiedControllers, NormIntervals, StandardErrors};
use crate::trust::Evidence;
use serde::{Deserialize, Serialize};

/// What a report says of a trial by an estimator.
#[derive(Debug, Clone, PartialEq)]
pub struct Kept {
    /// The trial's place among those of the analysis, from 0.
    pub position: usize,
    /// How it was estimated.
    pub estimator: Estimator,
    /// What was found.
    pub estimate: KeptEstimate,
}

/// An estimate as it is written down, without what its row says: of which analysis, with which spec.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KeptEstimate {
    /// It was read.
    Found(Box<Found>),
    /// The report could not be read, and why.
    Refused(String),
}

/// The numbers of an estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Plant, feedforward and feedback.
    controllers: Option<[Model; 3]>,
    metrics: Option<ControllerMetrics>,
    standard_errors: StandardErrors,
    intervals: NormIntervals,
    variance_accounted_for: Option<f64>,
    cost: Option<f64>,
    evidence: Evidence,
}

/// Everything of a report about trials on `plant` that curves are drawn from.
#[must_use]
pub fn kept(report: &Report, plant: Option<&Model>) -> Vec<Kept> {
    let one = |answer: Answer| {
        let estimate = match answer.found {
            Ok(found) => KeptEstimate::Found(Box::new(Found::of(found))),
            Err(why) => KeptEstimate::Refused(why),
        };
        Kept { position: answer.position, estimator: answer.estimator, estimate }
    };
    answers(report, plant).into_iter().map(one).collect()
}

impl KeptEstimate {
    /// What it was made from, of an analysis with a spec.
    ///
    /// # Errors
    /// Why the report could not be read, in words.
    pub fn identification(
        self,
        estimator: Estimator,
        analysis: String,
        spec_sha256: String,
    ) -> Result<Identification, String> {
        let found = match self {
            Self::Found(found) => *found,
            Self::Refused(why) => return Err(why),
        };
        let system = |model: Model| model.check().map_err(|error| error.to_string());
        let controllers = match found.controllers {
            None => None,
            Some([plant, feedforward, feedback]) => Some(IdentifiedControllers {
                plant: system(plant)?,
                feedforward: system(feedforward)?,
                feedback: system(feedback)?,
            }),
        };
        Ok(Identification {
            analysis,
            spec_sha256,
            estimator,
            controllers,
            metrics: found.metrics,
            standard_errors: found.standard_errors,
            intervals: found.intervals,
            variance_accounted_for: found.variance_accounted_for,
            cost: found.cost,
            evidence: found.evidence,
        })
    }
}

impl Found {
    /// Numbers that are not finite have no JSON: they are left out, as answers leave them out.
    fn of(own: Identification) -> Self {
        let ends = |interval: Option<[f64; 2]>| interval.filter(|ends| ends.iter().all(|end| end.is_finite()));
        let NormIntervals { norm_feedback, norm_feedforward_minus_inverse, norm_feedforward_plant_minus_one, reason } =
            own.intervals;
        Self {
            controllers: own
                .controllers
                .map(|both| [both.plant, both.feedforward, both.feedback].map(|one| model(&one))),
            metrics: own.metrics,
            standard_errors: own.standard_errors,
            intervals: NormIntervals {
                norm_feedback: ends(norm_feedback),
                norm_feedforward_minus_inverse: ends(norm_feedforward_minus_inverse),
                norm_feedforward_plant_minus_one: ends(norm_feedforward_plant_minus_one),
                reason,
            },
            variance_accounted_for: own.variance_accounted_for,
            cost: own.cost,
            evidence: own.evidence,
        }
    }
}

fn model(system: &System) -> Model {
    // A numerator of zero has no coefficient left, and a transfer function needs one.
    let coefficients = |all: &[f64]| if all.is_empty() { vec![0.0] } else { all.to_vec() };
    Model::TransferFunction(TransferFunctionModel {
        num: coefficients(system.num().coefficients()),
        den: coefficients(system.den().coefficients()),
        sample_time_s: system.sample_time_s(),
        delay_s: None,
    })
}
