//! What shows that weights belong to a gain.

use super::gains::Gains;
use crate::control::lyapunov::{Clock, Lyapunov};
use crate::control::riccati::{Riccati, RiccatiError, doubling, sign_function};
use crate::num::linalg::symmetric;
use nalgebra::DMatrix;
use num_complex::Complex64;

/// Frequencies of the return difference's grid.
const GRID: usize = 64;
/// Halvings of the grid's step around the least value.
const REFINEMENTS: usize = 20;

/// The least of Kalman's return difference over frequency.
///
/// With `T(jω) = I + K(jωI − A)⁻¹B` the least eigenvalue of `R^(−1/2) (T*RT − R) R^(−1/2)`; in sampled time with `R +
/// BᵀPB` around T and in the square roots. It is not negative for an optimal gain (Kalman 1964; Priess 2015, Theorem
/// 1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReturnDifference {
    /// The least eigenvalue.
    pub margin: f64,
    /// Where, in rad per unit of time (in sampled time rad per sample).
    pub omega: f64,
}

/// Evidence for weights (Q, R).
#[derive(Debug, Clone, PartialEq)]
pub struct Proof {
    /// P, from the closed loop's Lyapunov equation.
    pub p: DMatrix<f64>,
    /// `‖BᵀP − RK‖/‖RK‖`, in sampled time `‖BᵀPA − (BᵀPB + R)K‖/‖(BᵀPB + R)K‖`.
    pub gain_residual: f64,
    /// Relative residual of the Riccati equation at P.
    pub riccati_residual: f64,
    /// The regulator of (Q, R), by solving the Riccati equation anew.
    pub forward_gain: DMatrix<f64>,
    /// `‖K̂ − K‖_F/‖K‖_F`.
    pub forward_error: f64,
    /// The largest difference of the two methods' gains (doubling, sign function, unrefined) to the refined one,
    /// relative; `None` where a method broke down.
    pub method_difference: Option<f64>,
    /// Eigenvalues of A − BK̂.
    pub forward_poles: Vec<Complex64>,
    /// Kalman's inequality.
    pub return_difference: Option<ReturnDifference>,
    /// The least eigenvalue of Q over its largest.
    pub least_q: f64,
    /// The same of R.
    pub least_r: f64,
}

/// Solves the forward problem and compares.
///
/// # Errors
/// [`RiccatiError`] where (Q, R) has no regulator.
pub(super) fn prove(gains: &Gains, q: &DMatrix<f64>, r: &DMatrix<f64>) -> Result<Proof, RiccatiError> {
    let equation = Riccati::indefinite(&gains.a, &gains.b, q, r, gains.clock)?;
    let closed = gains.closed_loop();
    let p = Lyapunov::new(&closed, gains.clock)?.solve(&(q + gains.k.tr_mul(&(r * &gains.k))));
    let bp = gains.b.tr_mul(&p);
    let (left, right) = match gains.clock {
        Clock::Continuous => (bp, r * &gains.k),
        Clock::Sampled => (&bp * &gains.a, (&bp * &gains.b + r) * &gains.k),
    };
    // From no knowledge of K; only where rounding defeats both methods is K itself the start, and the answer is then
    // still checked.
    let solution = equation.solve().or_else(|error| equation.finish(&gains.k).map_err(|_| error))?;
    // A gain of zero is compared as it is.
    let size = if gains.k.norm() > 0.0 { gains.k.norm() } else { 1.0 };
    let difference = |method: fn(&Riccati) -> Option<DMatrix<f64>>| {
        method(&equation).map(|p| (equation.gain(&p) - &solution.k).norm() / size).filter(|d| d.is_finite())
    };
    let method_difference = difference(doubling).zip(difference(sign_function)).map(|(x, y)| x.max(y));
    let ratio = |m: &DMatrix<f64>| {
        let values = m.symmetric_eigenvalues();
        values.min() / values.amax().max(f64::MIN_POSITIVE)
    };
    Ok(Proof {
        gain_residual: (left - &right).norm() / right.norm().max(f64::MIN_POSITIVE),
        riccati_residual: equation.relative_residual(&p),
        forward_error: (&solution.k - &gains.k).norm() / size,
        method_difference,
        forward_poles: solution.poles,
        return_difference: return_difference(gains, r, &p),
        least_q: ratio(q),
        least_r: ratio(r),
        forward_gain: solution.k,
        p,
    })
}

