//! Which gains make a stable loop, for all numerators of a denominator at once: eight rows of the table side by side.
//!
//! Two second-order systems in a loop, whose closed-loop polynomial has degree four, are what the largest pools are
//! made of. The operations of a test are those of [`routh::stable_gains`](super::routh) in the same order, none of them
//! fused, so the answer is the same to the last candidate. What is saved: tests of gains with which a coefficient
//! surely has another sign than the first one.

use super::peak::Quadratic;
use super::routh::POSITIVE;
use pulp::{Simd, WithSimd};

/// Coefficients of a closed-loop polynomial of degree four.
pub(super) const LENGTH: usize = 5;

/// Rows side by side; no vector is longer.
pub(super) const LANES: usize = 8;

/// Relative margin around the gains at which a coefficient vanishes, far above what rounding does to them.
const MARGIN: f64 = 1e-9;

/// Numerators side by side: as many as fill whole groups of [`LANES`].
#[derive(Debug, Clone)]
pub(super) struct Numerators {
    /// The plant's numerator times theirs: what a gain multiplies in the closed-loop polynomial.
    pub steps: [Vec<f64>; LENGTH],
    /// Their squared moduli, where gains are peaks.
    pub squares: Option<[Vec<f64>; 3]>,
}

impl Numerators {
    pub(super) fn new(steps: &[Vec<f64>], squares: Option<&[Quadratic]>) -> Self {
        let whole = steps.len() / LANES * LANES;
        Self {
            steps: std::array::from_fn(|i| steps[..whole].iter().map(|step| step[i]).collect()),
            squares: squares.map(|all| std::array::from_fn(|i| all[..whole].iter().map(|square| square[i]).collect())),
        }
    }

    /// How many numerators stand side by side.
    pub(super) fn len(&self) -> usize {
        self.steps[0].len()
    }
}

/// Listed gains of either sign, by increasing modulus.
#[derive(Debug, Clone)]
pub(super) struct Gains {
    positive: Vec<f64>,
    negative: Vec<f64>,
}

impl Gains {
    pub(super) fn new(gains: &[f64]) -> Self {
        let of = |positive: bool| {
            let mut some: Vec<f64> = gains.iter().copied().filter(|g| (*g > 0.0) == positive).collect();
            some.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
            some
        };
        Self { positive: of(true), negative: of(false) }
    }
}

/// Per numerator, the smallest and the largest modulus of a stable gain times a scale: of positive gains, then of
/// negative ones.
#[derive(Debug, Clone, PartialEq)]
pub struct Extremes {
    /// Smallest of the positive gains; infinite where there is none.
    pub least_positive: Vec<f64>,
    /// Largest of the positive gains; 0 where there is none.
    pub most_positive: Vec<f64>,
    /// Smallest modulus of the negative gains; infinite where there is none.
    pub least_negative: Vec<f64>,
    /// Largest modulus of the negative gains; 0 where there is none.
    pub most_negative: Vec<f64>,
}

impl Extremes {
    /// Of no gains at all, for this many numerators.
    #[must_use]
    pub fn none(numerators: usize) -> Self {
        Self {
            least_positive: vec![f64::INFINITY; numerators],
            most_positive: vec![0.0; numerators],
            least_negative: vec![f64::INFINITY; numerators],
            most_negative: vec![0.0; numerators],
        }
    }

    /// Takes in one more gain, times its scale, of a numerator.
    pub(super) fn take(&mut self, numerator: usize, scaled: f64) {
        let (least, most) = if scaled > 0.0 {
            (&mut self.least_positive[numerator], &mut self.most_positive[numerator])
        } else {
            (&mut self.least_negative[numerator], &mut self.most_negative[numerator])
        };
        *least = least.min(scaled.abs());
        *most = most.max(scaled.abs());
    }
}

/// One denominator with every numerator.
pub(super) struct Scan<'a> {
    pub numerators: &'a Numerators,
    pub gains: &'a Gains,
    /// The plant's denominator times this one.
    pub base: [f64; LENGTH],
    /// The squared modulus of this denominator and the band of its variable, where gains are peaks.
    pub peak: Option<(Quadratic, [f64; 2])>,
    /// What the gains of each numerator are multiplied with before they are taken in.
    pub into: Option<(&'a mut Extremes, f64, &'a [f64])>,
}

