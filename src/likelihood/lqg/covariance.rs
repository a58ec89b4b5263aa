//! The covariance recursion of the predictor, with its derivatives.
//!
//! With `T = PHᵀ` and `Ā = F − GH`,
//!
//! ```text
//! Σ = HT + N,   G = (FT + X)Σ⁻¹,   P⁺ = ĀPĀᵀ + Q − XGᵀ − GXᵀ + GNGᵀ
//! ```
//! which is the form of Joseph: an error of G enters P⁺ only by its square. G makes P⁺ least, so that ∂G does not enter
//! its derivative either; along a parameter, with `U = ∂F − G∂H` and `∂T = ∂P Hᵀ + P∂Hᵀ`,
//!
//! ```text
//! ∂Σ = H∂T + ∂H T + ∂N,   ∂G = (UT + Ā∂T + ∂X − G∂N)Σ⁻¹
//! ∂P⁺ = Ā∂PĀᵀ + U(ĀP)ᵀ + (ĀP)Uᵀ + ∂Q − ∂X Gᵀ − G∂Xᵀ + G∂N Gᵀ
//! ```

use super::design::{Design, Start, Timing};
use super::jet::Jet;
use super::joint::Joint;
use super::kernel::{add_product, add_transposed, dot, invert, symmetrise};
use crate::control::lyapunov::{Clock, Lyapunov};
use crate::num::linalg::symmetric;
use std::ops::Range;

/// The recursion stands still where a step moves what the predictor is made of by less than this share.
const STILL: f64 = 1e-12;

/// A step; matrices column by column.
pub(super) struct Step {
    /// G, 2n×c.
    pub gain: Vec<f64>,
    /// Σ⁻¹, c×c; zero in the rows of channels that tell nothing.
    pub inverse: Vec<f64>,
    /// log det Σ.
    pub log_det: f64,
    /// Channels that tell something.
    pub told: usize,
    /// Standard deviations of the prediction errors; zero of a channel that tells nothing.
    pub deviations: Vec<f64>,
    /// ∂G of every parameter, one after the other.
    pub gain_slopes: Vec<f64>,
    /// ∂Σ of every parameter, one after the other; zero where a channel tells nothing.
    pub sigma_slopes: Vec<f64>,
    /// `½ tr Σ⁻¹∂_iΣ` of every parameter.
    pub half_traces: Vec<f64>,
    /// `½ tr Σ⁻¹∂_iΣ Σ⁻¹∂_jΣ` of all pairs of parameters.
    pub information: Vec<f64>,
}

/// P with its derivatives.
#[derive(Clone)]
pub(super) struct State {
    pub p: Vec<f64>,
    /// One after the other.
    pub slopes: Vec<f64>,
}

/// Matrices that a step writes to before anything else.
pub(super) struct Scratch {
    /// T, 2n×c.
    t: Vec<f64>,
    /// Ā, ĀP, ∂F − G∂H, Ā∂P: 2n×2n.
    closed: Vec<f64>,
    closed_p: Vec<f64>,
    turned: Vec<f64>,
    closed_dp: Vec<f64>,
    /// X − ½GN and its like, ∂T, ∂G Σ: 2n×c.
    half: Vec<f64>,
    dt: Vec<f64>,
    d_cross: Vec<f64>,
    /// P after the step.
    pub next: State,
}

impl Scratch {
    pub(super) fn new(width: usize, channels: usize, state: &State) -> Self {
        let (square, tall) = (vec![0.0; width * width], vec![0.0; width * channels]);
        Self {
            t: tall.clone(),
            closed: square.clone(),
            closed_p: square.clone(),
            turned: square.clone(),
            closed_dp: square,
            half: tall.clone(),
            dt: tall.clone(),
            d_cross: tall,
            next: state.clone(),
        }
    }
}

impl Design {
    /// Whether the first control tells nothing: recorded exactly, of a belief that is known.
    pub(super) fn is_control_silent(&self) -> bool {
        let is_exact = self.recorded.control.as_ref().is_some_and(|noise| noise.amax() == 0.0);
        is_exact && !self.recorded.is_applied && self.timing == Timing::Predictor && self.start == Start::Rest
    }

    /// Whether the first outputs tell nothing: recorded exactly, of a state that is known.
    pub(super) fn are_outputs_silent(&self) -> bool {
        self.start == Start::Rest && self.recorded.instrument.as_ref().is_some_and(|noise| noise.amax() == 0.0)
    }

