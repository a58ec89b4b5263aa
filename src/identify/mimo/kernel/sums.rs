//! Normal equations of the feedforward, packed, and their sums over the lines.

use super::{LANES, V};
use crate::identify::mimo::exact::Problem;
use num_complex::Complex64;

/// Normal equations, packed; see [`Shape`].
#[derive(Debug, Clone)]
pub(super) struct Sums<T> {
    pub(super) gram: Vec<T>,
    pub(super) right: Vec<T>,
    pub(super) square: Vec<T>,
    pub(super) c: T,
    pub(super) b: T,
    pub(super) sigma: T,
}

/// Sizes of the packed normal equations.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shape {
    pub(super) controls: usize,
    pub(super) commands: usize,
    pub(super) even: usize,
    pub(super) odd: usize,
}

impl Shape {
    pub(super) fn of(problem: &Problem, pool_controls: usize, commands: usize) -> Self {
        Self { controls: pool_controls, commands, even: problem.even(), odd: problem.basis.odd().len() }
    }

    /// Numbers of the packed Gram matrix: for every pair i ≤ i' of controls the triangles even·even and odd·odd, and
    /// even·odd where i < i'.
    pub(super) fn gram(self) -> usize {
        let (e, o, m) = (self.even, self.odd, self.controls);
        let triangles = e * (e + 1) / 2 + o * (o + 1) / 2;
        m * (m + 1) / 2 * triangles + m * (m - 1) / 2 * e * o
    }

    pub(super) fn size(self) -> usize {
        self.even + self.odd
    }

    pub(super) fn right(self) -> usize {
        self.controls * self.size() * self.commands
    }
}

impl<T: Copy> Sums<T> {
    pub(super) fn new(shape: Shape, zero: T) -> Self {
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
    pub(super) fn start(&mut self, from: &Sums<f64>) {
        let fill = |to: &mut [V], from: &[f64]| to.iter_mut().zip(from).for_each(|(t, f)| *t = [*f; LANES]);
        fill(&mut self.gram, &from.gram);
        fill(&mut self.right, &from.right);
        fill(&mut self.square, &from.square);
        (self.c, self.b, self.sigma) = ([from.c; LANES], [from.b; LANES], [0.0; LANES]);
    }
}

impl Sums<f64> {
    /// One equation `y Gff − τ` per command at a line, in the same order as the batches.
    pub(super) fn add_scalar(
        &mut self,
        shape: Shape,
        problem: &Problem,
        line: usize,
        y: &[Complex64],
        tau: &[Complex64],
    ) {
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
    /// The lower triangle of the full Gram matrix, row by row. With `s + jt = Σ w y_i* y_i'` the entry of a real
    /// function of i and an imaginary one of i' is −t, the other way round +t.
    #[inline(always)]
    pub(super) fn unpack(self, packed: &[V], full: &mut [V]) {
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
