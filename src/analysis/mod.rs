//! Analyses: an unchecked request becomes a checked [`Plan`], a plan and its inputs become a [`Report`].
//!
//! One file per kind. Nothing here knows about HTTP, databases or clocks: a [`Problem`] says what is wrong in words and
//! leaves the status code to the API.

pub mod excitation;
pub mod frequency_problem;
pub mod frequency_response;
pub mod gain_fit;
pub mod ids;
pub mod input_design;
pub mod inputs;
pub mod inverse;
pub mod kind;
pub mod plan;
pub mod problem;
mod reading;
pub mod report;
pub mod robust_input_design;
pub mod ssid;
pub mod ssid_mimo;
pub mod trial_input;
pub mod trial_problem;
pub mod two_stimulus;

pub use inputs::{Library, References, StoredTrial};
pub use kind::{Kind, Request};
pub use plan::{Failure, Incumbent, Plan};
pub use problem::{Code, Problem};
pub use reading::FittedTrials;
pub use report::{Effort, Provenance, Report, Warning};
pub use trial_input::{PlantNeed, ResolvedTrial, TrialInputs};
