//! One candidate, evaluated by Householder QR: the cost that decides.

use crate::identify::basis::Part;
use crate::identify::pool::Candidate;
use crate::identify::problem::Problem;
use num_complex::Complex64;

/// What a candidate's best feedforward numerator achieves.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// `J = Σ weight · |G̃ − H|²` over the lines.
    pub cost: f64,
    /// Coefficients of the feedforward numerator, descending powers.
    pub feedforward_numerator: Vec<f64>,
}

/// The weighted rows of a candidate's problem: square roots of the weights of the numerator, and its target at the
/// lines.
struct Rows {
    root_weight: Vec<f64>,
    target: Vec<Complex64>,
}

fn rows(problem: &Problem, candidate: &Candidate) -> Rows {
    // As the fast evaluation does it: the quotient at the lines first, then the gain.
    let numerator = problem.at_lines(&candidate.feedback_numerator);
    let reciprocal = problem.reciprocal_at_lines(&candidate.feedback_denominator);
    let feedforward = problem.at_lines(&candidate.feedforward_denominator);
    let mut rows = Rows { root_weight: Vec::new(), target: Vec::new() };
    for (k, line) in problem.lines().iter().enumerate() {
        let feedback = candidate.feedback_gain * (numerator[k] * reciprocal[k]);
        let target = line.response / line.plant + (line.response - 1.0) * feedback;
        let gain = line.plant / ((1.0 + line.plant * feedback) * feedforward[k]);
        let rotation = Complex64::from_polar(1.0, problem.basis().rotation(line.omega_rad_s));
        rows.root_weight.push(line.weight.sqrt() * gain.norm());
        rows.target.push(target * feedforward[k] * rotation);
    }
    rows
}

/// Minimises `‖diag(w) (V x − b)‖` by Householder QR; returns x and the squared residual.
///
/// A column that vanishes beside the others gets the coefficient 0.
fn least_squares(part: &Part, root_weight: &[f64], target: &[f64]) -> (Vec<f64>, f64) {
    let lines = root_weight.len();
    let mut columns: Vec<Vec<f64>> =
        part.values.iter().map(|v| v.iter().zip(root_weight).map(|(v, w)| v * w).collect()).collect();
    let mut b: Vec<f64> = target.iter().zip(root_weight).map(|(t, w)| t * w).collect();
    let size = columns.len();
    // Row of each column's pivot; a column without one is a combination of those before it.
    let mut pivots: Vec<Option<(usize, f64)>> = vec![None; size];
    let mut row = 0;
    for j in 0..size {
        if row >= lines {
            break;
        }
        let norm = columns[j][row..].iter().map(|v| v * v).sum::<f64>().sqrt();
        if norm == 0.0 {
            continue;
        }
        // The reflection that takes the rest of column j to (−sign · norm, 0, …).
        let alpha = -norm.copysign(columns[j][row]);
        let mut reflector = columns[j][row..].to_vec();
        reflector[0] -= alpha;
        let square: f64 = reflector.iter().map(|v| v * v).sum();
        let reflect = |vector: &mut [f64]| {
            let share = 2.0 * reflector.iter().zip(&*vector).map(|(a, b)| a * b).sum::<f64>() / square;
            vector.iter_mut().zip(&reflector).for_each(|(v, r)| *v -= share * r);
        };
        columns[j + 1..].iter_mut().for_each(|column| reflect(&mut column[row..]));
        reflect(&mut b[row..]);
        pivots[j] = Some((row, alpha));
        row += 1;
    }
    let residual = b[row..].iter().map(|v| v * v).sum();
    let mut x = vec![0.0; size];
    for j in (0..size).rev() {
        if let Some((row, alpha)) = pivots[j] {
            let sum: f64 = (j + 1..size).map(|i| columns[i][row] * x[i]).sum();
            x[j] = (b[row] - sum) / alpha;
        }
    }
    (x, residual)
}

/// The best numerator of a candidate, and its cost.
#[must_use]
pub fn fit(problem: &Problem, candidate: &Candidate) -> Fit {
    let rows = rows(problem, candidate);
    let real: Vec<f64> = rows.target.iter().map(|t| t.re).collect();
    let imaginary: Vec<f64> = rows.target.iter().map(|t| t.im).collect();
    let (even, from_even) = least_squares(problem.basis().even(), &rows.root_weight, &real);
    let (odd, from_odd) = least_squares(problem.basis().odd(), &rows.root_weight, &imaginary);
    Fit { cost: from_even + from_odd, feedforward_numerator: problem.basis().numerator(&even, &odd) }
}

/// The cost of a candidate; infinite where its response overflows.
#[must_use]
pub fn cost(problem: &Problem, candidate: &Candidate) -> f64 {
    let cost = fit(problem, candidate).cost;
    if cost.is_nan() { f64::INFINITY } else { cost }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::basis::Basis;
    use crate::identify::time::Time;
    use nalgebra::{DMatrix, DVector};

    #[test]
    fn agrees_with_a_library_on_weighted_lines() {
        let omega: Vec<f64> = (1..=12).map(|k| 0.3 * f64::from(k)).collect();
        let basis = Basis::new(Time::Continuous, 5, &omega).unwrap();
        let weights: Vec<f64> = omega.iter().map(|w| 1.0 / (0.1 + w * w)).collect();
        let target: Vec<f64> = omega.iter().map(|w| w.sin() + 2.0).collect();
        let (x, residual) = least_squares(basis.even(), &weights, &target);
        let a = DMatrix::from_fn(12, 3, |k, i| weights[k] * basis.even().values[i][k]);
        let b = DVector::from_fn(12, |k, _| weights[k] * target[k]);
        let (expected, expected_residual) = crate::num::linalg::least_squares(&a, &b).unwrap();
        assert!(x.iter().zip(expected.iter()).all(|(a, b)| (a - b).abs() < 1e-11), "{x:?} {expected}");
        assert!((residual - expected_residual).abs() < 1e-13 * residual.max(1.0));
    }
}
