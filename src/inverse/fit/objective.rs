//! The misfit of the regulator of (Q, R), with exact first and second derivatives.

use crate::control::lyapunov::{Clock, Lyapunov};
use crate::control::riccati::{Riccati, RiccatiError, RiccatiSolution};
use crate::ctl::{Ctl, Stopped};
use crate::inverse::gains::Gains;
use crate::num::linalg::{solve_symmetric, symmetric};
use nalgebra::{DMatrix, DVector};

/// `f(Q, R) = vec(E)ᵀ M vec(E)` with `E = K(Q, R) − K_e`.
///
/// vec stacks the columns of the m×n matrix E; M is mn×mn, the identity unless the covariance of K_e is known.
#[derive(Debug, Clone)]
pub struct Objective<'a> {
    pub(super) gains: &'a Gains,
    metric: Option<&'a DMatrix<f64>>,
}

/// f and what its derivatives need.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// f.
    pub value: f64,
    /// K(Q, R), m×n.
    pub k: DMatrix<f64>,
    /// ∂f/∂Q, n×n and symmetric: `df = tr(G_Q dQ) + tr(G_R dR)`, so that an off-diagonal entry of θ counts twice.
    pub gradient_q: DMatrix<f64>,
    /// ∂f/∂R, m×m and symmetric.
    pub gradient_r: DMatrix<f64>,
    /// R, in sampled time R + BᵀPB.
    weight: DMatrix<f64>,
    closed: DMatrix<f64>,
    lyapunov: Lyapunov,
    /// `weight⁻¹ M E`.
    scaled_error: DMatrix<f64>,
}

impl<'a> Objective<'a> {
    /// The misfit to a gain; `metric`, where there is one, is mn×mn, symmetric and positive semidefinite.
    ///
    /// # Panics
    /// If the metric has another size, which is a mistake of the caller.
    #[must_use]
    pub fn new(gains: &'a Gains, metric: Option<&'a DMatrix<f64>>) -> Self {
        let size = gains.states() * gains.ports();
        assert!(metric.is_none_or(|m| m.shape() == (size, size)), "metric of a {size}-vector");
        Self { gains, metric }
    }

    fn weighted(&self, e: &DMatrix<f64>) -> DMatrix<f64> {
        self.metric.map_or_else(
            || e.clone(),
            |m| {
                let v = m * DVector::from_column_slice(e.as_slice());
                DMatrix::from_column_slice(e.nrows(), e.ncols(), v.as_slice())
            },
        )
    }

    /// The regulator of (Q, R), by Newton's method from a gain near it where that stabilises, from nothing otherwise.
    fn regulator(
        &self,
        q: &DMatrix<f64>,
        r: &DMatrix<f64>,
        near: Option<&DMatrix<f64>>,
    ) -> Result<RiccatiSolution, RiccatiError> {
        let equation = Riccati::indefinite(&self.gains.a, &self.gains.b, q, r, self.gains.clock)?;
        if let Some(near) = near
            && let Ok(solution) = equation.finish(near)
        {
            return Ok(solution);
        }
        equation.solve()
    }

    /// f alone.
    ///
    /// # Errors
    /// [`RiccatiError`] where (Q, R) has no regulator.
    pub fn value(
        &self,
        q: &DMatrix<f64>,
        r: &DMatrix<f64>,
        near: Option<&DMatrix<f64>>,
    ) -> Result<(f64, DMatrix<f64>), RiccatiError> {
        let k = self.regulator(q, r, near)?.k;
        let e = &k - &self.gains.k;
        Ok((e.dot(&self.weighted(&e)), k))
    }

