//! One input: Kalman's polynomial, exactly, against the rounding of the data.
//!
//! With `L = K(jω − A)⁻¹B` a gain is optimal for some Q ⪰ 0 if and only if `F = |1 + L|² − 1 ≥ 0` at every frequency
//! (Kalman 1964); in sampled time `F = |1 + L|² − ρ` with `ρ = R/(R + BᵀPB) = 1 − KA⁻¹B > 0`, which the gain fixes.
//! `N = F |det(jω − A)|²` is a polynomial in ω² (in cos θ), and its integer coefficients follow exactly from the
//! doubles. F is judged against its own uncertainty u under the box of the data, to first order with its phase. At one
//! frequency `F < −u` proves that nothing near the data is optimal; that `F > u` everywhere is proven by Bernstein's
//! coefficients of N on halved intervals, so that no dip between two frequencies is missed.

use super::sensitivity::{Place, Sensitivity};
use crate::control::lyapunov::Clock;
use crate::ctl::{Ctl, Stopped};
use crate::inverse::rounding::{PLANT, Rounding, UNIT};
use crate::num::characteristic::characteristic_polynomial;
use crate::num::integer_polynomial::{Piece, Scaled, value_at};
use nalgebra::DMatrix;
use num_bigint::BigInt;

/// Intervals looked at, at most.
const INTERVALS: usize = 4000;
/// Halvings at most: a dip is then narrower than any rounding of the frequency.
const HALVINGS: u64 = 140;
/// Further intervals that a certificate of infeasibility is improved over.
const IMPROVE: usize = 64;
/// How much N must exceed its uncertainty at the ends of an interval: much on wide ones, where the uncertainty between
/// the ends is not known.
const WIDE: f64 = 16.0;
/// The same on narrow ones.
const NARROW: f64 = 1.5;
/// Halvings from which an interval is narrow.
const NARROW_FROM: u64 = 8;
/// How far a point that meets a pole of the plant is moved: 2^−40 of the interval.
const ASIDE: u64 = 40;

/// What decides: F over its uncertainty where that is least.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Kalman {
    /// The least F/u.
    pub ratio: f64,
    /// Where, in rad per unit of time (sampled: per sample); infinite for the limit.
    pub omega: f64,
    /// F there; at infinity the limit of ω²F.
    pub value: f64,
    /// u there.
    pub rounding: f64,
    /// Whether F > u is proven everywhere.
    pub is_proven: bool,
    /// The relative change of K to the boundary, to first order: where feasible the least over frequency, otherwise a
    /// lower bound of what is needed.
    pub relative_change: Option<f64>,
    /// In sampled time what decides may be the sign of `R/(R + BᵀPB)` itself.
    pub is_input_weight: bool,
}

/// N and |det(jω − A)|² on one piece of the axis, in y from 0 to 1.
struct Part {
    numerator: Vec<BigInt>,
    denominator: Vec<BigInt>,
    /// 2^exponent·√y, or its inverse, is ω; in sampled time `cos θ = 1 − 2y`.
    map: Map,
}

#[derive(Clone, Copy)]
enum Map {
    /// `ω² = 4^h y`.
    Low {
        h: i64,
    },
    /// `ω² = 4^h/y`; F is `y N/D`, and at y = 0 `N(0)` stands for `limit`.
    High {
        h: i64,
    },
    Circle,
}

/// F, its uncertainty and the place.
#[derive(Clone, Copy)]
struct Value {
    found: Kalman,
    /// u in the units of N.
    unit: Scaled,
}

pub(super) struct OneInput<'a> {
    pub a: &'a DMatrix<f64>,
    pub b: &'a DMatrix<f64>,
    pub k: &'a DMatrix<f64>,
    pub rounding: &'a Rounding,
    pub clock: Clock,
}

/// Integers `M·2^bits`, with what lies 2⁻²⁰ below the box cut off.
fn integers(m: &DMatrix<f64>, bits: i64) -> Vec<BigInt> {
    let one = |v: f64| {
        // Powers of two: no digit above the cut is lost.
        let scaled = v * (bits as f64).exp2();
        let (magnitude, negative) = (scaled.abs(), scaled < 0.0);
        let shift = (magnitude.max(1.0).log2().floor() as i64 - 60).max(0);
        let digits = (magnitude * (-shift as f64).exp2()).round() as u64;
        let value = BigInt::from(digits) << shift as u64;
        if negative { -value } else { value }
    };
    (0..m.nrows() * m.ncols()).map(|e| one(m[(e / m.ncols(), e % m.ncols())])).collect()
}

