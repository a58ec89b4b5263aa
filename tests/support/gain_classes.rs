//! Random gains whose verdict is known, by construction or in rational arithmetic.

use crate::exact;
use nalgebra::DMatrix;
use num_rational::BigRational;
use num_traits::{One, Signed, Zero};
use rand::{Rng, RngExt};
use volition::control::lqg::lqr;
use volition::control::lyapunov::Clock;
use volition::inverse::Verdict;
use volition::num::linalg::eigenvalues;

/// A plant and a gain of one input.
pub struct Member {
    pub a: DMatrix<f64>,
    pub b: DMatrix<f64>,
    pub k: DMatrix<f64>,
    pub clock: Clock,
}

/// Random orthogonal coordinates.
pub fn rotation(n: usize, stream: &mut impl Rng) -> DMatrix<f64> {
    DMatrix::from_fn(n, n, |_, _| stream.random_range(-1.0..1.0)).qr().q()
}

impl Member {
    pub fn rotated(&self, stream: &mut impl Rng) -> Self {
        let q = rotation(self.a.nrows(), stream);
        Self { a: q.tr_mul(&(&self.a * &q)), b: q.tr_mul(&self.b), k: &self.k * &q, clock: self.clock }
    }
}

pub fn random(rows: usize, columns: usize, stream: &mut impl Rng) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| stream.random_range(-1.0..1.0))
}

pub fn definite(n: usize, least: f64, stream: &mut impl Rng) -> DMatrix<f64> {
    let root = random(n, n, stream);
    &root * root.transpose() + DMatrix::identity(n, n) * least
}

pub fn clock_of(stream: &mut impl Rng) -> Clock {
    if stream.random::<bool>() { Clock::Continuous } else { Clock::Sampled }
}

pub fn stabilising(stream: &mut impl Rng) -> Option<Member> {
    let n = stream.random_range(2..=6);
    let clock = clock_of(stream);
    let (a, b) = (random(n, n, stream), random(n, 1, stream));
    let near = lqr(&a, &b, &DMatrix::identity(n, n), &DMatrix::identity(1, 1), clock).ok()?.k;
    let size = near.norm() * stream.random_range(0.0..0.8);
    let k = &near + random(1, n, stream) * size;
    let poles = eigenvalues(&(&a - &b * &k)).unwrap();
    poles.iter().all(|pole| clock.margin(*pole) > 1e-6).then_some(Member { a, b, k, clock })
}

/// A loop of 16 to 64 states with eight inputs, mixed by rotations: eight channels of which all are optimal, or one is
/// not, by rational arithmetic.
pub fn large(worst: Verdict, stream: &mut impl Rng) -> Option<Member> {
    let channels = 8;
    let which = stream.random_range(0..channels);
    let clock = clock_of(stream);
    let mut parts: Vec<Member> = Vec::new();
    for channel in 0..channels {
        loop {
            let n = stream.random_range(2..=8usize);
            let (a, b) = (random(n, n, stream), random(n, 1, stream));
            let r = DMatrix::from_element(1, 1, 1.0);
            let Some(k) = lqr(&a, &b, &definite(n, 0.1, stream), &r, clock).ok().map(|found| found.k) else { continue };
            if worst == Verdict::Feasible || channel != which {
                parts.push(Member { a, b, k, clock });
                break;
            }
            let Some(member) = stabilising(stream) else { continue };
            if member.clock == clock && truth(&member) == Verdict::Infeasible {
                parts.push(member);
                break;
            }
        }
    }
    let n: usize = parts.iter().map(|part| part.a.nrows()).sum();
    let (mut a, mut b, mut k) = (DMatrix::zeros(n, n), DMatrix::zeros(n, channels), DMatrix::zeros(channels, n));
    let mut at = 0;
    for (i, part) in parts.iter().enumerate() {
        let size = part.a.nrows();
        a.view_mut((at, at), (size, size)).copy_from(&part.a);
        b.view_mut((at, i), (size, 1)).copy_from(&part.b);
        k.view_mut((i, at), (1, size)).copy_from(&part.k);
        at += size;
    }
    let turn = rotation(channels, stream);
    Some(Member { a, b: b * turn.transpose(), k: turn * k, clock }.rotated(stream))
}

/// The verdict on the doubles as they stand, in rational arithmetic: Kalman's polynomial and Sturm's chain.
pub fn truth(member: &Member) -> Verdict {
    let (a, b, k) = (exact::exact(&member.a), exact::exact(&member.b), exact::exact(&member.k));
    let closed = exact::combined(&a, &exact::product(&b, &k), -1);
    let (open, closed) = (exact::characteristic(&a), exact::characteristic(&closed));
    let n = a.len();
    let (zero, one) = (BigRational::zero(), BigRational::one());
    let is_feasible = match member.clock {
        Clock::Continuous => {
            let mut numerator: Vec<BigRational> =
                exact::on_axis(&closed).iter().zip(&exact::on_axis(&open)).map(|(x, y)| x - y).collect();
            numerator.truncate(n);
            numerator[n - 1].is_positive() && exact::is_positive_on(&numerator, &zero, None)
        }
        Clock::Sampled => {
            let rho = &closed[0] / &open[0];
            let numerator: Vec<BigRational> = exact::on_circle(&closed)
                .iter()
                .zip(&exact::on_circle(&open))
                .map(|(x, y)| x - &rho * y)
                .take(n)
                .collect();
            rho.is_positive() && exact::is_positive_on(&numerator, &zero, Some(&one))
        }
    };
    if is_feasible { Verdict::Feasible } else { Verdict::Infeasible }
}
