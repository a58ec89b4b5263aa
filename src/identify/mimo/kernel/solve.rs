//! The best feedforwards of a batch from its normal equations.

use super::sums::Shape;
use super::{Fixed, LANES, SMALLEST_PIVOT, Scratch, Screened, V};
use crate::identify::search::simd::ldl::{Above, Lanes, Ldl, Square};

/// Plain loops over the lanes, which the compiler vectorises for the dispatched instructions.
impl Lanes for V {
    #[inline(always)]
    fn times(mut self, b: Self) -> Self {
        for n in 0..LANES {
            self[n] *= b[n];
        }
        self
    }
    #[inline(always)]
    fn times_from(self, b: Self, mut c: Self) -> Self {
        for n in 0..LANES {
            c[n] -= self[n] * b[n];
        }
        c
    }
    #[inline(always)]
    fn over(mut self, b: Self) -> Self {
        for n in 0..LANES {
            self[n] /= b[n];
        }
        self
    }
    #[inline(always)]
    fn where_above(self, limit: Self, mut then: Self, otherwise: Self) -> Self {
        for n in 0..LANES {
            then[n] = if self[n] > limit[n] { then[n] } else { otherwise[n] };
        }
        then
    }
}

/// A square matrix row by row.
struct Rows<'a> {
    width: usize,
    entries: &'a mut [V],
}

impl Rows<'_> {
    /// Checked by the length of what it points into: a check of each product would stand in the innermost loop.
    #[inline(always)]
    fn place(&self, row: usize, column: usize) -> usize {
        row.wrapping_mul(self.width).wrapping_add(column)
    }
}

impl Square<V> for Rows<'_> {
    #[inline(always)]
    fn at(&self, row: usize, column: usize) -> V {
        self.entries[self.place(row, column)]
    }
    #[inline(always)]
    fn put(&mut self, row: usize, column: usize, value: V) {
        let place = self.place(row, column);
        self.entries[place] = value;
    }
}

impl Fixed<'_> {
    #[allow(clippy::needless_range_loop)]
    #[inline(always)]
    pub(super) fn solve(&self, shape: Shape, scratch: &mut Scratch) -> Screened {
        let p = shape.controls * shape.size();
        let Scratch { sums, matrix, scale, inverse, x, .. } = scratch;
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
        // Of a pivot that is too small the inverse is infinite, and so is the cost, or no number.
        let mut ldl = Ldl { gram: Rows { width: p, entries: matrix }, inverse: &mut inverse[..] };
        let mut pivots = Above { least: [SMALLEST_PIVOT; LANES], infinity: [f64::INFINITY; LANES] };
        ldl.factor(p, [1.0; LANES], &mut pivots);
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
                x[i] = sum;
            }
            ldl.forward(p, x);
            for (x, inverse) in x.iter().zip(ldl.inverse.iter()) {
                for n in 0..LANES {
                    cost[n] -= x[n] * (x[n] * inverse[n]);
                }
            }
            ldl.backward(p, x);
            let mut length = [0.0; LANES];
            for (x, scale) in x.iter().zip(scale.iter()).rev() {
                for n in 0..LANES {
                    length[n] += (x[n] * scale[n]).abs();
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
