//! Inverse optimal control on random plants, and against another solver.
#![allow(non_snake_case)]

use super::inverse::directions_of;
use nalgebra::DMatrix;
use volition::control::lqg::lqr;
use volition::control::lyapunov::Clock;
use volition::ctl::Ctl;
use volition::inverse::{Gains, Settings, Structure, Verdict, inverse_lqr};

#[test]
fn optimal_gains_of_random_plants_are_never_called_infeasible() {
    let tally = crate::inverse_plants::optimal(250, crate::inverse_plants::SEED, |line| panic!("{line}"));
    assert!(tally.feasible >= 240, "{tally:?}");
    assert!(tally.worst_forward_error <= 1e-6, "{tally:?}");
}

#[test]
fn verdicts_on_random_stabilising_gains_agree_with_kalmans_inequality() {
    let tally = crate::inverse_plants::single_input(400, crate::inverse_plants::SEED, |line| panic!("{line}"));
    assert!(tally.feasible > 100 && tally.infeasible > 50, "{tally:?}");
}

/// t* by clarabel, with P, R and t as unknowns and the equalities as they stand: another method, another elimination.
///
/// `None` where clarabel gives up, as it does on some of the infeasible programs with the equalities left in.
fn margin_by_clarabel(gains: &Gains) -> Option<f64> {
    use volition::convex::conic::{Affine, Outcome, Program};
    let (a, b, k) = (gains.a(), gains.b(), gains.k());
    let (n, m) = (gains.states(), gains.ports());
    let basis = directions_of(&Structure::default(), n, m);
    let sampled = gains.clock() == Clock::Sampled;
    let parts: Vec<(DMatrix<f64>, DMatrix<f64>)> = basis
        .iter()
        .map(|(p, r)| {
            if sampled {
                let weight = b.tr_mul(&(p * b)) + r;
                (p - a.tr_mul(&(p * a)) + k.tr_mul(&(&weight * k)), b.tr_mul(&(p * a)) - weight * k)
            } else {
                (k.tr_mul(&(r * k)) - a.tr_mul(p) - p * a, b.tr_mul(p) - r * k)
            }
        })
        .collect();
    let t = basis.len();
    let mut program = Program::new(t + 1);
    program.add_cost(t, -1.0);
    let sum = |value: &dyn Fn(usize) -> f64| -> Vec<(usize, f64)> { (0..t).map(|i| (i, value(i))).collect() };
    for i in 0..m {
        for j in 0..n {
            program.zero(Affine { constant: 0.0, terms: sum(&|u| parts[u].1[(i, j)]) });
        }
    }
    program.zero(Affine { constant: -((n + m) as f64), terms: sum(&|u| parts[u].0.trace() + basis[u].1.trace()) });
    let shifted = |mut terms: Vec<(usize, f64)>, diagonal: bool| {
        if diagonal {
            terms.push((t, -1.0));
        }
        Affine { constant: 0.0, terms }
    };
    program.semidefinite(n, |i, j| shifted(sum(&|u| parts[u].0[(i, j)]), i == j));
    program.semidefinite(m, |i, j| shifted(sum(&|u| basis[u].1[(i, j)]), i == j));
    let answer = program.solve(&Ctl::new()).unwrap();
    let solved = matches!(answer.outcome, Outcome::Solved | Outcome::AlmostSolved);
    (solved && answer.violation < 1e-6).then(|| answer.x[t])
}

#[test]
fn margins_of_multi_input_gains_agree_with_another_solver_on_the_whole_program() {
    use rand::RngExt;
    let mut stream = volition::num::rng::stream(11, "multi-input margins");
    let mut counts = [0, 0];
    for round in 0..60 {
        let n = stream.random_range(2..=4usize);
        let m = stream.random_range(2..=n);
        let clock = if round % 2 == 0 { Clock::Continuous } else { Clock::Sampled };
        let mut matrix =
            |rows: usize, columns: usize| DMatrix::from_fn(rows, columns, |_, _| stream.random_range(-1.0..1.0));
        let (a, b) = (matrix(n, n), matrix(n, m));
        let (q, r, noise) = (matrix(n, n), matrix(m, m), matrix(m, n));
        let q = &q * q.transpose() + DMatrix::identity(n, n) * 0.3;
        let r = &r * r.transpose() + DMatrix::identity(m, m) * 0.3;
        let k = lqr(&a, &b, &q, &r, clock).unwrap().k;
        // Every other gain is moved off its optimum.
        let k = if round % 4 < 2 { k } else { &k + noise * (0.2 * k.norm()) };
        let Ok(gains) = Gains::regulator(&a, &b, &k, clock) else { continue };
        let answer = inverse_lqr(&gains, &Settings::default(), &Ctl::new());
        let answer = answer.unwrap_or_else(|error| panic!("{round}: {error}"));
        let ours = answer.t_star.unwrap();
        let Some(other) = margin_by_clarabel(&gains) else { continue };
        assert!((ours - other).abs() < 1e-5 * (1.0 + other.abs()), "{round}: {ours} {other}");
        match answer.verdict {
            Verdict::Feasible => counts[0] += 1,
            Verdict::Infeasible => counts[1] += 1,
            Verdict::Boundary => {}
        }
    }
    assert!(counts[0] >= 20 && counts[1] >= 15, "{counts:?}");
}
