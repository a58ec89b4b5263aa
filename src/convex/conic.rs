//! Conic programs in words, solved by clarabel.
//!
//! `minimise ½ xᵀPx + qᵀx` subject to affine expressions that are zero, at least zero, in a second-order cone or
//! positive semidefinite. A [`Ctl`] is looked at in every step.

use super::svec;
use crate::ctl::{Ctl, Stopped};
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};
use nalgebra::{DMatrix, DVector};

/// An affine expression `constant + Σ coefficient · x[index]`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Affine {
    /// The constant.
    pub constant: f64,
    /// Coefficients by unknown; an unknown may occur more than once.
    pub terms: Vec<(usize, f64)>,
}

impl Affine {
    /// A constant.
    #[must_use]
    pub fn constant(constant: f64) -> Self {
        Self { constant, terms: Vec::new() }
    }

    /// One unknown.
    #[must_use]
    pub fn unknown(index: usize) -> Self {
        Self { constant: 0.0, terms: vec![(index, 1.0)] }
    }

    /// Its value at x.
    #[must_use]
    pub fn value(&self, x: &[f64]) -> f64 {
        self.terms.iter().fold(self.constant, |sum, (index, factor)| sum + factor * x[*index])
    }
}

/// A program under construction, in N unknowns.
#[derive(Debug, Clone, PartialEq)]
pub struct Program {
    unknowns: usize,
    linear: Vec<f64>,
    quadratic: Vec<(usize, usize, f64)>,
    /// Rows in their order, each an expression that must lie in the row's cone.
    rows: Vec<Affine>,
    cones: Vec<Cone>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Cone {
    Zero(usize),
    Nonnegative(usize),
    Norm(usize),
    Semidefinite(usize),
}

/// How clarabel ended. The answer's own residuals are in [`Answer`]; callers prove their claims on those.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// To full accuracy.
    Solved,
    /// To reduced accuracy.
    AlmostSolved,
    /// It believes that nothing is feasible.
    Infeasible,
    /// It believes that the cost has no bound.
    Unbounded,
    /// It ran out of steps or of digits.
    Failed,
}

/// What clarabel answered, and how well that satisfies the program.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The unknowns.
    pub x: Vec<f64>,
    /// The dual of each row, in the order in which rows were added (svec of a matrix).
    pub dual: Vec<f64>,
    /// The cost of x, computed here.
    pub objective: f64,
    /// The largest violation of a row by x, computed here: of a matrix minus its least eigenvalue.
    pub violation: f64,
    /// How it ended.
    pub outcome: Outcome,
    /// Steps taken.
    pub steps: u32,
}

/// A program that clarabel does not take.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConicError {
    /// A number is NaN or infinite.
    #[error("the program has a number that is not finite")]
    NotFinite,
    /// Clarabel refused the program.
    #[error("the solver refuses the program: {0}")]
    Refused(String),
    /// Somebody asked to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

impl Program {
    /// A program in N unknowns, without cost or constraint.
    #[must_use]
    pub fn new(unknowns: usize) -> Self {
        Self { unknowns, linear: vec![0.0; unknowns], quadratic: Vec::new(), rows: Vec::new(), cones: Vec::new() }
    }

    /// Adds `factor · x[index]` to the cost.
    pub fn add_cost(&mut self, index: usize, factor: f64) -> &mut Self {
        self.linear[index] += factor;
        self
    }

    /// Adds `½ factor · x[i] · x[i]` for i = j to the cost, `factor · x[i] · x[j]` otherwise.
    pub fn add_quadratic_cost(&mut self, i: usize, j: usize, factor: f64) -> &mut Self {
        self.quadratic.push((i.min(j), i.max(j), factor));
        self
    }

    /// `expression = 0`.
    pub fn zero(&mut self, expression: Affine) -> &mut Self {
        self.cone(vec![expression], Cone::Zero(1))
    }

    /// `expression ≥ 0`.
    pub fn nonnegative(&mut self, expression: Affine) -> &mut Self {
        self.cone(vec![expression], Cone::Nonnegative(1))
    }

    /// `‖entries‖₂ ≤ bound`.
    pub fn norm(&mut self, bound: Affine, entries: Vec<Affine>) -> &mut Self {
        let size = entries.len() + 1;
        let mut rows = vec![bound];
        rows.extend(entries);
        self.cone(rows, Cone::Norm(size))
    }

    /// `entry(i, j) ⪰ 0` as an n×n matrix; only `i ≤ j` is asked for.
    pub fn semidefinite(&mut self, n: usize, mut entry: impl FnMut(usize, usize) -> Affine) -> &mut Self {
        let mut rows = Vec::with_capacity(svec::length(n));
        for j in 0..n {
            for i in 0..=j {
                let mut expression = entry(i, j);
                if i != j {
                    expression.constant *= std::f64::consts::SQRT_2;
                    expression.terms.iter_mut().for_each(|(_, factor)| *factor *= std::f64::consts::SQRT_2);
                }
                rows.push(expression);
            }
        }
        self.cone(rows, Cone::Semidefinite(n))
    }

