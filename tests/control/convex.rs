//! The two semidefinite solvers, against closed forms and against each other.

use nalgebra::{DMatrix, DVector};
use rand::{Rng, RngExt};
use volition::convex::conic::{Affine, ConicError, Outcome, Program};
use volition::convex::lmi::{self, Block, LmiError, Problem, Status};
use volition::ctl::{Ctl, StopReason};
use volition::num::rng;

fn symmetric(n: usize, stream: &mut impl Rng) -> DMatrix<f64> {
    let m = DMatrix::from_fn(n, n, |_, _| stream.random_range(-1.0..1.0));
    &m + m.transpose()
}

#[test]
fn the_largest_eigenvalue_is_the_least_bound() {
    let mut stream = rng::stream(20_260_804, "largest eigenvalue");
    for n in 1..=10 {
        let a = symmetric(n, &mut stream);
        let exact = a.symmetric_eigenvalues().max();
        let identity = DMatrix::identity(n, n);
        let problem = Problem {
            cost: DVector::from_element(1, 1.0),
            quadratic: None,
            objective_scale: 1.0,
            gap: lmi::GAP,
            blocks: vec![Block::new(-&a, [&identity].into_iter())],
        };
        let solution = lmi::solve(&problem, &DVector::from_element(1, exact + 3.0), &Ctl::new()).unwrap();
        assert_eq!(solution.status, Status::Solved);
        assert!((solution.objective - exact).abs() < 1e-9 * (1.0 + exact.abs()), "{n}");
        assert!((solution.dual_objective - exact).abs() < 1e-7 * (1.0 + exact.abs()), "{n}");

        let mut program = Program::new(1);
        program.add_cost(0, 1.0).semidefinite(n, |i, j| Affine {
            constant: -a[(i, j)],
            terms: if i == j { vec![(0, 1.0)] } else { vec![] },
        });
        let answer = program.solve(&Ctl::new()).unwrap();
        assert_eq!(answer.outcome, Outcome::Solved);
        assert!((answer.objective - exact).abs() < 1e-7 && answer.violation < 1e-7, "{n}: {answer:?}");
    }
}

#[test]
fn both_solvers_agree_on_random_problems_with_and_without_a_quadratic_cost() {
    let mut stream = rng::stream(20_260_804, "random lmi");
    for round in 0..24 {
        let (unknowns, sizes) = (1 + round % 6, [2 + round % 5, 1 + round % 3]);
        // A ball keeps it bounded: [r I  z; zᵀ r] ⪰ 0.
        let mut blocks = Vec::new();
        for size in sizes {
            let terms: Vec<_> = (0..unknowns).map(|_| symmetric(size, &mut stream)).collect();
            blocks.push((DMatrix::identity(size, size), terms));
        }
        let ball: Vec<_> = (0..unknowns)
            .map(|i| {
                let mut e = DMatrix::zeros(unknowns + 1, unknowns + 1);
                e[(i, unknowns)] = 1.0;
                e[(unknowns, i)] = 1.0;
                e
            })
            .collect();
        blocks.push((DMatrix::identity(unknowns + 1, unknowns + 1) * 10.0, ball));
        let cost = DVector::from_fn(unknowns, |_, _| stream.random_range(-1.0..1.0));
        let quadratic = (round % 2 == 1).then(|| {
            let m = symmetric(unknowns, &mut stream);
            &m * &m
        });
        let problem = Problem {
            cost: cost.clone(),
            quadratic: quadratic.clone(),
            objective_scale: 1e-2,
            gap: lmi::GAP,
            blocks: blocks.iter().map(|(c, t)| Block::new(c.clone(), t.iter())).collect(),
        };
        let ours = lmi::solve(&problem, &DVector::zeros(unknowns), &Ctl::new()).unwrap();
        assert_eq!(ours.status, Status::Solved, "{round}");
        let mut program = Program::new(unknowns);
        for i in 0..unknowns {
            program.add_cost(i, cost[i]);
            for j in 0..=i {
                if let Some(h) = &quadratic {
                    program.add_quadratic_cost(j, i, h[(j, i)]);
                }
            }
        }
        for (constant, terms) in &blocks {
            program.semidefinite(constant.nrows(), |i, j| Affine {
                constant: constant[(i, j)],
                terms: terms.iter().enumerate().map(|(k, t)| (k, t[(i, j)])).collect(),
            });
        }
        let theirs = program.solve(&Ctl::new()).unwrap();
        assert_eq!(theirs.outcome, Outcome::Solved, "{round}");
        assert!(theirs.violation < 1e-7, "{round}: {}", theirs.violation);
        assert!((ours.objective - theirs.objective).abs() < 1e-7, "{round}: {} {}", ours.objective, theirs.objective);
        assert!((ours.objective - ours.dual_objective).abs() < 1e-7, "{round}");
        assert!(program.violation(ours.z.as_slice()) < 1e-12, "ours stays inside");
    }
}

#[test]
fn equalities_inequalities_and_norms() {
    // The point of the line x + y = 2 with x ≥ 1.5 nearest to the origin.
    let mut program = Program::new(3);
    program.add_cost(2, 1.0);
    program.zero(Affine { constant: -2.0, terms: vec![(0, 1.0), (1, 1.0)] });
    program.nonnegative(Affine { constant: -1.5, terms: vec![(0, 1.0)] });
    program.norm(Affine::unknown(2), vec![Affine::unknown(0), Affine::unknown(1)]);
    let answer = program.solve(&Ctl::new()).unwrap();
    assert_eq!(answer.outcome, Outcome::Solved);
    assert!((answer.x[0] - 1.5).abs() < 1e-7 && (answer.x[1] - 0.5).abs() < 1e-7);
    // And none at all where x ≥ 3, y ≥ 0.
    program.nonnegative(Affine { constant: -3.0, terms: vec![(0, 1.0)] });
    program.nonnegative(Affine::unknown(1));
    assert_eq!(program.solve(&Ctl::new()).unwrap().outcome, Outcome::Infeasible);
    let nan = Program::new(1).nonnegative(Affine::constant(f64::NAN)).solve(&Ctl::new()).unwrap_err();
    assert!(matches!(nan, ConicError::NotFinite), "{nan}");
}

#[test]
fn a_start_outside_and_a_stop_are_errors() {
    let identity = DMatrix::identity(2, 2);
    let problem = Problem {
        cost: DVector::from_element(1, 1.0),
        quadratic: None,
        objective_scale: 1.0,
        gap: lmi::GAP,
        blocks: vec![Block::new(DMatrix::zeros(2, 2), [&identity].into_iter())],
    };
    let outside = lmi::solve(&problem, &DVector::from_element(1, -1.0), &Ctl::new());
    assert_eq!(outside, Err(LmiError::Infeasible { block: 0 }));
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    assert!(matches!(lmi::solve(&problem, &DVector::from_element(1, 1.0), &ctl), Err(LmiError::Stopped(_))));
}
