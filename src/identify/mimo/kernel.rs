//! The fast evaluation of many candidates that share all rows but the last one.
//!
//! With `E = Dfb + Nfb Gv` and `X = Nfb + Dfb Gff` the weighted residual at a line is `R E⁻¹ X − T` (R, T: [`Line`](super::lines::Line)). Let the upper
//! rows E_u of E be fixed, ñ the unit null vector of `E_u R⁻¹` and P̃ its pseudo-inverse. With the last row e of E and
//! `g = e R⁻¹ ñ`, `f = e R⁻¹ P̃`
//!
//! `R E⁻¹ X − T = [P̃ X_u − (I − ñ ñ*) T] + ñ [(x − f X_u)/g − ñ* T]`, the two brackets being orthogonal.
//!
//! The first does not depend on the last row; the second is one weighted equation `(y Gff − τ)/g` per command, with
//! `y = [−f, 1] Dfb` and `τ = ñ* T g − [−f, 1] Nfb`. Since g and f are affine in the last row's coefficients, a candidate costs a few
//! products per line, and the normal equations in the orthonormal basis follow from weighted sums of `y* y` and `y* τ`.
//!
//! # Bound
//! A sum of N terms errs by γ = (N + p + 32) ε of the sum of the moduli of what it is made of. Let C be `Σ S_τ²/|g|²` with S_τ the sum of the
//! moduli of the terms of τ before they cancel, B the same for `y` times the largest basis function, both with the share of the fixed
//! bracket. J then errs by at most `4γ κ (1 + σ) Σ_j (√C + √B ‖x_j‖₁)²`, where `σ = max S_g/|g|` is the cancellation in g and κ the condition of R and
//! of the fixed rows, through which f and g are computed; the minimum of a quadratic moves by no more than its perturbation at
//! either minimiser. Where the scaled normal equations are nearly singular nothing is claimed and orthogonalisation decides.

use super::exact::Problem;
use super::pool::{Entry, FeedbackPool, MOST_CONTROLS, Row};
use nalgebra::DMatrix;
use num_complex::Complex64;

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

/// Normal equations, packed; see [`Shape`].
#[derive(Debug, Clone)]
struct Sums<T> {
    gram: Vec<T>,
    right: Vec<T>,
    square: Vec<T>,
    c: T,
    b: T,
    sigma: T,
}

/// Sizes of the packed normal equations.
#[derive(Debug, Clone, Copy)]
struct Shape {
    controls: usize,
    commands: usize,
    even: usize,
    odd: usize,
}

impl Shape {
    fn of(problem: &Problem, pool_controls: usize, commands: usize) -> Self {
        Self { controls: pool_controls, commands, even: problem.even(), odd: problem.basis.odd().len() }
    }

    /// Numbers of the packed Gram matrix: for every pair i ≤ i' of controls the triangles even·even and odd·odd, and even·odd where i < i'.
    fn gram(self) -> usize {
        let (e, o, m) = (self.even, self.odd, self.controls);
        let triangles = e * (e + 1) / 2 + o * (o + 1) / 2;
        m * (m + 1) / 2 * triangles + m * (m - 1) / 2 * e * o
    }

    fn size(self) -> usize {
        self.even + self.odd
    }

    fn right(self) -> usize {
        self.controls * self.size() * self.commands
    }
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
    x: Vec<V>,
    y: Vec<(V, V)>,
    f: Vec<(V, V)>,
    tau: Vec<(V, V)>,
}

fn norm(row: &[Complex64]) -> f64 {
    row.iter().map(|v| v.norm_sqr()).sum::<f64>().sqrt()
}

fn inner(a: &[Complex64], b: &[Complex64]) -> Complex64 {
    a.iter().zip(b).map(|(x, y)| x.conj() * y).sum()
}

