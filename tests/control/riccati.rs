//! Linear matrix equations, Riccati equations, regulators and filters: by residual, stability and a second method.
#![allow(non_snake_case)]

use nalgebra::DMatrix;
use rand::{Rng, RngExt};
use volition::control::lqg::{kalman, lqg_closed_loop, lqr};
use volition::control::lyapunov::{Clock, LinearEquationError, Lyapunov, sylvester};
use volition::control::riccati::{Riccati, RiccatiError, doubling, sign_function};
use volition::control::state_space::StateSpaceError;
use volition::control::stochastic::{sample_cost, sample_noise};
use volition::control::structural::{self, StructuralError};
use volition::control::{Continuous, Discrete, StateSpace};
use volition::num::linalg::eigenvalues;
use volition::num::rng;

const SEED: u64 = 20_260_804;

fn random(rows: usize, columns: usize, stream: &mut impl Rng) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| stream.random_range(-1.0..1.0))
}

fn positive(n: usize, stream: &mut impl Rng) -> DMatrix<f64> {
    let m = random(n, n, stream);
    &m * m.transpose() + DMatrix::identity(n, n) * 0.1
}

fn mat(rows: usize, columns: usize, values: &[f64]) -> DMatrix<f64> {
    DMatrix::from_row_slice(rows, columns, values)
}

#[test]
fn lyapunov_and_stein_solutions_satisfy_their_equations_and_their_adjoints() {
    let mut stream = rng::stream(SEED, "lyapunov");
    for n in 1..=16 {
        for clock in [Clock::Continuous, Clock::Sampled] {
            let a = random(n, n, &mut stream);
            let q = positive(n, &mut stream);
            let solver = Lyapunov::new(&a, clock).unwrap();
            let (x, y) = (solver.solve(&q), solver.solve_adjoint(&q));
            let (rx, ry) = match clock {
                Clock::Continuous => (a.tr_mul(&x) + &x * &a + &q, &a * &y + &y * a.transpose() + &q),
                Clock::Sampled => (a.tr_mul(&x) * &a - &x + &q, &a * &y * a.transpose() - &y + &q),
            };
            let scale = (x.norm() + y.norm()) * (1.0 + a.norm_squared()) + q.norm();
            assert!(rx.norm() + ry.norm() < 1e-13 * scale, "{n} {clock:?} {:e} {:e}", rx.norm(), ry.norm());
            // tr(Y Q) = tr(X Q) is the duality on which the gradients rest.
            let other = positive(n, &mut stream);
            let left = solver.solve(&q).dot(&other);
            let right = solver.solve_adjoint(&other).dot(&q);
            assert!((left - right).abs() < 1e-9 * left.abs().max(scale), "{left} {right}");
        }
    }
}

#[test]
fn a_singular_lyapunov_equation_names_the_eigenvalues() {
    let a = mat(2, 2, &[1.0, 0.0, 0.0, -1.0]);
    assert!(matches!(Lyapunov::new(&a, Clock::Continuous), Err(LinearEquationError::Singular { .. })));
    let a = mat(2, 2, &[2.0, 1.0, 0.0, 0.5]);
    assert!(matches!(Lyapunov::new(&a, Clock::Sampled), Err(LinearEquationError::Singular { .. })));
}

#[test]
fn sylvester_solutions_satisfy_their_equation() {
    let mut stream = rng::stream(SEED, "sylvester");
    for n in 1..=8 {
        for m in 1..=8 {
            let (a, b, c) = (random(n, n, &mut stream), random(m, m, &mut stream), random(n, m, &mut stream));
            let x = sylvester(&a, &b, &c).unwrap();
            assert!((&a * &x + &x * &b - &c).norm() < 1e-12 * (x.norm() + c.norm()), "{n} {m}");
        }
    }
    let one = DMatrix::identity(2, 2);
    assert!(matches!(sylvester(&one, &-&one, &one), Err(LinearEquationError::Singular { .. })));
}

