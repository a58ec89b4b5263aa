//! Costs, perceived noises and true noises of a person straight from trials, by maximum likelihood (Priess 2015, §4.3,
//! 4.4.2 and 6.3).
//!
//! The plant `x⁺ = Ax + B(u + m) + Ed + w`, `y = Cx + Dd + v` is controlled by `u = −Kx̂` of a filter that the person
//! made for noises W_p and V_p of their own belief, perhaps for a plant of their own belief, while the true noises are
//! W, V and M. K and L are no parameters but functions of the costs and of the perceived noises,
//!
//! ```text
//! K = (R + BᵀPB)⁻¹BᵀPA,  P = AᵀPA − AᵀPBK + Q(θ);    L = A S Cᵀ(CSCᵀ + V_p)⁻¹,  S = ASAᵀ − LCSAᵀ + W_p(θ)
//! ```
//! without an end ([`stationary`]), or those of a horizon that ends, or of noise that grows with the control
//! ([`gains`]); each of the matrices is `Σ_i e^{θ_i} M_i` with known shapes M_i ([`design`]). Delays of the senses are
//! states ([`delay`]). Plant and belief make one linear system with noise ([`joint`]), what was recorded of it are some
//! of its outputs, and its exact likelihood is that of Kalman's predictor with a cross-covariance ([`covariance`],
//! [`course`], [`walk`], [`recursion`]). Gradients are exact: forward sensitivities of all of these equations
//! ([`jet`]). The likelihood is climbed by Fisher's scoring from several starts ([`mod@climb`], [`mod@starts`]); what
//! is known of the answer is said by profiles of the likelihood ([`mod@inference`]), and which other gains explain the
//! same records by [`mod@explanations`].

pub mod climb;
mod course;
mod covariance;
mod delay;
pub mod design;
pub mod explanations;
pub mod free_gains;
mod gains;
pub mod inference;
mod jet;
mod joint;
mod kernel;
pub mod recursion;
pub mod starts;
mod stationary;
mod walk;

pub use climb::{Climbed, climb};
pub use design::{Design, FilterStart, Horizon, Member, Plant, Recorded, Role, Start, Term, Timing};
pub use explanations::{Explanation, Hills, NoTwins, explanations, hills};
pub use free_gains::free_gains;
pub use inference::{Inference, Refusal, inference};
pub use recursion::{Evaluation, Problem, Record, RecordError};
pub use starts::{Fit, FitError, fit};
