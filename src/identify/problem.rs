//! The least-squares problem that every candidate is judged by.
//!
//! With `T = H/G + (H − 1) Gfb` the modelled response misses the data by `G̃ − H = G/(1 + G Gfb) · (Gff − T)`, so for a
//! fixed feedback controller the cost is a weighted distance of Gff from T (Zhang 2015, eqs. 2.3 and 3.6, rearranged),
//! and linear in the feedforward numerator.

use super::basis::{Basis, TooFewLines};
use super::held::Held;
use super::time::Time;
use crate::control::System;
use num_complex::Complex64;

/// Candidates whose cost is within this share of the best one's are counted.
pub const NEAR: f64 = 0.01;

/// One frequency at which the closed loop was measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Angular frequency in rad/s.
    pub omega_rad_s: f64,
    /// Plant response, finite and not zero.
    pub plant: Complex64,
    /// Measured response from command to output.
    pub response: Complex64,
    /// Weight of this line's squared residual, positive.
    pub weight: f64,
}

/// Why a line cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Unusable {
    /// A plant pole lies on it: `G̃ = (Gff + Gfb)/Gfb` there, whatever the plant is.
    PlantPole,
    /// A plant zero lies on it: `G̃ = 0` there, whatever the controllers are.
    PlantZero,
    /// The measured response is not finite.
    NoResponse,
    /// The weight is not positive and finite.
    NoWeight,
    /// The line lies above the Nyquist frequency.
    AboveNyquist,
}

/// A line that was left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dropped {
    /// Angular frequency in rad/s.
    pub omega_rad_s: f64,
    /// Why.
    pub why: Unusable,
}

/// The lines of a problem, with those that could not be used.
#[derive(Debug, Clone, PartialEq)]
pub struct Lines {
    /// Time base of plant and controllers.
    pub time: Time,
    /// The usable lines, in the given order.
    pub used: Vec<Line>,
    /// The others.
    pub dropped: Vec<Dropped>,
}

/// A plant response below this share of the largest one at the other lines, or above its inverse, counts as a zero or a
/// pole on the line: rounding keeps a pole at z = 1 from being hit exactly.
const SINGULAR: f64 = 1e-10;

impl Lines {
    /// From plant and data; `weights` are relative, all 1 if not given.
    ///
    /// # Panics
    /// If the lengths differ, which is a mistake of the caller.
    #[must_use]
    pub fn new(plant: &System, omega_rad_s: &[f64], response: &[Complex64], weights: Option<&[f64]>) -> Self {
        assert_eq!(omega_rad_s.len(), response.len(), "a response for every line");
        assert!(weights.is_none_or(|w| w.len() == response.len()), "a weight for every line");
        let time = Time::of(plant);
        let nyquist = time.sample_time_s().map(|t| std::f64::consts::PI / t * (1.0 + 1e-9));
        let magnitudes: Vec<f64> = omega_rad_s.iter().map(|w| plant.response(*w).norm()).collect();
        let mut finite: Vec<f64> = magnitudes.iter().copied().filter(|m| m.is_finite() && *m > 0.0).collect();
        finite.sort_by(f64::total_cmp);
        let typical = finite.get(finite.len() / 2).copied().unwrap_or(1.0);
        let mut lines = Self { time, used: Vec::new(), dropped: Vec::new() };
        for (k, (&omega, &h)) in omega_rad_s.iter().zip(response).enumerate() {
            let weight = weights.map_or(1.0, |w| w[k]);
            let why = if nyquist.is_some_and(|limit| omega > limit) {
                Some(Unusable::AboveNyquist)
            } else if magnitudes[k].is_nan() || magnitudes[k] >= typical / SINGULAR {
                Some(Unusable::PlantPole)
            } else if magnitudes[k] <= typical * SINGULAR {
                Some(Unusable::PlantZero)
            } else if !(h.re.is_finite() && h.im.is_finite()) {
                Some(Unusable::NoResponse)
            } else if !(weight.is_finite() && weight > 0.0) {
                Some(Unusable::NoWeight)
            } else {
                None
            };
            match why {
                Some(why) => lines.dropped.push(Dropped { omega_rad_s: omega, why }),
                None => lines.used.push(Line { omega_rad_s: omega, plant: plant.response(omega), response: h, weight }),
            }
        }
        lines
    }
}

/// The problem: lines, and the basis of the feedforward numerator on them.
#[derive(Debug, Clone, PartialEq)]
pub struct Problem {
    time: Time,
    lines: Vec<Line>,
    basis: Basis,
}