impl WithSimd for Scan<'_> {
    /// How many gains are stable.
    type Output = u64;

    #[inline(always)]
    // The index runs over several arrays at once.
    #[allow(clippy::needless_range_loop)]
    fn with_simd<S: Simd>(self, simd: S) -> u64 {
        let Self { numerators, gains, base, peak, mut into } = self;
        let splat = |x: f64| simd.splat_f64s(x);
        let (zero, one, infinity) = (splat(0.0), splat(1.0), splat(f64::INFINITY));
        let sign_bit = splat(-0.0);
        let (mul, add, sub) = (|a, b| simd.mul_f64s(a, b), |a, b| simd.add_f64s(a, b), |a, b| simd.sub_f64s(a, b));
        let min = |a, b| simd.select_f64s(simd.less_than_f64s(a, b), a, b);
        let max = |a, b| simd.select_f64s(simd.greater_than_f64s(a, b), a, b);
        let bases = base.map(splat);
        let moduli = base.map(|b| splat(b.abs()));
        let positive = splat(POSITIVE);
        let whole = numerators.len();
        let steps: [&[S::f64s]; LENGTH] = std::array::from_fn(|i| S::as_simd_f64s(&numerators.steps[i]).0);
        let vectors = steps[0].len();
        let mut counted = zero;
        for v in 0..vectors {
            let step: [S::f64s; LENGTH] = std::array::from_fn(|i| steps[i][v]);
            // What turns a listed gain into the factor in front of the numerator, and its reciprocal.
            let (unit, reciprocal, usable) = match (&numerators.squares, &peak) {
                (Some(squares), Some((d, band))) => {
                    let n: [S::f64s; 3] = std::array::from_fn(|i| S::as_simd_f64s(&squares[i]).0[v]);
                    let largest = largest_ratio(simd, n, d.map(splat), band.map(splat));
                    let peak = simd.sqrt_f64s(largest);
                    let usable = simd.and_m64s(simd.less_than_f64s(peak, infinity), simd.greater_than_f64s(peak, zero));
                    (simd.div_f64s(one, peak), peak, usable)
                }
                _ => (one, one, simd.less_than_f64s(zero, one)),
            };
            // Between these gains all coefficients have the sign +, and between those the sign −.
            let (mut plus, mut minus) = ([simd.neg_f64s(infinity), infinity], [simd.neg_f64s(infinity), infinity]);
            for i in 0..LENGTH {
                let root = simd.div_f64s(simd.neg_f64s(bases[i]), step[i]);
                let (rising, falling) = (simd.greater_than_f64s(step[i], zero), simd.less_than_f64s(step[i], zero));
                plus[0] = simd.select_f64s(rising, max(root, plus[0]), plus[0]);
                plus[1] = simd.select_f64s(falling, min(root, plus[1]), plus[1]);
                minus[0] = simd.select_f64s(falling, max(root, minus[0]), minus[0]);
                minus[1] = simd.select_f64s(rising, min(root, minus[1]), minus[1]);
            }
            for (negative, listed) in [(false, &gains.positive), (true, &gains.negative)] {
                let (mut low, mut high) = (infinity, simd.neg_f64s(infinity));
                for [from, to] in [plus, minus] {
                    let [from, to] = if negative { [simd.neg_f64s(to), simd.neg_f64s(from)] } else { [from, to] };
                    let from = mul(max(from, zero), splat(1.0 - MARGIN));
                    let to = mul(to, splat(1.0 + MARGIN));
                    let some = simd.and_m64s(usable, simd.less_than_or_equal_f64s(from, to));
                    low = simd.select_f64s(some, min(mul(from, reciprocal), low), low);
                    high = simd.select_f64s(some, max(mul(to, reciprocal), high), high);
                }
                let low = simd.reduce_min_f64s(low) * (1.0 - MARGIN);
                let high = simd.reduce_max_f64s(high) * (1.0 + MARGIN);
                let first = listed.partition_point(|g| g.abs() < low);
                let last = listed.partition_point(|g| g.abs() <= high);
                let (mut least, mut most) = (infinity, zero);
                for gain in listed.get(first..last).unwrap_or(&[]) {
                    let g = mul(splat(*gain), unit);
                    // Loops: what `map` and `from_fn` call is not inlined where the instructions are known.
                    let (mut c, mut limit) = ([zero; LENGTH], [zero; LENGTH]);
                    for i in 0..LENGTH {
                        let term = simd.mul_f64s(g, step[i]);
                        c[i] = simd.add_f64s(bases[i], term);
                        limit[i] = simd.mul_f64s(positive, simd.add_f64s(moduli[i], simd.abs_f64s(term)));
                    }
                    let sign = simd.select_f64s(simd.less_than_f64s(c[0], zero), sign_bit, zero);
                    for c in &mut c {
                        *c = simd.xor_f64s(*c, sign);
                    }
                    let d = sub(mul(c[1], c[2]), mul(c[0], c[3]));
                    let cubic = sub(sub(mul(c[3], d), mul(mul(c[1], c[1]), c[4])), mul(limit[3], d));
                    let mut stable = simd.and_m64s(usable, simd.greater_than_f64s(cubic, zero));
                    for above in
                        [sub(c[0], limit[0]), sub(c[1], limit[1]), sub(d, mul(limit[2], c[1])), sub(c[4], limit[4])]
                    {
                        stable = simd.and_m64s(stable, simd.greater_than_f64s(above, zero));
                    }
                    counted = add(counted, simd.select_f64s(stable, one, zero));
                    let modulus = simd.abs_f64s(g);
                    least = simd.select_f64s(stable, min(modulus, least), least);
                    most = simd.select_f64s(stable, max(modulus, most), most);
                }
                if let Some((extremes, scale, scales)) = &mut into {
                    let scale = mul(splat(*scale), S::as_simd_f64s(&scales[..whole]).0[v]);
                    let (into_least, into_most) = if negative {
                        (&mut extremes.least_negative, &mut extremes.most_negative)
                    } else {
                        (&mut extremes.least_positive, &mut extremes.most_positive)
                    };
                    let into_least = &mut S::as_mut_simd_f64s(&mut into_least[..whole]).0[v];
                    *into_least = min(mul(least, scale), *into_least);
                    let into_most = &mut S::as_mut_simd_f64s(&mut into_most[..whole]).0[v];
                    *into_most = max(mul(most, scale), *into_most);
                }
            }
        }
        // Whole numbers far below 2^53.
        simd.reduce_sum_f64s(counted) as u64
    }
}

