//! Functions of frequency on narrow cells of a band, with a bound of what their Taylor polynomials leave over.

use crate::identify::basis::Factor;
use crate::identify::time::Time;
use num_complex::Complex64;

/// |x|, quicker than where nothing may overflow.
#[inline(always)]
pub(super) fn modulus(x: Complex64) -> f64 {
    x.norm_sqr().sqrt()
}

/// `f(ω + s) = a + b s + c s² + ρ` with `|ρ| ≤ rest`, for every |s| up to the half width of the cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Model {
    pub a: Complex64,
    pub b: Complex64,
    pub c: Complex64,
    pub rest: f64,
}

impl Model {
    pub(super) const ZERO: Self = Self { a: Complex64::ZERO, b: Complex64::ZERO, c: Complex64::ZERO, rest: 0.0 };

    pub(super) fn constant(a: f64) -> Self {
        Self { a: Complex64::new(a, 0.0), ..Self::ZERO }
    }

    pub(super) fn plus(&self, other: &Self) -> Self {
        Self { a: self.a + other.a, b: self.b + other.b, c: self.c + other.c, rest: self.rest + other.rest }
    }

    pub(super) fn scaled(&self, factor: Complex64) -> Self {
        let Self { a, b, c, rest } = *self;
        Self { a: a * factor, b: b * factor, c: c * factor, rest: rest * factor.norm() }
    }

    /// Adds a real multiple of another.
    #[inline(always)]
    pub(super) fn add(&mut self, factor: f64, other: &Self) {
        self.a += other.a * factor;
        self.b += other.b * factor;
        self.c += other.c * factor;
        self.rest += other.rest * factor.abs();
    }

    /// On a cell of this half width.
    #[inline(always)]
    pub(super) fn times(&self, other: &Self, half: f64) -> Self {
        let cubic = (self.b * other.c + self.c * other.b).l1_norm() + (self.c * other.c).l1_norm() * half;
        Self {
            a: self.a * other.a,
            b: self.a * other.b + self.b * other.a,
            c: self.a * other.c + self.b * other.b + self.c * other.a,
            rest: cubic * half * half * half
                + self.rest * (other.largest(half) + other.rest)
                + other.rest * self.largest(half),
        }
    }

    /// No value of the polynomial is larger.
    #[inline(always)]
    fn largest(&self, half: f64) -> f64 {
        self.a.l1_norm() + half * (self.b.l1_norm() + half * self.c.l1_norm())
    }

    /// No value on the cell has a larger modulus.
    #[inline(always)]
    pub(super) fn most(&self, half: f64) -> f64 {
        modulus(self.a) + half * (modulus(self.b) + half * modulus(self.c)) + self.rest
    }

    /// No value on the cell has a smaller modulus; not positive where nothing is known.
    #[inline(always)]
    pub(super) fn least(&self, half: f64) -> f64 {
        modulus(self.a) - half * (modulus(self.b) + half * modulus(self.c)) - self.rest
    }

    /// What is left over of the tangent `a + b s`.
    #[inline(always)]
    pub(super) fn curved(&self, half: f64) -> f64 {
        modulus(self.c) * half * half + self.rest
    }
}

/// A band cut into cells of equal width.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cells {
    pub time: Time,
    from: f64,
    pub half: f64,
    pub count: usize,
}

impl Cells {
    /// Of a band in rad/s.
    pub(super) fn new(time: Time, band_rad_s: [f64; 2], count: usize) -> Self {
        let [from, to] = band_rad_s;
        Self { time, from, half: 0.5 * (to - from) / count as f64, count }
    }

    /// The same band in another number of cells.
    pub(super) fn divided(&self, count: usize) -> Self {
        Self { half: self.half * self.count as f64 / count as f64, count, ..*self }
    }

    fn middle(&self, cell: usize) -> f64 {
        self.from + self.half * (2 * cell + 1) as f64
    }

    /// The variable, s or z, on a cell.
    fn variable(&self, cell: usize) -> Model {
        let omega = self.middle(cell);
        match self.time {
            Time::Continuous => Model { a: Complex64::new(0.0, omega), b: Complex64::I, c: Complex64::ZERO, rest: 0.0 },
            Time::Sampled(time) => self.turning(cell, time.period_s()),
        }
    }

    /// `e^{jω t}` on a cell.
    pub(super) fn turning(&self, cell: usize, t: f64) -> Model {
        let a = Complex64::from_polar(1.0, self.middle(cell) * t);
        Model { a, b: a * Complex64::new(0.0, t), c: a * (-0.5 * t * t), rest: (t.abs() * self.half).powi(3) / 6.0 }
    }

    /// A polynomial (descending powers of the variable) on a cell.
    pub(super) fn polynomial(&self, descending: &[f64], cell: usize) -> Model {
        let x = self.variable(cell);
        let horner = |sum: Model, c: &f64| sum.times(&x, self.half).plus(&Model::constant(*c));
        descending.iter().fold(Model::ZERO, horner)
    }

