//! What trials say about learning: time-domain metrics, distances from the inverse dynamics, curves over trials,
//! groups.
//!
//! Everything here takes plain values ([`SubjectInput`]), so that a caller with a database, a file or a simulation can
//! use it.

pub mod bode;
pub mod comparison;
pub mod correlation;
pub mod curves;
mod disagreement;
pub mod frequency_domain;
pub mod groups;
pub mod inputs;
pub mod median_subject;
mod quadrature;
pub mod recording;
mod smoothness;
pub mod time_domain;
pub mod trend;
pub mod trust_grid;
mod trusted;

pub use bode::{StudyFrequencyResponses, TrialSelection, study_frequency_responses};
pub use comparison::report::StudyComparison;
pub use comparison::study::{ComparisonOptions, compare};
pub use curves::{CurveOptions, SubjectLearningCurve, subject_learning_curve};
pub use groups::{StudyLearningCurves, study_learning_curves};
pub use inputs::{
    Estimator, Identification, IdentifiedControllers, NormIntervals, PlantName, Remark, SpecChoice, StandardErrors,
    SubjectInput, TrialInput, choose_spec,
};
pub use trusted::{StatementTrust, TrustedQuantity, trust_of_identification};
