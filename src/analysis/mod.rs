//! Analyses: a request becomes a checked [`Plan`], a plan and its inputs become a [`Report`].
//!
//! One folder a kind; [`contract`] says what a kind is, [`registry`] lists them. Nothing here knows about databases,
//! clocks or the network: a [`Problem`] says what is wrong in words.

pub mod compensator_design;
pub mod contract;
pub mod estimates;
pub mod excitation;
pub mod excitation_quality;
pub mod frequency_response;
pub mod gain_fit;
pub mod ids;
pub mod input_design;
pub mod inputs;
pub mod inverse;
pub mod inverse_lqe;
pub mod inverse_lqg;
pub mod inverse_lqr;
pub mod kind;
pub mod lqg_fit;
pub mod prediction_error;
pub mod problem;
mod reading;
pub mod registry;
pub mod report;
pub mod robust_input_design;
pub mod samples;
pub mod simulate;
pub mod ssid;
pub mod ssid_mimo;
pub mod two_stimulus;

pub use contract::{Analysis, Failure, Incumbent};
pub use inputs::library::{Library, References, StoredTrial};
pub use kind::{Kind, Request};
pub use problem::{Code, Problem};
pub use registry::Plan;
pub use report::{Effort, Provenance, Report, Warning};
