//! The gains of a horizon without end, with their derivatives.
//!
//! Of the regulator's equation `dP = A_cᵀ dP A_c + dQ + KᵀdR K` with `A_c = A − BK`, and `dK = (R + BᵀPB)⁻¹(Bᵀ dP A_c −
//! dR K)`; of the filter's, which is dual, `dS = A_f dS A_fᵀ + dW_p + L dV_p Lᵀ` with `A_f = A − LC`.
//!
//! States that no control moves, such as a target that walks at random, need not decay. With A = [A₁ A₁₂; 0 A₂] and B =
//! [B₁; 0] the cost's corner P₁ is that of (A₁, B₁), and `P₁₂ = A_c₁ᵀ(P₁A₁₂ + P₁₂A₂) + Q₁₂` is all that K needs beside
//! it: that of a growing horizon, whether or not the cost itself stays finite.

use super::design::{Design, Member, Role, Timing};
use super::jet::Jet;
use crate::control::lyapunov::{Clock, Lyapunov};
use crate::control::riccati::Riccati;
use crate::num::linalg::{eigenvalues, solve_symmetric, symmetric};
use nalgebra::DMatrix;

/// A direction of the states that the controls reach by less than this share of A's norm is not reached.
const REACHED: f64 = 1e-9;
/// A state that no control moves may grow by less than this in a sample.
const GROWTH: f64 = 1e-9;
/// Doublings of the equation of P₁₂ at most.
const DOUBLINGS: usize = 60;

/// Coordinates x = [T₁ T₂][x₁; x₂] with orthonormal columns: x₁ is what the controls reach.
struct Reach {
    t: DMatrix<f64>,
    reached: usize,
}

/// `None` where the controls reach all states.
fn reach(a: &DMatrix<f64>, b: &DMatrix<f64>) -> Option<Reach> {
    let n = a.nrows();
    let mut basis: Vec<nalgebra::DVector<f64>> = Vec::new();
    let add = |basis: &mut Vec<nalgebra::DVector<f64>>, v: nalgebra::DVector<f64>, size: f64| {
        let mut rest = v;
        // Twice, for the rounding of the first time.
        for _ in 0..2 {
            for known in basis.iter() {
                rest -= known * known.dot(&rest);
            }
        }
        let norm = rest.norm();
        if norm > REACHED * size {
            basis.push(rest / norm);
        }
    };
    for column in b.column_iter() {
        add(&mut basis, column.into_owned(), b.norm());
    }
    let mut next = 0;
    while next < basis.len() && basis.len() < n {
        let moved = a * &basis[next];
        add(&mut basis, moved, a.norm());
        next += 1;
    }
    let reached = basis.len();
    if reached == n {
        return None;
    }
    for i in 0..n {
        let mut unit = nalgebra::DVector::zeros(n);
        unit[i] = 1.0;
        // A tenth: of all unit vectors one is at least that far from what is spanned.
        let mut rest = unit;
        for known in &basis {
            rest -= known * known.dot(&rest);
        }
        if rest.norm() > 0.1 / n as f64 {
            add(&mut basis, rest, 1.0);
        }
    }
    Some(Reach { t: DMatrix::from_columns(&basis), reached })
}

fn riccati(a: &DMatrix<f64>, b: &DMatrix<f64>, q: &DMatrix<f64>, r: &DMatrix<f64>) -> Option<[DMatrix<f64>; 2]> {
    let solved = Riccati::new(a, b, q, r, Clock::Sampled).ok()?.solve().ok()?;
    Some([solved.k, solved.p])
}

/// X with `X = MᵀXN + C`, by doubling; `None` where it does not converge.
fn stein(m: &DMatrix<f64>, n: &DMatrix<f64>, c: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let (mut m, mut n, mut x) = (m.clone(), n.clone(), c.clone());
    for _ in 0..DOUBLINGS {
        let change = m.tr_mul(&(&x * &n));
        x += &change;
        if !x.iter().all(|v| v.is_finite()) {
            return None;
        }
        if change.norm() <= 1e-16 * x.norm() {
            return Some(x);
        }
        (m, n) = (&m * &m, &n * &n);
    }
    None
}

