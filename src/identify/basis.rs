//! The feedforward numerator on the frequency axis: a real and an imaginary part that decouple.
//!
//! On the axis a numerator of degree n is `N = e^{jnθ/2} (E + j O)`, without the rotation in continuous time, where the
//! real functions E and O are
//!
//! | | variable y | E | O |
//! |---|---|---|---|
//! | continuous | ω² | polynomial in y | ω · polynomial in y |
//! | sampled, n even | 1 − cos θ | polynomial in y | sin θ · polynomial in y |
//! | sampled, n odd | 1 − cos θ | cos θ/2 · polynomial in y | sin θ/2 · polynomial in y |
//!
//! with θ = ωT. So a least-squares problem for N splits into two of about half the size. Both polynomials are written
//! in bases that are orthonormal over the lines: powers of z⁻¹ on a short arc near z = 1 are equal to working
//! precision, and their normal equations worthless.

use super::time::{Time, multiply};

/// A numerator of fixed degree on fixed lines.
#[derive(Debug, Clone, PartialEq)]
pub struct Basis {
    time: Time,
    degree: usize,
    /// What the numerator stands behind, in seconds.
    delay_s: f64,
    /// `t = (y − centre) / half`, inside [−1, 1].
    centre: f64,
    half: f64,
    even: Part,
    odd: Part,
}

/// One of the two parts.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Part {
    /// Value of each basis function at each line.
    pub values: Vec<Vec<f64>>,
    polynomials: Vec<Vec<f64>>,
}

/// What the polynomials of a part are multiplied with: see the table above.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Factor {
    /// 1.
    One,
    /// ω.
    Omega,
    /// The cosine of this multiple of θ.
    Cosine(f64),
    /// The sine of this multiple of θ.
    Sine(f64),
}

/// The lines do not determine a numerator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "{lines} frequency lines do not determine the {needed} coefficients of the {part} part of the feedforward numerator"
)]
pub struct TooFewLines {
    /// `real` or `imaginary`.
    pub part: &'static str,
    /// Coefficients of that part.
    pub needed: usize,
    /// Lines at which that part does not vanish.
    pub lines: usize,
}

/// A basis function that keeps less than this share of itself beside the others is not determined by the lines.
const INDEPENDENT: f64 = 1e-9;

impl Part {
    fn new(name: &'static str, size: usize, factor: &[f64], t: &[f64]) -> Result<Self, TooFewLines> {
        let lines = factor.iter().filter(|f| **f != 0.0).count();
        let fail = TooFewLines { part: name, needed: size, lines };
        if lines < size {
            return Err(fail);
        }
        let mut part = Self::default();
        for i in 0..size {
            // Arnoldi: the next function is t times the last one, made orthogonal to all, twice.
            let (mut values, mut polynomial) = match (part.values.last(), part.polynomials.last()) {
                (Some(last), Some(p)) => {
                    let values: Vec<f64> = last.iter().zip(t).map(|(v, t)| v * t).collect();
                    (values, [&[0.0], p.as_slice()].concat())
                }
                _ => (factor.to_vec(), vec![1.0]),
            };
            let before = norm(&values);
            for _ in 0..2 {
                for j in 0..i {
                    let share: f64 = part.values[j].iter().zip(&values).map(|(a, b)| a * b).sum();
                    values.iter_mut().zip(&part.values[j]).for_each(|(v, b)| *v -= share * b);
                    polynomial.iter_mut().zip(&part.polynomials[j]).for_each(|(c, b)| *c -= share * b);
                }
            }
            let after = norm(&values);
            // Written so that NaN fails too.
            let is_independent = after > INDEPENDENT * before;
            if !is_independent {
                return Err(fail);
            }
            values.iter_mut().for_each(|v| *v /= after);
            polynomial.iter_mut().for_each(|c| *c /= after);
            part.values.push(values);
            part.polynomials.push(polynomial);
        }
        Ok(part)
    }

    /// Each basis function's polynomial in t, ascending powers.
    pub(crate) fn polynomials(&self) -> &[Vec<f64>] {
        &self.polynomials
    }

    /// The number of basis functions.
    #[must_use]
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Ascending powers of y of the combination with these coefficients.
    fn combine(&self, coefficients: &[f64], centre: f64, half: f64) -> Vec<f64> {
        let mut in_t = vec![0.0; self.len()];
        for (c, polynomial) in coefficients.iter().zip(&self.polynomials) {
            in_t.iter_mut().zip(polynomial).for_each(|(sum, p)| *sum += c * p);
        }
        // Horner's scheme in t = y/half − centre/half.
        let mut in_y = Vec::new();
        for c in in_t.iter().rev() {
            in_y = if in_y.is_empty() { vec![0.0] } else { multiply(&in_y, &[-centre / half, 1.0 / half]) };
            in_y[0] += c;
        }
        in_y
    }
}

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

