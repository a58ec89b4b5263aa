//! Linear-quadratic regulators, Kalman filters, and the loop that both make.

use super::lyapunov::Clock;
use super::riccati::{Riccati, RiccatiError, RiccatiSolution};
use super::state_space::{StateSpace, StateSpaceError};
use super::structural;
use super::time_base::TimeBase;
use crate::num::linalg::{self, NoConvergence};
use nalgebra::DMatrix;
use num_complex::Complex64;

/// The regulator u = −Kx that minimises `∫ xᵀQx + uᵀRu dt` (`Σ xᵀQx + uᵀRu`).
///
/// A is n×n, B n×m, Q ⪰ 0 n×n, R ≻ 0 m×m; (A, B) must be stabilisable and (A, Q) detectable (Priess 2015, eq.
/// (3.4)–(3.9)).
///
/// # Errors
/// [`RiccatiError`] naming the matrix or the hypothesis that fails.
pub fn lqr(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    clock: Clock,
) -> Result<RiccatiSolution, RiccatiError> {
    let equation = Riccati::new(a, b, q, r, clock)?;
    structural::check_stabilisable(a, b, clock)?;
    structural::check_detectable(a, &equation.q, clock)?;
    equation.solve()
}

/// A Kalman filter in its steady state.
#[derive(Debug, Clone, PartialEq)]
pub struct Kalman {
    /// L, n×p: `HCᵀV⁻¹`, in sampled time the predictor's gain `AHCᵀ(CHCᵀ + V)⁻¹`; A − LC is stable.
    pub l: DMatrix<f64>,
    /// H, n×n: the covariance of the error; in sampled time that of the prediction.
    pub h: DMatrix<f64>,
    /// Eigenvalues of A − LC.
    pub poles: Vec<Complex64>,
    /// Relative residual of the Riccati equation.
    pub residual: f64,
}

/// The filter `x̂⁺ = Ax̂ + Bu + L(y − Cx̂ − Du)` for process noise of intensity W (n×n, ⪰ 0) and measurement noise of
/// intensity V (p×p, ≻ 0), independent of each other; C is p×n (Priess 2015, eq. (4.3)–(4.5)).
///
/// The dual of [`lqr`]: (Aᵀ, Cᵀ, W, V) in place of (A, B, Q, R).
///
/// # Errors
/// [`RiccatiError`], with the letters of the filter.
pub fn kalman(
    a: &DMatrix<f64>,
    c: &DMatrix<f64>,
    w: &DMatrix<f64>,
    v: &DMatrix<f64>,
    clock: Clock,
) -> Result<Kalman, RiccatiError> {
    let solution = lqr(&a.transpose(), &c.transpose(), w, v, clock).map_err(dual)?;
    Ok(Kalman { l: solution.k.transpose(), h: solution.p, poles: solution.poles, residual: solution.residual })
}

/// The error of a regulator as one of the filter that it is dual to.
#[must_use]
pub fn dual(error: RiccatiError) -> RiccatiError {
    use structural::StructuralError as S;
    let letter = |matrix: &'static str| match matrix {
        "B" => "C",
        "Q" => "W",
        "R" => "V",
        other => other,
    };
    match error {
        RiccatiError::Size { matrix: "B", rows, columns, expected_rows, expected_columns } => RiccatiError::Size {
            matrix: "C",
            rows: columns,
            columns: rows,
            expected_rows: expected_columns,
            expected_columns: expected_rows,
        },
        RiccatiError::Size { matrix, rows, columns, expected_rows, expected_columns } => {
            RiccatiError::Size { matrix: letter(matrix), rows, columns, expected_rows, expected_columns }
        }
        RiccatiError::NotFinite { matrix: "A" | "B", row, column } => {
            RiccatiError::NotFinite { matrix: if row == column { "A" } else { "C" }, row: column, column: row }
        }
        RiccatiError::NotFinite { matrix, row, column } => {
            RiccatiError::NotFinite { matrix: letter(matrix), row, column }
        }
        RiccatiError::NotSymmetric { matrix, asymmetry } => {
            RiccatiError::NotSymmetric { matrix: letter(matrix), asymmetry }
        }
        RiccatiError::NotDefinite { matrix, least } => RiccatiError::NotDefinite { matrix: letter(matrix), least },
        RiccatiError::NotSemidefinite { matrix, least } => {
            RiccatiError::NotSemidefinite { matrix: letter(matrix), least }
        }
        RiccatiError::Structure(S::NotStabilisable(mode)) => S::NotDetectable(mode).into(),
        RiccatiError::Structure(S::NotDetectable(mode)) => S::NotStabilisable(mode).into(),
        other => other,
    }
}

/// A plant under `u = −Kx̂` with the filter of gain L: states `[x; x̂]`.
///
/// Inputs are the process noise w (n) and the measurement noise v (p); outputs are y (p) and u (m): `ẋ = Ax − BKx̂ +
/// w`, `x̂' = LCx + (A − BK − LC)x̂ + Lv`, `y = Cx − DKx̂ + v`, `u = −Kx̂`. The feedthrough D cancels in the filter,
/// which knows u.
///
/// # Errors
/// [`StateSpaceError`] where K (m×n) or L (n×p) does not fit the plant.
pub fn lqg_closed_loop<T: TimeBase>(
    plant: &StateSpace<T>,
    k: &DMatrix<f64>,
    l: &DMatrix<f64>,
) -> Result<StateSpace<T>, StateSpaceError> {
    let (n, m, p) = (plant.states(), plant.inputs(), plant.outputs());
    let size = |matrix, value: &DMatrix<f64>, expected_rows, expected_columns| {
        let (rows, columns) = value.shape();
        if (rows, columns) == (expected_rows, expected_columns) {
            Ok(())
        } else {
            Err(StateSpaceError::Size {
                matrix,
                rows,
                columns,
                expected_rows,
                expected_columns,
                states: n,
                inputs: m,
                outputs: p,
            })
        }
    };
    size("K", k, m, n)?;
    size("L", l, n, p)?;
    let bk = plant.b() * k;
    let lc = l * plant.c();
    let mut a = DMatrix::zeros(2 * n, 2 * n);
    a.view_mut((0, 0), (n, n)).copy_from(plant.a());
    a.view_mut((0, n), (n, n)).copy_from(&-&bk);
    a.view_mut((n, 0), (n, n)).copy_from(&lc);
    a.view_mut((n, n), (n, n)).copy_from(&(plant.a() - bk - lc));
    let mut b = DMatrix::zeros(2 * n, n + p);
    b.view_mut((0, 0), (n, n)).fill_with_identity();
    b.view_mut((n, n), (n, p)).copy_from(l);
    let mut c = DMatrix::zeros(p + m, 2 * n);
    c.view_mut((0, 0), (p, n)).copy_from(plant.c());
    c.view_mut((0, n), (p, n)).copy_from(&-(plant.d() * k));
    c.view_mut((p, n), (m, n)).copy_from(&-k);
    let mut d = DMatrix::zeros(p + m, n + p);
    d.view_mut((0, n), (p, p)).fill_with_identity();
    StateSpace::new(a, b, c, d, plant.time())
}

/// The eigenvalues of A − BK.
///
/// # Errors
/// [`NoConvergence`].
pub fn closed_loop_poles(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    k: &DMatrix<f64>,
) -> Result<Vec<Complex64>, NoConvergence> {
    if a.is_empty() { Ok(Vec::new()) } else { linalg::eigenvalues(&(a - b * k)) }
}
