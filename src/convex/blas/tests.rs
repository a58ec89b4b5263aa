//! Against values worked out by hand or by the definition of each routine.

use super::*;

fn c(letter: u8) -> c_char {
    letter.cast_signed()
}

const A: [f64; 6] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];

#[test]
fn gemm_multiplies_transposed_and_padded_matrices() {
    // A = [1 3 5; 2 4 6] by columns; AᵀB with B = [1 0; 1 2].
    let b = [1.0, 1.0, 0.0, 2.0];
    let mut out = [1.0, 1.0, 1.0, f64::NAN, 1.0, 1.0, 1.0, f64::NAN];
    unsafe {
        dgemm_(&c(b'T'), &c(b'N'), &3, &2, &2, &2.0, A.as_ptr(), &2, b.as_ptr(), &2, &1.0, out.as_mut_ptr(), &4);
    }
    assert_eq!(out[..3], [7.0, 15.0, 23.0]);
    assert_eq!(out[4..7], [9.0, 17.0, 25.0]);
    assert!(out[3].is_nan() && out[7].is_nan(), "the padding is not touched");
    // β = 0 ignores what was there.
    let mut out = [f64::NAN; 4];
    unsafe {
        dgemm_(&c(b'N'), &c(b'T'), &2, &2, &3, &1.0, A.as_ptr(), &2, A.as_ptr(), &2, &0.0, out.as_mut_ptr(), &2);
    }
    assert_eq!(out, [35.0, 44.0, 44.0, 56.0]);
}

#[test]
fn products_with_vectors() {
    let x = [1.0, 0.0, -1.0];
    let mut y = [10.0, f64::NAN, 20.0];
    unsafe { dgemv_(&c(b'N'), &2, &3, &1.0, A.as_ptr(), &2, x.as_ptr(), &1, &1.0, y.as_mut_ptr(), &2) };
    assert_eq!((y[0], y[2]), (6.0, 16.0));
    let mut y = [0.0; 3];
    unsafe { dgemv_(&c(b'T'), &2, &3, &1.0, A.as_ptr(), &2, x.as_ptr(), &2, &0.0, y.as_mut_ptr(), &1) };
    assert_eq!(y, [-1.0, -1.0, -1.0]);
    // Upper triangle of [1 3; 3 4], the lower one is not read.
    let s = [1.0, f64::NAN, 3.0, 4.0];
    let mut y = [1.0, 1.0];
    unsafe { dsymv_(&c(b'U'), &2, &2.0, s.as_ptr(), &2, x.as_ptr(), &1, &0.5, y.as_mut_ptr(), &1) };
    assert_eq!(y, [2.5, 6.5]);
}

#[test]
fn rank_updates_write_one_triangle() {
    let mut out = [f64::NAN, -7.0, f64::NAN, f64::NAN];
    unsafe { dsyrk_(&c(b'U'), &c(b'N'), &2, &3, &1.0, A.as_ptr(), &2, &0.0, out.as_mut_ptr(), &2) };
    assert_eq!(out, [35.0, -7.0, 44.0, 56.0]);
    let mut out = [0.0; 9];
    unsafe { dsyrk_(&c(b'L'), &c(b'T'), &3, &2, &1.0, A.as_ptr(), &2, &0.0, out.as_mut_ptr(), &3) };
    assert_eq!(out, [5.0, 11.0, 17.0, 0.0, 25.0, 39.0, 0.0, 0.0, 61.0]);
    let b = [0.0, 1.0, 1.0, 0.0, 0.0, 0.0];
    let mut out = [0.0; 4];
    unsafe {
        dsyr2k_(&c(b'U'), &c(b'N'), &2, &3, &1.0, A.as_ptr(), &2, b.as_ptr(), &2, &0.0, out.as_mut_ptr(), &2);
    }
    // ABᵀ = [3 1; 4 2].
    assert_eq!(out, [6.0, 0.0, 5.0, 4.0]);
}

#[test]
fn cholesky_factor_and_solve() {
    // [4 2; 2 3] = LLᵀ with L = [2 0; 1 √2].
    let mut a = [4.0, f64::NAN, 2.0, 3.0];
    let mut info = -9;
    unsafe { dpotrf_(&c(b'U'), &2, a.as_mut_ptr(), &2, &mut info) };
    assert_eq!(info, 0);
    assert!((a[0] - 2.0).abs() < 1e-15 && (a[2] - 1.0).abs() < 1e-15 && (a[3] - 2f64.sqrt()).abs() < 1e-15);
    assert!(a[1].is_nan(), "the other triangle is not touched");
    a[1] = 0.0;
    let mut b = [2.0, 5.0];
    unsafe { dpotrs_(&c(b'U'), &2, &1, a.as_ptr(), &2, b.as_mut_ptr(), &2, &mut info) };
    assert!(info == 0 && (b[0] + 0.5).abs() < 1e-15 && (b[1] - 2.0).abs() < 1e-15);
    let mut a = [1.0, 2.0, 2.0, 1.0];
    unsafe { dpotrf_(&c(b'L'), &2, a.as_mut_ptr(), &2, &mut info) };
    assert!(info > 0, "an indefinite matrix has no factor");
}