/// Bits after the binary point that a matrix needs for its entries to be right far within the box.
fn bits_of(m: &DMatrix<f64>) -> i64 {
    let size = m.norm() / m.nrows().max(m.ncols()) as f64 * PLANT * UNIT;
    if size > 0.0 { 20 - size.log2().floor() as i64 } else { 0 }
}

impl OneInput<'_> {
    fn n(&self) -> usize {
        self.a.nrows()
    }

    /// det(σ − A) and det(σ − A + BK) with integer coefficients, where `σ = 2^t s`, and t.
    fn polynomials(&self, ctl: &Ctl) -> Result<(Vec<BigInt>, Vec<BigInt>, u64), Stopped> {
        let n = self.n();
        let (bits_a, bits_b, bits_k) = (bits_of(self.a).max(0), bits_of(self.b), bits_of(self.k));
        let bits = bits_a.max(bits_b + bits_k).max(0);
        let a = integers(self.a, bits_a);
        let (b, k) = (integers(self.b, bits_b), integers(self.k, bits_k));
        let (up_a, up_bk) = ((bits - bits_a) as u64, (bits - bits_b - bits_k) as u64);
        let closed: Vec<BigInt> = (0..n * n).map(|e| (&a[e] << up_a) - ((&b[e / n] * &k[e % n]) << up_bk)).collect();
        let mut open = characteristic_polynomial(&a, n, ctl)?;
        for (power, coefficient) in open.iter_mut().enumerate() {
            *coefficient <<= up_a * (n - power) as u64;
        }
        Ok((open, characteristic_polynomial(&closed, n, ctl)?, bits as u64))
    }

    fn parts(&self, open: &[BigInt], closed: &[BigInt], t: u64) -> Vec<Part> {
        let n = self.n();
        if self.clock == Clock::Sampled {
            // Coefficients of z, not of 2^t z.
            let plain = |p: &[BigInt]| -> Vec<BigInt> {
                p.iter().enumerate().map(|(power, c)| c << (t * power as u64)).collect()
            };
            let (open, closed) = (plain(open), plain(closed));
            let (squared_open, squared_closed) = (on_circle(&open), on_circle(&closed));
            let numerator =
                (0..n).map(|i| &open[0] * (&open[0] * &squared_closed[i] - &closed[0] * &squared_open[i])).collect();
            let denominator = squared_open.iter().map(|c| &open[0] * &open[0] * c).collect();
            return vec![Part { numerator, denominator, map: Map::Circle }];
        }
        let (squared_open, squared_closed) = (on_axis(open), on_axis(closed));
        let numerator: Vec<BigInt> = (0..n).map(|i| &squared_closed[i] - &squared_open[i]).collect();
        // The axis is cut at the size of the plant.
        let size = (self.a.norm().max((self.b * self.k).norm()) / (n as f64).sqrt()).max(f64::MIN_POSITIVE);
        let h = size.log2().round() as i64;
        // x = 4^(t + h) y; a negative exponent goes to the other coefficients.
        let shift = 2 * (t as i64 + h);
        let scaled = |p: &[BigInt]| -> Vec<BigInt> {
            let last = p.len() as i64 - 1;
            let power = |i: usize| if shift >= 0 { shift * i as i64 } else { -shift * (last - i as i64) };
            p.iter().enumerate().map(|(i, c)| c << power(i) as u64).collect()
        };
        let (low, low_open) = (scaled(&numerator), scaled(&squared_open));
        // One factor more, since the denominator has one coefficient more.
        let low: Vec<BigInt> = if shift < 0 { low.into_iter().map(|c| c << (-shift) as u64).collect() } else { low };
        let reversed = |p: &[BigInt]| p.iter().rev().cloned().collect();
        vec![
            Part { numerator: reversed(&low), denominator: reversed(&low_open), map: Map::High { h } },
            Part { numerator: low, denominator: low_open, map: Map::Low { h } },
        ]
    }

    /// F at y = numerator/2^halvings of a part.
    fn value(&self, part: &Part, sensitivity: &Sensitivity, numerator: &BigInt, halvings: u64) -> Value {
        let exact = |p: &[BigInt], numerator: &BigInt, halvings: u64| {
            let value = Scaled::of(&value_at(p, numerator, halvings));
            value.times(Scaled::new(1.0, -((halvings * (p.len() as u64 - 1)) as i64)))
        };
        let y = Scaled::of(numerator).times(Scaled::new(1.0, -(halvings as i64))).value();
        let place = match part.map {
            Map::Low { h } => Place::Axis((h as f64).exp2() * y.sqrt()),
            Map::High { .. } if y == 0.0 => Place::Infinity,
            Map::High { h } => Place::Axis((h as f64).exp2() / y.sqrt()),
            Map::Circle => Place::circle(y),
        };
        let top = exact(&part.numerator, numerator, halvings);
        let bottom = exact(&part.denominator, numerator, halvings);
        let found = sensitivity.at(place);
        let Some(found) = found.filter(|_| !bottom.is_zero()) else {
            // A pole of the plant: a step aside.
            if halvings > HALVINGS + ASIDE {
                return Value { found: Kalman::nothing(), unit: Scaled::new(1.0, 0) };
            }
            let moved: BigInt = (numerator << ASIDE) + if y >= 1.0 { -1 } else { 1 };
            return self.value(part, sensitivity, &moved, halvings + ASIDE);
        };
        // N over this is F (at infinity ω²F).
        let denominator = match (part.map, place) {
            (Map::High { h }, Place::Infinity) => bottom.times(Scaled::new(1.0, -2 * h)),
            (Map::High { .. }, _) => bottom.over(Scaled::new(y, 0)),
            _ => bottom,
        };
        let value = top.over(denominator).value();
        let change = value.abs() / (found.gain.norm() * self.k.norm());
        let kalman = Kalman {
            ratio: value / found.rounding,
            omega: place.omega(),
            value,
            rounding: found.rounding,
            is_proven: false,
            relative_change: change.is_finite().then_some(change),
            is_input_weight: false,
        };
        Value { found: kalman, unit: denominator.times(Scaled::new(found.rounding, 0)) }
    }

    /// The verdict's number: the least F/u over the axis.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub(super) fn judge(&self, ctl: &Ctl) -> Result<Kalman, Stopped> {
        let sensitivity = Sensitivity::new(self);
        let (open, closed, t) = self.polynomials(ctl)?;
        let mut scan = Scan { least: None, smallest: f64::INFINITY, largest: None };
        if self.clock == Clock::Sampled {
            let (value, rounding) =
                (Scaled::of(&closed[0]).over(Scaled::of(&open[0])).value(), sensitivity.input_weight_rounding());
            let ratio = value / rounding;
            let found = Kalman { ratio, value, rounding, is_input_weight: true, ..Kalman::nothing() };
            scan.least = Some(found);
            if ratio.is_nan() || ratio < -1.0 {
                return Ok(found);
            }
        }
        let parts = self.parts(&open, &closed, t);
        let precision = 512 + 24 * self.n() as u64;
        let mut stack = Vec::new();
        for (which, part) in parts.iter().enumerate() {
            let (piece, factor) = Piece::whole(&part.numerator, precision);
            let ends = [0, 1].map(|end| self.value(part, &sensitivity, &BigInt::from(end), 0));
            ends.iter().for_each(|end| scan.meet(&end.found));
            stack.push((which, factor, piece, ends.map(|end| end.unit)));
        }
        let (mut looked_at, mut improved, mut is_proven) = (0, 0, true);
        while let Some((which, factor, piece, units)) = stack.pop() {
            ctl.check()?;
            let lower = Scaled::of(&piece.lower_bound()).times(factor);
            let ratio = scan.least.map_or(f64::INFINITY, |least| least.ratio);
            let margin = if piece.halvings < NARROW_FROM { WIDE } else { NARROW };
            let clear = if ratio > 1.0 {
                lower.over(units[0].max(units[1])).value() > margin
            } else {
                lower.over(units[0].min(units[1])).value() > -0.5
            };
            if clear {
                continue;
            }
            looked_at += 1;
            if ratio < -1.0 {
                improved += 1;
            }
            if piece.halvings >= HALVINGS {
                is_proven = false;
                continue;
            }
            if looked_at > INTERVALS || improved > IMPROVE {
                is_proven = false;
                break;
            }
            let (numerator, halvings) = ((&piece.numerator << 1) + 1, piece.halvings + 1);
            let middle = self.value(&parts[which], &sensitivity, &numerator, halvings);
            scan.meet(&middle.found);
            let [left, right] = piece.halves();
            stack.push((which, factor, left, [units[0], middle.unit]));
            stack.push((which, factor, right, [middle.unit, units[1]]));
        }
        let least = scan.least.unwrap_or_else(Kalman::nothing);
        let change = if least.ratio > 0.0 { Some(scan.smallest).filter(|v| v.is_finite()) } else { scan.largest };
        Ok(Kalman { is_proven, relative_change: change, ..least })
    }
}

