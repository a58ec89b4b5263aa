//! Gains of a regulator and gains of a filter that make the same controller.
//!
//! A person who controls by `u = −Kx̂` and `x̂⁺ = Ax̂ + Bu + L(y − Cx̂)` is seen from outside through the compensator
//! `K(zI − A + BK + LC)⁻¹L` alone, and other pairs (K, L) have the same one. The loop of plant and person has the
//! matrix `F = [A −BK; LC A−BK−LC]`, with the eigenvalues of A − BK and of A − LC. Any n of these 2n whose invariant
//! subspace is spanned by the columns of [N; I] give the twin `K₂ = KN⁻¹`, `L₂ = NL`: x̂₂ = Nx̂ is the same estimate in
//! other states, and A − BK₂ has those n eigenvalues (Priess 2015, §6.3, where it is said that K and L do not
//! separate).

use crate::num::linalg::{self, NoConvergence};
use crate::num::schur::ComplexSchur;
use nalgebra::DMatrix;
use num_complex::Complex64;

/// Subsets of the eigenvalues that are gone through at most.
const MAX_SUBSETS: usize = 924;
/// N is singular where its condition number exceeds this: a twin's gains would be larger than the person's by as much,
/// and known to few digits.
const SINGULAR: f64 = 1e6;
/// Eigenvalues nearer than this share of their size are one, and no subspace is told from another.
const DOUBLE: f64 = 1e-6;

/// A pair of gains with the controller of another.
#[derive(Debug, Clone, PartialEq)]
pub struct Twin {
    /// K₂, m×n.
    pub k: DMatrix<f64>,
    /// L₂, n×p.
    pub l: DMatrix<f64>,
    /// Eigenvalues of A − BK₂.
    pub regulator_poles: Vec<Complex64>,
}

/// Why twins were not looked for.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum TwinsError {
    /// More than 924 ways to split the eigenvalues.
    #[error("{states} states split the loop's eigenvalues in more ways than are gone through; 6 states at most")]
    TooMany {
        /// n.
        states: usize,
    },
    /// An eigenvalue that is not simple.
    #[error("the loop has the eigenvalue {value:.4} twice, and its invariant subspaces are not told apart")]
    Double {
        /// It.
        value: Complex64,
    },
    /// A decomposition failed.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
}

/// All other pairs of gains with the compensator of K (m×n) and L (n×p) for the plant A, B, C, without direct
/// feedthrough. The spectra of A − BK and A − LC must be apart.
///
/// # Errors
/// [`TwinsError`].
pub fn twins([a, b, c]: [&DMatrix<f64>; 3], k: &DMatrix<f64>, l: &DMatrix<f64>) -> Result<Vec<Twin>, TwinsError> {
    of_loop([a, b, &(l * c)], k, l)
}

/// The same of a person whose belief takes y in before the control is chosen: `u = −Kx̂`, and
/// `x̂⁺ = (I − LC)(A − BK)x̂ + Ly⁺` with the gain L of the filter. The loop is `[A −BK; LCA A−BK−LCA]`, and a twin is
/// made as before.
///
/// # Errors
/// [`TwinsError`].
pub fn filter_twins(
    [a, b, c]: [&DMatrix<f64>; 3],
    k: &DMatrix<f64>,
    l: &DMatrix<f64>,
) -> Result<Vec<Twin>, TwinsError> {
    of_loop([a, b, &(l * c * a)], k, l)
}

