//! Properties of `control` on random systems, from a fixed seed, and goldens from independent sources.

use crate::property::from_seed;
use nalgebra::DMatrix;
use num_complex::Complex64;
use proptest::prelude::*;
use volition::control::bode::log_grid;
use volition::control::discretise::DiscretiseError;
use volition::control::simulate::{self, Hold};
use volition::control::stability::{is_hurwitz_shifted, is_schur_within, is_stable};
use volition::control::{Continuous, Discrete, StateSpace, TimeBase, TransferFunction, conversion, discretise};
use volition::num::Polynomial;
use volition::person::TwoDegreesOfFreedom;
use volition::plants::Plant;

/// Real roots and conjugate pairs with real parts and imaginary parts in the given ranges.
fn roots(
    count: std::ops::Range<usize>,
    re: std::ops::Range<f64>,
    im: std::ops::Range<f64>,
) -> impl Strategy<Value = Vec<Complex64>> {
    prop::collection::vec((re, im, any::<bool>()), count).prop_map(|factors| {
        let mut roots = Vec::new();
        for (re, im, is_pair) in factors {
            if is_pair {
                roots.extend([Complex64::new(re, im), Complex64::new(re, -im)]);
            } else {
                roots.push(Complex64::new(re, 0.0));
            }
        }
        roots
    })
}

fn tf(num: &[f64], den: &[f64]) -> TransferFunction<Continuous> {
    TransferFunction::new(num, den, Continuous).unwrap()
}

/// A proper stable system with distinct poles.
fn stable_system() -> impl Strategy<Value = TransferFunction<Continuous>> {
    (roots(1..4, -6.0..-0.1, 0.2..5.0), prop::collection::vec(-3.0..3.0_f64, 1..7)).prop_map(|(poles, num)| {
        let den = Polynomial::from_roots(&poles);
        let num = &num[..num.len().min(den.degree() + 1)];
        tf(num, den.coefficients())
    })
}

/// The result, unless rounding its coefficients would misstate the response, which is then the only reason accepted.
fn representable(result: Result<TransferFunction<Discrete>, DiscretiseError>) -> Option<TransferFunction<Discrete>> {
    match result {
        Ok(system) => Some(system),
        Err(DiscretiseError::IllConditioned { .. }) => None,
        Err(other) => panic!("{other}"),
    }
}

/// The sum of the moduli of a polynomial's terms at a point: the size to which its rounding is relative.
fn term_sum(p: &Polynomial, x: Complex64) -> f64 {
    let moduli: Vec<f64> = p.coefficients().iter().map(|c| c.abs()).collect();
    Polynomial::new(moduli).eval(Complex64::new(x.norm(), 0.0)).re
}

