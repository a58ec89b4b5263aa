//! The feedforward denominators, in nested blocks of neighbours.

use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::Pool;
use crate::identify::problem::Problem;
use crate::identify::search::factored::tree::{Deviation, Tree};
use crate::identify::search::simd::lanes::Real;
use num_complex::Complex64;

/// Largest number of denominators in a block: a bit of a mask for each.
pub(crate) const LARGEST: usize = 64;

/// Coefficients of a monic denominator that may vary.
pub(crate) const FREE: usize = 2;

/// A block of denominators around a centre `D`: each member is `D (1 + Σ_m offset_m φ_m)` with `φ_m = x^m/D`.
#[derive(Debug)]
pub(crate) struct Block {
    pub offsets: Vec<[f64; FREE]>,
    /// Largest modulus of each offset.
    pub reach: [f64; FREE],
    /// One and the largest `Σ |offset φ|` at a line.
    pub spread: f64,
    /// Largest |1/D|.
    pub unit: f64,
    /// Per line, what the kernel reads.
    pub rows: Vec<Row>,
    /// Per line: products of the basis functions over |D|²: the lower triangle of the real half, then of the imaginary
    /// half.
    pub products: Vec<f64>,
}

impl Block {
    pub(crate) fn is_single(&self) -> bool {
        self.offsets.len() == 1
    }
}

/// The members of a block, and the blocks that divide it: what a walk asks for at every step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Division {
    /// Members, a range of [`Denominators::order`].
    pub first: u32,
    count: u32,
    parts: [u32; MOST_PARTS],
    filled: u32,
}

/// The most blocks that divide one.
const MOST_PARTS: usize = 4;

impl Division {
    fn new(members: &std::ops::Range<usize>) -> Self {
        Self { first: members.start as u32, count: members.len() as u32, parts: [0; MOST_PARTS], filled: 0 }
    }

    fn push(&mut self, part: u32) {
        self.parts[self.filled as usize] = part;
        self.filled += 1;
    }

    /// None for a single denominator.
    pub(crate) fn parts(&self) -> &[u32] {
        &self.parts[..self.filled as usize]
    }

    pub(crate) fn is_single(&self) -> bool {
        self.count == 1
    }

    /// A bit for each member.
    pub(crate) fn everything(&self) -> u64 {
        u64::MAX >> (LARGEST as u32 - self.count)
    }

    /// The place in the middle of the members.
    pub(crate) fn middle(&self) -> usize {
        (self.first + self.count / 2) as usize
    }
}

/// A block at a line.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    /// 1/D.
    pub inverse: Complex64,
    /// φ of the highest free power first.
    pub directions: [Complex64; FREE],
    /// Largest modulus of `Σ offset φ`.
    pub radius: f64,
}

/// What the kernel for clusters reads of the blocks, in one of the precisions.
#[derive(Debug)]
pub(crate) struct Table<N> {
    /// Of a block per line: Re and Im of 1/D, in units of its largest modulus, and the largest |δ|.
    rows: Vec<[N; 3]>,
    lines: usize,
    /// Per block, largest modulus of each offset in the inverse unit; one and the largest `Σ |offset φ|`.
    reach: Vec<[N; FREE]>,
    spread: Vec<N>,
    /// Offsets of the members, in the inverse unit, as many together as [`MEMBER_LANES`]; and where a block's begin.
    offsets: Vec<[[N; MEMBER_LANES]; FREE]>,
    begins: Vec<usize>,
}

/// Members of a block whose bounds are computed together.
pub(crate) const MEMBER_LANES: usize = 16;

/// The rows, the reach and the spread of a block.
pub(crate) type Entry<'a, N> = (&'a [[N; 3]], [N; FREE], N);

impl<N: Real> Table<N> {
    fn new(blocks: &[Block], lines: usize) -> Self {
        let row = |block: &Block, row: &Row| {
            let inverse = row.inverse / block.unit;
            [N::nearest(inverse.re), N::nearest(inverse.im), N::above(row.radius)]
        };
        let (mut offsets, mut begins) = (Vec::new(), vec![0]);
        for block in blocks {
            offsets.extend(block.offsets.chunks(MEMBER_LANES).map(|chunk| {
                std::array::from_fn(|m| {
                    std::array::from_fn(|j| N::nearest(chunk[j.min(chunk.len() - 1)][m] * block.unit))
                })
            }));
            begins.push(offsets.len());
        }
        Self {
            offsets,
            begins,
            rows: blocks.iter().flat_map(|block| block.rows.iter().map(move |r| row(block, r))).collect(),
            lines,
            reach: blocks.iter().map(|block| block.reach.map(|r| N::above(r * block.unit))).collect(),
            spread: blocks.iter().map(|block| N::above(block.spread)).collect(),
        }
    }

