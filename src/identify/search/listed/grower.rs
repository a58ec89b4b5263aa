//! Dividing the listed controllers into nested clusters.

use super::cell::Cell;
use super::cells::Table;
use super::deviations::{Extent, Pass, Split, Splitter, Widest};
use super::singles::LANES;
use crate::num::{Ctl, Stopped};
use rayon::prelude::*;

/// Clusters of at most this size (the root mean square of the largest |κ| at each line) are not divided, unless they have more members.
const SMALL: f64 = 0.02;
const MOST: usize = 256;

/// Clusters above this size are divided before anything is known of them.
const START: f64 = 0.7;

/// Clusters that are divided by several threads.
const SHARED: usize = 1 << 16;

/// Members from which a cluster's directions and thresholds are taken.
const SAMPLE: usize = 256;
const LARGE_SAMPLE: usize = 2048;

/// Looks at the stop flag once for so many members.
const PER_CHECK: usize = 1 << 15;

pub(super) struct Grower<'a> {
    pub table: Table<'a>,
    pub lines: usize,
    /// Clusters of at most so many members are not divided.
    pub leaf: usize,
    pub ctl: &'a Ctl,
}

/// Clusters whose children are counted from the beginning of their own list.
type Grown = Vec<Cell>;

impl Grower<'_> {
    /// The clusters, and the largest ones worth bounding.
    pub(super) fn forest(&self, members: &mut [u32]) -> Result<(Vec<Cell>, Vec<u32>), Stopped> {
        let mut scratch = vec![0_u32; members.len()];
        let trees = self.scatter(members, &mut scratch, 0)?;
        drop(scratch);
        let mut nodes: Vec<Cell> = Vec::with_capacity(trees.iter().map(Vec::len).sum());
        let mut roots = Vec::with_capacity(trees.len());
        for tree in trees {
            let base = nodes.len() as u32;
            roots.push(base);
            nodes.extend(tree.into_iter().map(|mut cell| {
                cell.children.iter_mut().for_each(|child| *child += base);
                cell
            }));
        }
        Ok((nodes, roots))
    }

    /// Divides what is too large to be bounded, and grows a tree on each part.
    fn scatter(&self, members: &mut [u32], scratch: &mut [u32], first: u32) -> Result<Vec<Grown>, Stopped> {
        let splitter = self.splitter(members);
        // The sample says how far to divide, and all members whether that is enough: a few far ones would spoil every bound.
        let mut size = splitter.size;
        if size <= START || members.len() <= self.leaf {
            let measured = self.measure(members, splitter.by_coordinates(self.halvings(members)))?;
            size = measured.extent.size();
            if size <= START || members.len() <= self.leaf {
                return Ok(vec![self.grow(members, scratch, first, measured)?]);
            }
        }
        let halvings = if size > 3.0 * START && splitter.size > START {
            3
        } else if size > 1.8 * START && splitter.size > START {
            2
        } else {
            1
        };
        let split = splitter.by_logarithms(halvings);
        let codes = self.codes(members, &split)?;
        let Some(counts) = sort(members, scratch, split.parts(), &codes) else {
            let measured = self.measure(members, splitter.by_coordinates(self.halvings(members)))?;
            return Ok(vec![self.grow(members, scratch, first, measured)?]);
        };
        drop(codes);
        let parts = parts(members, scratch, &counts, first);
        let each: Vec<_> = parts.into_par_iter().map(|(m, s, first)| self.scatter(m, s, first)).collect();
        Ok(each.into_iter().collect::<Result<Vec<_>, Stopped>>()?.into_iter().flatten().collect())
    }

    /// A cluster and everything inside it; the first of the list is the cluster itself.
    fn grow(&self, members: &mut [u32], scratch: &mut [u32], first: u32, measured: Measured) -> Result<Grown, Stopped> {
        let Measured { split, extent, codes, widest } = measured;
        let size = extent.size();
        let mut grown = vec![Cell::new(&split, &extent, first..first + members.len() as u32)];
        if members.len() <= self.leaf || (size <= SMALL && members.len() <= MOST) {
            return Ok(grown);
        }
        let Some(counts) = sort(members, scratch, split.parts(), &codes) else { return Ok(grown) };
        drop((split, extent, codes));
        let ranges: Vec<_> =
            (0..counts.len()).filter(|part| counts[*part] > 0).map(|part| widest.ranges(part)).collect();
        let each: Vec<Result<Grown, Stopped>> = parts(members, scratch, &counts, first)
            .into_par_iter()
            .map(|(m, s, first)| {
                let measured = self.measure(m, self.splitter(m).by_coordinates(self.halvings(m)))?;
                self.grow(m, s, first, measured)
            })
            .collect();
        let mut children = Vec::with_capacity(each.len());
        for (tree, ranges) in each.into_iter().zip(&ranges) {
            let base = grown.len() as u32;
            children.push(base);
            let mut tree = tree?;
            tree[0].set_within(&grown[0], ranges);
            grown.extend(tree.into_iter().map(|mut cell| {
                cell.children.iter_mut().for_each(|child| *child += base);
                cell
            }));
        }
        grown[0].children = children.into();
        Ok(grown)
    }

    /// How often a cluster is halved: into eight parts, or fewer where these would be smaller than leaves need to be.
    fn halvings(&self, members: &[u32]) -> usize {
        (members.len() / self.leaf).max(2).ilog2().min(3) as usize
    }

    /// Centre, directions and thresholds from a sample.
    fn splitter(&self, members: &[u32]) -> Splitter {
        let most = if members.len() <= SHARED { SAMPLE } else { LARGE_SAMPLE };
        let step = members.len().div_ceil(most).max(1);
        let sample = members.iter().step_by(step).flat_map(|member| self.table.response(*member)).collect();
        Splitter::new(sample, self.lines)
    }

    /// Runs over all members, by several threads where there are many.
    fn over<T: Send>(
        &self,
        members: &[u32],
        each: impl Fn(&[u32], &mut Pass) -> T + Sync,
        join: impl Fn(T, T) -> T + Sync,
    ) -> Result<Option<T>, Stopped> {
        let of = |chunk: &[u32]| {
            self.ctl.check()?;
            Ok(each(chunk, &mut Pass::new(self.lines)))
        };
        if members.len() <= SHARED {
            let mut all = None;
            for chunk in members.chunks(PER_CHECK) {
                let one = of(chunk)?;
                all = Some(match all {
                    Some(before) => join(before, one),
                    None => one,
                });
            }
            return Ok(all);
        }
        members.par_chunks(PER_CHECK).map(|chunk| of(chunk).map(Some)).try_reduce(
            || None,
            |a, b| {
                Ok(match (a, b) {
                    (Some(a), Some(b)) => Some(join(a, b)),
                    (a, b) => a.or(b),
                })
            },
        )
    }

    /// Extent and part of every member.
    fn measure(&self, members: &[u32], split: Split) -> Result<Measured, Stopped> {
        let each = |chunk: &[u32], pass: &mut Pass| {
            let (mut widest, mut codes) = (Widest::none(self.lines), Vec::with_capacity(chunk.len()));
            for eight in chunk.chunks(LANES) {
                pass.load(eight.len(), |lane| self.table.response(eight[lane]));
                pass.widen(&split, &mut widest, &mut codes);
            }
            (widest, codes)
        };
        let join = |(a, mut codes): (Widest, Vec<u8>), (b, more): (Widest, Vec<u8>)| {
            codes.extend(more);
            (a.join(&b), codes)
        };
        let (widest, codes) = self.over(members, each, join)?.unwrap_or_else(|| (Widest::none(self.lines), Vec::new()));
        let extent = Extent::new(&widest, &split);
        Ok(Measured { split, extent, codes, widest })
    }

    /// The part of every member, by its logarithm.
    fn codes(&self, members: &[u32], split: &Split) -> Result<Vec<u8>, Stopped> {
        let each = |chunk: &[u32], pass: &mut Pass| {
            let mut codes = Vec::with_capacity(chunk.len());
            for eight in chunk.chunks(LANES) {
                pass.load(eight.len(), |lane| self.table.response(eight[lane]));
                pass.codes(split, &mut codes);
            }
            codes
        };
        let join = |mut a: Vec<u8>, b: Vec<u8>| {
            a.extend(b);
            a
        };
        Ok(self.over(members, each, join)?.unwrap_or_default())
    }
}

