//! The time base of an identification, known at run time, and the region where closed-loop poles may lie.

use crate::control::{Continuous, Discrete, System, TimeBase};
use num_complex::Complex64;

/// Continuous or sampled time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Time {
    /// The variable is the Laplace `s`.
    Continuous,
    /// The variable is the `z` of the z-transform.
    Sampled(Discrete),
}

impl Time {
    /// The time base of a system.
    #[must_use]
    pub fn of(system: &System) -> Self {
        match system {
            System::Continuous(_) => Self::Continuous,
            System::Discrete(tf) => Self::Sampled(tf.time()),
        }
    }

    /// The sample time in seconds; `None` in continuous time.
    #[must_use]
    pub fn sample_time_s(self) -> Option<f64> {
        match self {
            Self::Continuous => None,
            Self::Sampled(time) => Some(time.period_s()),
        }
    }

    /// The point of the complex plane that belongs to an angular frequency.
    #[must_use]
    pub fn point(self, omega_rad_s: f64) -> Complex64 {
        match self {
            Self::Continuous => Continuous.point(omega_rad_s),
            Self::Sampled(time) => time.point(omega_rad_s),
        }
    }

    /// The largest real part of the continuous-time exponents of these poles, in 1/s: the slowest decay rate,
    /// negated. `None` where there is no pole.
    #[must_use]
    pub fn slowest_exponent(self, poles: &[Complex64]) -> Option<f64> {
        let exponent = |pole: &Complex64| match self {
            Self::Continuous => pole.re,
            // A pole at zero is gone after one sample: its exponent is minus infinity.
            Self::Sampled(time) => pole.norm().ln() / time.period_s(),
        };
        poles.iter().map(exponent).reduce(f64::max)
    }
}

/// The half plane `Re λ < −margin` of continuous-time exponents: `Re s < −margin`, or `|z| < e^{−margin T}`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// Time base.
    pub time: Time,
    /// Stability margin in 1/s, not negative.
    pub margin: f64,
}

impl Region {
    /// Substitutes a variable `v` whose open left half plane is this region, and clears denominators:
    /// `P(v − margin)` in continuous time, `(1−v)^degree P(ρ(1+v)/(1−v))` with `ρ = e^{−margin T}` in sampled time.
    ///
    /// Coefficients in descending powers, `degree + 1` of them. In sampled time this is what makes the Routh array
    /// of the result the Jury criterion of P.
    ///
    /// # Panics
    /// If `degree` is below the degree of `P`, which is a mistake of the caller.
    #[must_use]
    pub fn map(self, descending: &[f64], degree: usize) -> Vec<f64> {
        let own = descending.len() - 1;
        assert!(own <= degree, "degree {own} does not fit into {degree}");
        let mut mapped = vec![0.0; degree + 1];
        match self.time {
            Time::Continuous => {
                // Horner's scheme in the polynomial v − margin.
                let mut shifted = vec![0.0];
                for coefficient in descending {
                    shifted = multiply(&shifted, &[1.0, -self.margin]);
                    if let Some(last) = shifted.last_mut() {
                        *last += coefficient;
                    }
                }
                let used = &shifted[shifted.len() - (own + 1)..];
                mapped[degree - own..].copy_from_slice(used);
            }
            Time::Sampled(time) => {
                let rho = (-self.margin * time.period_s()).exp();
                for (i, coefficient) in descending.iter().enumerate() {
                    let power = own - i;
                    let mut term = vec![*coefficient * rho.powi(power as i32)];
                    for _ in 0..power {
                        term = multiply(&term, &[1.0, 1.0]);
                    }
                    for _ in 0..degree - power {
                        term = multiply(&term, &[-1.0, 1.0]);
                    }
                    for (m, t) in mapped.iter_mut().zip(&term) {
                        *m += t;
                    }
                }
            }
        }
        mapped
    }
}

/// The product of two polynomials, same order of powers, leading zeros kept.
#[must_use]
pub(crate) fn multiply(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; a.len() + b.len() - 1];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            product[i + j] += x * y;
        }
    }
    product
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::Polynomial;

    #[test]
    fn the_continuous_map_shifts_roots() {
        let region = Region { time: Time::Continuous, margin: 0.5 };
        // (s + 1)(s + 2) becomes (v + 0.5)(v + 1.5), here with a leading zero.
        assert_eq!(region.map(&[1.0, 3.0, 2.0], 3), [0.0, 1.0, 2.0, 0.75]);
    }

    #[test]
    fn the_sampled_map_takes_the_disc_to_the_left_half_plane() {
        let time = Time::Sampled(Discrete::new(0.1).unwrap());
        let region = Region { time, margin: 1.0 };
        let rho = (-0.1_f64).exp();
        for root in [0.0, 0.5, 0.9, 0.95, -0.89, -0.95, 1.2] {
            let mapped = region.map(&[1.0, -root], 1);
            let v = Polynomial::new(mapped).roots().unwrap()[0].re;
            assert_eq!(v < 0.0, root.abs() < rho, "{root} went to {v}");
            assert!((rho * (1.0 + v) / (1.0 - v) - root).abs() < 1e-14);
        }
    }

    #[test]
    fn homogenising_adds_a_zero_at_one() {
        let time = Time::Sampled(Discrete::new(0.1).unwrap());
        let region = Region { time, margin: 0.0 };
        let with = region.map(&[1.0, -0.5], 2);
        let without = region.map(&[1.0, -0.5], 1);
        assert_eq!(with, multiply(&without, &[-1.0, 1.0]));
    }
}