    fn cone(&mut self, rows: Vec<Affine>, cone: Cone) -> &mut Self {
        self.rows.extend(rows);
        // Scalar cones side by side are one cone: clarabel is much faster with few.
        match (self.cones.last_mut(), cone) {
            (Some(Cone::Zero(n)), Cone::Zero(more)) | (Some(Cone::Nonnegative(n)), Cone::Nonnegative(more)) => {
                *n += more
            }
            _ => self.cones.push(cone),
        }
        self
    }

    /// Solves it.
    ///
    /// # Errors
    /// [`ConicError`].
    pub fn solve(&self, ctl: &Ctl) -> Result<Answer, ConicError> {
        ctl.check()?;
        let numbers = self
            .rows
            .iter()
            .flat_map(|row| std::iter::once(row.constant).chain(row.terms.iter().map(|(_, factor)| *factor)));
        let costs = self.linear.iter().copied().chain(self.quadratic.iter().map(|(_, _, factor)| *factor));
        if numbers.chain(costs).any(|v| !v.is_finite()) {
            return Err(ConicError::NotFinite);
        }
        let sparse = |rows: usize, entries: &[(usize, usize, f64)]| {
            let (mut is, mut js, mut vs) = (Vec::new(), Vec::new(), Vec::new());
            for (i, j, v) in entries {
                is.push(*i);
                js.push(*j);
                vs.push(*v);
            }
            CscMatrix::new_from_triplets(rows, self.unknowns, is, js, vs)
        };
        let p = sparse(self.unknowns, &self.quadratic);
        // s = b − Ax is the expression itself.
        let entries: Vec<(usize, usize, f64)> = self
            .rows
            .iter()
            .enumerate()
            .flat_map(|(i, row)| row.terms.iter().map(move |(index, factor)| (i, *index, -factor)))
            .collect();
        let a = sparse(self.rows.len(), &entries);
        let b: Vec<f64> = self.rows.iter().map(|row| row.constant).collect();
        let cones: Vec<SupportedConeT<f64>> = self
            .cones
            .iter()
            .map(|cone| match cone {
                Cone::Zero(n) => SupportedConeT::ZeroConeT(*n),
                Cone::Nonnegative(n) => SupportedConeT::NonnegativeConeT(*n),
                Cone::Norm(n) => SupportedConeT::SecondOrderConeT(*n),
                Cone::Semidefinite(n) => SupportedConeT::PSDTriangleConeT(*n),
            })
            .collect();
        let settings = DefaultSettings {
            verbose: false,
            tol_gap_abs: 1e-10,
            tol_gap_rel: 1e-10,
            tol_feas: 1e-10,
            max_threads: 1,
            ..DefaultSettings::default()
        };
        let mut solver = DefaultSolver::new(&p, &self.linear, &a, &b, &cones, settings)
            .map_err(|error| ConicError::Refused(format!("{error:?}")))?;
        let flag = ctl.stop_flag();
        solver.set_termination_callback(move |_| flag.is_raised());
        solver.solve();
        ctl.check()?;
        let solution = &solver.solution;
        let outcome = match solution.status {
            SolverStatus::Solved => Outcome::Solved,
            SolverStatus::AlmostSolved => Outcome::AlmostSolved,
            SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => Outcome::Infeasible,
            SolverStatus::DualInfeasible | SolverStatus::AlmostDualInfeasible => Outcome::Unbounded,
            _ => Outcome::Failed,
        };
        Ok(Answer {
            objective: self.cost(&solution.x),
            violation: self.violation(&solution.x),
            x: solution.x.clone(),
            dual: solution.z.clone(),
            outcome,
            steps: solution.iterations,
        })
    }

    /// The cost of x.
    #[must_use]
    pub fn cost(&self, x: &[f64]) -> f64 {
        let linear: f64 = self.linear.iter().zip(x).map(|(c, x)| c * x).sum();
        let quadratic =
            |(i, j, f): &(usize, usize, f64)| if i == j { 0.5 * f * x[*i] * x[*i] } else { f * x[*i] * x[*j] };
        linear + self.quadratic.iter().map(quadratic).sum::<f64>()
    }

    /// The largest violation of a row by x; NaN counts as infinite.
    #[must_use]
    pub fn violation(&self, x: &[f64]) -> f64 {
        let values = DVector::from_iterator(self.rows.len(), self.rows.iter().map(|row| row.value(x)));
        if values.iter().any(|v| !v.is_finite()) {
            return f64::INFINITY;
        }
        let mut at = 0;
        let mut worst: f64 = 0.0;
        for cone in &self.cones {
            let length = match cone {
                Cone::Zero(n) | Cone::Nonnegative(n) | Cone::Norm(n) => *n,
                Cone::Semidefinite(n) => svec::length(*n),
            };
            let part = values.rows(at, length);
            at += length;
            worst = worst.max(match cone {
                Cone::Zero(_) => part.amax(),
                Cone::Nonnegative(_) => -part.min(),
                Cone::Norm(n) => part.rows(1, n - 1).norm() - part[0],
                Cone::Semidefinite(0) => 0.0,
                Cone::Semidefinite(n) => {
                    let matrix: DMatrix<f64> = svec::smat(part.clone_owned().as_slice(), *n);
                    -matrix.symmetric_eigenvalues().min()
                }
            });
        }
        worst
    }
}