    /// f with its gradient, by one adjoint Lyapunov equation:
    /// `(A − BK)Λ + Λ(A − BK)ᵀ + sym(2BR⁻¹ME) = 0`, `G_Q = Λ`, `G_R = KΛKᵀ − sym(2R⁻¹MEKᵀ)`;
    /// in sampled time with `R + BᵀPB` for R and `(A − BK)ᵀ` to the right of ME.
    ///
    /// # Errors
    /// [`RiccatiError`] where (Q, R) has no regulator.
    pub fn evaluate(
        &self,
        q: &DMatrix<f64>,
        r: &DMatrix<f64>,
        near: Option<&DMatrix<f64>>,
    ) -> Result<Evaluation, RiccatiError> {
        let Gains { a, b, clock, .. } = self.gains;
        let RiccatiSolution { p, k, .. } = self.regulator(q, r, near)?;
        let e = &k - &self.gains.k;
        let weighted = self.weighted(&e);
        let value = e.dot(&weighted);
        let closed = a - b * &k;
        let lyapunov = Lyapunov::new(&closed, *clock)?;
        let weight = match clock {
            Clock::Continuous => symmetric(r),
            Clock::Sampled => symmetric(&(r + b.tr_mul(&(&p * b)))),
        };
        let scaled_error = solve_symmetric(&weight, &weighted);
        let source = match clock {
            Clock::Continuous => b * &scaled_error,
            Clock::Sampled => b * &scaled_error * closed.transpose(),
        };
        let lambda = lyapunov.solve_adjoint(&(&source + source.transpose()));
        let direct = &scaled_error * k.transpose();
        let gradient_r = symmetric(&(&k * &lambda * k.transpose())) - (&direct + direct.transpose());
        Ok(Evaluation { value, k, gradient_q: lambda, gradient_r, weight, closed, lyapunov, scaled_error })
    }

    /// Gradient and Hessian along directions (dQ_i, dR_i).
    ///
    /// With `(A − BK)ᵀP_i + P_i(A − BK) + dQ_i + KᵀdR_iK = 0` and `RK_i = BᵀP_i − dR_iK` the second derivative needs no
    /// further equation: `f_ij = 2⟨K_i, MK_j⟩ − 2⟨RK_iΛ, K_j⟩ − 2⟨R⁻¹ME, dR_iK_j + dR_jK_i⟩`; in sampled time with `R +
    /// BᵀPB` for R and its derivative for dR in the last term.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn derivatives(
        &self,
        at: &Evaluation,
        directions: &[(DMatrix<f64>, DMatrix<f64>)],
        ctl: &Ctl,
    ) -> Result<(DVector<f64>, DMatrix<f64>), Stopped> {
        let b = &self.gains.b;
        let count = directions.len();
        let mut gains = Vec::with_capacity(count);
        for (dq, dr) in directions {
            ctl.check()?;
            let p = at.lyapunov.solve(&(dq + at.k.tr_mul(&(dr * &at.k))));
            let bp = b.tr_mul(&p);
            let (right, slope) = match self.gains.clock {
                Clock::Continuous => (bp, dr.clone()),
                Clock::Sampled => (&bp * &at.closed, dr + &bp * b),
            };
            let k = solve_symmetric(&at.weight, &(right - dr * &at.k));
            let curved = &at.weight * &k * &at.gradient_q;
            // ⟨X, dR_iK_j⟩ = ⟨dR_iᵀX, K_j⟩.
            let turned = slope.tr_mul(&at.scaled_error);
            gains.push((self.weighted(&k), curved, turned, k));
        }
        let gradient =
            DVector::from_fn(count, |i, _| at.gradient_q.dot(&directions[i].0) + at.gradient_r.dot(&directions[i].1));
        let mut hessian = DMatrix::zeros(count, count);
        for i in 0..count {
            for j in 0..=i {
                let (wi, ci, ti, ki) = &gains[i];
                let (_, _, tj, kj) = &gains[j];
                let value = 2.0 * (wi.dot(kj) - ci.dot(kj) - ti.dot(kj) - tj.dot(ki));
                hessian[(i, j)] = value;
                hessian[(j, i)] = value;
            }
        }
        Ok((gradient, hessian))
    }
}
