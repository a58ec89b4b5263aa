//! Adaptive Gauss–Kronrod quadrature of band averages.

use std::collections::BinaryHeap;

/// Nodes in (0, 1] of the 15-point Kronrod rule on (−1, 1), outermost first; every second one belongs to the 7-point
/// Gauss rule, as does the centre. (Standard tables, e.g. Piessens et al., QUADPACK, 1983.)
const NODES: [f64; 7] = [
    0.991_455_371_120_812_6,
    0.949_107_912_342_758_5,
    0.864_864_423_359_769_1,
    0.741_531_185_599_394_4,
    0.586_087_235_467_691_1,
    0.405_845_151_377_397_2,
    0.207_784_955_007_898_47,
];
const KRONROD: [f64; 7] = [
    0.022_935_322_010_529_224,
    0.063_092_092_629_978_55,
    0.104_790_010_322_250_19,
    0.140_653_259_715_525_92,
    0.169_004_726_639_267_9,
    0.190_350_578_064_785_4,
    0.204_432_940_075_298_89,
];
const KRONROD_CENTRE: f64 = 0.209_482_141_084_727_82;
const GAUSS: [f64; 3] = [0.129_484_966_168_869_7, 0.279_705_391_489_276_64, 0.381_830_050_505_118_9];
const GAUSS_CENTRE: f64 = 0.417_959_183_673_469_4;

/// The estimated error may be this share of the integral.
pub(crate) const RELATIVE_TOLERANCE: f64 = 1e-9;
/// … plus this share of the integral of the terms' moduli, below which differences are rounding.
const ROUNDING_SHARE: f64 = 1e-13;
/// An interval this much narrower than the band that still carries error sits on a singularity.
const NARROWEST: f64 = 1e-10;
const FIRST_INTERVALS: usize = 8;
const MOST_INTERVALS: usize = 4_000;

/// Why an integral has no value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum NoIntegral {
    /// The integrand is not finite, or grows without bound, near this point.
    Singular(f64),
    /// Too many intervals; the estimate of the relative error reached.
    NotConverged(f64),
}

/// What is integrated: the value, and the size of the terms it is the sum of.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub value: f64,
    pub terms: f64,
}

#[derive(Debug, Clone, Copy)]
struct Piece {
    from: f64,
    to: f64,
    value: f64,
    terms: f64,
    error: f64,
}

impl PartialEq for Piece {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}
impl Eq for Piece {}
impl PartialOrd for Piece {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Piece {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        // Ties by position keep the order of refinement, and with it every bit of the answer, reproducible.
        self.error.total_cmp(&other.error).then(other.from.total_cmp(&self.from))
    }
}

/// `1/(to − from) ∫ f` with an estimated error of at most `1e-9` of it (or `1e-13` of the mean size of its terms).
///
/// The end points themselves are never evaluated, so a removable singularity there does no harm; one inside is bridged
/// by the mean of its neighbours.
pub(crate) fn mean(f: impl Fn(f64) -> Sample, from: f64, to: f64) -> Result<f64, NoIntegral> {
    let width = to - from;
    let mut heap = BinaryHeap::new();
    for i in 0..FIRST_INTERVALS {
        let edge = |k: usize| from + width * k as f64 / FIRST_INTERVALS as f64;
        heap.push(piece(&f, edge(i), edge(i + 1), width)?);
    }
    loop {
        // Summed anew each time: a running sum would keep the rounding of the large early errors.
        let (value, terms, error) =
            heap.iter().fold((0.0, 0.0, 0.0), |s, p| (s.0 + p.value, s.1 + p.terms, s.2 + p.error));
        if error <= RELATIVE_TOLERANCE * value + ROUNDING_SHARE * terms {
            return Ok(value / width);
        }
        if heap.len() >= MOST_INTERVALS {
            return Err(NoIntegral::NotConverged(error / value));
        }
        let Some(worst) = heap.pop() else { return Err(NoIntegral::NotConverged(f64::INFINITY)) };
        let middle = 0.5 * (worst.from + worst.to);
        if worst.to - worst.from < NARROWEST * width || middle <= worst.from || middle >= worst.to {
            return Err(NoIntegral::Singular(middle));
        }
        heap.push(piece(&f, worst.from, middle, width)?);
        heap.push(piece(&f, middle, worst.to, width)?);
    }
}

