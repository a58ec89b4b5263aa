//! The best candidate of a pool for the responses to both stimuli: the search of SSID where a disturbance at the
//! plant's input was recorded beside the command.
//!
//! `J = Σ w_r |G̃_yr − H_yr|² + Σ w_d |G̃_yd − H_yd|²` over the lines of each. The second sum depends on the feedback
//! alone, `G̃_yd = G/(1 + G Gfb)`, and the first is for every feedback and feedforward denominator a linear
//! least-squares problem of the feedforward numerator, as in [`crate::identify::problem`]. A feedback whose second sum
//! alone exceeds the best J is passed over with all its feedforward denominators: exact, since the first sum is not
//! negative. Ties go to the lowest index.

use crate::ctl::{Bracket, Ctl, Phase, Stopped};
use crate::identify::pool::{Candidate, Pool};
use crate::identify::problem::Problem;
use crate::identify::search::exact;
use num_complex::Complex64;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// A line of the disturbance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DisturbanceLine {
    /// Angular frequency in rad/s.
    pub omega_rad_s: f64,
    /// The plant there, finite and not zero.
    pub plant: Complex64,
    /// Measured response from disturbance to output.
    pub response: Complex64,
    /// Weight of its squared misfit, positive.
    pub weight: f64,
}

/// Why there is no best candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PoolSearchError {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// The pool is larger than allowed.
    #[error("the pool holds {size} candidates, and at most {limit} are searched")]
    Unaffordable {
        /// Candidates.
        size: u64,
        /// The limit.
        limit: u64,
    },
    /// There is no line of the disturbance.
    #[error("the disturbance excites no line, so the data do not tell feedback from feedforward")]
    NoDisturbance,
}

/// The best candidate.
#[derive(Debug, Clone, PartialEq)]
pub struct Best {
    /// Its index in the pool.
    pub index: u64,
    /// J.
    pub cost: f64,
    /// The part of J from the disturbance.
    pub disturbance_cost: f64,
    /// It, but for its feedforward numerator.
    pub candidate: Candidate,
    /// Coefficients of its feedforward numerator, descending powers.
    pub feedforward_numerator: Vec<f64>,
    /// Candidates whose least-squares problem was solved; the others are proven no better.
    pub evaluated: u64,
}

/// The part of J that the feedback decides.
fn disturbance_cost(lines: &[DisturbanceLine], feedback: &[Complex64]) -> f64 {
    lines
        .iter()
        .zip(feedback)
        .map(|(line, gfb)| line.weight * (line.plant / (1.0 + line.plant * gfb) - line.response).norm_sqr())
        .sum()
}

/// Finds the best candidate; `problem` holds the lines of the command, `lines` those of the disturbance. Progress is in
/// blocks.
///
/// # Errors
/// [`PoolSearchError`].
pub fn search(
    problem: &Problem,
    lines: &[DisturbanceLine],
    pool: &Pool,
    max_candidates: u64,
    ctl: &Ctl,
) -> Result<Best, PoolSearchError> {
    if pool.size() > max_candidates {
        return Err(PoolSearchError::Unaffordable { size: pool.size(), limit: max_candidates });
    }
    if lines.is_empty() {
        return Err(PoolSearchError::NoDisturbance);
    }
    let table = pool.feedback();
    let points: Vec<Complex64> = lines.iter().map(|line| problem.time().point(line.omega_rad_s)).collect();
    let at = |descending: &[f64]| -> Vec<Complex64> {
        points.iter().map(|x| descending.iter().fold(Complex64::default(), |sum, c| sum * x + c)).collect()
    };
    let numerators: Vec<Vec<Complex64>> = table.numerators().iter().map(|n| at(&n.coefficients)).collect();
    let denominators: Vec<Vec<Complex64>> = table.denominators().iter().map(|d| at(&d.coefficients)).collect();
    let count = pool.feedforward().len() as u64;
    let evaluated = AtomicU64::new(0);
    // Costs are not negative, and their bits are ordered as they are.
    let bound = AtomicU64::new(f64::INFINITY.to_bits());
    let blocks = table.blocks();
    ctl.enter(Phase::Search, 1.0);
    ctl.set_total(2 * blocks as u64);
    ctl.begin_search();

    // Visits every feedback of a block with its index and its part of the cost.
    let each = |block: usize, visit: &mut dyn FnMut(u64, f64) -> Result<(), Stopped>| -> Result<(), Stopped> {
        let mut index = table.before(block);
        let mut feedback = vec![Complex64::default(); lines.len()];
        table.walk(block, ctl, |row| {
            let denominator = &denominators[row.denominator];
            for gain in row.gains {
                for (k, value) in feedback.iter_mut().enumerate() {
                    let numerator = row.numerator.map_or(Complex64::from(1.0), |n| numerators[n][k]);
                    *value = *gain * (numerator / denominator[k]);
                }
                visit(index, disturbance_cost(lines, &feedback))?;
                index += 1;
            }
            Ok(())
        })?;
        ctl.advance(1);
        Ok(())
    };
    // The best feedback for the disturbance alone gives the first bound.
    let first = (0..blocks)
        .into_par_iter()
        .map(|block| {
            let mut best = (f64::INFINITY, u64::MAX);
            each(block, &mut |index, cost| {
                if cost < best.0 {
                    best = (cost, index);
                }
                Ok(())
            })?;
            Ok(best)
        })
        .try_reduce(|| (f64::INFINITY, u64::MAX), |a, b| Ok(smaller(a, b)))
        .map_err(PoolSearchError::Stopped)?;
    let solve = |feedback: u64, own: f64| {
        let mut best = (f64::INFINITY, u64::MAX);
        for f in 0..count {
            let index = feedback * count + f;
            let cost = own + exact::cost(problem, &pool.candidate(pool.position(index)));
            best = smaller(best, (cost, index));
        }
        evaluated.fetch_add(count, Ordering::Relaxed);
        bound.fetch_min(best.0.to_bits(), Ordering::Relaxed);
        best
    };
    // The command adds to the disturbance's part, and nothing has a smaller one.
    let tell = |(cost, index): (f64, u64)| ctl.set_bracket(Bracket { incumbent: cost, bound: first.0, index });
    if first.1 < u64::MAX {
        tell(solve(first.1, first.0));
        evaluated.store(0, Ordering::Relaxed);
    }
    let (cost, index) = (0..blocks)
        .into_par_iter()
        .map(|block| {
            let mut best = (f64::INFINITY, u64::MAX);
            each(block, &mut |index, own| {
                // An equal cost may still have a lower index.
                if own <= f64::from_bits(bound.load(Ordering::Relaxed)) {
                    ctl.check()?;
                    best = smaller(best, solve(index, own));
                }
                Ok(())
            })?;
            tell(best);
            Ok(best)
        })
        .try_reduce(|| (f64::INFINITY, u64::MAX), |a, b| Ok(smaller(a, b)))
        .map_err(PoolSearchError::Stopped)?;
    let candidate = pool.candidate(pool.position(index.min(pool.size() - 1)));
    let fit = exact::fit(problem, &candidate);
    Ok(Best {
        index,
        cost,
        disturbance_cost: cost - fit.cost,
        candidate,
        feedforward_numerator: fit.feedforward_numerator,
        evaluated: evaluated.into_inner(),
    })
}

fn smaller(a: (f64, u64), b: (f64, u64)) -> (f64, u64) {
    if b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)).is_lt() { b } else { a }
}