    /// The channels that tell something at a sample.
    pub(super) fn told(&self, sample: usize) -> Range<usize> {
        let (outputs, channels) = (self.outputs(), self.channels());
        let first = if sample == 0 && self.are_outputs_silent() { outputs } else { 0 };
        // The terminal cost is of the last sample: there is no control.
        let is_last = self.horizon.is_some_and(|horizon| sample >= horizon.steps);
        let last = if is_last || (sample == 0 && self.is_control_silent()) { outputs } else { channels };
        first..last.max(first)
    }
}

/// Whether G, Σ and their derivatives are those of the step before. P itself would not do: entries that are large, in
/// their units or because nothing is known of a state, hide others that still move. Everything is in units of the
/// prediction errors' deviations, and of the largest gain of its own state.
pub(super) fn stands_still(step: &Step, before: &Step, width: usize) -> bool {
    let channels = step.deviations.len();
    let row = |gain: &[f64], i: usize| {
        (0..channels).map(|j| (gain[i + j * width] * step.deviations[j]).abs()).fold(0.0, f64::max)
    };
    for i in 0..width {
        let size = row(&step.gain, i);
        let moves = |to: &[f64], from: &[f64], size: f64| {
            (0..channels).any(|j| (to[i + j * width] - from[i + j * width]).abs() * step.deviations[j] > STILL * size)
        };
        if moves(&step.gain, &before.gain, size) {
            return false;
        }
        let slopes = step.gain_slopes.chunks_exact(width * channels);
        for (to, from) in slopes.zip(before.gain_slopes.chunks_exact(width * channels)) {
            if moves(to, from, size.max(row(to, i))) {
                return false;
            }
        }
    }
    let order = channels * channels;
    let is_same = |to: &[f64], from: &[f64]| {
        (0..order).all(|at| {
            let size = step.deviations[at % channels] * step.deviations[at / channels];
            (to[at] - from[at]).abs() <= STILL * size
        })
    };
    let mut deviations = step.deviations.iter().zip(&before.deviations);
    deviations.all(|(to, from)| (to - from).abs() <= STILL * to)
        && step
            .sigma_slopes
            .chunks_exact(order)
            .zip(before.sigma_slopes.chunks_exact(order))
            .all(|(to, from)| is_same(to, from))
}

/// P at the first sample, with its derivatives: zero but for noise on its way, or that of the loop's steady state, `P =
/// FPFᵀ + Q`.
pub(super) fn first(start: Start, joint: &Joint) -> Option<State> {
    let (width, count) = (joint.f.shape().0, joint.f.count());
    if start == Start::Rest {
        let mut state = State { p: vec![0.0; width * width], slopes: vec![0.0; width * width * count] };
        if let Some(known) = &joint.on_the_way {
            state.p.copy_from_slice(known.value());
            for (i, slope) in state.slopes.chunks_exact_mut(width * width).enumerate() {
                if let Some(known) = known.slope(i) {
                    slope.copy_from_slice(known);
                }
            }
        }
        return Some(state);
    }
    let f = joint.f.matrix();
    let operator = Lyapunov::new(&f, Clock::Sampled).ok().filter(Lyapunov::is_stable)?;
    let p = operator.solve_adjoint(&symmetric(&joint.q.matrix()));
    let mut slopes = Vec::with_capacity(width * width * count);
    for i in 0..count {
        let mut right = joint.q.slope_matrix(i).unwrap_or_else(|| &p * 0.0);
        if let Some(df) = joint.f.slope_matrix(i) {
            let moved = df * &p * f.transpose();
            right += &moved + moved.transpose();
        }
        slopes.extend_from_slice(operator.solve_adjoint(&symmetric(&right)).as_slice());
    }
    Some(State { p: p.as_slice().to_vec(), slopes })
}

