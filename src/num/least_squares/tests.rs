use super::*;
use crate::ctl::StopReason;

type Residuals = Box<dyn Fn(&[f64]) -> Vec<f64>>;
type Jacobian = Box<dyn Fn(&[f64]) -> Vec<Vec<f64>>>;

/// A value and its gradient.
type Inequality = (fn(&[f64]) -> f64, fn(&[f64]) -> Vec<f64>);

/// A problem made of closures.
struct Case {
    n: usize,
    m: usize,
    residuals: Residuals,
    jacobian: Jacobian,
    bounds: Vec<[f64; 2]>,
    inequality: Option<Inequality>,
    feasible: fn(&[f64]) -> bool,
}

impl LeastSquares for Case {
    fn unknowns(&self) -> usize {
        self.n
    }
    fn equations(&self) -> usize {
        self.m
    }
    fn evaluate(&self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) -> bool {
        residuals.copy_from_slice(&(self.residuals)(x));
        if let Some(jacobian) = jacobian {
            let rows = (self.jacobian)(x);
            *jacobian = DMatrix::from_fn(self.m, self.n, |i, j| rows[i][j]);
        }
        true
    }
    fn bounds(&self) -> Vec<[f64; 2]> {
        self.bounds.clone()
    }
    fn inequalities(&self) -> usize {
        usize::from(self.inequality.is_some())
    }
    fn constrain(&self, x: &[f64], values: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) {
        if let Some((value, gradient)) = self.inequality {
            values[0] = value(x);
            if let Some(jacobian) = jacobian {
                jacobian.row_mut(0).iter_mut().zip(gradient(x)).for_each(|(j, g)| *j = g);
            }
        }
    }
    fn is_feasible(&self, x: &[f64]) -> bool {
        (self.feasible)(x)
    }
}

fn case(
    n: usize,
    m: usize,
    residuals: impl Fn(&[f64]) -> Vec<f64> + 'static,
    jacobian: impl Fn(&[f64]) -> Vec<Vec<f64>> + 'static,
) -> Case {
    Case {
        n,
        m,
        residuals: Box::new(residuals),
        jacobian: Box::new(jacobian),
        bounds: Vec::new(),
        inequality: None,
        feasible: |_| true,
    }
}

/// `10 (x₂ − x₁²), 1 − x₁`.
fn rosenbrock() -> Case {
    case(2, 2, |x| vec![10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]], |x| vec![vec![-20.0 * x[0], 10.0], vec![-1.0, 0.0]])
}

fn solved(case: &Case, start: &[f64], options: &Options) -> Minimum {
    let found = minimise(case, start, options, &Ctl::new()).unwrap();
    let mut again = DVector::zeros(case.m);
    case.evaluate(&found.x, &mut again, None);
    assert_eq!(again.norm_squared(), found.cost);
    for (x, [lower, upper]) in found.x.iter().zip(&case.bounds) {
        assert!(lower <= x && x <= upper);
    }
    found
}

fn floor() -> Options {
    Options { residual_floor: 1e-13, ..Options::default() }
}

#[test]
fn rosenbrock_has_its_minimum_at_one() {
    for start in [[-1.2, 1.0], [6.39, -0.221], [-50.0, 50.0]] {
        let found = solved(&rosenbrock(), &start, &floor());
        assert_eq!(found.stop, Stop::PerfectFit);
        assert!(found.x.iter().all(|x| (x - 1.0).abs() < 1e-12), "{found:?}");
    }
}

#[test]
fn powells_singular_function_reaches_its_floor() {
    let (five, ten) = (5.0_f64.sqrt(), 10.0_f64.sqrt());
    let problem = case(
        4,
        4,
        move |x| {
            vec![x[0] + 10.0 * x[1], five * (x[2] - x[3]), (x[1] - 2.0 * x[2]).powi(2), ten * (x[0] - x[3]).powi(2)]
        },
        move |x| {
            let (a, b) = (2.0 * (x[1] - 2.0 * x[2]), 2.0 * ten * (x[0] - x[3]));
            vec![
                vec![1.0, 10.0, 0.0, 0.0],
                vec![0.0, 0.0, five, -five],
                vec![0.0, a, -2.0 * a, 0.0],
                vec![b, 0.0, 0.0, -b],
            ]
        },
    );
    let found = solved(&problem, &[3.0, -1.0, 0.0, 1.0], &floor());
    assert_eq!(found.stop, Stop::PerfectFit, "{found:?}");
    assert!(found.x.iter().all(|x| x.abs() < 1e-6), "{found:?}");
}

