//! The loop of head and neck over a sample, and its derivative with respect to K_p, with sizes known at compile time
//! and a loop in every lane.
//!
//! The matrices of [`HeadNeck`] are affine in K_p, so that their derivative is a difference. `exp([A B; 0 0] T)` comes
//! from a Taylor polynomial after halving, and the derivative from the same steps by the product rule.

use super::lanes::lanes;
use crate::control::Discrete;
use crate::control::parametric::ParametricModel as _;
use crate::plants::head_neck::{COUNT, Drive, HeadNeck};
use pulp::Simd;

/// States of the loop: the angle y, its rate, the muscle's torque M, ∫e and the filtered error ξ.
pub(super) const STATES: usize = 5;
/// States and the target as seen.
pub(super) const WITH_TARGET: usize = STATES + 1;
/// States, the target as seen and the muscle's noise.
pub(super) const WITH_NOISE: usize = STATES + 2;
/// The norm that the matrix is halved to, and the terms of the polynomial: the rest is below 1e-16.
const NORM: f64 = 0.25;
const TERMS: usize = 10;

/// `[A B]` of W columns, a loop in every lane.
pub(super) type Rows<S, const W: usize> = [[<S as Simd>::f64s; W]; STATES];

/// A loop in continuous time.
#[derive(Debug, Clone)]
pub(super) struct Continuous {
    /// `[A B] T` over a sample T.
    whole: [[f64; WITH_NOISE]; STATES],
    /// Its derivative with respect to K_p.
    slope: [[f64; WITH_NOISE]; STATES],
    /// The row of the acceleration over the states.
    acceleration: [f64; STATES],
    /// What the muscle's noise adds to it.
    noise_to_acceleration: f64,
}

impl Continuous {
    /// The loop with the controller's gains, a body, and the declared time constants; `None` where it is not defined.
    pub(super) fn new(gains: [f64; 3], body: [f64; 3], times: [f64; 2], time: Discrete) -> Option<Self> {
        let matrices = |gains: [f64; 3]| {
            let [k_p, k_d, k_i] = gains;
            let [inertia, damping, stiffness] = body;
            // The delay is not part of the loop here, and its value no matter.
            let values: [f64; COUNT] = [k_p, k_d, k_i, 0.1, inertia, damping, stiffness, times[0], times[1]];
            let model = HeadNeck::new(values, Vec::new(), Drive::SeenTargetAndNoise).ok()?;
            Some(model.matrices::<f64>(&[]))
        };
        let over_a_sample = |m: &crate::control::parametric::Matrices<f64>| -> [[f64; WITH_NOISE]; STATES] {
            let entry = |i: usize, j: usize| if j < STATES { m.a[(i, j)] } else { m.b[(i, j - STATES)] };
            std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j) * time.period_s()))
        };
        let own = matrices(gains)?;
        let whole = over_a_sample(&own);
        // One unit more: the difference of affine functions is their slope.
        let more = over_a_sample(&matrices([gains[0] + 1.0, gains[1], gains[2]])?);
        Some(Self {
            slope: std::array::from_fn(|i| std::array::from_fn(|j| more[i][j] - whole[i][j])),
            whole,
            acceleration: std::array::from_fn(|j| own.c[(2, j)]),
            noise_to_acceleration: own.d[(2, 1)],
        })
    }

    /// How often `[A B] T` is halved, and the power of a half that this is.
    fn halvings(&self) -> (f64, f64) {
        let column = |j: usize| self.whole.iter().map(|row| row[j].abs()).sum::<f64>();
        let norm = (0..WITH_NOISE).map(column).fold(0.0, f64::max);
        let halvings = (norm / NORM).log2().ceil().clamp(0.0, 60.0);
        (halvings, 0.5_f64.powi(halvings as i32))
    }
}

/// The row of the acceleration over states and noise, of the loop in every lane.
#[inline(always)]
pub(super) fn acceleration<S: Simd>(simd: S, loops: &[Continuous]) -> [S::f64s; WITH_TARGET] {
    let entry = |l: usize, j: usize| {
        let own = &loops[l.min(loops.len() - 1)];
        if j < STATES { own.acceleration[j] } else { own.noise_to_acceleration }
    };
    std::array::from_fn(|j| lanes(simd, |l| entry(l, j)))
}

