//! Up to two roots, given as continuous-time exponents in rad/s, and the sets of them that a pool is made of.

/// No, one or two roots that are real or conjugate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RootPair {
    /// The polynomial 1.
    None,
    /// One real root.
    One(f64),
    /// Two real roots.
    Two(f64, f64),
    /// The conjugate roots of `s² + 2ζω_n s + ω_n²`.
    Complex {
        /// ω_n in rad/s, positive.
        natural_frequency: f64,
        /// ζ, inside (−1, 1).
        damping: f64,
    },
}

impl RootPair {
    /// The number of roots.
    #[must_use]
    pub fn degree(self) -> usize {
        match self {
            Self::None => 0,
            Self::One(_) => 1,
            Self::Two(..) | Self::Complex { .. } => 2,
        }
    }

    /// The real roots, where they are listed as such.
    #[must_use]
    pub(super) fn real(self) -> [Option<f64>; 2] {
        match self {
            Self::None | Self::Complex { .. } => [None, None],
            Self::One(a) => [Some(a), None],
            Self::Two(a, b) => [Some(a), Some(b)],
        }
    }

    /// Natural frequency and damping ratio of a conjugate pair.
    #[must_use]
    pub(super) fn complex(self) -> Option<(f64, f64)> {
        match self {
            Self::Complex { natural_frequency, damping } => Some((natural_frequency, damping)),
            _ => None,
        }
    }

    /// Whether a root lies on the imaginary axis at a frequency of the band `[low, high]` in rad/s, where the
    /// polynomial then vanishes.
    #[must_use]
    pub(super) fn vanishes_on(self, low: f64, high: f64) -> bool {
        match self {
            Self::None => false,
            Self::One(a) => low <= 0.0 && a == 0.0,
            Self::Two(a, b) => low <= 0.0 && (a == 0.0 || b == 0.0),
            Self::Complex { natural_frequency: w, damping } => damping == 0.0 && low <= w && w <= high,
        }
    }

    /// The monic polynomial in `s`, descending powers.
    #[must_use]
    pub fn polynomial(self) -> Vec<f64> {
        match self {
            Self::None => vec![1.0],
            Self::One(a) => vec![1.0, -a],
            Self::Two(a, b) => vec![1.0, -a - b, a * b],
            Self::Complex { natural_frequency: w, damping } => vec![1.0, 2.0 * damping * w, w * w],
        }
    }

    /// The monic polynomial in `v = s + margin`: as [`Self::polynomial`], with every root moved by `margin`.
    #[must_use]
    pub(super) fn shifted(self, margin: f64) -> Shifted {
        Shifted { roots: self, margin }
    }

    /// The monic polynomial in `z` with the roots `e^{λT}` (zero-pole matching).
    #[must_use]
    pub fn matched(self, period: f64) -> Vec<f64> {
        match self {
            Self::None => vec![1.0],
            Self::One(a) => vec![1.0, -(a * period).exp()],
            Self::Two(a, b) => {
                vec![1.0, -(a * period).exp() - (b * period).exp(), ((a + b) * period).exp()]
            }
            Self::Complex { natural_frequency: w, damping } => {
                let real = -damping * w * period;
                let imaginary = period * w * (1.0 - damping * damping).sqrt();
                vec![1.0, -2.0 * real.exp() * imaginary.cos(), (2.0 * real).exp()]
            }
        }
    }

