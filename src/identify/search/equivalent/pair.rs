//! What a cluster of feedback controllers with a block of feedforward denominators costs at least, and how far its
//! feedforward controllers can be from the inverse of the plant.
//!
//! # Cost
//! With the measured error `E = 1 − H`, the sensitivity `S = 1/(1 + G Gfb)` and the feedforward N/D, the residual of a
//! candidate is `e = E − S + (S G/D) N`. Around the centres S and D, members have `S/(1 + κ)` and `D (1 + δ)`, and with
//! the centre's residual `r(N) = E − S + (S G/D) N`
//!
//! `e (1 + κ)(1 + δ) = r(N) + Δ`, `Δ = E κ (1 + δ) + (E − S) δ`, `|Δ| ≤ d = |E| κ̄ (1 + δ̄) + |E − S| δ̄`
//!
//! line by line, so that `‖e‖ ≥ (‖r*‖ − ‖d‖)/max (1 + κ̄)(1 + δ̄)`, r* the residual with the centre's best numerator N*.
//!
//! # Numerator
//! A member's best numerator minimises `‖g (r(N) + Δ)‖` with `g = 1/((1 + κ)(1 + δ))`. Since r* is orthogonal to the
//! columns A, and `A (Aᵀ g² A)⁻¹ Aᵀ ≼ I/min g²`,
//!
//! `‖A (N − N*)‖ ≤ β = ‖ |g² − 1| |r*| + g² d ‖/min g²`.
//!
//! # Distance
//! `X = G N/D − 1` on a cell of the band is known from [`Model`]s of the centre's; a member differs from it by at most
//! `|G/D| (|N*| δ̄ + ℓ β)/(1 − δ̄)`, where ℓ is the largest |N| on the cell of a numerator with `‖A N‖ = 1`. A modulus
//! `|a + b s|` is convex in s, so its mean over a cell is at least |a| and at most the mean of both ends.
//!
//! # Rounding
//! As in the kernel of the exhaustive search: the cost of the centre errs by at most
//! `16 γ C (1 + max σ)(1 + p tr Ĝ⁻¹)`.

use super::denominators::Block;
use super::models::{Cells, Model};
use crate::control::System;
use crate::identify::basis::Part;
use crate::identify::problem::Problem;
use num_complex::Complex64;

/// Beyond this trace of the inverse of the scaled Gram matrix the normal equations prove nothing.
const WORST_TRACE: f64 = 1e11;

/// A cluster of feedback controllers `1/(1 + L) = S/(1 + κ)`.
#[derive(Debug, Clone, Default)]
pub(super) struct View {
    /// `1/S` of the centre at each line.
    pub inverse: Vec<Complex64>,
    /// The largest |κ| there; infinite where nothing is known.
    pub radius: Vec<f64>,
    /// Between which values ‖Gfb‖ lies.
    pub norm: [f64; 2],
}

/// What is known of a cluster with a block. Infinite, or nothing, where nothing is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bracket {
    /// No member costs less.
    pub cost: f64,
    /// What the centre costs at most: of a single candidate, its own cost.
    pub above: f64,
    /// Between which values ‖Gff G − 1‖ of the members lies.
    pub distance: [f64; 2],
    /// The sizes of Δ from κ and from δ.
    pub losses: [f64; 2],
}

impl Bracket {
    const UNKNOWN: Self = Self {
        cost: 0.0,
        above: f64::INFINITY,
        distance: [0.0, f64::INFINITY],
        losses: [f64::INFINITY, f64::INFINITY],
    };
}

/// A line of a trial.
#[derive(Debug, Clone, Copy)]
struct Constant {
    /// `E √weight`.
    error: Complex64,
    /// √weight.
    root: f64,
    /// `G √weight`, turned by the angle at which the numerator splits into halves.
    plant: Complex64,
}

/// A cell of the band.
#[derive(Debug)]
struct Cell {
    /// Numerator and denominator of the plant.
    plant: [Model; 2],
    /// The basis functions of the numerator, the real half first.
    functions: Vec<Model>,
    /// Their real values in the middle, and how far they are from these on the cell.
    values: Vec<(f64, f64)>,
}

