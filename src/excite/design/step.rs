//! One step of a design: the best change of the input within a trust region, as a linear program.
//!
//! With the input `û + δ d`, the criterion grows by `δ gᵀd` to first order, and d keeps to
//!
//! ```text
//! −1 ≤ d ≤ 1,   the input's limits,   lower ≤ y(û) + δ G d ≤ upper,   |û_k − û_{k−1} + δ (d_k − d_{k−1})| ≤ change,
//! |dev_j + δ ∇_jᵀ d| ≤ max(β − γ, |dev_j|),   ∇_j = (û_{k−j} + û_{k+j} − 2 r_j û_k)_k / R(û; 0)
//! ```
//! where `dev_j = r_j − R*_j` is the deviation of the normalised autocorrelation `r_j`, linearised with its
//! denominator. (The thesis holds the denominator, eq. 5.10, whose error is of first order in the growth of the input;
//! and it tightens every lag to β − γ, which û itself may break, so that the program has no solution.) d = 0 always
//! satisfies all of it.
//!
//! # Rows that matter
//! A row whose largest value over the box stays within its limits is left out, which changes nothing. Of the others
//! only those that hold d back are needed: the program is solved with the rows that did so in the step before, the rows
//! that its answer breaks are added, and so on until it breaks none. The multipliers of the last program prove the
//! optimum of the whole.

use super::limits::{Limits, lagged};
use crate::convex::box_lp::{self, BoxLpError};
use crate::ctl::Ctl;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeSet;

/// Limits are tightened by this share of their width, so that the rounding of a solver does not break them.
const TIGHTER: f64 = 1e-9;
/// Rows added at most in a round, beside a share of those already taken.
const ADDED: usize = 64;
/// Rounds at most.
const ROUNDS: usize = 60;
/// A row counts as broken beyond this share of the largest value that it takes in the box.
const BROKEN: f64 = 1e-9;
/// The relative gap to which programs are solved.
const GAP: f64 = 1e-7;
/// A multiplier above this share of the largest one marks a row to begin the next step with.
const ACTIVE: f64 = 1e-6;

/// A row of the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Row {
    /// Sample `.1` of the limited output `.0`.
    Output(usize, usize),
    /// The change to this sample.
    Change(usize),
    /// The autocorrelation at this lag.
    Lag(usize),
}

/// The answer to a step.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// d, in units of the trust region.
    pub direction: DVector<f64>,
    /// `δ gᵀd`: the growth of the criterion to first order.
    pub gain: f64,
    /// No d that keeps to the rows has a larger `δ gᵀd`.
    pub bound: f64,
    /// Rows before screening, after it, and in the last program.
    pub rows: [usize; 3],
    /// Programs solved.
    pub rounds: usize,
    /// Steps of the interior-point method in all.
    pub iterations: usize,
}

/// What all rows have in common.
struct Rows<'a> {
    limits: &'a Limits,
    /// δ.
    radius: f64,
    u: &'a [f64],
    /// `R(û; 0)` and `r_j` of the lags 1, 2, ….
    power: f64,
    correlation: Vec<f64>,
}

/// A row that screening keeps, with its limits.
struct Kept {
    row: Row,
    range: [f64; 2],
    /// The largest value that it takes in the box.
    reach: f64,
}

