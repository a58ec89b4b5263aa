//! How many candidates of a pool the data cannot tell from the best one.

use super::question::Question;
use crate::ctl::{Ctl, Phase, Stopped};
use crate::identify::search::screen::within::{Partners, count_within};
use crate::num::rng;
use rand::RngExt;
use rayon::prelude::*;

/// Larger pools are sampled, unless they are to be counted: it takes about a second for so many.
const COUNTED: u64 = 100_000_000;

/// Feedback controllers that are drawn of a larger pool, each with all its feedforward denominators.
const DRAWS: u64 = 8192;

/// The seed of these draws. They are about the pool, not about the data, so nobody needs to choose it.
const SEED: u64 = 1;

/// The level of the interval of a sampled share.
const CONFIDENCE: f64 = 0.95;

/// The share of the pool that the set is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Share {
    /// Members of the set, a controller without feedback with every feedback denominator; `None` where the share is
    /// sampled.
    pub count: Option<u64>,
    /// Members over candidates.
    pub share: f64,
    /// Between which values it lies with a probability of 95 % or more; both alike where it is counted.
    pub interval: [f64; 2],
    /// Feedback controllers drawn; 0 where it is counted.
    pub draws: u64,
}

/// Counts the candidates that cost at most the limit, or estimates their share from random feedback controllers.
///
/// With n controllers drawn alike and with replacement, mean m and variance v of the shares of their denominators, the
/// interval is `m ± (√(2 v ln(4/α)/n) + 7 ln(4/α)/(3 (n − 1)))` with α = 0.05: it holds for every distribution of such
/// shares and every n (Maurer & Pontil 2009, theorem 4, on both sides).
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub fn share(question: &Question<'_>, always_count: bool, ctl: &Ctl) -> Result<Share, Stopped> {
    let Question { problem, pool, limit, .. } = *question;
    ctl.enter(Phase::Verification, 1.0);
    if always_count || pool.size() <= COUNTED {
        let count = count_within(problem, pool, limit, ctl)?;
        let share = count as f64 / pool.size() as f64;
        return Ok(Share { count: Some(count), share, interval: [share, share], draws: 0 });
    }
    ctl.set_total(DRAWS);
    let mut random = rng::stream(SEED, "equivalent share");
    let drawn: Vec<u64> = (0..DRAWS).map(|_| random.random_range(0..pool.feedback().len())).collect();
    let partners = Partners::new(problem, pool, limit);
    let all = pool.feedforward().len() as f64;
    let shares = drawn
        .par_iter()
        .map(|index| {
            ctl.check()?;
            let count = partners.count(pool.feedback().get(*index));
            ctl.advance(1);
            Ok(count as f64 / all)
        })
        .collect::<Result<Vec<f64>, Stopped>>()?;
    let n = DRAWS as f64;
    let share = shares.iter().sum::<f64>() / n;
    let variance = shares.iter().map(|s| (s - share).powi(2)).sum::<f64>() / (n - 1.0);
    let log = (4.0 / (1.0 - CONFIDENCE)).ln();
    let half = (2.0 * variance * log / n).sqrt() + 7.0 * log / (3.0 * (n - 1.0));
    Ok(Share { count: None, share, interval: [(share - half).max(0.0), (share + half).min(1.0)], draws: DRAWS })
}
