//! A sample of a cluster, from which its centre, its directions and its division are taken.

use super::deviations::{Columns, Split, crude_logarithms, deviation, response};
use super::line_lanes::{LINE_LANES, LineLanes, Pair, blocks, pairs};
use super::members::Table;
use super::principal::Principal;
use super::size::ALL;
use num_complex::{Complex32, Complex64};
use pulp::{Simd, WithSimd};

/// Deviations below this hardly differ from their logarithms.
const NARROW: f64 = 0.5;

/// The middle of a range divides it, unless that leaves less than this share of the sample on one side. Bounds suffer
/// from what is far off, and the middle puts that apart; the median would leave a long tail in every part.
const LEAST_PART: f64 = 0.05;

/// Members, and room for what is computed of them.
#[derive(Debug, Default)]
pub(crate) struct Sample {
    /// `1 + L`, one member after another in blocks; and what the same lines deviate from the centre by.
    responses: Vec<Pair<f64>>,
    pub deviations: Vec<Pair<f32>>,
    /// Coordinates of the deviations.
    pub along: Vec<LineLanes<f32>>,
}

/// A sample around its logarithmic mean.
#[derive(Debug)]
pub(crate) struct Splitter {
    /// In single precision, exactly; and its reciprocal.
    centre: Vec<Complex64>,
    inverse: Vec<Complex64>,
    /// Root mean square over the lines of the largest deviation in the sample.
    pub size: f64,
}

impl Splitter {
    /// From every so manieth member, of which there is one at least.
    pub(crate) fn new(table: &Table<'_>, members: &[u32], step: usize, lines: usize, sample: &mut Sample) -> Self {
        let mut look = vec![Look::default(); blocks(lines)];
        let responses = &mut sample.responses;
        pulp::Arch::new().dispatch(Take { table, members, step, responses, look: &mut look });
        let count = sample.responses.len() / look.len().max(1);
        let mut centre = Vec::with_capacity(lines);
        for k in 0..lines {
            let (block, at) = (k / LINE_LANES, k % LINE_LANES);
            let here = || sample.responses.iter().skip(block).step_by(look.len()).map(|x| value(x, at));
            let mut c = value(&sample.responses[count / 2 * look.len() + block], at);
            if look[block].is_narrow(at) {
                // Here the mean is as good as that of the logarithms.
                c = look[block].sum(at) / count as f64;
            } else {
                // A second round removes what the branch of the logarithm did to the first.
                for _ in 0..2 {
                    let inverse = c.inv();
                    let mean = here().map(|x| (x * inverse).ln()).sum::<Complex64>() / count as f64;
                    if mean.is_finite() {
                        c *= mean.exp();
                    }
                }
            }
            let single = Complex32::new(c.re as f32, c.im as f32);
            centre.push(Complex64::new(f64::from(single.re), f64::from(single.im)));
        }
        let inverse: Vec<Complex64> = centre.iter().map(Complex64::inv).collect();
        let Sample { responses, deviations, .. } = sample;
        deviations.resize(responses.len(), Pair::default());
        let mut largest = vec![LineLanes::default(); look.len()];
        let wide: Vec<_> = pairs(&inverse, 1.0).collect();
        pulp::Arch::new().dispatch(Deviate {
            responses,
            inverse: &wide,
            minus: 1.0,
            deviations,
            largest: &mut largest,
        });
        let squares = largest.iter().flat_map(|l| l.0).map(f64::from);
        let size = (squares.sum::<f64>() / lines as f64).sqrt();
        Self { centre, inverse, size }
    }

    /// Along the principal directions of crude logarithms, which tell even clusters apart whose members differ by
    /// orders of magnitude.
    pub(crate) fn by_logarithms(&self, sample: &mut Sample, halvings: usize) -> Split {
        let Sample { responses, deviations, .. } = sample;
        let mut largest = vec![LineLanes::default(); blocks(self.centre.len())];
        let wide: Vec<_> = pairs(&self.inverse, 1.0).collect();
        pulp::Arch::new().dispatch(Deviate {
            responses,
            inverse: &wide,
            minus: 0.0,
            deviations,
            largest: &mut largest,
        });
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || crude_logarithms(deviations),
        );
        self.split(sample, halvings, halvings)
    }

    /// Along the principal directions of κ. The deviations and the coordinates of the sample stay.
    pub(crate) fn by_coordinates(&self, sample: &mut Sample, halvings: usize) -> Split {
        self.split(sample, ALL, halvings)
    }

    fn split(&self, sample: &mut Sample, count: usize, halvings: usize) -> Split {
        let lines = self.centre.len();
        let Principal { directions, scale } = Principal::new(&sample.deviations, lines, count);
        let columns = Columns::new(&directions, lines);
        columns.along(&sample.deviations, &mut sample.along);
        let mut thresholds = Vec::with_capacity((1 << halvings) - 1);
        let mut order: Vec<u16> = (0..sample.along.len() as u16).collect();
        // Parts lie one after another in the order, and the next halving puts two in the place of each.
        let mut ends = vec![order.len()];
        for m in 0..halvings {
            let along = |at: u16| sample.along[usize::from(at)].0[m];
            let mut next = Vec::with_capacity(2 * ends.len());
            let mut from = 0;
            for end in ends {
                let part = &mut order[from..end];
                let threshold = threshold(part, along);
                thresholds.push(threshold);
                let mut low = from;
                for at in from..end {
                    if along(order[at]) <= threshold {
                        order.swap(low, at);
                        low += 1;
                    }
                }
                next.extend([low, end]);
                from = end;
            }
            ends = next;
        }
        Split { centre: self.centre.clone(), inverse: self.inverse.clone(), directions, columns, scale, thresholds }
    }
}

