//! The fast evaluation of many candidates: normal equations in the orthonormal half-bases, several candidates per
//! instruction.
//!
//! # Bound
//! For a candidate with weights W and target Y at the lines, let Ĝ be one half's Gram matrix scaled to unit diagonal,
//! and `C = Σ w (|H/G| + |(H−1) Gfb|)² ≥ Σ W |Y|²`, which bounds what cancellation in `T = H/G + (H−1) Gfb` can do.
//! Sums of N terms are computed with relative error at most γ = (N + 16) ε of the sum of their moduli, so entries of Ĝ
//! err by γ at most, those of its right-hand side by γ√C, and the Cholesky factorisation adds as much again. The
//! minimum of a quadratic moves by no more than its perturbation at either minimiser, so J errs by at most
//! `2γ (√C + ‖x‖₁)² ≤ 4γ C (1 + p tr Ĝ⁻¹)` with p unknowns, because `‖x‖₁² ≤ p ‖x‖₂² ≤ p C / λ_min` and
//! `1/λ_min ≤ tr Ĝ⁻¹`. Cancellation in `1 + G Gfb` multiplies the relative error of a weight by
//! `σ = (1 + |G Gfb|)/|1 + G Gfb|`, hence a factor `1 + max σ`. The factor below is 16 instead of 4, which also covers
//! the rounding of the QR that decides. Where `p tr Ĝ⁻¹` is large, nothing is claimed (the bound is −∞) and QR decides.

use crate::identify::pool::factor::Factor;
use crate::identify::problem::Problem;
use crate::identify::search::simd::dispatch::{Halves, dispatch_halves};
use crate::identify::search::simd::lanes::Packed;
use crate::identify::search::simd::ldl::{Above, Half};
use num_complex::Complex64;
use pulp::{Simd, WithSimd};

/// Beyond this trace of the inverse of the scaled Gram matrix the normal equations prove nothing.
const WORST_TRACE: f64 = 1e11;

/// A screened batch: for each candidate its approximate cost and a lower bound of its exact cost.
#[derive(Debug, Default)]
pub(super) struct Screened {
    /// Approximate costs; +∞ where the normal equations say nothing.
    pub cost: Vec<f64>,
    /// Lower bounds; −∞ there.
    pub bound: Vec<f64>,
}

impl Screened {
    fn resize(&mut self, length: usize) {
        self.cost.resize(length, 0.0);
        self.bound.resize(length, 0.0);
    }
}

/// The half-bases at the lines, laid out for the kernel: per line the products of the Gram matrices' upper triangles
/// (row by row), then the functions themselves; the real part first.
#[derive(Debug)]
pub(super) struct Layout {
    even: usize,
    odd: usize,
    /// `even (even+1)/2 + odd (odd+1)/2 + even + odd` numbers per line; one where there is no numerator.
    table: Vec<f64>,
    /// `16 γ`.
    rounding: f64,
}

impl Layout {
    pub(super) fn new(problem: &Problem) -> Self {
        let (even, odd) = (problem.basis().even(), problem.basis().odd());
        let lines = problem.lines().len();
        let mut table = Vec::new();
        for k in 0..lines {
            for part in [even, odd] {
                for i in 0..part.len() {
                    for j in i..part.len() {
                        table.push(part.values[i][k] * part.values[j][k]);
                    }
                }
            }
            for part in [even, odd] {
                table.extend(part.values.iter().map(|v| v[k]));
            }
            if problem.basis().is_none() {
                // A place for each line, of which nothing is read.
                table.push(0.0);
            }
        }
        let rounding = 16.0 * (lines + 16) as f64 * f64::EPSILON;
        Self { even: even.len(), odd: odd.len(), table, rounding }
    }
}

type Lane<S> = Packed<S, f64>;

/// The sums of one half, for several candidates: its normal equations, by the lower triangle.
#[derive(Clone, Copy)]
struct Sums<V, const N: usize> {
    half: Half<V, N>,
    right: [V; N],
}