impl Basis {
    /// For a numerator of this degree on these lines (rad/s).
    ///
    /// # Errors
    /// [`TooFewLines`] where the lines do not determine it.
    pub fn new(time: Time, degree: usize, omega_rad_s: &[f64]) -> Result<Self, TooFewLines> {
        let odd_size = match time {
            Time::Continuous => degree.div_ceil(2),
            Time::Sampled(_) => degree - degree / 2,
        };
        // With an odd degree in sampled time both parts have the same size.
        let even_size = degree + 1 - odd_size;
        let y: Vec<f64> = omega_rad_s
            .iter()
            .map(|w| match time {
                Time::Continuous => w * w,
                Time::Sampled(t) => 2.0 * (0.5 * w * t.period_s()).sin().powi(2),
            })
            .collect();
        let low = y.iter().copied().fold(f64::INFINITY, f64::min);
        let high = y.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let (centre, half) = (0.5 * (low + high), if high > low { 0.5 * (high - low) } else { 1.0 });
        let t: Vec<f64> = y.iter().map(|y| (y - centre) / half).collect();
        let factors = |omega: &f64| match time {
            Time::Continuous => (1.0, *omega),
            Time::Sampled(time) => {
                let theta = omega * time.period_s();
                if degree.is_multiple_of(2) { (1.0, theta.sin()) } else { ((0.5 * theta).cos(), (0.5 * theta).sin()) }
            }
        };
        let (even_factor, odd_factor): (Vec<f64>, Vec<f64>) = omega_rad_s.iter().map(factors).unzip();
        Ok(Self {
            time,
            degree,
            delay_s: 0.0,
            centre,
            half,
            even: Part::new("real", even_size, &even_factor, &t)?,
            odd: Part::new("imaginary", odd_size, &odd_factor, &t)?,
        })
    }

    /// For no numerator at all: both parts are empty, and the numerator is 0.
    #[must_use]
    pub fn none(time: Time) -> Self {
        let (even, odd) = (Part::default(), Part::default());
        Self { time, degree: 0, delay_s: 0.0, centre: 0.0, half: 1.0, even, odd }
    }

    /// Whether there is no numerator.
    #[must_use]
    pub fn is_none(&self) -> bool {
        self.even.is_empty() && self.odd.is_empty()
    }

    /// The real part, E.
    #[must_use]
    pub fn even(&self) -> &Part {
        &self.even
    }

    /// The imaginary part, O.
    #[must_use]
    pub fn odd(&self) -> &Part {
        &self.odd
    }

    /// The factor of each part.
    pub(crate) fn factors(&self) -> [Factor; 2] {
        match self.time {
            Time::Continuous => [Factor::One, Factor::Omega],
            Time::Sampled(_) if self.degree.is_multiple_of(2) => [Factor::One, Factor::Sine(1.0)],
            Time::Sampled(_) => [Factor::Cosine(0.5), Factor::Sine(0.5)],
        }
    }

    /// Centre and half width of t in y.
    pub(crate) fn scale(&self) -> [f64; 2] {
        [self.centre, self.half]
    }

    /// The time whose angle ωt the numerator is turned back by before it splits: nT/2, or 0 in continuous time.
    pub(crate) fn turning_s(&self) -> f64 {
        match self.time {
            Time::Continuous => -self.delay_s,
            Time::Sampled(t) => 0.5 * self.degree as f64 * t.period_s() - self.delay_s,
        }
    }

    /// The same numerator behind a delay (a lead, where negative): it is `N e^{−jω delay}` that splits, and N whose
    /// coefficients are given.
    #[must_use]
    pub fn behind(self, delay_s: f64) -> Self {
        Self { delay_s, ..self }
    }

    /// The angle by which the numerator with its delay is turned at a line before it splits: `−nθ/2` (0 in continuous
    /// time), and the delay undone.
    #[must_use]
    pub fn rotation(&self, omega_rad_s: f64) -> f64 {
        let own = match self.time {
            Time::Continuous => 0.0,
            Time::Sampled(t) => -0.5 * self.degree as f64 * omega_rad_s * t.period_s(),
        };
        own + omega_rad_s * self.delay_s
    }

