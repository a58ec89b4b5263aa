//! From a request to a report, whatever the kind.

use super::inputs::{Library, References};
use super::kind::{Kind, Request};
use super::problem::Problem;
use super::report::Report;
use super::{frequency_response, input_design, inverse, robust_input_design, ssid, ssid_mimo, two_stimulus};
use crate::num::{Ctl, Stopped};

/// A checked request: everything that can be checked without its inputs has been.
#[derive(Debug, Clone)]
pub enum Plan {
    /// See [`frequency_response`].
    FrequencyResponse(frequency_response::Plan),
    /// See [`ssid`].
    Ssid(ssid::Plan),
    /// See [`two_stimulus`].
    TwoStimulus(two_stimulus::Plan),
    /// See [`inverse`]: three kinds.
    Inverse(inverse::Plan),
    /// Kind `ssid` with several inputs and outputs; see [`ssid_mimo`].
    SsidMimo(ssid_mimo::Plan),
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
    /// It cannot be done, for a reason that the person who asked can read.
    #[error(transparent)]
    Problem(#[from] Problem),
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
            kind @ (Kind::InverseLqr | Kind::InverseLqe | Kind::InverseLqg) => {
                inverse::Plan::parse(request, kind).map(Self::Inverse)
            }
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
            Self::Inverse(plan) => plan.kind(),
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
            Self::Inverse(plan) => plan.references(),
            Self::SsidMimo(plan) => plan.references(),
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
            Self::Inverse(plan) => plan.request(),
            Self::SsidMimo(plan) => plan.request(),
            Self::InputDesign(plan) => plan.request(),
            Self::RobustInputDesign(plan) => plan.request(),
        }
    }

    /// Computes the report. Deterministic but for the times, which the caller adds.
    ///
    /// Runs on the rayon pool that it is called in.
    ///
    /// # Errors
    /// [`Failure::Stopped`] when `ctl` says so, [`Failure::Problem`] when the inputs cannot answer the question.
    pub fn run(&self, library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        match self {
            Self::FrequencyResponse(plan) => plan.run(library, ctl),
            Self::Ssid(plan) => plan.run(library, ctl),
            Self::TwoStimulus(plan) => plan.run(library, ctl),
            Self::Inverse(plan) => plan.run(library, ctl),
            Self::SsidMimo(plan) => plan.run(library, ctl),
            Self::InputDesign(plan) => plan.run(library, ctl),
            Self::RobustInputDesign(plan) => plan.run(library, ctl),
        }
    }
}
