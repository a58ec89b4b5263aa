//! Simulated people, the reference signals that they follow, and whole simulated studies.

pub mod closed_loop;
pub mod inverse_dynamics;
pub mod reference_signals;
pub mod study;
pub mod subject;

pub use study::SimulatedStudy;
pub use subject::SimulatedSubject;
