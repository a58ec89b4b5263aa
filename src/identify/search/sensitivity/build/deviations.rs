//! How responses deviate from a centre: their coordinates along directions, and into which part of a division they
//! fall.
//!
//! Deviations are computed in double precision, and kept and taken apart in single precision.
//! [`Extent`](super::extent::Extent) makes up for that.

use super::extent::Widest;
use super::line_lanes::{LINE_LANES, LineLanes, Pair, blocks, mul_add, pairs};
use super::members::{Place, Table};
use super::size::{ALL, DIRECTIONS};
use num_complex::Complex64;
use pulp::{Simd, WithSimd};

/// Members whose numbers stay in the nearest cache.
pub(crate) const PER_CHUNK: usize = 64;

/// A division of a cluster into parts: by halving along up to three directions, one after the other.
#[derive(Debug)]
pub(crate) struct Split {
    /// In single precision, exactly; and its reciprocal.
    pub centre: Vec<Complex64>,
    pub inverse: Vec<Complex64>,
    /// Directions of κ, one after another; or of crude logarithms.
    pub directions: Vec<Complex64>,
    pub columns: Columns,
    /// What a member typically leaves over at each line, as the unit of
    /// [`Extent::reach`](super::extent::Extent::reach).
    pub scale: Vec<f64>,
    /// Where each part is halved: a heap.
    pub thresholds: Vec<f32>,
}

impl Split {
    #[inline(always)]
    fn part(&self, coordinates: &LineLanes<f32>) -> u8 {
        let mut node = 0;
        for t in coordinates.0 {
            let Some(threshold) = self.thresholds.get(node) else { break };
            node = 2 * node + 1 + usize::from(t > *threshold);
        }
        (node - self.thresholds.len()) as u8
    }

    /// Appends the part that each falls into by its logarithm.
    pub(crate) fn codes(&self, table: &Table<'_>, members: &[u32], scratch: &mut Scratch, codes: &mut Vec<u8>) {
        pulp::Arch::new().dispatch(Logarithms { split: self, table, members, scratch, codes });
    }

    /// Widens by members, and appends the part that each falls into.
    pub(crate) fn widen(
        &self,
        table: &Table<'_>,
        members: &[u32],
        scratch: &mut Scratch,
        widest: &mut Widest,
        codes: &mut Vec<u8>,
    ) {
        let split = Directions::new(self);
        pulp::Arch::new().dispatch(Measure { split, table, members, scratch, widest, codes });
    }

    /// Widens by members of which deviations and coordinates are known, and appends the part that each falls into.
    pub(crate) fn widen_known(
        &self,
        deviations: &[Pair<f32>],
        along: &[LineLanes<f32>],
        widest: &mut Widest,
        codes: &mut Vec<u8>,
    ) {
        let split = Directions::new(self);
        pulp::Arch::new().dispatch(Known { split, deviations, along, widest, codes });
    }
}

/// Scratch to work on some members.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    deviations: Vec<Pair<f32>>,
    along: Vec<LineLanes<f32>>,
}

/// `1 + L`, of gain, G/D and numerator.
#[inline(always)]
pub(crate) fn response<S: Simd>(gain: f64, d: [f64; 2], n: [f64; 2]) -> (f64, f64) {
    let re = mul_add::<S>(-d[1], n[1], d[0] * n[0]);
    let im = mul_add::<S>(d[1], n[0], d[0] * n[1]);
    (mul_add::<S>(gain, re, 1.0), gain * im)
}

/// The quotient of a response and the centre, less `minus`.
#[inline(always)]
pub(crate) fn deviation<S: Simd>(x: [f64; 2], inverse: [f64; 2], minus: f64) -> [f64; 2] {
    let re = mul_add::<S>(-x[1], inverse[1], mul_add::<S>(x[0], inverse[0], -minus));
    let im = mul_add::<S>(x[1], inverse[0], x[0] * inverse[1]);
    [re, im]
}