// Indices below run over the rows and columns of several arrays at once.
#[allow(clippy::needless_range_loop)]
impl<S: Simd, const N: usize> Sums<Lane<S>, N> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zero = Packed::of(simd, 0.0);
        Self { half: Half::new(zero), right: [zero; N] }
    }

    /// `products` are the basis products of the line, `functions` the basis functions.
    #[inline(always)]
    fn add(&mut self, simd: S, n: usize, weight: S::f64s, target: S::f64s, products: &[f64], functions: &[f64]) {
        let (weight, target) = (Packed::new(simd, weight), Packed::new(simd, target));
        let mut p = 0;
        for i in 0..n {
            for j in i..n {
                let sum = &mut self.half.gram[j][i];
                *sum = weight.times_plus(Packed::of(simd, products[p]), *sum);
                p += 1;
            }
            self.right[i] = target.times_plus(Packed::of(simd, functions[i]), self.right[i]);
        }
    }

    /// What the best combination takes off the cost, and the trace of the inverse of the scaled Gram matrix; that is
    /// infinite or not a number where the matrix is not positive definite in working precision.
    #[inline(always)]
    fn solve(&mut self, simd: S, n: usize) -> (Lane<S>, Lane<S>) {
        let Self { half, right } = self;
        let zero = Packed::of(simd, 0.0);
        // A pivot that is not positive must not hide in a sum: it makes the trace infinite.
        let mut positive = Above { least: zero, infinity: Packed::of(simd, f64::INFINITY) };
        half.factor(n, Packed::of(simd, 1.0), &mut positive);
        half.forward(n, right);
        let mut gain = zero;
        let mut trace = zero;
        // L⁻¹ below the diagonal. Its squares over the pivots are the diagonal of G⁻¹.
        let mut inverse = [[zero; N]; N];
        for j in 0..n {
            gain = (right[j] * right[j]).times_plus(half.inverse[j], gain);
            for i in 0..j {
                let mut entry = zero;
                for k in i + 1..j {
                    entry = half.gram[j][k].times_from(inverse[k][i], entry);
                }
                inverse[j][i] = entry - half.gram[j][i];
                let scaled = (inverse[j][i] * inverse[j][i]) * half.gram[i][i];
                trace = scaled.times_plus(half.inverse[j], trace);
            }
            trace = half.gram[j][j].times_plus(half.inverse[j], trace);
        }
        (gain, trace)
    }
}

/// Cost and bound from the sums; `rounding` is `16 γ C (1 + max σ)`.
#[inline(always)]
fn finish<S: Simd, const P: usize, const Q: usize>(
    simd: S,
    (p, q): (usize, usize),
    even: &mut Sums<Lane<S>, P>,
    odd: &mut Sums<Lane<S>, Q>,
    total: S::f64s,
    rounding: S::f64s,
) -> (S::f64s, S::f64s) {
    let (even_gain, even_trace) = even.solve(simd, p);
    let (odd_gain, odd_trace) = odd.solve(simd, q);
    let (even_trace, odd_trace) = (even_trace.x, odd_trace.x);
    let cost = simd.sub_f64s(simd.sub_f64s(total, even_gain.x), odd_gain.x);
    let one = simd.splat_f64s(1.0);
    let condition = simd.mul_add_e_f64s(even_trace, simd.splat_f64s(p as f64), one);
    let condition = simd.mul_add_e_f64s(odd_trace, simd.splat_f64s(q as f64), condition);
    let proven = simd.less_than_f64s(condition, simd.splat_f64s(WORST_TRACE));
    let margin = simd.mul_f64s(rounding, condition);
    let bound = simd.sub_f64s(cost, margin);
    // A cost that overflowed proves nothing either.
    let proven = simd.and_m64s(proven, simd.greater_than_f64s(bound, simd.splat_f64s(f64::NEG_INFINITY)));
    (
        simd.select_f64s(proven, cost, simd.splat_f64s(f64::INFINITY)),
        simd.select_f64s(proven, bound, simd.splat_f64s(f64::NEG_INFINITY)),
    )
}

/// The largest half-basis of a numerator of degree 24.
const LARGEST_HALF: usize = 13;

/// One feedback controller at the lines.
#[derive(Debug, Default)]
pub(super) struct FeedbackAtLines {
    /// `w = weight |G/(1 + G Gfb)|²` and `w T`, three numbers per line.
    terms: Vec<f64>,
    /// `Σ w |T|²`.
    total: f64,
    /// `C (1 + max σ)`.
    scale: f64,
}