/// The twins of the loop `[A −BK; H A−BK−H]`, for H = LC or LCA.
fn of_loop([a, b, h]: [&DMatrix<f64>; 3], k: &DMatrix<f64>, l: &DMatrix<f64>) -> Result<Vec<Twin>, TwinsError> {
    let n = a.nrows();
    let subsets = (0..n).try_fold(1usize, |count, i| count.checked_mul(2 * n - i).map(|v| v / (i + 1)));
    if subsets.is_none_or(|count| count > MAX_SUBSETS) {
        return Err(TwinsError::TooMany { states: n });
    }
    let own = linalg::eigenvalues(&(a - b * k))?;
    let mut f = DMatrix::zeros(2 * n, 2 * n);
    let bk = b * k;
    f.view_mut((0, 0), (n, n)).copy_from(a);
    f.view_mut((0, n), (n, n)).copy_from(&-&bk);
    f.view_mut((n, 0), (n, n)).copy_from(h);
    f.view_mut((n, n), (n, n)).copy_from(&(a - bk - h));
    let values: Vec<Complex64> = ComplexSchur::new(&f)?.eigenvalues().collect();
    let size = values.iter().map(|v| v.norm()).fold(0.0, f64::max);
    for (i, value) in values.iter().enumerate() {
        if values[..i].iter().any(|other| (other - value).norm() <= DOUBLE * size) {
            return Err(TwinsError::Double { value: *value });
        }
    }
    let vectors: Vec<_> = values.iter().map(|value| null_vector(&f, *value)).collect::<Result<_, _>>()?;
    let is_own = |value: &Complex64| own.iter().any(|v| (v - value).norm() <= DOUBLE * size);
    let mut found = Vec::new();
    for subset in 0u32..1 << (2 * n) {
        let members: Vec<usize> = (0..2 * n).filter(|i| subset >> i & 1 == 1).collect();
        if members.len() != n || members.iter().all(|i| is_own(&values[*i])) {
            continue;
        }
        // Real gains: a complex eigenvalue comes with its conjugate.
        let has = |value: Complex64| members.iter().any(|i| (values[*i] - value).norm() <= DOUBLE * size);
        if !members.iter().all(|i| has(values[*i].conj())) {
            continue;
        }
        let columns = |from: usize| DMatrix::from_fn(n, n, |i, j| vectors[members[j]][from + i]);
        let Some(inverse) = columns(n).try_inverse() else { continue };
        let map = (columns(0) * inverse).map(|v| v.re);
        let singular = linalg::singular_values(&map)?;
        let is_regular = singular.last().is_some_and(|least| *least * SINGULAR > singular[0]);
        let Some(back) = map.clone().try_inverse().filter(|_| is_regular) else { continue };
        let regulator_poles = members.iter().map(|i| values[*i]).collect();
        found.push(Twin { k: k * back, l: map * l, regulator_poles });
    }
    Ok(found)
}