#[test]
fn both_riccati_methods_agree_with_the_refined_solution() {
    let mut stream = rng::stream(SEED, "riccati");
    for clock in [Clock::Continuous, Clock::Sampled] {
        for n in 1..=12 {
            for m in 1..=n.min(4) {
                let a = random(n, n, &mut stream);
                let b = random(n, m, &mut stream);
                let equation =
                    Riccati::new(&a, &b, &positive(n, &mut stream), &positive(m, &mut stream), clock).unwrap();
                let solution = equation.solve().unwrap();
                assert!(solution.residual < 1e-13, "{clock:?} {n} {m}: {:e}", solution.residual);
                assert!(solution.poles.iter().all(|p| clock.margin(*p) > 0.0));
                assert!(solution.p.clone().cholesky().is_some(), "P is positive definite for Q > 0");
                for (name, method) in [("doubling", doubling as fn(&_) -> _), ("sign", sign_function)] {
                    let p = method(&equation).unwrap();
                    let error = (&p - &solution.p).norm() / solution.p.norm();
                    assert!(error < 1e-7, "{name} {clock:?} {n} {m}: {error:e}");
                }
            }
        }
    }
}

#[test]
fn scalar_equations_have_their_closed_forms() {
    // Continuous: 2ap − b²p²/r + q = 0 with a = b = 1, r = 1, q = 3: p = 3, k = 3.
    let one = mat(1, 1, &[1.0]);
    let s = lqr(&one, &one, &mat(1, 1, &[3.0]), &one, Clock::Continuous).unwrap();
    assert!((s.p[0] - 3.0).abs() < 1e-14 && (s.k[0] - 3.0).abs() < 1e-14);
    // Sampled: a = 2, b = 1, q = 1, r = 1.25: p = 5, k = 1.6.
    let s = lqr(&mat(1, 1, &[2.0]), &one, &one, &mat(1, 1, &[1.25]), Clock::Sampled).unwrap();
    assert!((s.p[0] - 5.0).abs() < 1e-13 && (s.k[0] - 1.6).abs() < 1e-14);
}

#[test]
fn a_singular_but_detectable_weight_is_solved() {
    // The double integrator with Q = diag(1, 0): K = [1, √2].
    let a = mat(2, 2, &[0.0, 1.0, 0.0, 0.0]);
    let b = mat(2, 1, &[0.0, 1.0]);
    let s = lqr(&a, &b, &mat(2, 2, &[1.0, 0.0, 0.0, 0.0]), &mat(1, 1, &[1.0]), Clock::Continuous).unwrap();
    assert!((s.k - mat(1, 2, &[1.0, 2f64.sqrt()])).norm() < 1e-13);
}

#[test]
fn a_singular_state_matrix_is_no_obstacle_in_sampled_time() {
    // Two steps of delay before an integrator.
    let a = mat(3, 3, &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0]);
    let b = mat(3, 1, &[1.0, 0.0, 0.0]);
    let q = DMatrix::from_diagonal(&nalgebra::dvector![0.0, 0.0, 1.0]);
    let s = lqr(&a, &b, &q, &mat(1, 1, &[0.5]), Clock::Sampled).unwrap();
    assert!(s.residual < 1e-14 && s.poles.iter().all(|p| p.norm() < 1.0));
}

