//! The compensator itself: a gain and sections in series.

use crate::control::discretise::DiscretiseError;
use crate::control::{Discrete, TransferFunction};
use crate::excite::path::PathError;
use crate::num::Polynomial;
use std::f64::consts::PI;

/// A section of a compensator, of gain 1 at infinite frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Section {
    /// `(s + 2πf_z)/(s + 2πf_p)`: a lead where f_z < f_p, a lag where f_z > f_p.
    First {
        /// f_z, Hz.
        zero_hz: f64,
        /// f_p, Hz.
        pole_hz: f64,
    },
    /// `(s² + 2ζ_z ω_z s + ω_z²)/(s² + 2ζ_p ω_p s + ω_p²)` with ω = 2πf: zeros and poles may be complex.
    Second {
        /// f_z, Hz: natural frequency of the zeros.
        zero_hz: f64,
        /// ζ_z.
        zero_damping: f64,
        /// f_p, Hz: natural frequency of the poles.
        pole_hz: f64,
        /// ζ_p.
        pole_damping: f64,
    },
}

/// `C(s) = K Π sections`, taken to sampled time by Tustin's substitution (Qiu 2021, before equation 17).
#[derive(Debug, Clone, PartialEq)]
pub struct Compensator {
    /// K, in force per position: the gain at high frequency.
    pub gain: f64,
    /// The sections; none of proportional control. A section whose zeros are its poles is 1, and is left out of what
    /// is computed.
    pub sections: Vec<Section>,
}

/// A section in z: numerator and denominator in descending powers, the latter monic.
pub(super) type SampledSection = ([f64; 3], [f64; 3], usize);

impl Section {
    /// Whether it is 1 at every frequency.
    #[must_use]
    pub fn is_one(&self) -> bool {
        match *self {
            Self::First { zero_hz, pole_hz } => zero_hz == pole_hz,
            Self::Second { zero_hz, zero_damping, pole_hz, pole_damping } => {
                zero_hz == pole_hz && zero_damping == pole_damping
            }
        }
    }

    /// Its numerator, denominator and degree in z.
    pub(super) fn sampled(&self, time: Discrete) -> SampledSection {
        let k = 2.0 / time.period_s();
        match *self {
            Self::First { zero_hz, pole_hz } => {
                let (z, p) = (2.0 * PI * zero_hz, 2.0 * PI * pole_hz);
                let scale = (k + p).recip();
                ([scale * (k + z), scale * (z - k), 0.0], [1.0, scale * (p - k), 0.0], 1)
            }
            Self::Second { zero_hz, zero_damping, pole_hz, pole_damping } => {
                let substituted = |hz: f64, damping: f64| {
                    let w = 2.0 * PI * hz;
                    let (square, middle) = (k * k + w * w, 2.0 * damping * w * k);
                    [square + middle, 2.0 * (w * w - k * k), square - middle]
                };
                let (num, den) = (substituted(zero_hz, zero_damping), substituted(pole_hz, pole_damping));
                (num.map(|c| c / den[0]), [1.0, den[1] / den[0], den[2] / den[0]], 2)
            }
        }
    }
}

impl Compensator {
    /// Proportional control.
    #[must_use]
    pub fn proportional(gain: f64) -> Self {
        Self { gain, sections: Vec::new() }
    }

    /// A lead, or a lag, of first order.
    #[must_use]
    pub fn lead(gain: f64, zero_hz: f64, pole_hz: f64) -> Self {
        Self { gain, sections: vec![Section::First { zero_hz, pole_hz }] }
    }

    /// The sections that do something.
    pub fn active(&self) -> impl Iterator<Item = &Section> {
        self.sections.iter().filter(|section| !section.is_one())
    }

    /// Numerator and denominator in z; constants for proportional control.
    pub(super) fn coefficients(&self, time: Discrete) -> (Polynomial, Polynomial) {
        let (mut num, mut den) = (Polynomial::new(vec![self.gain]), Polynomial::new(vec![1.0]));
        for section in self.active() {
            let (b, a, degree) = section.sampled(time);
            num = num.mul(&Polynomial::new(&b[..=degree]));
            den = den.mul(&Polynomial::new(&a[..=degree]));
        }
        (num, den)
    }

    /// The controller in sampled time.
    ///
    /// # Errors
    /// [`PathError`] for coefficients that are not finite.
    pub fn sampled(&self, time: Discrete) -> Result<TransferFunction<Discrete>, PathError> {
        let (num, den) = self.coefficients(time);
        TransferFunction::new(num.coefficients(), den.coefficients(), time)
            .map_err(|error| PathError::Discretise(DiscretiseError::from(error)))
    }
}
