//! The matrix exponential.

use nalgebra::DMatrix;

/// `e^M` by scaling and squaring with the (13, 13) Padé approximant (Higham, SIAM J. Matrix Anal. Appl. 26, 1179–1193,
/// 2005): M is halved s times until its 1-norm is at most 5.37, where the approximant is exact to working precision.
///
/// `None` where the result, or M itself, is not finite.
///
/// # Panics
/// If M is not square, which is a mistake of the caller.
#[must_use]
pub(crate) fn matrix_exponential(m: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    /// Numerator coefficients of the approximant, ascending powers (Higham 2005, p. 1183).
    const PADE: [f64; 14] = [
        64_764_752_532_480_000.0,
        32_382_376_266_240_000.0,
        7_771_770_303_897_600.0,
        1_187_353_796_428_800.0,
        129_060_195_264_000.0,
        10_559_470_521_600.0,
        670_442_572_800.0,
        33_522_128_640.0,
        1_323_241_920.0,
        40_840_800.0,
        960_960.0,
        16_380.0,
        182.0,
        1.0,
    ];
    /// The 1-norm up to which the approximant is exact to working precision.
    const LARGEST_NORM: f64 = 5.371_920_351_148_152;

    assert!(m.is_square(), "exponential of a {}x{} matrix", m.nrows(), m.ncols());
    let n = m.nrows();
    if n == 0 {
        return Some(m.clone());
    }
    let norm = m.column_iter().map(|c| c.iter().map(|v| v.abs()).sum::<f64>()).fold(0.0, f64::max);
    if m.iter().any(|v| !v.is_finite()) || !norm.is_finite() {
        return None;
    }
    let halvings = (norm / LARGEST_NORM).log2().ceil().max(0.0) as i32;
    let m = m * 0.5_f64.powi(halvings);

    let one = DMatrix::<f64>::identity(n, n);
    let m2 = &m * &m;
    let m4 = &m2 * &m2;
    let m6 = &m4 * &m2;
    let odd = &m
        * (&m6 * (&m6 * PADE[13] + &m4 * PADE[11] + &m2 * PADE[9])
            + &m6 * PADE[7]
            + &m4 * PADE[5]
            + &m2 * PADE[3]
            + &one * PADE[1]);
    let even = &m6 * (&m6 * PADE[12] + &m4 * PADE[10] + &m2 * PADE[8])
        + &m6 * PADE[6]
        + &m4 * PADE[4]
        + &m2 * PADE[2]
        + &one * PADE[0];
    let mut result = (&even - &odd).lu().solve(&(even + odd))?;
    for _ in 0..halvings {
        result = &result * &result;
    }
    result.iter().all(|v| v.is_finite()).then_some(result)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_of_a_rotation_is_a_rotation() {
        for angle in [1e-3_f64, 0.7, 3.0, 40.0] {
            let e = matrix_exponential(&DMatrix::from_row_slice(2, 2, &[0.0, angle, -angle, 0.0])).unwrap();
            let expected = DMatrix::from_row_slice(2, 2, &[angle.cos(), angle.sin(), -angle.sin(), angle.cos()]);
            assert!((e - expected).norm() < 1e-13 * angle.max(1.0), "{angle}");
        }
    }

    #[test]
    fn a_nilpotent_matrix_has_a_finite_series() {
        let e = matrix_exponential(&DMatrix::from_row_slice(3, 3, &[0.0, 2.0, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0]));
        let expected = DMatrix::from_row_slice(3, 3, &[1.0, 2.0, 3.0, 0.0, 1.0, 3.0, 0.0, 0.0, 1.0]);
        assert!((e.unwrap() - expected).norm() < 1e-15);
    }

    #[test]
    fn the_exponential_times_that_of_the_negative_is_one() {
        let m = DMatrix::from_row_slice(3, 3, &[-1.0, 4.0, 0.5, 2.0, 0.3, -7.0, 1.5, -2.5, -0.2]);
        let product = matrix_exponential(&m).unwrap() * matrix_exponential(&-m).unwrap();
        assert!((product - DMatrix::identity(3, 3)).norm() < 1e-11);
    }

    #[test]
    fn overflow_and_nan_have_no_exponential() {
        assert!(matrix_exponential(&DMatrix::from_element(1, 1, 1e4)).is_none());
        assert!(matrix_exponential(&DMatrix::from_element(2, 2, f64::NAN)).is_none());
    }
}
