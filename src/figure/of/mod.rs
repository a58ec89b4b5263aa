//! Figures of stored things: values of the domain in, a [`Figure`](super::Figure) out.

pub mod bode;
pub mod compensator;
pub mod cost;
pub mod descent;
pub mod divergent;
mod document;
pub mod excitation;
pub mod input_design;
pub mod last_trial;
pub mod learning_curves;
pub mod mean_bode;
pub mod near_optimal;
pub mod overlay;
mod places;
pub mod plant_check;
pub mod plants;
pub mod poles;
mod provenance;
pub mod queue;
pub mod response;
pub mod return_difference;
pub mod scatter;
pub mod signals;
pub mod simulated;
pub mod simulation;
pub mod spectra;
pub mod trust_grid;

pub use provenance::{ReportOrigin, TrialOrigin, Units};
