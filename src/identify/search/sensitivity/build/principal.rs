//! Directions in which a sample extends most, from its second moments.

use super::line_lanes::{LINE_LANES, LineLanes, Pair, blocks};
use super::size::DIRECTIONS;
use num_complex::Complex64;
use pulp::{Simd, WithSimd};

/// Rounds of power iteration per direction. An inexact direction costs a little in what is left over, which is measured
/// after it.
const POWER_ITERATIONS: usize = 4;

/// Parts of a leading direction are kept as multiples of its inverse, in 16 bits: exact in single precision.
const FINEST: f64 = 32_768.0;

/// Parts of a faint direction are kept in 8 bits, as multiples of a unit that is so many multiples of the inverse of
/// this, in 16 bits: exact in single precision as well.
const FINEST_UNIT: f64 = 4_194_304.0;

/// Of smaller units the largest value could be a multiple by less than 127, and be given a smaller unit the next time.
/// No largest part of a vector of length one asks for them, unless it has more than ten thousand parts.
const LEAST_UNIT: f64 = 254.0;

/// Of the mean rest, what a line's share is taken to be at least: the sample may have missed what others do there.
const LEAST_SHARE: f64 = 0.01;

/// Vectors of the sample that are added to the moments at once, since the sums would otherwise mostly be loaded and
/// stored.
const TOGETHER: usize = 32;

/// A part of a nearly unit vector, as it is kept. Any vectors will do, as long as everyone uses the same.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    re: i16,
    im: i16,
}

impl Part {
    pub(crate) fn new(value: Complex64) -> Self {
        let round = |x: f64| to_nearest(x * FINEST) as i16;
        Self { re: round(value.re), im: round(value.im) }
    }

    #[inline(always)]
    pub(crate) fn value(self) -> Complex64 {
        Complex64::new(f64::from(self.re) / FINEST, f64::from(self.im) / FINEST)
    }

    pub(crate) fn bits(self) -> u32 {
        u32::from(self.re as u16) | u32::from(self.im as u16) << 16
    }

    #[inline(always)]
    pub(crate) fn from_bits(bits: u32) -> Self {
        Self { re: bits as u16 as i16, im: (bits >> 16) as u16 as i16 }
    }
}

/// What truncation then rounds to the nearest: the library's rounding is a call where processors need not have an
/// instruction for it.
fn to_nearest(x: f64) -> f64 {
    x + 0.5_f64.copysign(x)
}

/// The unit of a faint direction's parts, as it is kept.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Faint(u16);

impl Faint {
    /// The least unit that will do, so that values in such units have the same one again, and are kept exactly: from
    /// [`LEAST_UNIT`] on, the largest of them is a multiple by 127.
    pub(crate) fn new(direction: &[Complex64]) -> Self {
        let largest = direction.iter().map(|d| d.re.abs().max(d.im.abs())).fold(0.0, f64::max);
        Self((largest / f64::from(i8::MAX) * FINEST_UNIT).ceil().max(LEAST_UNIT) as u16)
    }

    pub(crate) fn unit(self) -> u16 {
        self.0
    }

    #[inline(always)]
    pub(crate) fn from_unit(unit: u16) -> Self {
        Self(unit)
    }

    pub(crate) fn bits(self, value: Complex64) -> u16 {
        let round = |x: f64| to_nearest(x / (f64::from(self.0) / FINEST_UNIT)) as i8;
        u16::from_le_bytes([value.re, value.im].map(|x| round(x) as u8))
    }

    #[inline(always)]
    pub(crate) fn value(self, bits: u16) -> Complex64 {
        let unit = f64::from(self.0) / FINEST_UNIT;
        let [re, im] = bits.to_le_bytes();
        Complex64::new(f64::from(re as i8) * unit, f64::from(im as i8) * unit)
    }
}

/// A direction as it is kept.
fn kept(m: usize, direction: &mut [Complex64]) {
    if m < DIRECTIONS {
        direction.iter_mut().for_each(|d| *d = Part::new(*d).value());
    } else {
        let faint = Faint::new(direction);
        direction.iter_mut().for_each(|d| *d = faint.value(faint.bits(*d)));
    }
}

