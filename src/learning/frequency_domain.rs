//! How far identified controllers are from the inverse dynamics (Zhang 2015, sections 3.6 and 5.7).

use super::quadrature::{NoIntegral, Sample, mean};
use crate::control::double_double::DoubleDouble;
use crate::control::{System, TimeBase as _};
use crate::num::Polynomial;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Sample times that differ by less than this share are the same.
const SAME_SAMPLE_TIME: f64 = 1e-9;

/// Band averages of moduli, `‖X‖ = 1/(ω₂ − ω₁) ∫_{ω₁}^{ω₂} |X(jω)| dω` (sampled: `X(e^{jωT})`).
///
/// Zhang 2015, section 3.6 (first two) and section 5.7 (first and third). Computed by adaptive 7/15-point Gauss–Kronrod
/// quadrature until the estimated error is below 1e-9 of the value, from responses evaluated in double-double
/// precision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ControllerMetrics {
    /// ‖Gfb‖, in units of u per unit of error; null where it is infinite.
    pub norm_feedback: Option<f64>,
    /// ‖Gff − G⁻¹‖, in units of u per unit of y; null where it is infinite (a zero of the plant in the band).
    pub norm_feedforward_minus_inverse: Option<f64>,
    /// ‖Gff G − 1‖, without unit; null where it is infinite (a pole of the plant in the band, such as 1/s at zero).
    pub norm_feedforward_plant_minus_one: Option<f64>,
    /// The band [ω₁, ω₂] in rad/s.
    pub band_rad_s: [f64; 2],
    /// For each of the norms that is null: which, and why.
    #[serde(default)]
    pub undefined: Vec<UndefinedNorm>,
}

/// A norm that has no finite value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UndefinedNorm {
    /// The name of the field that is null.
    pub field: String,
    /// Why, with the frequency.
    pub reason: String,
}

/// Why no norm can be computed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum MetricsError {
    /// The band is empty, reversed, negative or not finite.
    #[error("the band [{from}, {to}] rad/s must satisfy 0 <= from < to and be finite")]
    BadBand {
        /// Lower end in rad/s.
        from: f64,
        /// Upper end in rad/s.
        to: f64,
    },
    /// Plant and controllers do not share a time base.
    #[error(
        "the {part} has sample time {found:?} s and the plant {expected:?} s (None: continuous); \
         bring them to one time base first"
    )]
    MixedTimeBases {
        /// `feedforward` or `feedback`.
        part: &'static str,
        /// Its sample time in seconds.
        found: Option<f64>,
        /// The plant's sample time in seconds.
        expected: Option<f64>,
    },
    /// The band passes the Nyquist frequency, where responses of sampled systems repeat.
    #[error("the band ends at {to} rad/s, above the Nyquist frequency {nyquist} rad/s")]
    AboveNyquist {
        /// Upper end in rad/s.
        to: f64,
        /// π over the sample time.
        nyquist: f64,
    },
}

/// The distances of identified controllers from the plant's inverse dynamics over a band.
///
/// The three systems must share their time base (a continuous plant with sampled controllers is discretised by the
/// caller, who knows how). A norm that is infinite is null, with the reason.
///
/// # Errors
/// [`MetricsError`] for a band or time bases that make no sense.
pub fn controller_metrics(
    plant: &System,
    feedforward: &System,
    feedback: &System,
    band_rad_s: (f64, f64),
) -> Result<ControllerMetrics, MetricsError> {
    controller_metrics_delayed(plant, 0.0, feedforward, feedback, band_rad_s)
}

/// [`controller_metrics`] on the plant with a delay behind it, `G e^{−jω delay_s}`.
///
/// # Errors
/// [`MetricsError`].
pub fn controller_metrics_delayed(
    plant: &System,
    delay_s: f64,
    feedforward: &System,
    feedback: &System,
    band_rad_s: (f64, f64),
) -> Result<ControllerMetrics, MetricsError> {
    let expected = plant.sample_time_s();
    for (part, system) in [("feedforward", feedforward), ("feedback", feedback)] {
        let found = system.sample_time_s();
        let same = match (expected, found) {
            (None, None) => true,
            (Some(a), Some(b)) => (a - b).abs() <= SAME_SAMPLE_TIME * a,
            _ => false,
        };
        if !same {
            return Err(MetricsError::MixedTimeBases { part, found, expected });
        }
    }
    if let Some(period) = expected {
        let nyquist = std::f64::consts::PI / period;
        // A band that ends at the Nyquist frequency may pass it by rounding.
        if band_rad_s.1 > nyquist * (1.0 + SAME_SAMPLE_TIME) {
            return Err(MetricsError::AboveNyquist { to: band_rad_s.1, nyquist });
        }
    }
    controller_metrics_of(
        |omega| {
            let (num, den) = fraction(plant, omega);
            (num * Complex64::from_polar(1.0, -omega * delay_s), den)
        },
        |omega| quotient(fraction(feedforward, omega)),
        |omega| quotient(fraction(feedback, omega)),
        band_rad_s,
    )
}

/// ‖Gfb‖ alone, as [`controller_metrics`] computes it; `None` where it is infinite.
#[must_use]
pub fn norm_feedback(feedback: &System, [from, to]: [f64; 2]) -> Option<f64> {
    mean(|omega| feedback_modulus(quotient(fraction(feedback, omega))), from, to).ok()
}

