//! What a cluster of feedback controllers with a block of feedforward denominators costs at least, and how far its
//! feedforward controllers can be from the inverse of the plant.
//!
//! # Cost
//! With the measured error `E = 1 − H`, the sensitivity `S = 1/(1 + G Gfb)` and the feedforward N/D, the residual of a
//! candidate is `e = E − S + (S G/D) N`. Around the centres S and D, members have `S/(1 + κ)` and `D (1 + δ)`, and with
//! the centre's residual `r(N) = E − S + (S G/D) N`
//!
//! `e (1 + κ)(1 + δ) = r(N) + E κ (1 + δ) + (E − S) δ`
//!
//! line by line. Most of what another denominator does, the numerator makes up for: with `δ = Σ o_i xⁱ/D`, o_i being
//! differences of coefficients, and numerators ν_i that come closest to it in `ρ_i = (E − S) xⁱ/D + A ν_i`, where A is
//! what a numerator adds to r, `N = N' + Σ o_i ν_i` gives
//!
//! `e (1 + κ)(1 + δ) = r(N') + Δ`, `Δ = E κ (1 + δ) + Σ o_i ρ_i`, `|Δ| ≤ d = |E| κ̄ (1 + δ̄) + Σ |o_i| |ρ_i|`,
//!
//! so that `‖e‖ ≥ (‖r*‖ − ‖d‖)/max (1 + κ̄)(1 + δ̄)`, r* the residual with the centre's best numerator N*.
//!
//! # Numerator
//! A member's best numerator minimises `‖g (r(N') + Δ)‖` with `g = 1/((1 + κ)(1 + δ))`. Since r* is orthogonal to the
//! columns A, and `A (Aᵀ g² A)⁻¹ Aᵀ ≼ I/min g²`,
//!
//! `‖A (N' − N*)‖ ≤ β = ‖ |g² − 1| |r*| + g² d ‖/min g²`.
//!
//! # Distance
//! `X = G N/D − 1` on a cell of the band is known from [`Model`]s of the centre's; a member differs from it by at most
//! `|G/D| (Σ |o_i| |ν_i − N* xⁱ/D| + ℓ β)/(1 − δ̄)`, where ℓ is the largest |N| on the cell of a numerator with
//! `‖A N‖ = 1`. A modulus `|a + b s|` is convex in s, so its mean over a cell is at least |a| and at most the mean of
//! both ends.
//!
//! # Rounding
//! As in the kernel of the exhaustive search: the cost of the centre errs by at most
//! `16 γ C (1 + max σ)(1 + p tr Ĝ⁻¹)`.

use super::denominators::Block;
use super::models::{Cells, Model, modulus};
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
    /// The variable, s or z.
    variable: Complex64,
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
    /// Powers of the variable from 0 on.
    powers: Vec<Model>,
}

/// A trial at its lines and on the band.
#[derive(Debug)]
pub(super) struct Trial {
    constants: Vec<Constant>,
    /// Values of the basis functions, line by line, the real half first; without a numerator, a 0 for each line.
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
    /// The coefficients of a denominator that differ within a block.
    free: Vec<usize>,
}

/// The normal equations of a half of the numerator.
#[derive(Debug, Default)]
struct HalfProblem {
    size: usize,
    /// The Gram matrix's lower triangle, then its Cholesky factor.
    gram: Vec<f64>,
    /// Right sides, then the coefficients: of the numerator, then of each ν.
    right: Vec<f64>,
    /// Norms of the columns of L⁻¹.
    columns: Vec<f64>,
    work: Vec<f64>,
    inverse: Vec<f64>,
}

impl HalfProblem {
    fn begin(&mut self, size: usize, sides: usize) {
        self.size = size;
        for (vector, length) in [
            (&mut self.gram, size * size),
            (&mut self.right, size * sides),
            (&mut self.columns, size),
            (&mut self.work, size),
            (&mut self.inverse, size),
        ] {
            vector.clear();
            vector.resize(length, 0.0);
        }
    }

