//! Characteristic polynomials of integer matrices, exactly.
//!
//! Modulo many primes by reduction to Hessenberg form (Cohen, A Course in Computational Algebraic Number Theory, 1993,
//! algorithm 2.2.9), and together by the Chinese remainder theorem: `n³` operations a prime, and one prime for every 61
//! bits of the largest coefficient.

use crate::ctl::{Ctl, Stopped};
use num_bigint::{BigInt, Sign};

/// Primes are taken from here downwards: products of two residues fit 128 bits with room to spare.
const LARGEST: u64 = (1 << 62) - 1;

/// Arithmetic modulo an odd number below 2⁶², in Montgomery's form (Montgomery, Math. Comp. 44, 519–521, 1985).
#[derive(Debug, Clone, Copy)]
struct Field {
    p: u64,
    /// `−p⁻¹ mod 2⁶⁴`.
    inverse: u64,
    /// `2¹²⁸ mod p`.
    square: u64,
}

impl Field {
    fn new(p: u64) -> Self {
        // Newton's iteration doubles the correct bits of p⁻¹: 3, 6, .. 96.
        let mut inverse = p.wrapping_mul(3) ^ 2;
        for _ in 0..5 {
            inverse = inverse.wrapping_mul(2u64.wrapping_sub(p.wrapping_mul(inverse)));
        }
        let radix = (u128::from(u64::MAX) % u128::from(p) + 1) % u128::from(p);
        let square = (radix * radix % u128::from(p)) as u64;
        Self { p, inverse: inverse.wrapping_neg(), square }
    }

    fn reduce(self, value: u128) -> u64 {
        let factor = (value as u64).wrapping_mul(self.inverse);
        let sum = (value + u128::from(factor) * u128::from(self.p)) >> 64;
        let sum = sum as u64;
        if sum >= self.p { sum - self.p } else { sum }
    }

    fn mul(self, a: u64, b: u64) -> u64 {
        self.reduce(u128::from(a) * u128::from(b))
    }

    fn sub(self, a: u64, b: u64) -> u64 {
        if a >= b { a - b } else { a + self.p - b }
    }

    /// Into Montgomery's form.
    fn enter(self, a: u64) -> u64 {
        self.mul(a, self.square)
    }

    /// And out of it.
    fn leave(self, a: u64) -> u64 {
        self.reduce(u128::from(a))
    }

    fn pow(self, base: u64, mut exponent: u64) -> u64 {
        let (mut base, mut result) = (base, self.enter(1));
        while exponent > 0 {
            if exponent & 1 == 1 {
                result = self.mul(result, base);
            }
            base = self.mul(base, base);
            exponent >>= 1;
        }
        result
    }

    fn invert(self, a: u64) -> u64 {
        self.pow(a, self.p - 2)
    }

    /// Whether p is prime, by the test of Miller and Rabin with the bases that decide below 2⁶⁴ (Sorenson and Webster,
    /// Math. Comp. 86, 985–1003, 2017).
    fn is_prime(self) -> bool {
        let (one, minus_one) = (self.enter(1), self.enter(self.p - 1));
        let shift = (self.p - 1).trailing_zeros();
        [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37].into_iter().all(|base| {
            let mut x = self.pow(self.enter(base), (self.p - 1) >> shift);
            if x == one || x == minus_one {
                return true;
            }
            (1..shift).any(|_| {
                x = self.mul(x, x);
                x == minus_one
            })
        })
    }
}

/// A residue of an integer, in Montgomery's form.
fn residue(value: &BigInt, field: Field) -> u64 {
    let magnitude = value.magnitude().iter_u64_digits().rev();
    // Digit by digit from the top: x ← x·2⁶⁴ + digit.
    let radix = field.enter(field.leave(field.square));
    let x = magnitude.fold(0, |x, digit| {
        let sum = u128::from(field.mul(x, radix)) + u128::from(field.enter(digit % field.p));
        (sum % u128::from(field.p)) as u64
    });
    if value.sign() == Sign::Minus { field.sub(0, x) } else { x }
}