    /// `(1−v)^n P(ρ(1+v)/(1−v))` of the matched polynomial P of degree n, with `ρ = e^{−margin T}`:
    /// each root gives the factor `(ρ + z) v + (ρ − z)`.
    #[must_use]
    pub(super) fn mapped(self, period: f64, margin: f64) -> Vec<f64> {
        let rho = (-margin * period).exp();
        // (ρ + z, ρ − z) of a real root, the difference without cancellation.
        let real = |a: f64| (rho + (a * period).exp(), -rho * ((a + margin) * period).exp_m1());
        match self {
            Self::None => vec![1.0],
            Self::One(a) => {
                let (sum, difference) = real(a);
                vec![sum, difference]
            }
            Self::Two(a, b) => {
                let ((s1, d1), (s2, d2)) = (real(a), real(b));
                vec![s1 * s2, s1 * d2 + s2 * d1, d1 * d2]
            }
            Self::Complex { natural_frequency: w, damping } => {
                let excess = (margin - damping * w) * period;
                let angle = period * w * (1.0 - damping * damping).sqrt();
                let modulus = excess.exp();
                // |ρ ± z|² / ρ², with |1 − e^{x+jθ}|² = (e^x − 1)² + 4 e^x sin²(θ/2).
                let difference = excess.exp_m1().powi(2) + 4.0 * modulus * (0.5 * angle).sin().powi(2);
                let sum = 1.0 + 2.0 * modulus * angle.cos() + modulus * modulus;
                let cross = -2.0 * (2.0 * excess).exp_m1();
                let scale = rho * rho;
                vec![scale * sum, scale * cross, scale * difference]
            }
        }
    }

    /// `|P(e^{jθ})|²` of the matched polynomial P as `c0 + c1 y + c2 y²` in `y = 1 − cos θ`.
    #[must_use]
    pub(super) fn matched_square(self, period: f64) -> [f64; 3] {
        // |e^{jθ} − z|² = (1−z)² + 2 z y of a real root.
        let real = |a: f64| ((a * period).exp_m1().powi(2), 2.0 * (a * period).exp());
        match self {
            Self::None => [1.0, 0.0, 0.0],
            Self::One(a) => {
                let (c0, c1) = real(a);
                [c0, c1, 0.0]
            }
            Self::Two(a, b) => {
                let ((p0, p1), (q0, q1)) = (real(a), real(b));
                [p0 * q0, p0 * q1 + p1 * q0, p1 * q1]
            }
            Self::Complex { natural_frequency: w, damping } => {
                let exponent = -damping * w * period;
                let angle = period * w * (1.0 - damping * damping).sqrt();
                let modulus = exponent.exp();
                // P(1) = |1 − z|², b0 = |z|²; see the polynomial z² + b1 z + b0 on the unit circle.
                let at_one = exponent.exp_m1().powi(2) + 4.0 * modulus * (0.5 * angle).sin().powi(2);
                let b0 = modulus * modulus;
                let one_minus_b0 = -(2.0 * exponent).exp_m1();
                [at_one * at_one, 2.0 * (one_minus_b0 * one_minus_b0 - at_one * (1.0 + b0)), 4.0 * b0]
            }
        }
    }

    /// `|P(jω)|²` as `c0 + c1 x + c2 x²` in `x = ω²`.
    #[must_use]
    pub(super) fn square(self) -> [f64; 3] {
        match self {
            Self::None => [1.0, 0.0, 0.0],
            Self::One(a) => [a * a, 1.0, 0.0],
            Self::Two(a, b) => [a * a * b * b, a * a + b * b, 1.0],
            Self::Complex { natural_frequency: w, damping } => {
                [w.powi(4), 2.0 * w * w * (2.0 * damping * damping - 1.0), 1.0]
            }
        }
    }
}

/// A pair of roots moved to the right by a margin.
pub(super) struct Shifted {
    roots: RootPair,
    margin: f64,
}

impl Shifted {
    pub(super) fn polynomial(self) -> Vec<f64> {
        let m = self.margin;
        match self.roots {
            RootPair::None => vec![1.0],
            RootPair::One(a) => vec![1.0, -(a + m)],
            RootPair::Two(a, b) => vec![1.0, -(a + m) - (b + m), (a + m) * (b + m)],
            RootPair::Complex { natural_frequency: w, damping } => {
                let real = m - damping * w;
                vec![1.0, -2.0 * real, real * real + w * w * (1.0 - damping * damping)]
            }
        }
    }
}

