//! What a search needs of a pool and the lines, whatever was measured.

use super::ranges::Ranges;
use super::tree::{Deviation, Tree};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::Pool;
use crate::identify::problem::Problem;
use num_complex::Complex64;

/// Members of the leaves of the feedback trees.
pub(super) const LEAF: usize = 2;

/// The trees of a pool at the lines of a problem. All trials with the same plant, lines and pool share it.
#[derive(Debug)]
pub struct FactorTrees {
    /// Responses `1/D`, scaled to a geometric mean of one over the lines, and what each was divided by.
    pub(crate) denominators: Factors,
    pub(crate) numerators: Factors,
    pub(super) feedforward: Factors,
    pub(crate) ranges: Ranges,
    /// How many denominators make a stable loop without feedback, and the first of them.
    pub(super) without_feedback: Option<(u64, usize)>,
    /// Logarithmic distance of neighbouring gains, on average.
    pub(crate) gain_step: f64,
}

/// The factors of one kind.
#[derive(Debug)]
pub(crate) struct Factors {
    pub tree: Tree,
    pub responses: Vec<Vec<Complex64>>,
    pub scales: Vec<f64>,
}

impl Factors {
    fn new(
        mut responses: Vec<Vec<Complex64>>,
        deviation: Deviation,
        leaf: usize,
        scaled: bool,
        ctl: &Ctl,
    ) -> Result<Self, Stopped> {
        let mut scales = vec![1.0; responses.len()];
        if scaled {
            for (response, scale) in responses.iter_mut().zip(&mut scales) {
                let logs: Vec<f64> =
                    response.iter().map(|x| x.norm()).filter(|m| (1e-12..1e12).contains(m)).map(f64::ln).collect();
                *scale = crate::num::stats::mean(&logs).map_or(1.0, f64::exp);
                response.iter_mut().for_each(|x| *x /= *scale);
            }
        }
        Ok(Self { tree: Tree::new(&responses, deviation, leaf, ctl)?, responses, scales })
    }
}

impl FactorTrees {
    /// Builds the trees. The measured responses of the problem are not used.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn new(problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Self, Stopped> {
        let table = pool.feedback();
        let denominators = table.denominators().iter().map(|d| problem.reciprocal_at_lines(&d.coefficients)).collect();
        let numerators = table.numerators().iter().map(|n| problem.at_lines(&n.coefficients)).collect();
        let feedforward = pool.feedforward().iter().map(|d| problem.at_lines(&d.coefficients)).collect();
        let (denominators, (numerators, feedforward)) = rayon::join(
            || Factors::new(denominators, Deviation::Logarithm, LEAF, true, ctl),
            || {
                rayon::join(
                    || Factors::new(numerators, Deviation::Logarithm, LEAF, true, ctl),
                    || Factors::new(feedforward, Deviation::Ratio, 1, false, ctl),
                )
            },
        );
        let (denominators, numerators, feedforward) = (denominators?, numerators?, feedforward?);
        let ranges = Ranges::new(
            table,
            [&denominators.tree, &numerators.tree],
            [&denominators.scales, &numerators.scales],
            ctl,
        )?;
        let mut without_feedback = None;
        for denominator in 0..table.denominators().len() {
            if !table.gains_of(denominator, None).is_empty() {
                let (count, first) = without_feedback.unwrap_or((0, denominator));
                without_feedback = Some((count + 1, first));
            }
        }
        let log_gains: Vec<f64> = table.gains().iter().map(|g| g.abs().ln()).collect();
        let (low, high) = log_gains.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
        let distinct = table.gains().len().max(2) as f64 / 2.0;
        let gain_step = if high > low { (high - low) / distinct } else { 1.0 };
        Ok(Self { denominators, numerators, feedforward, ranges, without_feedback, gain_step })
    }
}
