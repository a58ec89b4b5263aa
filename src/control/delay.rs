//! Stability of a feedback loop with a pure delay, judged with the delay itself.
//!
//! Continuous loops of retarded type, `D(s) + N(s) e^{−sτ} = 0` with deg N < deg D, by the direct method of Walton and
//! Marshall (1987): with N and D held, the count of roots right of the axis at delay 0 is that of a polynomial, and as
//! the delay grows it changes only where a root crosses the axis at `jω` with `W(ω²) = |D(jω)|² − |N(jω)|² = 0`, at the
//! delays `(arg(−N/D) + 2πq)/ω`: to the right where W rises, to the left where it falls. A margin m shifts the
//! variable, `s = v − m`, which multiplies N by `e^{mτ}`.
//!
//! Sampled loops with a delay of d samples have the polynomial `z^d D(z) + N(z)`.

use super::stability::is_schur_within;
use crate::num::Polynomial;
use num_complex::Complex64;

/// A crossing this close to the delay (relative), or a root of W this close to a double one, leaves the loop on the
/// boundary.
const CLOSE: f64 = 1e-9;

/// Roots of W whose imaginary part is below this share of their modulus count as real.
const REAL: f64 = 1e-7;

/// Crossings counted at most; a loop with more is far from stable or has no use for a count.
const MOST_CROSSINGS: f64 = 1e6;

/// Why a loop cannot be judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum DelayError {
    /// N is not of lower degree than D: the equation is of neutral or advanced type.
    #[error(
        "the loop with delay is not strictly proper, and its roots may come arbitrarily close to an axis or cross it \
         at infinity"
    )]
    NotRetarded,
    /// A coefficient, the margin or the delay is not finite, or the delay is negative.
    #[error("a coefficient, the margin or the delay is not finite, or the delay is negative")]
    NotFinite,
}

/// `p(v − margin)`, descending powers.
fn shifted(p: &[f64], margin: f64) -> Vec<f64> {
    let mut p = p.to_vec();
    for end in (1..p.len()).rev() {
        for i in 0..end {
            p[i + 1] -= margin * p[i];
        }
    }
    p
}

/// `|p(jω)|²` as a polynomial in ω², descending.
fn square_on_axis(p: &[f64]) -> Polynomial {
    // p(jω) p(−jω): the even part of p(s) p(−s) with s² = −ω².
    let n = p.len() - 1;
    let mirrored: Vec<f64> =
        p.iter().enumerate().map(|(i, c)| if (n - i).is_multiple_of(2) { *c } else { -c }).collect();
    let product = Polynomial::new(p.to_vec()).mul(&Polynomial::new(mirrored));
    let coefficients = product.coefficients();
    let degree = coefficients.len() - 1;
    let even: Vec<f64> = coefficients
        .iter()
        .enumerate()
        .filter(|(i, _)| (degree - i).is_multiple_of(2))
        .map(|(i, c)| if ((degree - i) / 2).is_multiple_of(2) { *c } else { -c })
        .collect();
    Polynomial::new(even)
}

