//! Gains of a person, and parameters of the plant, from noisy trials by maximum likelihood (Priess 2015, eq. (3.25),
//! §3.5, §5.2).
//!
//! ```text
//! y_k = ŷ_k(θ) + w_k,  w_k ~ N(0, Σ) independent;
//! θ̂ = argmin log det Σ̂(θ),  Σ̂(θ) = (1/N) Σ_k e_k e_kᵀ,  e_k = y_k − ŷ_k(θ)
//! ```
//! ŷ is the response of the loop of plant and person ([`model`]), exact between the samples of inputs that are held; it
//! is simulated in closed loop only, and only where that is stable. Σ is not known beforehand: with it concentrated
//! out, the likelihood is the determinant above ([`noise`]). It is minimised by reweighted Levenberg-Marquardt steps
//! with exact sensitivities ([`estimate`]), which never increase it since `log det S ≤ log det Σ + tr(Σ⁻¹S) − p`, from
//! several starts that need no guess ([`starts`]). The covariance of θ̂ is the inverse of Fisher's information
//! ([`uncertainty`]).
//!
//! K and L together come from the innovation form ([`innovation`]): the same machinery, with the person's own predictor
//! as the model.
//!
//! A gain that is held to be optimal, and the test whether it is: [`optimal`].
//!
//! Costs and noises themselves, of which K and L are functions, are fitted by [`lqg`].

pub mod estimate;
pub mod experiment;
pub mod innovation;
pub mod lqg;
pub mod model;
pub mod noise;
pub mod optimal;
pub mod residuals;
pub mod starts;
pub mod uncertainty;

pub use estimate::{Estimate, FitError, Settings, fit};
pub use experiment::{Experiment, ExperimentError, Record};
pub use innovation::{Innovation, Predicted};
pub use model::LoopModel;
pub use noise::Noise;
