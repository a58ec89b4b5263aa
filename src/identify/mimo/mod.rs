//! Subsystem identification with several inputs and outputs (Zhang 2015, algorithm 4.1), in sampled time.
//!
//! The plant `y = Gy u`, `v = Gv u` is known, with n measured outputs y, l fed-back outputs v (the same, or others) and
//! m controls u; the person's control is `u = Gff r + Gfb (r − v)` with an FIR feedforward `Gff = Σ B_i z^{−i}` (m×l)
//! and a feedback in left fraction `Gfb = Dfb⁻¹ Nfb`. The closed loop from r to y is (equation 4.4)
//!
//! `G̃ = Gy (I + Gfb Gv)⁻¹ (Gfb + Gff) = Gy (Dfb + Nfb Gv)⁻¹ (Nfb + Dfb Gff)`.
//!
//! Of all feedbacks of a [`FeedbackPool`] with an asymptotically stable loop, each with its best feedforward, the one
//! is found whose closed loop comes closest to the data in `J = Σ weight ‖G̃ − H‖_F²` (equation 4.7).

mod diagnose;
mod error;
mod exact;
mod findings;
mod identify;
mod kernel;
mod lines;
mod pool;
mod search;
mod stability;

pub use diagnose::identifiability;
pub use error::{MOST_DERIVATIVES, MOST_STATES, MimoError};
pub use exact::{Fit, Problem};
pub use identify::{Identified, Plant, Settings, check, identify};
pub use lines::{Line, Lines, MatrixFrequencyData};
pub use pool::{AxisMatrix, Coefficient, Entry, FeedbackPool, MOST_CONTROLS, MOST_FED_BACK, Row};
pub use search::{MOST_NEAR, Optimum, search};
pub use stability::{LastRow, Tester};
