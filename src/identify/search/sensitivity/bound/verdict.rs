//! What a bound says of each denominator of a block, for a cluster and for each of its parts.

use super::bounds::Bounds;
use super::cluster_frame::{ClusterFrame, Range};
use crate::identify::search::sensitivity::build::denominators::{FREE, MEMBER_LANES};
use crate::identify::search::sensitivity::build::size::{DIRECTIONS, PARTS};
use crate::identify::search::simd::lanes::{Packed, Real};
use pulp::{Simd, WithSimd};

/// Denominators that may have a member within the limit, a bit each.
#[derive(Debug, Clone)]
pub(super) struct Verdict<N> {
    /// In the cluster.
    pub alive: u64,
    /// If asked for: in each part, as far as the cluster's own y tells, and the smallest bound there.
    pub parts: [u64; PARTS],
    pub least: [N; PARTS],
    /// If not: the smallest bound in the cluster. −∞ where nothing is known.
    pub bound: N,
}

/// The bound of each denominator in `mask`, by its offsets, from a lane of the kernel's answer. With `divided`, the
/// cluster's y bounds its parts as well, over the smaller boxes that they have in its coordinates: many need no y of
/// their own.
pub(super) fn verdict<N: Real>(
    frame: &ClusterFrame<N>,
    bounds: &Bounds<N>,
    lane: usize,
    offsets: &[[[N; MEMBER_LANES]; FREE]],
    mask: u64,
    limit: N,
    divided: bool,
) -> Verdict<N> {
    pulp::Arch::new().dispatch(Find { frame, bounds, lane, offsets, mask, limit, divided })
}

struct Find<'a, N> {
    frame: &'a ClusterFrame<N>,
    bounds: &'a Bounds<N>,
    lane: usize,
    offsets: &'a [[[N; MEMBER_LANES]; FREE]],
    mask: u64,
    limit: N,
    divided: bool,
}

/// Bit i of byte j becomes bit j of byte i.
#[inline(always)]
fn transposed(mut bytes: u64) -> u64 {
    for (mask, shift) in [(0x00aa_00aa_00aa_00aa, 7), (0x0000_cccc_0000_cccc, 14), (0x0000_0000_f0f0_f0f0, 28)] {
        let swapped = (bytes ^ (bytes >> shift)) & mask;
        bytes ^= swapped ^ (swapped << shift);
    }
    bytes
}

/// A vector of a chunk.
#[inline(always)]
fn vector<S: Simd, N: Real>(simd: S, chunk: &[N; MEMBER_LANES], v: usize) -> Packed<S, N> {
    Packed::new(simd, N::vectors::<S>(chunk)[v])
}

/// `sum + Σ_m min over the ranges of slope_m t_m`.
#[inline(always)]
fn least_over<S: Simd, N: Real>(
    simd: S,
    mut sum: Packed<S, N>,
    slopes: &[[Packed<S, N>; 2]; DIRECTIONS],
    ranges: &[Range<N>],
) -> Packed<S, N> {
    for ([slope, modulus], range) in slopes.iter().zip(ranges) {
        sum = slope.times_plus(Packed::of(simd, range.middle), sum);
        sum = modulus.times_from(Packed::of(simd, range.half), sum);
    }
    sum
}