/// Deviations of members, at most [`PER_CHUNK`], in blocks.
#[inline(always)]
pub(super) fn fill<S: Simd>(
    table: &Table<'_>,
    members: &[u32],
    inverse: &[Pair<f64>],
    minus: f64,
    into: &mut [Pair<f32>],
) {
    // Where things are comes from far off, for all at once.
    let mut places = [Place::default(); PER_CHUNK];
    places.iter_mut().zip(members).for_each(|(place, member)| *place = table.place(*member));
    for (place, into) in places.iter().zip(into.chunks_exact_mut(inverse.len())) {
        let ((d, n), gain) = (table.factors(place), place.gain);
        for (((into, d), n), c) in into.iter_mut().zip(d).zip(n).zip(inverse) {
            for k in 0..LINE_LANES {
                let x = response::<S>(gain, [d.re.0[k], d.im.0[k]], [n.re.0[k], n.im.0[k]]);
                let d = deviation::<S>([x.0, x.1], [c.re.0[k], c.im.0[k]], minus);
                (into.re.0[k], into.im.0[k]) = (d[0] as f32, d[1] as f32);
            }
        }
    }
}

/// Monotone stand-ins for the logarithms, to some percent, and far quicker: for choosing where to divide, and nothing
/// else.
#[inline(always)]
pub(crate) fn crude_logarithms(quotients: &mut [Pair<f32>]) {
    for x in quotients {
        for (re, im) in x.re.0.iter_mut().zip(&mut x.im.0) {
            let square = (*re * *re + *im * *im).max(1e-37);
            // Exponent and mantissa, read as one number, are the binary logarithm between powers of two, nearly.
            let binary = square.to_bits() as i32 as f32 * (1.0 / 8_388_608.0) - 127.0;
            let share = *im / (re.abs() + im.abs() + 1e-30);
            let turns = if *re >= 0.0 { share } else { 2f32.copysign(*im) - share };
            (*re, *im) = (0.5 * std::f32::consts::LN_2 * binary, std::f32::consts::FRAC_PI_2 * turns);
        }
    }
}

/// What the coordinates of a deviation are products with: those of `κ − Σ_{j<m} t_j v_j` with `v_m`, directions being
/// only nearly orthogonal. For real and imaginary part of each line, the numbers of all directions.
#[derive(Debug)]
pub(crate) struct Columns(Vec<[LineLanes<f32>; 2]>);

impl Columns {
    pub(crate) fn new(directions: &[Complex64], lines: usize) -> Self {
        let mut columns = vec![[LineLanes::default(); 2]; lines];
        let mut rows: Vec<Complex64> = directions.to_vec();
        for m in 0..directions.len() / lines.max(1) {
            let direction = &directions[m * lines..(m + 1) * lines];
            let (before, row) = rows.split_at_mut(m * lines);
            let row = &mut row[..lines];
            for (v, before) in directions.chunks_exact(lines).zip(before.chunks_exact(lines)) {
                let product: f64 = direction.iter().zip(v).map(|(a, b)| a.re * b.re + a.im * b.im).sum();
                row.iter_mut().zip(before).for_each(|(row, before)| *row -= before * product);
            }
            for (column, x) in columns.iter_mut().zip(row) {
                (column[0].0[m], column[1].0[m]) = (x.re as f32, x.im as f32);
            }
        }
        Self(columns)
    }

    /// The coordinates of deviations.
    pub(crate) fn along(&self, deviations: &[Pair<f32>], into: &mut Vec<LineLanes<f32>>) {
        into.resize(deviations.len() / blocks(self.0.len()).max(1), LineLanes::default());
        pulp::Arch::new().dispatch(Along { columns: self, deviations, into });
    }
}

struct Along<'a> {
    columns: &'a Columns,
    deviations: &'a [Pair<f32>],
    into: &'a mut [LineLanes<f32>],
}

