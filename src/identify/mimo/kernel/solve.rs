//! The best feedforwards of a batch from its normal equations.

use super::sums::Shape;
use super::{Fixed, LANES, SMALLEST_PIVOT, Scratch, Screened};

impl Fixed<'_> {
    #[allow(clippy::needless_range_loop)]
    #[inline(always)]
    pub(super) fn solve(&self, shape: Shape, scratch: &mut Scratch) -> Screened {
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
