//! Every feedback controller of a pool, in nested clusters of like sensitivities.
//!
//! What a controller does to a response is its sensitivity `S = 1/(1 + G Gfb)` at the lines, and controllers of very different poles,
//! zeros and gains have nearly the same: some thousand clusters within a third of their centre hold the 31 million of appendix B. Members
//! of a cluster deviate by `κ = S_c/S − 1 = Σ_i t_i v_i + ρ` from its centre, with real t, few directions v and a small rest. Clusters
//! depend on plant, lines and pool, not on what was measured: all trials of a study share them.

use super::deviations::{Extent, Pass, Split, Splitter};
use super::group::{DIRECTIONS, LANES};
use crate::identify::pool::{Feedback, Pool};
use crate::identify::problem::Problem;
use crate::num::{Ctl, Stopped};
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;

/// Clusters of so few members, or of so small a size, are not divided.
const LEAF: usize = 16;
const SMALL: f64 = 0.02;

/// Leaves above this size are looked at member by member.
const ROUGH: f64 = 0.03;

/// The most members of such a leaf: more are divided even where they are alike.
const MOST: usize = 1 << 12;

/// Clusters above this size are divided before anything is known of them.
pub(super) const START: f64 = 0.7;

/// Bits of a member that hold the position of its gain.
const GAIN_BITS: u32 = 7;

/// The most controllers that are listed (8 bytes each while they are sorted).
const LARGEST_LIST: u64 = 50_000_000;

/// Clusters that are divided by several threads.
const SHARED: usize = 1 << 16;

/// Looks at the stop flag once for so many members.
const PER_CHECK: usize = 1 << 15;

/// A cluster of feedback controllers.
#[derive(Debug)]
pub(super) struct Cell {
    /// `1/S` of the centre at each line, which need not be a member's.
    pub centre: Box<[Complex64]>,
    /// Principal directions, one after another.
    directions: Box<[Complex32]>,
    /// Range of the coordinate along each.
    pub low: [f64; DIRECTIONS],
    pub high: [f64; DIRECTIONS],
    /// Largest |κ| per line, and largest rest.
    pub radius: Box<[f64]>,
    pub remainder: Box<[f64]>,
    /// The members, a range of [`Cells::members`].
    pub members: std::ops::Range<u32>,
    /// Clusters that divide this one; none in a leaf.
    pub children: Vec<u32>,
    /// Whether the members of a leaf differ too much to be bounded together: beside poles and zeros of the loop on a line.
    pub rough: bool,
}

impl Cell {
    pub(super) fn direction(&self, m: usize, line: usize) -> Complex64 {
        let v = self.directions[m * self.centre.len() + line];
        Complex64::new(f64::from(v.re), f64::from(v.im))
    }
}

/// Controllers that share denominator and numerator.
#[derive(Debug, Clone, Copy)]
struct Row {
    denominator: u32,
    numerator: u32,
    /// What turns a listed gain into the factor in front of the numerator.
    unit: f64,
}

/// The clusters of a pool at the lines of a problem.
#[derive(Debug)]
pub struct Cells {
    pub(super) nodes: Vec<Cell>,
    pub(super) roots: Vec<u32>,
    members: Vec<u32>,
    rows: Vec<Row>,
    gains: Vec<f64>,
    /// `G/D` of each denominator, and each numerator, at the lines.
    denominators: Vec<Vec<Complex64>>,
    numerators: Vec<Vec<Complex64>>,
    /// How many denominators make a stable loop without feedback, and the first of them.
    pub(super) without_feedback: Option<(u64, usize)>,
    pub(super) feedforward: super::denominators::Denominators,
}

/// Whether the controllers of this pool can be listed.
#[must_use]
pub fn can_list(pool: &Pool) -> bool {
    let table = pool.feedback();
    let rows = table.denominators().len() as u64 * table.numerators().len() as u64;
    table.len() <= LARGEST_LIST
        && table.gains().len() <= 1 << GAIN_BITS
        && rows < 1 << (32 - GAIN_BITS)
        && super::denominators::can_hold(pool)
}

