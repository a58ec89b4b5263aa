//! Primitive polynomials over GF(2) and GF(3), and the sequences of maximum length that they generate.
//!
//! A recurrence `s[t+n] = c₀ s[t] + c₁ s[t+1] + … + c_{n−1} s[t+n−1]` over GF(p) repeats after pⁿ − 1 digits, the
//! longest possible, exactly where its polynomial `f(x) = xⁿ − c_{n−1} xⁿ⁻¹ − … − c₀` is primitive: where x has the
//! order pⁿ − 1 modulo f (Golomb, *Shift Register Sequences*, 1967). There are φ(pⁿ − 1)/n such polynomials.

use crate::ctl::{Ctl, Stopped};
use crate::num::rng::Stream;
use rand::RngExt;

/// The largest order of any base.
const MOST_DIGITS: usize = 20;

/// How many candidates are tested between two looks at the handle.
const BATCH: u64 = 1024;

/// GF(2) or GF(3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Base {
    /// Digits 0 and 1.
    Two,
    /// Digits 0, 1 and 2.
    Three,
}

type Residue = [u8; MOST_DIGITS];

impl Base {
    /// p.
    #[must_use]
    pub fn p(self) -> u8 {
        match self {
            Self::Two => 2,
            Self::Three => 3,
        }
    }

    /// The largest order whose sequence can be sampled.
    #[must_use]
    pub fn largest_order(self) -> u32 {
        match self {
            Self::Two => 20,
            Self::Three => 12,
        }
    }

    /// Digits of a sequence of maximum length, pⁿ − 1.
    #[must_use]
    pub fn length(self, order: u32) -> u64 {
        u64::from(self.p()).pow(order) - 1
    }

    /// How many primitive polynomials of this order there are, φ(pⁿ − 1)/n.
    #[must_use]
    pub fn primitive_count(self, order: u32) -> u64 {
        let length = self.length(order);
        let phi = prime_factors(length).iter().fold(length, |phi, q| phi / q * (q - 1));
        phi / u64::from(order)
    }

    /// The only c₀ that a primitive polynomial can have: `(−1)ⁿ f(0) = −(−1)ⁿ c₀` must be a primitive element of GF(p).
    fn constant(self, order: u32) -> u8 {
        match self {
            Self::Three if !order.is_multiple_of(2) => 2,
            _ => 1,
        }
    }

    /// Whether these coefficients, c₀ first, generate a sequence of maximum length.
    #[must_use]
    pub fn is_primitive(self, coefficients: &[u8]) -> bool {
        let n = coefficients.len();
        if n == 0 || n > MOST_DIGITS || coefficients[0] == 0 || coefficients.iter().any(|c| *c >= self.p()) {
            return false;
        }
        let length = self.length(n as u32);
        let one = {
            let mut one = [0; MOST_DIGITS];
            one[0] = 1;
            one
        };
        // The order divides pⁿ − 1, and no quotient by a prime.
        self.power_of_x(coefficients, length) == one
            && prime_factors(length).iter().all(|q| self.power_of_x(coefficients, length / q) != one)
    }

    /// x^e modulo f, ascending powers.
    fn power_of_x(self, coefficients: &[u8], exponent: u64) -> Residue {
        let n = coefficients.len();
        let mut result = [0; MOST_DIGITS];
        result[0] = 1;
        for bit in (0..u64::BITS - exponent.leading_zeros()).rev() {
            result = self.product(coefficients, &result, &result);
            if exponent >> bit & 1 == 1 {
                self.times_x(&mut result[..n], coefficients);
            }
        }
        result
    }

    fn times_x(self, residue: &mut [u8], coefficients: &[u8]) {
        let n = residue.len();
        let carry = residue[n - 1];
        residue.copy_within(..n - 1, 1);
        residue[0] = 0;
        for (r, c) in residue.iter_mut().zip(coefficients) {
            *r = (*r + carry * c) % self.p();
        }
    }

    fn product(self, coefficients: &[u8], a: &Residue, b: &Residue) -> Residue {
        let n = coefficients.len();
        let mut sum = [0; MOST_DIGITS];
        // Horner in x: the highest power of a first.
        for digit in a[..n].iter().rev() {
            self.times_x(&mut sum[..n], coefficients);
            for (s, b) in sum[..n].iter_mut().zip(b) {
                *s = (*s + digit * b) % self.p();
            }
        }
        sum
    }

