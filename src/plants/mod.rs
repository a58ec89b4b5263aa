//! Known plants, the commands that subjects follow, and simulated subjects.

pub mod catalogue;
pub mod commands;
pub mod head_neck;
pub mod inverse;
pub mod seated_balance;
pub mod study;
pub mod subject;

pub use catalogue::{ParametricPlant, Plant};
pub use head_neck::HeadNeck;
pub use seated_balance::SeatedBalance;
pub use study::SimulatedStudy;
pub use subject::SimulatedSubject;