/// A step from `state` to `scratch.next` under this covariance Q; of the `told` channels only, the others tell nothing.
pub(super) fn step(joint: &Joint, q: &Jet, state: &State, told: Range<usize>, scratch: &mut Scratch) -> Option<Step> {
    let (channels, width) = joint.h.shape();
    let [f, h, n, x] = [&joint.f, &joint.h, &joint.n, &joint.x].map(Jet::value);
    let count = joint.f.count();
    let (square, tall, wide) = ([width, width, width], [width, width, channels], [channels, width, channels]);
    let (mixed, outer) = ([width, channels, channels], [width, channels, width]);
    let Scratch { t, closed, closed_p, turned, closed_dp, half, dt, d_cross, next } = scratch;
    let mut found = Step {
        gain: vec![0.0; width * channels],
        inverse: vec![0.0; channels * channels],
        log_det: 0.0,
        told: told.len(),
        deviations: vec![0.0; channels],
        gain_slopes: vec![0.0; width * channels * count],
        sigma_slopes: vec![0.0; channels * channels * count],
        half_traces: vec![0.0; count],
        information: vec![0.0; count * count],
    };
    t.fill(0.0);
    add_transposed(t, &state.p, h, tall, 1.0);
    let mut sigma = n.to_vec();
    add_product(&mut sigma, h, t, wide, 1.0);
    symmetrise(&mut sigma, channels);
    found.log_det = invert(&sigma, channels, told.clone(), &mut found.inverse)?;
    for i in told.clone() {
        found.deviations[i] = sigma[i + i * channels].sqrt();
    }
    half.copy_from_slice(x);
    add_product(half, f, t, tall, 1.0);
    add_product(&mut found.gain, half, &found.inverse, mixed, 1.0);
    let gain = found.gain.as_slice();
    closed.copy_from_slice(f);
    add_product(closed, gain, h, outer, -1.0);
    closed_p.fill(0.0);
    add_product(closed_p, closed, &state.p, square, 1.0);
    next.p.copy_from_slice(q.value());
    add_transposed(&mut next.p, closed_p, closed, square, 1.0);
    half.copy_from_slice(x);
    add_product(half, gain, n, mixed, -0.5);
    add_transposed(&mut next.p, half, gain, outer, -1.0);
    add_transposed(&mut next.p, gain, half, outer, -1.0);
    symmetrise(&mut next.p, width);
    for i in 0..count {
        let dp = &state.slopes[i * width * width..(i + 1) * width * width];
        let d_sigma = &mut found.sigma_slopes[i * channels * channels..(i + 1) * channels * channels];
        let d_next = &mut next.slopes[i * width * width..(i + 1) * width * width];
        dt.fill(0.0);
        add_transposed(dt, dp, h, tall, 1.0);
        d_sigma.fill(0.0);
        d_cross.fill(0.0);
        d_next.fill(0.0);
        if let Some(dq) = q.slope(i) {
            d_next.copy_from_slice(dq);
        }
        let (dn, dx) = (joint.n.slope(i), joint.x.slope(i));
        if dn.is_some() || dx.is_some() {
            if let Some(dx) = dx {
                d_cross.copy_from_slice(dx);
            }
            half.copy_from_slice(d_cross);
            if let Some(dn) = dn {
                d_sigma.copy_from_slice(dn);
                add_product(d_cross, gain, dn, mixed, -1.0);
                add_product(half, gain, dn, mixed, -0.5);
            }
            add_transposed(d_next, half, gain, outer, -1.0);
            add_transposed(d_next, gain, half, outer, -1.0);
        }
        let (df, dh) = (joint.f.slope(i), joint.h.slope(i));
        if df.is_some() || dh.is_some() {
            turned.fill(0.0);
            if let Some(df) = df {
                turned.copy_from_slice(df);
            }
            if let Some(dh) = dh {
                add_transposed(dt, &state.p, dh, tall, 1.0);
                add_product(d_sigma, dh, t, wide, 1.0);
                add_product(turned, gain, dh, outer, -1.0);
            }
            add_product(d_cross, turned, t, tall, 1.0);
            add_transposed(d_next, turned, closed_p, square, 1.0);
            add_transposed(d_next, closed_p, turned, square, 1.0);
        }
        add_product(d_sigma, h, dt, wide, 1.0);
        symmetrise(d_sigma, channels);
        // What tells nothing moves nothing.
        for (at, entry) in d_sigma.iter_mut().enumerate().filter(|_| told.len() < channels) {
            if !(told.contains(&(at % channels)) && told.contains(&(at / channels))) {
                *entry = 0.0;
            }
        }
        add_product(d_cross, closed, dt, tall, 1.0);
        closed_dp.fill(0.0);
        add_product(closed_dp, closed, dp, square, 1.0);
        add_transposed(d_next, closed_dp, closed, square, 1.0);
        symmetrise(d_next, width);
        let d_gain = &mut found.gain_slopes[i * width * channels..(i + 1) * width * channels];
        add_product(d_gain, d_cross, &found.inverse, mixed, 1.0);
        found.half_traces[i] = 0.5 * dot(&found.inverse, d_sigma);
    }
    // Σ⁻¹∂Σ of all parameters, then the traces of their products.
    let order = channels * channels;
    let mut weighted = vec![0.0; order * count];
    add_product(&mut weighted, &found.inverse, &found.sigma_slopes, [channels, channels, channels * count], 1.0);
    for i in 0..count {
        for j in 0..=i {
            let (left, right) = (&weighted[i * order..(i + 1) * order], &weighted[j * order..(j + 1) * order]);
            let mut trace = 0.0;
            for a in 0..channels {
                for b in 0..channels {
                    trace += left[a + b * channels] * right[b + a * channels];
                }
            }
            found.information[i + j * count] = 0.5 * trace;
            found.information[j + i * count] = 0.5 * trace;
        }
    }
    Some(found)
}
