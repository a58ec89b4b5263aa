//! The exact search: every stable candidate is screened, and what rounding leaves open is decided by orthogonalisation.

use super::exact::{Fit, Problem};
use super::kernel::{Fixed, LANES};
use super::pool::{FeedbackPool, Row};
use super::stability::Tester;
use crate::ctl::{Bracket, Ctl, Stopped};
use crate::identify::problem::NEAR;
use rayon::prelude::*;

/// The best candidate, and how it was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Optimum {
    /// Its index among all listed candidates.
    pub listed_index: u64,
    /// Its index among the stable ones.
    pub index: u64,
    /// Its coefficients, row by row.
    pub coefficients: Vec<Vec<f64>>,
    /// The best feedforward for it.
    pub fit: Fit,
    /// Stable candidates.
    pub pool_size: u64,
    /// Candidates decided by orthogonalisation.
    pub decided_by_qr: u64,
    /// Candidates, the best one included, whose cost is at most `1 + NEAR` times the best one's, or cannot be told from
    /// that by rounding.
    pub near_optimal: u64,
    /// Whether there are more than that: counting stops at [`MOST_NEAR`].
    pub near_optimal_is_capped: bool,
}

/// Near-optimal candidates counted at most.
pub const MOST_NEAR: usize = 4_000_000;

/// Candidates of one work item at most, all with the same upper rows.
const BLOCK: u64 = 4096;

/// Candidates between two reductions, about; costs memory where rounding tells nothing apart.
const WAVE: u64 = 1 << 18;

/// Items between two reductions at most.
const WAVE_ITEMS: usize = 1 << 14;

/// Open candidates decided at once; ties to the lowest index may end the decision after any batch.
const BATCH: usize = 256;

/// One combination of upper rows and a range of the last row.
struct Item {
    upper: u64,
    from: u64,
    to: u64,
}

/// A screened candidate that may be the best, or near it.
#[derive(Debug, Clone, Copy)]
struct Open {
    listed_index: u64,
    index: u64,
    /// Approximate cost and how far it may be off; both +∞ where screening says nothing.
    cost: f64,
    error: f64,
}

impl Open {
    /// No candidate costs less than this; −∞ where screening says nothing.
    fn lower(self) -> f64 {
        if self.cost.is_finite() { self.cost - self.error } else { f64::NEG_INFINITY }
    }
}

#[derive(Default)]
struct Found {
    stable: u64,
    open: Vec<Open>,
}

/// Finds the candidate with the smallest cost of all stable ones, and of several with the same cost the first: costs
/// are those of [`Problem::fit`], and costs that are zero but for rounding are equal. `None` where no candidate is
/// stable.
///
/// Progress is in listed candidates. Runs on the rayon pool that it is called in, with the same answer for any number
/// of threads.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
///
/// # Panics
/// If more candidates are listed than a u64 counts, which the caller refuses first.
pub fn search(problem: &Problem, pool: &FeedbackPool, tester: &Tester, ctl: &Ctl) -> Result<Option<Optimum>, Stopped> {
    let listed = u64::try_from(pool.listed()).unwrap_or_else(|_| panic!("{} candidates", pool.listed()));
    let per_upper = pool.rows().last().map_or(1, Row::count) as u64;
    ctl.set_total(listed);
    ctl.begin_search();
    let mut best: Option<(Open, Vec<Vec<f64>>, Fit)> = None;
    let mut near: Vec<f64> = Vec::new();
    let (mut capped, mut pool_size, mut decided) = (false, 0_u64, 0_u64);
    let (mut upper, mut from) = (0_u64, 0_u64);
    while upper < listed / per_upper {
        let mut items = Vec::new();
        let mut held = 0;
        while upper < listed / per_upper && held < WAVE && items.len() < WAVE_ITEMS {
            let to = per_upper.min(from + BLOCK);
            items.push(Item { upper, from, to });
            held += to - from;
            (upper, from) = if to == per_upper { (upper + 1, 0) } else { (upper, to) };
        }
        let bound = best.as_ref().map_or(f64::INFINITY, |(_, _, fit)| fit.cost.max(fit.rounding));
        let found: Vec<Found> = items
            .par_iter()
            .map(|item| {
                let found = screen(problem, pool, tester, item, bound, ctl)?;
                ctl.advance(item.to - item.from);
                Ok(found)
            })
            .collect::<Result<_, Stopped>>()?;
        let mut open = Vec::new();
        for part in found {
            open.extend(part.open.into_iter().map(|o| Open { index: o.index + pool_size, ..o }));
            pool_size += part.stable;
        }
        decided += decide(problem, pool, &open, &mut best, ctl)?;
        let Some((open_best, _, fit)) = &best else { continue };
        // Nothing is known of the candidates that are still to come.
        ctl.set_bracket(Bracket { incumbent: fit.cost.max(0.0), bound: 0.0, index: open_best.index });
        let limit = near_limit(fit);
        near.retain(|lower| *lower <= limit);
        near.extend(open.iter().map(|o| o.lower()).filter(|lower| *lower <= limit));
        if near.len() > MOST_NEAR {
            near.truncate(MOST_NEAR);
            capped = true;
        }
    }
    Ok(best.map(|(open, coefficients, fit)| Optimum {
        listed_index: open.listed_index,
        index: open.index,
        coefficients,
        near_optimal: near.len() as u64,
        near_optimal_is_capped: capped,
        pool_size,
        decided_by_qr: decided,
        fit,
    }))
}

