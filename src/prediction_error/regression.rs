//! Weighted least squares over several records that have some of their parameters in common.
//!
//! Each record i has `b_i = X_i θ_i + S_i s + w_i` with parameters θ_i of its own, shared ones s, and noise of a
//! variance σ_i² of its own. With an orthonormal basis `Q = [Q₁ Q₂]` of `[X S]`, Q₁ that of X, everything but
//! `Q₂ᵀb = R₂₂ s + …` is fitted by the record's own parameters, so that s minimises `Σ ‖z₂ − R₂₂ s‖²/σ_i²`. The
//! variances are iterated.
//!
//! The covariance is the sandwich: with the score `g(t) = q(t) w(t)` of a record, and `M = Σ_{|l| ≤ L} (1 − |l|/(L+1))
//! Σ_t g(t) g(t+l)ᵀ` (Newey and West, *Econometrica* 55, 1987), which is positive semidefinite by construction: it is
//! the sum of squares of moving sums of L + 1 scores, over L + 1.

use super::design::{Columns, Layout};
use super::orthonormal::orthonormalise;
use super::tall::{product, remove, subtract};
use crate::ctl::{Ctl, Stopped};
use nalgebra::{DMatrix, DVector};

/// The weights are iterated until none changes by more than this share.
const WEIGHTS_SETTLED: f64 = 1e-9;

/// Rounds of the weights at most.
const MOST_ROUNDS: usize = 100;

/// The floor of errors of shared parameters: with more records than this their variances are those of so many. Without
/// it intervals from 40 trials covered 49 – 75 % where six covered 86 – 90 % (docs/limits.md).
const MOST_AVERAGED: f64 = 6.0;

/// Why a regression has no answer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(super) enum RegressionError {
    /// Shared columns depend on each other in every record.
    #[error("column {0} depends on those before it")]
    Dependent(usize),
    /// The control is fitted exactly.
    #[error("record {0} is fitted without any error")]
    NoNoise(usize),
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

/// A record, compressed to what the shared parameters need.
struct Compressed {
    /// Basis of its own columns, then of what the shared ones add.
    q: DMatrix<f64>,
    /// Its own columns that are independent.
    kept: Vec<usize>,
    /// `Q₁ᵀX` of those, upper triangular; `Q₁ᵀS`; `Q₂ᵀS`.
    r11: DMatrix<f64>,
    r12: DMatrix<f64>,
    r22: DMatrix<f64>,
    z1: DVector<f64>,
    z2: DVector<f64>,
    /// What no column reaches.
    outside: DVector<f64>,
}

impl Compressed {
    fn new(record: &Columns, own: usize, ctl: &Ctl) -> Result<Self, Stopped> {
        let found = orthonormalise(&[&record.columns], ctl)?;
        let kept: Vec<usize> = found.kept.iter().copied().filter(|j| *j < own).collect();
        let (first, shared) = (kept.len(), record.columns.ncols() - own);
        let second = found.q.ncols() - first;
        let r = product(&found.q, &record.columns, ctl)?;
        let mut outside = record.target.clone();
        let z = subtract(&found.q, &DVector::zeros(found.q.ncols()), &mut outside, ctl)?;
        remove(&found.q, &z, &mut outside, ctl)?;
        Ok(Self {
            r11: DMatrix::from_fn(first, first, |i, j| if i <= j { r[(i, kept[j])] } else { 0.0 }),
            r12: r.view((0, own), (first, shared)).into_owned(),
            r22: r.view((first, own), (second, shared)).into_owned(),
            z1: z.rows(0, first).into_owned(),
            z2: z.rows(first, second).into_owned(),
            q: found.q,
            kept,
            outside,
        })
    }

    fn samples(&self) -> f64 {
        self.outside.len() as f64
    }

    fn variance(&self, s: &DVector<f64>) -> f64 {
        ((&self.z2 - &self.r22 * s).norm_squared() + self.outside.norm_squared()) / self.samples()
    }

    fn residuals(&self, s: &DVector<f64>) -> DVector<f64> {
        let inside = &self.z2 - &self.r22 * s;
        &self.outside + self.q.columns(self.kept.len(), inside.len()) * inside
    }

    /// The record's own parameters; those of dependent columns are zero.
    fn own(&self, s: &DVector<f64>, own: usize) -> DVector<f64> {
        let mut all = DVector::zeros(own);
        let solved = solve_vector(&self.r11, &(&self.z1 - &self.r12 * s));
        for (k, column) in self.kept.iter().enumerate() {
            all[*column] = solved[k];
        }
        all
    }