/// The directions, one after another, and how much a member typically leaves over at each line.
#[derive(Debug, Clone)]
pub(crate) struct Principal {
    /// Values that [`Part`] or [`Faint`] keeps exactly.
    pub directions: Vec<Complex64>,
    pub scale: Vec<f64>,
}

impl Principal {
    /// Up to `count` directions of these vectors, one after another in blocks. Where there are no more, zeros.
    pub(crate) fn new(vectors: &[Pair<f32>], lines: usize, count: usize) -> Self {
        pulp::Arch::new().dispatch(Find { vectors, lines, count })
    }
}

struct Find<'a> {
    vectors: &'a [Pair<f32>],
    lines: usize,
    count: usize,
}

/// Moments: a row for each real and imaginary part of a line; in the columns whole blocks.
struct Moments {
    /// Where the parts lie in a row, in order.
    places: Vec<usize>,
    /// Wide numbers of a row.
    width: usize,
    rows: Vec<LineLanes<f64>>,
}

impl WithSimd for Find<'_> {
    type Output = Principal;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Principal {
        let Self { vectors, lines, count } = self;
        let places: Vec<usize> = (0..2 * LINE_LANES * blocks(lines)).filter(|at| line(*at) < lines).collect();
        let width = 2 * blocks(lines);
        let rows = vec![LineLanes::default(); places.len() * width];
        let mut moments = Moments { places, width, rows };
        moments.fill(simd, vectors);
        let mut directions = vec![Complex64::ZERO; count * lines];
        let mut direction = vec![LineLanes::default(); width];
        let mut image = direction.clone();
        for (m, parts) in directions.chunks_exact_mut(lines).enumerate() {
            let Some(longest) = moments.longest() else { break };
            direction.copy_from_slice(moments.row(longest));
            if !normalise(simd, &mut direction) {
                break;
            }
            for _ in 0..POWER_ITERATIONS {
                moments.apply(simd, &direction, &mut image);
                std::mem::swap(&mut direction, &mut image);
            }
            if !normalise(simd, &mut direction) {
                break;
            }
            for (k, part) in parts.iter_mut().enumerate() {
                let [re, im] = [0, 1].map(|of| direction[2 * (k / LINE_LANES) + of].0[k % LINE_LANES]);
                *part = Complex64::new(re, im);
            }
            kept(m, parts);
            for (k, part) in parts.iter().enumerate() {
                direction[2 * (k / LINE_LANES)].0[k % LINE_LANES] = part.re;
                direction[2 * (k / LINE_LANES) + 1].0[k % LINE_LANES] = part.im;
            }
            moments.apply(simd, &direction, &mut image);
            moments.remove(simd, &direction, &image);
        }
        let number = (vectors.len() / blocks(lines).max(1)).max(1) as f64;
        let mut shares = vec![0.0; lines];
        for (row, place) in moments.places.iter().enumerate() {
            shares[line(*place)] += moments.at(row).max(0.0) / number;
        }
        let least = (LEAST_SHARE * shares.iter().sum::<f64>() / lines as f64).max(1e-24);
        let scale = shares.iter().map(|share| if share.is_finite() { share.max(least).sqrt() } else { 1.0 }).collect();
        Principal { directions, scale }
    }
}

/// The line of a place in a vector of blocks.
fn line(place: usize) -> usize {
    place / (2 * LINE_LANES) * LINE_LANES + place % LINE_LANES
}

impl Moments {
    fn row(&self, row: usize) -> &[LineLanes<f64>] {
        &self.rows[row * self.width..(row + 1) * self.width]
    }

    /// An entry of the diagonal.
    fn at(&self, row: usize) -> f64 {
        let place = self.places[row];
        self.row(row)[place / LINE_LANES].0[place % LINE_LANES]
    }

    fn longest(&self) -> Option<usize> {
        let mut longest = None;
        for row in 0..self.places.len() {
            let at = self.at(row);
            if longest.is_none_or(|(_, most)| at > most) {
                longest = Some((row, at));
            }
        }
        longest.map(|(row, _)| row)
    }