/// Null vector and pseudo-inverse (columns) of a wide matrix with m − 1 rows, and its condition number's bound; by Gram and Schmidt,
/// twice. `None` where its rows are dependent.
fn null_and_inverse(rows: &[Small], m: usize) -> Option<(Small, Vec<Small>, f64)> {
    // F* = Q L* with orthonormal Q, so that F⁺ = Q (L*)⁻* and ñ is orthogonal to Q.
    let n = rows.len();
    let mut q = [[ZERO; MOST_CONTROLS]; MOST_CONTROLS];
    let mut l = [[ZERO; MOST_CONTROLS]; MOST_CONTROLS];
    let mut condition = 1.0_f64;
    for i in 0..n {
        let mut v: Small = rows[i].map(|c| c.conj());
        let size = norm(&v[..m]);
        for _ in 0..2 {
            for k in 0..i {
                let share = inner(&q[k][..m], &v[..m]);
                l[i][k] += share.conj();
                for c in 0..m {
                    v[c] -= share * q[k][c];
                }
            }
        }
        let length = norm(&v[..m]);
        if length <= 1e-14 * size || !length.is_normal() {
            return None;
        }
        l[i][i] = Complex64::new(length, 0.0);
        condition *= size / length;
        q[i] = v.map(|c| c / length);
    }
    // The unit vector that keeps most of itself beside Q.
    let keeps = |c: usize| 1.0 - (0..n).map(|k| q[k][c].norm_sqr()).sum::<f64>();
    let best = (0..m).max_by(|a, b| keeps(*a).total_cmp(&keeps(*b)))?;
    let mut null = [ZERO; MOST_CONTROLS];
    null[best] = Complex64::new(1.0, 0.0);
    for _ in 0..2 {
        for row in q.iter().take(n) {
            let share = inner(&row[..m], &null[..m]);
            for c in 0..m {
                null[c] -= share * row[c];
            }
        }
        let length = norm(&null[..m]);
        null = null.map(|c| c / length);
    }
    // Column j of F⁺ is Q w with L w = e_j (F = L Q*).
    let inverse = (0..n)
        .map(|j| {
            let mut w = [ZERO; MOST_CONTROLS];
            for i in j..n {
                let known: Complex64 = (j..i).map(|k| l[i][k] * w[k]).sum();
                w[i] = (if i == j { Complex64::new(1.0, 0.0) } else { ZERO } - known) / l[i][i];
            }
            let mut column = [ZERO; MOST_CONTROLS];
            for (k, row) in q.iter().enumerate().take(n) {
                for c in 0..m {
                    column[c] += row[c] * w[k];
                }
            }
            column
        })
        .collect();
    Some((null, inverse, condition))
}