impl WithSimd for Along<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { columns, deviations, into } = self;
        along(simd, columns, deviations, into);
    }
}

/// Takes members together as far as registers reach: `$f::<S, vectors per block, members>`.
macro_rules! by_registers {
    ($S:ident, $f:ident($($argument:expr),*)) => {
        match LINE_LANES / $S::F32_LANES {
            1 => $f::<$S, 1, 4>($($argument),*),
            2 => $f::<$S, 2, 2>($($argument),*),
            4 => $f::<$S, 4, 2>($($argument),*),
            _ => $f::<$S, LINE_LANES, 1>($($argument),*),
        }
    };
}

#[inline(always)]
pub(super) fn along<S: Simd>(simd: S, columns: &Columns, deviations: &[Pair<f32>], into: &mut [LineLanes<f32>]) {
    by_registers!(S, along_in(simd, columns, deviations, into));
}

#[inline(always)]
fn along_in<S: Simd, const V: usize, const J: usize>(
    simd: S,
    columns: &Columns,
    deviations: &[Pair<f32>],
    into: &mut [LineLanes<f32>],
) {
    let blocks = blocks(columns.0.len());
    let whole = into.len() / J * J;
    let (some, last) = into.split_at_mut(whole);
    let (first, rest) = deviations.split_at(whole * blocks);
    for (x, into) in first.chunks_exact(J * blocks).zip(some.chunks_exact_mut(J)) {
        along_some::<S, V, J>(simd, columns, x, into);
    }
    for (x, into) in rest.chunks_exact(blocks).zip(last.chunks_exact_mut(1)) {
        along_some::<S, V, 1>(simd, columns, x, into);
    }
}

#[inline(always)]
fn along_some<S: Simd, const V: usize, const J: usize>(
    simd: S,
    columns: &Columns,
    deviations: &[Pair<f32>],
    into: &mut [LineLanes<f32>],
) {
    let blocks = deviations.len() / J;
    // Real and imaginary parts do not wait for each other.
    let mut sums = [[[simd.splat_f32s(0.0); V]; 2]; J];
    for (b, columns) in columns.0.chunks(LINE_LANES).enumerate() {
        for (k, column) in columns.iter().enumerate() {
            let column: [[S::f32s; V]; 2] = [vectors::<S, V>(simd, &column[0]), vectors::<S, V>(simd, &column[1])];
            for (sums, x) in sums.iter_mut().zip(deviations.chunks_exact(blocks)) {
                let x = &x[b];
                let parts = [simd.splat_f32s(x.re.0[k % LINE_LANES]), simd.splat_f32s(x.im.0[k % LINE_LANES])];
                for ((sums, part), column) in sums.iter_mut().zip(parts).zip(&column) {
                    for (sum, column) in sums.iter_mut().zip(column) {
                        *sum = simd.mul_add_e_f32s(part, *column, *sum);
                    }
                }
            }
        }
    }
    for (into, [re, im]) in into.iter_mut().zip(sums) {
        for ((into, re), im) in S::as_mut_simd_f32s(&mut into.0).0.iter_mut().zip(re).zip(im) {
            *into = simd.add_f32s(re, im);
        }
    }
}

#[inline(always)]
fn vectors<S: Simd, const V: usize>(simd: S, of: &LineLanes<f32>) -> [S::f32s; V] {
    let mut all = [simd.splat_f32s(0.0); V];
    all.iter_mut().zip(S::as_simd_f32s(&of.0).0).for_each(|(into, from)| *into = *from);
    all
}

/// Codes of members by their logarithms.
struct Logarithms<'a> {
    split: &'a Split,
    table: &'a Table<'a>,
    members: &'a [u32],
    scratch: &'a mut Scratch,
    codes: &'a mut Vec<u8>,
}