    /// The Newey–West sum of the record's scores.
    fn meat(&self, residuals: &DVector<f64>, correlation: usize, ctl: &Ctl) -> Result<DMatrix<f64>, Stopped> {
        let (samples, columns) = self.q.shape();
        // Sums over correlation + 1 scores, from the first that holds one to the last: in blocks, so that each product
        // is one of matrices.
        let mut sums = DMatrix::zeros(samples + correlation, columns);
        for j in 0..columns {
            ctl.check()?;
            let mut sum = 0.0;
            let column = self.q.column(j);
            for t in 0..samples + correlation {
                if t < samples {
                    sum += column[t] * residuals[t];
                }
                if t > correlation {
                    sum -= column[t - correlation - 1] * residuals[t - correlation - 1];
                }
                sums[(t, j)] = sum;
            }
        }
        Ok(product(&sums, &sums, ctl)? / (correlation + 1) as f64)
    }
}

/// `R⁻¹X` of an upper triangular R without a zero on its diagonal.
fn solve_upper(r: &DMatrix<f64>, x: &DMatrix<f64>) -> DMatrix<f64> {
    if r.nrows() == 0 {
        return DMatrix::zeros(0, x.ncols());
    }
    r.solve_upper_triangular(x).unwrap_or_else(|| DMatrix::from_element(x.nrows(), x.ncols(), f64::NAN))
}

fn solve_vector(r: &DMatrix<f64>, x: &DVector<f64>) -> DVector<f64> {
    solve_upper(r, &DMatrix::from_column_slice(x.len(), 1, x.as_slice())).column(0).into_owned()
}

/// The answer for one record.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Solution {
    /// Its own parameters and the shared ones.
    pub parameters: DVector<f64>,
    /// Their covariance (sandwich).
    pub covariance: DMatrix<f64>,
    /// The residuals.
    pub residuals: DVector<f64>,
    /// Their mean square.
    pub variance: f64,
}

/// The answer for all records.
pub(super) struct Joint {
    pub records: Vec<Solution>,
    /// `Σ n_i ln σ_i²`, which is −2 ln L of Gaussian noise but for a constant.
    pub deviance: f64,
}

/// Solves the regression of all records together, without covariances where `correlation` is `None`.
pub(super) fn solve(
    records: impl Iterator<Item = Result<Columns, Stopped>>,
    layout: &Layout,
    correlation: Option<usize>,
    ctl: &Ctl,
) -> Result<Joint, RegressionError> {
    let mut compressed = Vec::new();
    for record in records {
        ctl.check()?;
        let record = Compressed::new(&record?, layout.own, ctl)?;
        // A command of few sinusoids determines few columns of the feedforward; everything else must be determined.
        let missing = (0..layout.own).find(|j| !record.kept.contains(j) && !layout.feedforward.contains(j));
        if let Some(missing) = missing {
            return Err(RegressionError::Dependent(missing));
        }
        compressed.push(record);
    }
    let shared = layout.all - layout.own;
    let mut weights = vec![1.0; compressed.len()];
    // Those that the shared parameters were found with.
    let mut used = weights.clone();
    let mut s = DVector::zeros(shared);
    let mut inverse = DMatrix::zeros(shared, 0);
    for _ in 0..MOST_ROUNDS {
        ctl.check()?;
        if shared > 0 {
            (s, inverse) = shared_parameters(&compressed, &weights, layout, ctl)?;
            used.clone_from(&weights);
        }
        let mut largest: f64 = 0.0;
        for (i, (record, weight)) in compressed.iter().zip(&mut weights).enumerate() {
            let variance = record.variance(&s);
            let power = record.outside.norm_squared() + record.z1.norm_squared() + record.z2.norm_squared();
            // Nothing but rounding is left.
            let is_noise = variance * record.samples() > 1e-24 * power;
            if !is_noise {
                return Err(RegressionError::NoNoise(i));
            }
            largest = largest.max((1.0 / variance / *weight - 1.0).abs());
            *weight = 1.0 / variance;
        }
        // With one record its weight cancels.
        if largest <= WEIGHTS_SETTLED || compressed.len() == 1 || shared == 0 {
            break;
        }
    }
    let deviance = compressed.iter().zip(&weights).map(|(record, w)| -record.samples() * w.ln()).sum();
    let information = &inverse * inverse.transpose();
    let mut solutions = Vec::new();
    let mut meats = Vec::new();
    let mut common = DMatrix::zeros(shared, shared);
    for (record, weight) in compressed.iter().zip(&used) {
        ctl.check()?;
        let residuals = record.residuals(&s);
        if let Some(correlation) = correlation {
            let first = record.kept.len();
            let meat = record.meat(&residuals, correlation, ctl)?;
            // How the scores of this record move the shared parameters.
            let gain = &information * record.r22.transpose() * *weight;
            let second = meat.nrows() - first;
            common += &gain * meat.view((first, first), (second, second)) * gain.transpose();
            meats.push((meat, gain));
        }
        let mut parameters = DVector::zeros(layout.all);
        parameters.rows_mut(0, layout.own).copy_from(&record.own(&s, layout.own));
        parameters.rows_mut(layout.own, shared).copy_from(&s);
        let variance = record.variance(&s);
        solutions.push(Solution { parameters, covariance: DMatrix::zeros(0, 0), residuals, variance });
    }
    // What is left with many records is bias of the form, which no number of them lessens.
    common *= (compressed.len() as f64 / MOST_AVERAGED).max(1.0);
    for ((record, solution), (meat, gain)) in compressed.iter().zip(&mut solutions).zip(&meats) {
        solution.covariance = covariance(record, meat, gain, &common, layout);
    }
    Ok(Joint { records: solutions, deviance })
}