/// Jennrich and Sampson: the minimum 124.362 at 0.257825 in both (Moré, Garbow and Hillstrom 1981, problem 6).
#[test]
fn a_large_residual_converges_by_its_gradient() {
    let problem = case(
        2,
        10,
        |x| {
            (1..=10)
                .map(|i| 2.0 + 2.0 * f64::from(i) - (f64::from(i) * x[0]).exp() - (f64::from(i) * x[1]).exp())
                .collect()
        },
        |x| (1..=10).map(|i| x.iter().map(|x| -f64::from(i) * (f64::from(i) * x).exp()).collect()).collect(),
    );
    let found = solved(&problem, &[0.3, 0.4], &Options::default());
    assert_eq!(found.stop, Stop::Converged, "{found:?}");
    assert!((found.cost - 124.362_182).abs() < 1e-5 && (found.x[0] - 0.257_825).abs() < 1e-5, "{found:?}");
    assert!(found.gradient_cosine <= 1e-7);
}

/// A column twice: the step is the shortest one, and the answer one of many.
#[test]
fn a_rank_deficient_problem_has_a_stationary_answer() {
    let problem = case(
        3,
        4,
        |x| (0..4).map(|i| x[0] + x[1] + f64::from(i) * x[2].exp() - 0.7 * f64::from(i * i)).collect(),
        |x| (0..4).map(|i| vec![1.0, 1.0, f64::from(i) * x[2].exp()]).collect(),
    );
    let found = solved(&problem, &[0.0, 0.0, 0.0], &Options::default());
    assert_eq!(found.stop, Stop::Converged);
    // The line through 0.7 i² has slope 2.1 and intercept −0.7.
    assert!((found.x[0] + found.x[1] + 0.7).abs() < 1e-6 && (found.x[2] - 2.1_f64.ln()).abs() < 1e-6, "{found:?}");
}

#[test]
fn more_unknowns_than_equations_are_allowed() {
    let problem = case(3, 1, |x| vec![x[0] * x[1] + x[2] - 4.0], |x| vec![vec![x[1], x[0], 1.0]]);
    assert_eq!(solved(&problem, &[1.0, 1.0, 1.0], &floor()).stop, Stop::PerfectFit);
}

#[test]
fn a_bound_holds_the_answer_and_says_so() {
    // Under x₁ ≤ 0.5 the minimum is at (0.5, 0.25), with cost 0.25.
    let mut problem = rosenbrock();
    problem.bounds = vec![[-2.0, 0.5], [f64::NEG_INFINITY, f64::INFINITY]];
    let found = solved(&problem, &[-1.2, 1.0], &Options::default());
    assert_eq!((found.stop, found.active.as_slice()), (Stop::Converged, &[Active::Upper(0)][..]));
    assert!((found.x[0] - 0.5).abs() < 1e-12 && (found.x[1] - 0.25).abs() < 1e-9, "{found:?}");
    // In a corner: x₁ ≥ 1.5, x₂ ≤ 1 (both hold, as the gradient says).
    problem.bounds = vec![[1.5, 9.0], [-9.0, 1.0]];
    let found = solved(&problem, &[4.0, -3.0], &Options::default());
    assert_eq!(found.active, [Active::Lower(0), Active::Upper(1)]);
    assert!(found.stop == Stop::Converged && found.x[0] == 1.5 && (found.x[1] - 1.0).abs() < 1e-12, "{found:?}");
    // Bounds that hold nothing change nothing.
    problem.bounds = vec![[-3.0, 3.0], [-3.0, 3.0]];
    let found = solved(&problem, &[-1.2, 1.0], &floor());
    assert!(found.stop == Stop::PerfectFit && found.active.is_empty(), "{found:?}");
}

