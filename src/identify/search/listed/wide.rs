//! Lines side by side: what is computed for every line of a controller takes a few vector operations.

use num_complex::Complex64;
use pulp::Simd;

/// Lines in a block; those left over in the last one are zero.
pub(super) const WIDE: usize = 16;

/// The numbers of a block, in a cache line or two of their own.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(64))]
pub(super) struct Wide<N>(pub [N; WIDE]);

/// Real and imaginary parts of a block.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pair<N> {
    pub re: Wide<N>,
    pub im: Wide<N>,
}

/// Blocks that hold so many lines.
pub(super) fn blocks(lines: usize) -> usize {
    lines.div_ceil(WIDE)
}

/// Complex numbers in blocks; what is left over is `rest`.
pub(super) fn pairs(values: &[Complex64], rest: f64) -> impl Iterator<Item = Pair<f64>> {
    values.chunks(WIDE).map(move |values| {
        let mut pair = Pair { re: Wide([rest; WIDE]), im: Wide([0.0; WIDE]) };
        for ((re, im), value) in pair.re.0.iter_mut().zip(&mut pair.im.0).zip(values) {
            (*re, *im) = (value.re, value.im);
        }
        pair
    })
}

/// Values at the lines of many polynomials, each in blocks.
#[derive(Debug)]
pub(super) struct Rows {
    blocks: usize,
    pairs: Vec<Pair<f64>>,
}

impl Rows {
    pub(super) fn new(lines: usize, rows: &[Vec<Complex64>]) -> Self {
        Self { blocks: blocks(lines).max(1), pairs: rows.iter().flat_map(|row| pairs(row, 0.0)).collect() }
    }

    pub(super) fn len(&self) -> usize {
        self.pairs.len() / self.blocks
    }

    #[inline(always)]
    pub(super) fn row(&self, at: usize) -> &[Pair<f64>] {
        &self.pairs[at * self.blocks..(at + 1) * self.blocks]
    }
}

/// `a b + c`, in one operation where the processor has it; elsewhere that would be a slow call.
#[inline(always)]
pub(super) fn mul_add<S: Simd>(a: f64, b: f64, c: f64) -> f64 {
    if S::IS_SCALAR { a * b + c } else { a.mul_add(b, c) }
}