/// A division, and what it makes of the members.
struct Measured {
    split: Split,
    extent: Extent,
    codes: Vec<u8>,
    widest: Widest,
}

/// Sorts the members by their part; `None` where they all fall into one.
fn sort(members: &mut [u32], scratch: &mut [u32], parts: usize, codes: &[u8]) -> Option<Vec<usize>> {
    let mut counts = vec![0_usize; parts];
    codes.iter().for_each(|code| counts[usize::from(*code)] += 1);
    if counts.contains(&members.len()) {
        return None;
    }
    let mut next: Vec<usize> = counts
        .iter()
        .scan(0, |sum, count| {
            let before = *sum;
            *sum += count;
            Some(before)
        })
        .collect();
    for (member, code) in members.iter().zip(codes) {
        let place = &mut next[usize::from(*code)];
        scratch[*place] = *member;
        *place += 1;
    }
    members.copy_from_slice(scratch);
    Some(counts)
}

/// The parts of sorted members, without empty ones, each with its share of the scratch memory and its place.
fn parts<'m>(
    mut members: &'m mut [u32],
    mut scratch: &'m mut [u32],
    counts: &[usize],
    first: u32,
) -> Vec<(&'m mut [u32], &'m mut [u32], u32)> {
    let mut parts = Vec::new();
    let mut place = first;
    for &count in counts {
        let (m, rest) = members.split_at_mut(count);
        let (s, left) = scratch.split_at_mut(count);
        (members, scratch) = (rest, left);
        if count > 0 {
            parts.push((m, s, place));
        }
        place += count as u32;
    }
    parts
}