proptest! {
    #![proptest_config(from_seed(20_150_401, 400))]

    #[test]
    fn routh_agrees_with_the_roots(roots in roots(1..5, -4.0..1.0, 0.0..6.0), margin in -0.5..1.5_f64,
            scale in 0.1..10.0_f64) {
        let slowest = roots.iter().map(|r| r.re).fold(f64::NEG_INFINITY, f64::max) + margin;
        prop_assume!(slowest.abs() > 1e-4);
        let p = Polynomial::from_roots(&roots).scale(-scale);
        prop_assert_eq!(is_hurwitz_shifted(p.coefficients(), margin), slowest < 0.0);
        prop_assert_eq!(is_stable(&p, &Continuous, margin), slowest < 0.0);
        // The same by eigenvalues, which know nothing of how the polynomial was made.
        let by_eigenvalues = p.roots().unwrap().iter().map(|r| r.re).fold(f64::NEG_INFINITY, f64::max);
        if (by_eigenvalues + margin).abs() > 1e-4 {
            prop_assert_eq!(is_hurwitz_shifted(p.coefficients(), margin), by_eigenvalues < -margin);
        }
    }

    #[test]
    fn jury_agrees_with_the_roots(roots in roots(1..5, -1.0..1.0, 0.0..0.9), radius in 0.4..1.3_f64) {
        let largest = roots.iter().map(|r| r.norm()).fold(0.0, f64::max);
        prop_assume!((largest - radius).abs() > 1e-4);
        let p = Polynomial::from_roots(&roots);
        prop_assert_eq!(is_schur_within(p.coefficients(), radius), largest < radius);
    }

    #[test]
    fn a_margin_means_the_same_decay_in_both_time_bases(
        roots in roots(1..4, -4.0..0.5, 0.0..6.0), margin in 0.0..1.0_f64, period in 0.02..0.3_f64,
    ) {
        let slowest = roots.iter().map(|r| r.re).fold(f64::NEG_INFINITY, f64::max) + margin;
        prop_assume!(slowest.abs() > 1e-2);
        let time = Discrete::new(period).unwrap();
        let sampled: Vec<Complex64> = roots.iter().map(|r| (r * period).exp()).collect();
        let p = Polynomial::from_roots(&sampled);
        let continuous = is_stable(&Polynomial::from_roots(&roots), &Continuous, margin);
        prop_assert_eq!(is_stable(&p, &time, margin), continuous);
        prop_assert!(sampled.iter().all(|z| time.exponent(*z).re + margin <= slowest + 1e-9));
    }

    #[test]
    fn state_space_and_transfer_function_agree_everywhere(
        n in 1..6_usize,
        entries in prop::collection::vec(-2.0..2.0_f64, 6 * 6 + 6 + 6 + 1),
        points in prop::collection::vec((-5.0..5.0_f64, -5.0..5.0_f64), 8),
    ) {
        let a = DMatrix::from_fn(n, n, |i, j| entries[6 * i + j]);
        let b = DMatrix::from_fn(n, 1, |i, _| entries[36 + i]);
        let c = DMatrix::from_fn(1, n, |_, j| entries[42 + j]);
        let d = DMatrix::from_element(1, 1, if entries[48] > 0.0 { entries[48] } else { 0.0 });
        let model = StateSpace::new(a, b, c, d, Continuous).unwrap();
        let system = conversion::to_transfer_function(&model).unwrap();
        prop_assert_eq!(system.den().degree(), n);
        prop_assert_eq!(system.den().leading(), 1.0);
        for (re, im) in points {
            let x = Complex64::new(re, im);
            let Some(direct) = model.eval(x) else { continue };
            // N − G D, relative to the terms that make it up.
            let residual = (system.num().eval(x) - direct[(0, 0)] * system.den().eval(x)).norm();
            let size = term_sum(system.num(), x) + direct[(0, 0)].norm() * term_sum(system.den(), x);
            prop_assert!(residual <= 1e-10 * size, "{} of {} at {}", residual, size, x);
        }
    }

    #[test]
    fn a_transfer_function_survives_the_way_through_state_space(system in stable_system()) {
        let back = conversion::to_transfer_function(&conversion::to_state_space(&system).unwrap()).unwrap();
        for omega in log_grid(0.01, 50.0, 25) {
            let s = Complex64::new(0.0, omega);
            let tolerance = 1e-10 * term_sum(system.num(), s) / system.den().eval(s).norm();
            prop_assert!((back.response(omega) - system.response(omega)).norm() <= tolerance);
        }
    }

    #[test]
    fn zero_order_hold_reproduces_the_step_response(system in stable_system(), period in 0.01..0.2_f64) {
        // Second method: the step response by partial fractions, y(t) = G(0) + Σ N(p)/(p D'(p)) e^{pt}.
        let poles = system.poles().unwrap();
        let apart = poles.iter().enumerate().all(|(i, p)| poles[..i].iter().all(|q| (p - q).norm() > 0.3));
        prop_assume!(apart);
        let time = Discrete::new(period).unwrap();
        let sampled = discretise::zero_order_hold(&system, time).unwrap();
        let y = simulate::filter(&sampled, &vec![1.0; 60]).unwrap();
        let residues: Vec<Complex64> = poles
            .iter()
            .enumerate()
            .map(|(i, p)| {
                let others: Complex64 =
                    poles.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, q)| p - q).product();
                system.num().eval(*p) / (p * others * system.den().leading())
            })
            .collect();
        let size: f64 = residues.iter().map(|r| r.norm()).sum::<f64>() + system.response(0.0).norm();
        for (k, y) in y.iter().enumerate() {
            let t = period * k as f64;
            let modes = poles.iter().zip(&residues).map(|(p, r)| r * (p * t).exp());
            let exact = system.response(0.0) + modes.sum::<Complex64>();
            prop_assert!((y - exact.re).abs() < 1e-8 * size, "{} {} at {}", y, exact, k);
        }
    }

    #[test]
    fn tustin_maps_frequencies_by_the_tangent(system in stable_system(), period in 0.01..0.5_f64,
            fraction in 0.01..0.95_f64) {
        let time = Discrete::new(period).unwrap();
        let sampled = representable(discretise::tustin(&system, time));
        prop_assume!(sampled.is_some());
        let sampled = sampled.unwrap();
        let omega = fraction * std::f64::consts::PI / period;
        let warped = 2.0 / period * (omega * period / 2.0).tan();
        let s = Complex64::new(0.0, warped);
        let size = term_sum(system.num(), s) / system.den().eval(s).norm();
        prop_assert!((sampled.response(omega) - system.response(warped)).norm() < 1e-6 * size);
    }

    #[test]
    fn matched_sampling_keeps_poles_zeros_and_static_gain(system in stable_system(), period in 0.01..0.2_f64) {
        prop_assume!(!system.num().is_zero() && system.num().coefficients().last().unwrap().abs() > 1e-2);
        let time = Discrete::new(period).unwrap();
        let sampled = representable(discretise::matched(&system, time));
        prop_assume!(sampled.is_some());
        let sampled = sampled.unwrap();
        let static_error = (sampled.response(0.0) - system.response(0.0)).norm();
        prop_assert!(static_error < 2.0 * discretise::RESPONSE_TOLERANCE * system.response(0.0).norm());
        let wanted_degree = system.num().degree().max(system.den().degree().saturating_sub(1));
        prop_assert_eq!(sampled.num().degree(), wanted_degree);
        for zero in system.zeros().unwrap() {
            let z = (zero * period).exp();
            prop_assert!(sampled.num().eval(z).norm() < 1e-7 * term_sum(sampled.num(), z));
        }
        for pole in system.poles().unwrap() {
            let z = (pole * period).exp();
            prop_assert!(sampled.den().eval(z).norm() < 1e-9 * term_sum(sampled.den(), z));
        }
    }

    #[test]
    fn closed_loop_functions_obey_their_algebra(
        plant in stable_system(), feedforward in stable_system(), feedback in stable_system(),
        omega in 0.05..20.0_f64, data in (-2.0..2.0_f64, -2.0..2.0_f64),
    ) {
        prop_assume!(!plant.num().is_zero());
        let closed = TwoDegreesOfFreedom::new(plant, feedforward, feedback).unwrap();
        let g = closed.plant().response(omega);
        let (ff, fb) = (closed.feedforward().response(omega), closed.feedback().response(omega));
        prop_assume!(g.norm() > 1e-3 && (1.0 + g * fb).norm() > 1e-3);
        let near = |a: Complex64, b: Complex64| (a - b).norm() <= 1e-9 * (1.0 + a.norm() + b.norm());
        let output = closed.command_to_output(omega);
        prop_assert!(near(output, g * (ff + fb) / (1.0 + g * fb)));
        prop_assert!(near(output + closed.command_to_error(omega), Complex64::new(1.0, 0.0)));
        prop_assert!(near(output, g * closed.command_to_control(omega)));
        prop_assert!(near(closed.sensitivity(omega), 1.0 / (1.0 + g * fb)));
        prop_assert!(near(closed.disturbance_to_output(omega), g * closed.sensitivity(omega)));
        // The factorisation behind SSID: G̃ − H = G/(1 + G Gfb) (Gff − T), T = H/G + (H − 1) Gfb, for any data H.
        let h = Complex64::new(data.0, data.1);
        let target = h / g + (h - 1.0) * fb;
        prop_assert!(near(output - h, closed.disturbance_to_output(omega) * (ff - target)));
        // Transfer functions say the same as the direct evaluation.
        let s = Complex64::new(0.0, omega);
        for (system, value) in [
            (closed.command_to_output_transfer_function().unwrap(), output),
            (closed.command_to_control_transfer_function().unwrap(), closed.command_to_control(omega)),
            (closed.sensitivity_transfer_function().unwrap(), closed.sensitivity(omega)),
            (closed.disturbance_to_output_transfer_function().unwrap(), closed.disturbance_to_output(omega)),
            (closed.disturbance_to_control_transfer_function().unwrap(), closed.sensitivity(omega) - 1.0),
        ] {
            let rounding = 1e-11 * term_sum(system.num(), s) / system.den().eval(s).norm();
            let tolerance = rounding + 1e-9 * (1.0 + value.norm());
            prop_assert!((system.eval(s) - value).norm() <= tolerance);
        }
        // The poles are the roots of the characteristic polynomial.
        let characteristic = closed.characteristic_polynomial();
        for pole in closed.poles().unwrap() {
            prop_assert!(characteristic.eval(pole).norm() <= 1e-8 * term_sum(&characteristic, pole));
        }
    }

    #[test]
    fn a_sampled_loop_is_the_filter_of_its_transfer_function(
        plant in stable_system(), feedforward in stable_system(), feedback in stable_system(),
    ) {
        // Slow sampling, so that the product polynomials of high degree are well conditioned.
        let time = Discrete::new(1.0).unwrap();
        let sampled = |g: &TransferFunction<Continuous>| discretise::tustin(g, time).unwrap();
        let (plant, feedback) = (sampled(&plant), sampled(&feedback));
        let closed = TwoDegreesOfFreedom::new(plant, sampled(&feedforward), feedback).unwrap();
        prop_assume!(closed.is_stable(0.05));
        let r: Vec<f64> = (0..80).map(|k| (0.3 * f64::from(k)).sin() + 0.2 * f64::from(k % 7)).collect();
        let d: Vec<f64> = (0..80).map(|k| (0.7 * f64::from(k)).cos()).collect();
        let response = closed.simulate(&r, Some(&d)).unwrap();
        let through = |system: TransferFunction<Discrete>, x: &[f64]| simulate::filter(&system, x).unwrap();
        let from_r = through(closed.command_to_output_transfer_function().unwrap(), &r);
        let from_d = through(closed.disturbance_to_output_transfer_function().unwrap(), &d);
        let u_from_r = through(closed.command_to_control_transfer_function().unwrap(), &r);
        let u_from_d = through(closed.disturbance_to_control_transfer_function().unwrap(), &d);
        let control = response.control.unwrap();
        let size = response.output.iter().chain(&control).map(|v| v.abs()).fold(1.0, f64::max);
        for k in 0..80 {
            prop_assert!((response.output[k] - from_r[k] - from_d[k]).abs() < 1e-6 * size);
            prop_assert!((control[k] - u_from_r[k] - u_from_d[k]).abs() < 1e-6 * size);
        }
    }
}