    /// The numerator's coefficients in descending powers, from those of the two bases.
    #[must_use]
    pub fn numerator(&self, even: &[f64], odd: &[f64]) -> Vec<f64> {
        let n = self.degree;
        let mut numerator = vec![0.0; n + 1];
        let mut add = |term: &[f64], factor: f64, power: usize| {
            // `term · x^power`, descending.
            let offset = n + 1 - term.len() - power;
            for (i, c) in term.iter().enumerate() {
                numerator[offset + i] += factor * c;
            }
        };
        let even = self.even.combine(even, self.centre, self.half);
        let odd = self.odd.combine(odd, self.centre, self.half);
        match self.time {
            Time::Continuous => {
                // ω^{2m} = (−1)^m s^{2m} and jω = s.
                for (m, c) in even.iter().enumerate() {
                    add(&[1.0], if m % 2 == 0 { *c } else { -c }, 2 * m);
                }
                for (m, c) in odd.iter().enumerate() {
                    add(&[1.0], if m % 2 == 0 { *c } else { -c }, 2 * m + 1);
                }
            }
            Time::Sampled(_) => {
                // y = −(z − 1)²/(2z); cos θ/2 = (z + 1)/(2√z), j sin θ/2 = (z − 1)/(2√z), j sin θ = (z² − 1)/(2z).
                let (even_factor, odd_factor): (&[f64], &[f64]) =
                    if n.is_multiple_of(2) { (&[1.0], &[0.5, 0.0, -0.5]) } else { (&[0.5, 0.5], &[0.5, -0.5]) };
                for (coefficients, factor) in [(even, even_factor), (odd, odd_factor)] {
                    let mut term = factor.to_vec();
                    for c in coefficients {
                        // The term has degree 2m + deg(factor), and n minus that is twice the power of z that is left.
                        add(&term, c, (n + 1 - term.len()) / 2);
                        term = multiply(&term, &[-0.5, 1.0, -0.5]);
                    }
                }
            }
        }
        numerator
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Discrete;
    use crate::num::Polynomial;
    use num_complex::Complex64;

    #[test]
    fn the_coefficients_reproduce_the_parts_at_the_lines() {
        let omega: Vec<f64> = (0..16).map(|k| 0.1 + 0.4 * f64::from(k)).collect();
        for time in [Time::Continuous, Time::Sampled(Discrete::new(0.3).unwrap())] {
            for degree in 0..=9 {
                let basis = Basis::new(time, degree, &omega).unwrap();
                assert_eq!(basis.even().len() + basis.odd().len(), degree + 1);
                let even: Vec<f64> = (0..basis.even().len()).map(|i| 1.0 - 0.3 * i as f64).collect();
                let odd: Vec<f64> = (0..basis.odd().len()).map(|i| 0.5 + 0.2 * i as f64).collect();
                let numerator = Polynomial::new(basis.numerator(&even, &odd));
                for (k, w) in omega.iter().enumerate() {
                    let at = |part: &Part, c: &[f64]| -> f64 { part.values.iter().zip(c).map(|(v, c)| v[k] * c).sum() };
                    let parts = Complex64::new(at(basis.even(), &even), at(basis.odd(), &odd));
                    let turned = numerator.eval(time.point(*w)) * Complex64::from_polar(1.0, basis.rotation(*w));
                    assert!((parts - turned).norm() < 1e-10, "{time:?} degree {degree} line {k}: {parts} {turned}");
                }
            }
        }
    }

    #[test]
    fn the_basis_is_orthonormal_on_a_short_arc() {
        let time = Time::Sampled(Discrete::new(0.02).unwrap());
        let omega: Vec<f64> = (0..31).map(|k| f64::from(k) * std::f64::consts::PI / 30.0).collect();
        let basis = Basis::new(time, 6, &omega).unwrap();
        for part in [basis.even(), basis.odd()] {
            for (i, a) in part.values.iter().enumerate() {
                for (j, b) in part.values.iter().enumerate() {
                    let product: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
                    assert!((product - f64::from(u8::from(i == j))).abs() < 1e-13);
                }
            }
        }
    }

    #[test]
    fn no_numerator_is_zero() {
        for time in [Time::Continuous, Time::Sampled(Discrete::new(0.02).unwrap())] {
            let none = Basis::none(time);
            assert!(none.is_none() && !Basis::new(time, 0, &[1.0]).unwrap().is_none());
            assert_eq!(none.numerator(&[], &[]), [0.0]);
        }
    }

    #[test]
    fn too_few_lines_are_refused() {
        // At 0 Hz the imaginary part says nothing.
        let error = Basis::new(Time::Continuous, 3, &[0.0, 1.0, 1.0]).unwrap_err();
        assert_eq!(error, TooFewLines { part: "imaginary", needed: 2, lines: 2 });
        assert!(Basis::new(Time::Continuous, 3, &[0.0, 1.0, 2.0]).is_ok());
        assert_eq!(Basis::new(Time::Continuous, 4, &[1.0, 2.0]).unwrap_err().part, "real");
    }
}
