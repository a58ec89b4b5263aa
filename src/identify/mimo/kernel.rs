//! The fast evaluation of many candidates that share all rows but the last one.
//!
//! With `E = Dfb + Nfb Gv` and `X = Nfb + Dfb Gff` the weighted residual at a line is `R E⁻¹ X − T` (R, T:
//! [`Line`](super::lines::Line)). Let the upper rows E_u of E be fixed, ñ the unit null vector of `E_u R⁻¹` and P̃ its
//! pseudo-inverse. With the last row e of E and `g = e R⁻¹ ñ`, `f = e R⁻¹ P̃`
//!
//! `R E⁻¹ X − T = [P̃ X_u − (I − ñ ñ*) T] + ñ [(x − f X_u)/g − ñ* T]`, the two brackets being orthogonal.
//!
//! The first does not depend on the last row; the second is one weighted equation `(y Gff − τ)/g` per command, with
//! `y = [−f, 1] Dfb` and `τ = ñ* T g − [−f, 1] Nfb`. Since g and f are affine in the last row's coefficients, a
//! candidate costs a few products per line, and the normal equations in the orthonormal basis follow from weighted sums
//! of `y* y` and `y* τ`.
//!
//! # Bound
//! A sum of N terms errs by γ = (N + p + 32) ε of the sum of the moduli of what it is made of. Let C be `Σ S_τ²/|g|²`
//! with S_τ the sum of the moduli of the terms of τ before they cancel, B the same for `y` times the largest basis
//! function, both with the share of the fixed bracket. J then errs by at most `4γ κ (1 + σ) Σ_j (√C + √B ‖x_j‖₁)²`,
//! where `σ = max S_g/|g|` is the cancellation in g and κ the condition of R and of the fixed rows, through which f and
//! g are computed; the minimum of a quadratic moves by no more than its perturbation at either minimiser. Where the
//! scaled normal equations are nearly singular nothing is claimed and orthogonalisation decides.

mod null;
mod solve;
mod sums;

use super::exact::Problem;
use super::pool::{Entry, FeedbackPool, MOST_CONTROLS, Row};
use null::{inner, null_and_inverse, over, small};
use num_complex::Complex64;
use sums::{Shape, Sums};

/// Candidates evaluated at once.
pub(super) const LANES: usize = 8;

type V = [f64; LANES];
type Small = [Complex64; MOST_CONTROLS];

const ZERO: Complex64 = Complex64::new(0.0, 0.0);

/// A pivot of the normal equations, scaled to unit diagonal, below which they prove nothing.
const SMALLEST_PIVOT: f64 = 1e-9;

/// A line with the upper rows fixed.
#[derive(Debug, Clone)]
struct FixedLine {
    /// By term (the constant one first, then by coefficient): its share of g, then of f.
    terms: Vec<(Complex64, Small)>,
    /// By term: its share of the last row of Dfb or Nfb: the column and the (turned) power of z.
    power: Vec<Complex64>,
    /// `ñ* T` turned, by command.
    h: Vec<Complex64>,
    /// Upper rows of Nfb, turned.
    numerator: Vec<Vec<Complex64>>,
    /// Upper rows of Dfb.
    denominator: Vec<Small>,
    /// Moduli before cancellation: of g, of τ over all commands, of y times the largest basis function.
    s_g: f64,
    s_tau: f64,
    s_y: f64,
}

/// All lines with the upper rows fixed, and the fixed bracket's normal equations.
#[derive(Debug, Clone)]
pub(super) struct Fixed<'a> {
    problem: &'a Problem,
    last: &'a Row,
    lines: Vec<FixedLine>,
    sums: Sums<f64>,
    rounding: f64,
}

/// What the screening says about a batch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Screened {
    /// Approximate costs; +∞ where the normal equations say nothing.
    pub cost: V,
    /// How far they may be off; +∞ there.
    pub error: V,
}

/// Scratch of one thread.
#[derive(Debug, Clone)]
pub(super) struct Scratch {
    sums: Sums<V>,
    matrix: Vec<V>,
    scale: Vec<V>,
    inverse: Vec<V>,
    x: Vec<V>,
    y: Vec<(V, V)>,
    f: Vec<(V, V)>,
    tau: Vec<(V, V)>,
}

