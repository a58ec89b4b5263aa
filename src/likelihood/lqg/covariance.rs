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

use super::design::{Design, Member, Start, Timing};
use super::joint::Joint;
use super::kernel::{add_product, add_transposed, dot, invert, symmetrise};
use crate::control::lyapunov::{Clock, Lyapunov};
use crate::ctl::{Ctl, Stopped};
use crate::num::linalg::symmetric;

/// The recursion stands still where a step moves what the predictor is made of by less than this share.
const STILL: f64 = 1e-12;
/// For so many steps, so that a slow mode is not passed over.
const STILL_STEPS: usize = 10;
/// Steps between two questions whether to go on.
const STEPS_BETWEEN_CHECKS: usize = 500;

/// The joint system with its derivatives, each with whether it moves F and H.
pub(super) struct Linear {
    pub joint: Joint,
    pub slopes: Vec<(Joint, bool)>,
}

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
struct State {
    p: Vec<f64>,
    /// One after the other.
    slopes: Vec<f64>,
}

/// Matrices that a step writes to before anything else.
struct Scratch {
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
    next: State,
}

/// Whether the first control tells nothing: recorded exactly, of a belief that is zero for certain.
pub(super) fn is_control_silent(design: &Design) -> bool {
    let is_exact = design.recorded.control.as_ref().is_some_and(|noise| noise.amax() == 0.0);
    is_exact && !design.recorded.is_applied && design.timing == Timing::Predictor && design.start == Start::Rest
}

/// The steps of a person up to where they stand still, or so many; `None` where a covariance is not positive definite.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub(super) fn covariances(
    design: &Design,
    member: &Member,
    longest: usize,
    ctl: &Ctl,
) -> Result<Option<(Linear, Vec<Step>)>, Stopped> {
    let joint = design.joint(member);
    let slopes: Vec<_> = member.slopes.iter().map(|slope| design.joint_slope(member, slope)).collect();
    let linear = Linear { joint, slopes };
    let Some(mut state) = first(design.start, &linear) else { return Ok(None) };
    let (channels, width) = linear.joint.h.shape();
    let [_, _, outputs, _] = design.sizes();
    let first_told = if is_control_silent(design) { outputs } else { channels };
    let (square, tall) = (vec![0.0; width * width], vec![0.0; width * channels]);
    let mut scratch = Scratch {
        t: tall.clone(),
        closed: square.clone(),
        closed_p: square.clone(),
        turned: square.clone(),
        closed_dp: square,
        half: tall.clone(),
        dt: tall.clone(),
        d_cross: tall,
        next: state.clone(),
    };
    let mut steps: Vec<Step> = Vec::new();
    let mut still = 0;
    for k in 0..longest {
        if k % STEPS_BETWEEN_CHECKS == 0 {
            ctl.check()?;
        }
        let told = if k == 0 { first_told } else { channels };
        let Some(found) = step(&linear, &state, told, &mut scratch) else { return Ok(None) };
        steps.push(found);
        let is_still = match steps.as_slice() {
            [.., before, last] => stands_still(last, before, width),
            _ => false,
        };
        still = if is_still { still + 1 } else { 0 };
        std::mem::swap(&mut state, &mut scratch.next);
        if still >= STILL_STEPS {
            break;
        }
    }
    Ok(Some((linear, steps)))
}