#[test]
fn general_systems() {
    let (mut a, mut b, mut pivots, mut info) = ([0.0, 1.0, 2.0, 3.0], [4.0, 7.0], [0; 2], -9);
    unsafe { dgesv_(&2, &1, a.as_mut_ptr(), &2, pivots.as_mut_ptr(), b.as_mut_ptr(), &2, &mut info) };
    assert!(info == 0 && (b[0] - 1.0).abs() < 1e-15 && (b[1] - 2.0).abs() < 1e-15);
    let mut a = [1.0, 1.0, 1.0, 1.0];
    unsafe { dgesv_(&2, &1, a.as_mut_ptr(), &2, pivots.as_mut_ptr(), b.as_mut_ptr(), &2, &mut info) };
    assert!(info > 0);
}

#[test]
fn singular_values_and_vectors() {
    // ones(3, 5): nalgebra's own decomposition is wrong on it. σ = √15.
    for which in 0..2 {
        let (mut a, mut s, mut u, mut vt) = ([1.0; 15], [0.0; 3], [0.0; 9], [0.0; 15]);
        let (mut work, mut iwork, mut info) = ([0.0], [0; 24], -9);
        for lwork in [-1, 100] {
            unsafe {
                if which == 0 {
                    dgesdd_(
                        &c(b'S'),
                        &3,
                        &5,
                        a.as_mut_ptr(),
                        &3,
                        s.as_mut_ptr(),
                        u.as_mut_ptr(),
                        &3,
                        vt.as_mut_ptr(),
                        &3,
                        work.as_mut_ptr(),
                        &lwork,
                        iwork.as_mut_ptr(),
                        &mut info,
                    );
                } else {
                    dgesvd_(
                        &c(b'S'),
                        &c(b'S'),
                        &3,
                        &5,
                        a.as_mut_ptr(),
                        &3,
                        s.as_mut_ptr(),
                        u.as_mut_ptr(),
                        &3,
                        vt.as_mut_ptr(),
                        &3,
                        work.as_mut_ptr(),
                        &lwork,
                        &mut info,
                    );
                }
            }
            assert_eq!(info, 0);
            assert!(work[0] >= 1.0);
        }
        assert!((s[0] - 15f64.sqrt()).abs() < 1e-14 && s[1].abs() < 1e-14 && s[2].abs() < 1e-14);
        let u = DMatrix::from_column_slice(3, 3, &u);
        let vt = DMatrix::from_column_slice(3, 5, &vt);
        let back = u * DMatrix::from_diagonal(&DVector::from_column_slice(&s)) * vt;
        assert!((back - DMatrix::from_element(3, 5, 1.0)).norm() < 1e-14);
    }
}

#[test]
fn symmetric_eigenvalues_ascend() {
    // Eigenvalues −1, −1, 8 (and 9).
    let full = [3.0, 2.0, 4.0, 0.0, 2.0, 0.0, 2.0, 0.0, 4.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 9.0];
    let (mut a, mut w, mut z, mut found) = (full, [0.0; 4], [0.0; 16], 0);
    let (mut work, mut iwork, mut info, mut support) = ([0.0], [0], -9, [0; 8]);
    for lwork in [-1, 64] {
        unsafe {
            dsyevr_(
                &c(b'V'),
                &c(b'A'),
                &c(b'U'),
                &4,
                a.as_mut_ptr(),
                &4,
                &0.0,
                &0.0,
                &0,
                &0,
                &-1.0,
                &mut found,
                w.as_mut_ptr(),
                z.as_mut_ptr(),
                &4,
                support.as_mut_ptr(),
                work.as_mut_ptr(),
                &lwork,
                iwork.as_mut_ptr(),
                &lwork,
                &mut info,
            );
        }
        assert_eq!(info, 0);
    }
    assert_eq!(found, 4);
    for (value, expected) in w.iter().zip([-1.0, -1.0, 8.0, 9.0]) {
        assert!((value - expected).abs() < 1e-13, "{w:?}");
    }
    let z = DMatrix::from_column_slice(4, 4, &z);
    let back = &z * DMatrix::from_diagonal(&DVector::from_column_slice(&w)) * z.transpose();
    assert!((back - DMatrix::from_column_slice(4, 4, &full)).norm() < 1e-13);
}

#[test]
fn the_single_precision_routines_exist_too() {
    let a = [1.0_f32, 2.0, 3.0, 4.0];
    let mut out = [0.0_f32; 4];
    unsafe { sgemm_(&c(b'N'), &c(b'N'), &2, &2, &2, &1.0, a.as_ptr(), &2, a.as_ptr(), &2, &0.0, out.as_mut_ptr(), &2) };
    assert_eq!(out, [7.0, 10.0, 15.0, 22.0]);
}
