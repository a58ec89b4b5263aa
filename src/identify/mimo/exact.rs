//! The cost of one candidate, by orthogonalisation: what decides between candidates.

use super::lines::Lines;
use super::pool::FeedbackPool;
use crate::control::Discrete;
use crate::identify::basis::{Basis, TooFewLines};
use crate::identify::time::Time;
use nalgebra::DMatrix;
use num_complex::Complex64;

/// The least-squares problem of the FIR feedforward, without the feedback.
#[derive(Debug, Clone)]
pub struct Problem {
    /// The lines.
    pub lines: Lines,
    /// The basis of every entry of the feedforward numerator on them.
    pub basis: Basis,
    /// Values of the basis functions, line by line: the real ones, then the imaginary ones.
    pub functions: Vec<Vec<f64>>,
    /// `e^{j n θ/2}`, which makes them real and imaginary.
    pub turn: Vec<Complex64>,
    /// The time base.
    pub time: Discrete,
}

/// The best feedforward for a feedback.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// `J = Σ weight ‖G̃ − H‖²`.
    pub cost: f64,
    /// J below this is zero but for the rounding of its computation.
    pub rounding: f64,
    /// Coefficients in the basis: control i, command j, basis function a at `[(i·functions + a, j)]`.
    pub coefficients: DMatrix<f64>,
    /// Whether the lines determine them.
    pub is_unique: bool,
}

impl Fit {
    /// The cost that candidates are compared by: 0 where it is zero but for rounding.
    #[must_use]
    pub fn compared(&self) -> f64 {
        if self.cost <= self.rounding { 0.0 } else { self.cost }
    }
}

/// A column that keeps less than this share of itself beside the others depends on them.
const INDEPENDENT: f64 = 1e-13;

/// Costs below `(ROUNDING ε)²` times the squared size of what is fitted are rounding.
const ROUNDING: f64 = 64.0;

impl Problem {
    /// From lines and the order of the feedforward.
    ///
    /// # Errors
    /// [`TooFewLines`] where the lines do not determine it.
    pub fn new(lines: Lines, order: usize, time: Discrete) -> Result<Self, TooFewLines> {
        let omega: Vec<f64> = lines.used.iter().map(|line| line.omega_rad_s).collect();
        let basis = Basis::new(Time::Sampled(time), order, &omega)?;
        let functions = (0..omega.len())
            .map(|k| basis.even().values.iter().chain(&basis.odd().values).map(|v| v[k]).collect())
            .collect();
        let turn = omega.iter().map(|w| Complex64::from_polar(1.0, -basis.rotation(*w))).collect();
        Ok(Self { lines, basis, functions, turn, time })
    }

    /// How many basis functions are real; the others are imaginary.
    #[must_use]
    pub fn even(&self) -> usize {
        self.basis.even().len()
    }

    /// Unknown coefficients of one column of the feedforward, for `controls` controls.
    #[must_use]
    pub fn unknowns(&self, controls: usize) -> usize {
        controls * (self.basis.even().len() + self.basis.odd().len())
    }

    /// The coefficients of the feedforward numerators in descending powers, row by row.
    #[must_use]
    pub fn numerators(&self, fit: &Fit) -> Vec<Vec<Vec<f64>>> {
        let size = self.basis.even().len() + self.basis.odd().len();
        (0..fit.coefficients.nrows() / size)
            .map(|i| {
                (0..fit.coefficients.ncols())
                    .map(|j| {
                        let own: Vec<f64> = (0..size).map(|a| fit.coefficients[(i * size + a, j)]).collect();
                        let (even, odd) = own.split_at(self.even());
                        self.basis.numerator(even, odd)
                    })
                    .collect()
            })
            .collect()
    }