impl WithSimd for Logarithms<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { split, table, members, scratch, codes } = self;
        let inverse: Vec<_> = pairs(&split.inverse, 1.0).collect();
        for members in members.chunks(PER_CHUNK) {
            scratch.deviations.resize(members.len() * inverse.len(), Pair::default());
            scratch.along.resize(members.len(), LineLanes::default());
            fill::<S>(table, members, &inverse, 0.0, &mut scratch.deviations);
            crude_logarithms(&mut scratch.deviations);
            along(simd, &split.columns, &scratch.deviations, &mut scratch.along);
            codes.extend(scratch.along.iter().map(|along| split.part(along)));
        }
    }
}

/// What deviations are taken apart by.
pub(super) struct Directions<'a> {
    split: &'a Split,
    /// Per block the directions, and the inverse of the scale.
    blocks: Vec<([Pair<f32>; ALL], LineLanes<f32>)>,
}

impl<'a> Directions<'a> {
    pub(super) fn new(split: &'a Split) -> Self {
        let mut all = vec![([Pair::default(); ALL], LineLanes::default()); blocks(split.centre.len())];
        for (m, direction) in split.directions.chunks_exact(split.centre.len()).enumerate() {
            for (block, parts) in all.iter_mut().zip(direction.chunks(LINE_LANES)) {
                let Pair { re, im } = &mut block.0[m];
                for ((re, im), part) in re.0.iter_mut().zip(&mut im.0).zip(parts) {
                    // Exactly: see `FINEST`.
                    (*re, *im) = (part.re as f32, part.im as f32);
                }
            }
        }
        for (block, scale) in all.iter_mut().zip(split.scale.chunks(LINE_LANES)) {
            block.1.0.iter_mut().zip(scale).for_each(|(into, scale)| *into = (1.0 / scale) as f32);
        }
        Self { split, blocks: all }
    }
}

/// Extent and codes of members.
pub(super) struct Measure<'a> {
    pub split: Directions<'a>,
    pub table: &'a Table<'a>,
    pub members: &'a [u32],
    pub scratch: &'a mut Scratch,
    pub widest: &'a mut Widest,
    pub codes: &'a mut Vec<u8>,
}

impl WithSimd for Measure<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { split, table, members, scratch, widest, codes } = self;
        let inverse: Vec<_> = pairs(&split.split.inverse, 1.0).collect();
        for members in members.chunks(PER_CHUNK) {
            scratch.deviations.resize(members.len() * inverse.len(), Pair::default());
            scratch.along.resize(members.len(), LineLanes::default());
            fill::<S>(table, members, &inverse, 1.0, &mut scratch.deviations);
            along(simd, &split.split.columns, &scratch.deviations, &mut scratch.along);
            widen(simd, &split, &scratch.deviations, &scratch.along, widest, codes);
        }
    }
}

/// As [`Measure`], of members whose deviations and coordinates are known.
struct Known<'a> {
    split: Directions<'a>,
    deviations: &'a [Pair<f32>],
    along: &'a [LineLanes<f32>],
    widest: &'a mut Widest,
    codes: &'a mut Vec<u8>,
}

impl WithSimd for Known<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { split, deviations, along, widest, codes } = self;
        widen(simd, &split, deviations, along, widest, codes);
    }
}

#[inline(always)]
fn widen<S: Simd>(
    simd: S,
    split: &Directions<'_>,
    deviations: &[Pair<f32>],
    along: &[LineLanes<f32>],
    widest: &mut Widest,
    codes: &mut Vec<u8>,
) {
    for along in along {
        let code = split.split.part(along);
        codes.push(code);
        let [low, high] = &mut widest.parts[usize::from(code)];
        let vectors = S::as_simd_f32s(&along.0).0;
        for ((low, high), t) in
            low.0.chunks_exact_mut(S::F32_LANES).zip(high.0.chunks_exact_mut(S::F32_LANES)).zip(vectors)
        {
            let (low, high) = (&mut S::as_mut_simd_f32s(low).0[0], &mut S::as_mut_simd_f32s(high).0[0]);
            (*low, *high) = (simd.min_f32s(*low, *t), simd.max_f32s(*high, *t));
        }
    }
    by_registers!(S, rests(simd, split, deviations, along, widest));
}

