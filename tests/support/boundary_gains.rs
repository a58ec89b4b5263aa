//! Gains on the boundary of optimality to sixty digits before they are rounded, and exact verdicts on others.

use crate::gain_classes::{Member, clock_of, definite, random, rotation};
use nalgebra::DMatrix;
use num_bigint::BigInt;
use num_rational::BigRational;
use num_traits::{One, Signed, ToPrimitive, Zero};
use rand::{Rng, RngExt};
use volition::control::lqg::lqr;
use volition::control::lyapunov::Clock;
use volition::inverse::Verdict;

/// Bits after the point.
const BITS: u32 = 220;

fn fixed(v: f64) -> BigInt {
    (BigRational::from_float(v).unwrap() * BigRational::from_integer(BigInt::one() << BITS)).to_integer()
}

fn float(v: &BigInt) -> f64 {
    BigRational::new(v.clone(), BigInt::one() << BITS).to_f64().unwrap()
}

fn times(a: &BigInt, b: &BigInt) -> BigInt {
    (a * b) >> BITS
}

fn over(a: &BigInt, b: &BigInt) -> BigInt {
    (a << BITS) / b
}

fn polynomial(roots: &[(f64, f64)]) -> Vec<f64> {
    // Factors s² + ps + q, or s + p where q is NaN; from s⁰.
    roots.iter().fold(vec![1.0], |p, (b, c)| {
        let factor = if c.is_nan() { vec![*b, 1.0] } else { vec![*c, *b, 1.0] };
        let mut product = vec![0.0; p.len() + factor.len() - 1];
        for (i, x) in p.iter().enumerate() {
            for (j, y) in factor.iter().enumerate() {
                product[i + j] += x * y;
            }
        }
        product
    })
}

/// The value of `p*p` as coefficients: autocorrelation (circle), or even coefficients of p(s)p(−s) (axis).
fn square(p: &[BigInt], q: &[BigInt], clock: Clock) -> Vec<BigInt> {
    let n = p.len();
    let mut all = vec![BigInt::zero(); n];
    for i in 0..n {
        for j in 0..n {
            match clock {
                Clock::Sampled if j >= i => all[j - i] += times(&p[i], &q[j]),
                Clock::Continuous if (i + j) % 2 == 0 => {
                    let term = times(&p[i], &q[j]);
                    if j % 2 == 0 { all[(i + j) / 2] += term } else { all[(i + j) / 2] -= term }
                }
                _ => {}
            }
        }
    }
    all
}

fn solve(mut rows: Vec<Vec<BigInt>>) -> Vec<BigInt> {
    let n = rows.len();
    for i in 0..n {
        let pivot = (i..n).max_by_key(|r| rows[*r][i].abs()).unwrap();
        rows.swap(i, pivot);
        for r in (0..n).filter(|r| *r != i) {
            let factor = over(&rows[r][i], &rows[i][i]);
            let line = rows[i].clone();
            rows[r].iter_mut().zip(&line).for_each(|(v, l)| *v -= times(&factor, l));
        }
    }
    (0..n).map(|i| over(&rows[i][n], &rows[i][i])).collect()
}

/// The gain for which `|d_closed|² ∝ |d_open|² + |c|²`, in companion form: the regulator of the output c and R = 1, by
/// Wilson's iteration with 220 bits from the doubles of a Riccati equation.
pub fn of_output(open: &[f64], c: &[f64], clock: Clock) -> Option<Member> {
    let n = open.len() - 1;
    let a = DMatrix::from_fn(n, n, |i, j| if i + 1 < n { f64::from(u8::from(j == i + 1)) } else { -open[j] });
    let b = DMatrix::from_fn(n, 1, |i, _| f64::from(u8::from(i + 1 == n)));
    let mut output = DMatrix::zeros(1, n);
    c.iter().enumerate().for_each(|(i, v)| output[(0, i)] = *v);
    let start = lqr(&a, &b, &(output.tr_mul(&output)), &DMatrix::identity(1, 1), clock).ok()?;
    let (exact_open, mut exact_c) =
        (open.iter().map(|v| fixed(*v)).collect::<Vec<_>>(), c.iter().map(|v| fixed(*v)).collect::<Vec<_>>());
    exact_c.resize(n + 1, BigInt::zero());
    let wanted: Vec<BigInt> = square(&exact_open, &exact_open, clock)
        .into_iter()
        .zip(square(&exact_c, &exact_c, clock))
        .map(|(x, y)| x + y)
        .collect();
    // √S d_closed, with the leading coefficient as an unknown.
    let s = match clock {
        Clock::Continuous => 1.0,
        Clock::Sampled => (1.0 + (b.transpose() * &start.p * &b)[0]).sqrt(),
    };
    let mut factor: Vec<BigInt> = (0..n).map(|i| fixed(s * (open[i] + start.k[i]))).collect();
    factor.push(fixed(s));
    for _ in 0..12 {
        let have = square(&factor, &factor, clock);
        let rows: Vec<Vec<BigInt>> = (0..=n).map(|_| Vec::new()).collect();
        let mut rows = rows;
        let columns: Vec<Vec<BigInt>> = (0..=n)
            .map(|j| {
                let mut unit = vec![BigInt::zero(); n + 1];
                unit[j] = BigInt::one() << BITS;
                let (one, two) = (square(&factor, &unit, clock), square(&unit, &factor, clock));
                one.into_iter().zip(two).map(|(x, y)| x + y).collect()
            })
            .collect();
        for (i, row) in rows.iter_mut().enumerate() {
            row.extend(columns.iter().map(|column| column[i].clone()));
            row.push(&wanted[i] - &have[i]);
        }
        let step = solve(rows);
        factor.iter_mut().zip(&step).for_each(|(f, s)| *f += s);
    }
    let k = DMatrix::from_fn(1, n, |_, j| float(&(over(&factor[j], &factor[n]) - &exact_open[j])));
    Some(Member { a, b, k, clock })
}

