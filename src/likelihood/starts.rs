//! Where the search starts, without a guess of the user's.

use crate::control::lqg::lqr;
use crate::control::lyapunov::Clock;
use crate::num::rng::Stream;
use nalgebra::DMatrix;
use rand::RngExt;

/// Draws whose regulators weigh all states alike; their control weights go through as many decades.
const PLAIN: usize = 13;

/// Parameters near their nominal values or, after the plain draws, anywhere within their bounds: by the logarithm where
/// the bounds are positive.
pub(super) fn around(nominal: &[f64], bounds: &[[f64; 2]], stream: &mut Stream, index: usize) -> Vec<f64> {
    let mut values = Vec::with_capacity(nominal.len());
    for (value, [lower, upper]) in nominal.iter().zip(bounds) {
        // Always drawn, so that a bound does not move what the other parameters get.
        let share: f64 = stream.random();
        let drawn = if index < PLAIN {
            *value
        } else if lower.is_finite() && upper.is_finite() {
            if *lower > 0.0 { lower * (upper / lower).powf(share) } else { lower + share * (upper - lower) }
        } else {
            value * 10.0_f64.powf(share - 0.5)
        };
        values.push(drawn.clamp(*lower, *upper));
    }
    values
}

/// The regulator of some weights: the identity and a power of ten for the plain draws, random diagonal ones over six
/// decades after.
pub(super) fn regulator(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    clock: Clock,
    stream: &mut Stream,
    index: usize,
) -> Option<DMatrix<f64>> {
    let (n, m) = b.shape();
    let mut decades = |half: f64| 10.0_f64.powf(half * (2.0 * stream.random::<f64>() - 1.0));
    let (q, r) = if index < PLAIN {
        // 1, 10, 0.1, 100, ...: the middle first.
        let step = index.div_ceil(2) as i32;
        let weight = 10.0_f64.powi(if index % 2 == 1 { step } else { -step });
        (DMatrix::identity(n, n), DMatrix::identity(m, m) * weight)
    } else {
        let q = DMatrix::from_fn(n, n, |i, j| if i == j { decades(3.0) } else { 0.0 });
        let all = decades(6.0);
        let r = DMatrix::from_fn(m, m, |i, j| if i == j { all * decades(1.0) } else { 0.0 });
        (q, r)
    };
    lqr(a, b, &q, &r, clock).ok().map(|found| found.k)
}