    /// Offsets of a block's members; those left over repeat the last.
    pub(crate) fn offsets(&self, block: u32) -> &[[[N; MEMBER_LANES]; FREE]] {
        &self.offsets[self.begins[block as usize]..self.begins[block as usize + 1]]
    }

    pub(crate) fn entry(&self, block: u32) -> Entry<'_, N> {
        let at = block as usize;
        (&self.rows[at * self.lines..(at + 1) * self.lines], self.reach[at], self.spread[at])
    }
}

/// A precision in which a table is kept.
pub(crate) trait Tabled: Real {
    fn table(of: &Denominators) -> &Table<Self>;
}

impl Tabled for f32 {
    fn table(of: &Denominators) -> &Table<Self> {
        &of.single_precision
    }
}

impl Tabled for f64 {
    fn table(of: &Denominators) -> &Table<Self> {
        &of.double_precision
    }
}

/// All of them.
#[derive(Debug)]
pub(crate) struct Denominators {
    single_precision: Table<f32>,
    double_precision: Table<f64>,
    pub blocks: Vec<Block>,
    pub divisions: Vec<Division>,
    pub roots: Vec<u32>,
    /// Positions of the pool's denominators, so that the members of a block are adjacent.
    pub order: Vec<u32>,
    /// The block of a single denominator, per place in `order`.
    pub single: Vec<u32>,
    /// Per line, what part of `Σ |1/D|²` a denominator has there on average.
    pub typical: Vec<f64>,
    /// Values of the basis functions, per line: the real half first.
    pub functions: Vec<f64>,
    /// Per line, the powers x^m that go with the free coefficients; zero where there are fewer.
    pub powers: Vec<[Complex64; FREE]>,
    pub halves: [usize; 2],
}

/// The free coefficients of a pool's denominators once they are monic, highest power first; `None` where one has no
/// leading coefficient or more free ones than the kernel takes.
fn monic(pool: &Pool) -> Option<Vec<[f64; FREE]>> {
    pool.feedforward()
        .iter()
        .map(|factor| {
            let (lead, rest) = factor.coefficients.split_first()?;
            if *lead == 0.0 || rest.len() > FREE {
                return None;
            }
            let mut free = [0.0; FREE];
            for (slot, c) in free[FREE - rest.len()..].iter_mut().zip(rest) {
                *slot = c / lead;
            }
            Some(free)
        })
        .collect()
}

/// Whether the blocks can hold this pool's denominators.
pub(crate) fn can_hold(pool: &Pool) -> bool {
    monic(pool).is_some()
}