/// An open polynomial of degree n with roots of moderate size, some unstable.
pub fn open(n: usize, clock: Clock, stream: &mut impl Rng) -> Vec<f64> {
    let mut factors = Vec::new();
    let mut left = n;
    while left > 0 {
        if left >= 2 && stream.random::<bool>() {
            let (size, cosine) = (stream.random_range(0.4..1.6_f64), stream.random_range(-0.9..0.9_f64));
            factors.push((-2.0 * size * cosine, size * size));
            left -= 2;
        } else {
            let root = match clock {
                Clock::Continuous => stream.random_range(-2.0..2.0_f64),
                Clock::Sampled => stream.random_range(0.3..1.5_f64) * if stream.random::<bool>() { 1.0 } else { -1.0 },
            };
            factors.push((-root, f64::NAN));
            left -= 1;
        }
    }
    polynomial(&factors)
}

/// An output whose response vanishes on the axis or circle, for a plant of order n: at zero frequency, within, or at
/// the highest.
pub fn touching(n: usize, clock: Clock, stream: &mut impl Rng) -> Vec<f64> {
    let mut factors = Vec::new();
    let mut left = n - 1;
    match (clock, stream.random_range(0..3)) {
        (Clock::Continuous, 0) => factors.push((0.0, f64::NAN)),
        (Clock::Continuous, 1) if n >= 3 => factors.push((0.0, stream.random_range(0.2..4.0))),
        // One degree less: the response vanishes faster at infinity.
        (Clock::Continuous, _) => {
            left -= 1;
        }
        (Clock::Sampled, 0) => factors.push((-1.0, f64::NAN)),
        (Clock::Sampled, 1) if n >= 3 => factors.push((-2.0 * stream.random_range(-0.9..0.9_f64), 1.0)),
        (Clock::Sampled, _) => factors.push((1.0, f64::NAN)),
    }
    left -= factors.iter().map(|(_, c): &(f64, f64)| if c.is_nan() { 1 } else { 2 }).sum::<usize>().min(left);
    for _ in 0..left {
        factors.push((stream.random_range(0.2..0.9), f64::NAN));
    }
    let size = 10f64.powf(stream.random_range(-0.5..0.7));
    polynomial(&factors).into_iter().map(|v| v * size).collect()
}

pub fn second_order(a: [f64; 2], k: [f64; 2]) -> Member {
    Member {
        a: DMatrix::from_row_slice(2, 2, &[0.0, 1.0, a[0], a[1]]),
        b: DMatrix::from_row_slice(2, 1, &[0.0, 1.0]),
        k: DMatrix::from_row_slice(1, 2, &k),
        clock: Clock::Continuous,
    }
}

pub fn optimal_of_several(n: usize, m: usize, stream: &mut impl Rng) -> Option<Member> {
    let clock = clock_of(stream);
    let (a, b) = (random(n, n, stream), random(n, m, stream));
    let k = lqr(&a, &b, &definite(n, 0.1, stream), &definite(m, 0.1, stream), clock).ok()?.k;
    Some(Member { a, b, k, clock })
}

/// Channels side by side, mixed by rotations of states and inputs: as good as the worst.
pub fn mixed(worst: Verdict, stream: &mut impl Rng) -> Option<Member> {
    let channels = stream.random_range(2..=3usize);
    let which = stream.random_range(0..channels);
    let mut parts = Vec::new();
    for channel in 0..channels {
        let member = if channel != which {
            let a = stream.random_range(0.2..2.0_f64);
            let (q, d) = (stream.random_range(0.5..5.0_f64), stream.random_range(0.5..4.0_f64));
            let k1 = a + a.hypot(q.sqrt());
            second_order([a, 0.0], [k1, (2.0 * k1 + d).sqrt()])
        } else {
            let a = stream.random_range(0.2..2.0_f64);
            // k₁ = 2a is the boundary; below it no weight on the position is negative enough.
            let share = match worst {
                Verdict::Boundary => 2.0,
                _ => stream.random_range(1.1..1.9),
            };
            second_order([a, 0.0], [share * a, (8.0 * a + stream.random_range(0.5..4.0)).sqrt()])
        };
        parts.push(member);
    }
    let (n, m) = (2 * channels, channels);
    let (mut a, mut b, mut k) = (DMatrix::zeros(n, n), DMatrix::zeros(n, m), DMatrix::zeros(m, n));
    for (i, part) in parts.iter().enumerate() {
        a.view_mut((2 * i, 2 * i), (2, 2)).copy_from(&part.a);
        b.view_mut((2 * i, i), (2, 1)).copy_from(&part.b);
        k.view_mut((i, 2 * i), (1, 2)).copy_from(&part.k);
    }
    let turn = rotation(m, stream);
    let whole = Member { a, b: b * turn.transpose(), k: turn * k, clock: Clock::Continuous };
    Some(whole.rotated(stream))
}
