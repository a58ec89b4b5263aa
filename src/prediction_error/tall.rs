//! Sums over the rows of tall matrices, a block of rows at a time: what is read twice is still in the cache, and a stop
//! is seen between blocks.

use crate::ctl::{Ctl, Stopped};
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Rows of a block.
const ROWS: usize = 4096;

/// The blocks of so many rows.
pub(super) fn blocks(rows: usize) -> impl Iterator<Item = Range<usize>> {
    (0..rows).step_by(ROWS).map(move |from| from..(from + ROWS).min(rows))
}

fn view(m: &DMatrix<f64>) -> faer::MatRef<'_, f64> {
    faer::MatRef::from_column_major_slice(m.as_slice(), m.nrows(), m.ncols())
}

/// `XᵀY` of two matrices with as many rows.
///
/// # Errors
/// [`Stopped`].
pub(super) fn product(x: &DMatrix<f64>, y: &DMatrix<f64>, ctl: &Ctl) -> Result<DMatrix<f64>, Stopped> {
    let mut found = DMatrix::zeros(x.ncols(), y.ncols());
    let (from, to) = found.shape();
    for block in blocks(x.nrows()) {
        ctl.check()?;
        let target = faer::MatMut::from_column_major_slice_mut(found.as_mut_slice(), from, to);
        let (x, y) = (view(x).subrows(block.start, block.len()), view(y).subrows(block.start, block.len()));
        faer::linalg::matmul::matmul(target, faer::Accum::Add, x.transpose(), y, 1.0, faer::Par::Seq);
    }
    Ok(found)
}

/// `x ← x − Q c`, with the first columns of Q, as many as there are coefficients.
///
/// # Errors
/// [`Stopped`].
pub(super) fn remove(
    q: &DMatrix<f64>,
    coefficients: &DVector<f64>,
    x: &mut DVector<f64>,
    ctl: &Ctl,
) -> Result<(), Stopped> {
    for block in blocks(x.len()) {
        ctl.check()?;
        let mut part = x.rows_range_mut(block.clone());
        for (k, c) in coefficients.iter().enumerate() {
            part.axpy(-c, &q.column(k).rows_range(block.clone()), 1.0);
        }
    }
    Ok(())
}

/// `x ← x − Q c`, and `Qᵀx` of what is left, with the first columns of Q, as many as there are coefficients.
///
/// # Errors
/// [`Stopped`].
pub(super) fn subtract(
    q: &DMatrix<f64>,
    coefficients: &DVector<f64>,
    x: &mut DVector<f64>,
    ctl: &Ctl,
) -> Result<DVector<f64>, Stopped> {
    let mut left = DVector::zeros(coefficients.len());
    let nothing = coefficients.iter().all(|c| *c == 0.0);
    for block in blocks(x.len()) {
        ctl.check()?;
        let mut part = x.rows_range_mut(block.clone());
        for (k, c) in coefficients.iter().enumerate().filter(|_| !nothing) {
            part.axpy(-c, &q.column(k).rows_range(block.clone()), 1.0);
        }
        for (k, left) in left.iter_mut().enumerate() {
            *left += q.column(k).rows_range(block.clone()).dot(&part);
        }
    }
    Ok(left)
}

/// Some columns of a matrix.
///
/// # Errors
/// [`Stopped`].
pub(super) fn columns(of: &DMatrix<f64>, places: &[usize], ctl: &Ctl) -> Result<DMatrix<f64>, Stopped> {
    let mut found = DMatrix::zeros(of.nrows(), places.len());
    for (mut into, place) in found.column_iter_mut().zip(places) {
        ctl.check()?;
        into.copy_from(&of.column(*place));
    }
    Ok(found)
}

/// Some rows of a matrix.
///
/// # Errors
/// [`Stopped`].
pub(super) fn rows(of: &DMatrix<f64>, from: usize, count: usize, ctl: &Ctl) -> Result<DMatrix<f64>, Stopped> {
    let mut found = DMatrix::zeros(count, of.ncols());
    for (mut into, column) in found.column_iter_mut().zip(of.column_iter()) {
        ctl.check()?;
        into.copy_from(&column.rows(from, count));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_by_blocks_are_those_of_the_whole() {
        let count = 2 * ROWS + 77;
        let entry = |i: usize, j: usize| ((i * (j + 3)) as f64 * 0.37).sin();
        let (x, y) = (DMatrix::from_fn(count, 3, entry), DMatrix::from_fn(count, 4, |i, j| entry(i + 5, j)));
        let ctl = Ctl::new();
        let found = product(&x, &y, &ctl).unwrap();
        assert!((found - x.tr_mul(&y)).norm() < 1e-12 * count as f64);
        let coefficients = DVector::from_vec(vec![0.3, -2.0]);
        let mut moved = y.column(0).into_owned();
        let left = subtract(&x, &coefficients, &mut moved, &ctl).unwrap();
        let expected = y.column(0) - x.columns(0, 2) * &coefficients;
        assert!((&moved - &expected).norm() < 1e-12);
        let mut again = y.column(0).into_owned();
        remove(&x, &coefficients, &mut again, &ctl).unwrap();
        assert_eq!(again, moved);
        assert!((left - x.columns(0, 2).tr_mul(&expected)).norm() < 1e-12 * count as f64);
        assert_eq!(rows(&x, 7, 20, &ctl).unwrap(), x.rows(7, 20).into_owned());
        assert_eq!(columns(&y, &[3, 1], &ctl).unwrap(), y.select_columns(&[3, 1]));
        ctl.stop(crate::ctl::StopReason::Cancelled);
        assert!(product(&x, &y, &ctl).is_err() && subtract(&x, &coefficients, &mut moved, &ctl).is_err());
    }
}
