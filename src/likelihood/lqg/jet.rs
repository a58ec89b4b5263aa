//! Matrices with their derivatives by the parameters, carried forward: `∂(AB) = ∂A B + A ∂B`, `∂A⁻¹ = −A⁻¹ ∂A A⁻¹`.
//!
//! What is written in them once has exact derivatives. A derivative that is zero for certain costs nothing.

use super::kernel::{add_product, add_transposed, invert, symmetrise};
use nalgebra::DMatrix;

/// A matrix, column by column, with its derivatives.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Jet {
    rows: usize,
    columns: usize,
    /// Parameters.
    count: usize,
    /// A bit for every parameter that moves the matrix.
    moved: u64,
    value: Vec<f64>,
    /// One after the other; empty where no parameter moves the matrix.
    slopes: Vec<f64>,
}

impl Jet {
    /// A matrix that no parameter moves.
    pub(super) fn fixed(m: &DMatrix<f64>, count: usize) -> Self {
        let (rows, columns) = m.shape();
        Self { rows, columns, count, moved: 0, value: m.as_slice().to_vec(), slopes: Vec::new() }
    }

    pub(super) fn zeros(rows: usize, columns: usize, count: usize) -> Self {
        Self { rows, columns, count, moved: 0, value: vec![0.0; rows * columns], slopes: Vec::new() }
    }