    fn add(&mut self, weight: f64, functions: &[f64]) {
        for i in 0..self.size {
            let scaled = weight * functions[i];
            let row = &mut self.gram[i * self.size..i * self.size + i + 1];
            row.iter_mut().zip(functions).for_each(|(sum, f)| *sum += scaled * f);
        }
    }

    fn add_right(&mut self, side: usize, target: f64, functions: &[f64]) {
        let right = &mut self.right[side * self.size..(side + 1) * self.size];
        right.iter_mut().zip(functions).for_each(|(sum, f)| *sum += target * f);
    }

    /// The coefficients of a right side.
    fn side(&self, side: usize) -> &[f64] {
        &self.right[side * self.size..(side + 1) * self.size]
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
        for right in self.right.chunks_exact_mut(n.max(1)) {
            for i in 0..n {
                let known: f64 = (0..i).map(|k| self.gram[i * n + k] * right[k]).sum();
                right[i] = (right[i] - known) / self.gram[i * n + i];
            }
            for i in (0..n).rev() {
                let known: f64 = (i + 1..n).map(|k| self.gram[k * n + i] * right[k]).sum();
                right[i] = (right[i] - known) / self.gram[i * n + i];
            }
        }
        n as f64 * trace
    }

    /// `‖L⁻¹ φ‖` at most, for functions within some distance of values.
    fn leverage(&mut self, values: &[(f64, f64)]) -> f64 {
        let n = self.size;
        let (mut square, mut around) = (0.0, 0.0);
        for (i, (value, distance)) in values.iter().enumerate().take(n) {
            let known: f64 = (0..i).map(|k| self.gram[i * n + k] * self.work[k]).sum();
            self.work[i] = (value - known) / self.gram[i * n + i];
            square += self.work[i] * self.work[i];
            around += distance * self.columns[i];
        }
        square.sqrt() + around
    }
}