impl<N: Real> WithSimd for Find<'_, N> {
    type Output = Verdict<N>;

    #[inline(always)]
    // Indices run over several arrays at once.
    #[allow(clippy::needless_range_loop)]
    fn with_simd<S: Simd>(self, simd: S) -> Verdict<N> {
        let Self { frame, bounds, lane, offsets, mask, limit, divided } = self;
        let number = |x: N| Packed::<S, N>::of(simd, x);
        let (zero, infinite, within) = (number(N::default()), number(N::INFINITY), number(limit));
        let nothing = number(N::nearest(f64::NEG_INFINITY));
        // Affine and quadratic in the offsets.
        let affine: [N; FREE + 1] = std::array::from_fn(|i| bounds.base[i][lane] - bounds.square[i][lane]);
        let centre = number(affine[0] - bounds.lost[lane]);
        let (along_a, along_b) = (number(affine[1]), number(affine[2]));
        let square = |i: usize| number(bounds.square[i][lane]);
        let (aa, ab, bb) = (square(3), square(4), square(5));
        let faint = bounds.faint.each_ref().map(|lanes| lanes[lane]);
        let mut faint_of_whole = zero;
        for (slope, range) in faint.into_iter().zip(&frame.ranges[DIRECTIONS..]) {
            let slope = number(slope);
            faint_of_whole = slope.times_plus(number(range.middle), faint_of_whole);
            faint_of_whole = slope.modulus().times_from(number(range.half), faint_of_whole);
        }
        let mut faint_of_parts = [N::default(); PARTS];
        if divided {
            for (slope, range) in faint.into_iter().zip(&frame.faint) {
                for part in 0..PARTS {
                    let least = slope * range.middle[part] - slope.magnitude() * range.half[part];
                    faint_of_parts[part] = faint_of_parts[part] + least;
                }
            }
        }
        let count = N::vectors::<S>(&offsets[0][0]).len();
        let powers: [N; PARTS] = std::array::from_fn(|part| N::nearest(f64::from(1_u32 << part)));
        let mut parts = [0_u64; PARTS];
        let (mut least, mut least_of_parts) = (infinite, [infinite; PARTS]);
        for (chunk, [a, b]) in offsets.iter().enumerate() {
            let bits = (mask >> (chunk * MEMBER_LANES)) & ((1 << MEMBER_LANES) - 1);
            if bits == 0 {
                continue;
            }
            let absent: [N; MEMBER_LANES] =
                std::array::from_fn(|j| if bits & (1 << j) == 0 { N::INFINITY } else { N::default() });
            // Which parts each denominator lives in, a bit for each.
            let mut living = [N::default(); MEMBER_LANES];
            for v in 0..count {
                let (a, b, absent) = (vector(simd, a, v), vector(simd, b, v), vector(simd, &absent, v));
                let mut here = along_a.times_plus(a, along_b.times_plus(b, centre));
                here = aa.times_from(a * a, here);
                here = ab.times_from(a * b, here);
                here = bb.times_from(b * b, here) + absent;
                let mut tilted = [[zero; 2]; DIRECTIONS];
                for (tilted, slopes) in tilted.iter_mut().zip(&bounds.slopes) {
                    let slope = number(slopes[2][lane]).times_plus(b, number(slopes[0][lane]));
                    let slope = number(slopes[1][lane]).times_plus(a, slope);
                    *tilted = [slope, slope.modulus()];
                }
                let whole = least_over(simd, here + faint_of_whole, &tilted, &frame.ranges);
                let whole = whole.max(nothing);
                if whole.smallest() > limit {
                    continue;
                }
                let mut lives = zero;
                if divided {
                    for part in 0..frame.parts {
                        let bound =
                            least_over(simd, here + number(faint_of_parts[part]), &tilted, &frame.leading[part]);
                        // The whole's bound holds for the parts as well, and what is no number says nothing.
                        let bound = bound.max(whole);
                        lives = lives + bound.where_above(within, zero, number(powers[part]));
                        least_of_parts[part] = least_of_parts[part].min(bound.where_above(within, infinite, bound));
                    }
                } else {
                    lives = whole.where_above(within, zero, number(powers[0]));
                    least = least.min(whole.where_above(within, infinite, whole));
                }
                N::vectors_mut::<S>(&mut living)[v] = lives.x;
            }
            let mut bytes = [[0; 8]; MEMBER_LANES / 8];
            for (bytes, living) in bytes.iter_mut().zip(living.chunks_exact(8)) {
                bytes.iter_mut().zip(living).for_each(|(byte, lives)| *byte = lives.byte());
            }
            for (eighth, bytes) in bytes.into_iter().enumerate() {
                let of_parts = transposed(u64::from_le_bytes(bytes)).to_le_bytes();
                let at = chunk * MEMBER_LANES + 8 * eighth;
                parts.iter_mut().zip(of_parts).for_each(|(into, bits)| *into |= u64::from(bits) << at);
            }
        }
        parts.iter_mut().for_each(|bits| *bits &= mask);
        let alive = parts.iter().fold(0, |all, bits| all | bits);
        let mut verdict = Verdict { alive, parts, least: [N::INFINITY; PARTS], bound: least.smallest() };
        // No `map`: what it calls is not inlined where the instructions are known.
        for (into, least) in verdict.least.iter_mut().zip(least_of_parts).take(if divided { frame.parts } else { 0 }) {
            *into = least.smallest();
        }
        verdict
    }
}