fn near_limit(fit: &Fit) -> f64 {
    (1.0 + NEAR) * fit.cost.max(fit.rounding)
}

/// Decides the open candidates that may be better than the best one so far; how many it took.
fn decide(
    problem: &Problem,
    pool: &FeedbackPool,
    open: &[Open],
    best: &mut Option<(Open, Vec<Vec<f64>>, Fit)>,
    ctl: &Ctl,
) -> Result<u64, Stopped> {
    let least = open.iter().map(|o| o.cost + o.error).fold(f64::INFINITY, f64::min);
    let mut rest: Vec<Open> = open.iter().copied().filter(|o| o.lower() <= least).collect();
    let mut decided = 0;
    while !rest.is_empty() {
        ctl.check()?;
        let mut limit = f64::INFINITY;
        if let Some((_, _, fit)) = best {
            limit = fit.cost;
            // Later candidates can only tie.
            if fit.compared() == 0.0 {
                break;
            }
        }
        rest.retain(|o| o.lower() <= limit);
        let batch: Vec<Open> = rest.drain(..rest.len().min(BATCH)).collect();
        decided += batch.len() as u64;
        let fits: Vec<Option<(Vec<Vec<f64>>, Fit)>> = batch
            .par_iter()
            .map(|o| {
                ctl.check()?;
                let coefficients = pool.candidate(o.listed_index);
                Ok(problem.fit(pool, &coefficients).map(|fit| (coefficients, fit)))
            })
            .collect::<Result<_, Stopped>>()?;
        for (o, fit) in batch.into_iter().zip(fits) {
            let Some((coefficients, fit)) = fit else { continue };
            // In the order of indices, so that the first of equals stays.
            if best.as_ref().is_none_or(|(_, _, known)| fit.compared() < known.compared()) {
                *best = Some((o, coefficients, fit));
            }
        }
    }
    Ok(decided)
}

/// Screens one item; candidates that cannot be near the best of the item, or near `bound`, are left out.
fn screen(
    problem: &Problem,
    pool: &FeedbackPool,
    tester: &Tester,
    item: &Item,
    bound: f64,
    ctl: &Ctl,
) -> Result<Found, Stopped> {
    ctl.check()?;
    let rows = pool.rows();
    let Some((last, upper_rows)) = rows.split_last() else { return Ok(Found::default()) };
    let mut upper = Vec::with_capacity(upper_rows.len());
    let mut rest = item.upper;
    for row in upper_rows.iter().rev() {
        let count = row.count() as u64;
        upper.push(row.candidate(rest % count));
        rest /= count;
    }
    upper.reverse();

    let mut of_last = tester.last_row(&upper);
    let mut stable: Vec<(u64, Vec<f64>)> = Vec::new();
    for index in item.from..item.to {
        let coefficients = last.candidate(index);
        if of_last.is_stable(&coefficients) {
            stable.push((index, coefficients));
        }
    }
    let mut found = Found { stable: stable.len() as u64, open: Vec::with_capacity(stable.len()) };
    if stable.is_empty() {
        return Ok(found);
    }
    let first = item.upper * last.count() as u64;
    let opened = |rank: usize, cost: f64, error: f64| Open {
        listed_index: first + stable[rank].0,
        index: rank as u64,
        cost,
        error,
    };
    if problem.lines.is_wide() {
        // The fast evaluation separates the controls at every line, which fewer outputs do not.
        for (rank, (index, _)) in stable.iter().enumerate() {
            ctl.check()?;
            let fit = problem.fit(pool, &pool.candidate(first + index));
            let (cost, error) = fit.map_or((f64::INFINITY, f64::INFINITY), |fit| (fit.cost, fit.rounding));
            if cost.is_finite() && cost - error <= (1.0 + NEAR) * bound {
                found.open.push(opened(rank, cost, error));
            }
        }
        return Ok(found);
    }
    let Some(fixed) = Fixed::new(problem, pool, &upper) else {
        // Nothing is known of these but that they are stable.
        found.open = (0..stable.len()).map(|rank| opened(rank, f64::INFINITY, f64::INFINITY)).collect();
        return Ok(found);
    };
    let mut costs: Vec<(f64, f64)> = Vec::with_capacity(stable.len() + LANES);
    pulp::Arch::new().dispatch(|| {
        let mut scratch = fixed.scratch();
        let mut lanes = vec![[0.0; LANES]; last.coefficients.len()];
        for batch in stable.chunks(LANES) {
            ctl.check()?;
            for n in 0..LANES {
                // The last batch is filled up with its own last candidate.
                let (_, coefficients) = &batch[n.min(batch.len() - 1)];
                lanes.iter_mut().zip(coefficients).for_each(|(lane, c)| lane[n] = *c);
            }
            let screened = fixed.screen(&lanes, &mut scratch);
            costs.extend((0..batch.len()).map(|n| (screened.cost[n], screened.error[n])));
        }
        Ok::<(), Stopped>(())
    })?;
    let least = costs.iter().map(|(cost, error)| cost + error).fold(bound, f64::min);
    let limit = (1.0 + NEAR) * least.max(0.0);
    found.open = costs
        .iter()
        .enumerate()
        .map(|(rank, (cost, error))| opened(rank, *cost, *error))
        .filter(|o| o.lower() <= limit)
        .collect();
    Ok(found)
}
