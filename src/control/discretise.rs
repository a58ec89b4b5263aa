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
        "the transfer function is improper (numerator of degree {num_degree}, denominator of degree {den_degree}); \
         only proper ones can be sampled"
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
        "sampled every {sample_time_s} s the poles crowd so closely around z = 1 that coefficients of working \
         precision misstate the frequency response by {error:.1e} of its value at {omega_rad_s:.3} rad/s \
         ({RESPONSE_TOLERANCE:.0e} is allowed); use a longer sample time or the state space form"
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

/// What a state and its input become over one sample: `x⁺ = Φ x + Γ₀ u + Γ₁ (u⁺ − u)`.
pub(crate) struct Propagation {
    /// Φ = e^{AT}, n×n.
    pub transition: DMatrix<f64>,
    /// Γ₀, n×m: the effect of an input that stays.
    pub held: DMatrix<f64>,
    /// Γ₁, n×m: the effect of an input that goes straight to its next value.
    pub slope: DMatrix<f64>,
}

impl Propagation {
    /// The blocks of `exp([A B 0; 0 0 I/T; 0 0 0] T) = [Φ Γ₀ Γ₁; 0 I I; 0 0 I]`; `None` where it overflows.
    pub(crate) fn new(model: &StateSpace<Continuous>, time: Discrete) -> Option<Self> {
        let (n, m, period) = (model.states(), model.inputs(), time.period_s());
        let mut augmented = DMatrix::zeros(n + 2 * m, n + 2 * m);
        augmented.view_mut((0, 0), (n, n)).copy_from(&(model.a() * period));
        augmented.view_mut((0, n), (n, m)).copy_from(&(model.b() * period));
        augmented.view_mut((n, n + m), (m, m)).fill_with_identity();
        let exponential = matrix_exponential(&augmented)?;
        let block = |column: usize, width: usize| exponential.view((0, column), (n, width)).into_owned();
        Some(Self { transition: block(0, n), held: block(n, m), slope: block(n + m, m) })
    }
}

/// The exact samples of a system whose input is held constant between samples:
/// `x⁺ = Φ x + Γ u` with `[Φ Γ; 0 I] = exp([A B; 0 0] T)`, C and D unchanged.
///
/// # Errors
/// [`DiscretiseError::Overflow`].
pub fn zero_order_hold_state_space(
    model: &StateSpace<Continuous>,
    time: Discrete,
) -> Result<StateSpace<Discrete>, DiscretiseError> {
    let overflow = DiscretiseError::Overflow { sample_time_s: time.period_s() };
    let Propagation { transition, held, .. } = Propagation::new(model, time).ok_or(overflow.clone())?;
    StateSpace::new(transition, held, model.c().clone(), model.d().clone(), time).map_err(|_| overflow)
}

/// The exact samples of a system whose input goes straight from sample to sample: with the state `ξ = x − Γ₁ u`,
/// `ξ⁺ = Φ ξ + (Γ₀ + Φ Γ₁ − Γ₁) u`, `y = C ξ + (D + C Γ₁) u`.
///
/// # Errors
/// [`DiscretiseError::Overflow`].
pub fn first_order_hold_state_space(
    model: &StateSpace<Continuous>,
    time: Discrete,
) -> Result<StateSpace<Discrete>, DiscretiseError> {
    let overflow = DiscretiseError::Overflow { sample_time_s: time.period_s() };
    let Propagation { transition, held, slope } = Propagation::new(model, time).ok_or(overflow.clone())?;
    let b = held + &transition * &slope - &slope;
    let d = model.d() + model.c() * slope;
    StateSpace::new(transition, b, model.c().clone(), d, time).map_err(|_| overflow)
}

/// The zero-order-hold equivalent of a proper transfer function: `G(z) = (1 − z⁻¹) Z{G(s)/s}`, as Zhang 2015, §5.6.1,
/// samples the plant, by [`zero_order_hold_state_space`] of its balanced canonical form.
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
    check_response(&result, |omega| Some(sampled.response(omega)?[(0, 0)]))?;
    Ok(result)
}

/// Compares the response of rounded coefficients with the exact one over four decades below the Nyquist frequency.
fn check_response(
    result: &TransferFunction<Discrete>,
    exact: impl Fn(f64) -> Option<Complex64>,
) -> Result<(), DiscretiseError> {
    let time = result.time();
    let nyquist = std::f64::consts::PI / time.period_s();
    // Just below the Nyquist frequency, where a response may be exactly zero.
    for omega_rad_s in super::bode::log_grid(1e-4 * nyquist, 0.99 * nyquist, 41) {
        let Some(wanted) = exact(omega_rad_s) else { continue };
        let error = (result.response(omega_rad_s) - wanted).norm() / wanted.norm();
        // A response of zero has no relative error; a NaN must not pass.
        let is_close = wanted.norm() == 0.0 || error <= RESPONSE_TOLERANCE;
        if !is_close {
            return Err(DiscretiseError::IllConditioned { sample_time_s: time.period_s(), error, omega_rad_s });
        }
    }
    Ok(())
}

/// Tustin's substitution `s = (2/T) (z − 1)/(z + 1)`, without prewarping.
///
/// # Errors
/// [`DiscretiseError`] for an improper system or one with a pole at 2/T; `IllConditioned` as in [`zero_order_hold`].
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
    let result = TransferFunction::new(&scaled(num), &scaled(den.clone()), time)?;
    // On the unit circle the substitution maps frequencies by the tangent.
    check_response(&result, |omega| Some(system.response(rate * (omega / rate).tan())))?;
    Ok(result)
}

/// A factor to a power.
fn product(power: usize, factor: &[f64]) -> Polynomial {
    let factor = Polynomial::new(factor);
    (0..power).fold(Polynomial::new(vec![1.0]), |p, _| p.mul(&factor))
}

/// Zero-pole matching: every pole p becomes `e^{pT}`, every zero likewise; of the zeros at infinity one stays there
/// (the output answers one sample late) and the others go to z = −1. The gain is that of the continuous system at s =
/// 0, or, with poles or zeros at the origin, that of `s^k G(s)` compared with `((z − 1)/T)^k G(z)`.
///
/// # Errors
/// [`DiscretiseError`] for an improper system, or a root finder that fails; `IllConditioned` as in [`zero_order_hold`].
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
    let result = TransferFunction::new(num.coefficients(), Polynomial::from_roots(&poles).coefficients(), time)?;
    check_response(&result, |omega| {
        let z = Complex64::from_polar(1.0, omega * period);
        let factors = |roots: &[Complex64]| roots.iter().map(|root| z - root).product::<Complex64>();
        Some(gain * factors(&zeros) / factors(&poles))
    })?;
    Ok(result)
}

fn require_proper(system: &TransferFunction<Continuous>) -> Result<(), DiscretiseError> {
    if system.relative_degree() < 0 {
        return Err(DiscretiseError::Improper { num_degree: system.num().degree(), den_degree: system.den().degree() });
    }
    Ok(())
}
