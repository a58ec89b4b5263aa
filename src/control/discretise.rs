//! From continuous to sampled time.

use super::conversion::{self, ConversionError};
use super::exponential::matrix_exponential;
use super::state_space::StateSpace;
use super::time_base::{Continuous, Discrete};
use super::transfer_function::{TransferFunction, TransferFunctionError};
use crate::num::Polynomial;
use crate::num::linalg::NoConvergence;
use nalgebra::DMatrix;
use num_complex::Complex64;

/// Why a system could not be discretised.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DiscretiseError {
    /// Only proper systems are sampled.
    #[error(
        "the transfer function is improper (numerator of degree {num_degree}, denominator of degree {den_degree}); only proper ones can be sampled"
    )]
    Improper {
        /// Degree of the numerator.
        num_degree: usize,
        /// Degree of the denominator.
        den_degree: usize,
    },
    /// A mode grows so much, or the matrix is so large, that the exponential overflows.
    #[error("the exponential of the state matrix over {sample_time_s} s overflows")]
    Overflow {
        /// The sample time.
        sample_time_s: f64,
    },
    /// Tustin's substitution sends a pole at 2/T to infinity.
    #[error("there is a pole at 2/T = {pole} rad/s, which Tustin's substitution sends to infinity")]
    PoleAtInfinity {
        /// Where the pole is.
        pole: f64,
    },
    /// The coefficients in powers of z cannot represent the system in working precision.
    #[error(
        "sampled every {sample_time_s} s the poles crowd so closely around z = 1 that coefficients of working precision \
         misstate the frequency response by {error:.1e} of its value at {omega_rad_s:.3} rad/s ({RESPONSE_TOLERANCE:.0e} is allowed); \
         use a longer sample time or the state space form"
    )]
    IllConditioned {
        /// The sample time.
        sample_time_s: f64,
        /// The largest relative error of the response.
        error: f64,
        /// Where it is.
        omega_rad_s: f64,
    },
    /// The way through state space failed.
    #[error(transparent)]
    Conversion(#[from] ConversionError),
    /// A root finder failed.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
    /// The result has coefficients that are not finite.
    #[error(transparent)]
    TransferFunction(#[from] TransferFunctionError),
}

/// The largest relative error of the frequency response that rounding the coefficients of a sampled transfer function
/// may cause.
pub const RESPONSE_TOLERANCE: f64 = 1e-4;

/// The exact samples of a system whose input is held constant between samples:
/// `[Φ Γ; 0 I] = exp([A B; 0 0] T)`, C and D unchanged.
///
/// # Errors
/// [`DiscretiseError::Overflow`].
pub fn zero_order_hold_state_space(
    model: &StateSpace<Continuous>,
    time: Discrete,
) -> Result<StateSpace<Discrete>, DiscretiseError> {
    let overflow = DiscretiseError::Overflow { sample_time_s: time.period_s() };
    let (n, m) = (model.states(), model.inputs());
    let mut augmented = DMatrix::zeros(n + m, n + m);
    augmented.view_mut((0, 0), (n, n)).copy_from(model.a());
    augmented.view_mut((0, n), (n, m)).copy_from(model.b());
    let exponential = matrix_exponential(&(augmented * time.period_s())).ok_or(overflow.clone())?;
    let (a, b) = (exponential.view((0, 0), (n, n)).into_owned(), exponential.view((0, n), (n, m)).into_owned());
    StateSpace::new(a, b, model.c().clone(), model.d().clone(), time).map_err(|_| overflow)
}

/// The zero-order-hold equivalent of a proper transfer function: `G(z) = (1 − z⁻¹) Z{G(s)/s}`, as Zhang 2015, §5.6.1, samples
/// the plant, by [`zero_order_hold_state_space`] of its balanced canonical form.
///
/// # Errors
/// [`DiscretiseError`]; `IllConditioned` where rounding the coefficients in powers of z would misstate the frequency
/// response by more than [`RESPONSE_TOLERANCE`].
pub fn zero_order_hold(
    system: &TransferFunction<Continuous>,
    time: Discrete,
) -> Result<TransferFunction<Discrete>, DiscretiseError> {
    require_proper(system)?;
    let sampled = zero_order_hold_state_space(&conversion::to_state_space(system)?.balanced(), time)?;
    let result = conversion::to_transfer_function(&sampled)?;
    check_response(&result, &sampled)?;
    Ok(result)
}

/// Compares the response over four decades below the Nyquist frequency.
fn check_response(result: &TransferFunction<Discrete>, exact: &StateSpace<Discrete>) -> Result<(), DiscretiseError> {
    let time = result.time();
    let nyquist = std::f64::consts::PI / time.period_s();
    for omega_rad_s in super::bode::log_grid(1e-4 * nyquist, nyquist, 41) {
        let Some(wanted) = exact.response(omega_rad_s) else { continue };
        let wanted = wanted[(0, 0)];
        let error = (result.response(omega_rad_s) - wanted).norm() / wanted.norm();
        // A response of zero has no relative error; a NaN must not pass.
        if wanted.norm() > 0.0 && !(error <= RESPONSE_TOLERANCE) {
            return Err(DiscretiseError::IllConditioned { sample_time_s: time.period_s(), error, omega_rad_s });
        }
    }
    Ok(())
}

/// Tustin's substitution `s = (2/T) (z − 1)/(z + 1)`, without prewarping.
///
/// # Errors
/// [`DiscretiseError`] for an improper system or one with a pole at 2/T.
pub fn tustin(
    system: &TransferFunction<Continuous>,
    time: Discrete,
) -> Result<TransferFunction<Discrete>, DiscretiseError> {
    require_proper(system)?;
    let n = system.den().degree();
    let rate = 2.0 / time.period_s();
    let substitute = |p: &Polynomial| {
        let mut sum = vec![0.0; n + 1];
        for (i, coefficient) in p.coefficients().iter().enumerate() {
            let power = p.degree() - i;
            let term = product(power, &[1.0, -1.0]).mul(&product(n - power, &[1.0, 1.0]));
            for (s, t) in sum.iter_mut().zip(term.coefficients()) {
                *s += coefficient * rate.powi(power as i32) * t;
            }
        }
        sum
    };
    let (num, den) = (substitute(system.num()), substitute(system.den()));
    if den[0] == 0.0 {
        return Err(DiscretiseError::PoleAtInfinity { pole: rate });
    }
    let scaled = |p: Vec<f64>| p.into_iter().map(|c| c / den[0]).collect::<Vec<_>>();
    Ok(TransferFunction::new(&scaled(num), &scaled(den.clone()), time)?)
}

/// A factor to a power.
fn product(power: usize, factor: &[f64]) -> Polynomial {
    let factor = Polynomial::new(factor);
    (0..power).fold(Polynomial::new(vec![1.0]), |p, _| p.mul(&factor))
}

/// Zero-pole matching: every pole p becomes `e^{pT}`, every zero likewise; of the zeros at infinity one stays there (the
/// output answers one sample late) and the others go to z = −1. The gain is that of the continuous system at s = 0, or,
/// with poles or zeros at the origin, that of `s^k G(s)` compared with `((z − 1)/T)^k G(z)`.
///
/// # Errors
/// [`DiscretiseError`] for an improper system, or a root finder that fails.
pub fn matched(
    system: &TransferFunction<Continuous>,
    time: Discrete,
) -> Result<TransferFunction<Discrete>, DiscretiseError> {
    require_proper(system)?;
    let period = time.period_s();
    let one = Complex64::new(1.0, 0.0);
    // Per polynomial: the sampled roots, and the ratio of p(s)/s^k at s = 0 to its sampled counterpart at z = 1.
    let side = |p: &Polynomial| -> Result<(Vec<Complex64>, f64), DiscretiseError> {
        let roots = p.roots()?;
        let mut ratio = p.leading();
        let mut pairs = one;
        for root in &roots {
            if root.norm() > 0.0 {
                pairs *= -root / (one - (root * period).exp());
            } else {
                ratio /= period;
            }
        }
        ratio *= pairs.re;
        Ok((roots.iter().map(|r| (r * period).exp()).collect(), ratio))
    };
    if system.num().is_zero() {
        return Ok(TransferFunction::new(&[0.0], &[1.0], time)?);
    }
    let (mut zeros, mut gain) = side(system.num())?;
    let (poles, den_gain) = side(system.den())?;
    gain /= den_gain;
    for _ in zeros.len() + 1..poles.len() {
        zeros.push(-one);
        gain /= 2.0;
    }
    let num = Polynomial::from_roots(&zeros).scale(gain);
    Ok(TransferFunction::new(num.coefficients(), Polynomial::from_roots(&poles).coefficients(), time)?)
}

fn require_proper(system: &TransferFunction<Continuous>) -> Result<(), DiscretiseError> {
    if system.relative_degree() < 0 {
        return Err(DiscretiseError::Improper { num_degree: system.num().degree(), den_degree: system.den().degree() });
    }
    Ok(())
}
