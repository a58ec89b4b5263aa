//! The loop of a person around a plant as signals: with delays, preview, noise and an initial state.
//!
//! ```text
//! u(t) = Gff r(t − σ + p) + Gfb ε(t − τ) + w(t)     ε = r − y − n
//! y(t) = G (u + d)(t − θ)
//! ```
//! θ is the delay of the plant, σ that of the feedforward and p its preview, τ the delay of the feedback; w is the
//! remnant, n the error of perception, d a disturbance. All three systems are in one time base. In sampled time their
//! delays are poles at the origin, and only p is left.
//!
//! In continuous time every signal from outside goes straight from sample to sample ([`continuous`]), in sampled time
//! there is nothing between the samples ([`sampled`]).

mod closed;
mod continuous;
mod noise;
mod sampled;
mod simulator;
mod stability;

pub use closed::{ClosedLoop, Delays, LoopDefect, LoopResponses, Part};
pub use continuous::free_motion;
pub use noise::coloured;
pub use simulator::{Drive, NumericalError, Simulated, Simulator, SimulatorError};
pub use stability::{Pole, Unstable};