impl Kalman {
    fn nothing() -> Self {
        Self {
            ratio: f64::INFINITY,
            omega: f64::NAN,
            value: f64::INFINITY,
            rounding: 0.0,
            is_proven: false,
            relative_change: None,
            is_input_weight: false,
        }
    }
}

/// What was met so far.
struct Scan {
    least: Option<Kalman>,
    /// The least relative change where F > 0.
    smallest: f64,
    /// The largest where F < 0.
    largest: Option<f64>,
}

impl Scan {
    fn meet(&mut self, found: &Kalman) {
        if self.least.is_none_or(|least| found.ratio < least.ratio) {
            self.least = Some(*found);
        }
        let Some(change) = found.relative_change else { return };
        if found.value > 0.0 {
            self.smallest = self.smallest.min(change);
        } else {
            self.largest = Some(self.largest.map_or(change, |v| v.max(change)));
        }
    }
}

/// `|p(jω)|²` as a polynomial in `x = ω²`, from x⁰.
fn on_axis(p: &[BigInt]) -> Vec<BigInt> {
    let signed = |offset: usize| -> Vec<BigInt> {
        let part = p.iter().skip(offset).step_by(2).enumerate();
        part.map(|(i, c)| if i % 2 == 0 { c.clone() } else { -c }).collect()
    };
    let mut squared = vec![BigInt::ZERO; p.len()];
    for (offset, part) in [(0, signed(0)), (1, signed(1))] {
        for (i, x) in part.iter().enumerate() {
            for (j, y) in part.iter().enumerate() {
                squared[i + j + offset] += x * y;
            }
        }
    }
    squared
}