#[test]
fn every_hypothesis_is_named() {
    let a = mat(2, 2, &[1.0, 0.0, 0.0, -1.0]);
    let b = mat(2, 1, &[0.0, 1.0]);
    let (q, r) = (DMatrix::identity(2, 2), mat(1, 1, &[1.0]));
    let run = |a: &DMatrix<f64>, b: &DMatrix<f64>, q: &DMatrix<f64>, r: &DMatrix<f64>| {
        lqr(a, b, q, r, Clock::Continuous).unwrap_err()
    };
    assert!(matches!(run(&a, &b, &q, &r), RiccatiError::Structure(StructuralError::NotStabilisable(m)) if m.re == 1.0));
    let unseen = mat(2, 2, &[0.0, 0.0, 0.0, 1.0]);
    let full = DMatrix::identity(2, 2);
    let r2 = DMatrix::identity(2, 2);
    assert!(matches!(run(&a, &full, &unseen, &r2), RiccatiError::Structure(StructuralError::NotDetectable(_))));
    assert!(matches!(run(&a, &b, &-&q, &r), RiccatiError::NotSemidefinite { matrix: "Q", .. }));
    assert!(matches!(run(&a, &b, &q, &-&r), RiccatiError::NotDefinite { matrix: "R", .. }));
    assert!(matches!(
        run(&a, &b, &mat(2, 2, &[1.0, 1.0, 0.0, 1.0]), &r),
        RiccatiError::NotSymmetric { matrix: "Q", .. }
    ));
    assert!(matches!(run(&a, &b, &r, &r), RiccatiError::Size { matrix: "Q", rows: 1, expected_rows: 2, .. }));
    assert!(matches!(
        run(&a, &mat(2, 1, &[0.0, f64::NAN]), &q, &r),
        RiccatiError::NotFinite { matrix: "B", row: 1, column: 0 }
    ));
    let c = mat(1, 2, &[0.0, 1.0]);
    let error = kalman(&a, &c, &q, &r, Clock::Continuous).unwrap_err();
    assert!(matches!(error, RiccatiError::Structure(StructuralError::NotDetectable(_))), "{error}");
    let error = kalman(&a, &c, &q, &-&r, Clock::Continuous).unwrap_err();
    assert!(matches!(error, RiccatiError::NotDefinite { matrix: "V", .. }), "{error}");
}

