//! How far the return difference of one input may move within the rounding of the data.

use super::kalman::OneInput;
use crate::control::lyapunov::Clock;
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

/// A point of the imaginary axis, or of the unit circle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Place {
    /// jω.
    Axis(f64),
    Infinity,
    /// `e^jθ` with its cosine and sine.
    Circle(f64, f64),
}

impl Place {
    /// From `y = (1 − cos θ)/2`, without loss at either end.
    pub(super) fn circle(y: f64) -> Self {
        Self::Circle(1.0 - 2.0 * y, 2.0 * (y * (1.0 - y)).max(0.0).sqrt())
    }

    /// ω, or θ.
    pub(super) fn omega(self) -> f64 {
        match self {
            Self::Axis(omega) => omega,
            Self::Infinity => f64::INFINITY,
            Self::Circle(cosine, sine) => sine.atan2(cosine),
        }
    }
}

/// The uncertainty of F, and its gradient with respect to K.
pub(super) struct Found {
    /// u: the first order over the box, and the square of what |L| may move by.
    pub rounding: f64,
    /// ∂F/∂K.
    pub gain: DVector<f64>,
}

/// What does not depend on the frequency.
pub(super) struct Sensitivity<'a> {
    of: &'a OneInput<'a>,
    /// `A⁻¹B` and `(KA⁻¹)ᵀ`, in sampled time.
    inverse: Option<(DVector<f64>, DVector<f64>)>,
    size: f64,
}

impl<'a> Sensitivity<'a> {
    pub(super) fn new(of: &'a OneInput<'a>) -> Self {
        let solved = || {
            let left = of.a.clone().lu().solve(of.b)?;
            let right = of.a.transpose().lu().solve(&of.k.transpose())?;
            Some((left.column(0).into_owned(), right.column(0).into_owned()))
        };
        let inverse = if of.clock == Clock::Sampled { solved() } else { None };
        Self { of, inverse, size: of.a.norm() }
    }

    /// How far `ρ = 1 − KA⁻¹B` may move, to first order.
    pub(super) fn input_weight_rounding(&self) -> f64 {
        let Some((right, left)) = &self.inverse else { return f64::INFINITY };
        let (right, left) = (right.abs(), left.abs());
        let box_ = self.of.rounding;
        (&box_.k * &right)[0] + left.dot(&(&box_.a * &right)) + left.dot(&box_.b.column(0))
    }

    /// u at a place; `None` on a pole of the plant.
    pub(super) fn at(&self, place: Place) -> Option<Found> {
        let OneInput { a, b, k, rounding, .. } = self.of;
        let n = a.nrows();
        if place == Place::Infinity {
            // The limit of ω²F is (KB)² − 2KAB.
            let (kb, ka, ab) = ((*k * *b)[0], (*k * *a).transpose(), *a * *b);
            let gain = (*b * kb - ab) * 2.0;
            let input = (k.transpose() * kb - ka) * 2.0;
            let plant = k.transpose().abs() * 2.0;
            let first = (&rounding.k * gain.abs())[0]
                + rounding.b.dot(&input.abs())
                + (plant.transpose() * &rounding.a * b.abs())[0];
            let moved = (&rounding.k * b.abs() + k.abs() * &rounding.b)[0];
            return Some(Found { rounding: first + moved * moved, gain: gain.column(0).into_owned() });
        }
        let (phi, psi) = self.resolvent(place)?;
        let sigma = Complex64::new(1.0, 0.0) + k.iter().zip(phi.iter()).map(|(k, p)| p * *k).sum::<Complex64>();
        let turned = |v: &DVector<Complex64>| v.map(|v| 2.0 * (sigma.conj() * v).re);
        let mut gain = turned(&phi);
        let mut input = turned(&psi);
        let mut plant = DMatrix::from_fn(n, n, |i, j| 2.0 * (sigma.conj() * psi[i] * phi[j]).re);
        if let Some((right, left)) = &self.inverse {
            gain += right;
            input += left;
            plant -= left * right.transpose();
        }
        let first = (&rounding.k * gain.abs())[0] + rounding.b.dot(&input.abs()) + rounding.a.dot(&plant.abs());
        let (size_phi, size_psi) = (phi.map(|v| v.norm()), psi.map(|v| v.norm()));
        let moved = size_psi.dot(&(&rounding.a * &size_phi))
            + (&rounding.k * &size_phi)[0]
            + size_psi.dot(&rounding.b.column(0));
        let rounding = first + moved * moved;
        (rounding.is_finite() && gain.iter().all(|v| v.is_finite())).then_some(Found { rounding, gain })
    }

    /// `φ = (z − A)⁻¹B` and `ψ = (K(z − A)⁻¹)ᵀ`.
    fn resolvent(&self, place: Place) -> Option<(DVector<Complex64>, DVector<Complex64>)> {
        let OneInput { a, b, k, .. } = self.of;
        let n = a.nrows();
        let (b, k) = (b.column(0).into_owned(), k.transpose().column(0).into_owned());
        if let Place::Axis(omega) = place
            && omega > self.size
        {
            // −(A + jω)(ω² + A²)⁻¹: the real parts fall faster than the imaginary ones, and keep their digits.
            let square = (*a * *a) + DMatrix::identity(n, n) * (omega * omega);
            let right = square.clone().lu().solve(&b)?;
            let left = square.transpose().lu().solve(&k)?;
            let complex = |real: DVector<f64>, imaginary: DVector<f64>| {
                real.zip_map(&imaginary, |re, im| Complex64::new(-re, -omega * im))
            };
            return Some((complex(*a * &right, right), complex(a.tr_mul(&left), left)));
        }
        let point = match place {
            Place::Axis(omega) => Complex64::new(0.0, omega),
            Place::Circle(cosine, sine) => Complex64::new(cosine, sine),
            Place::Infinity => return None,
        };
        let complex = |v: f64| Complex64::new(v, 0.0);
        let pencil = DMatrix::from_diagonal_element(n, n, point) - a.map(complex);
        let phi = pencil.clone().lu().solve(&b.map(complex))?;
        let psi = pencil.transpose().lu().solve(&k.map(complex))?;
        Some((phi, psi))
    }
}
