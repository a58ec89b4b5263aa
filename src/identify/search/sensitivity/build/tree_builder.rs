//! Dividing the listed controllers into nested clusters.

use super::cluster::Cluster;
use super::deviations::{Scratch, Split};
use super::extent::{Extent, Widest};
use super::members::Table;
use super::sample::{Sample, Splitter};
use super::size::PARTS;
use crate::ctl::{Ctl, Stopped};
use rayon::prelude::*;

/// Clusters of at most this size (the root mean square of the largest |κ| at each line) are not divided, unless they
/// have more members.
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

pub(crate) struct TreeBuilder<'a> {
    pub table: Table<'a>,
    pub lines: usize,
    /// Clusters of at most so many members are not divided.
    pub leaf: usize,
    pub ctl: &'a Ctl,
}

/// Clusters, each before those that divide it, and the largest ones worth bounding.
#[derive(Debug, Default)]
pub(crate) struct Forest {
    pub nodes: Vec<Cluster>,
    pub roots: Vec<u32>,
}

impl Forest {
    fn append(&mut self, other: Self) {
        let base = self.nodes.len() as u32;
        self.roots.extend(other.roots.into_iter().map(|root| root + base));
        self.nodes.extend(other.nodes.into_iter().map(|mut cluster| {
            cluster.children.iter_mut().for_each(|child| *child += base);
            cluster
        }));
    }
}

/// Scratch for one cluster after the other.
#[derive(Debug, Default)]
struct Task {
    sample: Sample,
    scratch: Scratch,
    /// The part of every member.
    codes: Vec<u8>,
    unsorted: Vec<u32>,
}

/// A division, how far what is divided extends, and how far its parts do.
struct Measured {
    split: Split,
    extent: Extent,
    widest: Widest,
}

impl TreeBuilder<'_> {
    /// The clusters.
    pub(crate) fn forest(&self, members: &mut [u32]) -> Result<Forest, Stopped> {
        let mut forest = Forest::default();
        if !members.is_empty() {
            self.scatter(members, 0, &mut Task::default(), &mut forest)?;
        }
        forest.nodes.shrink_to_fit();
        Ok(forest)
    }

    /// Divides what is too large to be bounded, and grows a tree on each part.
    fn scatter(&self, members: &mut [u32], first: u32, task: &mut Task, forest: &mut Forest) -> Result<(), Stopped> {
        let splitter = self.splitter(members, task);
        // The sample says how far to divide, and all members whether that is enough: a few far ones would spoil every
        // bound.
        let mut size = splitter.size;
        if size <= START || members.len() <= self.leaf {
            let measured = self.measure(members, &splitter, task)?;
            size = measured.extent.size();
            if size <= START || members.len() <= self.leaf {
                forest.roots.push(forest.nodes.len() as u32);
                return self.grow(members, first, measured, task, forest);
            }
        }
        let halvings = if size > 3.0 * START && splitter.size > START {
            3
        } else if size > 1.8 * START && splitter.size > START {
            2
        } else {
            1
        };
        let split = splitter.by_logarithms(&mut task.sample, halvings);
        self.codes(members, &split, task)?;
        let Some(counts) = sort(members, task) else {
            let measured = self.measure(members, &splitter, task)?;
            forest.roots.push(forest.nodes.len() as u32);
            return self.grow(members, first, measured, task, forest);
        };
        drop((splitter, split));
        let each = |m: &mut [u32], first, task: &mut Task, forest: &mut Forest| self.scatter(m, first, task, forest);
        parts(members, &counts, first, task, forest, each)?;
        Ok(())
    }

    /// A cluster and everything inside it; the first of what is appended is the cluster itself.
    fn grow(
        &self,
        members: &mut [u32],
        first: u32,
        measured: Measured,
        task: &mut Task,
        forest: &mut Forest,
    ) -> Result<(), Stopped> {
        let Measured { split, extent, widest } = measured;
        let size = extent.size();
        let own = forest.nodes.len();
        forest.nodes.push(Cluster::new(&split, &extent, first..first + members.len() as u32));
        if members.len() <= self.leaf || (size <= SMALL && members.len() <= MOST) {
            return Ok(());
        }
        let Some(counts) = sort(members, task) else { return Ok(()) };
        drop((split, extent));
        let each = |m: &mut [u32], first, task: &mut Task, forest: &mut Forest| {
            let splitter = self.splitter(m, task);
            let measured = self.measure(m, &splitter, task)?;
            drop(splitter);
            self.grow(m, first, measured, task, forest)
        };
        let children = parts(members, &counts, first, task, forest, each)?;
        let filled = (0..PARTS).filter(|part| counts[*part] > 0);
        for (child, part) in children.iter().zip(filled) {
            let (before, after) = forest.nodes.split_at_mut(*child as usize);
            after[0].set_within(&before[own], &widest.ranges(part));
        }
        forest.nodes[own].children = children.into();
        Ok(())
    }

    /// How often a cluster is halved: into eight parts, or fewer where these would be smaller than leaves need to be.
    fn halvings(&self, members: &[u32]) -> usize {
        (members.len() / self.leaf).max(2).ilog2().min(3) as usize
    }

    /// Centre, directions and thresholds from a sample.
    fn splitter(&self, members: &[u32], task: &mut Task) -> Splitter {
        let most = if members.len() <= SHARED { SAMPLE } else { LARGE_SAMPLE };
        let step = members.len().div_ceil(most).max(1);
        Splitter::new(&self.table, members, step, self.lines, &mut task.sample)
    }

    /// Extent and part of every member.
    fn measure(&self, members: &[u32], splitter: &Splitter, task: &mut Task) -> Result<Measured, Stopped> {
        self.ctl.check()?;
        let Task { sample, scratch, codes, .. } = task;
        let split = splitter.by_coordinates(sample, self.halvings(members));
        let mut widest = Widest::none(self.lines);
        codes.clear();
        if members.len() <= SAMPLE {
            // The sample is the whole.
            split.widen_known(&sample.deviations, &sample.along, &mut widest, codes);
        } else if members.len() <= SHARED {
            split.widen(&self.table, members, scratch, &mut widest, codes);
        } else {
            let each = |members: &[u32]| {
                self.ctl.check()?;
                let (mut widest, mut codes) = (Widest::none(self.lines), Vec::with_capacity(members.len()));
                split.widen(&self.table, members, &mut Scratch::default(), &mut widest, &mut codes);
                Ok((widest, codes))
            };
            for (some, more) in members.par_chunks(PER_CHECK).map(each).collect::<Result<Vec<_>, Stopped>>()? {
                widest = widest.join(&some);
                codes.extend(more);
            }
        }
        let extent = Extent::new(&widest, &split);
        Ok(Measured { split, extent, widest })
    }

    /// The part of every member, by its logarithm.
    fn codes(&self, members: &[u32], split: &Split, task: &mut Task) -> Result<(), Stopped> {
        self.ctl.check()?;
        let Task { scratch, codes, .. } = task;
        codes.clear();
        if members.len() <= SHARED {
            split.codes(&self.table, members, scratch, codes);
        } else {
            let each = |members: &[u32]| {
                self.ctl.check()?;
                let mut codes = Vec::with_capacity(members.len());
                split.codes(&self.table, members, &mut Scratch::default(), &mut codes);
                Ok(codes)
            };
            let each = members.par_chunks(PER_CHECK).map(each).collect::<Result<Vec<_>, Stopped>>()?;
            each.into_iter().for_each(|more| codes.extend(more));
        }
        Ok(())
    }
}

