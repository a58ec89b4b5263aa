//! The candidates that are nearly as good as the best one, exactly, from costs that are only bracketed.

use super::exact;
use super::optimum::MOST_NEAR;
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::Candidate;
use crate::identify::problem::Problem;
use rayon::prelude::*;

/// A candidate whose cost lies between two values.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bracketed<T> {
    pub below: f64,
    pub above: f64,
    pub place: T,
}

/// Leaves out what cannot be among the [`MOST_NEAR`] best.
pub(super) fn prune<T>(candidates: &mut Vec<Bracketed<T>>) {
    if candidates.len() > MOST_NEAR {
        let mut above: Vec<f64> = candidates.iter().map(|c| c.above).collect();
        let (_, last, _) = above.select_nth_unstable_by(MOST_NEAR - 1, f64::total_cmp);
        let last = *last;
        // A bound that is no number says nothing.
        candidates.retain(|c| c.below <= last || c.below.is_nan());
    }
}

/// The [`MOST_NEAR`] best of those that cost `limit` at most, as (index, cost by QR): smallest cost first, of equals
/// the lowest index.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub(super) fn nearest<T: Send + Sync>(
    problem: &Problem,
    mut candidates: Vec<Bracketed<T>>,
    limit: f64,
    candidate: impl Fn(&T) -> Candidate + Sync,
    index: impl Fn(&T) -> u64 + Sync,
    ctl: &Ctl,
) -> Result<Vec<(u64, f64)>, Stopped> {
    candidates.retain(|c| c.below <= limit || c.below.is_nan());
    prune(&mut candidates);
    let mut costs = candidates
        .par_iter()
        .map(|c| {
            ctl.check()?;
            Ok((exact::cost(problem, &candidate(&c.place)), &c.place))
        })
        .collect::<Result<Vec<_>, Stopped>>()?;
    costs.retain(|(cost, _)| *cost <= limit);
    costs.sort_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((last, _)) = costs.get(MOST_NEAR - 1) {
        let last = *last;
        costs.retain(|(cost, _)| *cost <= last);
    }
    let mut near: Vec<(u64, f64)> = costs.par_iter().map(|(cost, place)| (index(place), *cost)).collect();
    near.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    near.truncate(MOST_NEAR);
    Ok(near)
}
