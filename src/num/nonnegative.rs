//! Small convex quadratic programs over nonnegative numbers: the dual of a step under linear inequalities.

use nalgebra::{DMatrix, DVector};

/// A pivot below this, of a matrix with unit diagonal, means that a row depends on those already taken.
const DEPENDENT: f64 = 1e-12;

/// Minimises `½ μᵀQμ + qᵀμ` over `μ ≥ 0` by the active-set method of Lawson and Hanson (1974, ch. 23), for a positive
/// semidefinite `Q` with unit diagonal and few rows.
///
/// Rows that depend on those already taken stay at zero. The answer satisfies `Qμ + q ≥ −tolerance` in the rows left at
/// zero, and `(Qμ + q)ᵢ = 0` where `μᵢ > 0`, unless rows were dependent or the count of steps ran out (`3·rows + 10`).
///
/// # Panics
/// If the shapes differ, which is a mistake of the caller.
#[must_use]
pub(crate) fn minimise(quadratic: &DMatrix<f64>, linear: &DVector<f64>, tolerance: f64) -> DVector<f64> {
    let n = linear.len();
    assert!(quadratic.nrows() == n && quadratic.ncols() == n, "a {n}x{n} matrix");
    let mut mu = DVector::zeros(n);
    let mut passive: Vec<usize> = Vec::new();
    let mut barred = vec![false; n];
    for _ in 0..3 * n + 10 {
        let gradient = quadratic * &mu + linear;
        let entering = (0..n)
            .filter(|i| !passive.contains(i) && !barred[*i] && gradient[*i] < -tolerance)
            .min_by(|a, b| gradient[*a].total_cmp(&gradient[*b]));
        let Some(entering) = entering else { break };
        passive.push(entering);
        // Until the minimum over the passive rows is nonnegative.
        loop {
            let Some(target) = solve(quadratic, linear, &passive) else {
                passive.retain(|i| *i != entering);
                barred[entering] = true;
                break;
            };
            if target.iter().all(|t| *t > 0.0) {
                for (i, t) in passive.iter().zip(target.iter()) {
                    mu[*i] = *t;
                }
                barred.fill(false);
                break;
            }
            let share = passive
                .iter()
                .zip(target.iter())
                .filter(|(_, t)| **t <= 0.0)
                .map(|(i, t)| mu[*i] / (mu[*i] - t))
                .fold(1.0, f64::min);
            let mut leaving = Vec::new();
            for (i, t) in passive.iter().zip(target.iter()) {
                mu[*i] += share * (t - mu[*i]);
                if *t <= 0.0 && mu[*i] <= 1e-15 * t.abs().max(f64::MIN_POSITIVE) {
                    mu[*i] = 0.0;
                    leaving.push(*i);
                }
            }
            if leaving.contains(&entering) || leaving.is_empty() {
                // Rounding: the entering row gains nothing.
                barred[entering] = true;
                leaving.push(entering);
                mu[entering] = 0.0;
            }
            passive.retain(|i| !leaving.contains(i));
            if passive.is_empty() {
                break;
            }
        }
    }
    mu
}

fn solve(quadratic: &DMatrix<f64>, linear: &DVector<f64>, rows: &[usize]) -> Option<DVector<f64>> {
    let block = DMatrix::from_fn(rows.len(), rows.len(), |i, j| quadratic[(rows[i], rows[j])]);
    let right = DVector::from_fn(rows.len(), |i, _| -linear[rows[i]]);
    let factor = block.cholesky()?;
    let diagonal = factor.l_dirty().diagonal();
    diagonal.iter().all(|d| d * d > DEPENDENT).then(|| factor.solve(&right))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::rng;
    use rand::RngExt;

    #[test]
    fn the_optimality_conditions_hold_on_random_problems() {
        let mut random = rng::stream(11, "nonnegative");
        let mut active = 0;
        for size in 1..8 {
            for _ in 0..50 {
                let g = DMatrix::from_fn(size, size + 2, |_, _| random.random::<f64>() - 0.5);
                let g = DMatrix::from_fn(size, size + 2, |i, j| g[(i, j)] / g.row(i).norm());
                let (q, linear) = (&g * g.transpose(), DVector::from_fn(size, |_, _| random.random::<f64>() - 0.5));
                let mu = minimise(&q, &linear, 1e-13);
                let gradient = &q * &mu + &linear;
                for i in 0..size {
                    assert!(mu[i] >= 0.0 && gradient[i] > -1e-9, "{mu} {gradient}");
                    assert!((mu[i] * gradient[i]).abs() < 1e-9, "{mu} {gradient}");
                    active += usize::from(mu[i] > 0.0);
                }
            }
        }
        assert!(active > 300, "{active}");
    }

    #[test]
    fn a_row_given_twice_is_taken_once() {
        let q = DMatrix::from_element(2, 2, 1.0);
        let mu = minimise(&q, &DVector::from_vec(vec![-2.0, -2.0]), 1e-13);
        assert!((mu.sum() - 2.0).abs() < 1e-12, "{mu}");
    }
}