/// The number of roots of `D(s) + N(s) e^{−sτ}` with real parts of at least `−margin`; `None` where a root lies on that
/// line to working precision. Coefficients in descending powers, `margin` in 1/s (it may be negative), `delay` in
/// seconds.
///
/// # Errors
/// [`DelayError`].
pub(crate) fn roots_right_of(d: &[f64], n: &[f64], delay: f64, margin: f64) -> Result<Option<usize>, DelayError> {
    let (d, n) = (Polynomial::new(d.to_vec()), Polynomial::new(n.to_vec()));
    if n.degree() >= d.degree() && !n.is_zero() {
        return Err(DelayError::NotRetarded);
    }
    let is_finite = d.coefficients().iter().chain(n.coefficients()).chain([&delay, &margin]).all(|c| c.is_finite());
    if !is_finite || delay < 0.0 || d.is_zero() {
        return Err(DelayError::NotFinite);
    }
    let d = Polynomial::new(shifted(d.coefficients(), margin));
    let n = Polynomial::new(shifted(n.coefficients(), margin)).scale((margin * delay).exp());
    let Ok(roots) = d.add(&n).roots() else { return Err(DelayError::NotFinite) };
    let scale = roots.iter().map(|r| r.norm()).fold(0.0, f64::max).max(f64::MIN_POSITIVE);
    if delay == 0.0 {
        let on_axis = roots.iter().any(|r| r.re.abs() <= CLOSE * scale);
        return Ok((!on_axis).then(|| roots.iter().filter(|r| r.re > 0.0).count()));
    }
    let zero = Complex64::new(0.0, 0.0);
    let (at_zero, terms) = ((d.eval(zero) + n.eval(zero)).re, d.eval(zero).norm() + n.eval(zero).norm());
    if at_zero.abs() <= CLOSE * terms {
        return Ok(None);
    }
    // A root on the axis at delay 0 leaves it as soon as there is a delay; which way, only a count at a small delay
    // could tell.
    if roots.iter().any(|r| r.re.abs() <= CLOSE * scale) {
        return Ok(None);
    }
    let mut count = roots.iter().filter(|r| r.re > 0.0).count() as i64;
    let w = square_on_axis(d.coefficients()).add(&square_on_axis(n.coefficients()).scale(-1.0));
    let slope = w.derivative();
    let Ok(squares) = w.roots() else { return Err(DelayError::NotFinite) };
    for square in squares {
        if square.re <= 0.0 || square.im.abs() > REAL * square.norm() {
            continue;
        }
        let omega = square.re.sqrt();
        let direction = slope.eval(Complex64::new(square.re, 0.0)).re;
        let point = Complex64::new(0.0, omega);
        // D + N e^{−jωτ} = 0: ωτ = arg(−N/D).
        let angle = (-n.eval(point) / d.eval(point)).arg().rem_euclid(std::f64::consts::TAU);
        let turns = (omega * delay - angle) / std::f64::consts::TAU;
        if turns > MOST_CROSSINGS {
            return Ok(None);
        }
        let nearest = angle + turns.round().max(0.0) * std::f64::consts::TAU;
        if (nearest - omega * delay).abs() <= CLOSE * (1.0 + omega * delay) {
            return Ok(None);
        }
        if turns >= 0.0 {
            let crossings = turns.floor() as i64 + 1;
            count += if direction > 0.0 { 2 * crossings } else { -2 * crossings };
        }
    }
    // A count below zero means that a double root of W was taken for one.
    Ok(usize::try_from(count).ok())
}

/// Whether every root of `D(s) + N(s) e^{−sτ}` has `Re s < −margin`, strictly; on the boundary to working precision it
/// has not.
///
/// # Errors
/// [`DelayError`].
pub(crate) fn is_stable_continuous(d: &[f64], n: &[f64], delay: f64, margin: f64) -> Result<bool, DelayError> {
    Ok(roots_right_of(d, n, delay, margin)? == Some(0))
}

/// Whether every root of `z^samples D(z) + N(z)` has `|z| < radius`, strictly; N must not be of higher degree than D.
///
/// # Errors
/// [`DelayError`].
pub(crate) fn is_stable_sampled(d: &[f64], n: &[f64], samples: usize, radius: f64) -> Result<bool, DelayError> {
    if d.iter().chain(n).any(|c| !c.is_finite()) {
        return Err(DelayError::NotFinite);
    }
    let (d, n) = (Polynomial::new(d.to_vec()), Polynomial::new(n.to_vec()));
    if n.degree() > d.degree() {
        return Err(DelayError::NotRetarded);
    }
    let delayed = Polynomial::new([d.coefficients(), &vec![0.0; samples]].concat());
    Ok(is_schur_within(delayed.add(&n).coefficients(), radius))
}