/// A trial at its lines and on the band.
#[derive(Debug)]
pub(super) struct Trial {
    constants: Vec<Constant>,
    /// Values of the basis functions, line by line, the real half first.
    functions: Vec<f64>,
    halves: [usize; 2],
    half: f64,
    cells: Vec<Cell>,
}

/// A thread's memory.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    halves: [HalfProblem; 2],
    columns: Vec<Complex64>,
    residual: Vec<Complex64>,
}

/// The normal equations of a half of the numerator.
#[derive(Debug, Default)]
struct HalfProblem {
    size: usize,
    /// The Gram matrix's lower triangle, then its Cholesky factor.
    gram: Vec<f64>,
    /// Right sides, then the coefficients.
    right: Vec<f64>,
    /// Norms of the columns of L⁻¹.
    columns: Vec<f64>,
    work: Vec<f64>,
    inverse: Vec<f64>,
}

impl HalfProblem {
    fn begin(&mut self, size: usize) {
        self.size = size;
        for (vector, length) in [
            (&mut self.gram, size * size),
            (&mut self.right, size),
            (&mut self.columns, size),
            (&mut self.work, size),
            (&mut self.inverse, size),
        ] {
            vector.clear();
            vector.resize(length, 0.0);
        }
    }

    fn add(&mut self, weight: f64, target: f64, functions: &[f64]) {
        for i in 0..self.size {
            let scaled = weight * functions[i];
            let row = &mut self.gram[i * self.size..i * self.size + i + 1];
            row.iter_mut().zip(functions).for_each(|(sum, f)| *sum += scaled * f);
            self.right[i] += target * functions[i];
        }
    }

    /// Factors, solves, and gives `n tr Ĝ⁻¹`, infinite where the matrix is not positive definite.
    fn solve(&mut self) -> f64 {
        let n = self.size;
        let mut trace = 0.0;
        self.work.iter_mut().enumerate().for_each(|(i, diagonal)| *diagonal = self.gram[i * n + i]);
        for i in 0..n {
            for j in 0..=i {
                let sum: f64 = (0..j).map(|k| self.gram[i * n + k] * self.gram[j * n + k]).sum();
                let left = self.gram[i * n + j] - sum;
                if i > j {
                    self.gram[i * n + j] = left / self.gram[j * n + j];
                } else if left > 0.0 {
                    self.gram[i * n + i] = left.sqrt();
                } else {
                    return f64::INFINITY;
                }
            }
        }
        for column in 0..n {
            // Column by column of L⁻¹, whose squares sum up to the diagonal of G⁻¹.
            let inverse = &mut self.inverse;
            let mut sum = 0.0;
            for i in column..n {
                let right = if i == column { 1.0 } else { 0.0 };
                let known: f64 = (column..i).map(|k| self.gram[i * n + k] * inverse[k]).sum();
                inverse[i] = (right - known) / self.gram[i * n + i];
                sum += inverse[i] * inverse[i];
            }
            trace += self.work[column] * sum;
            self.columns[column] = sum.sqrt();
        }
        for i in 0..n {
            let known: f64 = (0..i).map(|k| self.gram[i * n + k] * self.right[k]).sum();
            self.right[i] = (self.right[i] - known) / self.gram[i * n + i];
        }
        for i in (0..n).rev() {
            let known: f64 = (i + 1..n).map(|k| self.gram[k * n + i] * self.right[k]).sum();
            self.right[i] = (self.right[i] - known) / self.gram[i * n + i];
        }
        n as f64 * trace
    }

    /// `‖L⁻¹ φ‖` at most, for functions within some distance of values.
    fn leverage(&mut self, values: &[(f64, f64)]) -> f64 {
        let n = self.size;
        let (mut square, mut around) = (0.0, 0.0);
        for i in 0..n {
            let known: f64 = (0..i).map(|k| self.gram[i * n + k] * self.work[k]).sum();
            self.work[i] = (values[i].0 - known) / self.gram[i * n + i];
            square += self.work[i] * self.work[i];
            around += values[i].1 * self.columns[i];
        }
        square.sqrt() + around
    }
}

