//! Whether the data tell feedback and feedforward apart; see [`identifiability`](crate::identify::identifiability), of
//! which this is the multivariable form.
//!
//! With `E = Dfb + Nfb Gv` and `Q = E⁻¹ (Nfb + Dfb Gff)`, the response from command to control, the modelled response
//! `G̃ = Gy Q` changes by `Gy E⁻¹ Dfb δGff`, by `Gy E⁻¹ δNfb (I − Gv Q)` and by `Gy E⁻¹ δDfb (Gff − Q)`.

use super::lines::Lines;
use super::pool::{Entry, FeedbackPool};
use crate::control::{Discrete, LeftFraction, PolynomialMatrix};
use crate::identify::identifiability::Identifiability;
use crate::num::linalg;
use nalgebra::DMatrix;
use num_complex::Complex64;

/// Derivatives of the modelled response as real columns over lines and entries.
#[derive(Debug, Clone, PartialEq)]
struct Derivatives {
    feedforward: Vec<Vec<f64>>,
    feedback: Vec<Vec<f64>>,
}

/// The derivatives of the modelled response, by the coefficients of the feedforward (control, command and power of 1/z,
/// in this order) and by those coefficients of the feedback that the pool leaves open. `None` where the loop is
/// singular at a line.
fn derivatives(
    lines: &Lines,
    pool: &FeedbackPool,
    feedback: &LeftFraction<Discrete>,
    feedforward: &PolynomialMatrix,
    order: usize,
) -> Option<Derivatives> {
    let (m, l) = (pool.controls(), pool.fed_back());
    let open: Vec<_> = pool
        .rows()
        .iter()
        .enumerate()
        .flat_map(|(i, row)| row.coefficients.iter().filter(|c| c.values.len() > 1).map(move |c| (i, c.of, c.power)))
        .collect();
    let mut by_feedforward = vec![Vec::new(); m * l * (order + 1)];
    let mut by_feedback = vec![Vec::new(); open.len()];
    for line in &lines.used {
        let z = line.z;
        let gff = feedforward.eval(z) * z.powi(-(order as i32));
        let (dfb, nfb) = (feedback.denominator().eval(z), feedback.numerator().eval(z));
        let loop_inverse = (&dfb + &nfb * &line.fed_back).lu();
        let q = loop_inverse.solve(&(&nfb + &dfb * &gff))?;
        let identity = DMatrix::<Complex64>::identity(m, m);
        let scale = Complex64::new(line.weight.sqrt(), 0.0);
        let through = &line.measured * loop_inverse.solve(&identity)? * scale;
        let by_row = &through * &dfb;
        let push = |column: &mut Vec<f64>, of: &DMatrix<Complex64>, i: usize, right: &dyn Fn(usize) -> Complex64| {
            for output in 0..line.measured.nrows() {
                for command in 0..l {
                    let v = of[(output, i)] * right(command);
                    column.extend([v.re, v.im]);
                }
            }
        };
        let mut columns = by_feedforward.iter_mut();
        for i in 0..m {
            for j in 0..l {
                for power in 0..=order {
                    let delay = z.powi(-(power as i32));
                    let right = |command: usize| if command == j { delay } else { Complex64::new(0.0, 0.0) };
                    if let Some(column) = columns.next() {
                        push(column, &by_row, i, &right);
                    }
                }
            }
        }
        let passed = DMatrix::<Complex64>::identity(l, l) - &line.fed_back * &q;
        let direct = &gff - &q;
        for (column, (i, of, power)) in by_feedback.iter_mut().zip(&open) {
            let power = z.powu(*power as u32);
            match of {
                Entry::Numerator(j) => push(column, &through, *i, &|command| power * passed[(*j, command)]),
                Entry::Denominator(c) => push(column, &through, *i, &|command| power * direct[(*c, command)]),
            }
        }
    }
    Some(Derivatives { feedforward: by_feedforward, feedback: by_feedback })
}

/// Scaled to unit length; `None` for a column that vanishes.
fn unit(columns: &[Vec<f64>]) -> Vec<Option<Vec<f64>>> {
    let scaled = |column: &Vec<f64>| {
        let norm = column.iter().map(|v| v * v).sum::<f64>().sqrt();
        (norm > 0.0 && norm.is_finite()).then(|| column.iter().map(|v| v / norm).collect())
    };
    columns.iter().map(scaled).collect()
}

fn matrix(columns: &[Vec<f64>]) -> DMatrix<f64> {
    DMatrix::from_fn(columns[0].len(), columns.len(), |i, j| columns[j][i])
}

/// Judges the derivatives at identified controllers.
#[must_use]
pub fn identifiability(
    lines: &Lines,
    pool: &FeedbackPool,
    feedback: &LeftFraction<Discrete>,
    feedforward: &PolynomialMatrix,
    order: usize,
) -> Identifiability {
    let open = pool.rows().iter().flat_map(|row| &row.coefficients).filter(|c| c.values.len() > 1).count();
    let unknowns = pool.controls() * pool.fed_back() * (order + 1) + open;
    let mut judged =
        Identifiability { unknowns, equations: lines.equations(), condition_number: None, separation: None };
    if unknowns > judged.equations {
        return judged;
    }
    let Some(by) = derivatives(lines, pool, feedback, feedforward, order) else { return judged };
    let (ff, fb) = (unit(&by.feedforward), unit(&by.feedback));
    if let Some(all) = ff.iter().chain(&fb).cloned().collect::<Option<Vec<_>>>()
        && let Ok(values) = linalg::singular_values(&matrix(&all))
        && let (Some(largest), Some(smallest)) = (values.first(), values.last())
        && *smallest > 0.0
    {
        judged.condition_number = Some(largest / smallest);
    }
    let ff: Vec<Vec<f64>> = ff.into_iter().flatten().collect();
    let fb: Option<Vec<Vec<f64>>> = fb.into_iter().collect();
    if let Some(fb) = fb.filter(|fb| !fb.is_empty() && !ff.is_empty()) {
        // The smallest angle between the two spaces of changes.
        let (own, other) = (matrix(&fb).qr().q(), matrix(&ff).qr().q());
        let mut apart = &own - &other * (other.transpose() * &own);
        apart -= &other * (other.transpose() * &apart);
        judged.separation =
            linalg::singular_values(&apart).ok().and_then(|values| values.last().copied()).map(|sine| sine.min(1.0));
    }
    judged
}