impl FeedbackAtLines {
    /// Fills in the controller with these values at the lines.
    pub(super) fn set(&mut self, problem: &Problem, feedback: impl Iterator<Item = Complex64>) {
        self.terms.clear();
        self.total = 0.0;
        let (mut moduli, mut worst) = (0.0, 0.0_f64);
        for (line, feedback) in problem.lines().iter().zip(feedback) {
            let loop_gain = line.plant * feedback;
            let closed = 1.0 + loop_gain;
            let weight = line.weight * line.plant.norm_sqr() / closed.norm_sqr();
            let (a, b) = (line.response / line.plant, (line.response - 1.0) * feedback);
            let target = a + b;
            self.terms.extend([weight, weight * target.re, weight * target.im]);
            self.total += weight * target.norm_sqr();
            moduli += weight * 2.0 * (a.norm_sqr() + b.norm_sqr());
            worst = worst.max((1.0 + loop_gain.norm_sqr()) / closed.norm_sqr());
        }
        self.scale = moduli * (1.0 + (2.0 * worst).sqrt());
    }
}

/// The feedforward denominators at the lines, padded with copies of the last to a whole number of vectors.
#[derive(Debug)]
pub(super) struct FeedforwardAtLines {
    count: usize,
    padded: usize,
    /// Per line: `u = 1/|D|²`, then the real part, then the imaginary part of `u D e^{j rotation}`, `padded` numbers
    /// each.
    tables: Vec<f64>,
}

/// Numbers that every vector length divides.
const WIDEST: usize = 8;

impl FeedforwardAtLines {
    pub(super) fn new(problem: &Problem, denominators: &[Factor]) -> Self {
        let count = denominators.len();
        let padded = count.next_multiple_of(WIDEST);
        let lines = problem.lines();
        let mut tables = vec![0.0; 3 * padded * lines.len()];
        for i in 0..padded {
            let denominator = &denominators[i.min(count - 1)];
            for (k, value) in problem.at_lines(&denominator.coefficients).into_iter().enumerate() {
                let rotation = Complex64::from_polar(1.0, problem.basis().rotation(lines[k].omega_rad_s));
                let u = 1.0 / value.norm_sqr();
                let turned = u * value * rotation;
                let start = 3 * padded * k;
                tables[start + i] = u;
                tables[start + padded + i] = turned.re;
                tables[start + 2 * padded + i] = turned.im;
            }
        }
        Self { count, padded, tables }
    }
}

/// Evaluates one feedback controller with every feedforward denominator; the results have the order of the
/// denominators.
pub(super) fn across_feedforward(
    layout: &Layout,
    feedforward: &FeedforwardAtLines,
    feedback: &FeedbackAtLines,
    out: &mut Screened,
) {
    out.resize(feedforward.padded);
    dispatch_halves!(
        [layout.even, layout.odd],
        in [1 0, 1 1, 2 1, 2 2, 3 2, 3 3, 4 3, 4 4, 5 4] else LARGEST_HALF,
        |halves| AcrossFeedforward { halves, layout, feedforward, feedback, out: &mut *out }
    );
    out.resize(feedforward.count);
}

struct AcrossFeedforward<'a, const P: usize, const Q: usize, const KNOWN: bool> {
    halves: Halves<P, Q, KNOWN>,
    layout: &'a Layout,
    feedforward: &'a FeedforwardAtLines,
    feedback: &'a FeedbackAtLines,
    out: &'a mut Screened,
}