    /// Fits the feedforward to one feedback (Zhang 2015, equations 4.8 to 4.10): with `E = Dfb + Nfb Gv` the modelled
    /// response is `Gy E⁻¹ (Nfb + Dfb Gff)`, linear in Gff. Columns are orthogonalised by modified Gram and Schmidt,
    /// twice; the columns of Gff share them. `None` where E is singular at a line or a value is not finite.
    #[must_use]
    pub fn fit(&self, pool: &FeedbackPool, coefficients: &[Vec<f64>]) -> Option<Fit> {
        let fraction = pool.fraction(coefficients, self.time);
        let (m, l) = (pool.controls(), pool.fed_back());
        let (lines, p) = (&self.lines.used, self.unknowns(m));
        // With fewer measured outputs than controls a line has fewer equations than unknowns; the lines together
        // decide.
        let reached = lines.first().map_or(m, |line| line.root.nrows());
        let rows = 2 * reached * lines.len();
        let mut columns = vec![vec![0.0; rows]; p];
        let mut targets = vec![vec![0.0; rows]; l];
        let size = p / m;
        for (k, line) in lines.iter().enumerate() {
            let (dfb, nfb) = (fraction.denominator().eval(line.z), fraction.numerator().eval(line.z));
            let inverse = (&dfb + &nfb * &line.fed_back).lu();
            let a = &line.root * inverse.solve(&dfb)?;
            let b = (&line.target - &line.root * inverse.solve(&nfb)?) * self.turn[k];
            let put = |column: &mut Vec<f64>, i: usize, v: Complex64| {
                (column[2 * (k * reached + i)], column[2 * (k * reached + i) + 1]) = (v.re, v.im);
            };
            for i in 0..reached {
                for control in 0..m {
                    for (f, value) in self.functions[k].iter().enumerate() {
                        let unit =
                            if f < self.even() { Complex64::new(*value, 0.0) } else { Complex64::new(0.0, *value) };
                        put(&mut columns[control * size + f], i, a[(i, control)] * unit);
                    }
                }
                for (j, target) in targets.iter_mut().enumerate() {
                    put(target, i, b[(i, j)]);
                }
            }
        }
        let fitted: f64 = targets.iter().flatten().map(|v| v * v).sum();
        let solved = orthogonalise(columns, targets)?;
        let cost = solved.residual + self.lines.unreachable;
        // What the response is made of: its parts cancel where a feedback fits.
        let data: f64 = lines.iter().map(|line| line.target.iter().map(|v| v.norm_sqr()).sum::<f64>()).sum();
        let rounding = (ROUNDING * f64::EPSILON).powi(2) * (fitted + data);
        Some(Fit { cost, rounding, coefficients: solved.x, is_unique: solved.is_unique })
    }
}

struct Solved {
    residual: f64,
    x: DMatrix<f64>,
    is_unique: bool,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Least squares for several right-hand sides; dependent columns get the coefficient 0.
fn orthogonalise(mut columns: Vec<Vec<f64>>, mut targets: Vec<Vec<f64>>) -> Option<Solved> {
    let p = columns.len();
    let mut r = DMatrix::<f64>::zeros(p, p);
    let mut rhs = DMatrix::<f64>::zeros(p, targets.len());
    let mut is_kept = vec![true; p];
    for c in 0..p {
        let (before, rest) = columns.split_at_mut(c);
        let own = &mut rest[0];
        let size = dot(own, own).sqrt();
        for _ in 0..2 {
            for (i, q) in before.iter().enumerate().filter(|(i, _)| is_kept[*i]) {
                let share = dot(q, own);
                r[(i, c)] += share;
                own.iter_mut().zip(q).for_each(|(v, q)| *v -= share * q);
            }
        }
        let norm = dot(own, own).sqrt();
        if !norm.is_finite() {
            return None;
        }
        is_kept[c] = norm > INDEPENDENT * size;
        if is_kept[c] {
            r[(c, c)] = norm;
            own.iter_mut().for_each(|v| *v /= norm);
        }
    }
    for (j, target) in targets.iter_mut().enumerate() {
        for _ in 0..2 {
            for (i, q) in columns.iter().enumerate().filter(|(i, _)| is_kept[*i]) {
                let share = dot(q, target);
                rhs[(i, j)] += share;
                target.iter_mut().zip(q).for_each(|(v, q)| *v -= share * q);
            }
        }
    }
    let residual: f64 = targets.iter().flatten().map(|v| v * v).sum();
    if !residual.is_finite() {
        return None;
    }
    let mut x = DMatrix::<f64>::zeros(p, targets.len());
    for j in 0..targets.len() {
        for i in (0..p).rev().filter(|i| is_kept[*i]) {
            let known: f64 = (i + 1..p).map(|c| r[(i, c)] * x[(c, j)]).sum();
            x[(i, j)] = (rhs[(i, j)] - known) / r[(i, i)];
        }
    }
    Some(Solved { residual, x, is_unique: is_kept.iter().all(|kept| *kept) })
}