/// The largest real part of the roots of `D(s) + N(s) e^{−sτ}` within `[lowest, highest]`, by bisection on the exact
/// count, to `tolerance`; `None` where it lies outside, or the loop cannot be judged.
#[must_use]
pub(crate) fn largest_real_part(
    d: &[f64],
    n: &[f64],
    delay: f64,
    [lowest, highest]: [f64; 2],
    tolerance: f64,
) -> Option<f64> {
    let is_left_of = |edge: f64| is_stable_continuous(d, n, delay, -edge);
    if !is_left_of(highest).ok()? || is_left_of(lowest).ok()? {
        return None;
    }
    let (mut low, mut high) = (lowest, highest);
    while high - low > tolerance {
        let middle = 0.5 * (low + high);
        if is_left_of(middle).ok()? {
            high = middle;
        } else {
            low = middle;
        }
    }
    Some(high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::rng;
    use rand::RngExt;
    use std::f64::consts::PI;

    /// The count by the argument principle: the phase of `D + N e^{−sτ}` along the axis, followed in steps that a bound
    /// of the derivative certifies.
    fn by_winding(d: &[f64], n: &[f64], delay: f64) -> Option<usize> {
        let (d, n) = (Polynomial::new(d.to_vec()), Polynomial::new(n.to_vec()));
        let f = |w: f64| {
            d.eval(Complex64::new(0.0, w)) + n.eval(Complex64::new(0.0, w)) * Complex64::from_polar(1.0, -w * delay)
        };
        let sum = |p: &Polynomial, w: f64, order: usize| -> f64 {
            let degree = p.degree();
            p.coefficients()
                .iter()
                .enumerate()
                .filter(|(i, _)| degree - i >= order)
                .map(|(i, c)| {
                    let power = degree - i;
                    let factor = if order == 1 { power as f64 } else { 1.0 };
                    c.abs() * factor * w.powi((power - order) as i32)
                })
                .sum()
        };
        // Beyond `far` the leading term of D outweighs a hundred times all others.
        let lead = d.leading().abs();
        let mut far = 1.0;
        while 0.01 * lead * f64::powi(far, d.degree() as i32)
            < sum(&d, far, 0) - lead * f64::powi(far, d.degree() as i32) + sum(&n, far, 0)
        {
            far *= 1.5;
        }
        let (mut w, mut turned) = (0.0, 0.0);
        let mut steps = 0;
        while w < far {
            let value = f(w);
            let mut step = 0.1_f64.min(far - w);
            loop {
                let end = w + step;
                let slope = sum(&d, end, 1) + sum(&n, end, 1) + delay * sum(&n, end, 0);
                if slope * step < 0.5 * value.norm() {
                    break;
                }
                step *= 0.5;
                if step < 1e-10 {
                    return None;
                }
            }
            turned += (f(w + step) / value).arg();
            w += step;
            steps += 1;
            assert!(steps < 5_000_000);
        }
        // To infinity D's leading term turns on to n·π/2.
        let degree = d.degree() as f64;
        let rest = (Complex64::new(0.0, 1.0).powu(d.degree() as u32) * d.leading().signum() / f(far)).arg();
        let right = degree / 2.0 - (turned + rest) / PI;
        assert!((right - right.round()).abs() < 1e-6, "{right}");
        usize::try_from(right.round() as i64).ok()
    }

    #[test]
    fn counts_agree_with_the_argument_principle() {
        let mut random = rng::stream(17, "delay");
        let (mut stable, mut unstable) = (0, 0);
        for trial in 0..400 {
            let degree = 1 + trial % 5;
            let mut d = Polynomial::new(vec![1.0]);
            for _ in 0..degree {
                d = d.mul(&Polynomial::new(vec![1.0, 4.0 * random.random::<f64>() - 0.6]));
            }
            let size = random.random::<f64>() * 6.0;
            let n: Vec<f64> = (0..degree).map(|_| size * (random.random::<f64>() - 0.4)).collect();
            let delay = 2.0 * random.random::<f64>();
            let Some(expected) = by_winding(d.coefficients(), &n, delay) else { continue };
            let found = roots_right_of(d.coefficients(), &n, delay, 0.0).unwrap();
            assert_eq!(found, Some(expected), "{d:?} {n:?} {delay}");
            *(if expected == 0 { &mut stable } else { &mut unstable }) += 1;
        }
        assert!(stable > 50 && unstable > 100, "{stable} {unstable}");
    }

    /// `s + k e^{−sτ}` is stable for kτ < π/2, whatever its Padé approximation says; its root of largest real part
    /// solves `s + k e^{−sτ} = 0`.
    #[test]
    fn the_integrator_with_delay_has_its_known_limit() {
        let k = 2.0;
        let limit = PI / 2.0 / k;
        assert_eq!(roots_right_of(&[1.0, 0.0], &[k], limit * (1.0 - 1e-6), 0.0), Ok(Some(0)));
        assert_eq!(roots_right_of(&[1.0, 0.0], &[k], limit * (1.0 + 1e-6), 0.0), Ok(Some(2)));
        assert_eq!(roots_right_of(&[1.0, 0.0], &[k], limit, 0.0), Ok(None));
        // The next pair crosses a full turn later.
        assert_eq!(roots_right_of(&[1.0, 0.0], &[k], limit * 5.0 + 0.01, 0.0), Ok(Some(4)));
        let largest = largest_real_part(&[1.0, 0.0], &[k], 0.5, [-20.0, 20.0], 1e-10).unwrap();
        // A Newton iteration on the characteristic equation itself.
        let mut s = Complex64::new(-0.5, 2.0);
        for _ in 0..50 {
            let e = (-s * 0.5).exp();
            s -= (s + k * e) / (1.0 - 0.5 * k * e);
        }
        assert!((largest - s.re).abs() < 1e-8, "{largest} {s}");
    }

    /// Against the roots of a loop with a Padé approximation of high order, away from the boundary.
    #[test]
    fn verdicts_agree_with_a_high_order_pade_approximation() {
        let order = 8;
        let mut random = rng::stream(23, "delay pade");
        let mut both = [0, 0];
        for _ in 0..200 {
            let (a, b) = (3.0 * random.random::<f64>() - 0.3, 0.5 + 2.0 * random.random::<f64>());
            let d = Polynomial::new(vec![1.0, a + b, a * b]);
            let n = Polynomial::new(vec![9.0 * random.random::<f64>(), 9.0 * random.random::<f64>()]);
            let delay = 0.05 + 0.4 * random.random::<f64>();
            let mut coefficient = 1.0;
            let (mut up, mut down) = (Vec::new(), Vec::new());
            for i in 0..=order {
                down.push(coefficient);
                up.push(if i % 2 == 0 { coefficient } else { -coefficient });
                coefficient *= delay * (order - i) as f64 / ((2 * order - i) as f64 * (i + 1) as f64);
            }
            up.reverse();
            down.reverse();
            let closed = d.mul(&Polynomial::new(down)).add(&n.mul(&Polynomial::new(up)));
            let largest = closed.roots().unwrap().iter().map(|r| r.re).fold(f64::NEG_INFINITY, f64::max);
            for margin in [0.0, 0.1] {
                if (largest + margin).abs() < 0.02 {
                    continue;
                }
                let is_stable = is_stable_continuous(d.coefficients(), n.coefficients(), delay, margin).unwrap();
                assert_eq!(is_stable, largest < -margin, "{d:?} {n:?} {delay} {margin}: {largest}");
                both[usize::from(is_stable)] += 1;
            }
        }
        assert!(both[0] > 30 && both[1] > 100, "{both:?}");
    }

    #[test]
    fn sampled_delays_lengthen_the_polynomial() {
        // z − 1 + k z^{−d}: stable for k < 2 sin(π/(2(2d + 1))) (Levin and May 1976).
        for samples in 0..6_u32 {
            let limit = 2.0 * (PI / (2.0 * (2.0 * f64::from(samples) + 1.0))).sin();
            for (share, expected) in [(0.999, true), (1.001, false)] {
                let found = is_stable_sampled(&[1.0, -1.0], &[share * limit], samples as usize, 1.0).unwrap();
                assert_eq!(found, expected, "{samples} {share}");
            }
        }
    }

    #[test]
    fn what_is_not_retarded_is_refused() {
        assert_eq!(roots_right_of(&[1.0, 1.0], &[0.5, 1.0], 0.1, 0.0), Err(DelayError::NotRetarded));
        assert_eq!(roots_right_of(&[1.0, 1.0], &[1.0], -0.1, 0.0), Err(DelayError::NotFinite));
        assert_eq!(roots_right_of(&[1.0, 1.0], &[0.0], 0.1, 0.0), Ok(Some(0)));
    }
}
