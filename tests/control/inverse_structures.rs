//! Structures of weights: a verdict against one rests on a multiplier, checked in rational arithmetic.

use crate::gain_classes::{Member, clock_of, definite, random};
use crate::inverse_boundary::SEED;
use crate::inverse_certificates::multiplied;
use nalgebra::{DMatrix, DVector};
use num_traits::Signed;
use rand::{Rng, RngExt};
use volition::control::lqg::lqr;
use volition::control::lyapunov::{Clock, Lyapunov};
use volition::ctl::Ctl;
use volition::inverse::{Gains, InverseLqr, Settings, Structure, Verdict, inverse_lqr};
use volition::num::rng;

fn ask(member: &Member, structure: &Structure) -> Option<InverseLqr> {
    let gains = Gains::regulator(&member.a, &member.b, &member.k, member.clock).ok()?;
    let settings = Settings { structure: structure.clone(), ..Settings::default() };
    Some(inverse_lqr(&gains, &settings, &Ctl::new()).unwrap())
}

/// An optimal gain of dense weights, which diagonal ones make optimal by chance alone where inputs are several.
fn dense(n: usize, m: usize, stream: &mut impl Rng) -> Option<Member> {
    let clock = clock_of(stream);
    let (a, b) = (random(n, n, stream), random(n, m, stream));
    let k = lqr(&a, &b, &definite(n, 0.1, stream), &definite(m, 0.1, stream), clock).ok()?.k;
    Some(Member { a, b, k, clock })
}

/// For a diagonal Q the entries of X off its diagonal are free: it completes to a definite matrix where its diagonal is
/// positive. T likewise where R is diagonal.
#[test]
fn multipliers_against_diagonal_weights_hold_in_rational_arithmetic() {
    let mut stream = rng::stream(SEED, "diagonal weights");
    let (mut proven, mut asked) = (0, 0);
    while asked < 80 {
        let (n, m) = (stream.random_range(2..=4usize), 2);
        let Some(member) = dense(n, m, &mut stream) else { continue };
        let structure =
            Structure { r_pattern: Some(DMatrix::from_fn(m, m, |i, j| i == j)), ..Structure::diagonal_q(n) };
        let Some(found) = ask(&member, &structure) else { continue };
        asked += 1;
        assert_ne!(found.verdict, Verdict::Feasible, "{found:?}");
        assert_eq!(found.verdict == Verdict::Infeasible, found.refutation.is_some());
        let Some(refutation) = found.refutation else { continue };
        let [x, t] = multiplied(&member, &refutation.n);
        for (name, matrix) in [("X", &x), ("T", &t)] {
            assert!((0..matrix.len()).all(|i| matrix[i][i].is_positive()), "{name}: {refutation:?}");
        }
        proven += 1;
    }
    eprintln!("{proven} of {asked} refuted");
    assert!(proven >= 76, "{proven} of {asked}");
}

/// The stabilising gain of one input for a diagonal Q of any sign and R = 1, by Newton's method (Kleinman, IEEE Trans.
/// Autom. Control 13, 114–115, 1968); none where that does not end.
fn gain_of(a: &DMatrix<f64>, b: &DMatrix<f64>, q: &DVector<f64>, clock: Clock) -> Option<DMatrix<f64>> {
    let (n, one) = (a.nrows(), DMatrix::identity(1, 1));
    let mut k = lqr(a, b, &DMatrix::identity(n, n), &one, clock).ok()?.k;
    for _ in 0..60 {
        let equation = Lyapunov::new(&(a - b * &k), clock).ok().filter(Lyapunov::is_stable)?;
        let p = equation.solve(&(DMatrix::from_diagonal(q) + k.tr_mul(&k)));
        let next = match clock {
            Clock::Continuous => b.tr_mul(&p),
            Clock::Sampled => {
                let weight = (&one + b.tr_mul(&(&p * b)))[(0, 0)];
                (weight > 0.0).then(|| b.tr_mul(&(&p * a)) / weight)?
            }
        };
        if (&next - &k).norm() <= 1e-14 * k.norm() {
            return Some(next);
        }
        k = next;
    }
    None
}

/// One input and a diagonal Q: the weights of a gain are unique, and one of them is negative here.
#[test]
fn a_negative_weight_is_no_weight() {
    let mut stream = rng::stream(SEED, "negative weights");
    let (mut infeasible, mut asked) = (0, 0);
    while asked < 300 {
        let n = stream.random_range(2..=5usize);
        let clock = clock_of(&mut stream);
        let (a, b) = (random(n, n, &mut stream), random(n, 1, &mut stream));
        let mut q = DVector::from_fn(n, |_, _| stream.random_range(0.2..1.0));
        q[stream.random_range(0..n)] = -stream.random_range(0.01..0.2);
        let Some(k) = gain_of(&a, &b, &q, clock) else { continue };
        let member = Member { a, b, k, clock };
        let Some(found) = ask(&member, &Structure::diagonal_q(n)) else { continue };
        asked += 1;
        assert_ne!(found.verdict, Verdict::Feasible, "{q:?}: {found:?}");
        infeasible += usize::from(found.verdict == Verdict::Infeasible);
    }
    eprintln!("{infeasible} of {asked} infeasible");
    assert!(infeasible >= 285, "{infeasible} of {asked}");
}