/// A row times the inverse of an upper triangular matrix.
fn over(row: &Small, root: &DMatrix<Complex64>) -> Small {
    let m = root.ncols();
    let mut x = [ZERO; MOST_CONTROLS];
    for c in 0..m {
        let known: Complex64 = (0..c).map(|k| x[k] * root[(k, c)]).sum();
        x[c] = (row[c] - known) / root[(c, c)];
    }
    x
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

    #[allow(clippy::needless_range_loop)]
    #[inline(always)]
    fn solve(&self, shape: Shape, scratch: &mut Scratch) -> Screened {
        let p = shape.controls * shape.size();
        let Scratch { sums, matrix, scale, x, .. } = scratch;
        shape.unpack(&sums.gram, matrix);
        // Scaled to unit diagonal: S G S with S = diag(G)^−½, kept in the diagonal until the end.
        let mut is_sound = [true; LANES];
        for i in 0..p {
            for n in 0..LANES {
                scale[i][n] = 1.0 / matrix[i * p + i][n].sqrt();
                is_sound[n] &= scale[i][n].is_finite();
            }
        }
        for i in 0..p {
            for j in 0..i {
                for n in 0..LANES {
                    matrix[i * p + j][n] *= scale[i][n] * scale[j][n];
                }
            }
            matrix[i * p + i] = [1.0; LANES];
        }
        // L D Lᵀ, the pivots in the diagonal.
        for i in 0..p {
            for j in 0..i {
                let mut sum = matrix[i * p + j];
                for k in 0..j {
                    let (a, b) = (matrix[i * p + k], matrix[j * p + k]);
                    for n in 0..LANES {
                        sum[n] -= a[n] * b[n];
                    }
                }
                matrix[i * p + j] = sum;
            }
            // Row i holds L D so far; divide, and take off the pivot.
            let mut pivot = matrix[i * p + i];
            for j in 0..i {
                let (entry, d) = (matrix[i * p + j], matrix[j * p + j]);
                let mut l = [0.0; LANES];
                for n in 0..LANES {
                    l[n] = entry[n] / d[n];
                    pivot[n] -= l[n] * entry[n];
                }
                matrix[i * p + j] = l;
            }
            for n in 0..LANES {
                is_sound[n] &= pivot[n] > SMALLEST_PIVOT;
            }
            matrix[i * p + i] = pivot;
        }
        let mut cost = [self.problem.lines.unreachable; LANES];
        let mut error = [0.0; LANES];
        let mut width = [0.0; LANES];
        for n in 0..LANES {
            width[n] = sums.b[n].sqrt();
        }
        for j in 0..shape.commands {
            let x = &mut x[j * p..(j + 1) * p];
            for n in 0..LANES {
                cost[n] += sums.square[j][n];
            }
            for i in 0..p {
                let mut sum = sums.right[j * p + i];
                for n in 0..LANES {
                    sum[n] *= scale[i][n];
                }
                for k in 0..i {
                    let l = matrix[i * p + k];
                    for n in 0..LANES {
                        sum[n] -= l[n] * x[k][n];
                    }
                }
                x[i] = sum;
            }
            for i in 0..p {
                let d = matrix[i * p + i];
                for n in 0..LANES {
                    let quotient = x[i][n] / d[n];
                    cost[n] -= x[i][n] * quotient;
                    x[i][n] = quotient;
                }
            }
            let mut length = [0.0; LANES];
            for i in (0..p).rev() {
                let mut sum = x[i];
                for k in i + 1..p {
                    let l = matrix[k * p + i];
                    for n in 0..LANES {
                        sum[n] -= l[n] * x[k][n];
                    }
                }
                x[i] = sum;
                for n in 0..LANES {
                    length[n] += (sum[n] * scale[i][n]).abs();
                }
            }
            for n in 0..LANES {
                let part = sums.c[n].sqrt() + width[n] * length[n];
                error[n] += part * part;
            }
        }
        for n in 0..LANES {
            error[n] *= self.rounding * (1.0 + sums.sigma[n].sqrt());
            is_sound[n] &= cost[n].is_finite() && error[n].is_finite();
            if !is_sound[n] {
                (cost[n], error[n]) = (f64::INFINITY, f64::INFINITY);
            }
        }
        Screened { cost, error }
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

fn small(values: impl Iterator<Item = Complex64>) -> Small {
    let mut small = [ZERO; MOST_CONTROLS];
    for (to, value) in small.iter_mut().zip(values) {
        *to = value;
    }
    small
}

impl<T: Copy> Sums<T> {
    fn new(shape: Shape, zero: T) -> Self {
        Self {
            gram: vec![zero; shape.gram()],
            right: vec![zero; shape.right()],
            square: vec![zero; shape.commands],
            c: zero,
            b: zero,
            sigma: zero,
        }
    }
}

impl Sums<V> {
    #[inline(always)]
    fn start(&mut self, from: &Sums<f64>) {
        let fill = |to: &mut [V], from: &[f64]| to.iter_mut().zip(from).for_each(|(t, f)| *t = [*f; LANES]);
        fill(&mut self.gram, &from.gram);
        fill(&mut self.right, &from.right);
        fill(&mut self.square, &from.square);
        (self.c, self.b, self.sigma) = ([from.c; LANES], [from.b; LANES], [0.0; LANES]);
    }
}

impl Sums<f64> {
    /// One equation `y Gff − τ` per command at a line, in the same order as the batches.
    fn add_scalar(&mut self, shape: Shape, problem: &Problem, line: usize, y: &[Complex64], tau: &[Complex64]) {
        let (even, all) = (shape.even, shape.size());
        let functions = &problem.functions[line];
        let mut at = 0;
        for i in 0..shape.controls {
            for other in i..shape.controls {
                let product = y[i].conj() * y[other];
                for range in [0..even, even..all] {
                    for u in range.clone() {
                        for v in u..range.end {
                            self.gram[at] += product.re * functions[u] * functions[v];
                            at += 1;
                        }
                    }
                }
                if other > i {
                    for u in 0..even {
                        for v in even..all {
                            self.gram[at] += product.im * functions[u] * functions[v];
                            at += 1;
                        }
                    }
                }
            }
        }
        let mut at = 0;
        for (j, tau) in tau.iter().enumerate() {
            self.square[j] += tau.norm_sqr();
            for y in y.iter().take(shape.controls) {
                let product = y.conj() * tau;
                for (a, f) in functions.iter().enumerate() {
                    self.right[at] += f * if a < even { product.re } else { product.im };
                    at += 1;
                }
            }
        }
    }
}

impl Shape {
    /// The lower triangle of the full Gram matrix, row by row. With `s + jt = Σ w y_i* y_i'` the entry of a real function of i and an
    /// imaginary one of i' is −t, the other way round +t.
    #[inline(always)]
    fn unpack(self, packed: &[V], full: &mut [V]) {
        let (even, all) = (self.even, self.size());
        let p = self.controls * all;
        let mut at = 0;
        for i in 0..self.controls {
            for other in i..self.controls {
                for range in [0..even, even..all] {
                    for u in range.clone() {
                        for v in u..range.end {
                            full[(other * all + v) * p + i * all + u] = packed[at];
                            full[(other * all + u) * p + i * all + v] = packed[at];
                            at += 1;
                        }
                    }
                }
                if other > i {
                    for u in 0..even {
                        for v in even..all {
                            let value = packed[at];
                            full[(other * all + v) * p + i * all + u] = value.map(|x| -x);
                            full[(other * all + u) * p + i * all + v] = value;
                            at += 1;
                        }
                    }
                } else {
                    for u in 0..even {
                        for v in even..all {
                            full[(i * all + v) * p + i * all + u] = [0.0; LANES];
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Discrete, Multivariable, StateSpace};
    use crate::identify::mimo::lines::{Lines, MatrixFrequencyData};
    use crate::identify::mimo::stability::Tester;
    use crate::num::rng::stream;
    use rand::RngExt;

    /// The screened cost of every stable candidate lies within its bound of the cost by orthogonalisation, and the bound is tight
    /// enough to be of use; data and plants of many sizes, scales and conditions.
    #[test]
    fn the_screened_cost_errs_by_less_than_its_bound() {
        let (mut candidates, mut loose, mut widths) = (0, 0, Vec::new());
        for seed in 0..60 {
            let mut random = stream(seed, "mimo bound");
            let (m, l) = (random.random_range(1..=MOST_CONTROLS), random.random_range(1..4_usize));
            let states = random.random_range(m..m + 3);
            let outputs = m.max(l);
            let scale = 10.0_f64.powf(random.random_range(-3.0..3.0));
            let mut matrix = |rows: usize, columns: usize, size: f64| {
                DMatrix::from_fn(rows, columns, |_, _| size * random.random_range(-1.0..1.0))
            };
            let time = Discrete::new(0.1).unwrap();
            let model = StateSpace::new(
                matrix(states, states, 0.9),
                matrix(states, m, scale),
                matrix(outputs, states, 1.0),
                DMatrix::zeros(outputs, m),
                time,
            );
            let plant = Multivariable::StateSpace(model.unwrap());
            let axis = |random: &mut crate::num::rng::Stream| {
                let centre = random.random_range(-0.5..0.5) / scale;
                serde_json::json!([centre, centre + 0.4 / scale])
            };
            let numerator: Vec<Vec<_>> = (0..m)
                .map(|i| {
                    (0..l)
                        .map(|_| {
                            serde_json::json!([if i + 1 == m {
                                axis(&mut random)
                            } else {
                                serde_json::json!([0.1 / scale])
                            }])
                        })
                        .collect()
                })
                .collect();
            let numerator = serde_json::from_value(serde_json::json!(numerator)).unwrap();
            let pool = FeedbackPool::new(&numerator, None, 0.0, "").unwrap();
            let omega: Vec<f64> = (0..25).map(|k| 0.3 + f64::from(k)).collect();
            let noise = 10.0_f64.powf(random.random_range(-12.0..0.0));
            let h = omega
                .iter()
                .map(|_| {
                    DMatrix::from_fn(outputs, l, |_, _| {
                        Complex64::new(1.0 + noise * random.random_range(-1.0..1.0), noise)
                    })
                })
                .collect();
            let data = MatrixFrequencyData { omega_rad_s: omega, h, variance: None };
            let measured: Vec<usize> = (0..outputs).collect();
            let fed_back: Vec<usize> = (0..l).collect();
            let lines = Lines::new(&plant, &measured, &fed_back, &data, None);
            let problem = Problem::new(lines, random.random_range(0..6), time).unwrap();
            let tester = Tester::new(&pool, &plant, &fed_back);
            let all = pool.candidate(0);
            let (upper, _) = all.split_at(m - 1);
            let mut of_last = tester.last_row(upper);
            let fixed = Fixed::new(&problem, &pool, upper).unwrap();
            let mut scratch = fixed.scratch();
            for index in 0..pool.listed() as u64 {
                let coefficients = pool.candidate(index);
                if !of_last.is_stable(&coefficients[m - 1]) {
                    continue;
                }
                let lanes: Vec<V> = coefficients[m - 1].iter().map(|c| [*c; LANES]).collect();
                let screened = fixed.screen(&lanes, &mut scratch);
                let fit = problem.fit(&pool, &coefficients).unwrap();
                candidates += 1;
                if screened.error[0].is_infinite() {
                    loose += 1;
                    continue;
                }
                let off = (screened.cost[0] - fit.cost).abs();
                assert!(off <= screened.error[0], "seed {seed}, candidate {index}: {off} {}", screened.error[0]);
                let size: f64 = data.h.iter().flatten().map(|v| v.norm_sqr()).sum();
                widths.push(screened.error[0] / size);
            }
        }
        assert!(candidates > 100 && loose * 5 < candidates, "{loose} of {candidates}");
        widths.sort_by(f64::total_cmp);
        let at = |share: f64| widths[(share * widths.len() as f64) as usize];
        assert!(at(0.5) < 1e-8 && at(0.9) < 1e-4, "{} {}", at(0.5), at(0.9));
    }
}
