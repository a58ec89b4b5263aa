//! Lines side by side: what is computed for every line of a controller takes a few vector operations.

use num_complex::Complex64;
use pulp::Simd;

/// Lines in a block; those left over in the last one are zero.
pub(crate) const LINE_LANES: usize = 16;

/// The numbers of a block, in a cache line or two of their own.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(64))]
pub(crate) struct LineLanes<N>(pub [N; LINE_LANES]);

/// Real and imaginary parts of a block.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Pair<N> {
    pub re: LineLanes<N>,
    pub im: LineLanes<N>,
}

/// BlockLanes that hold so many lines.
pub(crate) fn blocks(lines: usize) -> usize {
    lines.div_ceil(LINE_LANES)
}

/// Complex numbers in blocks; what is left over is `rest`.
pub(crate) fn pairs(values: &[Complex64], rest: f64) -> impl Iterator<Item = Pair<f64>> {
    values.chunks(LINE_LANES).map(move |values| {
        let mut pair = Pair { re: LineLanes([rest; LINE_LANES]), im: LineLanes([0.0; LINE_LANES]) };
        for ((re, im), value) in pair.re.0.iter_mut().zip(&mut pair.im.0).zip(values) {
            (*re, *im) = (value.re, value.im);
        }
        pair
    })
}

/// Values at the lines of many polynomials, each in blocks.
#[derive(Debug)]
pub(crate) struct Rows {
    blocks: usize,
    pairs: Vec<Pair<f64>>,
}

impl Rows {
    pub(crate) fn new(lines: usize, rows: &[Vec<Complex64>]) -> Self {
        Self { blocks: blocks(lines).max(1), pairs: rows.iter().flat_map(|row| pairs(row, 0.0)).collect() }
    }

    pub(crate) fn len(&self) -> usize {
        self.pairs.len() / self.blocks
    }

    #[inline(always)]
    pub(crate) fn row(&self, at: usize) -> &[Pair<f64>] {
        &self.pairs[at * self.blocks..(at + 1) * self.blocks]
    }
}

/// `a b + c`, in one operation where the processor has it; elsewhere that would be a slow call.
#[inline(always)]
pub(crate) fn mul_add<S: Simd>(a: f64, b: f64, c: f64) -> f64 {
    if S::IS_SCALAR { a * b + c } else { a.mul_add(b, c) }
}