    /// From nothing.
    #[inline(always)]
    fn fill<S: Simd>(&mut self, simd: S, vectors: &[Pair<f32>]) {
        let width = self.width;
        let mut buffer = vec![LineLanes::<f64>::default(); TOGETHER * width];
        for some in vectors.chunks(TOGETHER * width / 2) {
            let parts = some.iter().flat_map(|pair| [&pair.re, &pair.im]);
            for (into, from) in buffer.iter_mut().zip(parts) {
                into.0.iter_mut().zip(&from.0).for_each(|(into, x)| *into = f64::from(*x));
            }
            let buffer = &buffer[..2 * some.len()];
            match LINE_LANES / S::F64_LANES {
                2 => self.add::<S, 2, 4>(simd, buffer),
                4 => self.add::<S, 4, 2>(simd, buffer),
                8 => self.add::<S, 8, 1>(simd, buffer),
                _ => self.add::<S, LINE_LANES, 1>(simd, buffer),
            }
        }
        for (row, place) in self.places.iter().enumerate() {
            let (above, below) = self.rows.split_at_mut(row * width);
            for (above, column) in above.chunks_exact(width).zip(&self.places) {
                if column / LINE_LANES < place / LINE_LANES {
                    below[column / LINE_LANES].0[column % LINE_LANES] = above[place / LINE_LANES].0[place % LINE_LANES];
                }
            }
        }
    }

    /// Adds the squares of vectors, several rows at a time, which share what is loaded.
    #[inline(always)]
    fn add<S: Simd, const V: usize, const R: usize>(&mut self, simd: S, vectors: &[LineLanes<f64>]) {
        let width = self.width;
        let mut rows = self.rows.chunks_exact_mut(R * width);
        let mut places = self.places.chunks_exact(R);
        for (rows, places) in rows.by_ref().zip(places.by_ref()) {
            add_rows::<S, V, R>(simd, rows, places, width, vectors);
        }
        for (row, place) in rows.into_remainder().chunks_exact_mut(width).zip(places.remainder().chunks_exact(1)) {
            add_rows::<S, V, 1>(simd, row, place, width, vectors);
        }
    }

    /// `M x`.
    #[inline(always)]
    fn apply<S: Simd>(&self, simd: S, x: &[LineLanes<f64>], image: &mut [LineLanes<f64>]) {
        // As much in registers as there are.
        match LINE_LANES / S::F64_LANES {
            2 if self.width == 2 => self.columns::<S, 4, 2>(simd, x, image),
            2 => self.columns::<S, 2, 2>(simd, x, image),
            4 if self.width == 2 => self.columns::<S, 8, 1>(simd, x, image),
            4 => self.columns::<S, 4, 2>(simd, x, image),
            8 => self.columns::<S, 8, 1>(simd, x, image),
            _ => self.columns::<S, LINE_LANES, 1>(simd, x, image),
        }
    }

    /// V vectors of `M x` at a time, in C sums that do not wait for each other.
    #[inline(always)]
    fn columns<S: Simd, const V: usize, const C: usize>(
        &self,
        simd: S,
        x: &[LineLanes<f64>],
        image: &mut [LineLanes<f64>],
    ) {
        let zero = simd.splat_f64s(0.0);
        let wides = V * S::F64_LANES / LINE_LANES;
        for (i, image) in image.chunks_exact_mut(wides).enumerate() {
            let mut sums = [[zero; V]; C];
            let part = i * wides..(i + 1) * wides;
            // M is symmetric: rows may stand for columns.
            let mut rows = self.rows.chunks_exact(C * self.width);
            let mut places = self.places.chunks_exact(C);
            for (rows, places) in rows.by_ref().zip(places.by_ref()) {
                for ((sums, row), place) in sums.iter_mut().zip(rows.chunks_exact(self.width)).zip(places) {
                    add_row(simd, sums, &row[part.clone()], x, *place);
                }
            }
            for (row, place) in rows.remainder().chunks_exact(self.width).zip(places.remainder()) {
                add_row(simd, &mut sums[0], &row[part.clone()], x, *place);
            }
            let into = image.iter_mut().flat_map(|image| S::as_mut_simd_f64s(&mut image.0).0);
            for (v, into) in into.enumerate().take(V) {
                *into = sums[0][v];
                for sums in &sums[1..] {
                    *into = simd.add_f64s(*into, sums[v]);
                }
            }
        }
    }

