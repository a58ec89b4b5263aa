//! Every feedback controller of a pool, in nested clusters of like sensitivities.
//!
//! What a controller does to a response is its sensitivity `S = 1/(1 + G Gfb)` at the lines, and controllers of very different poles,
//! zeros and gains have nearly the same: some thousand clusters within a third of their centre hold the 31 million of appendix B. Members
//! of a cluster deviate by `κ = S_c/S − 1 = Σ_i t_i v_i + ρ` from its centre, with real t, few directions v and a small rest. Clusters
//! depend on plant, lines and pool, not on what was measured: all trials of a study share them.

use super::deviations::{Extent, Pass, Split, Splitter, Widest};
use super::group::{ALL, LANES};
use super::principal::Part;
use crate::identify::pool::{Feedback, Pool};
use crate::identify::problem::Problem;
use crate::num::{Ctl, Stopped};
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;

/// Clusters of so few members, or of so small a size, are not divided.
const LEAF: usize = 64;
const SMALL: f64 = 0.02;

/// Leaves above this size are looked at member by member.
const ROUGH: f64 = 0.03;

/// The most members of such a leaf: more are divided even where they are alike.
const MOST: usize = 256;

/// Clusters above this size are divided before anything is known of them.
pub(super) const START: f64 = 0.7;

/// Bits of a member that hold the position of its gain.
const GAIN_BITS: u32 = 7;

/// The most controllers that are listed (8 bytes each while they are sorted).
const LARGEST_LIST: u64 = 50_000_000;

/// Clusters that are divided by several threads.
const SHARED: usize = 1 << 16;

/// Members from which a cluster's directions and thresholds are taken.
const SAMPLE: usize = 256;
const LARGE_SAMPLE: usize = 2048;

/// Looks at the stop flag once for so many members.
const PER_CHECK: usize = 1 << 15;

/// A cluster of feedback controllers, in as little memory as bounds allow: there are many.
#[derive(Debug)]
pub(super) struct Cell {
    /// `1/S` of the centre at each line, which need not be a member's.
    centre: Box<[Complex32]>,
    /// Principal directions, one after another.
    directions: Box<[Part]>,
    /// Range of the coordinate along each.
    ranges: [[f32; 2]; ALL],
    /// Three values a line: see [`Profile`].
    profile: Box<[[f32; 3]]>,
    /// Largest norm of what all directions leave over, in units of [`Profile::scale`].
    pub reach: f32,
    /// The members, a range of [`Cells::members`].
    pub members: std::ops::Range<u32>,
    /// Clusters that divide this one; none in a leaf.
    pub children: Box<[u32]>,
    /// Whether the members of a leaf differ too much to be bounded together: beside poles and zeros of the loop on a line.
    pub rough: bool,
}

/// How far a cluster extends at a line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Profile {
    /// Largest |κ|, and largest rest behind the leading directions.
    pub radius: f64,
    pub remainder: f64,
    /// What a member typically leaves over behind all directions.
    pub scale: f64,
}

/// The next number in single precision that is not below.
fn above(x: f64) -> f32 {
    let single = x as f32;
    if f64::from(single) < x { single.next_up() } else { single }
}

impl Cell {
    fn new(split: &Split, extent: &Extent, members: std::ops::Range<u32>) -> Self {
        let single = |x: &Complex64| Complex32::new(x.re as f32, x.im as f32);
        let profile = |k: usize| [above(extent.radius[k]), above(extent.remainder[k]), split.scale[k] as f32];
        // The scale is rounded to the nearest, by less than 2⁻²³ of itself.
        let reach = above(extent.reach * (1.0 + f64::from(f32::EPSILON)));
        Self {
            centre: split.centre.iter().map(single).collect(),
            directions: split.directions.iter().copied().map(Part::new).collect(),
            ranges: std::array::from_fn(|m| [-above(-extent.low[m]), above(extent.high[m])]),
            profile: (0..split.centre.len()).map(profile).collect(),
            reach,
            members,
            children: Box::default(),
            rough: extent.size() > ROUGH,
        }
    }

    pub(super) fn centre(&self, line: usize) -> Complex64 {
        let c = self.centre[line];
        Complex64::new(f64::from(c.re), f64::from(c.im))
    }

    pub(super) fn direction(&self, m: usize, line: usize) -> Complex64 {
        self.directions[m * self.centre.len() + line].value()
    }

    pub(super) fn profile(&self, line: usize) -> Profile {
        let [radius, remainder, scale] = self.profile[line].map(f64::from);
        Profile { radius, remainder, scale }
    }

    pub(super) fn range(&self, m: usize) -> [f64; 2] {
        self.ranges[m].map(f64::from)
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
    /// `1 + L` of a member at each line.
    #[inline(always)]
    fn response(&self, member: u32) -> impl Iterator<Item = Complex64> {
        let row = &self.rows[(member >> GAIN_BITS) as usize];
        let gain = row.unit * self.gains[(member & ((1 << GAIN_BITS) - 1)) as usize];
        let (d, n) = (&self.denominators[row.denominator as usize], &self.numerators[row.numerator as usize]);
        d.iter().zip(n).map(move |(d, n)| 1.0 + gain * (d * n))
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
            let table = self.table();
            let response = table.response(self.members[place as usize]);
            super::deviations::put(into, lane, response);
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
        let Measured { split, extent, codes } = measured;
        let size = extent.size();
        let mut grown = vec![Cell::new(&split, &extent, first..first + members.len() as u32)];
        if members.len() <= self.leaf || (size <= SMALL && members.len() <= MOST) {
            return Ok(grown);
        }
        let Some(counts) = sort(members, scratch, split.parts(), &codes) else { return Ok(grown) };
        drop((split, extent, codes));
        let each: Vec<Result<Grown, Stopped>> = parts(members, scratch, &counts, first)
            .into_par_iter()
            .map(|(m, s, first)| {
                let measured = self.measure(m, self.splitter(m).by_coordinates(self.halvings(m)))?;
                self.grow(m, s, first, measured)
            })
            .collect();
        let mut children = Vec::with_capacity(each.len());
        for tree in each {
            let base = grown.len() as u32;
            children.push(base);
            grown.extend(tree?.into_iter().map(|mut cell| {
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
        Ok(Measured { split, extent, codes })
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