/// The eigenvector of a simple eigenvalue, by the least singular vector of F − λI as a real matrix of twice the size.
fn null_vector(f: &DMatrix<f64>, value: Complex64) -> Result<Vec<Complex64>, NoConvergence> {
    let size = f.nrows();
    let mut real = DMatrix::zeros(2 * size, 2 * size);
    let shifted = f - DMatrix::identity(size, size) * value.re;
    real.view_mut((0, 0), (size, size)).copy_from(&shifted);
    real.view_mut((size, size), (size, size)).copy_from(&shifted);
    for i in 0..size {
        real[(i, size + i)] = value.im;
        real[(size + i, i)] = -value.im;
    }
    let (_, _, v) = linalg::svd(&real)?;
    let last = v.column(2 * size - 1);
    Ok((0..size).map(|i| Complex64::new(last[i], last[size + i])).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::lqg::{kalman, lqr};
    use crate::control::lyapunov::Clock;

    fn matrix(rows: usize, columns: usize, entries: &[f64]) -> DMatrix<f64> {
        DMatrix::from_row_slice(rows, columns, entries)
    }

    /// The compensator `K(zI − A + BK + LC)⁻¹L` at a point.
    fn compensator(plant: [&DMatrix<f64>; 3], k: &DMatrix<f64>, l: &DMatrix<f64>, z: Complex64) -> Vec<Complex64> {
        let [a, b, c] = plant;
        let n = a.nrows();
        let complex = |m: &DMatrix<f64>| m.map(|v| Complex64::new(v, 0.0));
        let inner = DMatrix::from_diagonal_element(n, n, z) - complex(&(a - b * k - l * c));
        (complex(k) * inner.lu().solve(&complex(l)).unwrap()).iter().copied().collect()
    }

    /// Numbers of the verified reference (`lqg_fit/twins.json`): the sampled plant of 4, −.3 at 20 ms, Q = .02·diag(20,
    /// 1), R = .001, noise of the person's diag(1e-6, 4e-4) and 1e-4 times 1, 5 and 20.
    #[test]
    fn twins_of_the_reference() {
        let a = matrix(2, 2, &[1.0007985088138476, 0.019945437607715825, 0.0797817504308633, 0.9948148775315327]);
        let b = matrix(2, 1, &[0.00019962720346188757, 0.019945437607715825]);
        let c = matrix(1, 2, &[1.0, 0.0]);
        let q = matrix(2, 2, &[0.4, 0.0, 0.0, 0.02]);
        let k = lqr(&a, &b, &q, &matrix(1, 1, &[0.001]), Clock::Sampled).unwrap().k;
        let noise = matrix(2, 2, &[1e-6, 0.0, 0.0, 4e-4]);
        for (factor, gain, filter) in [
            (1.0, [90.1648715855626, 13.811851421059787], [0.15602788678945434, 0.4159472697063826]),
            (5.0, [44.6966223931853, 9.358270706361544], [0.15602788678944232, 0.4159472697063743]),
            (20.0, [25.162447996141992, 6.851804696264378], [0.1560278867894891, 0.4159472697063445]),
        ] {
            let l = kalman(&a, &c, &noise, &matrix(1, 1, &[1e-4 * factor]), Clock::Sampled).unwrap().l;
            let found = twins([&a, &b, &c], &k, &l).unwrap();
            let is_it = |twin: &&Twin| {
                let gains = twin.k.iter().zip(gain).all(|(v, w)| (v / w - 1.0).abs() < 1e-6);
                gains && twin.l.iter().zip(filter).all(|(v, w)| (v / w - 1.0).abs() < 1e-6)
            };
            assert_eq!(found.iter().filter(is_it).count(), 1, "{factor}: {found:?}");
        }
    }

    /// Random plants of up to four states, several ports: the compensator of every twin is the same, and its regulator
    /// has the eigenvalues that were chosen.
    #[test]
    fn twins_have_one_compensator() {
        use rand::RngExt;
        let mut stream = crate::num::rng::stream(16, "twins");
        let mut checked = 0;
        for round in 0..60 {
            let n = stream.random_range(1..=4usize);
            let (m, p) = (stream.random_range(1..=n.min(2)), stream.random_range(1..=n.min(2)));
            let mut draw = |rows, columns| DMatrix::from_fn(rows, columns, |_, _| stream.random_range(-1.0..1.0));
            let (a, b, c) = (draw(n, n), draw(n, m), draw(p, n));
            let one = |size| DMatrix::identity(size, size);
            let Ok(regulator) = lqr(&a, &b, &one(n), &one(m), Clock::Sampled) else { continue };
            let Ok(filter) = kalman(&a, &c, &one(n), &(one(p) * 0.3), Clock::Sampled) else { continue };
            let (k, l) = (regulator.k, filter.l);
            let Ok(found) = twins([&a, &b, &c], &k, &l) else { continue };
            for twin in found {
                let poles = linalg::eigenvalues(&(&a - &b * &twin.k)).unwrap();
                for pole in &twin.regulator_poles {
                    let error = poles.iter().map(|v| (v - pole).norm()).fold(f64::INFINITY, f64::min);
                    assert!(error < 1e-2, "{round}: {error:e}");
                }
                for z in [Complex64::new(1.3, 0.0), Complex64::new(0.4, 1.1)] {
                    let one = compensator([&a, &b, &c], &k, &l, z);
                    let other = compensator([&a, &b, &c], &twin.k, &twin.l, z);
                    let size: f64 = one.iter().map(|v| v.norm()).sum();
                    let error: f64 = one.iter().zip(&other).map(|(v, w)| (v - w).norm()).sum();
                    assert!(error <= 1e-5 * size, "{round}: {error:e} of {size:e}");
                }
                checked += 1;
            }
        }
        assert!(checked > 40, "{checked}");
    }
}