    /// A matrix with the derivatives that are not zero.
    pub(super) fn new<'a>(m: &DMatrix<f64>, slopes: impl Iterator<Item = Option<&'a DMatrix<f64>>>) -> Self {
        let slopes: Vec<Option<&DMatrix<f64>>> = slopes.collect();
        let mut jet = Self::fixed(m, slopes.len());
        for (i, slope) in slopes.into_iter().enumerate() {
            if let Some(slope) = slope {
                jet.slope_mut(i).copy_from_slice(slope.as_slice());
            }
        }
        jet
    }

    /// A column with its derivatives, as slices.
    pub(super) fn column(value: &[f64], slopes: &[f64]) -> Self {
        let count = slopes.len().checked_div(value.len()).unwrap_or(0);
        let moved = if count == 0 { 0 } else { u64::MAX >> (64 - count) };
        Self { rows: value.len(), columns: 1, count, moved, value: value.to_vec(), slopes: slopes.to_vec() }
    }

    /// A square matrix with its derivatives, as slices.
    pub(super) fn square(value: &[f64], slopes: &[f64], count: usize) -> Self {
        let order = value.len().isqrt();
        let moved = if count == 0 { 0 } else { u64::MAX >> (64 - count) };
        Self { rows: order, columns: order, count, moved, value: value.to_vec(), slopes: slopes.to_vec() }
    }

    pub(super) fn shape(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    /// Parameters.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    pub(super) fn value(&self) -> &[f64] {
        &self.value
    }

    pub(super) fn matrix(&self) -> DMatrix<f64> {
        DMatrix::from_column_slice(self.rows, self.columns, &self.value)
    }

    /// The derivative by parameter i; `None` where it is zero for certain.
    pub(super) fn slope(&self, i: usize) -> Option<&[f64]> {
        let size = self.value.len();
        (self.moved >> i & 1 == 1).then(|| &self.slopes[i * size..(i + 1) * size])
    }

    pub(super) fn slope_matrix(&self, i: usize) -> Option<DMatrix<f64>> {
        self.slope(i).map(|slope| DMatrix::from_column_slice(self.rows, self.columns, slope))
    }

    fn slope_mut(&mut self, i: usize) -> &mut [f64] {
        let size = self.value.len();
        if self.slopes.is_empty() {
            self.slopes = vec![0.0; size * self.count];
        }
        self.moved |= 1 << i;
        &mut self.slopes[i * size..(i + 1) * size]
    }

    /// Adds `factor` times another of the same shape.
    pub(super) fn add(mut self, other: &Self, factor: f64) -> Self {
        debug_assert_eq!(self.shape(), other.shape());
        for (v, w) in self.value.iter_mut().zip(&other.value) {
            *v += factor * w;
        }
        for i in 0..self.count {
            if let Some(slope) = other.slope(i) {
                for (v, w) in self.slope_mut(i).iter_mut().zip(slope) {
                    *v += factor * w;
                }
            }
        }
        self
    }

    /// `A B`.
    pub(super) fn times(&self, other: &Self) -> Self {
        let shape = [self.rows, self.columns, other.columns];
        self.with(other, (self.rows, other.columns), &|out, a, b| add_product(out, a, b, shape, 1.0))
    }

    /// `A Bᵀ`.
    pub(super) fn times_transposed(&self, other: &Self) -> Self {
        let shape = [self.rows, self.columns, other.rows];
        self.with(other, (self.rows, other.rows), &|out, a, b| add_transposed(out, a, b, shape, 1.0))
    }

    fn with(&self, other: &Self, (rows, columns): (usize, usize), add: &impl Fn(&mut [f64], &[f64], &[f64])) -> Self {
        let mut found = Self::zeros(rows, columns, self.count.max(other.count));
        add(&mut found.value, &self.value, &other.value);
        for i in 0..found.count {
            if let Some(slope) = self.slope(i) {
                add(found.slope_mut(i), slope, &other.value);
            }
            if let Some(slope) = other.slope(i) {
                add(found.slope_mut(i), &self.value, slope);
            }
        }
        found
    }

    pub(super) fn transposed(&self) -> Self {
        let turn = |out: &mut [f64], m: &[f64]| {
            for (at, v) in m.iter().enumerate() {
                out[at / self.rows + at % self.rows * self.columns] = *v;
            }
        };
        let mut found = Self::zeros(self.columns, self.rows, self.count);
        turn(&mut found.value, &self.value);
        for i in 0..self.count {
            if let Some(slope) = self.slope(i) {
                turn(found.slope_mut(i), slope);
            }
        }
        found
    }

    /// The symmetric part of a square matrix.
    pub(super) fn symmetric(mut self) -> Self {
        let (order, size) = (self.rows, self.value.len());
        symmetrise(&mut self.value, order);
        self.slopes.chunks_exact_mut(size.max(1)).for_each(|slope| symmetrise(slope, order));
        self
    }

    /// The inverse of a symmetric matrix; `None` where it is not positive definite.
    pub(super) fn inverse(&self) -> Option<Self> {
        let order = self.rows;
        let mut found = Self::zeros(order, order, self.count);
        invert(&self.value, order, 0..order, &mut found.value)?;
        let square = [order, order, order];
        for i in 0..self.count {
            if let Some(slope) = self.slope(i) {
                let mut half = vec![0.0; order * order];
                add_product(&mut half, &found.value, slope, square, -1.0);
                let mut whole = vec![0.0; order * order];
                add_product(&mut whole, &half, &found.value, square, 1.0);
                found.slope_mut(i).copy_from_slice(&whole);
            }
        }
        Some(found)
    }

    /// Adds another into the block that begins at (row, column).
    pub(super) fn put(mut self, (row, column): (usize, usize), other: &Self, factor: f64) -> Self {
        let rows = self.rows;
        let place = |at: usize| row + at % other.rows + (column + at / other.rows) * rows;
        for (at, v) in other.value.iter().enumerate() {
            self.value[place(at)] += factor * v;
        }
        for i in 0..self.count {
            if let Some(slope) = other.slope(i) {
                let own = self.slope_mut(i);
                for (at, v) in slope.iter().enumerate() {
                    own[place(at)] += factor * v;
                }
            }
        }
        self
    }

    /// The diagonal matrix of a column's entries, or of a square matrix's diagonal.
    pub(super) fn diagonal(&self) -> Self {
        let order = self.rows;
        let step = if self.columns == 1 { 1 } else { order + 1 };
        let mut found = Self::zeros(order, order, self.count);
        for at in 0..order {
            found.value[at * (order + 1)] = self.value[at * step];
        }
        for i in 0..self.count {
            if let Some(slope) = self.slope(i) {
                let own = found.slope_mut(i);
                for at in 0..order {
                    own[at * (order + 1)] = slope[at * step];
                }
            }
        }
        found
    }

    /// Whether value and derivatives agree with another's up to this share of their norms.
    pub(super) fn is_near(&self, other: &Self, share: f64) -> bool {
        let near = |x: &[f64], y: &[f64], size: f64| {
            let apart = x.iter().zip(y).map(|(v, w)| (v - w).powi(2)).sum::<f64>().sqrt();
            apart <= share * size
        };
        let norm = |x: &[f64]| x.iter().map(|v| v * v).sum::<f64>().sqrt();
        let size = norm(&self.value);
        near(&self.value, &other.value, size)
            && (0..self.count).all(|i| match (self.slope(i), other.slope(i)) {
                (Some(x), Some(y)) => near(x, y, size.max(norm(x))),
                (None, None) => true,
                (Some(x), None) | (None, Some(x)) => norm(x) <= share * size,
            })
    }

    pub(super) fn is_finite(&self) -> bool {
        self.value.iter().chain(&self.slopes).all(|v| v.is_finite())
    }
}
