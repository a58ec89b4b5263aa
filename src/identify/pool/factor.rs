//! One numerator or denominator of a pool: its coefficients, and the same polynomial as the stability test wants it.

use super::roots::RootPair;
use crate::identify::time::{Region, Time};

/// A polynomial of a candidate with everything about it that does not depend on the rest of the candidate.
#[derive(Debug, Clone, PartialEq)]
pub struct Factor {
    /// Coefficients in descending powers of `s` or `z`.
    pub coefficients: Vec<f64>,
    /// [`Region::map`] of them, homogenised to the degree of the denominator.
    pub mapped: Vec<f64>,
    /// Its position in the list that it comes from.
    pub listed: usize,
}

impl Factor {
    /// From coefficients.
    #[must_use]
    pub fn from_coefficients(coefficients: Vec<f64>, region: Region, degree: usize, listed: usize) -> Self {
        let mapped = region.map(&coefficients, degree);
        Self { coefficients, mapped, listed }
    }

    /// From roots given as continuous-time exponents in rad/s; sampled by zero-pole matching, `z = e^{λT}`.
    ///
    /// The map is computed from the roots and not from the coefficients, so that a root on the boundary of the region
    /// is on it to the last bit, and roots near z = 1 lose nothing to cancellation.
    #[must_use]
    pub fn from_roots(roots: RootPair, region: Region, degree: usize, listed: usize) -> Self {
        let (coefficients, mut mapped) = match region.time {
            Time::Continuous => (roots.polynomial(), roots.shifted(region.margin).polynomial()),
            Time::Sampled(time) => (roots.matched(time.period_s()), roots.mapped(time.period_s(), region.margin)),
        };
        let own = coefficients.len() - 1;
        match region.time {
            Time::Continuous => {
                let mut padded = vec![0.0; degree - own];
                padded.append(&mut mapped);
                mapped = padded;
            }
            Time::Sampled(_) => {
                for _ in own..degree {
                    mapped = crate::identify::time::multiply(&mapped, &[-1.0, 1.0]);
                }
            }
        }
        Self { coefficients, mapped, listed }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Discrete;

    #[test]
    fn roots_and_coefficients_map_alike() {
        let pairs = [
            RootPair::None,
            RootPair::One(-3.5),
            RootPair::Two(-3.5, 1.2),
            RootPair::Complex { natural_frequency: 4.0, damping: 0.3 },
            RootPair::Complex { natural_frequency: 9.0, damping: -0.2 },
        ];
        for time in [Time::Continuous, Time::Sampled(Discrete::new(0.02).unwrap())] {
            let region = Region { time, margin: 0.1 };
            for pair in pairs {
                let degree = pair.degree() + 1;
                let exact = Factor::from_roots(pair, region, degree, 0);
                let generic = Factor::from_coefficients(exact.coefficients.clone(), region, degree, 0);
                let scale = generic.mapped.iter().map(|c| c.abs()).fold(0.0, f64::max);
                for (a, b) in exact.mapped.iter().zip(&generic.mapped) {
                    assert!((a - b).abs() < 1e-14 * scale, "{pair:?} {time:?}: {exact:?} {generic:?}");
                }
            }
        }
    }
}