impl<'a> Fixed<'a> {
    /// With the upper rows at these coefficients; `None` where their part of the loop is singular at a line.
    pub(super) fn new(problem: &'a Problem, pool: &'a FeedbackPool, upper: &[Vec<f64>]) -> Option<Self> {
        let (m, l) = (pool.controls(), pool.fed_back());
        let shape = Shape::of(problem, m, l);
        let last = &pool.rows()[m - 1];
        let mut sums = Sums::new(shape, 0.0);
        let mut condition = 1.0_f64;
        let mut lines = Vec::with_capacity(problem.lines.used.len());
        for (k, line) in problem.lines.used.iter().enumerate() {
            let turn = problem.turn[k];
            let largest = problem.functions[k].iter().map(|v| v.abs()).fold(0.0, f64::max);
            let mut numerator = vec![vec![ZERO; l]; m - 1];
            let mut denominator = vec![[ZERO; MOST_CONTROLS]; m - 1];
            let mut rows = vec![[ZERO; MOST_CONTROLS]; m - 1];
            for i in 0..m - 1 {
                let row = &pool.rows()[i];
                denominator[i][i] = line.z.powu(row.degree as u32);
                for (coefficient, value) in row.coefficients.iter().zip(&upper[i]) {
                    let term = line.z.powu(coefficient.power as u32) * value;
                    match coefficient.of {
                        Entry::Numerator(j) => numerator[i][j] += term,
                        Entry::Denominator(j) => denominator[i][j] += term,
                    }
                }
                let mut e = denominator[i];
                for (c, e) in e.iter_mut().enumerate().take(m) {
                    *e += (0..l).map(|j| numerator[i][j] * line.fed_back[(j, c)]).sum::<Complex64>();
                }
                rows[i] = over(&e, &line.root);
            }
            let (null, inverse, own) = null_and_inverse(&rows, m)?;
            let root_condition = (0..m).map(|i| line.root[(i, i)].norm()).fold(0.0, f64::max)
                / (0..m).map(|i| line.root[(i, i)].norm()).fold(f64::INFINITY, f64::min);
            condition = condition.max(own * root_condition * m as f64);
            for row in &mut numerator {
                row.iter_mut().for_each(|v| *v *= turn);
            }

            // Terms of the last row: the constant one, then by coefficient.
            let term = |of: Entry, power: usize| {
                let power = line.z.powu(power as u32);
                let mut e = [ZERO; MOST_CONTROLS];
                match of {
                    Entry::Denominator(j) => e[j] = power,
                    Entry::Numerator(j) => (0..m).for_each(|c| e[c] = power * line.fed_back[(j, c)]),
                }
                let e = over(&e, &line.root);
                let g = e.iter().zip(&null).map(|(a, b)| a * b).sum::<Complex64>();
                let mut f = [ZERO; MOST_CONTROLS];
                for (f, column) in f.iter_mut().zip(&inverse) {
                    *f = e.iter().zip(column).map(|(a, b)| a * b).sum();
                }
                ((g, f), if matches!(of, Entry::Numerator(_)) { power * turn } else { power })
            };
            let (mut terms, mut power) = (Vec::new(), Vec::new());
            let constant = [(Entry::Denominator(m - 1), last.degree)];
            for (of, degree) in constant.into_iter().chain(last.coefficients.iter().map(|c| (c.of, c.power))) {
                let (term, own) = term(of, degree);
                terms.push(term);
                power.push(own);
            }

            // The fixed bracket.
            let target: Vec<Small> = (0..l).map(|j| small((0..m).map(|i| line.target[(i, j)] * turn))).collect();
            let h: Vec<Complex64> = target.iter().map(|t| inner(&null[..m], &t[..m])).collect();
            let mut y = [[ZERO; MOST_CONTROLS]; MOST_CONTROLS];
            for (column, row) in inverse.iter().zip(&denominator) {
                for i in 0..m {
                    for c in 0..m {
                        y[i][c] += column[i] * row[c];
                    }
                }
            }
            for (i, y) in y.iter().enumerate().take(m) {
                let mut tau = Vec::with_capacity(l);
                let mut moduli = 0.0;
                for j in 0..l {
                    let direct: Complex64 =
                        inverse.iter().zip(&numerator).map(|(column, row)| column[i] * row[j]).sum();
                    tau.push(target[j][i] - null[i] * h[j] - direct);
                    let sizes: f64 =
                        inverse.iter().zip(&numerator).map(|(column, row)| column[i].norm() * row[j].norm()).sum();
                    moduli += (target[j][i].norm() + null[i].norm() * h[j].norm() + sizes).powi(2);
                }
                if m > 1 {
                    sums.add_scalar(shape, problem, k, &y[..m], &tau);
                    sums.c += moduli;
                    let size: f64 = inverse
                        .iter()
                        .zip(&denominator)
                        .map(|(column, row)| column[i].norm() * row[..m].iter().map(|v| v.norm()).sum::<f64>())
                        .sum();
                    sums.b += (size * largest).powi(2);
                }
            }

            // Moduli over the values that the coefficients may take.
            let reach: Vec<f64> = std::iter::once(1.0)
                .chain(last.coefficients.iter().map(|c| c.values.iter().fold(0.0, |r: f64, v| r.max(v.abs()))))
                .collect();
            let s_g: f64 = terms.iter().zip(&reach).map(|((g, _), r)| g.norm() * r).sum();
            let s_f: Vec<f64> =
                (0..m - 1).map(|i| terms.iter().zip(&reach).map(|((_, f), r)| f[i].norm() * r).sum()).collect();
            let mut own_row = vec![0.0; l];
            let mut own_denominator = 1.0;
            for (coefficient, r) in last.coefficients.iter().zip(&reach[1..]) {
                match coefficient.of {
                    Entry::Numerator(j) => own_row[j] += r,
                    Entry::Denominator(_) => own_denominator += r,
                }
            }
            let s_tau = (0..l)
                .map(|j| {
                    let upper: f64 = s_f.iter().zip(&numerator).map(|(s, row)| s * row[j].norm()).sum();
                    (h[j].norm() * s_g + own_row[j] + upper).powi(2)
                })
                .sum::<f64>();
            let upper: f64 =
                s_f.iter().zip(&denominator).map(|(s, row)| s * row[..m].iter().map(|v| v.norm()).sum::<f64>()).sum();
            let s_y = ((own_denominator + upper) * largest).powi(2);
            lines.push(FixedLine { terms, power, h, numerator, denominator, s_g, s_tau, s_y });
        }
        let rounding = 4.0 * condition * (problem.lines.used.len() + problem.unknowns(m) + 32) as f64 * f64::EPSILON;
        Some(Self { problem, last, lines, sums, rounding })
    }

