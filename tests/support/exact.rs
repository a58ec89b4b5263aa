//! Rational arithmetic for proofs in tests, apart from everything that the program computes with.
#![allow(dead_code)]

use nalgebra::DMatrix;
use num_bigint::BigInt;
use num_rational::BigRational;
use num_traits::{One, Signed, Zero};

pub type Matrix = Vec<Vec<BigRational>>;

pub fn exact(m: &DMatrix<f64>) -> Matrix {
    m.row_iter().map(|row| row.iter().map(|v| BigRational::from_float(*v).unwrap()).collect()).collect()
}

pub fn transpose(m: &Matrix) -> Matrix {
    (0..m[0].len()).map(|j| m.iter().map(|row| row[j].clone()).collect()).collect()
}

pub fn product(a: &Matrix, b: &Matrix) -> Matrix {
    let columns = b[0].len();
    a.iter().map(|row| (0..columns).map(|j| row.iter().zip(b).map(|(x, r)| x * &r[j]).sum()).collect()).collect()
}

pub fn combined(a: &Matrix, b: &Matrix, factor: i64) -> Matrix {
    let factor = BigRational::from_integer(factor.into());
    a.iter().zip(b).map(|(x, y)| x.iter().zip(y).map(|(x, y)| x + &factor * y).collect()).collect()
}

/// The solution of a square system with several right sides, by elimination.
pub fn solve(a: &Matrix, b: &Matrix) -> Option<Matrix> {
    let n = a.len();
    let mut rows: Vec<Vec<BigRational>> = a.iter().zip(b).map(|(x, y)| [x.clone(), y.clone()].concat()).collect();
    for i in 0..n {
        let pivot = (i..n).find(|r| !rows[*r][i].is_zero())?;
        rows.swap(i, pivot);
        let inverse = BigRational::one() / &rows[i][i];
        rows[i].iter_mut().for_each(|v| *v *= &inverse);
        for r in (0..n).filter(|r| *r != i) {
            let factor = rows[r][i].clone();
            if factor.is_zero() {
                continue;
            }
            let line = rows[i].clone();
            rows[r].iter_mut().zip(&line).for_each(|(v, l)| *v -= &factor * l);
        }
    }
    Some(rows.into_iter().map(|row| row[n..].to_vec()).collect())
}

/// Whether a symmetric matrix is positive definite, by its pivots.
pub fn is_definite(m: &Matrix) -> bool {
    let n = m.len();
    let mut rows = m.clone();
    for i in 0..n {
        if !rows[i][i].is_positive() {
            return false;
        }
        for r in i + 1..n {
            let factor = &rows[r][i] / &rows[i][i];
            let line = rows[i].clone();
            rows[r].iter_mut().zip(&line).for_each(|(v, l)| *v -= &factor * l);
        }
    }
    true
}

/// The coefficients of `det(xI − M)` from x⁰, by Faddeev's and Leverrier's recursion.
pub fn characteristic(m: &Matrix) -> Vec<BigRational> {
    let n = m.len();
    let mut coefficients = vec![BigRational::zero(); n + 1];
    coefficients[n] = BigRational::one();
    let mut power: Matrix = vec![vec![BigRational::zero(); n]; n];
    for k in 1..=n {
        power = product(m, &power);
        for (i, row) in power.iter_mut().enumerate() {
            row[i] += &coefficients[n - k + 1];
        }
        let trace: BigRational = product(m, &power).iter().enumerate().map(|(i, row)| row[i].clone()).sum();
        coefficients[n - k] = -trace / BigRational::from_integer((k as i64).into());
    }
    coefficients
}

/// `|p(jω)|²` in x = ω².
pub fn on_axis(p: &[BigRational]) -> Vec<BigRational> {
    let mut squared = vec![BigRational::zero(); p.len()];
    for (i, a) in p.iter().enumerate() {
        for (j, b) in p.iter().enumerate().filter(|(j, _)| (i + j) % 2 == 0) {
            // (jω)^i (−jω)^j = ω^(i+j) (−1)^((i−j)/2).
            let sign = if (i as i64 - j as i64).rem_euclid(4) == 0 { 1 } else { -1 };
            squared[(i + j) / 2] += a * b * BigRational::from_integer(sign.into());
        }
    }
    squared
}

