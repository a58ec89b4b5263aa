//! Known plants: the catalogue, and models with named parameters.

pub mod catalogue;
pub mod head_neck;
pub mod seated_balance;

pub use catalogue::{ParametricPlant, Plant};
pub use head_neck::HeadNeck;
pub use seated_balance::SeatedBalance;
