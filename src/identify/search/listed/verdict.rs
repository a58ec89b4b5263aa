//! What a bound says of each denominator of a block, for a cluster and for each of its parts.

use super::denominators::{FREE, WIDE};
use super::frame::Frame;
use super::kernel::Bounds;
use super::real::Real;
use super::{DIRECTIONS, FAINT, PARTS};
use pulp::{Simd, WithSimd};

/// Denominators that may have a member within the limit, a bit each.
#[derive(Debug, Clone)]
pub(super) struct Verdict<N> {
    /// In the cluster.
    pub alive: u64,
    /// In each part, as far as the cluster's own y tells, and the smallest bound; if asked for.
    pub parts: [u64; PARTS],
    pub least: [N; PARTS],
    /// The smallest bound in the cluster; −∞ where nothing is known.
    pub bound: N,
}

/// The bound of each denominator in `mask`, by its offsets, from a lane of the kernel's answer. With `divided`, the cluster's y bounds its parts as well, over
/// the smaller boxes that they have in its coordinates: many need no y of their own.
pub(super) fn verdict<N: Real>(
    frame: &Frame<N>,
    bounds: &Bounds<N>,
    lane: usize,
    offsets: &[[[N; WIDE]; FREE]],
    mask: u64,
    limit: N,
    divided: bool,
) -> Verdict<N> {
    pulp::Arch::new().dispatch(Find { frame, bounds, lane, offsets, mask, limit, divided })
}

struct Find<'a, N> {
    frame: &'a Frame<N>,
    bounds: &'a Bounds<N>,
    lane: usize,
    offsets: &'a [[[N; WIDE]; FREE]],
    mask: u64,
    limit: N,
    divided: bool,
}

impl<N: Real> WithSimd for Find<'_, N> {
    type Output = Verdict<N>;

    /// Plain loops, which the compiler vectorises for the dispatched instructions.
    #[inline(always)]
    // Indices run over several arrays at once.
    #[allow(clippy::needless_range_loop)]
    fn with_simd<S: Simd>(self, _: S) -> Verdict<N> {
        let Self { frame, bounds, lane, offsets, mask, limit, divided } = self;
        let nothing = N::nearest(f64::NEG_INFINITY);
        let mut verdict = Verdict { alive: 0, parts: [0; PARTS], least: [N::INFINITY; PARTS], bound: N::INFINITY };
        let base: [N; 3] = std::array::from_fn(|i| bounds.base[i][lane]);
        let square: [N; 6] = std::array::from_fn(|i| bounds.square[i][lane]);
        let slopes: [[N; 3]; DIRECTIONS] = std::array::from_fn(|m| std::array::from_fn(|i| bounds.slopes[m][i][lane]));
        let lost = bounds.lost[lane];
        let mut faint = N::default();
        let mut faint_of_parts = [N::default(); PARTS];
        for m in 0..FAINT {
            let slope = bounds.faint[m][lane];
            let at = DIRECTIONS + m;
            faint = faint + (slope * frame.low[at]).smaller(slope * frame.high[at]);
            for part in 0..PARTS {
                let (low, high) = (frame.parts_low[at][part], frame.parts_high[at][part]);
                faint_of_parts[part] = faint_of_parts[part] + (slope * low).smaller(slope * high);
            }
        }
        // What is no number says nothing, and must not hide in a minimum.
        let known = |bound: N| if bound > nothing { bound } else { nothing };
        for (chunk, [a, b]) in offsets.iter().enumerate() {
            let bits = (mask >> (chunk * WIDE)) & ((1 << WIDE) - 1);
            if bits == 0 {
                continue;
            }
            let mut here = [N::default(); WIDE];
            for j in 0..WIDE {
                let (a, b) = (a[j], b[j]);
                here[j] = base[0] + a * base[1] + b * base[2]
                    - (square[0] + a * square[1] + b * square[2])
                    - (a * a * square[3] + a * b * square[4] + b * b * square[5])
                    - lost;
            }
            let mut tilted = [[N::default(); WIDE]; DIRECTIONS];
            let mut whole = here.map(|here| here + faint);
            for m in 0..DIRECTIONS {
                for j in 0..WIDE {
                    tilted[m][j] = slopes[m][0] + a[j] * slopes[m][1] + b[j] * slopes[m][2];
                    let (low, high) = (tilted[m][j] * frame.low[m], tilted[m][j] * frame.high[m]);
                    whole[j] = whole[j] + low.smaller(high);
                }
            }
            for j in 0..WIDE {
                if bits & (1 << j) == 0 || whole[j] > limit {
                    continue;
                }
                let bit = 1 << (chunk * WIDE + j);
                verdict.bound = verdict.bound.smaller(known(whole[j]));
                if !divided {
                    verdict.alive |= bit;
                    continue;
                }
                let mut of_parts = faint_of_parts.map(|faint| here[j] + faint);
                for m in 0..DIRECTIONS {
                    for part in 0..PARTS {
                        let low = tilted[m][j] * frame.parts_low[m][part];
                        let high = tilted[m][j] * frame.parts_high[m][part];
                        of_parts[part] = of_parts[part] + low.smaller(high);
                    }
                }
                for part in 0..PARTS {
                    let dead = of_parts[part] > limit;
                    let alive = if dead { 0 } else { bit };
                    verdict.alive |= alive;
                    verdict.parts[part] |= alive;
                    let least = if dead { N::INFINITY } else { known(of_parts[part]) };
                    verdict.least[part] = verdict.least[part].smaller(least);
                }
            }
        }
        verdict
    }
}
