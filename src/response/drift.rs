//! The slope of a record's output that the input does not explain.
//!
//! On the lines k of a segment of N samples, a slope of b a sample has the transform `b S(k)`, `S(k) = N/(e^{−jω} −
//! 1)`, `ω = 2πk/N`. A straight line fitted to the samples would also take what the stimulus' own sinusoids have of
//! one. Here b is fitted on the lowest lines together with the transient (a polynomial in k) and, where the stimulus
//! has power on these lines, with the response to it (another polynomial times R).

use num_complex::Complex64;
use std::f64::consts::TAU;

/// The lowest lines that are used, at most.
const LINES: usize = 24;

/// How far up they are looked for where only lines without a stimulus are used.
const REACH: usize = 96;

/// Coefficients of each polynomial.
const TERMS: usize = 4;

/// A slope is one if it is this many standard errors from zero.
const SIGNIFICANT: f64 = 4.0;

/// The slope of the output, in units a sample, if it stands above its uncertainty. `dark` says on which lines no
/// stimulus has power.
pub(super) fn slope(input: &[Complex64], output: &[Complex64], dark: &[bool], samples: usize) -> Option<f64> {
    let last = (output.len().saturating_sub(1)).min(REACH + 1);
    let lines: Vec<usize> = (1..last).filter(|k| dark.get(*k) == Some(&true)).take(LINES).collect();
    let (lines, with_response) = if lines.len() >= 2 * TERMS + 2 {
        (lines, false)
    } else {
        ((1..last.min(LINES + 1)).collect::<Vec<_>>(), true)
    };
    let half = lines.last().copied()? as f64 / 2.0;
    let mut columns: Vec<Vec<Complex64>> = Vec::with_capacity(2 * TERMS);
    for p in 0..TERMS {
        let power = |k: &usize| ((*k as f64 - half) / half).powi(p as i32);
        columns.push(lines.iter().map(|k| Complex64::new(power(k), 0.0)).collect());
        if with_response {
            columns.push(lines.iter().map(|k| input[*k] * power(k)).collect());
        }
    }
    // Two equations a line, two unknowns a column, and the slope.
    let freedom = (2 * lines.len()).checked_sub(2 * columns.len() + 1).filter(|f| *f >= 4)?;
    let ramp = |k: &usize| samples as f64 / (Complex64::from_polar(1.0, -TAU * *k as f64 / samples as f64) - 1.0);
    let basis = orthonormal(columns);
    let ramp = rest(lines.iter().map(ramp).collect(), &basis);
    let seen = rest(lines.iter().map(|k| output[*k]).collect(), &basis);
    let square: f64 = ramp.iter().map(Complex64::norm_sqr).sum();
    let slope = ramp.iter().zip(&seen).map(|(s, y)| (s.conj() * y).re).sum::<f64>() / square;
    let missed: f64 = ramp.iter().zip(&seen).map(|(s, y)| (y - s * slope).norm_sqr()).sum();
    let error = (missed / freedom as f64 / square).sqrt();
    (slope.is_finite() && slope.abs() > SIGNIFICANT * error).then_some(slope)
}

/// Takes a slope off a transform.
pub(super) fn take_off(output: &mut [Complex64], slope: f64, samples: usize) {
    for (k, y) in output.iter_mut().enumerate().skip(1) {
        let turn = Complex64::from_polar(1.0, -TAU * k as f64 / samples as f64);
        *y -= slope * samples as f64 / (turn - 1.0);
    }
}

fn rest(mut vector: Vec<Complex64>, basis: &[Vec<Complex64>]) -> Vec<Complex64> {
    // Twice, because once loses orthogonality where little is left.
    for _ in 0..2 {
        for b in basis {
            let share: Complex64 = b.iter().zip(&vector).map(|(b, v)| b.conj() * v).sum();
            vector.iter_mut().zip(b).for_each(|(v, b)| *v -= share * b);
        }
    }
    vector
}

fn orthonormal(columns: Vec<Vec<Complex64>>) -> Vec<Vec<Complex64>> {
    const NOTHING_LEFT: f64 = 1e-10;
    let norm = |v: &[Complex64]| v.iter().map(Complex64::norm_sqr).sum::<f64>().sqrt();
    let mut basis: Vec<Vec<Complex64>> = Vec::with_capacity(columns.len());
    for column in columns {
        let before = norm(&column);
        let mut own = rest(column, &basis);
        let left = norm(&own);
        if left > NOTHING_LEFT * before {
            own.iter_mut().for_each(|v| *v /= left);
            basis.push(own);
        }
    }
    basis
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::fourier::real_transform;

    #[test]
    fn the_slope_beside_sinusoids_is_found_and_taken_off() {
        let n = 600;
        let sinusoids: Vec<f64> = (0..n).map(|i| (TAU * 3.0 * f64::from(i) / f64::from(n) + 0.4).sin()).collect();
        let drifting: Vec<f64> = sinusoids.iter().enumerate().map(|(i, x)| x + 0.01 * i as f64 + 3.0).collect();
        let r = real_transform(&sinusoids);
        let mut y = real_transform(&drifting);
        let dark: Vec<bool> = (0..r.len()).map(|k| k != 3 && k != 0).collect();
        let found = slope(&r, &y, &dark, 600).unwrap();
        assert!((found - 0.01).abs() < 1e-12, "{found}");
        take_off(&mut y, found, 600);
        assert!((1..r.len()).all(|k| (y[k] - r[k]).norm() < 1e-8));
    }
}