impl Trial {
    /// `powers` is the number of coefficients of a feedforward denominator.
    pub(super) fn new(problem: &Problem, plant: &System, powers: usize, cells: &Cells) -> Self {
        let basis = problem.basis();
        let halves = [basis.even(), basis.odd()].map(Part::len);
        let (mut constants, mut functions) = (Vec::new(), Vec::new());
        for (k, line) in problem.lines().iter().enumerate() {
            let root = line.weight.sqrt();
            let turn = Complex64::from_polar(1.0, -basis.rotation(line.omega_rad_s));
            constants.push(Constant {
                error: (1.0 - line.response) * root,
                root,
                plant: line.plant * turn * root,
                variable: problem.time().point(line.omega_rad_s),
            });
            functions
                .extend([basis.even(), basis.odd()].into_iter().flat_map(|part| part.values.iter().map(move |v| v[k])));
            if basis.is_none() {
                // A place for each line, of which nothing is read.
                functions.push(0.0);
            }
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
            Cell { plant, functions, values, powers: cells.powers(powers, cell) }
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
        let Scratch { halves, columns, residual, free } = scratch;
        let [even, odd] = halves;
        let [p, q] = self.halves;
        free.clear();
        free.extend((0..block.reach.len()).filter(|i| block.reach[*i] > 0.0));
        even.begin(p, 1 + free.len());
        odd.begin(q, 1 + free.len());
        columns.clear();
        residual.clear();
        let (mut total, mut worst) = (0.0, 1.0_f64);
        let rows = self.functions.chunks_exact((p + q).max(1));
        for (((constant, functions), inverse), (d, _)) in
            self.constants.iter().zip(rows).zip(&view.inverse).zip(&block.lines)
        {
            let (s, d) = (inverse.inv(), d.inv());
            let column = s * constant.plant * d;
            let right = constant.error - s * constant.root;
            let weight = column.norm_sqr();
            even.add(weight, &functions[..p]);
            odd.add(weight, &functions[p..]);
            let product = column.conj() * right;
            even.add_right(0, -product.re, &functions[..p]);
            odd.add_right(0, -product.im, &functions[p..]);
            for (side, i) in free.iter().enumerate() {
                let turned = product * constant.variable.powu(*i as u32) * d;
                even.add_right(1 + side, -turned.re, &functions[..p]);
                odd.add_right(1 + side, -turned.im, &functions[p..]);
            }
            columns.push(column);
            residual.push(right);
            // |L| ≤ 1 + |1 + L|.
            let (size, cancelled) = (modulus(s), 2.0 * modulus(s) + 1.0);
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
        let rows = self.functions.chunks_exact((p + q).max(1));
        for (k, functions) in rows.enumerate() {
            let value = |side: usize| {
                let re: f64 = functions[..p].iter().zip(even.side(side)).map(|(f, c)| f * c).sum();
                let im: f64 = functions[p..p + q].iter().zip(odd.side(side)).map(|(f, c)| f * c).sum();
                Complex64::new(re, im)
            };
            let right = residual[k];
            let left = right + columns[k] * value(0);
            let (kappa, delta) = (view.radius[k], block.lines[k].1);
            let square = left.norm_sqr();
            cost += square;
            if kappa == 0.0 && delta == 0.0 {
                continue;
            }
            let mut by = [modulus(self.constants[k].error) * kappa * (1.0 + delta), 0.0];
            for (side, i) in free.iter().enumerate() {
                let unit = self.constants[k].variable.powu(*i as u32) / block.lines[k].0;
                by[1] += block.reach[*i] * modulus(right * unit + columns[k] * value(1 + side));
            }
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
                bracket.distance = self.distance(block, beta, halves, free);
            }
        }
        bracket
    }

    /// Between which values ‖Gff G − 1‖ lies for numerators within β of those that were found.
    fn distance(&self, block: &Block, beta: f64, halves: &mut [HalfProblem; 2], free: &[usize]) -> [f64; 2] {
        let [even, odd] = halves;
        let (p, half) = (even.size, self.half);
        let (mut low, mut high) = (0.0, 0.0);
        for (cell, (d, delta)) in self.cells.iter().zip(&block.cells) {
            let numerator = |side: usize| {
                let mut n = Model::ZERO;
                let coefficients = even.side(side).iter().chain(odd.side(side));
                coefficients.zip(&cell.functions).for_each(|(c, function)| n.add(*c, function));
                n
            };
            let n = numerator(0);
            let below = cell.plant[1].times(d, half);
            let nominal = cell.plant[0].times(&n, half);
            let above = nominal.plus(&below.scaled(Complex64::new(-1.0, 0.0)));
            // The quotient as a tangent, and what it leaves over.
            let inverse = below.a.inv();
            let value = above.a * inverse;
            let slope = (above.b - value * below.b) * inverse;
            let left = above.curved(half)
                + modulus(value) * below.curved(half)
                + modulus(slope) * half * (modulus(below.b) * half + below.curved(half));
            let (smallest, smallest_d) = (below.least(half), d.least(half));
            if !(smallest > 0.0 && smallest_d > 0.0 && *delta < 1.0) {
                high = f64::INFINITY;
                continue;
            }
            let mut shift = 0.0;
            for (side, i) in free.iter().enumerate() {
                // ν D − N xⁱ over D.
                let made_up = numerator(1 + side).times(d, half);
                let changed = n.times(&cell.powers[*i], half).scaled(Complex64::new(-1.0, 0.0));
                shift += block.reach[*i] * made_up.plus(&changed).most(half) / smallest_d;
            }
            if beta > 0.0 {
                shift += beta * even.leverage(&cell.values[..p]).max(odd.leverage(&cell.values[p..]));
            }
            let around = left / smallest + cell.plant[0].most(half) * shift / (smallest * (1.0 - delta));
            low += (modulus(value) - around).max(0.0);
            high += 0.5 * (modulus(value + slope * half) + modulus(value - slope * half)) + around;
        }
        let count = self.cells.len() as f64;
        if high.is_nan() { [0.0, f64::INFINITY] } else { [low / count, high / count] }
    }
}
