//! Between transfer functions and state space models (single input, single output).

use super::state_space::{StateSpace, StateSpaceError};
use super::time_base::TimeBase;
use super::transfer_function::{TransferFunction, TransferFunctionError};
use crate::num::Polynomial;
use crate::num::linalg::{self, NoConvergence};
use nalgebra::DMatrix;
use num_complex::Complex64;

/// The largest mismatch between a state space model and its transfer function that is let through, relative to the
/// largest gain on the circle of the complex plane on which they are compared.
pub(crate) const CONVERSION_TOLERANCE: f64 = 1e-8;

/// Why a system has no form of the other kind.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConversionError {
    /// More zeros than poles: no state space model has such a transfer function.
    #[error(
        "the transfer function is improper (numerator of degree {num_degree}, denominator of degree {den_degree}), \
         so it has no state space form"
    )]
    Improper {
        /// Degree of the numerator.
        num_degree: usize,
        /// Degree of the denominator.
        den_degree: usize,
    },
    /// Not single-input single-output.
    #[error("the model has {inputs} inputs and {outputs} outputs; a transfer function here has one of each")]
    NotSingle {
        /// Number of inputs.
        inputs: usize,
        /// Number of outputs.
        outputs: usize,
    },
    /// No polynomial pair of working precision represents the model well enough.
    #[error(
        "the state space model is too badly conditioned for a transfer function: the two differ by {mismatch:.1e} \
         of the largest gain, and {CONVERSION_TOLERANCE:.0e} is allowed; rescale its time unit or its states"
    )]
    IllConditioned {
        /// The smallest mismatch reached.
        mismatch: f64,
    },
    /// The eigenvalue iteration failed.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
    /// The result has entries that are not finite.
    #[error("the conversion overflows: {0}")]
    Overflow(String),
}

impl From<StateSpaceError> for ConversionError {
    fn from(error: StateSpaceError) -> Self {
        Self::Overflow(error.to_string())
    }
}

impl From<TransferFunctionError> for ConversionError {
    fn from(error: TransferFunctionError) -> Self {
        Self::Overflow(error.to_string())
    }
}

/// The controllable canonical form of a proper transfer function.
///
/// With the denominator made monic, `xⁿ + a₁ xⁿ⁻¹ + … + aₙ`, A has `−a₁ … −aₙ` in its first row and ones below its
/// diagonal, B is the first unit vector, and D is the ratio of the leading coefficients (0 when strictly proper).
///
/// # Errors
/// [`ConversionError::Improper`], or [`ConversionError::Overflow`] where a coefficient overflows.
pub fn to_state_space<T: TimeBase>(system: &TransferFunction<T>) -> Result<StateSpace<T>, ConversionError> {
    let (num, den) = (system.num(), system.den());
    let n = den.degree();
    if num.degree() > n {
        return Err(ConversionError::Improper { num_degree: num.degree(), den_degree: n });
    }
    let monic: Vec<f64> = den.coefficients().iter().map(|c| c / den.leading()).collect();
    let mut padded = vec![0.0; n - num.degree()];
    padded.extend(num.coefficients().iter().map(|c| c / den.leading()));
    let feedthrough = padded[0];
    let a = DMatrix::from_fn(n, n, |i, j| match (i, j) {
        (0, j) => -monic[j + 1],
        (i, j) if i == j + 1 => 1.0,
        _ => 0.0,
    });
    let b = DMatrix::from_fn(n, 1, |i, _| if i == 0 { 1.0 } else { 0.0 });
    let c = DMatrix::from_fn(1, n, |_, j| padded[j + 1] - feedthrough * monic[j + 1]);
    let d = DMatrix::from_element(1, 1, feedthrough);
    Ok(StateSpace::new(a, b, c, d, system.time())?)
}