/// `q0 + x (q1 + x q2)`.
#[inline(always)]
fn value<S: Simd>(simd: S, q: [S::f64s; 3], x: S::f64s) -> S::f64s {
    simd.add_f64s(q[0], simd.mul_f64s(x, simd.add_f64s(q[1], simd.mul_f64s(x, q[2]))))
}

#[inline(always)]
fn ratio<S: Simd>(simd: S, n: [S::f64s; 3], d: [S::f64s; 3], x: S::f64s) -> S::f64s {
    simd.div_f64s(value(simd, n, x), value(simd, d, x))
}

/// The larger one; of a number and no number, the number.
#[inline(always)]
fn larger<S: Simd>(simd: S, a: S::f64s, b: S::f64s) -> S::f64s {
    let is_number = simd.equal_f64s(b, b);
    let keep = simd.or_m64s(simd.greater_than_f64s(a, b), simd.not_m64s(is_number));
    simd.select_f64s(keep, a, b)
}

/// [`super::peak::largest_ratio`], the same operations in the same order.
#[inline(always)]
fn largest_ratio<S: Simd>(simd: S, n: [S::f64s; 3], d: [S::f64s; 3], [low, high]: [S::f64s; 2]) -> S::f64s {
    let (mul, sub) = (|a, b| simd.mul_f64s(a, b), |a, b| simd.sub_f64s(a, b));
    let a = sub(mul(n[2], d[1]), mul(n[1], d[2]));
    let half_b = sub(mul(n[2], d[0]), mul(n[0], d[2]));
    let c = sub(mul(n[1], d[0]), mul(n[0], d[1]));
    let mut largest = larger(simd, ratio(simd, n, d, low), ratio(simd, n, d, high));
    let discriminant = sub(mul(half_b, half_b), mul(a, c));
    let signed = simd.or_f64s(simd.sqrt_f64s(discriminant), simd.and_f64s(half_b, simd.splat_f64s(-0.0)));
    let q = simd.neg_f64s(simd.add_f64s(half_b, signed));
    // Where the discriminant is negative these are no numbers, and inside of nothing.
    for x in [simd.div_f64s(q, a), simd.div_f64s(c, q)] {
        let inside = simd.and_m64s(simd.greater_than_f64s(x, low), simd.less_than_f64s(x, high));
        largest = simd.select_f64s(inside, larger(simd, largest, ratio(simd, n, d, x)), largest);
    }
    largest
}