impl<const P: usize, const Q: usize, const KNOWN: bool> WithSimd for AcrossFeedforward<'_, P, Q, KNOWN> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { halves, layout, feedforward, feedback, out } = self;
        let (tables, _) = S::as_simd_f64s(&feedforward.tables);
        let (costs, _) = S::as_mut_simd_f64s(&mut out.cost);
        let (bounds, _) = S::as_mut_simd_f64s(&mut out.bound);
        let vectors = costs.len();
        let bounds = &mut bounds[..vectors];
        let total = simd.splat_f64s(feedback.total);
        let rounding = simd.splat_f64s(layout.rounding * feedback.scale);
        let (p, q) = halves.sizes([layout.even, layout.odd]);
        let width = (p * (p + 3) / 2 + q * (q + 3) / 2).max(1);
        let (even_products, odd_products) = (p * (p + 1) / 2, q * (q + 1) / 2);
        for i in 0..vectors {
            let (mut even, mut odd) = (Sums::<Lane<S>, P>::new(simd), Sums::<Lane<S>, Q>::new(simd));
            let lines = layout.table.chunks_exact(width).zip(feedback.terms.chunks_exact(3));
            for ((basis, terms), row) in lines.zip(tables.chunks_exact(3 * vectors)) {
                let (u, re, im) = (row[i], row[vectors + i], row[2 * vectors + i]);
                let weight = simd.mul_f64s(u, simd.splat_f64s(terms[0]));
                let (t_re, t_im) = (simd.splat_f64s(terms[1]), simd.splat_f64s(terms[2]));
                let real = simd.negate_mul_add_e_f64s(t_im, im, simd.mul_f64s(t_re, re));
                let imaginary = simd.mul_add_e_f64s(t_im, re, simd.mul_f64s(t_re, im));
                let (e, rest) = basis.split_at(even_products);
                let (o, functions) = rest.split_at(odd_products);
                even.add(simd, p, weight, real, e, &functions[..p]);
                odd.add(simd, q, weight, imaginary, o, &functions[p..]);
            }
            (costs[i], bounds[i]) = finish(simd, (p, q), &mut even, &mut odd, total, rounding);
        }
    }
}

/// What a line and a feedforward denominator contribute to every feedback controller.
#[derive(Debug)]
pub(super) struct LineConstants {
    /// Per line: Re G, Im G, `weight |G|²/|D|²`, real and imaginary parts of A and B in `Y = A + B Gfb`, `2|A|²`,
    /// `2|B|²`, `|G|²`.
    table: Vec<f64>,
}

impl LineConstants {
    pub(super) fn new(problem: &Problem, denominator: &Factor) -> Self {
        let values = problem.at_lines(&denominator.coefficients);
        let mut table = Vec::new();
        for (line, value) in problem.lines().iter().zip(values) {
            let turned = value * Complex64::from_polar(1.0, problem.basis().rotation(line.omega_rad_s));
            let a = line.response / line.plant * turned;
            let b = (line.response - 1.0) * turned;
            let weight = line.weight * line.plant.norm_sqr() / value.norm_sqr();
            table.extend([line.plant.re, line.plant.im, weight, a.re, a.im, b.re, b.im]);
            table.extend([2.0 * a.norm_sqr(), 2.0 * b.norm_sqr(), line.plant.norm_sqr()]);
        }
        Self { table }
    }
}

/// Feedback controllers at the lines, side by side.
#[derive(Debug)]
pub(super) struct FeedbackBatch {
    /// Room for this many, a multiple of every vector length.
    room: usize,
    /// How many there are.
    pub(super) count: usize,
    /// Per line: real parts, then imaginary parts, `room` numbers each.
    values: Vec<f64>,
}

impl FeedbackBatch {
    pub(super) fn new(lines: usize, room: usize) -> Self {
        assert!(room.is_multiple_of(WIDEST), "room for whole vectors");
        Self { room, count: 0, values: vec![0.0; 2 * room * lines] }
    }

    /// How many more there is room for.
    pub(super) fn free(&self) -> usize {
        self.room - self.count
    }

    /// Adds the controllers `gain · unit`, with the values of `unit` at the lines.
    pub(super) fn push(&mut self, gains: &[f64], unit: &[Complex64]) {
        let (from, to) = (self.count, self.count + gains.len());
        for (row, value) in self.values.chunks_exact_mut(2 * self.room).zip(unit) {
            let (re, im) = row.split_at_mut(self.room);
            for ((re, im), gain) in re[from..to].iter_mut().zip(&mut im[from..to]).zip(gains) {
                *re = gain * value.re;
                *im = gain * value.im;
            }
        }
        self.count = to;
    }
}

/// Evaluates a batch of feedback controllers with one feedforward denominator.
pub(super) fn across_feedback(layout: &Layout, constants: &LineConstants, batch: &FeedbackBatch, out: &mut Screened) {
    out.resize(batch.room);
    dispatch_halves!(
        [layout.even, layout.odd],
        in [0 0, 1 0, 1 1, 2 1, 2 2, 3 2, 3 3, 4 3, 4 4, 5 4] else LARGEST_HALF,
        |halves| AcrossFeedback { halves, layout, constants, batch, out: &mut *out }
    );
    out.resize(batch.count);
}

