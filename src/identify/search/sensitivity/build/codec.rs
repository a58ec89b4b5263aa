//! Clusters as bytes.
//!
//! Kept is what takes long: the list and the clusters. What they are clusters of (the responses of numerators and
//! denominators at the lines, the blocks of feedforward denominators) is made again, which takes less time than reading
//! it would.

use super::cluster::Cluster;
use super::clusters::{Clusters, LEAF, at_lines};
use super::denominators::Denominators;
use super::members::{GAIN_BITS, Row};
use super::size::PARTS;
use crate::cache::KeyHasher;
use crate::cache::codec::{Pod, Record, Sink, Slice, Source, invalid, put_all};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::Pool;
use crate::identify::problem::Problem;
use std::io;

/// What clusters depend on beside pool, plant and lines.
pub(crate) fn parameters(into: &mut KeyHasher) {
    into.length(LEAF);
    into.number(u64::from(GAIN_BITS));
}

impl Pod for Row {
    const BYTES: usize = 16;

    fn put(self, into: &mut Vec<u8>) {
        [self.denominator, self.numerator].put(into);
        self.unit.put(into);
    }

    fn get(from: &[u8]) -> Self {
        let (positions, unit) = from.split_at(8);
        let [denominator, numerator] = Pod::get(positions);
        Self { denominator, numerator, unit: Pod::get(unit) }
    }
}

impl Record for Cluster {
    // Named member by member, so that a new one is not forgotten here.
    fn put(&self, into: &mut Vec<u8>) {
        let Self { numbers, reach, members, children, rough } = self;
        put_all(numbers, into);
        reach.put(into);
        [members.start, members.end].put(into);
        put_all(children, into);
        u8::from(*rough).put(into);
    }

    fn get(from: &mut Slice<'_>) -> io::Result<Self> {
        Ok(Self {
            numbers: from.all()?,
            reach: from.pod()?,
            members: {
                let [start, end] = from.pod()?;
                start..end
            },
            children: from.all()?,
            rough: from.pod::<u8>()? != 0,
        })
    }
}

impl Clusters {
    /// Writes what [`Clusters::load`] reads.
    ///
    /// # Errors
    /// Those of the sink.
    pub(crate) fn save(&self, to: &mut Sink<'_>) -> io::Result<()> {
        let Self { nodes, roots, members, rows, without_feedback, .. } = self;
        to.pod(without_feedback.map_or([0; 2], |(count, first)| [count, first as u64]))?;
        to.array(rows)?;
        to.array(members)?;
        to.array(roots)?;
        to.records(nodes)
    }

    /// Reads what [`Clusters::save`] wrote of a pool at the lines of a problem. Whether it is that has to be known from
    /// elsewhere; what no search could use is refused.
    ///
    /// # Errors
    /// Those of the source.
    pub(crate) fn load(problem: &Problem, pool: &Pool, from: &mut Source<'_>, ctl: &Ctl) -> io::Result<Self> {
        let made = || -> Result<_, Stopped> { Ok((at_lines(problem, pool), Denominators::new(problem, pool, ctl)?)) };
        let read = || -> io::Result<_> {
            Ok((from.pod::<[u64; 2]>()?, from.array()?, from.array()?, from.array()?, from.records()?))
        };
        let (made, read) = rayon::join(made, read);
        let ([denominators, numerators], feedforward) =
            made.map_err(|stopped| io::Error::new(io::ErrorKind::Interrupted, stopped))?;
        let feedforward = feedforward.ok_or_else(|| invalid("the pool's denominators cannot be held"))?;
        let ([count, first], rows, members, roots, nodes) = read?;
        let without_feedback = (count > 0).then_some((count, first as usize));
        let gains = pool.feedback().gains().to_vec();
        let clusters =
            Self { nodes, roots, members, rows, gains, denominators, numerators, without_feedback, feedforward };
        if clusters.fit(problem.lines().len(), pool) {
            Ok(clusters)
        } else {
            Err(invalid("clusters that do not fit the pool"))
        }
    }

    /// Whether every position that is stored exists, and every controller of the pool is listed.
    fn fit(&self, lines: usize, pool: &Pool) -> bool {
        let Self { nodes, roots, members, rows, gains, denominators, numerators, without_feedback, .. } = self;
        let row =
            |row: &Row| (row.denominator as usize) < denominators.len() && (row.numerator as usize) < numerators.len();
        let member = |member: &u32| {
            let (row, gain) = (member >> GAIN_BITS, member & ((1 << GAIN_BITS) - 1));
            (row as usize) < rows.len() && (gain as usize) < gains.len()
        };
        let node = |(at, cluster): (usize, &Cluster)| {
            let Cluster { numbers, members: own, children, .. } = cluster;
            numbers.len() == Cluster::words(lines)
                && own.start < own.end
                && own.end as usize <= members.len()
                && children.len() <= PARTS
                // Clusters come before those that divide them, so a walk down ends.
                && children.iter().all(|child| (*child as usize) > at && (*child as usize) < nodes.len())
        };
        let without = without_feedback.map_or(0, |(count, _)| count);
        without_feedback.is_none_or(|(_, first)| first < denominators.len())
            && pool.feedback().len() == members.len() as u64 + without
            && rows.iter().all(row)
            && members.iter().all(member)
            && roots.iter().all(|root| (*root as usize) < nodes.len())
            && nodes.iter().enumerate().all(node)
    }
}
