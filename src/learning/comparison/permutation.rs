//! Exact permutation tests over people, and the intervals that invert them.
//!
//! Under "the groups are alike" every allocation of the people to the groups is equally likely; p is the share of
//! allocations whose difference of means is at least as large as the observed one (Fisher 1935). With a shift δ taken
//! from the second group, the statistic of allocation j is `A_j − δ c_j`, linear in δ with |c_j| ≤ 1, and that of the
//! observed one `d − δ`. Allocation j counts as extreme while δ lies between the roots `(d − A_j)/(1 − c_j)` and `(d +
//! A_j)/(1 + c_j)`, an interval that holds d. So p(δ) falls on both sides of d, and the limits of the interval of all
//! shifts that the test at 5 % keeps are order statistics of those roots: one enumeration serves test and interval.

use crate::num::rng::stream;
use rand::RngExt as _;
use rand::seq::SliceRandom as _;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Allocations that are enumerated at most: 12 against 12 people are 2.7 million.
pub const MOST_ALLOCATIONS: u64 = 3_000_000;
/// Random allocations beyond: the standard error of p = 0.05 is then 0.0007.
pub const DRAWS: usize = 100_000;
/// Draws times people at most, which bounds the time: more than 500 people have fewer draws.
const MOST_WORK: usize = 50_000_000;
const FEWEST_DRAWS: usize = 1_000;
/// The stream of random numbers that draws them.
pub const STREAM: &str = "learning comparison permutation";
/// Statistics that differ by less than this, relative to 1 + the largest value, are ties, and count as extreme.
const TIE: f64 = 1e-12;
/// The level of the interval is one minus this.
const LEVEL: f64 = 0.05;

/// How the allocations were gone through.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "AllocationsSeen")]
pub enum Enumeration {
    /// Every one.
    Exact,
    /// At random, since there are more than three million; the observed one counts as one of them.
    MonteCarlo,
}

/// A test with its interval.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "PermutationTest")]
pub struct Permutation {
    /// Whether all allocations were gone through.
    pub enumeration: Enumeration,
    /// Allocations gone through.
    pub allocations: u64,
    /// The seed of the random allocations; null where all were gone through.
    pub seed: Option<u64>,
    /// The difference of the means (second group less first), or the mean of the changes.
    pub difference: f64,
    /// The two-sided p-value.
    pub p: f64,
    /// The standard error of p from random allocations; null where p is exact.
    pub p_standard_error: Option<f64>,
    /// The smallest p that as many people can give, whatever they do.
    pub smallest_p: f64,
    /// The 95 % interval: all shifts that the test at 5 % keeps.
    #[schemars(with = "Option<Vec<f64>>")]
    pub interval95: Option<[f64; 2]>,
    /// Why there is no interval.
    pub no_interval: Option<String>,
}

/// The test that two groups have one distribution, against a shift of the second; `None` where a group is empty.
///
/// Values count equally, whatever their errors.
#[must_use]
pub fn two_groups(first: &[f64], second: &[f64], seed: u64) -> Option<Permutation> {
    let (n, m) = (first.len(), second.len());
    if n == 0 || m == 0 {
        return None;
    }
    let all: Vec<f64> = second.iter().chain(first).copied().collect();
    let total: f64 = all.iter().sum();
    let (size, rest) = (m as f64, n as f64);
    // Sum of the values in the second group, and how many of them truly belong to it.
    let statistic =
        |sum: f64, own: usize| (sum / size - (total - sum) / rest, own as f64 / size - (size - own as f64) / rest);
    let count = binomial(n + m, m);
    let symmetric = n == m;
    let mut search = Extremes::new(&all, second.iter().sum::<f64>() / size - first.iter().sum::<f64>() / rest);
    if let Some(count) = count.filter(|c| *c <= MOST_ALLOCATIONS) {
        // With groups of equal size an allocation and its mirror image have opposite statistics: half will do.
        let half = if symmetric { 2 } else { 1 };
        search.reserve(count / half);
        let mut visit = |sum: f64, own: usize| {
            let (a, c) = statistic(sum, own);
            search.see(a, c);
        };
        if symmetric {
            choose(&all, m, 1, m - 1, all[0], 1, &mut visit);
        } else {
            choose(&all, m, 0, m, 0.0, 0, &mut visit);
        }
        return Some(search.exact(count, half, half as f64 / count as f64));
    }
    let mut random = stream(seed, STREAM);
    let mut order: Vec<usize> = (0..n + m).collect();
    let draws = draws(n + m);
    search.reserve(draws as u64);
    for _ in 0..draws {
        let (chosen, _) = order.partial_shuffle(&mut random, m);
        let sum = chosen.iter().map(|i| all[*i]).sum();
        let own = chosen.iter().filter(|i| **i < m).count();
        let (a, c) = statistic(sum, own);
        search.see(a, c);
    }
    // A binomial coefficient beyond 64 bits is still a number.
    let ways = (0..m).fold(1.0, |ways, i| ways * (n + m - i) as f64 / (i + 1) as f64);
    Some(search.random(seed, if symmetric { 2.0 } else { 1.0 } / ways))
}