/// Whether G, Σ and their derivatives are those of the step before. P itself would not do: entries that are large, in
/// their units or because nothing is known of a state, hide others that still move. Everything is in units of the
/// prediction errors' deviations, and of the largest gain of its own state.
fn stands_still(step: &Step, before: &Step, width: usize) -> bool {
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

/// P at the first sample, with its derivatives: zero, or that of the loop's steady state, `P = FPFᵀ + Q`.
fn first(start: Start, linear: &Linear) -> Option<State> {
    let Joint { f, q, .. } = &linear.joint;
    let width = f.nrows();
    let count = linear.slopes.len();
    if start == Start::Rest {
        return Some(State { p: vec![0.0; width * width], slopes: vec![0.0; width * width * count] });
    }
    let operator = Lyapunov::new(f, Clock::Sampled).ok().filter(Lyapunov::is_stable)?;
    let p = operator.solve_adjoint(&symmetric(q));
    let mut slopes = Vec::with_capacity(width * width * count);
    for (slope, _) in &linear.slopes {
        let moved = &slope.f * &p * f.transpose();
        let solved = operator.solve_adjoint(&symmetric(&(&moved + moved.transpose() + &slope.q)));
        slopes.extend_from_slice(solved.as_slice());
    }
    Some(State { p: p.as_slice().to_vec(), slopes })
}

/// A step from `state` to `scratch.next`; of the first `told` channels only, the others tell nothing.
fn step(linear: &Linear, state: &State, told: usize, scratch: &mut Scratch) -> Option<Step> {
    let Joint { f, h, q, n, x } = &linear.joint;
    let (channels, width) = h.shape();
    let [f, h, n, x] = [f, h, n, x].map(|m| m.as_slice());
    let count = linear.slopes.len();
    let (square, tall, wide) = ([width, width, width], [width, width, channels], [channels, width, channels]);
    let (mixed, outer) = ([width, channels, channels], [width, channels, width]);
    let Scratch { t, closed, closed_p, turned, closed_dp, half, dt, d_cross, next } = scratch;
    let mut found = Step {
        gain: vec![0.0; width * channels],
        inverse: vec![0.0; channels * channels],
        log_det: 0.0,
        told,
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
    found.log_det = invert(&sigma, channels, told, &mut found.inverse)?;
    for i in 0..told {
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
    next.p.copy_from_slice(q.as_slice());
    add_transposed(&mut next.p, closed_p, closed, square, 1.0);
    half.copy_from_slice(x);
    add_product(half, gain, n, mixed, -0.5);
    add_transposed(&mut next.p, half, gain, outer, -1.0);
    add_transposed(&mut next.p, gain, half, outer, -1.0);
    symmetrise(&mut next.p, width);
    for (i, (slope, moves_gains)) in linear.slopes.iter().enumerate() {
        let dp = &state.slopes[i * width * width..(i + 1) * width * width];
        let d_sigma = &mut found.sigma_slopes[i * channels * channels..(i + 1) * channels * channels];
        let d_next = &mut next.slopes[i * width * width..(i + 1) * width * width];
        let [df, dh, dq, dn, dx] = [&slope.f, &slope.h, &slope.q, &slope.n, &slope.x].map(|m| m.as_slice());
        dt.fill(0.0);
        add_transposed(dt, dp, h, tall, 1.0);
        d_sigma.copy_from_slice(dn);
        d_cross.copy_from_slice(dx);
        add_product(d_cross, gain, dn, mixed, -1.0);
        d_next.copy_from_slice(dq);
        half.copy_from_slice(dx);
        add_product(half, gain, dn, mixed, -0.5);
        add_transposed(d_next, half, gain, outer, -1.0);
        add_transposed(d_next, gain, half, outer, -1.0);
        if *moves_gains {
            add_transposed(dt, &state.p, dh, tall, 1.0);
            add_product(d_sigma, dh, t, wide, 1.0);
            turned.copy_from_slice(df);
            add_product(turned, gain, dh, outer, -1.0);
            add_product(d_cross, turned, t, tall, 1.0);
            add_transposed(d_next, turned, closed_p, square, 1.0);
            add_transposed(d_next, closed_p, turned, square, 1.0);
        }
        add_product(d_sigma, h, dt, wide, 1.0);
        symmetrise(d_sigma, channels);
        // What tells nothing moves nothing.
        for (at, entry) in d_sigma.iter_mut().enumerate().filter(|_| told < channels) {
            if at % channels >= told || at / channels >= told {
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