fn piece(f: &impl Fn(f64) -> Sample, from: f64, to: f64, width: f64) -> Result<Piece, NoIntegral> {
    let centre = 0.5 * (from + to);
    let half = 0.5 * (to - from);
    let at = |x: f64| -> Result<Sample, NoIntegral> {
        let sample = f(x);
        if sample.value.is_finite() && sample.terms.is_finite() {
            return Ok(sample);
        }
        let step = 1e-9 * width;
        let (left, right) = (f(x - step), f(x + step));
        let bridged = Sample { value: 0.5 * (left.value + right.value), terms: 0.5 * (left.terms + right.terms) };
        if bridged.value.is_finite() && bridged.terms.is_finite() { Ok(bridged) } else { Err(NoIntegral::Singular(x)) }
    };
    let middle = at(centre)?;
    let mut kronrod = KRONROD_CENTRE * middle.value;
    let mut gauss = GAUSS_CENTRE * middle.value;
    let mut terms = KRONROD_CENTRE * middle.terms;
    for (i, (node, weight)) in NODES.iter().zip(KRONROD).enumerate() {
        let (left, right) = (at(centre - half * node)?, at(centre + half * node)?);
        let pair = left.value + right.value;
        kronrod += weight * pair;
        terms += weight * (left.terms + right.terms);
        if i % 2 == 1 {
            gauss += GAUSS[i / 2] * pair;
        }
    }
    Ok(Piece { from, to, value: kronrod * half, terms: terms * half, error: ((kronrod - gauss) * half).abs() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(f: impl Fn(f64) -> f64) -> impl Fn(f64) -> Sample {
        move |x| {
            let value = f(x);
            Sample { value, terms: value.abs() }
        }
    }

    #[test]
    fn polynomials_up_to_degree_22_are_exact() {
        for degree in 0..=22 {
            let exact = (3.0_f64.powi(degree + 1) - 1.0) / f64::from(degree + 1) / 2.0;
            let value = mean(plain(|x| x.powi(degree)), 1.0, 3.0).unwrap();
            assert!((value / exact - 1.0).abs() < 1e-13, "degree {degree}: {value} {exact}");
        }
    }

    #[test]
    fn a_kink_and_a_narrow_peak_are_found() {
        let kink = mean(plain(|x| (x - 0.3).abs()), 0.0, 1.0).unwrap();
        assert!((kink - (0.09 + 0.49) / 2.0).abs() < 1e-9, "{kink}");
        let width = 1e-3;
        let peak = mean(plain(|x| 1.0 / ((x - 0.7_f64).powi(2) + width * width)), 0.0, 1.0).unwrap();
        let exact = ((0.3_f64 / width).atan() + (0.7_f64 / width).atan()) / width;
        assert!((peak / exact - 1.0).abs() < 1e-8, "{peak} {exact}");
    }

    #[test]
    fn a_pole_has_no_integral_wherever_it_lies() {
        for pole in [0.0, 0.123, 0.5, 1.0] {
            let Err(NoIntegral::Singular(x)) = mean(plain(|x| 1.0 / (x - pole).abs()), 0.0, 1.0) else {
                panic!("the pole at {pole} went unnoticed")
            };
            assert!((x - pole).abs() < 1e-6, "{x} {pole}");
        }
    }

    #[test]
    fn a_removable_singularity_does_no_harm() {
        let value = mean(plain(|x| (x - 0.5) / (x - 0.5)), 0.0, 1.0).unwrap();
        assert!((value - 1.0).abs() < 1e-12);
    }

    #[test]
    fn rounding_alone_is_accepted_as_nothing() {
        let noise = |x: f64| Sample { value: ((x * 1e9).sin() * 1e-16).abs(), terms: 2.0 };
        assert!(mean(noise, 0.0, 1.0).unwrap() < 1e-15);
    }
}
