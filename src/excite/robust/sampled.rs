//! The loop of head and neck over a sample, and its derivatives, with sizes known at compile time.
//!
//! The matrices of [`HeadNeck`] are affine in K_p, K_d and K_i, so that their derivatives are differences. `exp([A B; 0
//! 0] T)` comes from a Taylor polynomial after halving, and each derivative from the same steps by the product rule:
//! some microseconds where the general way takes a tenth of a millisecond, and a search samples millions of loops.

use crate::control::Discrete;
use crate::control::parametric::ParametricModel as _;
use crate::plants::head_neck::{COUNT, Drive, HeadNeck};
use nalgebra::{SMatrix, SVector};

/// States of the loop.
pub(super) const STATES: usize = 5;
/// States and inputs: the target as seen, and the muscle's noise.
const WIDTH: usize = STATES + 2;
/// The norm that M is halved to, and the terms of the polynomial: the rest is below 1e-16.
const NORM: f64 = 0.25;
const TERMS: usize = 10;

type Augmented = SMatrix<f64, WIDTH, WIDTH>;
/// A state matrix.
pub(super) type StateMatrix = SMatrix<f64, STATES, STATES>;
/// A state.
pub(super) type State = SVector<f64, STATES>;

/// The sampled loop.
pub(super) struct Sampled {
    pub a: StateMatrix,
    pub b: [State; 2],
    pub c: SMatrix<f64, 3, STATES>,
    pub noise_to_acceleration: f64,
    /// ∂A and ∂B (of the target) with respect to K_p, K_d and K_i, where asked for.
    pub slopes: Option<[(StateMatrix, State); 3]>,
}

impl Sampled {
    /// The loop with the controller's gains, a body, and the declared time constants; `None` where it is not defined.
    pub(super) fn new(
        gains: [f64; 3],
        body: [f64; 3],
        times: [f64; 2],
        time: Discrete,
        with_slopes: bool,
    ) -> Option<Self> {
        let matrices = |gains: [f64; 3]| {
            let [k_p, k_d, k_i] = gains;
            let [inertia, damping, stiffness] = body;
            // The delay is not part of the loop here, and its value no matter.
            let values: [f64; COUNT] = [k_p, k_d, k_i, 0.1, inertia, damping, stiffness, times[0], times[1]];
            let model = HeadNeck::new(values, Vec::new(), Drive::SeenTargetAndNoise).ok()?;
            Some(model.matrices::<f64>(&[]))
        };
        let augmented = |m: &crate::control::parametric::Matrices<f64>| {
            let entry = |i: usize, j: usize| if j < STATES { m.a[(i, j)] } else { m.b[(i, j - STATES)] };
            Augmented::from_fn(|i, j| if i < STATES { entry(i, j) * time.period_s() } else { 0.0 })
        };
        let own = matrices(gains)?;
        let whole = augmented(&own);
        let mut directions = [Augmented::zeros(); 3];
        if with_slopes {
            for (j, direction) in directions.iter_mut().enumerate() {
                let mut more = gains;
                // One unit more: the difference of affine functions is their slope.
                more[j] += 1.0;
                *direction = augmented(&matrices(more)?) - whole;
            }
        }
        let (value, slopes) = exponential(&whole, if with_slopes { &directions } else { &[] });
        let part = |m: &Augmented| (m.fixed_view::<STATES, STATES>(0, 0).into_owned(), column(m, STATES));
        let (a, target) = part(&value);
        if !value.iter().all(|v| v.is_finite()) {
            return None;
        }
        Some(Self {
            a,
            b: [target, column(&value, STATES + 1)],
            c: SMatrix::from_fn(|i, j| own.c[(i, j)]),
            noise_to_acceleration: own.d[(2, 1)],
            slopes: with_slopes.then(|| std::array::from_fn(|j| part(&slopes[j]))),
        })
    }
}

fn column(m: &Augmented, j: usize) -> State {
    State::from_fn(|i, _| m[(i, j)])
}

/// `e^M` and its derivatives along some directions.
fn exponential(m: &Augmented, directions: &[Augmented]) -> (Augmented, [Augmented; 3]) {
    let norm = m.column_iter().map(|c| c.iter().map(|v| v.abs()).sum::<f64>()).fold(0.0, f64::max);
    let halvings = (norm / NORM).log2().ceil().clamp(0.0, 60.0) as i32;
    let share = 0.5_f64.powi(halvings);
    let m = m * share;
    let mut value = Augmented::identity();
    let mut slopes = [Augmented::zeros(); 3];
    for k in (1..=TERMS).rev() {
        // P ← I + M P/k, by the product rule for its derivatives.
        let inverse = (k as f64).recip();
        for (slope, direction) in slopes.iter_mut().zip(directions) {
            *slope = (direction * value * share + m * *slope) * inverse;
        }
        value = Augmented::identity() + m * value * inverse;
    }
    for _ in 0..halvings {
        for (slope, _) in slopes.iter_mut().zip(directions) {
            *slope = *slope * value + value * *slope;
        }
        value *= value;
    }
    (value, slopes)
}