/// The coefficients of `det(xI − M)` modulo the prime, from x⁰ to xⁿ; M by rows, overwritten.
fn modular(m: &mut [u64], n: usize, field: Field) -> Vec<u64> {
    for k in 0..n.saturating_sub(2) {
        let Some(pivot) = (k + 1..n).find(|i| m[i * n + k] != 0) else { continue };
        if pivot != k + 1 {
            for j in 0..n {
                m.swap(pivot * n + j, (k + 1) * n + j);
            }
            for i in 0..n {
                m.swap(i * n + pivot, i * n + k + 1);
            }
        }
        let inverse = field.invert(m[(k + 1) * n + k]);
        for i in k + 2..n {
            if m[i * n + k] == 0 {
                continue;
            }
            let factor = field.mul(m[i * n + k], inverse);
            for j in k..n {
                m[i * n + j] = field.sub(m[i * n + j], field.mul(factor, m[(k + 1) * n + j]));
            }
            for row in 0..n {
                let sum = m[row * n + k + 1] + field.mul(factor, m[row * n + i]);
                m[row * n + k + 1] = if sum >= field.p { sum - field.p } else { sum };
            }
        }
    }
    // p_k of the leading k×k block: p_{k+1} = (x − h_kk) p_k − Σ_i h_ik (h_{i+1,i} … h_{k,k−1}) p_i.
    let mut polynomials: Vec<Vec<u64>> = vec![vec![field.enter(1)]];
    for k in 0..n {
        let mut next = vec![0; k + 2];
        next[1..].copy_from_slice(&polynomials[k]);
        let mut product = field.enter(1);
        for i in (0..=k).rev() {
            let factor = field.mul(m[i * n + k], product);
            for (to, from) in next.iter_mut().zip(&polynomials[i]) {
                *to = field.sub(*to, field.mul(factor, *from));
            }
            if i > 0 {
                product = field.mul(product, m[i * n + i - 1]);
            }
        }
        polynomials.push(next);
    }
    polynomials.swap_remove(n)
}

/// The coefficients of `det(xI − M)`, from x⁰ to xⁿ, for an n×n integer matrix given by rows.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub(crate) fn characteristic_polynomial(m: &[BigInt], n: usize, ctl: &Ctl) -> Result<Vec<BigInt>, Stopped> {
    // No eigenvalue exceeds the largest sum over a row, so no coefficient exceeds (1 + that sum)ⁿ.
    let row = |i: usize| m[i * n..(i + 1) * n].iter().map(|v| v.magnitude().bits()).max().unwrap_or(0);
    let bits = (0..n).map(row).max().unwrap_or(0) + u64::from((n as u64 + 1).ilog2() + 1) + 1;
    let needed = n as u64 * bits + 2;
    let mut coefficients = vec![BigInt::ZERO; n + 1];
    let mut modulus = BigInt::from(1);
    let mut candidate = LARGEST;
    while modulus.bits() <= needed {
        ctl.check()?;
        let field = loop {
            candidate -= 2;
            let field = Field::new(candidate);
            if field.is_prime() {
                break field;
            }
        };
        let mut copy: Vec<u64> = m.iter().map(|v| residue(v, field)).collect();
        let found = modular(&mut copy, n, field);
        let inverse = field.invert(residue(&modulus, field));
        for (whole, part) in coefficients.iter_mut().zip(found) {
            let step = field.leave(field.mul(field.sub(part, residue(whole, field)), inverse));
            *whole += &modulus * step;
        }
        modulus *= field.p;
    }
    // Residues from 0 to the modulus stand for numbers around zero.
    let half = &modulus >> 1;
    Ok(coefficients.into_iter().map(|c| if c > half { c - &modulus } else { c }).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn integers(values: &[i64]) -> Vec<BigInt> {
        values.iter().map(|v| BigInt::from(*v)).collect()
    }

    #[test]
    fn small_matrices_have_their_polynomials() {
        let of = |m: &[i64], n| characteristic_polynomial(&integers(m), n, &Ctl::new()).unwrap();
        assert_eq!(of(&[7], 1), integers(&[-7, 1]));
        assert_eq!(of(&[1, 2, 3, 4], 2), integers(&[-2, -5, 1]));
        assert_eq!(of(&[0, 1, 0, 0, 0, 1, 6, -11, 6], 3), integers(&[-6, 11, -6, 1]));
        // A zero below the diagonal, and a pivot that is not where it is looked for.
        assert_eq!(of(&[2, 0, 0, 0, 3, 0, 5, 0, 4], 3), integers(&[-24, 26, -9, 1]));
        assert_eq!(of(&[0; 9], 3), integers(&[0, 0, 0, 1]));
    }

    #[test]
    fn a_matrix_satisfies_its_polynomial() {
        // Cayley and Hamilton, with entries of 80 bits.
        let n = 5;
        let m: Vec<BigInt> = (0..n * n)
            .map(|i| (BigInt::from(i as i64 * 7919 - 60_000) << 64) + BigInt::from((i * i * 104_729) as i64))
            .collect();
        let p = characteristic_polynomial(&m, n, &Ctl::new()).unwrap();
        let product = |a: &[BigInt], b: &[BigInt]| -> Vec<BigInt> {
            (0..n * n).map(|e| (0..n).map(|k| &a[e / n * n + k] * &b[k * n + e % n]).sum()).collect()
        };
        let mut sum = vec![BigInt::ZERO; n * n];
        for coefficient in p.iter().rev() {
            sum = product(&sum, &m);
            for i in 0..n {
                sum[i * n + i] += coefficient;
            }
        }
        assert!(sum.iter().all(|v| *v == BigInt::ZERO));
    }
}