    fn shape(&self) -> Shape {
        let controls = self.lines.first().map_or(1, |line| line.denominator.len() + 1);
        Shape::of(self.problem, controls, self.lines.first().map_or(1, |line| line.h.len()))
    }

    pub(super) fn scratch(&self) -> Scratch {
        let shape = self.shape();
        let p = shape.controls * shape.size();
        let pair = ([0.0; LANES], [0.0; LANES]);
        Scratch {
            sums: Sums::new(shape, [0.0; LANES]),
            matrix: vec![[0.0; LANES]; p * p],
            scale: vec![[0.0; LANES]; p],
            inverse: vec![[0.0; LANES]; p],
            x: vec![[0.0; LANES]; p * shape.commands],
            y: vec![pair; shape.controls],
            f: vec![pair; shape.controls],
            tau: vec![pair; shape.commands],
        }
    }

    /// Approximate costs of candidates with these coefficients of the last row, coefficient by coefficient.
    // Indices run over several arrays at once.
    #[allow(clippy::needless_range_loop)]
    #[inline(always)]
    pub(super) fn screen(&self, coefficients: &[V], scratch: &mut Scratch) -> Screened {
        let shape = self.shape();
        let Shape { controls: m, commands: l, even, odd } = shape;
        scratch.sums.start(&self.sums);
        for (k, line) in self.lines.iter().enumerate() {
            // g and f, affine in the coefficients.
            let (g0, f0) = &line.terms[0];
            let (mut g_re, mut g_im) = ([g0.re; LANES], [g0.im; LANES]);
            for i in 0..m - 1 {
                scratch.f[i] = ([f0[i].re; LANES], [f0[i].im; LANES]);
            }
            for (x, (g, f)) in coefficients.iter().zip(&line.terms[1..]) {
                add(&mut g_re, x, g.re);
                add(&mut g_im, x, g.im);
                for i in 0..m - 1 {
                    add(&mut scratch.f[i].0, x, f[i].re);
                    add(&mut scratch.f[i].1, x, f[i].im);
                }
            }
            let mut weight = [0.0; LANES];
            for n in 0..LANES {
                weight[n] = 1.0 / (g_re[n] * g_re[n] + g_im[n] * g_im[n]);
            }
            // y = [−f, 1] Dfb and −τ = [−f, 1] Nfb − h g.
            for y in &mut scratch.y {
                *y = ([0.0; LANES], [0.0; LANES]);
            }
            for j in 0..l {
                let h = line.h[j];
                let tau = &mut scratch.tau[j];
                for n in 0..LANES {
                    tau.0[n] = h.re * g_re[n] - h.im * g_im[n];
                    tau.1[n] = h.re * g_im[n] + h.im * g_re[n];
                }
            }
            let base = line.power[0];
            scratch.y[m - 1] = ([base.re; LANES], [base.im; LANES]);
            for ((x, power), coefficient) in coefficients.iter().zip(&line.power[1..]).zip(&self.last.coefficients) {
                match coefficient.of {
                    Entry::Denominator(c) => {
                        add(&mut scratch.y[c].0, x, power.re);
                        add(&mut scratch.y[c].1, x, power.im);
                    }
                    Entry::Numerator(j) => {
                        add(&mut scratch.tau[j].0, x, -power.re);
                        add(&mut scratch.tau[j].1, x, -power.im);
                    }
                }
            }
            for i in 0..m - 1 {
                let f = scratch.f[i];
                for c in 0..m {
                    let d = line.denominator[i][c];
                    if d != ZERO {
                        add_product(&mut scratch.y[c], &f, -d);
                    }
                }
                for j in 0..l {
                    add_product(&mut scratch.tau[j], &f, line.numerator[i][j]);
                }
            }
            // Sums.
            let functions = &self.problem.functions[k];
            let mut at = 0;
            for i in 0..m {
                for other in i..m {
                    let (a, b) = (scratch.y[i], scratch.y[other]);
                    let (mut s, mut t) = ([0.0; LANES], [0.0; LANES]);
                    for n in 0..LANES {
                        s[n] = weight[n] * (a.0[n] * b.0[n] + a.1[n] * b.1[n]);
                        t[n] = weight[n] * (a.0[n] * b.1[n] - a.1[n] * b.0[n]);
                    }
                    for range in [0..even, even..even + odd] {
                        for u in range.clone() {
                            for v in u..range.end {
                                add(&mut scratch.sums.gram[at], &s, functions[u] * functions[v]);
                                at += 1;
                            }
                        }
                    }
                    if other > i {
                        for u in 0..even {
                            for v in even..even + odd {
                                add(&mut scratch.sums.gram[at], &t, functions[u] * functions[v]);
                                at += 1;
                            }
                        }
                    }
                }
            }
            let mut at = 0;
            for j in 0..l {
                let tau = &scratch.tau[j];
                let (mut re, mut im) = ([0.0; LANES], [0.0; LANES]);
                let square = &mut scratch.sums.square[j];
                for n in 0..LANES {
                    re[n] = weight[n] * tau.0[n];
                    im[n] = weight[n] * tau.1[n];
                    square[n] += re[n] * tau.0[n] + im[n] * tau.1[n];
                }
                for i in 0..m {
                    let y = &scratch.y[i];
                    let (mut u, mut v) = ([0.0; LANES], [0.0; LANES]);
                    for n in 0..LANES {
                        u[n] = y.0[n] * re[n] + y.1[n] * im[n];
                        v[n] = y.0[n] * im[n] - y.1[n] * re[n];
                    }
                    for a in 0..even {
                        add(&mut scratch.sums.right[at], &u, functions[a]);
                        at += 1;
                    }
                    for a in even..even + odd {
                        add(&mut scratch.sums.right[at], &v, functions[a]);
                        at += 1;
                    }
                }
            }
            add(&mut scratch.sums.c, &weight, line.s_tau);
            add(&mut scratch.sums.b, &weight, line.s_y);
            for n in 0..LANES {
                scratch.sums.sigma[n] = scratch.sums.sigma[n].max(weight[n] * line.s_g * line.s_g);
            }
        }
        self.solve(shape, scratch)
    }
}

#[inline(always)]
fn add(to: &mut V, x: &V, factor: f64) {
    for n in 0..LANES {
        to[n] += x[n] * factor;
    }
}

#[inline(always)]
fn add_product(to: &mut (V, V), x: &(V, V), factor: Complex64) {
    for n in 0..LANES {
        to.0[n] += x.0[n] * factor.re - x.1[n] * factor.im;
        to.1[n] += x.0[n] * factor.im + x.1[n] * factor.re;
    }
}

#[cfg(test)]
mod tests;
