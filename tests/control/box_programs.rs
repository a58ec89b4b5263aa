//! Linear programs over a box: against clarabel, and against their own proof.

use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use volition::convex::box_lp::{BoxLpError, GAP, Outcome, Program, Solution};
use volition::convex::conic::{self, Affine};
use volition::ctl::{Ctl, StopReason};
use volition::num::rng;

fn solve(program: &Program) -> Solution {
    program.solve(GAP, &Ctl::new()).unwrap()
}

/// The same program for clarabel.
fn conic(program: &Program) -> conic::Answer {
    let (m, n) = program.rows.shape();
    let mut other = conic::Program::new(n);
    for j in 0..n {
        other.add_cost(j, -program.cost[j]);
        other.nonnegative(Affine { constant: -program.bounds[0][j], terms: vec![(j, 1.0)] });
        other.nonnegative(Affine { constant: program.bounds[1][j], terms: vec![(j, -1.0)] });
    }
    for i in 0..m {
        let terms = |sign: f64| (0..n).map(|j| (j, sign * program.rows[(i, j)])).collect();
        other.nonnegative(Affine { constant: -program.limits[0][i], terms: terms(1.0) });
        other.nonnegative(Affine { constant: program.limits[1][i], terms: terms(-1.0) });
    }
    other.solve(&Ctl::new()).unwrap()
}

/// A random program that some x satisfies, whose rows differ in size by orders of magnitude.
fn random(n: usize, m: usize, round: u64) -> Program {
    let mut stream = rng::stream(20_261_125 + round, "boxed programs");
    let mut number = |low: f64, high: f64| stream.random_range(low..high);
    let bounds = [DVector::from_fn(n, |_, _| number(-2.0, -0.1)), DVector::from_fn(n, |_, _| number(0.1, 2.0))];
    let inside = DVector::from_fn(n, |j, _| number(0.9 * bounds[0][j], 0.9 * bounds[1][j]));
    let sizes: Vec<f64> = (0..m).map(|_| 10.0_f64.powf(number(-3.0, 3.0))).collect();
    let rows = DMatrix::from_fn(m, n, |i, _| sizes[i] * number(-1.0, 1.0));
    let at = &rows * inside;
    let width = |i: usize| sizes[i] * (n as f64).sqrt() * 0.2;
    let limits = [
        DVector::from_fn(m, |i, _| at[i] - number(0.01, 1.0) * width(i)),
        DVector::from_fn(m, |i, _| at[i] + number(0.01, 1.0) * width(i)),
    ];
    Program { cost: DVector::from_fn(n, |_, _| number(-3.0, 3.0)), bounds, rows, limits }
}

#[test]
fn it_agrees_with_clarabel_and_proves_it() {
    for (round, (n, m)) in [(1, 1), (5, 3), (10, 30), (40, 12), (120, 50), (30, 60)].into_iter().enumerate() {
        let program = random(n, m, round as u64);
        let (ours, theirs) = (solve(&program), conic(&program));
        assert_eq!(ours.outcome, Outcome::Solved, "{n} {m}: {ours:?}");
        let size = ours.objective.abs().max(1e-3);
        assert!((ours.objective + theirs.objective).abs() < 1e-7 * size, "{} {}", ours.objective, theirs.objective);
        // The bound, from the multipliers alone.
        assert!(ours.bound >= ours.objective - 1e-9 * size && ours.bound - ours.objective < 1e-7 * size);
        assert!(ours.x.iter().enumerate().all(|(j, x)| program.bounds[0][j] <= *x && *x <= program.bounds[1][j]));
        let values = &program.rows * &ours.x;
        for i in 0..m {
            let slack = 1e-8 * program.rows.row(i).norm();
            assert!(values[i] > program.limits[0][i] - slack && values[i] < program.limits[1][i] + slack);
        }
    }
}

#[test]
fn a_box_alone_has_its_corner() {
    let mut program = random(7, 3, 99);
    program.rows = DMatrix::zeros(0, 7);
    program.limits = [DVector::zeros(0), DVector::zeros(0)];
    let found = solve(&program);
    assert_eq!((found.outcome, found.steps), (Outcome::Solved, 0));
    for (j, c) in program.cost.iter().enumerate() {
        assert_eq!(found.x[j], program.bounds[usize::from(*c > 0.0)][j]);
    }
    // A row that nothing in the box reaches changes nothing.
    program.rows = DMatrix::from_element(1, 7, 1.0);
    program.limits = [DVector::from_element(1, -100.0), DVector::from_element(1, 100.0)];
    assert!((solve(&program).objective - found.objective).abs() < 1e-7 * found.objective.abs());
    program.cost = DVector::zeros(7);
    assert_eq!(solve(&program).outcome, Outcome::Solved);
}

#[test]
fn programs_that_nothing_satisfies_are_recognised() {
    // x + y ≥ 3 in the unit square.
    let program = Program {
        cost: DVector::from_vec(vec![1.0, -1.0]),
        bounds: [DVector::zeros(2), DVector::from_element(2, 1.0)],
        rows: DMatrix::from_element(1, 2, 1.0),
        limits: [DVector::from_element(1, 3.0), DVector::from_element(1, 4.0)],
    };
    let found = solve(&program);
    assert_eq!(found.outcome, Outcome::Infeasible, "{found:?}");
    // Two rows that contradict each other.
    let both = Program {
        rows: DMatrix::from_row_slice(2, 2, &[1.0, 1.0, 1.0, 1.0]),
        limits: [DVector::from_vec(vec![0.0, 1.2]), DVector::from_vec(vec![0.8, 2.0])],
        ..program
    };
    assert_eq!(solve(&both).outcome, Outcome::Infeasible);
}

#[test]
fn what_is_no_program_is_refused() {
    let good = random(3, 2, 7);
    let refused = |program: Program| program.solve(GAP, &Ctl::new()).unwrap_err();
    let mut wrong = good.clone();
    wrong.bounds[1][2] = wrong.bounds[0][2];
    assert!(matches!(refused(wrong), BoxLpError::Empty { part: "bounds", index: 2, .. }));
    let mut wrong = good.clone();
    wrong.limits[0][1] = f64::NEG_INFINITY;
    assert_eq!(refused(wrong), BoxLpError::NotFinite);
    let mut wrong = good.clone();
    wrong.cost = DVector::zeros(2);
    assert_eq!(refused(wrong), BoxLpError::Size { part: "cost", found: 2, expected: 3 });
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    assert!(matches!(good.solve(GAP, &ctl), Err(BoxLpError::Stopped(_))));
}
