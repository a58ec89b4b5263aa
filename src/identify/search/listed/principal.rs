//! Directions in which a sample extends most, from its second moments.

use num_complex::Complex64;
use pulp::{Simd, WithSimd};

/// Rounds of power iteration per direction. An inexact direction costs a little in what is left over, which is measured after it.
const POWER_ITERATIONS: usize = 4;

/// Parts of a direction are kept as multiples of its inverse, in 16 bits.
const FINEST: f64 = 32_767.0;

/// Of the mean rest, what a line's share is taken to be at least: the sample may have missed what others do there.
const LEAST_SHARE: f64 = 0.01;

/// A part of a nearly unit vector, as it is kept. Any vectors will do, as long as everyone uses the same.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part {
    pub(super) re: i16,
    pub(super) im: i16,
}

impl Part {
    pub(super) fn new(value: Complex64) -> Self {
        let round = |x: f64| (x * FINEST).round() as i16;
        Self { re: round(value.re), im: round(value.im) }
    }

    #[inline(always)]
    pub(super) fn value(self) -> Complex64 {
        Complex64::new(f64::from(self.re) / FINEST, f64::from(self.im) / FINEST)
    }
}

/// The directions, one after another, and how much a member typically leaves over at each line.
#[derive(Debug, Clone)]
pub(super) struct Principal {
    /// Values that a [`Part`] keeps exactly.
    pub directions: Vec<Complex64>,
    pub scale: Vec<f64>,
}

impl Principal {
    /// Up to `count` directions of these vectors of real and imaginary parts, one vector after another. Where there are no more, zeros.
    pub(super) fn new(vectors: &[f64], lines: usize, count: usize) -> Self {
        pulp::Arch::new().dispatch(Find { vectors, lines, count })
    }
}

struct Find<'a> {
    vectors: &'a [f64],
    lines: usize,
    count: usize,
}

impl WithSimd for Find<'_> {
    type Output = Principal;

    /// Plain loops, which the compiler vectorises for the dispatched instructions.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Principal {
        let Self { vectors, lines, count } = self;
        let order = 2 * lines;
        let nothing = vec![0.0; order];
        let mut moments = vec![0.0; order * order];
        // Four at a time, since the sums would otherwise mostly be loaded and stored.
        for four in vectors.chunks(4 * order) {
            let mut each = four.chunks_exact(order);
            let [a, b, c, d] = std::array::from_fn(|_| each.next().unwrap_or(&nothing[..]));
            for (i, row) in moments.chunks_exact_mut(order).enumerate() {
                let (x, y, z, w) = (a[i], b[i], c[i], d[i]);
                for ((((m, a), b), c), d) in row.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                    *m += x * a + y * b + (z * c + w * d);
                }
            }
        }
        let mut directions = vec![Complex64::ZERO; count * lines];
        let mut direction = vec![0.0; order];
        let mut image = vec![0.0; order];
        for parts in directions.chunks_exact_mut(lines) {
            let longest = (0..order).max_by(|a, b| moments[a * (order + 1)].total_cmp(&moments[b * (order + 1)]));
            let Some(longest) = longest else { break };
            direction.copy_from_slice(&moments[longest * order..(longest + 1) * order]);
            let mut found = normalise(&mut direction);
            for _ in 0..POWER_ITERATIONS {
                apply(&moments, &direction, &mut image);
                direction.copy_from_slice(&image);
                found = found && normalise(&mut direction);
            }
            if !found {
                break;
            }
            for (part, x) in parts.iter_mut().zip(direction.chunks_exact_mut(2)) {
                *part = Part::new(Complex64::new(x[0], x[1])).value();
                (x[0], x[1]) = (part.re, part.im);
            }
            // Every vector x becomes x − d (d·x), and the moments M become M − d (M d)ᵀ − (M d) dᵀ + d dᵀ (dᵀ M d).
            apply(&moments, &direction, &mut image);
            let square: f64 = image.iter().zip(&direction).map(|(i, d)| i * d).sum();
            for ((row, d), i) in moments.chunks_exact_mut(order).zip(&direction).zip(&image) {
                for ((m, d_j), i_j) in row.iter_mut().zip(&direction).zip(&image) {
                    *m += d * d_j * square - d * i_j - i * d_j;
                }
            }
        }
        let count = (vectors.len() / order).max(1) as f64;
        let at = |i: usize| moments[i * (order + 1)].max(0.0);
        let shares: Vec<f64> = (0..lines).map(|k| (at(2 * k) + at(2 * k + 1)) / count).collect();
        let least = (LEAST_SHARE * shares.iter().sum::<f64>() / lines as f64).max(1e-24);
        let scale = shares.iter().map(|share| if share.is_finite() { share.max(least).sqrt() } else { 1.0 }).collect();
        Principal { directions, scale }
    }
}

/// `M x`.
#[inline(always)]
fn apply(moments: &[f64], x: &[f64], image: &mut [f64]) {
    image.fill(0.0);
    // M is symmetric: rows may stand for columns.
    for (row, x) in moments.chunks_exact(x.len()).zip(x) {
        image.iter_mut().zip(row).for_each(|(i, m)| *i += m * x);
    }
}

/// To length one; whether that was possible.
#[inline(always)]
fn normalise(x: &mut [f64]) -> bool {
    let norm = x.iter().map(|x| x * x).sum::<f64>().sqrt();
    if !(norm > 1e-100 && norm < 1e150) {
        return false;
    }
    x.iter_mut().for_each(|x| *x /= norm);
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_found_by_length_and_the_rest_is_what_they_leave() {
        // Along (1, i)/√2 with 3, along (1, −i)/√2 with 1, along nothing else; and a rest at the second line.
        let root = 0.5_f64.sqrt();
        let mut vectors = Vec::new();
        for (a, b, c) in [(3.0, 1.0, 0.01), (-3.0, 1.0, -0.01), (3.0, -1.0, -0.01), (-3.0, -1.0, 0.01)] {
            vectors.extend([a * root, b * root, 0.0, c, b * root, -a * root]);
        }
        let found = Principal::new(&vectors, 3, 2);
        let [first, second] = [0, 1].map(|m| &found.directions[3 * m..3 * (m + 1)]);
        // As vectors of R⁶: (1, 0, 0, 0, 0, −1)/√2 and (0, 1, 0, 0, 1, 0)/√2.
        assert!((first[0].re.abs() - root).abs() < 1e-4 && (first[0].re + first[2].im).abs() < 1e-4);
        assert!((second[0].im.abs() - root).abs() < 1e-4 && (second[0].im - second[2].re).abs() < 1e-4);
        assert!((found.scale[1] - 0.01).abs() < 1e-5, "{:?}", found.scale);
        assert!(found.scale[0] < 2e-3 && found.scale[2] < 2e-3, "{:?}", found.scale);
    }

    #[test]
    fn nothing_to_find_is_no_number_gone_wrong() {
        for value in [0.0, 1e300, f64::NAN] {
            let found = Principal::new(&[value; 12], 3, 4);
            assert!(found.scale.iter().all(|s| s.is_finite() && *s > 0.0), "{value}: {found:?}");
        }
    }
}