impl Denominators {
    /// `None` where [`can_hold`] says no.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub(crate) fn new(problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Option<Self>, Stopped> {
        let Some(coefficients) = monic(pool) else { return Ok(None) };
        let responses: Vec<Vec<Complex64>> =
            pool.feedforward().iter().map(|d| problem.at_lines(&d.coefficients)).collect();
        let order: Vec<u32> =
            Tree::new(&responses, Deviation::Logarithm, 1, ctl)?.order.into_iter().map(|at| at as u32).collect();
        let basis = problem.basis();
        let halves = [basis.even().len(), basis.odd().len()];
        let mut functions = Vec::new();
        for k in 0..problem.lines().len() {
            functions.extend(basis.even().values.iter().chain(&basis.odd().values).map(|v| v[k]));
        }
        let degree = pool.feedforward().first().map_or(0, |d| d.coefficients.len() - 1);
        let powers = (0..=degree).map(|m| {
            let mut power = vec![0.0; degree + 1 - m];
            power[0] = 1.0;
            problem.at_lines(&power)
        });
        let powers: Vec<Vec<Complex64>> = powers.collect();
        let mut typical = vec![0.0; problem.lines().len()];
        for response in &responses {
            let shares: Vec<f64> = response.iter().map(|d| 1.0 / d.norm_sqr()).collect();
            let sum = shares.iter().sum::<f64>() * responses.len() as f64;
            typical.iter_mut().zip(shares).for_each(|(typical, share)| *typical += share / sum);
        }
        let tangent = |m: usize, k: usize| {
            let power = (m + degree).checked_sub(FREE).and_then(|at| powers.get(at + 1));
            power.map_or(Complex64::ZERO, |x| x[k])
        };
        let tangents = (0..problem.lines().len()).map(|k| std::array::from_fn(|m| tangent(m, k))).collect();
        let mut all = Self {
            single_precision: Table::new(&[], 0),
            double_precision: Table::new(&[], 0),
            blocks: Vec::new(),
            divisions: Vec::new(),
            roots: Vec::new(),
            single: vec![0; order.len()],
            order,
            typical,
            functions,
            powers: tangents,
            halves,
        };
        let builder = BlockBuilder { coefficients: &coefficients, powers: &powers };
        all.divide(&builder, 0..all.order.len(), true);
        let lines = problem.lines().len();
        all.single_precision = Table::new(&all.blocks, lines);
        all.double_precision = Table::new(&all.blocks, lines);
        Ok(Some(all))
    }

    /// Halves until a block can hold what is left, then makes blocks of four parts each.
    fn divide(&mut self, builder: &BlockBuilder<'_>, members: std::ops::Range<usize>, root: bool) -> Option<u32> {
        if members.is_empty() {
            return None;
        }
        let middle = (members.start + members.end) / 2;
        if members.len() > LARGEST {
            self.divide(builder, members.start..middle, true);
            self.divide(builder, middle..members.end, true);
            return None;
        }
        let block = builder.block(self, members.clone());
        let id = self.blocks.len() as u32;
        if members.len() == 1 {
            self.single[members.start] = id;
        }
        self.blocks.push(block);
        self.divisions.push(Division::new(&members));
        if root {
            self.roots.push(id);
        }
        if members.len() > 1 {
            let halves = [members.start..middle, middle..members.end];
            for half in halves {
                let middle = (half.start + half.end) / 2;
                let quarters = if half.len() > 1 { vec![half.start..middle, middle..half.end] } else { vec![half] };
                for quarter in quarters {
                    if let Some(part) = self.divide(builder, quarter, false) {
                        self.divisions[id as usize].push(part);
                    }
                }
            }
        }
        Some(id)
    }
}

struct BlockBuilder<'a> {
    coefficients: &'a [[f64; FREE]],
    /// Values of x^n, …, x, 1 at the lines, for denominators of degree n.
    powers: &'a [Vec<Complex64>],
}

impl BlockBuilder<'_> {
    fn block(&self, all: &Denominators, members: std::ops::Range<usize>) -> Block {
        let of = |at: usize| &self.coefficients[all.order[at] as usize];
        let mut centre = [0.0; FREE];
        for at in members.clone() {
            centre.iter_mut().zip(of(at)).for_each(|(sum, c)| *sum += c);
        }
        centre.iter_mut().for_each(|c| *c /= members.len() as f64);
        if members.len() == 1 {
            centre = *of(members.start);
        }
        let offsets: Vec<[f64; FREE]> =
            members.clone().map(|at| std::array::from_fn(|m| of(at)[m] - centre[m])).collect();
        let reach: [f64; FREE] = std::array::from_fn(|m| offsets.iter().map(|o| o[m].abs()).fold(0.0, f64::max));
        let (mut spread, mut unit) = (1.0_f64, 0.0_f64);
        let degree = self.powers.len() - 1;
        let lines = self.powers[0].len();
        let [p, q] = all.halves;
        let (mut rows, mut products) = (Vec::with_capacity(lines), Vec::new());
        for k in 0..lines {
            let mut d = self.powers[0][k];
            for (m, c) in centre[FREE - degree.min(FREE)..].iter().enumerate() {
                d += c * self.powers[m + 1][k];
            }
            let inverse = d.inv();
            let directions = all.powers[k].map(|x| x * inverse);
            let deviation = |o: &[f64; FREE]| -> f64 {
                o.iter().zip(&directions).map(|(o, phi)| phi * o).sum::<Complex64>().norm()
            };
            let radius = offsets.iter().map(deviation).fold(0.0, f64::max) * (1.0 + 1e-12);
            let moduli = directions.iter().zip(&reach).map(|(phi, r): (&Complex64, &f64)| phi.norm() * r).sum::<f64>();
            spread = spread.max(1.0 + moduli);
            rows.push(Row { inverse, directions, radius });
            let u = inverse.norm_sqr();
            unit = unit.max(u.sqrt());
            let functions = &all.functions[k * (p + q)..(k + 1) * (p + q)];
            for half in [&functions[..p], &functions[p..]] {
                for i in 0..half.len() {
                    products.extend((0..=i).map(|j| half[i] * half[j] * u));
                }
            }
        }
        Block { offsets, reach, spread, unit, rows, products }
    }
}
