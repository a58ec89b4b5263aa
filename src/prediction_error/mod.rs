//! Prediction error: the direct identification of a person in a closed loop, from what goes in and what comes out.
//!
//! With the error e = r − y, both recorded, the control is written as a regression on its own past, on the command and
//! on the error of at least a human delay ago (q⁻¹ is one sample back):
//!
//! ```text
//! A(q) u(t) = F(q) r(t) + E(q) e(t) + C(q) w(t)        Gff = F/A    Gfb = E/A    noise H = C/A
//! A = 1 − a₁q⁻¹ − …    E = Σ c_k q⁻ᵏ, every k of a range of delays    C = 1 + c₁q⁻¹ + … (1 in the default form)
//! ```
//! It is consistent in a closed loop when the noise model is rich enough and the loop has a delay (Ljung, *System
//! Identification*, 2nd edition, section 13.4; Forssell and Ljung, *Automatica* 35, 1999): the person's own noise then
//! excites the feedback at all frequencies, which is what a command alone cannot do. The lags of E are all left free,
//! because an interval that follows a chosen delay pretends that the delay is known.
//!
//! - [`record`], [`lags`]: trials at the working sample time, and which lags the regression has;
//! - [`feedforward`]: the columns of F, smooth in the lag, with the plant's slow zeros as poles;
//! - [`estimate`](mod@estimate): one regression for all trials, with covariances that hold for noise of unequal power;
//! - [`controllers`]: responses with regions, norms with intervals;
//! - [`residuals`], [`hypotheses`], [`change`]: what the residuals say, and tests;
//! - [`loops`]: the loop with the plant: stability, simulation; [`reduction`]: few parameters in place of many.

pub mod change;
pub mod controllers;
mod design;
pub mod estimate;
pub mod feedforward;
pub mod hypotheses;
pub mod lags;
pub mod loops;
mod moving_average;
mod orthonormal;
pub mod record;
pub mod reduction;
mod regression;
pub mod residuals;
mod tall;