/// What members are computed from.
struct Table<'a> {
    rows: &'a [Row],
    gains: &'a [f64],
    denominators: &'a [Vec<Complex64>],
    numerators: &'a [Vec<Complex64>],
}

impl Table<'_> {
    #[inline(always)]
    fn response(&self, member: u32, mut put: impl FnMut(usize, Complex64)) {
        let row = &self.rows[(member >> GAIN_BITS) as usize];
        let gain = row.unit * self.gains[(member & ((1 << GAIN_BITS) - 1)) as usize];
        let (d, n) = (&self.denominators[row.denominator as usize], &self.numerators[row.numerator as usize]);
        for (k, (d, n)) in d.iter().zip(n).enumerate() {
            put(k, 1.0 + gain * (d * n));
        }
    }
}

impl Cells {
    /// Lists and clusters the controllers. The measured responses of the problem are not used. `None` where [`can_list`] says no.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn new(problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Option<Self>, Stopped> {
        Self::with_leaves(problem, pool, LEAF, ctl)
    }

    /// As [`Cells::new`], dividing clusters of more than `leaf` members: the answer of a search is the same for any.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn with_leaves(problem: &Problem, pool: &Pool, leaf: usize, ctl: &Ctl) -> Result<Option<Self>, Stopped> {
        if !can_list(pool) {
            return Ok(None);
        }
        let Some(feedforward) = super::denominators::Denominators::new(problem, pool, ctl)? else { return Ok(None) };
        let table = pool.feedback();
        let plant: Vec<Complex64> = problem.lines().iter().map(|line| line.plant).collect();
        let denominators: Vec<Vec<Complex64>> = table
            .denominators()
            .par_iter()
            .map(|d| problem.reciprocal_at_lines(&d.coefficients).iter().zip(&plant).map(|(d, g)| g * d).collect())
            .collect();
        let numerators: Vec<Vec<Complex64>> =
            table.numerators().iter().map(|n| problem.at_lines(&n.coefficients)).collect();
        let listed = (0..denominators.len())
            .into_par_iter()
            .map(|denominator| {
                let (mut rows, mut positions) = (Vec::new(), Vec::new());
                let mut zero = false;
                table.walk_denominator(denominator, ctl, |row| {
                    match row.numerator {
                        Some(numerator) => {
                            let new =
                                Row { denominator: denominator as u32, numerator: numerator as u32, unit: row.unit };
                            let before = positions.len();
                            positions.extend(row.positions().iter().map(|p| *p as u8));
                            rows.push((new, positions.len() - before));
                        }
                        None => zero = true,
                    }
                    Ok(())
                })?;
                Ok((rows, positions, zero))
            })
            .collect::<Result<Vec<_>, Stopped>>()?;
        let mut without_feedback = None;
        let (mut rows, mut members) = (Vec::new(), Vec::with_capacity(table.len() as usize));
        for (denominator, (listed, positions, zero)) in listed.into_iter().enumerate() {
            if zero {
                let (count, first) = without_feedback.unwrap_or((0, denominator));
                without_feedback = Some((count + 1, first));
            }
            let mut positions = positions.into_iter();
            for (row, count) in listed {
                let base = (rows.len() as u32) << GAIN_BITS;
                members.extend(positions.by_ref().take(count).map(|p: u8| base | u32::from(p)));
                rows.push(row);
            }
        }
        let gains = table.gains().to_vec();
        let grower = Grower {
            table: Table { rows: &rows, gains: &gains, denominators: &denominators, numerators: &numerators },
            lines: plant.len(),
            leaf: leaf.max(1),
            ctl,
        };
        let (nodes, roots) = if members.is_empty() { (Vec::new(), Vec::new()) } else { grower.forest(&mut members)? };
        Ok(Some(Self { nodes, roots, members, rows, gains, denominators, numerators, without_feedback, feedforward }))
    }

    fn table(&self) -> Table<'_> {
        Table { rows: &self.rows, gains: &self.gains, denominators: &self.denominators, numerators: &self.numerators }
    }

    /// `1 + L` of up to eight members, by their places in the order of the clusters: per line eight real and eight imaginary parts, of
    /// which those left over repeat the last.
    pub(super) fn responses(&self, places: &[u32], into: &mut [f64]) {
        for lane in 0..LANES {
            let place = places[lane.min(places.len() - 1)];
            self.table().response(self.members[place as usize], |k, x| {
                into[2 * LANES * k + lane] = x.re;
                into[2 * LANES * k + LANES + lane] = x.im;
            });
        }
    }

    /// The controller of a member.
    pub(super) fn feedback(&self, place: usize) -> Feedback {
        let member = self.members[place];
        let row = &self.rows[(member >> GAIN_BITS) as usize];
        let position = (member & ((1 << GAIN_BITS) - 1)) as usize;
        Feedback {
            denominator: row.denominator as usize,
            numerator: Some(row.numerator as usize),
            gain: self.gains[position] * row.unit,
            gain_position: Some(position),
        }
    }

    /// The coordinates of a cluster's members, eight members at a time: `DIRECTIONS` rows of eight.
    pub(super) fn coordinates(&self, cell: &Cell, into: &mut Vec<f64>) {
        let members = &self.members[cell.members.start as usize..cell.members.end as usize];
        let mut pass = Pass::new(cell.centre.len());
        into.clear();
        for eight in members.chunks(LANES) {
            pass.load(eight.len(), |lane, put| self.table().response(eight[lane], put));
            pass.coordinates(&cell.centre, &cell.directions, into);
        }
    }
}