/// ‖Gff G − 1‖ alone, as [`controller_metrics`] computes it; `None` where it is infinite.
#[must_use]
pub fn norm_feedforward_plant_minus_one(plant: &System, feedforward: &System, [from, to]: [f64; 2]) -> Option<f64> {
    mean(|omega| distance_modulus(fraction(plant, omega), quotient(fraction(feedforward, omega))), from, to).ok()
}

/// [`controller_metrics`] of responses given as functions of ω in rad/s; the plant as numerator and denominator, so
/// that its inverse exists at its poles.
///
/// # Errors
/// [`MetricsError::BadBand`].
pub fn controller_metrics_of(
    plant: impl Fn(f64) -> (Complex64, Complex64),
    feedforward: impl Fn(f64) -> Complex64,
    feedback: impl Fn(f64) -> Complex64,
    band_rad_s: (f64, f64),
) -> Result<ControllerMetrics, MetricsError> {
    let (from, to) = band_rad_s;
    if !(from >= 0.0 && from < to && to.is_finite()) {
        return Err(MetricsError::BadBand { from, to });
    }
    let mut undefined = Vec::new();
    let mut note = |field: &str, value: Result<f64, NoIntegral>| match value {
        Ok(value) => Some(value),
        Err(why) => {
            let reason = match why {
                NoIntegral::Singular(at) => format!("it grows without bound near {at:.6} rad/s, inside the band"),
                NoIntegral::NotConverged(error) => {
                    format!("the quadrature did not converge; estimated relative error {error:.1e}")
                }
            };
            undefined.push(UndefinedNorm { field: field.to_owned(), reason });
            None
        }
    };
    let norm_feedback = note("norm_feedback", mean(|w| feedback_modulus(feedback(w)), from, to));
    let norm_feedforward_minus_inverse = note(
        "norm_feedforward_minus_inverse",
        mean(
            |w| {
                let (num, den) = plant(w);
                let inverse = den / num;
                modulus(feedforward(w) - inverse, inverse.norm())
            },
            from,
            to,
        ),
    );
    let norm_feedforward_plant_minus_one =
        note("norm_feedforward_plant_minus_one", mean(|w| distance_modulus(plant(w), feedforward(w)), from, to));
    Ok(ControllerMetrics {
        norm_feedback,
        norm_feedforward_minus_inverse,
        norm_feedforward_plant_minus_one,
        band_rad_s: [from, to],
        undefined,
    })
}

fn modulus(value: Complex64, subtracted: f64) -> Sample {
    let value = value.norm();
    Sample { value, terms: value + subtracted }
}

fn feedback_modulus(feedback: Complex64) -> Sample {
    modulus(feedback, 0.0)
}

fn distance_modulus((num, den): (Complex64, Complex64), feedforward: Complex64) -> Sample {
    modulus(feedforward * num / den - 1.0, 1.0)
}

fn quotient((num, den): (Complex64, Complex64)) -> Complex64 {
    num / den
}

/// Numerator and denominator at the angular frequency `omega`.
///
/// Evaluated in double-double precision: the FIR feedforward that inverts a plant sampled at 50 Hz has coefficients of
/// 10⁸ that cancel to 1 at the frequencies of interest, and plain Horner would leave noise of 10⁻⁸ in which no
/// quadrature converges.
pub(super) fn fraction(system: &System, omega: f64) -> (Complex64, Complex64) {
    let x = match system {
        System::Continuous(g) => g.time().point(omega),
        System::Discrete(g) => g.time().point(omega),
    };
    (evaluate(system.num(), x), evaluate(system.den(), x))
}

/// The value of a polynomial by Horner's rule in double-double precision.
fn evaluate(polynomial: &Polynomial, x: Complex64) -> Complex64 {
    let (mut re, mut im) = (DoubleDouble::default(), DoubleDouble::default());
    for c in polynomial.coefficients() {
        let product_re = re.mul(x.re).sub(im.mul(x.im));
        im = re.mul(x.im).add(im.mul(x.re));
        re = product_re.add((*c).into());
    }
    Complex64::new(re.value(), im.value())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cancelling_coefficients_keep_their_value() {
        // (x − 1)⁶ · 10⁸ expanded, near x = 1: each of its terms is 10⁹, their sum 10⁻⁴.
        let binomial = [1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0].map(|c| c * 1e8);
        let x = Complex64::from_polar(1.0, 0.01);
        let exact = 1e8 * (x - 1.0).powi(6);
        let value = evaluate(&Polynomial::new(binomial), x);
        assert!((value / exact - 1.0).norm() < 1e-9, "{value} {exact}");
        let plain = Polynomial::new(binomial).eval(x);
        assert!((plain / exact - 1.0).norm() > 1e-6, "the case no longer shows what it is for: {plain}");
    }

    #[test]
    fn ordinary_values_are_those_of_the_plain_rule() {
        let p = Polynomial::new(vec![1.0, 3.6, 4.0]);
        let x = Complex64::new(0.3, 1.7);
        assert!((evaluate(&p, x) - p.eval(x)).norm() < 1e-14);
    }
}
