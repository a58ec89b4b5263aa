//! The search for the best candidate of a pool.
//!
//! | folder | holds |
//! |---|---|
//! | `simd` | what the kernels share: lanes of two precisions, packed LDLᵀ, dispatch by the sizes of the half-bases |
//! | `screen` | what a search is asked and answers; one candidate by QR; every candidate by normal equations |
//! | `factored` | branch and bound over candidates as products of poles, zeros and gains |
//! | `sensitivity` | branch and bound over clusters of controllers of like sensitivity |
//! | `equivalent` | the candidates that the data cannot tell from the best one: how many, and how far they differ |
//!
//! Each uses those before it. [`Automatic`] chooses among them, and asks for pools and their trees where its caller
//! keeps them.

mod automatic;
mod equivalent;
mod factored;
mod keys;
pub(crate) mod prepared;
pub(super) mod screen;
mod sensitivity;
pub(crate) mod simd;

pub use automatic::Automatic;
pub use equivalent::question::{BandNorms, Question};
pub use equivalent::ranges::{EquivalentRanges, ExtremeMember, NormRange, ranges};
pub use equivalent::share::{Share, share};
pub use equivalent::threshold::{LEVEL, Threshold};
pub use factored::search::FactoredSearch;
pub use factored::trees::FactorTrees;
pub use prepared::{KeepNothing, Prepared, PreparedPools, RecipeOnPlant};
pub use screen::exact;
pub use screen::exhaustive::Exhaustive;
pub use screen::optimum::{MOST_NEAR, Method, Optimum, Search};
pub use sensitivity::build::clusters::Clusters;
pub use sensitivity::search::SensitivitySearch;
