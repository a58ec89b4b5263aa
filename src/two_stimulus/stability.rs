//! Stability of a loop whose feedback is known by its frequency response and has a delay: the argument principle.
//!
//! With `G = N/D` and a stable Gfb, the poles of the loop outside the stable region are the zeros of `D + N Gfb` there.
//! Divided by a polynomial of D's degree with all its roots inside,
//!
//! `f(ω) = (D + N Gfb)/(s + c)ⁿ` at `s = jω`, or `f(ω) = (D + N Gfb)/zⁿ` at `z = e^{jωT}`,
//!
//! their number is the number of turns of f along the whole axis, half of which runs from 0 to ∞ (or to the Nyquist
//! frequency): the loop is stable iff the phase of f returns to 0 there. Poles of G on the axis need no detour, since
//! nothing is divided by D. The delay enters exactly, as `e^{−jωτ}` in the response.
//!
//! On a sampled plant the feedback acts between samples as its continuous response up to the Nyquist frequency says,
//! and must be small there.

use crate::control::System;
use num_complex::Complex64;

/// Steps of the phase of f that are accepted without halving, in rad.
const PHASE_STEP: f64 = 0.3;

/// A loop gain below this can turn f no more.
const NEGLIGIBLE: f64 = 0.05;

/// Evaluations at most: a loop that needs more is on the boundary.
const MOST_EVALUATIONS: usize = 200_000;