/// K of the regulator, with its derivatives; `None` where none stabilises what the controls reach, or what they do not
/// reach grows.
pub(super) fn regulator(a: &DMatrix<f64>, b: &DMatrix<f64>, q: &Jet, r: &Jet) -> Option<Jet> {
    let n = a.nrows();
    let (weight_q, weight_r) = (q.matrix(), r.matrix());
    let parameters = 0..q.count();
    let moves = |i: usize| q.slope(i).is_some() || r.slope(i).is_some();
    let of = |jet: &Jet, i: usize| jet.slope_matrix(i);
    let Some(Reach { t, reached }) = reach(a, b) else {
        let [k, p] = riccati(a, b, &weight_q, &weight_r)?;
        let closed = a - b * &k;
        let weight = symmetric(&(&weight_r + b.tr_mul(&p) * b));
        let operator = if q.count() > 0 { Some(Lyapunov::new(&closed, Clock::Sampled).ok()?) } else { None };
        let slope = |i: usize| {
            let operator = operator.as_ref().filter(|_| moves(i))?;
            let dr = of(r, i).unwrap_or_else(|| DMatrix::zeros(b.ncols(), b.ncols()));
            let dq = of(q, i).unwrap_or_else(|| DMatrix::zeros(n, n));
            let dp = operator.solve(&symmetric(&(dq + k.tr_mul(&(&dr * &k)))));
            Some(solve_symmetric(&weight, &(b.tr_mul(&dp) * &closed - dr * &k)))
        };
        let slopes: Vec<_> = parameters.map(slope).collect();
        return Some(Jet::new(&k, slopes.iter().map(Option::as_ref)));
    };
    let rest = n - reached;
    let turned = t.tr_mul(&(a * &t));
    let a1 = turned.view((0, 0), (reached, reached)).into_owned();
    let a12 = turned.view((0, reached), (reached, rest)).into_owned();
    let a2 = turned.view((reached, reached), (rest, rest)).into_owned();
    if eigenvalues(&a2).ok()?.iter().any(|v| v.norm() > 1.0 + GROWTH) {
        return None;
    }
    let b1 = t.tr_mul(b).rows(0, reached).into_owned();
    let corners = |m: &DMatrix<f64>| {
        let turned = t.tr_mul(&(m * &t));
        let corner = symmetric(&turned.view((0, 0), (reached, reached)).into_owned());
        (corner, turned.view((0, reached), (reached, rest)).into_owned())
    };
    let (q1, q12) = corners(&weight_q);
    let [k1, p1] = riccati(&a1, &b1, &q1, &weight_r)?;
    let closed = &a1 - &b1 * &k1;
    let p12 = stein(&closed, &a2, &(closed.tr_mul(&(&p1 * &a12)) + q12))?;
    let weight = symmetric(&(&weight_r + b1.tr_mul(&p1) * &b1));
    let k2 = solve_symmetric(&weight, &b1.tr_mul(&(&p1 * &a12 + &p12 * &a2)));
    let both = |left: &DMatrix<f64>, right: &DMatrix<f64>| {
        left * t.columns(0, reached).transpose() + right * t.columns(reached, rest).transpose()
    };
    let operator = if q.count() > 0 { Some(Lyapunov::new(&closed, Clock::Sampled).ok()?) } else { None };
    let shared = &a12 - &b1 * &k2;
    let slope = |i: usize| {
        let operator = operator.as_ref().filter(|_| moves(i))?;
        let dr = of(r, i).unwrap_or_else(|| DMatrix::zeros(b.ncols(), b.ncols()));
        let (dq1, dq12) = corners(&of(q, i).unwrap_or_else(|| DMatrix::zeros(n, n)));
        let dp1 = operator.solve(&symmetric(&(dq1 + k1.tr_mul(&(&dr * &k1)))));
        let right = closed.tr_mul(&(&dp1 * &shared)) + dq12 + k1.tr_mul(&(&dr * &k2));
        let dp12 = stein(&closed, &a2, &right)?;
        let left = solve_symmetric(&weight, &(b1.tr_mul(&(&dp1 * &closed)) - &dr * &k1));
        let right = solve_symmetric(&weight, &(b1.tr_mul(&(&dp1 * &shared + dp12 * &a2)) - &dr * &k2));
        Some(both(&left, &right))
    };
    let slopes: Vec<_> = parameters.map(slope).collect();
    Some(Jet::new(&both(&k1, &k2), slopes.iter().map(Option::as_ref)))
}

/// L of the filter in this timing, with its derivatives.
pub(super) fn filter(a: &DMatrix<f64>, c: &DMatrix<f64>, w: &Jet, v: &Jet, timing: Timing) -> Option<Jet> {
    let n = a.nrows();
    let [k, s] = riccati(&a.transpose(), &c.transpose(), &w.matrix(), &v.matrix())?;
    let innovation = symmetric(&(v.matrix() + c * &s * c.transpose()));
    // L of the predictor is A times that of the filter.
    let update = solve_symmetric(&innovation, &(c * &s)).transpose();
    let predictor = k.transpose();
    let error = a - &predictor * c;
    let operator = if w.count() > 0 { Some(Lyapunov::new(&error, Clock::Sampled).ok()?) } else { None };
    let (l, left) = match timing {
        Timing::Predictor => (&predictor, error),
        Timing::Filter => (&update, DMatrix::identity(n, n) - &update * c),
    };
    let slope = |i: usize| {
        let operator = operator.as_ref().filter(|_| w.slope(i).is_some() || v.slope(i).is_some())?;
        let dv = v.slope_matrix(i).unwrap_or_else(|| DMatrix::zeros(c.nrows(), c.nrows()));
        let dw = w.slope_matrix(i).unwrap_or_else(|| DMatrix::zeros(n, n));
        let ds = operator.solve_adjoint(&symmetric(&(dw + &predictor * &dv * predictor.transpose())));
        let moved = &left * ds * c.transpose() - l * dv;
        Some(solve_symmetric(&innovation, &moved.transpose()).transpose())
    };
    let slopes: Vec<_> = (0..w.count()).map(slope).collect();
    Some(Jet::new(l, slopes.iter().map(Option::as_ref)))
}

impl Design {
    /// The person at θ, with derivatives if asked; `None` where no regulator or no filter is stabilising there.
    ///
    /// # Panics
    /// If θ has another length than there are free terms, which is a mistake of the caller.
    #[must_use]
    pub fn member(&self, theta: &[f64], slopes: bool) -> Option<Member> {
        let gains = self.gains(theta, slopes, None, &|| false)?;
        let [k, l] = gains.at(0);
        let own = self.internal().a.nrows();
        let zero = DMatrix::zeros(own, own);
        let of = |jet: &Jet| (0..jet.count()).map(|i| jet.slope_matrix(i)).collect();
        Some(Member {
            k: k.matrix(),
            l: l.matrix(),
            q: self.sum(theta, Role::StateWeight, &zero, false).matrix(),
            perceived: self.sum(theta, Role::PerceivedProcessNoise, &zero, false).matrix(),
            k_slopes: of(k),
            l_slopes: of(l),
        })
    }
}