    /// The primitive coefficients number `index` in lexicographic order, c₀ first.
    ///
    /// `None` where there are fewer.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn primitive(self, order: u32, index: u64, ctl: &Ctl) -> Result<Option<Vec<u8>>, Stopped> {
        if index >= self.primitive_count(order) {
            return Ok(None);
        }
        let p = u64::from(self.p());
        let mut left = index;
        for candidate in 0..p.pow(order - 1) {
            if candidate % BATCH == 0 {
                ctl.check()?;
            }
            let coefficients = self.candidate(order, candidate);
            if self.is_primitive(&coefficients) {
                if left == 0 {
                    return Ok(Some(coefficients));
                }
                left -= 1;
            }
        }
        Ok(None)
    }

    /// Primitive coefficients drawn with equal probability.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn draw_primitive(self, order: u32, random: &mut Stream, ctl: &Ctl) -> Result<Vec<u8>, Stopped> {
        let count = u64::from(self.p()).pow(order - 1);
        loop {
            ctl.check()?;
            let coefficients = self.candidate(order, random.random_range(0..count));
            if self.is_primitive(&coefficients) {
                return Ok(coefficients);
            }
        }
    }

    /// c₀ as it must be, and the digits of `candidate`, most significant first.
    fn candidate(self, order: u32, mut candidate: u64) -> Vec<u8> {
        let p = u64::from(self.p());
        let mut coefficients = vec![self.constant(order); order as usize];
        for c in coefficients[1..].iter_mut().rev() {
            *c = (candidate % p) as u8;
            candidate /= p;
        }
        coefficients
    }

    /// One period of the sequence from the state 0 … 0 1, in digits.
    #[must_use]
    pub fn digits(self, coefficients: &[u8]) -> Vec<u8> {
        let n = coefficients.len();
        let length = self.length(n as u32) as usize;
        let mut digits = vec![0; length.max(n)];
        digits[n - 1] = 1;
        for t in n..length {
            let sum: u32 = coefficients.iter().zip(&digits[t - n..t]).map(|(c, s)| u32::from(c * s)).sum();
            digits[t] = (sum % u32::from(self.p())) as u8;
        }
        digits
    }
}

/// The distinct prime factors, increasing.
fn prime_factors(mut n: u64) -> Vec<u64> {
    let mut factors = Vec::new();
    let mut q = 2;
    while q * q <= n {
        if n.is_multiple_of(q) {
            factors.push(q);
            while n.is_multiple_of(q) {
                n /= q;
            }
        }
        q += 1;
    }
    if n > 1 {
        factors.push(n);
    }
    factors
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_count_of_primitive_polynomials_is_that_of_the_formula() {
        for (base, orders) in [(Base::Two, 2..=9_u32), (Base::Three, 2..=6)] {
            for order in orders {
                let candidates = u64::from(base.p()).pow(order - 1);
                let found = (0..candidates).filter(|k| base.is_primitive(&base.candidate(order, *k))).count() as u64;
                assert_eq!(found, base.primitive_count(order), "{base:?} {order}");
                let ctl = Ctl::new();
                assert!(base.primitive(order, found, &ctl).unwrap().is_none());
                assert!(base.primitive(order, found - 1, &ctl).unwrap().is_some());
            }
        }
        assert_eq!((Base::Three.primitive_count(5), Base::Two.primitive_count(6)), (22, 6));
    }

    #[test]
    fn primitive_is_what_visits_every_state() {
        // Against the definition, over all coefficients, other values of c₀ included.
        for (base, order) in [(Base::Two, 6_u32), (Base::Three, 4)] {
            let p = base.p();
            for number in 0..u64::from(p).pow(order) {
                let c: Vec<u8> = (0..order).map(|i| (number / u64::from(p).pow(i) % u64::from(p)) as u8).collect();
                let start: Vec<u8> = (0..order).map(|i| u8::from(i == order - 1)).collect();
                let mut state = start.clone();
                let mut steps = 0;
                loop {
                    let next = c.iter().zip(&state).map(|(c, s)| c * s).sum::<u8>() % p;
                    state.remove(0);
                    state.push(next);
                    steps += 1;
                    if state == start || steps > base.length(order) {
                        break;
                    }
                }
                assert_eq!(base.is_primitive(&c), steps == base.length(order), "{c:?}");
            }
        }
    }

    #[test]
    fn drawn_polynomials_are_primitive_and_differ() {
        let mut random = crate::num::rng::stream(3, "test");
        let ctl = Ctl::new();
        let drawn: Vec<_> = (0..20).map(|_| Base::Three.draw_primitive(5, &mut random, &ctl).unwrap()).collect();
        assert!(drawn.iter().all(|c| Base::Three.is_primitive(c)) && drawn.iter().any(|c| *c != drawn[0]));
    }
}