/// The least return difference over a grid of frequencies around the poles, refined around the least.
pub(super) fn return_difference(gains: &Gains, r: &DMatrix<f64>, p: &DMatrix<f64>) -> Option<ReturnDifference> {
    let weight = match gains.clock {
        Clock::Continuous => r.clone(),
        Clock::Sampled => symmetric(&(gains.b.tr_mul(&(p * &gains.b)) + r)),
    };
    let factor = weight.clone().cholesky()?.l();
    let whitened = factor.solve_lower_triangular(&symmetric(r))?;
    let inner = factor.solve_lower_triangular(&whitened.transpose())?;
    let complex = |m: &DMatrix<f64>| m.map(|v| Complex64::new(v, 0.0));
    let (a, b, k) = (complex(&gains.a), complex(&gains.b), complex(&gains.k));
    let (left, inverse) = (complex(&factor.transpose()), complex(&factor.transpose().try_inverse()?));
    let (n, m) = (gains.states(), gains.ports());
    let value = |omega: f64| -> Option<f64> {
        let point = match gains.clock {
            Clock::Continuous => Complex64::new(0.0, omega),
            Clock::Sampled => Complex64::from_polar(1.0, omega),
        };
        let states = (DMatrix::from_diagonal_element(n, n, point) - &a).lu().solve(&b)?;
        let t = &left * (DMatrix::identity(m, m) + &k * states) * &inverse;
        let gram = t.adjoint() * t - complex(&inner);
        if gram.iter().any(|v| !(v.re.is_finite() && v.im.is_finite())) {
            return None;
        }
        // The real symmetric matrix [X −Y; Y X] has the eigenvalues of X + jY twice.
        let real = DMatrix::from_fn(2 * m, 2 * m, |i, j| {
            let v = 0.5 * (gram[(i % m, j % m)] + gram[(j % m, i % m)].conj());
            match (i < m, j < m) {
                (true, true) | (false, false) => v.re,
                (true, false) => -v.im,
                (false, true) => v.im,
            }
        });
        Some(real.symmetric_eigenvalues().min())
    };
    let mut grid: Vec<f64> = match gains.clock {
        Clock::Sampled => (0..GRID).map(|i| std::f64::consts::PI * i as f64 / (GRID - 1) as f64).collect(),
        Clock::Continuous => {
            let open = crate::num::linalg::eigenvalues(&gains.a).ok()?;
            let sizes = open.iter().chain(&gains.poles).map(|v| v.norm()).filter(|v| *v > 0.0);
            let (low, high) = sizes.fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
            let (low, high) = if high > 0.0 { (low * 1e-2, high * 1e2) } else { (1e-2, 1e2) };
            let mut grid = vec![0.0];
            grid.extend((0..GRID).map(|i| low * (high / low).powf(i as f64 / (GRID - 1) as f64)));
            grid.extend(open.iter().chain(&gains.poles).map(|v| v.im.abs()));
            grid
        }
    };
    grid.sort_by(f64::total_cmp);
    let values: Vec<Option<f64>> = grid.iter().map(|omega| value(*omega)).collect();
    let best = (0..grid.len())
        .filter(|i| values[*i].is_some())
        .min_by(|x, y| values[*x].unwrap_or(f64::INFINITY).total_cmp(&values[*y].unwrap_or(f64::INFINITY)))?;
    let (mut omega, mut margin) = (grid[best], values[best]?);
    let (mut low, mut high) = (grid[best.saturating_sub(1)], grid[(best + 1).min(grid.len() - 1)]);
    // Five points over the interval, of which those at its ends and in its middle stay when it is halved.
    let place = |low: f64, high: f64, i: usize| low + (high - low) * i as f64 / 4.0;
    let mut known: [Option<Option<f64>>; 5] = [None; 5];
    for _ in 0..REFINEMENTS {
        let found: [Option<f64>; 5] = std::array::from_fn(|i| known[i].unwrap_or_else(|| value(place(low, high, i))));
        let least = (0..5).filter_map(|i| found[i].map(|v| (i, v))).min_by(|x, y| x.1.total_cmp(&y.1));
        let Some((i, v)) = least else { break };
        if v < margin {
            (omega, margin) = (place(low, high, i), v);
        }
        let (left, right) = (i.saturating_sub(1), (i + 1).min(4));
        // At an end the interval is quartered, and its middle is new.
        let middle = (right - left == 2).then(|| found[left + 1]);
        known = [Some(found[left]), None, middle, None, Some(found[right])];
        (low, high) = (place(low, high, left), place(low, high, right));
        if high - low <= 1e-9 * high.abs() {
            break;
        }
    }
    Some(ReturnDifference { margin, omega })
}
