//! Known plants, the commands that subjects follow, and simulated subjects.

pub mod catalogue;
pub mod commands;
pub mod inverse;
pub mod study;
pub mod subject;

pub use catalogue::Plant;
pub use study::SimulatedStudy;
pub use subject::SimulatedSubject;
