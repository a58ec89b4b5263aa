//! Refinement: from the best candidate of a pool to a local optimum of all coefficients, the stability margin kept.
//!
//! ```text
//! minimise  J = Σ weight_k |G̃(jω_k) − H_k|²,   G̃ = G (Gff + Gfb)/(1 + G Gfb)
//! over      Nff, Dff (unless FIR), Nfb, Dfb (denominators monic), and delays where asked for
//! subject   every root of Dff and of Dp Dfb + Np Nfb inside the pool's region
//! ```
//! The numerator of the feedforward is projected out (Golub and Pereyra 1973); the others go by Levenberg-Marquardt
//! with the margins as smooth inequalities ([`least_squares`](crate::num::least_squares)). The pool's grids and gain
//! limits do not bind the refined controllers, its region does. A local optimum is what the equations say near one
//! candidate; only the pool's optimum is a global one, and of the pool.

mod bootstrap;
mod delayed_loop;
mod delays;
mod orders;
mod projection;
mod refinement;
mod region;
mod residuals;
mod setup;
mod uncertainty;
mod variable;

pub use bootstrap::{Bootstrap, BootstrapBand};
pub use delays::{Delay, Delays, ScanPoint, refine_with_delays};
pub use orders::Criteria;
pub use refinement::{ActiveConstraint, Refined, Refinement};
pub use residuals::ResidualTests;
pub use setup::{DelayValue, RefineError, Setup, Start};
pub use uncertainty::{Band, LEVEL, Noise, Parameter, Unavailable, Uncertainty};
