//! Gauss–Newton iterations where the noise has a moving average.
//!
//! With `w = C⁻¹ (u − X θ)` the derivatives are `−∂w/∂θ = C⁻¹X` and `−∂w/∂c_j = C⁻¹ q⁻ʲ w` (Ljung, *System
//! Identification*, section 10.3), so that a step is the regression of w on the filtered columns.

use super::design::{Columns, Layout};
use super::feedforward::recursion;
use super::regression::{Joint, RegressionError, solve};
use super::tall::columns;
use crate::ctl::{Ctl, Stopped};
use crate::num::Polynomial;
use nalgebra::{DMatrix, DVector};

/// Steps at most, and halvings of each.
const MOST_STEPS: usize = 60;
const MOST_HALVINGS: usize = 12;

/// A step that lowers the deviance by less than this much of a sample's share is the last.
const SETTLED: f64 = 1e-7;

/// The largest modulus of a zero of C.
const MOST_MODULUS: f64 = 0.98;

/// Solves the regression with a moving average, from that without.
///
/// The answer's residuals are those of the noise w; whether the steps settled comes with it.
pub(super) fn solve_with_moving_average(
    records: &[Columns],
    layout: &Layout,
    correlation: usize,
    ctl: &Ctl,
) -> Result<(Joint, bool), RegressionError> {
    let plain = without(records, layout, ctl)?;
    let mut parameters: Vec<DVector<f64>> = plain.records.iter().map(|r| r.parameters.clone()).collect();
    let mut best = plain.deviance;
    let mut settled = false;
    for _ in 0..MOST_STEPS {
        let steps = solve(filtered(records, &parameters, layout, ctl), layout, None, ctl)?;
        let mut scale = 1.0;
        let mut taken = false;
        for _ in 0..MOST_HALVINGS {
            ctl.check()?;
            let trial: Vec<DVector<f64>> =
                parameters.iter().zip(&steps.records).map(|(p, step)| p + scale * &step.parameters).collect();
            if trial.iter().all(|p| is_invertible(p, layout)) {
                let deviance = deviance(records, &trial, layout);
                if deviance < best {
                    settled = best - deviance < SETTLED * samples(records);
                    (parameters, best, taken) = (trial, deviance, true);
                    break;
                }
            }
            scale *= 0.5;
        }
        if !taken {
            settled = true;
        }
        if settled {
            break;
        }
    }
    // At the optimum the last regression's step is zero; its covariance is that of the parameters.
    let mut last = solve(filtered(records, &parameters, layout, ctl), layout, Some(correlation), ctl)?;
    for ((solution, p), record) in last.records.iter_mut().zip(parameters).zip(records) {
        let w = noise(record, &p, layout);
        solution.variance = w.norm_squared() / w.len() as f64;
        solution.residuals = w;
        solution.parameters = p;
    }
    last.deviance = best;
    Ok((last, settled))
}

/// The regression without moving average; its parameters are zero.
fn without(records: &[Columns], layout: &Layout, ctl: &Ctl) -> Result<Joint, RegressionError> {
    let ma = &layout.moving_average;
    let keep: Vec<usize> = (0..layout.all).filter(|j| !ma.contains(j)).collect();
    let own = keep.iter().filter(|j| **j < layout.own).count();
    let smaller = Layout { own, all: keep.len(), ..layout.clone() };
    let reduced =
        records.iter().map(|r| Ok(Columns { columns: columns(&r.columns, &keep, ctl)?, target: r.target.clone() }));
    let mut found = solve(reduced, &smaller, None, ctl)?;
    for record in &mut found.records {
        let mut all = DVector::zeros(layout.all);
        for (k, j) in keep.iter().enumerate() {
            all[*j] = record.parameters[k];
        }
        record.parameters = all;
    }
    Ok(found)
}

fn samples(records: &[Columns]) -> f64 {
    records.iter().map(|r| r.target.len() as f64).sum()
}

/// C in ascending powers of q⁻¹.
fn c_of(parameters: &DVector<f64>, layout: &Layout) -> Vec<f64> {
    std::iter::once(1.0).chain(layout.moving_average.clone().map(|j| parameters[j])).collect()
}

/// Whether the zeros of C are well inside the unit circle.
fn is_invertible(parameters: &DVector<f64>, layout: &Layout) -> bool {
    let roots = Polynomial::new(c_of(parameters, layout)).roots();
    parameters.iter().all(|p| p.is_finite()) && roots.is_ok_and(|roots| roots.iter().all(|z| z.norm() < MOST_MODULUS))
}

fn noise(record: &Columns, parameters: &DVector<f64>, layout: &Layout) -> DVector<f64> {
    // The columns of the moving average are zero here.
    let rest = &record.target - &record.columns * parameters;
    DVector::from_vec(recursion(&c_of(parameters, layout), rest.as_slice()))
}

fn deviance(records: &[Columns], parameters: &[DVector<f64>], layout: &Layout) -> f64 {
    records
        .iter()
        .zip(parameters)
        .map(|(record, p)| {
            let w = noise(record, p, layout);
            w.len() as f64 * (w.norm_squared() / w.len() as f64).ln()
        })
        .sum()
}

/// The regression of the residuals on the derivatives.
fn filtered<'a>(
    records: &'a [Columns],
    parameters: &'a [DVector<f64>],
    layout: &'a Layout,
    ctl: &'a Ctl,
) -> impl Iterator<Item = Result<Columns, Stopped>> + 'a {
    records.iter().zip(parameters).map(move |(record, p)| {
        let c = c_of(p, layout);
        let w = noise(record, p, layout);
        let filtered_noise = recursion(&c, w.as_slice());
        let mut columns = DMatrix::zeros(record.columns.nrows(), layout.all);
        for (j, column) in record.columns.column_iter().enumerate() {
            ctl.check()?;
            if layout.moving_average.contains(&j) {
                let lag = j - layout.moving_average.start + 1;
                for t in lag..columns.nrows() {
                    columns[(t, j)] = filtered_noise[t - lag];
                }
            } else {
                let x: Vec<f64> = column.iter().copied().collect();
                columns.column_mut(j).copy_from_slice(&recursion(&c, &x));
            }
        }
        Ok(Columns { columns, target: w })
    })
}