struct AcrossFeedback<'a, const P: usize, const Q: usize, const KNOWN: bool> {
    halves: Halves<P, Q, KNOWN>,
    layout: &'a Layout,
    constants: &'a LineConstants,
    batch: &'a FeedbackBatch,
    out: &'a mut Screened,
}

impl<const P: usize, const Q: usize, const KNOWN: bool> WithSimd for AcrossFeedback<'_, P, Q, KNOWN> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { halves, layout, constants, batch, out } = self;
        let (values, _) = S::as_simd_f64s(&batch.values);
        let (costs, _) = S::as_mut_simd_f64s(&mut out.cost);
        let (bounds, _) = S::as_mut_simd_f64s(&mut out.bound);
        let vectors = costs.len();
        let bounds = &mut bounds[..vectors];
        let used = batch.count.div_ceil(batch.room / vectors);
        let one = simd.splat_f64s(1.0);
        let (p, q) = halves.sizes([layout.even, layout.odd]);
        let width = (p * (p + 3) / 2 + q * (q + 3) / 2).max(1);
        let (even_products, odd_products) = (p * (p + 1) / 2, q * (q + 1) / 2);
        for i in 0..used {
            let (mut even, mut odd) = (Sums::<Lane<S>, P>::new(simd), Sums::<Lane<S>, Q>::new(simd));
            let mut total = simd.splat_f64s(0.0);
            let mut moduli = simd.splat_f64s(0.0);
            let mut worst = simd.splat_f64s(0.0);
            let lines = layout.table.chunks_exact(width).zip(constants.table.chunks_exact(10));
            for ((basis, line), row) in lines.zip(values.chunks_exact(2 * vectors)) {
                let (re, im) = (row[i], row[vectors + i]);
                let (g_re, g_im) = (simd.splat_f64s(line[0]), simd.splat_f64s(line[1]));
                // 1 + G Gfb
                let c_re = simd.negate_mul_add_e_f64s(g_im, im, simd.mul_add_e_f64s(g_re, re, one));
                let c_im = simd.mul_add_e_f64s(g_im, re, simd.mul_f64s(g_re, im));
                let square = simd.mul_add_e_f64s(c_re, c_re, simd.mul_f64s(c_im, c_im));
                let reciprocal = simd.div_f64s(one, square);
                let weight = simd.mul_f64s(simd.splat_f64s(line[2]), reciprocal);
                let size = simd.mul_add_e_f64s(re, re, simd.mul_f64s(im, im));
                let moduli_here = simd.mul_add_e_f64s(simd.splat_f64s(line[8]), size, simd.splat_f64s(line[7]));
                moduli = simd.mul_add_e_f64s(weight, moduli_here, moduli);
                let loss = simd.mul_f64s(simd.mul_add_e_f64s(simd.splat_f64s(line[9]), size, one), reciprocal);
                worst = simd.max_f64s(worst, loss);
                // Y = A + B Gfb
                let (b_re, b_im) = (simd.splat_f64s(line[5]), simd.splat_f64s(line[6]));
                let y_re = simd.mul_add_e_f64s(b_re, re, simd.splat_f64s(line[3]));
                let y_re = simd.negate_mul_add_e_f64s(b_im, im, y_re);
                let y_im = simd.mul_add_e_f64s(b_re, im, simd.splat_f64s(line[4]));
                let y_im = simd.mul_add_e_f64s(b_im, re, y_im);
                let (real, imaginary) = (simd.mul_f64s(weight, y_re), simd.mul_f64s(weight, y_im));
                total = simd.mul_add_e_f64s(real, y_re, total);
                total = simd.mul_add_e_f64s(imaginary, y_im, total);
                let (e, rest) = basis.split_at(even_products);
                let (o, functions) = rest.split_at(odd_products);
                even.add(simd, p, weight, real, e, &functions[..p]);
                odd.add(simd, q, weight, imaginary, o, &functions[p..]);
            }
            let loss = simd.add_f64s(one, simd.sqrt_f64s(simd.add_f64s(worst, worst)));
            let rounding = simd.mul_f64s(simd.mul_f64s(moduli, loss), simd.splat_f64s(layout.rounding));
            (costs[i], bounds[i]) = finish(simd, (p, q), &mut even, &mut odd, total, rounding);
        }
    }
}
