//! Inputs that tell the most about a person (Priess 2015, chapter 5).
//!
//! Of a linear model `y = G(θ) u` with white noise of covariance Σ the Fisher information of an experiment is `M(u) =
//! Σ_k (∂y_k/∂θ)ᵀ Σ⁻¹ (∂y_k/∂θ)`, quadratic in the input. [`climb()`] makes a [`Criterion`] of it large under
//! [`Limits`] on the input, on signals of the model and on the input's autocorrelation; [`refit()`] checks by
//! simulation what that does to the parameters' variances.

pub mod climb;
pub mod information;
pub mod limits;
pub mod refit;
pub mod responses;
pub mod step;

pub use climb::{Climb, ClimbError, Settings, Stop, climb};
pub use information::{Criterion, Fisher, Information, factor};
pub use limits::{Autocorrelation, Broken, Limits, OutputLimit};
pub use refit::{Refits, refit};
pub use responses::{Response, Responses};
pub use step::{Row, Step, step};