impl Rows<'_> {
    /// `û_k`, zero outside the record.
    fn at(&self, k: isize) -> f64 {
        usize::try_from(k).ok().and_then(|k| self.u.get(k)).copied().unwrap_or(0.0)
    }

    /// The coefficients of a row.
    fn write(&self, row: Row, into: &mut [f64]) {
        into.fill(0.0);
        match row {
            Row::Output(output, sample) => {
                let impulse = &self.limits.outputs[output].response.impulse;
                for (i, a) in into.iter_mut().enumerate().take(sample + 1) {
                    *a = self.radius * impulse[sample - i];
                }
            }
            Row::Change(sample) => {
                into[sample] = self.radius;
                into[sample - 1] = -self.radius;
            }
            Row::Lag(lag) => {
                let (shift, r) = (lag as isize, self.correlation[lag - 1]);
                for (k, a) in into.iter_mut().enumerate() {
                    let k = k as isize;
                    *a = self.radius * (self.at(k - shift) + self.at(k + shift) - 2.0 * r * self.at(k)) / self.power;
                }
            }
        }
    }

    /// The values of all rows at d, in the order of `Rows::all`.
    fn values(&self, d: &[f64]) -> Vec<f64> {
        let mut values = Vec::new();
        for output in &self.limits.outputs {
            values.extend(output.response.forced(d).into_iter().map(|y| self.radius * y));
        }
        if self.limits.change.is_some() {
            values.extend(d.windows(2).map(|pair| self.radius * (pair[1] - pair[0])));
        }
        if self.limits.autocorrelation.is_some() {
            let own: f64 = self.u.iter().zip(d).map(|(u, d)| u * d).sum();
            for (i, r) in self.correlation.iter().enumerate() {
                let lag = i + 1;
                let cross: f64 = self.u.iter().skip(lag).zip(d).map(|(u, d)| u * d).sum::<f64>()
                    + d.iter().skip(lag).zip(self.u).map(|(d, u)| d * u).sum::<f64>();
                values.push(self.radius * (cross - 2.0 * r * own) / self.power);
            }
        }
        values
    }

    fn all(&self) -> Vec<Row> {
        let n = self.u.len();
        let outputs = (0..self.limits.outputs.len()).flat_map(|o| (0..n).map(move |k| Row::Output(o, k)));
        let changes = (1..if self.limits.change.is_some() { n } else { 1 }).map(Row::Change);
        let lags = (1..=self.correlation.len()).map(Row::Lag);
        outputs.chain(changes).chain(lags).collect()
    }

    /// Ranges of all rows for d, in the order of `Rows::all`: zero is always inside.
    fn ranges(&self) -> Vec<[f64; 2]> {
        let tightened = |value: f64, [lower, upper]: [f64; 2]| {
            let by = TIGHTER * (upper - lower);
            [(lower + by - value).min(0.0), (upper - by - value).max(0.0)]
        };
        let mut ranges = Vec::new();
        for output in &self.limits.outputs {
            ranges.extend(output.response.to(self.u).into_iter().map(|y| tightened(y, output.range)));
        }
        if let Some(limit) = self.limits.change {
            ranges.extend(self.u.windows(2).map(|pair| tightened(pair[1] - pair[0], [-limit, limit])));
        }
        if let Some(wanted) = &self.limits.autocorrelation {
            for (found, reference) in self.correlation.iter().zip(&wanted.reference) {
                let deviation = found - reference;
                let most = (wanted.tolerance - wanted.margin).max(deviation.abs());
                ranges.push([-most - deviation, most - deviation]);
            }
        }
        ranges
    }

    /// The rows that some d in the box breaks.
    fn screened(&self, sizes: &[f64]) -> Vec<Kept> {
        let mut row_values = vec![0.0; self.u.len()];
        let mut running: Vec<Vec<f64>> = Vec::new();
        let largest = sizes.iter().copied().fold(0.0, f64::max);
        for output in &self.limits.outputs {
            // Σ|h| up to each sample, times the largest size: at least what the row can reach.
            let mut sum = 0.0;
            running.push(
                output.response.impulse.iter().map(|h| (sum += h.abs(), sum * self.radius * largest).1).collect(),
            );
        }
        let mut kept = Vec::new();
        for (row, range) in self.all().into_iter().zip(self.ranges()) {
            let least = (-range[0]).min(range[1]);
            if let Row::Output(output, sample) = row
                && running[output][sample] <= least
            {
                continue;
            }
            self.write(row, &mut row_values);
            let reach: f64 = row_values.iter().zip(sizes).map(|(a, size)| a.abs() * size).sum();
            if reach > least {
                kept.push(Kept { row, range, reach });
            }
        }
        kept
    }
}