#[derive(serde::Deserialize)]
struct Golden {
    tolerance: f64,
    cases: Vec<GoldenCase>,
}

#[derive(serde::Deserialize)]
struct GoldenCase {
    plant: String,
    sample_time_s: f64,
    num: Vec<f64>,
    den: Vec<f64>,
    response: Vec<GoldenResponse>,
}

#[derive(serde::Deserialize)]
struct GoldenResponse {
    omega_rad_s: f64,
    h: Complex64,
}

#[test]
fn zero_order_hold_agrees_with_partial_fractions_at_fifty_digits() {
    let golden: Golden = serde_json::from_str(include_str!("../golden/zero_order_hold.json")).unwrap();
    assert_eq!(golden.cases.len(), 5);
    let tolerance = golden.tolerance;
    for case in golden.cases {
        let plant = Plant::by_name(&case.plant).unwrap().transfer_function();
        let time = Discrete::new(case.sample_time_s).unwrap();
        let sampled = discretise::zero_order_hold(&plant, time).unwrap();
        let near = |ours: &[f64], golden: &[f64]| {
            // Relative to the largest coefficient.
            let largest = golden.iter().map(|v| v.abs()).fold(0.0, f64::max);
            let error = ours.iter().zip(golden).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert_eq!(ours.len(), golden.len(), "{}", case.plant);
            assert!(error <= tolerance * largest, "{}: {error} of {largest}", case.plant);
        };
        near(sampled.num().coefficients(), &case.num);
        near(sampled.den().coefficients(), &case.den);
        let exact =
            discretise::zero_order_hold_state_space(&conversion::to_state_space(&plant).unwrap().balanced(), time)
                .unwrap();
        // By states the response is exact to rounding, however fast the sampling; coefficients in powers of z lose up
        // to six digits at 500 Hz even when each is correctly rounded.
        for GoldenResponse { omega_rad_s, h } in &case.response {
            let by_states = exact.response(*omega_rad_s).unwrap()[(0, 0)];
            assert!((by_states - h).norm() <= tolerance * h.norm(), "{} at {omega_rad_s}", case.plant);
            let by_coefficients = sampled.response(*omega_rad_s);
            assert!((by_coefficients - h).norm() <= 1e-5 * h.norm(), "{} at {omega_rad_s}", case.plant);
        }
    }
}