/// Lists from which pairs of roots are made.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RootLists {
    /// Real roots in rad/s, without repeats.
    pub real: Vec<f64>,
    /// Natural frequencies of conjugate pairs in rad/s, not negative, without repeats.
    pub natural_frequency: Vec<f64>,
    /// Damping ratios of conjugate pairs, inside (−1, 1), without repeats.
    pub damping: Vec<f64>,
}

impl RootLists {
    /// Every set of `degree` roots, without repeats: real ones first (for two roots the pairs `i ≤ j` of the list, `i`
    /// outermost), then conjugate pairs (natural frequency outermost). A natural frequency of zero stands for the
    /// double root at zero, taken once and only if it is not among the real pairs.
    ///
    /// # Panics
    /// For a degree above 2, which the spec refuses.
    #[must_use]
    pub fn pairs(&self, degree: usize) -> Vec<RootPair> {
        match degree {
            0 => vec![RootPair::None],
            1 => self.real.iter().map(|a| RootPair::One(*a)).collect(),
            2 => {
                let mut pairs = Vec::new();
                for (i, a) in self.real.iter().enumerate() {
                    pairs.extend(self.real[i..].iter().map(|b| RootPair::Two(*a, *b)));
                }
                let mut double_zero = self.real.contains(&0.0);
                for &natural_frequency in &self.natural_frequency {
                    for &damping in &self.damping {
                        if natural_frequency > 0.0 {
                            pairs.push(RootPair::Complex { natural_frequency, damping });
                        } else if !double_zero {
                            pairs.push(RootPair::Two(0.0, 0.0));
                            double_zero = true;
                        }
                    }
                }
                pairs
            }
            _ => panic!("roots of degree {degree}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::Polynomial;
    use num_complex::Complex64;

    const PAIRS: [RootPair; 5] = [
        RootPair::None,
        RootPair::One(-3.5),
        RootPair::Two(-3.5, 1.2),
        RootPair::Complex { natural_frequency: 4.0, damping: 0.3 },
        RootPair::Complex { natural_frequency: 9.0, damping: 0.0 },
    ];

    #[test]
    fn squared_moduli_agree_with_the_polynomials() {
        for pair in PAIRS {
            for omega in [0.0, 0.3, 2.0, 8.9, 30.0] {
                let [c0, c1, c2] = pair.square();
                let x = omega * omega;
                let direct = Polynomial::new(pair.polynomial()).eval(Complex64::new(0.0, omega)).norm_sqr();
                assert!((c0 + x * (c1 + x * c2) - direct).abs() < 1e-12 * (1.0 + direct), "{pair:?} at {omega}");

                let period = 0.02;
                let [c0, c1, c2] = pair.matched_square(period);
                let theta = omega * period;
                let y = 2.0 * (0.5_f64 * theta).sin().powi(2);
                let direct = Polynomial::new(pair.matched(period)).eval(Complex64::from_polar(1.0, theta)).norm_sqr();
                assert!((c0 + y * (c1 + y * c2) - direct).abs() < 1e-13, "{pair:?} at {omega}");
            }
        }
    }

    #[test]
    fn shifting_moves_every_root() {
        for pair in PAIRS {
            let moved = Polynomial::new(pair.shifted(0.7).polynomial());
            for root in Polynomial::new(pair.polynomial()).roots().unwrap() {
                assert!(moved.eval(root + 0.7).norm() < 1e-12, "{pair:?}");
            }
        }
    }

    #[test]
    fn the_double_root_at_zero_is_counted_once() {
        let lists = RootLists { real: vec![-1.0, 0.0], natural_frequency: vec![0.0, 1.0], damping: vec![-0.5, 0.5] };
        assert_eq!(lists.pairs(2).len(), 3 + 2);
        let without = RootLists { real: vec![-1.0], ..lists };
        assert_eq!(without.pairs(2).len(), 1 + 1 + 2);
    }
}