struct Grower<'a> {
    table: Table<'a>,
    lines: usize,
    leaf: usize,
    ctl: &'a Ctl,
}

/// Clusters whose children are counted from the beginning of their own list.
type Grown = Vec<Cell>;

impl Grower<'_> {
    /// The clusters, and the largest ones worth bounding.
    fn forest(&self, members: &mut [u32]) -> Result<(Vec<Cell>, Vec<u32>), Stopped> {
        let mut scratch = vec![0_u32; members.len()];
        let trees = self.scatter(members, &mut scratch, 0)?;
        drop(scratch);
        let (mut nodes, mut roots): (Vec<Cell>, Vec<u32>) = (Vec::new(), Vec::new());
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
            let split = splitter.by_coordinates(self.halvings(members));
            let extent = self.extent(members, &split)?;
            size = extent.size();
            if size <= START || members.len() <= self.leaf {
                return Ok(vec![self.grow(members, scratch, first, split, extent)?]);
            }
        }
        let halvings = if size > 3.0 * START && splitter.size > START {
            3
        } else if size > 1.8 * START && splitter.size > START {
            2
        } else {
            1
        };
        let Some(counts) = self.sort(members, scratch, &splitter.by_logarithms(halvings))? else {
            let split = splitter.by_coordinates(self.halvings(members));
            let extent = self.extent(members, &split)?;
            return Ok(vec![self.grow(members, scratch, first, split, extent)?]);
        };
        let parts = parts(members, scratch, &counts, first);
        let each: Vec<_> = parts.into_par_iter().map(|(m, s, first)| self.scatter(m, s, first)).collect();
        Ok(each.into_iter().collect::<Result<Vec<_>, Stopped>>()?.into_iter().flatten().collect())
    }

    /// A cluster and everything inside it; the first of the list is the cluster itself.
    fn grow(
        &self,
        members: &mut [u32],
        scratch: &mut [u32],
        first: u32,
        split: Split,
        extent: Extent,
    ) -> Result<Grown, Stopped> {
        let size = extent.size();
        let mut grown = vec![Cell {
            centre: split.centre.clone().into(),
            directions: split.directions.clone().into(),
            low: extent.low,
            high: extent.high,
            radius: extent.radius.into(),
            remainder: extent.remainder.into(),
            members: first..first + members.len() as u32,
            children: Vec::new(),
            rough: size > ROUGH,
        }];
        if members.len() <= self.leaf || (size <= SMALL && members.len() <= MOST) {
            return Ok(grown);
        }
        let Some(counts) = self.sort(members, scratch, &split)? else { return Ok(grown) };
        let each: Vec<Result<Grown, Stopped>> = parts(members, scratch, &counts, first)
            .into_par_iter()
            .map(|(m, s, first)| {
                let split = self.splitter(m).by_coordinates(self.halvings(m));
                let extent = self.extent(m, &split)?;
                self.grow(m, s, first, split, extent)
            })
            .collect();
        for tree in each {
            let base = grown.len() as u32;
            grown[0].children.push(base);
            grown.extend(tree?.into_iter().map(|mut cell| {
                cell.children.iter_mut().for_each(|child| *child += base);
                cell
            }));
        }
        Ok(grown)
    }

    /// How often a cluster is halved: into eight parts, or fewer where these would be smaller than leaves need to be.
    fn halvings(&self, members: &[u32]) -> usize {
        (members.len() / self.leaf).max(2).ilog2().min(3) as usize
    }

    /// Centre, directions and thresholds from a sample.
    fn splitter(&self, members: &[u32]) -> Splitter {
        let most = match members.len() {
            0..=1_000 => 24,
            1_001..=SHARED => 128,
            _ => 2048,
        };
        let step = members.len().div_ceil(most).max(1);
        let sample: Vec<Vec<Complex64>> = members
            .iter()
            .step_by(step)
            .map(|member| {
                let mut response = vec![Complex64::ZERO; self.lines];
                self.table.response(*member, |k, x| response[k] = x);
                response
            })
            .collect();
        Splitter::new(sample)
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

    fn extent(&self, members: &[u32], split: &Split) -> Result<Extent, Stopped> {
        let each = |chunk: &[u32], pass: &mut Pass| {
            let mut extent = Extent::none(self.lines);
            for eight in chunk.chunks(LANES) {
                pass.load(eight.len(), |lane, put| self.table.response(eight[lane], put));
                pass.extend(&split.centre, &split.directions, &mut extent);
            }
            extent
        };
        let all = self.over(members, each, Extent::join)?;
        Ok(all.map_or_else(|| Extent::none(self.lines), Extent::rounded))
    }

    /// Sorts the members by their part; `None` where they all fall into one.
    fn sort(&self, members: &mut [u32], scratch: &mut [u32], split: &Split) -> Result<Option<Vec<usize>>, Stopped> {
        let each = |chunk: &[u32], pass: &mut Pass| {
            let mut codes = Vec::with_capacity(chunk.len());
            for eight in chunk.chunks(LANES) {
                pass.load(eight.len(), |lane, put| self.table.response(eight[lane], put));
                pass.codes(split, eight.len(), &mut codes);
            }
            codes
        };
        let join = |mut a: Vec<u8>, b: Vec<u8>| {
            a.extend(b);
            a
        };
        let codes = self.over(members, each, join)?.unwrap_or_default();
        let mut counts = vec![0_usize; split.parts()];
        codes.iter().for_each(|code| counts[usize::from(*code)] += 1);
        if counts.contains(&members.len()) {
            return Ok(None);
        }
        let mut next: Vec<usize> = counts
            .iter()
            .scan(0, |sum, count| {
                let before = *sum;
                *sum += count;
                Some(before)
            })
            .collect();
        for (member, code) in members.iter().zip(&codes) {
            let place = &mut next[usize::from(*code)];
            scratch[*place] = *member;
            *place += 1;
        }
        members.copy_from_slice(scratch);
        Ok(Some(counts))
    }
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