fn value(pair: &Pair<f64>, at: usize) -> Complex64 {
    Complex64::new(pair.re.0[at], pair.im.0[at])
}

/// Where a part of the sample is divided.
fn threshold(part: &mut [u16], along: impl Fn(u16) -> f32) -> f32 {
    let Some(last) = part.len().checked_sub(1) else { return 0.0 };
    let least = (LEAST_PART * last as f64) as usize;
    let by = |a: &u16, b: &u16| along(*a).total_cmp(&along(*b));
    let (low, high) = part.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), at| {
        let x = along(*at);
        (low.min(x), high.max(x))
    });
    let above = along(*part.select_nth_unstable_by(least, by).1);
    let below = along(*part.select_nth_unstable_by(last - least, by).1);
    // No number where the ends have none; `clamp` would not take that.
    (0.5 * (low + high)).max(above).min(below)
}

/// Of a block's lines, what tells whether the mean will do for a centre.
#[derive(Debug, Clone, Default)]
struct Look {
    /// The largest squared deviation from the middle member; all of them together, where what is no number stays.
    worst: LineLanes<f64>,
    total: LineLanes<f64>,
    sum: Pair<f64>,
}

impl Look {
    fn is_narrow(&self, at: usize) -> bool {
        self.worst.0[at] < NARROW * NARROW && self.total.0[at].is_finite()
    }

    fn sum(&self, at: usize) -> Complex64 {
        value(&self.sum, at)
    }
}

/// Computes the responses.
struct Take<'a> {
    table: &'a Table<'a>,
    members: &'a [u32],
    step: usize,
    responses: &'a mut Vec<Pair<f64>>,
    look: &'a mut [Look],
}

impl WithSimd for Take<'_> {
    type Output = ();

    /// Pod loops over the lines, which the compiler vectorises for the dispatched instructions.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { table, members, step, responses, look } = self;
        let count = members.len().div_ceil(step);
        responses.resize(count * look.len(), Pair::default());
        // Where things are comes from far off, for all at once.
        let places: Vec<_> = members.iter().step_by(step).map(|member| table.place(*member)).collect();
        for (place, response_of) in places.iter().zip(responses.chunks_exact_mut(look.len())) {
            let ((d, n), gain) = (table.factors(place), place.gain);
            for ((x, d), n) in response_of.iter_mut().zip(d).zip(n) {
                for k in 0..LINE_LANES {
                    (x.re.0[k], x.im.0[k]) = response::<S>(gain, [d.re.0[k], d.im.0[k]], [n.re.0[k], n.im.0[k]]);
                }
            }
        }
        let middle = &responses[count / 2 * look.len()..][..look.len()];
        let mut inverse = middle.to_vec();
        for x in &mut inverse {
            for (re, im) in x.re.0.iter_mut().zip(&mut x.im.0) {
                let square = 1.0 / (*re * *re + *im * *im);
                (*re, *im) = (*re * square, -*im * square);
            }
        }
        for response in responses.chunks_exact(look.len()) {
            for ((look, x), inverse) in look.iter_mut().zip(response).zip(&inverse) {
                let Look { worst, total, sum } = look;
                for k in 0..LINE_LANES {
                    let (re, im) = (x.re.0[k], x.im.0[k]);
                    let d = deviation::<S>([re, im], [inverse.re.0[k], inverse.im.0[k]], 1.0);
                    let square = d[0] * d[0] + d[1] * d[1];
                    worst.0[k] = if square > worst.0[k] { square } else { worst.0[k] };
                    total.0[k] += square;
                    sum.re.0[k] += re;
                    sum.im.0[k] += im;
                }
            }
        }
    }
}

/// Computes the deviations of a sample from its centre, less than their quotient by `minus`.
struct Deviate<'a> {
    responses: &'a [Pair<f64>],
    inverse: &'a [Pair<f64>],
    minus: f64,
    deviations: &'a mut [Pair<f32>],
    /// Largest squares.
    largest: &'a mut [LineLanes<f32>],
}

impl WithSimd for Deviate<'_> {
    type Output = ();

    /// Pod loops over the lines, which the compiler vectorises for the dispatched instructions.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { responses, inverse, minus, deviations, largest } = self;
        let blocks = inverse.len();
        for (responses, deviations) in responses.chunks_exact(blocks).zip(deviations.chunks_exact_mut(blocks)) {
            for (((x, c), into), largest) in responses.iter().zip(inverse).zip(deviations).zip(largest.iter_mut()) {
                for k in 0..LINE_LANES {
                    let d = deviation::<S>([x.re.0[k], x.im.0[k]], [c.re.0[k], c.im.0[k]], minus);
                    let [re, im] = d.map(|d| d as f32);
                    (into.re.0[k], into.im.0[k]) = (re, im);
                    let square = re * re + im * im;
                    largest.0[k] = if square > largest.0[k] { square } else { largest.0[k] };
                }
            }
        }
    }
}