    /// Every vector x becomes x − d (d·x), and the moments M become M − d (M d)ᵀ − (M d) dᵀ + d dᵀ (dᵀ M d).
    #[inline(always)]
    fn remove<S: Simd>(&mut self, simd: S, d: &[LineLanes<f64>], image: &[LineLanes<f64>]) {
        let square = simd.splat_f64s(product(simd, d, image));
        for (row, place) in self.rows.chunks_exact_mut(self.width).zip(&self.places) {
            let d_i = simd.splat_f64s(d[place / LINE_LANES].0[place % LINE_LANES]);
            let i_i = simd.splat_f64s(image[place / LINE_LANES].0[place % LINE_LANES]);
            let along = simd.sub_f64s(simd.mul_f64s(d_i, square), i_i);
            for ((row, d), image) in row.iter_mut().zip(d).zip(image) {
                let (d, image) = (S::as_simd_f64s(&d.0).0, S::as_simd_f64s(&image.0).0);
                for ((m, d), i) in S::as_mut_simd_f64s(&mut row.0).0.iter_mut().zip(d).zip(image) {
                    *m = simd.negate_mul_add_e_f64s(*i, d_i, simd.mul_add_e_f64s(*d, along, *m));
                }
            }
        }
    }
}

#[inline(always)]
fn add_row<S: Simd, const V: usize>(
    simd: S,
    sums: &mut [S::f64s; V],
    row: &[LineLanes<f64>],
    x: &[LineLanes<f64>],
    place: usize,
) {
    let factor = simd.splat_f64s(x[place / LINE_LANES].0[place % LINE_LANES]);
    for (sums, row) in sums.chunks_exact_mut(LINE_LANES / S::F64_LANES).zip(row) {
        for (sum, m) in sums.iter_mut().zip(S::as_simd_f64s(&row.0).0) {
            *sum = simd.mul_add_e_f64s(*m, factor, *sum);
        }
    }
}

#[inline(always)]
fn add_rows<S: Simd, const V: usize, const R: usize>(
    simd: S,
    rows: &mut [LineLanes<f64>],
    places: &[usize],
    width: usize,
    vectors: &[LineLanes<f64>],
) {
    let zero = simd.splat_f64s(0.0);
    // The matrix is symmetric: of the other triangle there follow the other blocks at the end.
    for i in places[0] / LINE_LANES..width {
        let mut sums = [[zero; V]; R];
        for vector in vectors.chunks_exact(width) {
            let mut y = [zero; V];
            y.iter_mut().zip(S::as_simd_f64s(&vector[i].0).0).for_each(|(into, from)| *into = *from);
            for (sums, place) in sums.iter_mut().zip(places) {
                let x = simd.splat_f64s(vector[place / LINE_LANES].0[place % LINE_LANES]);
                for (sum, y) in sums.iter_mut().zip(&y) {
                    *sum = simd.mul_add_e_f64s(x, *y, *sum);
                }
            }
        }
        for (row, sums) in rows.chunks_exact_mut(width).zip(sums) {
            for (into, sum) in S::as_mut_simd_f64s(&mut row[i].0).0.iter_mut().zip(sums) {
                *into = simd.add_f64s(*into, sum);
            }
        }
    }
}

#[inline(always)]
fn product<S: Simd>(simd: S, a: &[LineLanes<f64>], b: &[LineLanes<f64>]) -> f64 {
    let mut sum = simd.splat_f64s(0.0);
    for (a, b) in a.iter().zip(b) {
        for (a, b) in S::as_simd_f64s(&a.0).0.iter().zip(S::as_simd_f64s(&b.0).0) {
            sum = simd.mul_add_e_f64s(*a, *b, sum);
        }
    }
    simd.reduce_sum_f64s(sum)
}