#[test]
fn structural_tests_see_what_is_missed() {
    let chain = mat(3, 3, &[0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    let (last, first) = (mat(3, 1, &[0.0, 0.0, 1.0]), mat(3, 1, &[1.0, 0.0, 0.0]));
    assert!(structural::check_controllable(&chain, &last).is_ok());
    assert!(matches!(structural::check_controllable(&chain, &first), Err(StructuralError::NotControllable(_))));
    assert!(structural::check_detectable(&chain, &first.transpose(), Clock::Continuous).is_ok());
    let unseen = structural::check_detectable(&chain, &last.transpose(), Clock::Continuous);
    assert!(matches!(unseen, Err(StructuralError::NotDetectable(_))), "{unseen:?}");
    // The units of the input do not matter.
    assert!(structural::check_controllable(&chain, &(last * 1e-200)).is_ok());
    // A stable mode that nothing reaches is no obstacle to stabilisation.
    let a = mat(2, 2, &[-1.0, 0.0, 0.0, 1.0]);
    assert!(structural::check_stabilisable(&a, &mat(2, 1, &[0.0, 1.0]), Clock::Continuous).is_ok());
}

#[test]
fn the_lqg_loop_has_the_poles_of_regulator_and_filter() {
    let a = mat(2, 2, &[1.0, 2.0, -3.0, 1.0]);
    let b = mat(2, 2, &[0.0, 1.0, -1.0, 1.0]);
    let c = mat(1, 2, &[1.0, 0.0]);
    let (q, r) = (mat(2, 2, &[3.0, 0.0, 0.0, 4.0]), mat(2, 2, &[20.0, 0.0, 0.0, 40.0]));
    let regulator = lqr(&a, &b, &q, &r, Clock::Continuous).unwrap();
    let filter = kalman(&a, &c, &DMatrix::identity(2, 2), &mat(1, 1, &[1.0]), Clock::Continuous).unwrap();
    let plant = StateSpace::new(a, b, c, mat(1, 2, &[0.3, -0.2]), Continuous).unwrap();
    let closed = lqg_closed_loop(&plant, &regulator.k, &filter.l).unwrap();
    let mut poles = closed.poles().unwrap();
    let mut expected: Vec<_> = regulator.poles.iter().chain(&filter.poles).copied().collect();
    let order =
        |x: &num_complex::Complex64, y: &num_complex::Complex64| (x.re, x.im).partial_cmp(&(y.re, y.im)).unwrap();
    poles.sort_by(order);
    expected.sort_by(order);
    assert!(poles.iter().zip(&expected).all(|(p, e)| (p - e).norm() < 1e-9), "{poles:?} {expected:?}");
    let misfit = lqg_closed_loop(&plant, &filter.l, &filter.l);
    assert!(matches!(misfit, Err(StateSpaceError::Size { matrix: "K", .. })), "{misfit:?}");
}

#[test]
fn sampled_noise_is_the_integral_and_stays_finite_over_long_samples() {
    // dx = −x dt + dw: variance (1 − e^{−2T})/2.
    for period in [1e-6, 0.1, 3.0, 2000.0] {
        let time = Discrete::new(period).unwrap();
        let sampled = sample_noise(&mat(1, 1, &[-1.0]), &mat(1, 1, &[1.0]), time).unwrap();
        let exact = -(-2.0 * period).exp_m1() / 2.0;
        assert!((sampled.covariance[0] / exact - 1.0).abs() < 1e-12, "{period}: {}", sampled.covariance[0]);
        assert!((sampled.transition[0] - (-period).exp()).abs() < 1e-14);
    }
    // The stationary covariance of the sampled and of the continuous equation are the same.
    let mut stream = rng::stream(SEED, "van loan");
    for n in 1..=6 {
        let a = random(n, n, &mut stream) - DMatrix::identity(n, n) * 2.5;
        let w = positive(n, &mut stream);
        let sampled = sample_noise(&a, &w, Discrete::new(0.37).unwrap()).unwrap();
        let continuous = Lyapunov::new(&a, Clock::Continuous).unwrap().solve_adjoint(&w);
        let discrete = Lyapunov::new(&sampled.transition, Clock::Sampled).unwrap().solve_adjoint(&sampled.covariance);
        assert!((&continuous - discrete).norm() < 1e-11 * continuous.norm(), "{n}");
    }
}

#[test]
fn the_sampled_cost_is_the_integral_of_the_continuous_one() {
    // x' = u, held: x(t) = x + ut, ∫₀ᵀ x² + r u² = Tx² + T²xu + (T³/3 + rT)u².
    let cost = sample_cost(
        &mat(1, 1, &[0.0]),
        &mat(1, 1, &[1.0]),
        &mat(1, 1, &[1.0]),
        &mat(1, 1, &[0.7]),
        Discrete::new(0.5).unwrap(),
    )
    .unwrap();
    assert!((cost.q[0] - 0.5).abs() < 1e-14 && (cost.s[0] - 0.125).abs() < 1e-14);
    assert!((cost.r[0] - (0.125 / 3.0 + 0.35)).abs() < 1e-14 && (cost.input[0] - 0.5).abs() < 1e-14);
}

#[test]
fn the_discrete_regulator_tends_to_the_continuous_one() {
    let (a, b) = (mat(2, 2, &[0.0, 1.0, 2.0, -0.5]), mat(2, 1, &[0.0, 1.0]));
    let (q, r) = (DMatrix::identity(2, 2), mat(1, 1, &[0.3]));
    let continuous = lqr(&a, &b, &q, &r, Clock::Continuous).unwrap();
    let mut last = f64::INFINITY;
    for period in [1e-2, 1e-3, 1e-4] {
        let sampled = sample_cost(&a, &b, &q, &r, Discrete::new(period).unwrap()).unwrap();
        let k = lqr(&sampled.transition, &sampled.input, &sampled.q, &sampled.r, Clock::Sampled).unwrap().k;
        let error = (&k - &continuous.k).norm();
        assert!(error < 0.15 * last, "{period}: {error}");
        last = error;
    }
    assert!(eigenvalues(&a).unwrap().iter().any(|p| p.re > 0.0), "the plant is unstable, so that the gain matters");
}
