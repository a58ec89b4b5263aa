//! A candidate with its best feedforward numerator, as transfer functions.

use super::exact;
use crate::control::{Continuous, System, TransferFunction};
use crate::identify::pool::{Candidate, Pool};
use crate::identify::problem::Problem;
use crate::identify::time::Time;

/// A coefficient overflows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("not finite: {0}")]
pub(crate) struct NotFinite(pub &'static str);

/// The cost by QR, and Gff and Gfb.
pub(crate) fn systems(problem: &Problem, pool: &Pool, candidate: &Candidate) -> Result<(f64, [System; 2]), NotFinite> {
    let fit = exact::fit(problem, candidate);
    let time = pool.region().time;
    let feedforward = system(time, &fit.feedforward_numerator, &candidate.feedforward_denominator, "feedforward")?;
    Ok((fit.cost, [feedforward, feedback(pool, candidate)?]))
}

/// Gfb.
pub(crate) fn feedback(pool: &Pool, candidate: &Candidate) -> Result<System, NotFinite> {
    let numerator: Vec<f64> = candidate.feedback_numerator.iter().map(|c| candidate.feedback_gain * c).collect();
    system(pool.region().time, &numerator, &candidate.feedback_denominator, "feedback")
}

fn system(time: Time, num: &[f64], den: &[f64], part: &'static str) -> Result<System, NotFinite> {
    match time {
        Time::Continuous => TransferFunction::new(num, den, Continuous).map(System::Continuous),
        Time::Sampled(time) => TransferFunction::new(num, den, time).map(System::Discrete),
    }
    .map_err(|_| NotFinite(part))
}