impl Trial {
    pub(super) fn new(problem: &Problem, plant: &System, cells: &Cells) -> Self {
        let basis = problem.basis();
        let halves = [basis.even(), basis.odd()].map(Part::len);
        let (mut constants, mut functions) = (Vec::new(), Vec::new());
        for (k, line) in problem.lines().iter().enumerate() {
            let root = line.weight.sqrt();
            let turn = Complex64::from_polar(1.0, -basis.rotation(line.omega_rad_s));
            constants.push(Constant { error: (1.0 - line.response) * root, root, plant: line.plant * turn * root });
            functions
                .extend([basis.even(), basis.odd()].into_iter().flat_map(|part| part.values.iter().map(move |v| v[k])));
        }
        let of = |cell: usize| {
            let turning = cells.turning(cell, basis.turning_s());
            let (mut functions, mut values) = (Vec::new(), Vec::new());
            let units = [Complex64::ONE, Complex64::I];
            for ((part, factor), unit) in [basis.even(), basis.odd()].into_iter().zip(basis.factors()).zip(units) {
                for polynomial in part.polynomials() {
                    let real = cells.half_basis(polynomial, basis.scale(), factor, cell);
                    values.push((real.a.re, (real.b.norm() + real.c.norm() * cells.half) * cells.half + real.rest));
                    functions.push(real.scaled(unit).times(&turning, cells.half));
                }
            }
            let plant = [plant.num(), plant.den()].map(|p| cells.polynomial(p.coefficients(), cell));
            Cell { plant, functions, values }
        };
        Self { constants, functions, halves, half: cells.half, cells: (0..cells.count).map(of).collect() }
    }

    /// Whether the plant may have a pole in the band.
    pub(super) fn has_pole_in_band(&self) -> bool {
        self.cells.iter().any(|cell| cell.plant[1].least(self.half) <= 0.0)
    }

