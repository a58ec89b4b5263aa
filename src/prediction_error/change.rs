//! How much the feedback changed between first and last trials.
//!
//! Each block is estimated by itself, its trials jointly, so that nothing but noise and the form's bias is in the
//! difference; the errors of both add in squares.

use super::controllers::{NORMAL_95, Norm, NormEstimate};
use super::estimate::{Estimate, EstimateError, Settings, estimate};
use super::lags::Sharing;
use super::record::Record;
use crate::ctl::Ctl;
use num_complex::Complex64;

/// A change from one block to another.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// The norm in the first block.
    pub first: NormEstimate,
    /// In the last one.
    pub last: NormEstimate,
    /// Last less first.
    pub change: f64,
    /// Its 95 % interval.
    pub interval: [f64; 2],
    /// The estimates of both blocks.
    pub estimates: [Estimate; 2],
}

/// The change of ‖Gfb‖ over a band in rad/s from one block of records to another; `None` where a norm is infinite.
///
/// # Errors
/// [`EstimateError`] of either block; records are counted within their block.
pub fn change_of_feedback(
    first: &[Record],
    last: &[Record],
    settings: &Settings,
    band_rad_s: [f64; 2],
    ctl: &Ctl,
) -> Result<Option<Change>, EstimateError> {
    let sharing = Sharing { noise: true, feedback: true, ..settings.sharing };
    let settings = Settings { sharing, ..settings.clone() };
    let (a, b) = (estimate(first, &settings, ctl)?, estimate(last, &settings, ctl)?);
    let no_plant = |_: f64| Complex64::from(1.0);
    let of = |e: &Estimate| e.norm(0, Norm::Feedback, &no_plant, band_rad_s);
    let (Some(first), Some(last)) = (of(&a), of(&b)) else { return Ok(None) };
    let change = last.value - first.value;
    let half = NORMAL_95 * first.standard_error.hypot(last.standard_error);
    Ok(Some(Change { first, last, change, interval: [change - half, change + half], estimates: [a, b] }))
}