impl Problem {
    /// From usable lines and the degree of the feedforward numerator.
    ///
    /// # Errors
    /// [`TooFewLines`] where the lines do not determine the numerator.
    pub fn new(lines: &Lines, numerator_degree: usize) -> Result<Self, TooFewLines> {
        let omega: Vec<f64> = lines.used.iter().map(|line| line.omega_rad_s).collect();
        let basis = Basis::new(lines.time, numerator_degree, &omega)?;
        Ok(Self { time: lines.time, lines: lines.used.clone(), basis })
    }

    /// [`Problem::new`] with a controller held at zero: a feedforward that is has no numerator, whatever its degree.
    ///
    /// # Errors
    /// [`TooFewLines`] where the lines do not determine the numerator.
    pub fn holding(held: Option<Held>, lines: &Lines, numerator_degree: usize) -> Result<Self, TooFewLines> {
        if held == Some(Held::Feedforward) {
            let basis = Basis::none(lines.time);
            return Ok(Self { time: lines.time, lines: lines.used.clone(), basis });
        }
        Self::new(lines, numerator_degree)
    }

    /// The same lines with the feedforward behind a pure delay (before a lead, where negative): `Gff e^{−jω delay}`.
    #[must_use]
    pub fn with_feedforward_delay(self, delay_s: f64) -> Self {
        Self { basis: self.basis.behind(delay_s), ..self }
    }

    /// The time base.
    #[must_use]
    pub fn time(&self) -> Time {
        self.time
    }

    /// The lines.
    #[must_use]
    pub fn lines(&self) -> &[Line] {
        &self.lines
    }

    /// A difference of costs that rounding alone can make: `(2⁸ ε)² Σ weight |H|²`. The residuals of a candidate that
    /// fits exactly are the rounding of H and of the loop's functions, some ε each, squared and summed.
    #[must_use]
    pub fn rounding(&self) -> f64 {
        const RESIDUAL: f64 = 256.0 * f64::EPSILON;
        let scale: f64 = self.lines.iter().map(|line| line.weight * line.response.norm_sqr()).sum();
        RESIDUAL * RESIDUAL * scale
    }

    /// Up to which cost a candidate fits as well as one that costs `best`: within the share [`NEAR`] of it, and within
    /// rounding.
    #[must_use]
    pub fn near_limit(&self, best: f64) -> f64 {
        ((1.0 + NEAR) * best).max(best + self.rounding())
    }

    /// The basis of the feedforward numerator.
    #[must_use]
    pub fn basis(&self) -> &Basis {
        &self.basis
    }

    /// The reciprocal of a denominator (descending powers) at each line.
    ///
    /// A feedback controller may have a pole on a line (an integrator at 0 Hz). Everything that is computed from its
    /// response has a finite limit there, which 10³⁰ in place of infinity gives to working precision.
    #[must_use]
    pub fn reciprocal_at_lines(&self, denominator: &[f64]) -> Vec<Complex64> {
        let pole = Complex64::new(1e30, 0.0);
        self.at_lines(denominator).into_iter().map(|d| if d.norm_sqr() == 0.0 { pole } else { d.inv() }).collect()
    }

    /// The value of a polynomial (descending powers) at each line.
    #[must_use]
    pub fn at_lines(&self, descending: &[f64]) -> Vec<Complex64> {
        self.lines
            .iter()
            .map(|line| {
                let x = self.time.point(line.omega_rad_s);
                descending.iter().fold(Complex64::new(0.0, 0.0), |sum, c| sum * x + c)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Continuous, Discrete, TransferFunction};

    #[test]
    fn lines_on_poles_and_zeros_are_dropped_with_the_reason() {
        let one = Complex64::new(1.0, 0.0);
        let integrator =
            System::Continuous(TransferFunction::new(&[1.0, 0.0, 4.0], &[1.0, 1.0, 0.0], Continuous).unwrap());
        let lines = Lines::new(&integrator, &[0.0, 1.0, 2.0, 3.0], &[one; 4], None);
        let why: Vec<_> = lines.dropped.iter().map(|d| (d.omega_rad_s, d.why)).collect();
        assert_eq!(why, [(0.0, Unusable::PlantPole), (2.0, Unusable::PlantZero)]);
        assert_eq!(lines.used.len(), 2);

        let time = Discrete::new(0.5).unwrap();
        let sampled = System::Discrete(TransferFunction::new(&[0.5], &[1.0, -1.0], time).unwrap());
        let nan = Complex64::new(f64::NAN, 0.0);
        let lines = Lines::new(&sampled, &[0.0, 1.0, 7.0, 2.0], &[one, nan, one, one], Some(&[1.0, 1.0, 1.0, 0.0]));
        let why: Vec<_> = lines.dropped.iter().map(|d| d.why).collect();
        assert_eq!(why, [Unusable::PlantPole, Unusable::NoResponse, Unusable::AboveNyquist, Unusable::NoWeight]);
    }
}