/// To length one; whether that was possible.
#[inline(always)]
fn normalise<S: Simd>(simd: S, x: &mut [LineLanes<f64>]) -> bool {
    let norm = product(simd, x, x).sqrt();
    if !(norm > 1e-100 && norm < 1e150) {
        return false;
    }
    let factor = simd.splat_f64s(1.0 / norm);
    for x in x {
        S::as_mut_simd_f64s(&mut x.0).0.iter_mut().for_each(|x| *x = simd.mul_f64s(*x, factor));
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::search::sensitivity::build::line_lanes::pairs;
    use crate::identify::search::sensitivity::build::size::ALL;

    /// Real and imaginary parts in turn, as blocks.
    fn vector(parts: &[f64]) -> Vec<Pair<f32>> {
        let values: Vec<Complex64> = parts.chunks_exact(2).map(|x| Complex64::new(x[0], x[1])).collect();
        let single = |x: [f64; LINE_LANES]| LineLanes(x.map(|x| x as f32));
        pairs(&values, 0.0).map(|pair| Pair { re: single(pair.re.0), im: single(pair.im.0) }).collect()
    }

    #[test]
    fn directions_are_found_by_length_and_the_rest_is_what_they_leave() {
        // Along (1, i)/√2 with 3, along (1, −i)/√2 with 1, along nothing else; and a rest at the second line.
        let root = 0.5_f64.sqrt();
        // Lines of zeros between them, so that whole blocks lie apart.
        for between in [0, 1, 14, 30] {
            let mut vectors = Vec::new();
            for (a, b, c) in [(3.0, 1.0, 0.01), (-3.0, 1.0, -0.01), (3.0, -1.0, -0.01), (-3.0, -1.0, 0.01)] {
                let mut parts = vec![a * root, b * root, 0.0, c];
                parts.extend(vec![0.0; 2 * between]);
                parts.extend([b * root, -a * root]);
                vectors.extend(vector(&parts));
            }
            let lines = 3 + between;
            let found = Principal::new(&vectors, lines, 2);
            let [first, second] = [0, 1].map(|m| &found.directions[lines * m..lines * (m + 1)]);
            // As vectors of R⁶: (1, 0, 0, 0, 0, −1)/√2 and (0, 1, 0, 0, 1, 0)/√2.
            let last = lines - 1;
            assert!((first[0].re.abs() - root).abs() < 1e-4 && (first[0].re + first[last].im).abs() < 1e-4);
            assert!((second[0].im.abs() - root).abs() < 1e-4 && (second[0].im - second[last].re).abs() < 1e-4);
            assert!((found.scale[1] - 0.01).abs() < 1e-5, "{:?}", found.scale);
            assert!(found.scale[0] < 2e-3 && found.scale[last] < 2e-3, "{:?}", found.scale);
        }
    }

    #[test]
    fn nothing_to_find_is_no_number_gone_wrong() {
        for value in [0.0, 1e38, f64::NAN] {
            let vectors = [vector(&[value; 6]), vector(&[value; 6])].concat();
            let found = Principal::new(&vectors, 3, 4);
            assert!(found.scale.iter().all(|s| s.is_finite() && *s > 0.0), "{value}: {found:?}");
        }
    }

    #[test]
    fn directions_are_kept_as_they_are() {
        let mut parts: Vec<f64> = (0..74_u32).map(|i| f64::from(i * i % 37) - 18.0).collect();
        let mut vectors = Vec::new();
        for i in 0..50 {
            parts.rotate_left(i % 5 + 1);
            parts[i] += 3.0;
            vectors.extend(vector(&parts));
        }
        let found = Principal::new(&vectors, 37, ALL);
        for (m, direction) in found.directions.chunks_exact(37).enumerate() {
            let mut again = direction.to_vec();
            kept(m, &mut again);
            assert_eq!(direction, again);
            let norm = direction.iter().map(Complex64::norm_sqr).sum::<f64>().sqrt();
            assert!((norm - 1.0).abs() < 0.02, "{m} {norm}");
            assert!(direction.iter().all(|d| f64::from(d.re as f32) == d.re && f64::from(d.im as f32) == d.im));
        }
    }

    /// Between 127 and 254 units the largest value once fell to a smaller unit: that takes vectors of more than ten
    /// thousand parts.
    #[test]
    fn faint_directions_are_kept_as_they_are_however_small_their_parts() {
        for largest in (0..4000).map(|i| 1e-5 * f64::from(i)) {
            let mut direction = [largest, -0.61 * largest, 0.0].map(|re| Complex64::new(re, 0.37 * re));
            kept(DIRECTIONS, &mut direction);
            let before = direction;
            kept(DIRECTIONS, &mut direction);
            assert_eq!(direction, before, "{largest}");
            assert!((direction[0].re - largest).abs() <= 0.51 * largest.max(0.0077) / 127.0, "{largest} {before:?}");
        }
    }
}
