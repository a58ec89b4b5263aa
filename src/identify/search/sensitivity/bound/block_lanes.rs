//! BlockLanes of feedforward denominators, side by side for the kernel.

use crate::identify::search::sensitivity::build::denominators::{Denominators, FREE, Tabled};

/// BlockLanes per call: whole vectors of every kind.
pub(super) const LANES: usize = 16;

/// The blocks of a call, side by side.
#[derive(Debug)]
pub(super) struct BlockLanes<N> {
    /// How many lanes hold a block of their own; the others repeat the last.
    pub filled: usize,
    /// Whether all of them are single denominators.
    pub alone: bool,
    /// Per line: Re and Im of 1/D, largest |δ|, as in the table.
    pub rows: Vec<[[N; LANES]; 3]>,
    pub reach: [[N; LANES]; FREE],
    pub spread: [N; LANES],
}

impl<N: Tabled> BlockLanes<N> {
    pub(super) fn new(lines: usize) -> Self {
        let zero = [N::default(); LANES];
        Self { filled: 0, alone: true, rows: vec![[zero; 3]; lines], reach: [zero; FREE], spread: zero }
    }

    pub(super) fn fill(&mut self, denominators: &Denominators, ids: impl ExactSizeIterator<Item = u32>) {
        let table = N::table(denominators);
        self.filled = ids.len();
        self.alone = true;
        for (lane, id) in ids.enumerate().take(LANES) {
            self.alone &= denominators.divisions[id as usize].is_single();
            let (rows, reach, spread) = table.entry(id);
            for (into, row) in self.rows.iter_mut().zip(rows) {
                into.iter_mut().zip(row).for_each(|(into, x)| into[lane] = *x);
            }
            self.reach.iter_mut().zip(reach).for_each(|(into, x)| into[lane] = x);
            self.spread[lane] = spread;
        }
        let last = self.filled - 1;
        for lane in self.filled..LANES {
            let rows = self.rows.iter_mut().flatten().chain(&mut self.reach).chain([&mut self.spread]);
            rows.for_each(|row| row[lane] = row[last]);
        }
    }
}
