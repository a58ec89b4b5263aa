//! Orthonormal columns, with those left out that say nothing new.

use super::tall::{remove, subtract};
use crate::ctl::{Ctl, Stopped};
use nalgebra::{DMatrix, DVector};

/// A column whose part outside the span of those before it is smaller than this share of it depends on them.
const DEPENDENT: f64 = 1e-9;

/// Likewise one whose part outside is smaller than this share of the largest column: a difference of large numbers that
/// is nothing but their rounding.
const ROUNDING: f64 = 1e-13;

/// An orthonormal basis of the columns of a matrix.
pub(super) struct Orthonormal {
    /// The basis, rows × rank.
    pub q: DMatrix<f64>,
    /// The columns that added to it, in increasing order.
    pub kept: Vec<usize>,
}

/// Orthonormalises the columns of matrices, one beside the other, from left to right by the Gram–Schmidt process, each
/// column projected twice ("twice is enough": Giraud, Langou and Rozložník, *Computers and Mathematics with
/// Applications* 50, 2005).
///
/// Lags of a slow command differ by 1e-8 of their size. A covariance from the normal equations of such columns is not
/// positive definite; one from an orthonormal basis is.
///
/// # Errors
/// [`Stopped`].
pub(super) fn orthonormalise(parts: &[&DMatrix<f64>], ctl: &Ctl) -> Result<Orthonormal, Stopped> {
    let rows = parts.first().map_or(0, |part| part.nrows());
    let count: usize = parts.iter().map(|part| part.ncols()).sum();
    let columns = || parts.iter().flat_map(|part| part.column_iter());
    let mut q = DMatrix::zeros(rows, count.min(rows));
    let mut kept = Vec::with_capacity(q.ncols());
    let mut largest = 0.0_f64;
    for column in columns() {
        ctl.check()?;
        largest = largest.max(column.norm());
    }
    for (j, column) in columns().enumerate() {
        ctl.check()?;
        let rank = kept.len();
        let size = column.norm();
        if rank == q.ncols() || size <= 0.0 || !size.is_finite() {
            continue;
        }
        let mut rest: DVector<f64> = column / size;
        let inside = subtract(&q, &DVector::zeros(rank), &mut rest, ctl)?;
        let again = subtract(&q, &inside, &mut rest, ctl)?;
        remove(&q, &again, &mut rest, ctl)?;
        let outside = rest.norm();
        if outside > DEPENDENT && outside * size > ROUNDING * largest {
            q.set_column(rank, &(rest / outside));
            kept.push(j);
        }
    }
    // The columns beyond the rank are cut off where they are.
    let rank = kept.len();
    Ok(Orthonormal { q: q.resize_horizontally(rank, 0.0), kept })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearly_dependent_columns_stay_orthonormal_and_dependent_ones_are_left_out() {
        let wave = |i: usize, lag: f64| (0.01 * (i as f64 - lag)).sin();
        // A sinusoid has two independent lags; a little of another makes a third.
        let columns = DMatrix::from_fn(500, 6, |i, j| match j {
            4 => wave(i, 1.0) + 1e-6 * (0.7 * i as f64).sin(),
            5 => 0.0,
            _ => wave(i, j as f64),
        });
        let ctl = Ctl::new();
        let found = orthonormalise(&[&columns], &ctl).unwrap();
        let apart = [columns.columns(0, 2).into_owned(), columns.columns(2, 4).into_owned()];
        let both = orthonormalise(&[&apart[0], &apart[1]], &ctl).unwrap();
        assert_eq!((&both.q, &both.kept), (&found.q, &found.kept));
        assert_eq!(found.kept, [0, 1, 4]);
        let defect = (found.q.tr_mul(&found.q) - DMatrix::identity(3, 3)).norm();
        assert!(defect < 1e-14, "{defect}");
    }
}