/// `|p(e^jθ)|²` as a polynomial in `y = (1 − cos θ)/2`, from y⁰.
fn on_circle(p: &[BigInt]) -> Vec<BigInt> {
    let n = p.len();
    let correlation = |lag: usize| -> BigInt { p.iter().zip(&p[lag..]).map(|(x, y)| x * y).sum() };
    // Chebyshev's polynomials of 1 − 2y.
    let (mut before, mut now) = (vec![BigInt::from(1)], vec![BigInt::from(1), BigInt::from(-2)]);
    let mut squared = vec![BigInt::ZERO; n];
    squared[0] += correlation(0);
    for lag in 1..n {
        let factor: BigInt = correlation(lag) * 2;
        for (to, from) in squared.iter_mut().zip(&now) {
            *to += &factor * from;
        }
        let mut next = vec![BigInt::ZERO; now.len() + 1];
        for (i, c) in now.iter().enumerate() {
            next[i] += c * 2;
            next[i + 1] -= c * 4;
        }
        for (to, from) in next.iter_mut().zip(&before) {
            *to -= from;
        }
        (before, now) = (now, next);
    }
    squared
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_of_polynomials_on_axis_and_circle() {
        let p: Vec<BigInt> = [2, -3, 5, 7].map(BigInt::from).to_vec();
        // At x = ω² = 1: p(j) = 2 − 3j − 5 − 7j.
        let at_one: BigInt = on_axis(&p).into_iter().sum();
        assert_eq!(at_one, BigInt::from(9 + 100));
        // At y = 1, z = −1: 2 + 3 + 5 − 7; at y = 1/2, z = j.
        let circle = on_circle(&p);
        let at_end: BigInt = circle.iter().sum();
        assert_eq!(at_end, BigInt::from(9));
        assert_eq!(value_at(&circle, &BigInt::from(1), 1), BigInt::from(109 * 8));
    }
}
