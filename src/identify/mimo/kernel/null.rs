//! Null vector and pseudo-inverse of the fixed rows.

use super::{Small, ZERO};
use crate::identify::mimo::pool::MOST_CONTROLS;
use nalgebra::DMatrix;
use num_complex::Complex64;

pub(super) fn norm(row: &[Complex64]) -> f64 {
    row.iter().map(|v| v.norm_sqr()).sum::<f64>().sqrt()
}

pub(super) fn inner(a: &[Complex64], b: &[Complex64]) -> Complex64 {
    a.iter().zip(b).map(|(x, y)| x.conj() * y).sum()
}

/// Null vector and pseudo-inverse (columns) of a wide matrix with m − 1 rows, and its condition number's bound; by Gram
/// and Schmidt, twice. `None` where its rows are dependent.
pub(super) fn null_and_inverse(rows: &[Small], m: usize) -> Option<(Small, Vec<Small>, f64)> {
    // F* = Q L* with orthonormal Q, so that F⁺ = Q (L*)⁻* and ñ is orthogonal to Q.
    let n = rows.len();
    let mut q = [[ZERO; MOST_CONTROLS]; MOST_CONTROLS];
    let mut l = [[ZERO; MOST_CONTROLS]; MOST_CONTROLS];
    let mut condition = 1.0_f64;
    for i in 0..n {
        let mut v: Small = rows[i].map(|c| c.conj());
        let size = norm(&v[..m]);
        for _ in 0..2 {
            for k in 0..i {
                let share = inner(&q[k][..m], &v[..m]);
                l[i][k] += share.conj();
                for c in 0..m {
                    v[c] -= share * q[k][c];
                }
            }
        }
        let length = norm(&v[..m]);
        if length <= 1e-14 * size || !length.is_normal() {
            return None;
        }
        l[i][i] = Complex64::new(length, 0.0);
        condition *= size / length;
        q[i] = v.map(|c| c / length);
    }
    // The unit vector that keeps most of itself beside Q.
    let keeps = |c: usize| 1.0 - (0..n).map(|k| q[k][c].norm_sqr()).sum::<f64>();
    let best = (0..m).max_by(|a, b| keeps(*a).total_cmp(&keeps(*b)))?;
    let mut null = [ZERO; MOST_CONTROLS];
    null[best] = Complex64::new(1.0, 0.0);
    for _ in 0..2 {
        for row in q.iter().take(n) {
            let share = inner(&row[..m], &null[..m]);
            for c in 0..m {
                null[c] -= share * row[c];
            }
        }
        let length = norm(&null[..m]);
        null = null.map(|c| c / length);
    }
    // Column j of F⁺ is Q w with L w = e_j (F = L Q*).
    let inverse = (0..n)
        .map(|j| {
            let mut w = [ZERO; MOST_CONTROLS];
            for i in j..n {
                let known: Complex64 = (j..i).map(|k| l[i][k] * w[k]).sum();
                w[i] = (if i == j { Complex64::new(1.0, 0.0) } else { ZERO } - known) / l[i][i];
            }
            let mut column = [ZERO; MOST_CONTROLS];
            for (k, row) in q.iter().enumerate().take(n) {
                for c in 0..m {
                    column[c] += row[c] * w[k];
                }
            }
            column
        })
        .collect();
    Some((null, inverse, condition))
}

/// A row times the inverse of an upper triangular matrix.
pub(super) fn over(row: &Small, root: &DMatrix<Complex64>) -> Small {
    let m = root.ncols();
    let mut x = [ZERO; MOST_CONTROLS];
    for c in 0..m {
        let known: Complex64 = (0..c).map(|k| x[k] * root[(k, c)]).sum();
        x[c] = (row[c] - known) / root[(c, c)];
    }
    x
}

pub(super) fn small(values: impl Iterator<Item = Complex64>) -> Small {
    let mut small = [ZERO; MOST_CONTROLS];
    for (to, value) in small.iter_mut().zip(values) {
        *to = value;
    }
    small
}