#[test]
fn the_hold_is_exact_where_it_says_so() {
    // A damped oscillator driven by a triangle wave, against a Runge–Kutta integration with 200 steps per sample.
    let system = tf(&[1.0, 3.0], &[1.0, 0.4, 9.0]);
    let time = Discrete::new(0.1).unwrap();
    let input: Vec<f64> = (0..50).map(|k| f64::from((k % 8) - 4)).collect();
    for hold in [Hold::Zero, Hold::First] {
        let ours = simulate::sampled_response(&system, &input, time, hold).unwrap();
        // The input at a fraction of the interval after sample k.
        let at = |k: usize, fraction: f64| match hold {
            Hold::Zero => input[k],
            Hold::First => input[k] + (input[k + 1] - input[k]) * fraction,
        };
        // States z, ż with z'' + 0.4 z' + 9 z = u and y = z' + 3 z.
        let (mut z, mut v) = (0.0_f64, 0.0_f64);
        let f = |z: f64, v: f64, u: f64| (v, u - 0.4 * v - 9.0 * z);
        let h = 0.1 / 200.0;
        for (k, y) in ours.iter().enumerate().take(49) {
            assert!((y - (v + 3.0 * z)).abs() < 1e-9, "{hold:?} at {k}: {y} {}", v + 3.0 * z);
            for step in 0..200 {
                let [u0, u1, u2] = [0.0, 0.5, 1.0].map(|part| at(k, (f64::from(step) + part) / 200.0));
                let k1 = f(z, v, u0);
                let k2 = f(z + 0.5 * h * k1.0, v + 0.5 * h * k1.1, u1);
                let k3 = f(z + 0.5 * h * k2.0, v + 0.5 * h * k2.1, u1);
                let k4 = f(z + h * k3.0, v + h * k3.1, u2);
                z += h / 6.0 * (k1.0 + 2.0 * k2.0 + 2.0 * k3.0 + k4.0);
                v += h / 6.0 * (k1.1 + 2.0 * k2.1 + 2.0 * k3.1 + k4.1);
            }
        }
    }
}