/// Whether `1 + G Gfb` has no zero on or outside the boundary of stability. Gfb itself must be stable.
///
/// `feedback(ω)` is the response of Gfb, delay included; `delay_s` says how fast its phase may turn; `scale_rad_s` is a
/// frequency of the loop's own (its crossover, or the middle of the lines). False also for a loop whose gain does not
/// fall off.
#[must_use]
pub fn is_loop_stable(plant: &System, feedback: impl Fn(f64) -> Complex64, delay_s: f64, scale_rad_s: f64) -> bool {
    let (num, den) = (plant.num(), plant.den());
    let n = den.degree() as i32;
    let nyquist = plant.sample_time_s().map(|t| std::f64::consts::PI / t);
    let leading = den.leading();
    let parts = |omega: f64| {
        let (x, reference) = match plant.sample_time_s() {
            None => (Complex64::new(0.0, omega), Complex64::new(scale_rad_s, omega).powi(n)),
            Some(t) => {
                let z = Complex64::from_polar(1.0, omega * t);
                (z, z.powi(n))
            }
        };
        let scale = leading * reference;
        (den.eval(x) / scale, num.eval(x) * feedback(omega) / scale)
    };
    let value = |omega: f64| {
        let (d, l) = parts(omega);
        d + l
    };
    let end = nyquist.unwrap_or(1e6 * scale_rad_s);
    let mut omega = 0.0;
    let mut here = value(1e-9 * scale_rad_s);
    // From the phase of f(0), which is 0 or a half turn: with f(0) < 0 no path ends where it began.
    let mut turned = 0.0_f64;
    let mut evaluations = 0;
    while omega < end {
        // The delay's own turns set the step while the loop gain counts.
        let (d, l) = parts(omega.max(1e-9 * scale_rad_s));
        let is_small = l.norm() < NEGLIGIBLE * d.norm();
        if nyquist.is_none() && is_small && omega > 100.0 * scale_rad_s {
            break;
        }
        let relative = (0.05 * omega).max(1e-3 * scale_rad_s);
        let mut step = if is_small || delay_s <= 0.0 { relative } else { relative.min(0.3 / delay_s) };
        loop {
            evaluations += 1;
            if evaluations > MOST_EVALUATIONS || step < 1e-12 * (omega + scale_rad_s) {
                return false;
            }
            let next = (omega + step).min(end);
            let there = value(next);
            let turn = (there * here.conj()).arg();
            if !turn.is_finite() {
                return false;
            }
            if turn.abs() <= PHASE_STEP {
                (omega, here) = (next, there);
                turned += turn;
                break;
            }
            step *= 0.5;
        }
    }
    let (d, l) = parts(omega);
    // A loop gain that is not small at the end may turn f further.
    let falls_off = l.norm() < 0.5 * d.norm();
    falls_off && turned.abs() < std::f64::consts::FRAC_PI_2
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Continuous, Discrete, TransferFunction};

    fn integrator() -> System {
        System::Continuous(TransferFunction::new(&[1.0], &[1.0, 0.0], Continuous).unwrap())
    }

    #[test]
    fn an_integrator_with_a_delayed_gain_is_stable_up_to_a_quarter_turn() {
        // 1 + K e^{−sτ}/s: stable iff 0 < K τ < π/2.
        for tau in [0.05, 0.2, 1.0] {
            for (share, stable) in [(0.2, true), (0.9, true), (0.999, true), (1.001, false), (1.5, false), (6.0, false)]
            {
                let k = share * std::f64::consts::FRAC_PI_2 / tau;
                // The lag far above the crossover makes the gain fall off; it costs a delay of 1e-6 s.
                let feedback = |w: f64| k * Complex64::from_polar(1.0, -w * tau) / Complex64::new(1.0, 1e-6 * w);
                assert_eq!(is_loop_stable(&integrator(), feedback, tau, 1.0), stable, "{tau} {share}");
            }
            assert!(!is_loop_stable(&integrator(), |_| Complex64::from(-1.0), tau, 1.0), "positive feedback");
        }
    }

    #[test]
    fn rational_loops_agree_with_the_routh_test() {
        use crate::control::stability::is_hurwitz;
        use crate::num::Polynomial;
        let den = [1.0, 1.0, 0.0];
        let plant = System::Continuous(TransferFunction::new(&[1.0], &den, Continuous).unwrap());
        let unstable = [1.0, -0.5, 0.3];
        let other = System::Continuous(TransferFunction::new(&[1.0, 0.4], &unstable, Continuous).unwrap());
        let mut seen = [0; 2];
        for (plant, num, den) in [(&plant, vec![1.0], den), (&other, vec![1.0, 0.4], unstable)] {
            for i in 0..40 {
                let k = 0.1 * 1.25_f64.powi(i);
                for lag in [0.02, 0.3] {
                    let feedback = |w: f64| Complex64::new(k, 0.3 * k * w) / Complex64::new(1.0, lag * w);
                    let loop_polynomial = Polynomial::new(den.to_vec())
                        .mul(&Polynomial::new(vec![lag, 1.0]))
                        .add(&Polynomial::new(num.clone()).mul(&Polynomial::new(vec![0.3 * k, k])));
                    let expected = is_hurwitz(loop_polynomial.coefficients());
                    seen[usize::from(expected)] += 1;
                    assert_eq!(is_loop_stable(plant, feedback, 0.0, 1.0), expected, "{k} {lag}");
                }
            }
        }
        assert!(seen[0] > 5 && seen[1] > 5, "{seen:?}");
    }

    #[test]
    fn a_sampled_loop_with_whole_samples_of_delay_agrees_with_the_jury_test() {
        use crate::control::stability::is_schur_within;
        // G = T z/(z − 1), gain K, n samples of delay: z^n (z − 1) + K T z.
        let t = 1.0 / 60.0;
        let time = Discrete::new(t).unwrap();
        let plant = System::Discrete(TransferFunction::new(&[t, 0.0], &[1.0, -1.0], time).unwrap());
        for samples in [3_usize, 12, 30] {
            for i in 0..30 {
                let k = 0.3 * 1.15_f64.powi(i);
                let mut p = vec![0.0; samples + 2];
                p[0] = 1.0;
                p[1] = -1.0;
                p[samples] += k * t;
                let expected = is_schur_within(&p, 1.0);
                let tau = samples as f64 * t;
                let feedback = |w: f64| k * Complex64::from_polar(1.0, -w * tau);
                assert_eq!(is_loop_stable(&plant, feedback, tau, 3.0), expected, "{samples} {k}");
            }
        }
    }
}
