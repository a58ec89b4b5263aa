//! Products of small matrices without allocation: a covariance recursion makes some hundred of them for each sample.
//! All are column by column. The loops are plain, because adaptors of iterators are calls where nothing is inlined: in
//! the development profile they take ten times as long.

use std::ops::Range;

/// The shape of a product: rows of the left, what both share, columns of the right.
pub(super) type Shape = [usize; 3];

/// `out[to..] += sign · A x[from..]`, for as many columns of A, whose rows are those of one column of `out`.
#[inline]
fn add_column(out: &mut [f64], a: &[f64], x: &[f64], sign: f64, [to, from, columns]: [usize; 3]) {
    let rows = a.len().checked_div(columns).unwrap_or(0);
    let mut j = 0;
    while j < columns {
        let factor = sign * x[from + j];
        let mut i = 0;
        while i < rows {
            out[to + i] += factor * a[j * rows + i];
            i += 1;
        }
        j += 1;
    }
}

/// `out += sign · A B`.
pub(super) fn add_product(out: &mut [f64], a: &[f64], b: &[f64], [rows, inner, columns]: Shape, sign: f64) {
    let mut k = 0;
    while k < columns {
        add_column(out, a, b, sign, [k * rows, k * inner, inner]);
        k += 1;
    }
}

/// `out += sign · A Bᵀ`.
pub(super) fn add_transposed(out: &mut [f64], a: &[f64], b: &[f64], [rows, inner, columns]: Shape, sign: f64) {
    let mut k = 0;
    while k < inner {
        let mut j = 0;
        while j < columns {
            let factor = sign * b[k * columns + j];
            let mut i = 0;
            while i < rows {
                out[j * rows + i] += factor * a[k * rows + i];
                i += 1;
            }
            j += 1;
        }
        k += 1;
    }
}

/// The symmetric part of a square matrix, in its place.
pub(super) fn symmetrise(m: &mut [f64], order: usize) {
    let mut j = 0;
    while j < order {
        let mut i = 0;
        while i < j {
            let mean = 0.5 * (m[i + j * order] + m[j + i * order]);
            m[i + j * order] = mean;
            m[j + i * order] = mean;
            i += 1;
        }
        j += 1;
    }
}

/// `Σ x_i y_i`.
pub(super) fn dot(x: &[f64], y: &[f64]) -> f64 {
    let mut sum = 0.0;
    let mut i = 0;
    while i < x.len() {
        sum += x[i] * y[i];
        i += 1;
    }
    sum
}

/// Writes the inverse of the diagonal block of these rows of a symmetric matrix into `inverse`, zeros elsewhere, and
/// gives the logarithm of the block's determinant; `None` where it is not positive definite.
pub(super) fn invert(m: &[f64], order: usize, block: Range<usize>, inverse: &mut [f64]) -> Option<f64> {
    let Range { start: first, end: last } = block;
    // The lower Cholesky factor, in the place of the answer.
    inverse.fill(0.0);
    let mut log_det = 0.0;
    for j in first..last {
        for i in j..last {
            let mut rest = m[i + j * order];
            for k in first..j {
                rest -= inverse[i + k * order] * inverse[j + k * order];
            }
            if i > j {
                inverse[i + j * order] = rest / inverse[j + j * order];
            } else if rest > 0.0 && rest.is_finite() {
                inverse[j + j * order] = rest.sqrt();
                log_det += rest.ln();
            } else {
                return None;
            }
        }
    }
    // Its inverse, column by column from the right, then `L⁻ᵀL⁻¹`.
    for j in (first..last).rev() {
        let pivot = 1.0 / inverse[j + j * order];
        for i in (j + 1..last).rev() {
            let mut sum = 0.0;
            for k in j + 1..=i {
                sum += inverse[i + k * order] * inverse[k + j * order];
            }
            inverse[i + j * order] = -sum * pivot;
        }
        inverse[j + j * order] = pivot;
    }
    for j in first..last {
        for i in first..=j {
            let mut sum = 0.0;
            for k in j..last {
                sum += inverse[k + i * order] * inverse[k + j * order];
            }
            // Above the diagonal, which the factor leaves free; the diagonal itself is not read again.
            inverse[i + j * order] = sum;
        }
    }
    for j in first..last {
        for i in first..j {
            inverse[j + i * order] = inverse[i + j * order];
        }
    }
    Some(log_det)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    fn made(rows: usize, columns: usize, seed: f64) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |i, j| (seed + 1.7 * i as f64 + 0.6 * j as f64).sin())
    }

    #[test]
    fn products_are_those_of_nalgebra() {
        let (a, b, c) = (made(3, 4, 0.1), made(4, 2, 0.2), made(2, 4, 0.3));
        let mut out = made(3, 2, 0.4);
        let expected = &out + &a * &b - &a * c.transpose() * 2.0;
        add_product(out.as_mut_slice(), a.as_slice(), b.as_slice(), [3, 4, 2], 1.0);
        add_transposed(out.as_mut_slice(), a.as_slice(), c.as_slice(), [3, 4, 2], -2.0);
        assert!((out - expected).norm() < 1e-14);
    }

    #[test]
    fn the_inverse_of_a_block_is_its_inverse() {
        for (first, last) in [(0, 1), (0, 2), (0, 3), (0, 4), (1, 3), (2, 4), (3, 4)] {
            let size = last - first;
            let root = made(4, 4, 0.5) + DMatrix::identity(4, 4);
            let m = &root * root.transpose();
            let mut inverse = DMatrix::from_element(4, 4, f64::NAN);
            let log_det = invert(m.as_slice(), 4, first..last, inverse.as_mut_slice()).unwrap();
            let block = m.view((first, first), (size, size)).into_owned();
            assert!((log_det - block.determinant().ln()).abs() < 1e-12);
            let mut expected = DMatrix::zeros(4, 4);
            expected.view_mut((first, first), (size, size)).copy_from(&block.try_inverse().unwrap());
            assert!((inverse - &expected).norm() < 1e-11 * expected.norm(), "{first} {last}");
        }
        assert_eq!(invert(&[1.0, 2.0, 2.0, 1.0], 2, 0..2, &mut [0.0; 4]), None);
    }
}