/// Sorts the members by their part, and counts each; `None` where they all fall into one.
fn sort(members: &mut [u32], task: &mut Task) -> Option<[usize; PARTS]> {
    let Task { codes, unsorted, .. } = task;
    let mut counts = [0_usize; PARTS];
    codes.iter().for_each(|code| counts[usize::from(*code)] += 1);
    if counts.contains(&members.len()) {
        return None;
    }
    let mut next = [0_usize; PARTS];
    for part in 1..PARTS {
        next[part] = next[part - 1] + counts[part - 1];
    }
    unsorted.clear();
    unsorted.extend_from_slice(members);
    for (member, code) in unsorted.iter().zip(codes) {
        let place = &mut next[usize::from(*code)];
        members[*place] = *member;
        *place += 1;
    }
    Some(counts)
}

/// Does something to each part of sorted members, without empty ones, by its members and its place: by several threads
/// where there are many. Where what each appends begins.
fn parts(
    members: &mut [u32],
    counts: &[usize; PARTS],
    first: u32,
    task: &mut Task,
    forest: &mut Forest,
    each: impl Fn(&mut [u32], u32, &mut Task, &mut Forest) -> Result<(), Stopped> + Sync,
) -> Result<Vec<u32>, Stopped> {
    let shared = members.len() > SHARED;
    let mut parts = Vec::with_capacity(PARTS);
    let (mut left, mut place) = (members, first);
    for &count in counts.iter().filter(|count| **count > 0) {
        let (part, rest) = left.split_at_mut(count);
        parts.push((part, place));
        left = rest;
        place += count as u32;
    }
    let mut begins = Vec::with_capacity(parts.len());
    if shared {
        // Each has room of its own; this would lie idle.
        *task = Task::default();
        let of = |(members, first): (&mut [u32], u32)| {
            let mut forest = Forest::default();
            each(members, first, &mut Task::default(), &mut forest)?;
            Ok(forest)
        };
        let grown = parts.into_par_iter().map(of).collect::<Vec<Result<Forest, Stopped>>>();
        let grown = grown.into_iter().collect::<Result<Vec<_>, Stopped>>()?;
        forest.nodes.reserve_exact(grown.iter().map(|grown| grown.nodes.len()).sum());
        for grown in grown {
            begins.push(forest.nodes.len() as u32);
            forest.append(grown);
        }
    } else {
        for (members, first) in parts {
            begins.push(forest.nodes.len() as u32);
            each(members, first, task, forest)?;
        }
    }
    Ok(begins)
}
