//! Filters and whole LQG controllers, by duality (Priess 2015, §4.3).

use super::gains::{Gains, GainsError, Role};
use super::lqr::{InverseError, InverseLqr, Settings, inverse_lqr};
use crate::control::lyapunov::Clock;
use crate::ctl::Ctl;
use nalgebra::DMatrix;

/// The answers for the regulator and for the filter of one controller, which do not depend on each other.
#[derive(Debug, Clone, PartialEq)]
pub struct InverseLqg {
    /// Q and R of the gain K.
    pub regulator: InverseLqr,
    /// The perceived noise intensities of the gain L: W in the place of Q, V in that of R, and the error covariance H
    /// in that of P.
    pub filter: InverseLqr,
}

/// Which half of the controller has no answer, and why.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InverseLqgError {
    /// The matrices are not a question.
    #[error("{error}")]
    Gains {
        /// Which half.
        role: Role,
        /// Why.
        error: GainsError,
    },
    /// The question has no proven answer.
    #[error("{error}")]
    Inverse {
        /// Which half.
        role: Role,
        /// Why.
        error: InverseError,
    },
}

/// Both inverse problems of `u = −Kx̂` with the filter gain L, for A n×n, B n×m, C p×n, K m×n and L n×p.
///
/// W and V are the noise intensities that the controller behaves as if it believed in; the true ones may differ (Priess
/// 2015, §4.3). The feedthrough D enters neither problem, since the filter knows u.
///
/// # Errors
/// [`InverseLqgError`] with the half that fails.
#[allow(clippy::too_many_arguments)]
pub fn inverse_lqg(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    c: &DMatrix<f64>,
    k: &DMatrix<f64>,
    l: &DMatrix<f64>,
    clock: Clock,
    settings: &(Settings, Settings),
    ctl: &Ctl,
) -> Result<InverseLqg, InverseLqgError> {
    let question =
        |role, gains: Result<Gains, GainsError>| gains.map_err(|error| InverseLqgError::Gains { role, error });
    let regulator = question(Role::Regulator, Gains::regulator(a, b, k, clock))?;
    let filter = question(Role::Filter, Gains::filter(a, c, l, clock))?;
    let answer = |role, gains: &Gains, settings: &Settings| {
        inverse_lqr(gains, settings, ctl).map_err(|error| InverseLqgError::Inverse { role, error })
    };
    Ok(InverseLqg {
        regulator: answer(Role::Regulator, &regulator, &settings.0)?,
        filter: answer(Role::Filter, &filter, &settings.1)?,
    })
}
