//! The variable that denominators are refined in.
//!
//! `x = s/ω₀` in continuous and `x = (z − 1)/(ω₀T)` in sampled time, ω₀ the geometric mean of the lines. Roots near z =
//! 1, which differ only in the last digits of coefficients in powers of z, are as far apart in x as in continuous time,
//! and coefficients have the size of one.

use crate::identify::problem::Line;
use crate::identify::time::{Region, Time, multiply};
use num_complex::Complex64;

/// The variable x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Variable {
    time: Time,
    /// ω₀ in rad/s.
    pub omega: f64,
    /// What x is multiplied by: ω₀, or ω₀T.
    pub unit: f64,
}

/// `p(y + shift)` of a polynomial in descending powers.
fn shifted(descending: &[f64], shift: f64) -> Vec<f64> {
    let mut p = descending.to_vec();
    for end in (1..p.len()).rev() {
        for i in 0..end {
            p[i + 1] += shift * p[i];
        }
    }
    p
}

/// `p(factor · y)` of a polynomial in descending powers.
fn stretched(descending: &[f64], factor: f64) -> Vec<f64> {
    let degree = descending.len() - 1;
    descending.iter().enumerate().map(|(i, c)| c * factor.powi((degree - i) as i32)).collect()
}

/// `x^power` as a polynomial.
pub(super) fn power(power: usize) -> Vec<f64> {
    [vec![1.0], vec![0.0; power]].concat()
}

impl Variable {
    pub(super) fn new(time: Time, lines: &[Line]) -> Self {
        let logs: Vec<f64> = lines.iter().map(|l| l.omega_rad_s).filter(|w| *w > 0.0).map(f64::ln).collect();
        let omega = crate::num::stats::mean(&logs).map_or(1.0, f64::exp);
        Self { time, omega, unit: omega * time.sample_time_s().unwrap_or(1.0) }
    }

    /// x at an angular frequency.
    pub(super) fn at(&self, omega_rad_s: f64) -> Complex64 {
        match self.time {
            Time::Continuous => Complex64::new(0.0, omega_rad_s / self.unit),
            Time::Sampled(time) => {
                // e^{jθ} − 1 = 2j sin(θ/2) e^{jθ/2}, without the cancellation.
                let half = 0.5 * omega_rad_s * time.period_s();
                Complex64::new(0.0, 2.0 * half.sin() / self.unit) * Complex64::from_polar(1.0, half)
            }
        }
    }

    /// A polynomial in powers of s or z, written in powers of x.
    pub(super) fn enter(&self, descending: &[f64]) -> Vec<f64> {
        match self.time {
            Time::Continuous => stretched(descending, self.unit),
            Time::Sampled(_) => stretched(&shifted(descending, 1.0), self.unit),
        }
    }

    /// A polynomial in powers of x, written in powers of s or z.
    pub(super) fn leave(&self, descending: &[f64]) -> Vec<f64> {
        match self.time {
            Time::Continuous => stretched(descending, 1.0 / self.unit),
            Time::Sampled(_) => shifted(&stretched(descending, 1.0 / self.unit), -1.0),
        }
    }

    /// [`Region::map`] of a polynomial in powers of x, its variable in continuous time in units of ω₀.
    pub(super) fn map(&self, margin_per_s: f64, descending: &[f64], degree: usize) -> Vec<f64> {
        match self.time {
            Time::Continuous => {
                let region = Region { time: self.time, margin: margin_per_s / self.unit };
                region.map(descending, degree)
            }
            Time::Sampled(time) => {
                // x = ((ρ − 1) + (ρ + 1) v) / (ω₀T (1 − v)).
                let (low, high) =
                    ((-margin_per_s * time.period_s()).exp_m1(), 1.0 + (-margin_per_s * time.period_s()).exp());
                let top = [high / self.unit, low / self.unit];
                let own = descending.len() - 1;
                let mut mapped = vec![0.0; degree + 1];
                for (i, coefficient) in descending.iter().enumerate() {
                    let power = own - i;
                    let mut term = vec![*coefficient];
                    for _ in 0..power {
                        term = multiply(&term, &top);
                    }
                    for _ in 0..degree - power {
                        term = multiply(&term, &[-1.0, 1.0]);
                    }
                    mapped.iter_mut().zip(&term).for_each(|(m, t)| *m += t);
                }
                mapped
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Discrete;
    use crate::num::Polynomial;

    fn lines() -> Vec<Line> {
        let one = Complex64::new(1.0, 0.0);
        [0.0, 0.5, 8.0].map(|omega_rad_s| Line { omega_rad_s, plant: one, response: one, weight: 1.0 }).to_vec()
    }

    #[test]
    fn a_polynomial_enters_and_leaves_with_its_values() {
        for time in [Time::Continuous, Time::Sampled(Discrete::new(0.02).unwrap())] {
            let variable = Variable::new(time, &lines());
            assert!((variable.omega - 2.0).abs() < 1e-14);
            let p = [1.0, -1.7, 0.8, 0.3];
            let entered = variable.enter(&p);
            for omega in [0.0, 0.3, 2.0, 11.0] {
                let there = Polynomial::new(entered.clone()).eval(variable.at(omega));
                let here = Polynomial::new(p.to_vec()).eval(time.point(omega));
                assert!((there - here).norm() < 1e-13 * (1.0 + here.norm()), "{time:?} {omega}: {there} {here}");
            }
            for (a, b) in variable.leave(&entered).iter().zip(&p) {
                assert!((a - b).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn the_map_is_that_of_the_region_up_to_its_unit() {
        let time = Time::Sampled(Discrete::new(0.02).unwrap());
        let variable = Variable::new(time, &lines());
        let p = [1.0, -1.9, 0.903];
        let own = variable.map(0.1, &variable.enter(&p), 3);
        for (a, b) in own.iter().zip(Region { time, margin: 0.1 }.map(&p, 3)) {
            assert!((a - b).abs() < 1e-13, "{a} {b}");
        }
    }
}
