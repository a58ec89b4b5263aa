//! From a request to a report, whatever the kind.

use super::inputs::{Library, References};
use super::kind::{Kind, Request};
use super::problem::Problem;
use super::report::Report;
use super::{
    excitation, frequency_response, gain_fit, input_design, inverse, robust_input_design, ssid, ssid_mimo, two_stimulus,
};
use crate::control::Model;
use crate::ctl::{Ctl, Stopped};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A checked request: everything that can be checked without its inputs has been.
#[derive(Debug, Clone)]
pub enum Plan {
    /// See [`frequency_response`].
    FrequencyResponse(frequency_response::Plan),
    /// See [`ssid`].
    Ssid(ssid::Plan),
    /// See [`two_stimulus`].
    TwoStimulus(two_stimulus::Plan),
    /// See [`gain_fit`].
    GainFit(gain_fit::Plan),
    /// See [`inverse`]: three kinds.
    Inverse(inverse::Plan),
    /// Kind `ssid` with several inputs and outputs; see [`ssid_mimo`].
    SsidMimo(ssid_mimo::Plan),
    /// See [`excitation::quality`].
    ExcitationQuality(excitation::quality::Plan),
    /// See [`excitation::compensator`].
    CompensatorDesign(excitation::compensator::Plan),
    /// See [`input_design`].
    InputDesign(input_design::Plan),
    /// See [`robust_input_design`].
    RobustInputDesign(robust_input_design::Plan),
}

/// Why a plan came to no report.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Failure {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// Somebody asked it to stop, and this is the best that it had found until then.
    #[error("{stopped}")]
    Interrupted {
        /// Why it was stopped.
        stopped: Stopped,
        /// What it had found; its cost is that of [`Ctl::bracket`].
        incumbent: Box<Incumbent>,
    },
    /// It cannot be done, for a reason that the person who asked can read.
    #[error(transparent)]
    Problem(#[from] Problem),
}

/// The controllers of the best candidate that an unfinished search has found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Incumbent {
    /// Gff.
    pub feedforward: Model,
    /// Gfb.
    pub feedback: Model,
}

impl Plan {
    /// Checks a request.
    ///
    /// # Errors
    /// A [`Problem`] that names the field by its JSON pointer.
    pub fn parse(request: &Request) -> Result<Self, Problem> {
        match request.kind.parse()? {
            Kind::FrequencyResponse => frequency_response::Plan::parse(request).map(Self::FrequencyResponse),
            Kind::Ssid if ssid_mimo::is_asked_for(request) => ssid_mimo::Plan::parse(request).map(Self::SsidMimo),
            Kind::Ssid => ssid::Plan::parse(request).map(Self::Ssid),
            Kind::TwoStimulus => two_stimulus::Plan::parse(request).map(Self::TwoStimulus),
            Kind::GainFit => gain_fit::Plan::parse(request).map(Self::GainFit),
            kind @ (Kind::InverseLqr | Kind::InverseLqe | Kind::InverseLqg) => {
                inverse::Plan::parse(request, kind).map(Self::Inverse)
            }
            Kind::ExcitationQuality => excitation::quality::Plan::parse(request).map(Self::ExcitationQuality),
            Kind::CompensatorDesign => excitation::compensator::Plan::parse(request).map(Self::CompensatorDesign),
            Kind::InputDesign => input_design::Plan::parse(request).map(Self::InputDesign),
            Kind::RobustInputDesign => robust_input_design::Plan::parse(request).map(Self::RobustInputDesign),
        }
    }

    /// The kind.
    #[must_use]
    pub fn kind(&self) -> Kind {
        match self {
            Self::FrequencyResponse(_) => Kind::FrequencyResponse,
            Self::Ssid(_) | Self::SsidMimo(_) => Kind::Ssid,
            Self::TwoStimulus(_) => Kind::TwoStimulus,
            Self::GainFit(_) => Kind::GainFit,
            Self::Inverse(plan) => plan.kind(),
            Self::ExcitationQuality(_) => Kind::ExcitationQuality,
            Self::CompensatorDesign(_) => Kind::CompensatorDesign,
            Self::InputDesign(_) => Kind::InputDesign,
            Self::RobustInputDesign(_) => Kind::RobustInputDesign,
        }
    }

    /// The stored things that it needs.
    #[must_use]
    pub fn references(&self) -> References {
        match self {
            Self::FrequencyResponse(plan) => plan.references(),
            Self::Ssid(plan) => plan.references(),
            Self::TwoStimulus(plan) => plan.references(),
            Self::GainFit(plan) => plan.references(),
            Self::Inverse(plan) => plan.references(),
            Self::SsidMimo(plan) => plan.references(),
            Self::ExcitationQuality(plan) => plan.references(),
            Self::CompensatorDesign(plan) => plan.references(),
            Self::InputDesign(plan) => plan.references(),
            Self::RobustInputDesign(plan) => plan.references(),
        }
    }

    /// The request with every default filled in; parsing it again gives an equal plan.
    #[must_use]
    pub fn request(&self) -> Request {
        match self {
            Self::FrequencyResponse(plan) => plan.request(),
            Self::Ssid(plan) => plan.request(),
            Self::TwoStimulus(plan) => plan.request(),
            Self::GainFit(plan) => plan.request(),
            Self::Inverse(plan) => plan.request(),
            Self::SsidMimo(plan) => plan.request(),
            Self::ExcitationQuality(plan) => plan.request(),
            Self::CompensatorDesign(plan) => plan.request(),
            Self::InputDesign(plan) => plan.request(),
            Self::RobustInputDesign(plan) => plan.request(),
        }
    }

    /// Computes the report. Deterministic but for the times, which the caller adds.
    ///
    /// Runs on the rayon pool that it is called in.
    ///
    /// # Errors
    /// [`Failure::Stopped`] or [`Failure::Interrupted`] when `ctl` says so, [`Failure::Problem`] when the inputs cannot answer the question.
    pub fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        match self {
            Self::FrequencyResponse(plan) => plan.run(library, ctl),
            Self::Ssid(plan) => plan.run(library, ctl),
            Self::TwoStimulus(plan) => plan.run(library, ctl),
            Self::GainFit(plan) => plan.run(library, ctl),
            Self::Inverse(plan) => plan.run(library, ctl),
            Self::SsidMimo(plan) => plan.run(library, ctl),
            Self::ExcitationQuality(plan) => plan.run(library, ctl),
            Self::CompensatorDesign(plan) => plan.run(library, ctl),
            Self::InputDesign(plan) => plan.run(library, ctl),
            Self::RobustInputDesign(plan) => plan.run(library, ctl),
        }
    }
}