#[test]
fn fixed_unknowns_stay() {
    let mut problem = rosenbrock();
    problem.bounds = vec![[-1.2, -1.2], [-9.0, 9.0]];
    let found = solved(&problem, &[-1.2, 1.0], &Options::default());
    assert!(found.stop == Stop::Converged && (found.x[1] - 1.44).abs() < 1e-9, "{found:?}");
}

/// Nearest point of the disc `x² + y² ≤ 1`, and of its outside, to a given one: a curved edge, from either side.
#[test]
fn a_curved_inequality_is_followed_to_the_constrained_minimum() {
    let target = || case(2, 2, |x| vec![x[0] - 3.0, x[1] - 4.0], |_| vec![vec![1.0, 0.0], vec![0.0, 1.0]]);
    let mut inside = target();
    inside.inequality = Some((|x| 1.0 - x[0] * x[0] - x[1] * x[1], |x| vec![-2.0 * x[0], -2.0 * x[1]]));
    for start in [[0.0, 0.0], [1.0, 0.0], [-0.6, 0.3]] {
        let found = solved(&inside, &start, &Options::default());
        assert_eq!((found.stop, found.active.as_slice()), (Stop::Converged, &[Active::Inequality(0)][..]), "{found:?}");
        assert!((found.x[0] - 0.6).abs() < 1e-6 && (found.x[1] - 0.8).abs() < 1e-6, "{found:?}");
        assert!(found.x[0].hypot(found.x[1]) <= 1.0);
    }
    let mut outside = case(2, 2, |x| vec![x[0] - 0.03, 2.0 * (x[1] - 0.04)], |_| vec![vec![1.0, 0.0], vec![0.0, 2.0]]);
    outside.inequality = Some((|x| x[0] * x[0] + x[1] * x[1] - 1.0, |x| vec![2.0 * x[0], 2.0 * x[1]]));
    let found = solved(&outside, &[2.0, 1.0], &Options::default());
    assert_eq!(found.stop, Stop::Converged, "{found:?}");
    // Along the circle the derivative vanishes: (x − .03, 4(y − .04)) parallel to (x, y).
    let cross = (found.x[0] - 0.03) * found.x[1] - 4.0 * (found.x[1] - 0.04) * found.x[0];
    assert!(cross.abs() < 1e-6 && found.x[0].hypot(found.x[1]) >= 1.0, "{found:?}");
}

#[test]
fn a_yes_or_no_edge_is_said_to_block() {
    let mut problem = case(2, 2, |x| vec![x[0] - 3.0, x[1]], |_| vec![vec![1.0, 0.0], vec![0.0, 1.0]]);
    problem.feasible = |x| x[0] < 1.0;
    let found = solved(&problem, &[0.0, 0.0], &Options::default());
    assert_eq!(found.stop, Stop::Blocked);
    assert!(found.x[0] < 1.0 && found.x[0] > 1.0 - 1e-9, "{found:?}");
    assert_eq!(
        minimise(&problem, &[2.0, 0.0], &Options::default(), &Ctl::new()),
        Err(LeastSquaresError::InfeasibleStart)
    );
}

#[test]
fn units_of_the_unknowns_do_not_matter() {
    let mut found = Vec::new();
    for unit in [1e-6, 1.0, 1e6] {
        let problem = case(
            2,
            2,
            move |x| vec![10.0 * (x[1] - (x[0] / unit).powi(2)), 1.0 - x[0] / unit],
            move |x| vec![vec![-20.0 * x[0] / (unit * unit), 10.0], vec![-1.0 / unit, 0.0]],
        );
        found.push(solved(&problem, &[-1.2 * unit, 1.0], &floor()).iterations);
    }
    assert!(found.iter().all(|i| i.abs_diff(found[0]) <= 1), "{found:?}");
}

#[test]
fn it_stops_when_asked_and_counts() {
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    assert!(matches!(minimise(&rosenbrock(), &[-1.2, 1.0], &floor(), &ctl), Err(LeastSquaresError::Stopped(_))));
    let few = Options { max_evaluations: 3, ..floor() };
    let found = solved(&rosenbrock(), &[-1.2, 1.0], &few);
    assert_eq!((found.stop, found.residual_evaluations), (Stop::EvaluationLimit, 3));
    assert!(found.jacobian_evaluations == found.iterations + 1);
}
