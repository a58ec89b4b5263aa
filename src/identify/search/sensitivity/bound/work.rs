//! Pairs of clusters and blocks that are still to be looked at.

use super::block_lanes::LANES as BLOCK_LANES;
use crate::identify::search::sensitivity::build::clusters::Clusters;

/// A block of denominators, and which of them may still have a good partner.
pub(crate) type Item = (u32, u64);

/// A cluster and a block.
pub(crate) type Pair = (u32, u32);

/// The cheapest of some pairs, in order.
pub(crate) fn best(mut seen: Vec<(f64, u32, u32)>, count: usize) -> Vec<Pair> {
    seen.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    seen.truncate(count);
    seen.into_iter().map(|(_, cluster, block)| (cluster, block)).collect()
}

/// A cluster with the denominators that may go with it.
#[derive(Debug)]
pub(crate) struct Open {
    pub cluster: u32,
    pub items: Vec<Item>,
    /// What its members cost at least with these.
    pub bound: f64,
}

impl Open {
    pub(crate) fn add(&mut self, item: Item, bound: f64) {
        self.items.push(item);
        // `min` would ignore a NaN, which means that nothing is known.
        self.bound = self.bound.min(if bound.is_nan() { f64::NEG_INFINITY } else { bound });
    }
}

/// What is left to bound: single denominators apart from blocks, which the kernel handles differently.
#[derive(Debug, Default)]
pub(crate) struct Work {
    blocks: Vec<Item>,
    alone: Vec<Item>,
}

impl Work {
    pub(crate) fn push(&mut self, clusters: &Clusters, item: Item) {
        let alone = clusters.feedforward.divisions[item.0 as usize].is_single();
        if alone { self.alone.push(item) } else { self.blocks.push(item) }
    }

    pub(crate) fn pop(&mut self) -> Option<Item> {
        self.alone.pop().or_else(|| self.blocks.pop())
    }

    /// Up to as many as there are lanes; blocks first, since single denominators come of them.
    pub(crate) fn next(&mut self, batch: &mut Vec<Item>) -> bool {
        let from = if self.blocks.is_empty() { &mut self.alone } else { &mut self.blocks };
        batch.clear();
        batch.extend(from.drain(from.len().saturating_sub(BLOCK_LANES)..));
        !batch.is_empty()
    }
}