/// `|p(e^jθ)|²` in y = (1 − cos θ)/2.
pub fn on_circle(p: &[BigRational]) -> Vec<BigRational> {
    let n = p.len();
    let integer = |v: i64| BigRational::from_integer(v.into());
    let mut chebyshev: Vec<Vec<BigRational>> = vec![vec![integer(1)], vec![integer(1), integer(-2)]];
    while chebyshev.len() < n {
        let (last, before) = (&chebyshev[chebyshev.len() - 1], &chebyshev[chebyshev.len() - 2]);
        let mut next = vec![BigRational::zero(); last.len() + 1];
        for (i, c) in last.iter().enumerate() {
            next[i] += c * integer(2);
            next[i + 1] -= c * integer(4);
        }
        before.iter().enumerate().for_each(|(i, c)| next[i] -= c);
        chebyshev.push(next);
    }
    let mut squared = vec![BigRational::zero(); n];
    for lag in 0..n {
        let sum: BigRational = (0..n - lag).map(|i| &p[i] * &p[i + lag]).sum();
        let factor = sum * integer(if lag == 0 { 1 } else { 2 });
        chebyshev[lag].iter().enumerate().for_each(|(i, c)| squared[i] += &factor * c);
    }
    squared
}

pub fn value(p: &[BigRational], x: &BigRational) -> BigRational {
    p.iter().rev().fold(BigRational::zero(), |sum, c| sum * x + c)
}

/// Whether a polynomial is positive on [low, high], or on [low, ∞), by Sturm's chain.
pub fn is_positive_on(p: &[BigRational], low: &BigRational, high: Option<&BigRational>) -> bool {
    let trimmed = |p: Vec<BigRational>| {
        let degree = p.iter().rposition(|c| !c.is_zero()).map_or(0, |d| d + 1);
        p.into_iter().take(degree).collect::<Vec<_>>()
    };
    let primitive = |p: Vec<BigRational>| {
        let size = p.iter().map(|c| c.abs()).max().unwrap_or_else(BigRational::one);
        p.into_iter().map(|c| c / &size).collect::<Vec<_>>()
    };
    let first = trimmed(p.to_vec());
    if first.is_empty() {
        return false;
    }
    let derivative: Vec<BigRational> =
        first.iter().enumerate().skip(1).map(|(i, c)| c * BigRational::from_integer(BigInt::from(i))).collect();
    let mut chain = vec![first, derivative];
    while chain[chain.len() - 1].len() > 1 {
        let (mut rest, by) = (chain[chain.len() - 2].clone(), &chain[chain.len() - 1]);
        while rest.len() >= by.len() {
            let factor = &rest[rest.len() - 1] / &by[by.len() - 1];
            let offset = rest.len() - by.len();
            by.iter().enumerate().for_each(|(i, c)| rest[i + offset] -= &factor * c);
            rest.pop();
        }
        let rest = trimmed(rest);
        if rest.is_empty() {
            break;
        }
        chain.push(primitive(rest.into_iter().map(|c| -c).collect()));
    }
    let changes = |signs: Vec<BigRational>| {
        let signs: Vec<bool> = signs.into_iter().filter(|v| !v.is_zero()).map(|v| v.is_positive()).collect();
        signs.windows(2).filter(|pair| pair[0] != pair[1]).count()
    };
    let at = |x: &BigRational| changes(chain.iter().map(|p| value(p, x)).collect());
    let at_end = high.map_or_else(|| changes(chain.iter().map(|p| p[p.len() - 1].clone()).collect()), at);
    let is_positive_at_end =
        high.map_or_else(|| chain[0][chain[0].len() - 1].is_positive(), |x| value(p, x).is_positive());
    value(p, low).is_positive() && is_positive_at_end && at(low) == at_end
}
