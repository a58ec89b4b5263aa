//! Bounds, in the order of symmetric matrices, of sums whose terms are known in size only.
//!
//! For numbers `|ε_ij| ≤ δ_ij` and any t > 0, `±(xyᵀ + yxᵀ) ⪯ t xxᵀ + yyᵀ/t`. Summed over the entries this bounds a
//! matrix by semidefinite ones, which do not pile up on each other as absolute values of entries do: for vectors in
//! general directions it is tighter by up to their length.

use nalgebra::{DMatrix, DVector};

/// The lengths of the columns.
fn lengths(m: &DMatrix<f64>) -> DVector<f64> {
    DVector::from_iterator(m.ncols(), m.column_iter().map(|c| c.norm()))
}

/// `M diag(d) Mᵀ`.
fn congruent(m: &DMatrix<f64>, d: &DVector<f64>) -> DMatrix<f64> {
    let mut scaled = m.clone();
    for (mut column, factor) in scaled.column_iter_mut().zip(d.iter()) {
        column *= *factor;
    }
    scaled * m.transpose()
}

/// A bound of `±Σ ε_ij (x_i y_jᵀ + y_j x_iᵀ)` over all `|ε_ij| ≤ δ_ij`, for the columns x_i of X (n×p) and y_j of Y
/// (n×q), δ p×q.
pub(super) fn products(delta: &DMatrix<f64>, x: &DMatrix<f64>, y: &DMatrix<f64>) -> DMatrix<f64> {
    let (of_x, of_y) = (lengths(x), lengths(y));
    let over = |sum: f64, length: f64| if length > 0.0 { sum / length } else { 0.0 };
    // t = |y_j|/|x_i| makes both halves as long as each other.
    let to_x = (delta * &of_y).zip_map(&of_x, over);
    let to_y = delta.tr_mul(&of_x).zip_map(&of_y, over);
    congruent(x, &to_x) + congruent(y, &to_y)
}

/// A bound of `±WEWᵀ` over all symmetric E with `|E_ij| ≤ e_ij`, for a symmetric e.
pub(super) fn entries(e: &DMatrix<f64>, w: &DMatrix<f64>) -> DMatrix<f64> {
    let of_w = lengths(w);
    let d = (e * &of_w).zip_map(&of_w, |sum, length| if length > 0.0 { sum / length } else { 0.0 });
    congruent(w, &d)
}

#[cfg(test)]
mod tests {
    use super::{entries, products};
    use crate::num::rng;
    use nalgebra::DMatrix;
    use rand::RngExt;

    /// Sums with random and with the worst signs for some direction stay below their bounds, and the bounds are at most
    /// a small multiple of the largest sum.
    #[test]
    fn no_choice_of_signs_exceeds_the_bounds() {
        let mut stream = rng::stream(20_261_130, "majorants");
        for _ in 0..200 {
            let (n, p, q) = (stream.random_range(1..=6), stream.random_range(1..=5), stream.random_range(1..=5));
            let mut random = |rows, columns| DMatrix::from_fn(rows, columns, |_, _| stream.random_range(-1.0..1.0));
            let (x, y, delta): (DMatrix<f64>, DMatrix<f64>, DMatrix<f64>) =
                (random(n, p), random(n, q), random(p, q).abs());
            let bound = products(&delta, &x, &y);
            let direction = random(n, 1);
            let worst = DMatrix::from_fn(p, q, |i, j| {
                let sign = x.column(i).dot(&direction.column(0)) * y.column(j).dot(&direction.column(0));
                delta[(i, j)] * sign.signum()
            });
            for signed in [worst, delta.component_mul(&random(p, q))] {
                let half = &x * signed * y.transpose();
                for turned in [1.0, -1.0] {
                    let rest = &bound - (&half + half.transpose()) * turned;
                    assert!(rest.symmetric_eigenvalues().min() >= -1e-12 * bound.norm());
                }
            }
            let e = random(n, n);
            let e = e.abs() + e.abs().transpose();
            let w = random(4, n);
            let bound = entries(&e, &w);
            let signed = random(n, n);
            let signed = e.component_mul(&(&signed + signed.transpose()).map(f64::signum));
            for turned in [1.0, -1.0] {
                let rest = &bound - &w * &signed * w.transpose() * turned;
                assert!(rest.symmetric_eigenvalues().min() >= -1e-12 * bound.norm());
            }
        }
    }

    #[test]
    fn one_pair_is_bounded_by_its_own_size() {
        let x = DMatrix::from_column_slice(2, 1, &[3.0, 0.0]);
        let y = DMatrix::from_column_slice(2, 1, &[0.0, 0.1]);
        let bound = products(&DMatrix::from_element(1, 1, 2.0), &x, &y);
        // ±2(xyᵀ + yxᵀ) has the eigenvalues ±0.6.
        assert!((bound - DMatrix::identity(2, 2) * 0.6).norm() < 1e-15);
        assert_eq!(products(&DMatrix::from_element(1, 1, 2.0), &x, &(y * 0.0)).norm(), 0.0);
    }
}