/// Appendix B of Zhang 2015: of the 16,364 feedforward denominators 5,137 are stable with the margin 0.1; many roots
/// lie on the margin exactly (`shared/reference/ssid.json`, ch3_pool).
#[test]
fn the_stable_feedforward_denominators_of_appendix_b_are_counted() {
    let steps = |from: f64, by: f64, last: u32| (0..=last).map(move |i| from + by * f64::from(i));
    let real: Vec<f64> = steps(-25.0, 0.5, 44).chain(steps(-2.6, 0.1, 52)).chain(steps(3.0, 0.5, 44)).collect();
    let natural: Vec<f64> = steps(0.0, 0.05, 52).chain(steps(2.7, 0.1, 63)).chain(steps(9.5, 0.5, 31)).collect();
    let damping: Vec<f64> = steps(-0.9, 0.1, 4)
        .chain(steps(-0.45, 0.05, 5))
        .chain(steps(-0.18, 0.02, 18))
        .chain(steps(0.2, 0.05, 5))
        .chain(steps(0.5, 0.1, 4))
        .collect();
    let mut pool = std::collections::BTreeMap::new();
    let mut insert = |a1: f64, a0: f64| {
        pool.insert(((a1 * 1e8).round() as i64, (a0 * 1e8).round() as i64), [1.0, a1, a0]);
    };
    for p in &real {
        for q in &real {
            insert(-p - q, p * q);
        }
    }
    for w in &natural {
        for z in &damping {
            insert(2.0 * z * w, w * w);
        }
    }
    assert_eq!((real.len(), pool.len()), (143, 16_364));
    assert_eq!(pool.values().filter(|p| is_hurwitz_shifted(*p, 0.1)).count(), 5_137);
}
