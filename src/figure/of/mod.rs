//! Figures of stored things: values of the domain in, a [`Figure`](super::Figure) out.

pub mod bode;
pub mod learning_curves;
pub mod mean_bode;
mod places;
pub mod plant_check;
mod provenance;
pub mod response;
pub mod signals;
pub mod simulated;

pub use provenance::{ReportOrigin, TrialOrigin, Units};
