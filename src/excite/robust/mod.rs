//! An experiment for people who are not known yet (Priess 2015, chapter 2).
//!
//! A target moves by filtered noise; its two parameters γ, the edge of the noise's band and the width of the screen,
//! are chosen so that the worst subject of a population is estimated best:
//!
//! ```text
//! γ_M = argmin_{γ ∈ Γ} max_{θ ∈ Θ} J(θ, γ),   J = 1/n Σ_j [ Σ_i ((θ̂_i^j − θ_i)/θ_i)² + L_a + L_T + L_n ]
//! ```
//! over draws j of a body and of muscle noise, the same for every θ and γ (common random numbers). In each draw the
//! motion of a simulated head ([`HeadNeck`](crate::plants::HeadNeck)) is fitted by the model with the mean body
//! ([`cost`]); L penalises excursions beyond the limits of acceleration, torque and angle. [`search`] follows the
//! thesis's simultaneous min-max (Vincent 1992; Table A.1, whose tests for the bounds are printed reversed and whose
//! signs are exchanged, as a projection on the box), and then makes sure of what that alone does not: that the worst
//! subject of the answer has been sought over all of Θ.
//!
//! The thesis leaves out the muscle, the filter of the derivative, sample time, length, number of draws, the scaling of
//! the noise, first steps and the average subject; all of these are declared in [`Setting`], and none of its printed
//! costs can be reproduced.

pub mod cost;
mod fit;
mod lanes;
mod motion;
mod sampled;
pub mod search;

pub use cost::{Draw, DrawCost, Setting, costs, draws};
pub use search::{Outcome, Search, Trace, Worst};

/// The controller's parameters in the order of θ: K_p, K_d, K_i and τ.
pub const THETA: [&str; 4] = ["k_p", "k_d", "k_i", "tau"];

/// The experiment's parameters in the order of γ: the edge of the pass band in Hz, the width of the screen in m.
pub const GAMMA: [&str; 2] = ["edge_hz", "width_m"];
