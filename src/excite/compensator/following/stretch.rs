//! The values of a row over a piece, and bounds of them.

use super::{FollowingLoop, Row};

/// Samples of a piece that are bounded together, by the one in their middle.
pub(super) const BLOCK: usize = 8;

/// The values of a row over a piece: columns `h` and `g`, and the bound of all but the first.
pub(super) struct Stretch {
    columns: Vec<Vec<f64>>,
    /// R, upper triangular, row by row.
    triangle: Vec<f64>,
    /// The largest ‖q_i‖ for i ≥ 1.
    most: f64,
    /// The columns at the middles of the blocks.
    centres: Vec<Vec<f64>>,
    /// The largest ‖q_i − q_c‖ of each block, c its middle.
    pub spreads: Vec<f64>,
}

impl Stretch {
    pub(super) fn new(of: &FollowingLoop<'_>, row: &Row, length: usize) -> Self {
        let (n, width) = (of.n, of.n + 1);
        let mut columns = vec![Vec::with_capacity(length); width];
        let (mut h, mut next, mut g) = (row.c.clone(), vec![0.0; n], row.d);
        for _ in 0..length {
            for (column, h) in columns.iter_mut().zip(&h) {
                column.push(*h);
            }
            columns[n].push(g);
            g += h.iter().zip(&of.b).map(|(h, b)| h * b).sum::<f64>();
            next.fill(0.0);
            for (i, h) in h.iter().enumerate() {
                for (into, a) in next.iter_mut().zip(&of.a[i * n..(i + 1) * n]) {
                    *into += h * a;
                }
            }
            std::mem::swap(&mut h, &mut next);
        }
        // Gram and Schmidt's orthogonalisation as modified: H = Q R holds to rounding whatever the angles between the
        // columns are, which is all that the bound needs.
        let (mut q, mut triangle) = (columns.clone(), vec![0.0; width * width]);
        for j in 0..width {
            let (done, rest) = q.split_at_mut(j + 1);
            let own = &mut done[j];
            let norm = own.iter().map(|v| v * v).sum::<f64>().sqrt();
            triangle[j * width + j] = norm;
            if norm > 0.0 {
                own.iter_mut().for_each(|v| *v /= norm);
            }
            for (k, other) in rest.iter_mut().enumerate() {
                let share: f64 = own.iter().zip(other.iter()).map(|(a, b)| a * b).sum();
                triangle[j * width + j + 1 + k] = share;
                other.iter_mut().zip(own.iter()).for_each(|(b, a)| *b -= share * a);
            }
        }
        let norms = (1..length).map(|i| q.iter().map(|column| column[i] * column[i]).sum::<f64>());
        let most = norms.fold(0.0, f64::max).sqrt();
        let middle = |block: usize| (block * BLOCK + BLOCK / 2).min(length - 1);
        let blocks = length.div_ceil(BLOCK);
        let spread = |block: usize| {
            let apart = |i: usize| q.iter().map(|column| (column[i] - column[middle(block)]).powi(2)).sum::<f64>();
            (block * BLOCK..((block + 1) * BLOCK).min(length)).map(apart).fold(0.0, f64::max).sqrt()
        };
        let spreads = (0..blocks).map(spread).collect();
        let centres = columns.iter().map(|column| (0..blocks).map(|block| column[middle(block)]).collect()).collect();
        Self { columns, triangle, most, centres, spreads }
    }

    pub(super) fn first(&self, start: &[f64]) -> f64 {
        self.columns.iter().zip(start).map(|(column, x)| column[0] * x).sum()
    }

    /// ‖R (x₀, r)‖.
    pub(super) fn norm(&self, start: &[f64]) -> f64 {
        let width = start.len();
        let mut squares = 0.0;
        for i in 0..width {
            let row = &self.triangle[i * width..(i + 1) * width];
            let mut sum = 0.0;
            for j in i..width {
                sum += row[j] * start[j];
            }
            squares += sum * sum;
        }
        squares.sqrt()
    }

    pub(super) fn bound(&self, start: &[f64]) -> f64 {
        self.most * self.norm(start)
    }

    /// The values at the middles of the blocks; of the last one perhaps beyond the piece.
    pub(super) fn write_centres(&self, start: &[f64], into: &mut [f64]) {
        into.fill(0.0);
        for (column, x) in self.centres.iter().zip(start) {
            for (into, h) in into.iter_mut().zip(column) {
                *into += h * x;
            }
        }
    }

    /// The values of some samples from one on.
    pub(super) fn write(&self, start: &[f64], from: usize, into: &mut [f64]) {
        into.fill(0.0);
        for (column, x) in self.columns.iter().zip(start) {
            for (into, h) in into.iter_mut().zip(&column[from..]) {
                *into += h * x;
            }
        }
    }
}
