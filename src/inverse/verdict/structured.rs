//! The certificate that no weights of a structure make a gain optimal.
//!
//! For every N the weights that satisfy the equalities have `⟨X, Q⟩ = −⟨R, T⟩` ([`super::dual`]). Where the
//! structure holds entries of Q at zero X may be changed there, and T likewise: if the allowed entries of X complete to
//! a definite matrix, and those of T to one with `⟨R, T⟩ > 0` for every R of the structure, there are no weights.
//!
//! N follows from a candidate `(X̂, T̂)` by least squares: `⟨X, Q⟩ + ⟨T, R⟩ = −2⟨N, BᵀPM − RK⟩` for every Q and R, with
//! P of the closed loop and M = I (A − BK in sampled time), so that each allowed entry gives one equation.

use super::dual::{DualTest, Prepared};
use super::primal::CLEAR;
use crate::control::lyapunov::{Clock, Lyapunov};
use crate::inverse::gains::Gains;
use crate::inverse::reach::Core;
use crate::inverse::structure::Structure;
use crate::num::linalg::{self, NoConvergence};
use nalgebra::{DMatrix, DVector};

/// Singular values of the equations below this share of the largest are rounding.
const NULL: f64 = 1e-13;
/// Sizes of X beside T where no weights at all satisfy the equalities.
const SIZES: [f64; 4] = [1.0, 1e-2, 1e-4, 1e-6];

/// What proves that a structure has no weights.
#[derive(Debug, Clone, PartialEq)]
pub struct Refutation {
    /// N, m×n, in the units of the plant.
    pub n: DMatrix<f64>,
    /// The margin of `⟨R, T⟩` over what the rounding of the data makes of it; above 1.
    pub ratio: f64,
}

/// A structure in balanced units: what of X and T counts, and what the rest may be.
pub(super) struct Completion<'a> {
    structure: &'a Structure,
    /// X̂, n×n, and T̂, m×m.
    x: DMatrix<f64>,
    t: DMatrix<f64>,
    /// R up to its scale, with trace m, where it is given.
    pub r: Option<DMatrix<f64>>,
}

impl Completion<'_> {
    /// X with the entries of the candidate where the structure holds Q at zero. Of a state that Q does not weigh at all
    /// X may be as large as wanted.
    pub(super) fn states(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        let weighs = |i: usize| self.structure.allows(i, i);
        let largest = x.amax().max(self.x.amax());
        DMatrix::from_fn(x.nrows(), x.ncols(), |i, j| match (weighs(i) && weighs(j), self.structure.allows(i, j)) {
            (_, true) => x[(i, j)],
            (true, false) => self.x[(i, j)],
            (false, false) => {
                if i == j {
                    largest
                } else {
                    0.0
                }
            }
        })
    }

    /// A change of X, where it counts.
    pub(super) fn allowed(&self, change: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(
            change.nrows(),
            change.ncols(),
            |i, j| {
                if self.structure.allows(i, j) { change[(i, j)] } else { 0.0 }
            },
        )
    }

    /// T likewise.
    pub(super) fn inputs(&self, t: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(t.nrows(), t.ncols(), |i, j| {
            if self.structure.allows_input(i, j) { t[(i, j)] } else { self.t[(i, j)] }
        })
    }
}

/// A certificate that the structure has no weights, from the dual of its margin, (X̂, T̂) in the units of the plant;
/// with none where the equalities alone leave nothing.
///
/// # Errors
/// [`NoConvergence`] where a decomposition fails.
pub(in crate::inverse) fn refuted(
    gains: &Gains,
    structure: &Structure,
    dual: Option<[DMatrix<f64>; 2]>,
) -> Result<Option<Refutation>, NoConvergence> {
    let reach = &gains.reach;
    let core = reach.plant();
    let (n, m) = (core.states(), core.ports());
    if gains.states() != n {
        // The errors from set points have a box of their own, which nobody computes.
        return Ok(None);
    }
    let Some(test) = DualTest::new(&core) else { return Ok(None) };
    let candidates: Vec<[DMatrix<f64>; 2]> = match dual {
        Some([x, t]) => vec![[reach.dual_of_states(&x), reach.dual_of_inputs(&t)]],
        None => SIZES.map(|size| [DMatrix::identity(n, n) * size, DMatrix::identity(m, m)]).to_vec(),
    };
    let fixed = structure.r.as_ref().map(|r| {
        let r = reach.balanced_input_weight(r);
        &r * (m as f64 / r.trace())
    });
    let directions: Vec<(DMatrix<f64>, DMatrix<f64>)> = structure
        .directions(n, m)
        .into_iter()
        .map(|(q, r)| if structure.r.is_some() && r.amax() > 0.0 { (q, fixed.clone().unwrap_or(r)) } else { (q, r) })
        .collect();
    let Some(equations) = equations(&core, &directions) else { return Ok(None) };
    let (u, values, v) = linalg::svd(&equations)?;
    let kept = values.iter().take(n * m).filter(|s| **s > NULL * values[0]).count();
    let mut best: Option<(f64, Prepared)> = None;
    for [x, t] in candidates {
        let wanted = DVector::from_iterator(directions.len(), directions.iter().map(|(q, r)| x.dot(q) + t.dot(r)));
        let right = u.tr_mul(&wanted);
        let solution = DVector::from_fn(kept, |i, _| right[i] / values[i]);
        let multiplier = DMatrix::from_column_slice(m, n, (v.columns(0, kept) * solution).as_slice());
        let completion = Completion { structure, x, t, r: fixed.clone() };
        let Some(prepared) = test.completed(&multiplier, &completion).filter(|p| p.margin > 0.0) else { continue };
        let by_gain = test.moved_by_gain(&prepared, &core.rounding.k);
        let ratio = test.ratio(&prepared, &core.rounding.k, &by_gain).unwrap_or(0.0);
        if best.as_ref().is_none_or(|(best, _)| ratio > *best) {
            best = Some((ratio, prepared));
        }
    }
    let proven = best.filter(|(ratio, _)| *ratio > CLEAR);
    Ok(proven.map(|(ratio, prepared)| Refutation { n: reach.multiplier_of_plant(&prepared.n), ratio }))
}

/// `−2 vec(BᵀPM − RK)` of the directions, one row each.
fn equations(core: &Core, directions: &[(DMatrix<f64>, DMatrix<f64>)]) -> Option<DMatrix<f64>> {
    let Core { b, k, clock, .. } = core;
    let closed = core.closed_loop();
    let equation = Lyapunov::new(&closed, *clock).ok()?;
    let mut rows = DMatrix::zeros(directions.len(), k.len());
    for (mut row, (q, r)) in rows.row_iter_mut().zip(directions) {
        let p = equation.solve(&(q + k.tr_mul(&(r * k))));
        let bp = match clock {
            Clock::Continuous => b.tr_mul(&p),
            Clock::Sampled => b.tr_mul(&(p * &closed)),
        };
        let misfit = (bp - r * k) * -2.0;
        row.copy_from(&DVector::from_column_slice(misfit.as_slice()).transpose());
    }
    Some(rows)
}