/// The transfer function `c (xI − A)⁻¹ b + d` of a single-input single-output state space model.
///
/// The denominator is `det(xI − A)`, from the eigenvalues of A; it keeps all n of them, hidden ones included. With ρ
/// the relative degree and `g = c A^{ρ−1} b` (or `d`) the first Markov parameter that is not zero, the numerator is `g`
/// times the leading n − ρ + 1 coefficients of `det(xI − A + b c A^ρ / g)`, whose eigenvalues are the zeros and ρ times
/// the origin. Where `g` is too small for that, `det(xI − A + b c) + (d − 1) det(xI − A)` is taken. Whichever agrees
/// better with direct evaluation on three circles of the complex plane is returned, provided that it does so within
/// [`CONVERSION_TOLERANCE`].
///
/// # Errors
/// [`ConversionError`] for a model with several inputs or outputs, or one that is too badly conditioned.
pub fn to_transfer_function<T: TimeBase>(model: &StateSpace<T>) -> Result<TransferFunction<T>, ConversionError> {
    if (model.inputs(), model.outputs()) != (1, 1) {
        return Err(ConversionError::NotSingle { inputs: model.inputs(), outputs: model.outputs() });
    }
    let feedthrough = model.d()[(0, 0)];
    if model.states() == 0 {
        return Ok(TransferFunction::new(&[feedthrough], &[1.0], model.time())?);
    }
    let scaled = model.balanced();
    let poles = scaled.poles()?;
    let den = Polynomial::from_roots(&poles);
    let probes = Probes::new(&scaled, &poles);

    let mut best: Option<(f64, TransferFunction<T>)> = None;
    for num in [numerator_from_zeros(&scaled)?, numerator_from_determinants(&scaled, &den)?] {
        let Ok(candidate) = TransferFunction::new(&num, den.coefficients(), model.time()) else { continue };
        let mismatch = probes.mismatch(&candidate);
        if mismatch.is_finite() && best.as_ref().is_none_or(|(least, _)| mismatch < *least) {
            best = Some((mismatch, candidate));
        }
    }
    match best {
        Some((mismatch, candidate)) if mismatch <= CONVERSION_TOLERANCE => Ok(candidate),
        Some((mismatch, _)) => Err(ConversionError::IllConditioned { mismatch }),
        None => Err(ConversionError::Overflow("a coefficient is not finite".into())),
    }
}

/// `g` times the leading coefficients of `det(xI − A + b c A^ρ / g)`; see [`to_transfer_function`].
fn numerator_from_zeros<T: TimeBase>(model: &StateSpace<T>) -> Result<Vec<f64>, ConversionError> {
    let n = model.states();
    let (a, b) = (model.a(), model.b());
    let mut row = model.c().clone();
    let mut row_bound = row.abs();
    let mut gain = model.d()[(0, 0)];
    let mut relative_degree = 0;
    // A Markov parameter counts as zero when it is no larger than the rounding of its own sum, |c| |A|^k |b|.
    let mut rounding = 0.0;
    while gain.abs() <= rounding {
        relative_degree += 1;
        if relative_degree > n {
            return Ok(vec![0.0]);
        }
        gain = (&row * b)[(0, 0)];
        rounding = f64::EPSILON * (n * relative_degree) as f64 * (&row_bound * b.abs())[(0, 0)];
        row = &row * a;
        row_bound = &row_bound * a.abs();
    }
    if relative_degree == 0 {
        // The first row beyond the gain is c itself: u = (y - c x) / d.
        row = model.c().clone();
    }
    let inverse_dynamics = a - b * &row / gain;
    let roots = linalg::eigenvalues(&inverse_dynamics)?;
    let characteristic = Polynomial::from_roots(&roots);
    Ok(characteristic.coefficients()[..=n - relative_degree].iter().map(|c| gain * c).collect())
}

/// `det(xI − A + b c) + (d − 1) det(xI − A)`.
fn numerator_from_determinants<T: TimeBase>(
    model: &StateSpace<T>,
    den: &Polynomial,
) -> Result<Vec<f64>, ConversionError> {
    let closed = Polynomial::from_roots(&linalg::eigenvalues(&(model.a() - model.b() * model.c()))?);
    let num = closed.add(&den.scale(model.d()[(0, 0)] - 1.0));
    Ok(num.coefficients().to_vec())
}

/// Points of the complex plane with the value of the state space model there.
struct Probes(Vec<Vec<(Complex64, Complex64)>>);

impl Probes {
    fn new<T: TimeBase>(model: &StateSpace<T>, poles: &[Complex64]) -> Self {
        const ANGLES: usize = 7;
        let largest = poles.iter().map(|p| p.norm()).fold(0.0, f64::max);
        let scale = if largest > 0.0 { largest } else { 1.0 };
        let circles = [0.3, 1.1, 4.0].map(|radius| {
            (0..ANGLES)
                .filter_map(|k| {
                    let x = Complex64::from_polar(radius * scale, 0.2 + 2.9 * k as f64 / ANGLES as f64);
                    Some((x, model.eval(x)?[(0, 0)]))
                })
                .collect()
        });
        Self(circles.to_vec())
    }

    fn mismatch<T: TimeBase>(&self, candidate: &TransferFunction<T>) -> f64 {
        let circle = |points: &Vec<(Complex64, Complex64)>| {
            let largest = points.iter().map(|(_, value)| value.norm()).fold(0.0, f64::max);
            let error = points.iter().map(|(x, value)| (candidate.eval(*x) - value).norm()).fold(0.0, f64::max);
            if error == 0.0 { 0.0 } else { error / largest }
        };
        self.0.iter().map(circle).fold(0.0, f64::max)
    }
}