    /// The powers of the variable from 0 on, so many of them.
    pub(super) fn powers(&self, count: usize, cell: usize) -> Vec<Model> {
        let x = self.variable(cell);
        std::iter::successors(Some(Model::constant(1.0)), |power| Some(power.times(&x, self.half)))
            .take(count)
            .collect()
    }

    /// A real polynomial (ascending powers) of `(y − centre)/half`, where y is ω² or `1 − cos ωT`, times one of the
    /// factors that a part of a numerator has.
    pub(super) fn half_basis(&self, ascending: &[f64], [centre, half]: [f64; 2], factor: Factor, cell: usize) -> Model {
        let omega = self.middle(cell);
        let y = match self.time {
            Time::Continuous => Model {
                a: Complex64::new(omega * omega, 0.0),
                b: Complex64::new(2.0 * omega, 0.0),
                c: Complex64::ONE,
                rest: 0.0,
            },
            Time::Sampled(time) => {
                let cosine = self.cosine(cell, time.period_s());
                Model::constant(1.0).plus(&cosine.scaled(Complex64::new(-1.0, 0.0)))
            }
        };
        let t = y.plus(&Model::constant(-centre)).scaled(Complex64::new(1.0 / half, 0.0));
        let horner = |sum: Model, c: &f64| sum.times(&t, self.half).plus(&Model::constant(*c));
        let polynomial = ascending.iter().rev().fold(Model::ZERO, horner);
        let factor = match (factor, self.time) {
            (Factor::One, _) => return polynomial,
            (Factor::Omega, _) => {
                Model { a: Complex64::new(omega, 0.0), b: Complex64::ONE, c: Complex64::ZERO, rest: 0.0 }
            }
            (Factor::Cosine(share), Time::Sampled(time)) => self.cosine(cell, share * time.period_s()),
            (Factor::Sine(share), Time::Sampled(time)) => self.sine(cell, share * time.period_s()),
            (Factor::Cosine(_) | Factor::Sine(_), Time::Continuous) => return polynomial,
        };
        polynomial.times(&factor, self.half)
    }

    fn cosine(&self, cell: usize, t: f64) -> Model {
        let turning = self.turning(cell, t);
        let real = |x: Complex64| Complex64::new(x.re, 0.0);
        Model { a: real(turning.a), b: real(turning.b), c: real(turning.c), rest: turning.rest }
    }

    fn sine(&self, cell: usize, t: f64) -> Model {
        let turning = self.turning(cell, t);
        let imaginary = |x: Complex64| Complex64::new(x.im, 0.0);
        Model { a: imaginary(turning.a), b: imaginary(turning.b), c: imaginary(turning.c), rest: turning.rest }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Discrete, TimeBase as _};

    #[test]
    fn values_lie_within_what_is_left_over() {
        let sampled = Discrete::new(0.1).unwrap();
        for time in [Time::Continuous, Time::Sampled(sampled)] {
            let cells = Cells::new(time, [0.4, 3.0], 8);
            let (p, q) = ([1.0, -0.4, 2.5, 0.3], [1.0, 0.2, 4.0]);
            for cell in 0..cells.count {
                let (first, second) = (cells.polynomial(&p, cell), cells.polynomial(&q, cell));
                let product = first.times(&second, cells.half);
                let even = cells.half_basis(&[0.3, -1.0, 0.7], [2.0, 1.5], Factor::One, cell);
                for step in -5..=5 {
                    let s = cells.half * f64::from(step) / 5.0;
                    let omega = cells.middle(cell) + s;
                    let x = match time {
                        Time::Continuous => Complex64::new(0.0, omega),
                        Time::Sampled(time) => time.point(omega),
                    };
                    let at = |p: &[f64]| p.iter().fold(Complex64::ZERO, |sum, c| sum * x + c);
                    let y = match time {
                        Time::Continuous => omega * omega,
                        Time::Sampled(time) => 1.0 - (omega * time.period_s()).cos(),
                    };
                    let t = (y - 2.0) / 1.5;
                    let real = Complex64::new(0.3 - t + 0.7 * t * t, 0.0);
                    for (model, value) in [(first, at(&p)), (second, at(&q)), (product, at(&p) * at(&q)), (even, real)]
                    {
                        let error = (model.a + model.b * s + model.c * s * s - value).norm();
                        assert!(error <= model.rest + 1e-13, "{model:?} at {s}: {error}");
                        // 0.045 of the product of degree five on the widest cell; sums of parts stand for moduli.
                        assert!(model.rest < 0.05 * model.most(cells.half), "{model:?}");
                        assert!(value.norm() <= model.most(cells.half) + 1e-13);
                        assert!(value.norm() >= model.least(cells.half) - 1e-13);
                    }
                }
            }
        }
    }
}