    /// Bounds of a cluster with a block; the distance only if `with_distance`, and only where the cost is within the
    /// limit.
    pub(super) fn bracket(
        &self,
        view: &View,
        block: &Block,
        limit: f64,
        with_distance: bool,
        scratch: &mut Scratch,
    ) -> Bracket {
        let Scratch { halves, columns, residual } = scratch;
        let [even, odd] = halves;
        let [p, q] = self.halves;
        even.begin(p);
        odd.begin(q);
        columns.clear();
        residual.clear();
        let (mut total, mut worst) = (0.0, 1.0_f64);
        let rows = self.functions.chunks_exact(p + q);
        for (((constant, functions), inverse), (d, _)) in
            self.constants.iter().zip(rows).zip(&view.inverse).zip(&block.lines)
        {
            let s = inverse.inv();
            let column = s * constant.plant / d;
            let right = constant.error - s * constant.root;
            let weight = column.norm_sqr();
            let product = column.conj() * right;
            even.add(weight, -product.re, &functions[..p]);
            odd.add(weight, -product.im, &functions[p..]);
            columns.push(column);
            residual.push(right);
            // |L| ≤ 1 + |1 + L|.
            let (size, cancelled) = (s.norm(), 2.0 * s.norm() + 1.0);
            total += 2.0 * (constant.error.norm_sqr() + (constant.root * size).powi(2));
            worst = worst.max(cancelled);
        }
        let condition = 1.0 + even.solve() + odd.solve();
        if condition.is_nan() || condition > WORST_TRACE {
            return Bracket::UNKNOWN;
        }
        let margin = 16.0 * (self.constants.len() + 16) as f64 * f64::EPSILON * total * (1.0 + worst) * condition;
        let (mut cost, mut losses, mut least) = (0.0, [0.0, 0.0], 1.0_f64);
        let (mut size, mut moved) = (0.0, 0.0);
        let rows = self.functions.chunks_exact(p + q);
        for (k, functions) in rows.enumerate() {
            let re: f64 = functions[..p].iter().zip(&even.right).map(|(f, c)| f * c).sum();
            let im: f64 = functions[p..].iter().zip(&odd.right).map(|(f, c)| f * c).sum();
            let right = residual[k];
            let left = right + columns[k] * Complex64::new(re, im);
            let (kappa, delta) = (view.radius[k], block.lines[k].1);
            let square = left.norm_sqr();
            cost += square;
            if kappa == 0.0 && delta == 0.0 {
                continue;
            }
            let by = [self.constants[k].error.norm() * kappa * (1.0 + delta), right.norm() * delta];
            losses[0] += by[0] * by[0];
            losses[1] += by[1] * by[1];
            let both = by[0] + by[1];
            size += both * both;
            // The smallest and the largest |g|².
            let small = ((1.0 + kappa) * (1.0 + delta)).powi(-2);
            let large =
                if kappa < 1.0 && delta < 1.0 { ((1.0 - kappa) * (1.0 - delta)).powi(-2) } else { f64::INFINITY };
            least = least.min(small);
            moved += ((large - 1.0).max(1.0 - small) * square.sqrt() + large * both).powi(2);
        }
        let losses = losses.map(f64::sqrt);
        let root = (cost - margin).max(0.0).sqrt() - size.sqrt() * (1.0 + 1e-12);
        let low = (root.max(0.0).powi(2) * least - margin).max(0.0);
        let mut bracket = Bracket { cost: low, above: cost + margin, losses, ..Bracket::UNKNOWN };
        if !bracket.above.is_finite() || low.is_nan() {
            return Bracket::UNKNOWN;
        }
        if with_distance && low <= limit {
            let beta = moved.sqrt() / least + 2.0 * margin.sqrt();
            if beta.is_finite() {
                bracket.distance = self.distance(block, beta, halves);
            }
        }
        bracket
    }

    /// Between which values ‖Gff G − 1‖ lies for numerators within β of the one that was found.
    fn distance(&self, block: &Block, beta: f64, halves: &mut [HalfProblem; 2]) -> [f64; 2] {
        let [even, odd] = halves;
        let (p, half) = (even.size, self.half);
        let (mut low, mut high) = (0.0, 0.0);
        for (cell, (d, delta)) in self.cells.iter().zip(&block.cells) {
            let mut n = Model::ZERO;
            let coefficients = even.right.iter().chain(&odd.right);
            coefficients.zip(&cell.functions).for_each(|(c, function)| n.add(*c, function));
            let below = cell.plant[1].times(d, half);
            let nominal = cell.plant[0].times(&n, half);
            let above = nominal.plus(&below.scaled(Complex64::new(-1.0, 0.0)));
            // The quotient as a tangent, and what it leaves over.
            let inverse = below.a.inv();
            let value = above.a * inverse;
            let slope = (above.b - value * below.b) * inverse;
            let left = above.curved(half)
                + value.norm() * below.curved(half)
                + slope.norm() * half * (below.b.norm() * half + below.curved(half));
            let smallest = below.least(half);
            if !(smallest > 0.0 && *delta < 1.0) {
                high = f64::INFINITY;
                continue;
            }
            let mut around = left / smallest;
            let mut shift = 0.0;
            if *delta > 0.0 {
                shift += nominal.most(half) * delta;
            }
            let leverage = even.leverage(&cell.values[..p]).max(odd.leverage(&cell.values[p..]));
            shift += cell.plant[0].most(half) * leverage * beta;
            around += shift / (smallest * (1.0 - delta));
            low += (value.norm() - around).max(0.0);
            high += 0.5 * ((value + slope * half).norm() + (value - slope * half).norm()) + around;
        }
        let count = self.cells.len() as f64;
        if high.is_nan() { [0.0, f64::INFINITY] } else { [low / count, high / count] }
    }
}
