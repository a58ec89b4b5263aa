//! Trees as bytes.

use super::ranges::Ranges;
use super::tree::{DIRECTIONS, Node, Tree};
use super::trees::{FactorTrees, Factors, LEAF};
use crate::cache::KeyHasher;
use crate::cache::codec::{Pod, Record, Sink, Slice, Source, invalid, put_all};
use crate::identify::pool::Pool;
use crate::identify::problem::Problem;
use num_complex::Complex64;
use std::io;

/// What trees depend on beside pool, plant and lines.
pub(crate) fn parameters(into: &mut KeyHasher) {
    into.length(LEAF);
    into.length(DIRECTIONS);
}

impl Record for Node {
    // Named member by member, so that a new one is not forgotten here.
    fn put(&self, into: &mut Vec<u8>) {
        let Self { centre, directions, low, high, remainder, radius, spread, members, children } = self;
        put_all(centre, into);
        put_all(directions, into);
        low.put(into);
        high.put(into);
        put_all(remainder, into);
        put_all(radius, into);
        spread.put(into);
        [members.start as u64, members.end as u64].put(into);
        put_all(&positions(children), into);
    }

    fn get(from: &mut Slice<'_>) -> io::Result<Self> {
        Ok(Self {
            centre: from.all()?,
            directions: from.all()?,
            low: from.pod()?,
            high: from.pod()?,
            remainder: from.all()?,
            radius: from.all()?,
            spread: from.pod()?,
            members: {
                let [start, end] = from.pod::<[u64; 2]>()?.map(|at| at as usize);
                start..end
            },
            children: from.all::<u64, Vec<u64>>()?.into_iter().map(|at| at as usize).collect(),
        })
    }
}

fn positions(of: &[usize]) -> Vec<u64> {
    of.iter().map(|at| *at as u64).collect()
}

fn read_positions(from: &mut Source<'_>) -> io::Result<Vec<usize>> {
    Ok(from.array::<u64>()?.into_iter().map(|at| at as usize).collect())
}

impl Factors {
    fn save(&self, to: &mut Sink<'_>) -> io::Result<()> {
        let Self { tree: Tree { nodes, order, roots }, responses, scales } = self;
        to.array(scales)?;
        to.array(&responses.concat())?;
        to.array(&positions(order))?;
        to.array(&positions(roots))?;
        to.records(nodes)
    }

    fn load(lines: usize, from: &mut Source<'_>) -> io::Result<Self> {
        let scales: Vec<f64> = from.array()?;
        let responses: Vec<Complex64> = from.array()?;
        let (order, roots) = (read_positions(from)?, read_positions(from)?);
        let nodes = from.records()?;
        if lines == 0 || responses.len() != lines * scales.len() {
            return Err(invalid("responses of other lines"));
        }
        let responses = responses.chunks_exact(lines).map(<[Complex64]>::to_vec).collect();
        Ok(Self { tree: Tree { nodes, order, roots }, responses, scales })
    }

    /// Whether these are of so many factors, and every position that is stored exists.
    fn fit(&self, factors: usize, lines: usize) -> bool {
        let Self { tree: Tree { nodes, order, roots }, responses: _, scales } = self;
        let node = |(at, node): (usize, &Node)| {
            let Node { centre, directions, remainder, radius, members, children, .. } = node;
            [centre.len(), remainder.len(), radius.len()] == [lines; 3]
                && directions.len() == DIRECTIONS * lines
                && members.start < members.end
                && members.end <= order.len()
                // Clusters come before those that divide them, so a walk down ends.
                && children.iter().all(|child| *child > at && *child < nodes.len())
        };
        scales.len() == factors
            && order.len() == factors
            && order.iter().all(|factor| *factor < factors)
            && roots.iter().all(|root| *root < nodes.len())
            && nodes.iter().enumerate().all(node)
    }
}

impl Ranges {
    fn save(&self, to: &mut Sink<'_>) -> io::Result<()> {
        let Self { denominators, numerators, columns, table } = self;
        to.array(denominators)?;
        to.array(numerators)?;
        to.pod(*columns as u64)?;
        to.array(table)
    }

    fn load(from: &mut Source<'_>) -> io::Result<Self> {
        let (denominators, numerators) = (from.array()?, from.array()?);
        Ok(Self { denominators, numerators, columns: from.pod::<u64>()? as usize, table: from.array()? })
    }

    fn fit(&self, denominators: &Tree, numerators: &Tree) -> bool {
        let columns = self.columns.max(1);
        let rows = self.table.len() / columns;
        self.table.len() == rows * columns
            && self.denominators.len() == denominators.nodes.len()
            && self.numerators.len() == numerators.nodes.len()
            && self.denominators.iter().all(|row| (*row as usize) < rows)
            && self.numerators.iter().all(|column| (*column as usize) < columns)
    }
}

impl FactorTrees {
    /// Writes what [`FactorTrees::load`] reads.
    ///
    /// # Errors
    /// Those of the sink.
    pub(crate) fn save(&self, to: &mut Sink<'_>) -> io::Result<()> {
        let Self { denominators, numerators, feedforward, ranges, without_feedback, gain_step } = self;
        to.pod(without_feedback.map_or([0; 2], |(count, first)| [count, first as u64]))?;
        to.pod(*gain_step)?;
        [denominators, numerators, feedforward].into_iter().try_for_each(|factors| factors.save(to))?;
        ranges.save(to)
    }

    /// Reads what [`FactorTrees::save`] wrote of a pool at the lines of a problem. Whether it is that has to be known
    /// from elsewhere; what no search could use is refused.
    ///
    /// # Errors
    /// Those of the source.
    pub(crate) fn load(problem: &Problem, pool: &Pool, from: &mut Source<'_>) -> io::Result<Self> {
        let lines = problem.lines().len();
        let [count, first] = from.pod::<[u64; 2]>()?;
        let without_feedback = (count > 0).then_some((count, first as usize));
        let gain_step = from.pod()?;
        let denominators = Factors::load(lines, from)?;
        let numerators = Factors::load(lines, from)?;
        let feedforward = Factors::load(lines, from)?;
        let ranges = Ranges::load(from)?;
        let table = pool.feedback();
        let fit = denominators.fit(table.denominators().len(), lines)
            && numerators.fit(table.numerators().len(), lines)
            && feedforward.fit(pool.feedforward().len(), lines)
            && ranges.fit(&denominators.tree, &numerators.tree)
            && without_feedback.is_none_or(|(_, first)| first < table.denominators().len());
        if !fit {
            return Err(invalid("trees that do not fit the pool"));
        }
        Ok(Self { denominators, numerators, feedforward, ranges, without_feedback, gain_step })
    }
}