/// The best step from an input that keeps to the limits, along the gradient of the criterion, with the rows that held
/// the step before back; these are replaced by those that hold this one back.
///
/// # Errors
/// [`BoxLpError`]; never `Empty`.
///
/// # Panics
/// If gradient and input differ in length, which is a mistake of the caller.
pub fn step(
    limits: &Limits,
    u: &[f64],
    gradient: &DVector<f64>,
    radius: f64,
    active: &mut BTreeSet<Row>,
    ctl: &Ctl,
) -> Result<Step, BoxLpError> {
    let n = u.len();
    assert_eq!(gradient.len(), n, "a gradient of the input");
    let power = lagged(u, 0);
    let lags = limits.autocorrelation.as_ref().map_or(0, |wanted| wanted.reference.len());
    let correlation = (1..=lags).map(|lag| lagged(u, lag) / power).collect();
    let rows = Rows { limits, radius, u, power, correlation };
    // A sample at a limit, or beyond it by rounding, still has a little way to go inside.
    let lower = DVector::from_fn(n, |k, _| ((limits.input[0] - u[k]) / radius).clamp(-1.0, 0.0));
    let upper = DVector::from_fn(n, |k, _| ((limits.input[1] - u[k]) / radius).clamp(0.0, 1.0));
    let sizes: Vec<f64> = lower.iter().zip(upper.iter()).map(|(l, u)| -l.min(-*u)).collect();
    let kept = rows.screened(&sizes);
    let total = rows.all().len();
    let scale = Some(gradient.amax()).filter(|size| *size > 0.0).unwrap_or(1.0);
    let cost = gradient / scale;
    let positions: std::collections::BTreeMap<Row, usize> =
        rows.all().into_iter().enumerate().map(|(i, row)| (row, i)).collect();
    let mut taken: Vec<usize> = (0..kept.len()).filter(|i| active.contains(&kept[*i].row)).collect();
    let (mut iterations, mut rounds) = (0, 0);
    loop {
        ctl.check()?;
        rounds += 1;
        let m = taken.len();
        let mut transposed = DMatrix::zeros(n, m);
        for (mut column, index) in transposed.column_iter_mut().zip(&taken) {
            rows.write(kept[*index].row, column.as_mut_slice());
        }
        let limit = |side: usize| DVector::from_iterator(m, taken.iter().map(|i| kept[*i].range[side]));
        let program = box_lp::Program {
            cost: cost.clone(),
            bounds: [lower.clone(), upper.clone()],
            rows: transposed.transpose(),
            limits: [limit(0), limit(1)],
        };
        let solution = program.solve(GAP, ctl)?;
        iterations += solution.steps;
        let values = rows.values(solution.x.as_slice());
        let mut broken: Vec<(f64, usize)> = kept
            .iter()
            .enumerate()
            .filter(|(i, _)| taken.binary_search(i).is_err())
            .filter_map(|(i, kept)| {
                let value = values[positions[&kept.row]];
                let beyond = (kept.range[0] - value).max(value - kept.range[1]) / kept.reach;
                (beyond > BROKEN).then_some((beyond, i))
            })
            .collect();
        let most = solution.multipliers.amax();
        if broken.is_empty() || rounds >= ROUNDS {
            *active = taken
                .iter()
                .zip(solution.multipliers.iter())
                .filter(|(_, y)| y.abs() > ACTIVE * most)
                .map(|(i, _)| kept[*i].row)
                .collect();
            return Ok(Step {
                gain: radius * scale * solution.objective,
                bound: radius * scale * solution.bound,
                direction: solution.x,
                rows: [total, kept.len(), m],
                rounds,
                iterations,
            });
        }
        broken.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        // Rows that hold nothing back any more are let go, but not for ever, so that it ends.
        if rounds < ROUNDS / 2 {
            let mut y = solution.multipliers.iter();
            taken.retain(|_| y.next().is_some_and(|y| y.abs() > 1e-9 * most));
        }
        let more = ADDED.max(taken.len() / 2);
        taken.extend(broken.iter().take(more).map(|(_, i)| *i));
        taken.sort_unstable();
    }
}