#[inline(always)]
fn rests<S: Simd, const V: usize, const J: usize>(
    simd: S,
    split: &Directions<'_>,
    deviations: &[Pair<f32>],
    along: &[LineLanes<f32>],
    widest: &mut Widest,
) {
    let blocks = split.blocks.len();
    let (some, last) = along.split_at(along.len() / J * J);
    let (first, rest) = deviations.split_at(some.len() * blocks);
    for (x, along) in first.chunks_exact(J * blocks).zip(some.chunks_exact(J)) {
        rest_of::<S, V, J>(simd, split, x, along, widest);
    }
    for (x, along) in rest.chunks_exact(blocks).zip(last.chunks_exact(1)) {
        rest_of::<S, V, 1>(simd, split, x, along, widest);
    }
}

/// What the directions leave over of some members, and how large that is.
#[inline(always)]
fn rest_of<S: Simd, const V: usize, const J: usize>(
    simd: S,
    split: &Directions<'_>,
    deviations: &[Pair<f32>],
    along: &[LineLanes<f32>],
    widest: &mut Widest,
) {
    let blocks = split.blocks.len();
    let mut squares = [[simd.splat_f32s(0.0); V]; J];
    for (b, (directions, share)) in split.blocks.iter().enumerate() {
        let mut rest = [[[simd.splat_f32s(0.0); V]; 2]; J];
        for (rest, x) in rest.iter_mut().zip(deviations.chunks_exact(blocks)) {
            *rest = [vectors::<S, V>(simd, &x[b].re), vectors::<S, V>(simd, &x[b].im)];
        }
        largest(simd, &rest, &mut widest.radius[b]);
        for (m, direction) in directions.iter().enumerate() {
            if m == DIRECTIONS {
                largest(simd, &rest, &mut widest.remainder[b]);
            }
            let direction = [vectors::<S, V>(simd, &direction.re), vectors::<S, V>(simd, &direction.im)];
            for (rest, along) in rest.iter_mut().zip(along) {
                let t = simd.splat_f32s(along.0[m]);
                for (rest, direction) in rest.iter_mut().zip(&direction) {
                    for (rest, direction) in rest.iter_mut().zip(direction) {
                        *rest = simd.negate_mul_add_e_f32s(t, *direction, *rest);
                    }
                }
            }
        }
        let share = vectors::<S, V>(simd, share);
        for (squares, [re, im]) in squares.iter_mut().zip(&rest) {
            for v in 0..V {
                let (re, im) = (simd.mul_f32s(re[v], share[v]), simd.mul_f32s(im[v], share[v]));
                squares[v] = simd.add_f32s(squares[v], norm(simd, re, im));
            }
        }
    }
    for squares in squares {
        let mut sum = simd.splat_f32s(0.0);
        for square in squares {
            sum = simd.add_f32s(sum, square);
        }
        widest.reach(simd.reduce_sum_f32s(sum));
    }
}

#[inline(always)]
fn norm<S: Simd>(simd: S, re: S::f32s, im: S::f32s) -> S::f32s {
    simd.mul_add_e_f32s(re, re, simd.mul_f32s(im, im))
}

/// Takes the squared moduli of some members.
#[inline(always)]
fn largest<S: Simd, const V: usize>(simd: S, of: &[[[S::f32s; V]; 2]], into: &mut LineLanes<f32>) {
    let mut most = vectors::<S, V>(simd, into);
    for [re, im] in of {
        for ((most, re), im) in most.iter_mut().zip(re).zip(im) {
            *most = simd.max_f32s(*most, norm(simd, *re, *im));
        }
    }
    S::as_mut_simd_f32s(&mut into.0).0.copy_from_slice(&most);
}