/// The shared parameters, and a P with `P Pᵀ = (Σ R₂₂ᵀR₂₂/σ²)⁻¹`; parameters of the feedforward that the records do not
/// determine are zero.
fn shared_parameters(
    compressed: &[Compressed],
    weights: &[f64],
    layout: &Layout,
    ctl: &Ctl,
) -> Result<(DVector<f64>, DMatrix<f64>), RegressionError> {
    let shared = layout.all - layout.own;
    let rows: usize = compressed.iter().map(|record| record.r22.nrows()).sum();
    let (mut stacked, mut target) = (DMatrix::zeros(rows, shared), DVector::zeros(rows));
    let mut at = 0;
    for (record, weight) in compressed.iter().zip(weights) {
        let count = record.r22.nrows();
        stacked.rows_mut(at, count).copy_from(&(&record.r22 * weight.sqrt()));
        target.rows_mut(at, count).copy_from(&(&record.z2 * weight.sqrt()));
        at += count;
    }
    let found = orthonormalise(&[&stacked], ctl)?;
    let is_missing = |j: &usize| !found.kept.contains(j) && !layout.feedforward.contains(&(layout.own + j));
    if let Some(missing) = (0..shared).find(is_missing) {
        return Err(RegressionError::Dependent(layout.own + missing));
    }
    let rank = found.kept.len();
    let r = found.q.tr_mul(&stacked.select_columns(&found.kept)).upper_triangle();
    let solved = solve_vector(&r, &found.q.tr_mul(&target));
    let inverse = solve_upper(&r, &DMatrix::identity(rank, rank));
    let (mut s, mut p) = (DVector::zeros(shared), DMatrix::zeros(shared, rank));
    for (k, j) in found.kept.iter().enumerate() {
        s[*j] = solved[k];
        p.row_mut(*j).copy_from(&inverse.row(k));
    }
    Ok((s, p))
}

/// The covariance of a record's own parameters and the shared ones. With `δs = Σ_j G_j Q₂ᵀw_j` and
/// `δθ = R₁₁⁻¹ (Q₁ᵀw − R₁₂ δs)`.
fn covariance(
    record: &Compressed,
    meat: &DMatrix<f64>,
    gain: &DMatrix<f64>,
    common: &DMatrix<f64>,
    layout: &Layout,
) -> DMatrix<f64> {
    let (first, shared) = (record.kept.len(), common.nrows());
    let second = meat.nrows() - first;
    let through = solve_upper(&record.r11, &record.r12);
    let inverse = solve_upper(&record.r11, &DMatrix::identity(first, first));
    let cross = &inverse * meat.view((0, first), (first, second)) * gain.transpose();
    let mixed = &cross * through.transpose();
    let own = &inverse * meat.view((0, 0), (first, first)) * inverse.transpose() - &mixed - mixed.transpose()
        + &through * common * through.transpose();
    let beside = &cross - &through * common;
    let mut all = DMatrix::zeros(layout.all, layout.all);
    for (i, row) in record.kept.iter().enumerate() {
        for (j, column) in record.kept.iter().enumerate() {
            all[(*row, *column)] = own[(i, j)];
        }
        for j in 0..shared {
            all[(*row, layout.own + j)] = beside[(i, j)];
            all[(layout.own + j, *row)] = beside[(i, j)];
        }
    }
    all.view_mut((layout.own, layout.own), (shared, shared)).copy_from(common);
    all
}