/// The test that changes are as likely up as down (all `2ⁿ` choices of signs), against a shift; `None` of nobody.
#[must_use]
pub fn signs(changes: &[f64], seed: u64) -> Option<Permutation> {
    let n = changes.len();
    if n == 0 {
        return None;
    }
    let size = n as f64;
    let mut search = Extremes::new(changes, changes.iter().sum::<f64>() / size);
    let smallest = 2.0 * 0.5_f64.powi(i32::try_from(n).unwrap_or(i32::MAX));
    let count = u32::try_from(n).ok().and_then(|n| 1_u64.checked_shl(n)).filter(|c| *c <= MOST_ALLOCATIONS);
    if let Some(count) = count {
        // A choice and its opposite mirror each other: the first change keeps its sign.
        search.reserve(count / 2);
        for signs in 0..count / 2 {
            let (mut sum, mut positive) = (changes[0], 1.0);
            for (i, change) in changes.iter().enumerate().skip(1) {
                let sign = if signs >> (i - 1) & 1 == 0 { 1.0 } else { -1.0 };
                sum += sign * change;
                positive += sign;
            }
            search.see(sum / size, positive / size);
        }
        return Some(search.exact(count, 2, smallest));
    }
    let mut random = stream(seed, STREAM);
    let draws = draws(n);
    search.reserve(draws as u64);
    for _ in 0..draws {
        let (mut sum, mut positive) = (0.0, 0.0);
        for change in changes {
            let sign = if random.random::<bool>() { 1.0 } else { -1.0 };
            sum += sign * change;
            positive += sign;
        }
        search.see(sum / size, positive / size);
    }
    Some(search.random(seed, smallest))
}

/// Random allocations of so many people.
fn draws(people: usize) -> usize {
    DRAWS.min(MOST_WORK / people).max(FEWEST_DRAWS)
}

/// All ways to choose `left` more of the values from index `from` on, with the sum so far and how many of the chosen
/// are among the first `own_size`.
fn choose(
    values: &[f64],
    own_size: usize,
    from: usize,
    left: usize,
    sum: f64,
    own: usize,
    visit: &mut impl FnMut(f64, usize),
) {
    if left == 0 {
        return visit(sum, own);
    }
    for i in from..=values.len() - left {
        choose(values, own_size, i + 1, left - 1, sum + values[i], own + usize::from(i < own_size), visit);
    }
}

/// `n` over `m`; `None` beyond 64 bits.
fn binomial(n: usize, m: usize) -> Option<u64> {
    (0..m.min(n - m)).try_fold(1_u64, |ways, i| Some(ways.checked_mul((n - i) as u64)? / (i as u64 + 1)))
}

/// The fewest people in each of two equal groups for which a test at `level` exists.
#[must_use]
pub fn fewest_people(level: f64) -> usize {
    let exists = |n: &usize| binomial(2 * n, *n).is_none_or(|ways| 2.0 / ways as f64 <= level);
    (1..=40).find(exists).unwrap_or(40)
}

/// Collects what the allocations say.
struct Extremes {
    observed: f64,
    /// All values are equal: every shift but 0 would be rejected, which says nothing.
    constant: bool,
    tie: f64,
    extreme: u64,
    seen: u64,
    low: Vec<f64>,
    high: Vec<f64>,
}

impl Extremes {
    fn new(values: &[f64], observed: f64) -> Self {
        let largest = values.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
        let constant = values.iter().all(|v| *v == values[0]);
        let (low, high) = (Vec::new(), Vec::new());
        Self { observed, constant, tie: TIE * (1.0 + largest), extreme: 0, seen: 0, low, high }
    }

    fn reserve(&mut self, allocations: u64) {
        let count = usize::try_from(allocations).unwrap_or(0);
        self.low.reserve_exact(count);
        self.high.reserve_exact(count);
    }

    /// An allocation whose statistic is `a − δ c`.
    fn see(&mut self, a: f64, c: f64) {
        let d = self.observed;
        self.seen += 1;
        self.extreme += u64::from(a.abs() >= d.abs() - self.tie);
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        // The observed allocation (c = 1) and its mirror image (c = −1) are extreme for every shift.
        if (1.0 - c.abs()) > TIE {
            let (one, other) = ((d - a) / (1.0 - c), (d + a) / (1.0 + c));
            (low, high) = (one.min(other), one.max(other));
        }
        self.low.push(low);
        self.high.push(high);
    }

    fn exact(mut self, allocations: u64, half: u64, smallest_p: f64) -> Permutation {
        let kept = LEVEL * self.seen as f64;
        let (interval95, no_interval) = self.interval(kept.floor() as usize, smallest_p);
        Permutation {
            enumeration: Enumeration::Exact,
            allocations,
            seed: None,
            difference: self.observed,
            p: (self.extreme * half) as f64 / allocations as f64,
            p_standard_error: None,
            smallest_p,
            interval95,
            no_interval,
        }
    }

    fn random(mut self, seed: u64, smallest_p: f64) -> Permutation {
        let all = self.seen as f64 + 1.0;
        let p = (self.extreme as f64 + 1.0) / all;
        let (interval95, no_interval) = self.interval((LEVEL * all - 1.0).floor() as usize, smallest_p);
        Permutation {
            enumeration: Enumeration::MonteCarlo,
            allocations: self.seen,
            seed: Some(seed),
            difference: self.observed,
            p,
            p_standard_error: Some((p * (1.0 - p) / self.seen as f64).sqrt()),
            smallest_p: smallest_p.max(1.0 / all),
            interval95,
            no_interval,
        }
    }

    /// More than `rejected` of the allocations are extreme at every shift within.
    fn interval(&mut self, rejected: usize, smallest_p: f64) -> (Option<[f64; 2]>, Option<String>) {
        if self.constant {
            return (None, Some("all people have the same value, which says nothing of the spread".to_owned()));
        }
        if smallest_p > LEVEL {
            let why = format!(
                "the smallest p of so few people is {}: no test at 5 % exists, and no interval that inverts it",
                super::text::number(smallest_p)
            );
            return (None, Some(why));
        }
        let last = self.low.len() - 1;
        let low = *self.low.select_nth_unstable_by(rejected.min(last), f64::total_cmp).1;
        let high = *self.high.select_nth_unstable_by(last - rejected.min(last), f64::total_cmp).1;
        (Some([low, high]), None)
    }
}
