//! Proportions of people, their differences, and Fisher's exact test.

use crate::num::distributions::{NORMAL_95, beta_quantile, ln_gamma};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Tables whose probability exceeds the observed one by no more than this share are as extreme.
const TIE: f64 = 1e-7;

/// So many of so many people.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Proportion {
    /// Those that are.
    pub count: usize,
    /// Those of whom it can be said.
    pub of: usize,
    /// `count/of`; null of nobody.
    pub proportion: Option<f64>,
    /// Wilson's 95 % interval, for a picture; null of nobody.
    #[schemars(with = "Option<Vec<f64>>")]
    pub wilson95: Option<[f64; 2]>,
    /// The exact 95 % interval (Clopper and Pearson), for a claim; null of nobody.
    #[schemars(with = "Option<Vec<f64>>")]
    pub clopper_pearson95: Option<[f64; 2]>,
}

/// A proportion with its intervals.
///
/// Wilson (1927) inverts the score test; Clopper and Pearson (1934) invert the two binomial tails, by quantiles of the
/// beta distribution. Both work for none and for all.
#[must_use]
pub fn proportion(count: usize, of: usize) -> Proportion {
    if of == 0 {
        return Proportion { count, of, proportion: None, wilson95: None, clopper_pearson95: None };
    }
    let (x, n) = (count as f64, of as f64);
    let exact = [
        if count == 0 { 0.0 } else { beta_quantile(0.025, x, n - x + 1.0) },
        if count == of { 1.0 } else { beta_quantile(0.975, x + 1.0, n - x) },
    ];
    Proportion { count, of, proportion: Some(x / n), wilson95: Some(wilson(count, of)), clopper_pearson95: Some(exact) }
}

fn wilson(count: usize, of: usize) -> [f64; 2] {
    let (x, n, z2) = (count as f64, of as f64, NORMAL_95 * NORMAL_95);
    let share = x / n;
    let centre = (share + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = NORMAL_95 / (1.0 + z2 / n) * (share * (1.0 - share) / n + z2 / (4.0 * n * n)).sqrt();
    [if count == 0 { 0.0 } else { (centre - half).max(0.0) }, if count == of { 1.0 } else { (centre + half).min(1.0) }]
}

/// Two proportions of independent people.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProportionDifference {
    /// The second proportion less the first.
    pub difference: f64,
    /// Newcombe's 95 % interval, a hybrid of Wilson's.
    pub newcombe95: [f64; 2],
    /// The two-sided p-value of Fisher's exact test.
    pub fisher_p: f64,
    /// The smallest p that as many people can give with as many in all.
    pub smallest_p: f64,
    /// The p-value adjusted for all counts that are tested in this answer.
    pub p_adjusted: Option<f64>,
}

/// `second − first` of proportions of independent people (Newcombe 1998, method 10); `None` where one is of nobody.
#[must_use]
pub fn difference(first: &Proportion, second: &Proportion) -> Option<ProportionDifference> {
    let ([l1, u1], [l2, u2]) = (second.wilson95?, first.wilson95?);
    let (p1, p2) = (second.proportion?, first.proportion?);
    let difference = p1 - p2;
    let (p, smallest_p) = fisher(first.count, first.of, second.count, second.of);
    Some(ProportionDifference {
        difference,
        newcombe95: [
            difference - ((p1 - l1).powi(2) + (u2 - p2).powi(2)).sqrt(),
            difference + ((u1 - p1).powi(2) + (p2 - l2).powi(2)).sqrt(),
        ],
        fisher_p: p,
        smallest_p,
        p_adjusted: None,
    })
}

/// Fisher's exact test of two proportions: the probability, with as many in all, of tables no more probable than the
/// one observed; and the smallest that any table has.
#[must_use]
pub fn fisher(x1: usize, n1: usize, x2: usize, n2: usize) -> (f64, f64) {
    let choose = |n: usize, k: usize| {
        let ln_factorial = |m: usize| ln_gamma(m as f64 + 1.0);
        ln_factorial(n) - ln_factorial(k) - ln_factorial(n - k)
    };
    let all = x1 + x2;
    let probability = |x: usize| (choose(n1, x) + choose(n2, all - x) - choose(n1 + n2, all)).exp();
    let tables: Vec<f64> = (all.saturating_sub(n2)..=all.min(n1)).map(probability).collect();
    let two_sided = |observed: f64| tables.iter().filter(|p| **p <= observed * (1.0 + TIE)).sum::<f64>().min(1.0);
    let least = tables.iter().copied().fold(f64::INFINITY, f64::min);
    (two_sided(probability(x1)), two_sided(least))
}