/// The sampled loops, and their derivatives with respect to K_p where these are asked for. Lanes beyond the loops hold
/// the last one.
#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "chains of iterators are not inlined into code for vectors")]
pub(super) fn sampled<S: Simd, const W: usize>(
    simd: S,
    loops: &[Continuous],
    with_slope: bool,
) -> (Rows<S, W>, Rows<S, W>) {
    let own = |l: usize| &loops[l.min(loops.len() - 1)];
    let mut shares = [(0.0, 1.0); super::lanes::MOST];
    for (l, share) in shares.iter_mut().enumerate() {
        *share = own(l).halvings();
    }
    let zero = simd.splat_f64s(0.0);
    let (mut m, mut direction) = ([[zero; W]; STATES], [[zero; W]; STATES]);
    for i in 0..STATES {
        for j in 0..W {
            m[i][j] = lanes(simd, |l| own(l).whole[i][j] * shares[l].1);
            direction[i][j] = lanes(simd, |l| own(l).slope[i][j] * shares[l].1);
        }
    }
    // P ← I + M P/k, by the product rule for its derivative. The rows below are those of the identity and of zero.
    let mut value = [[zero; W]; STATES];
    let mut slope = value;
    for i in 0..STATES {
        value[i][i] = simd.splat_f64s(1.0);
    }
    for k in (1..=TERMS).rev() {
        let inverse = simd.splat_f64s((k as f64).recip());
        if with_slope {
            let through = product(simd, &m, &slope, false);
            let direct = product(simd, &direction, &value, true);
            for i in 0..STATES {
                for j in 0..W {
                    slope[i][j] = simd.mul_f64s(simd.add_f64s(through[i][j], direct[i][j]), inverse);
                }
            }
        }
        value = product(simd, &m, &value, true);
        for i in 0..STATES {
            for j in 0..W {
                value[i][j] = simd.mul_f64s(value[i][j], inverse);
            }
            value[i][i] = simd.add_f64s(value[i][i], simd.splat_f64s(1.0));
        }
    }
    let halvings = lanes(simd, |l| shares[l].0);
    let most = shares.iter().map(|share| share.0).fold(0.0, f64::max) as usize;
    for k in 0..most {
        let goes_on = simd.less_than_f64s(simd.splat_f64s(k as f64), halvings);
        let squared = product(simd, &value, &value, true);
        let (left, right) = if with_slope {
            (product(simd, &slope, &value, true), product(simd, &value, &slope, false))
        } else {
            (slope, slope)
        };
        for i in 0..STATES {
            for j in 0..W {
                let both = simd.add_f64s(left[i][j], right[i][j]);
                slope[i][j] = simd.select_f64s(goes_on, both, slope[i][j]);
                value[i][j] = simd.select_f64s(goes_on, squared[i][j], value[i][j]);
            }
        }
    }
    (value, slope)
}

/// `X [Y; 0 I]`, or `X [Y; 0 0]`.
#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "chains of iterators are not inlined into code for vectors")]
fn product<S: Simd, const W: usize>(simd: S, x: &Rows<S, W>, y: &Rows<S, W>, unit: bool) -> Rows<S, W> {
    let mut found = [[simd.splat_f64s(0.0); W]; STATES];
    for i in 0..STATES {
        for j in 0..W {
            let mut sum = if unit && j >= STATES { x[i][j] } else { simd.splat_f64s(0.0) };
            for k in 0..STATES {
                sum = simd.mul_add_f64s(x[i][k], y[k][j], sum);
            }
            found[i][j] = sum;
        }
    }
    found
}

/// `A x + B u` with as many inputs as are given.
#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "chains of iterators are not inlined into code for vectors")]
pub(super) fn next<S: Simd, const W: usize, const INPUTS: usize>(
    simd: S,
    rows: &Rows<S, W>,
    state: &[S::f64s; STATES],
    inputs: &[S::f64s; INPUTS],
) -> [S::f64s; STATES] {
    let mut found = *state;
    for i in 0..STATES {
        let mut sum = simd.mul_f64s(rows[i][0], state[0]);
        for j in 1..STATES {
            sum = simd.mul_add_f64s(rows[i][j], state[j], sum);
        }
        for j in 0..INPUTS {
            sum = simd.mul_add_f64s(rows[i][STATES + j], inputs[j], sum);
        }
        found[i] = sum;
    }
    found
}
