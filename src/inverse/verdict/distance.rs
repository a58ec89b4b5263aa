//! How far a gain is from the boundary: by a relative change of K, and by a factor on the whole gain.

use super::dual::{DualTest, Prepared};
use super::primal::CLEAR;
use crate::control::lyapunov::Clock;
use crate::inverse::reach::Core;
use crate::num::linalg;
use nalgebra::DMatrix;
use num_complex::Complex64;

/// Points of the grid of frequencies.
const GRID: usize = 240;
/// Steps of the golden section around the best of them.
const STEPS: usize = 60;
/// Halvings of the logarithm of the relative change: it is told to half a per cent, and never too large.
const HALVINGS: usize = 13;

/// The relative change of K up to which a test holds, which is asked for the entry of a box with equal ones; `None`
/// where it does not hold without any.
pub(super) fn largest(core: &Core, holds: impl Fn(f64) -> bool) -> Option<f64> {
    let (m, n) = core.k.shape();
    let size = core.k.norm() / ((m * n) as f64).sqrt();
    // Of all changes of this norm the one with equal entries bounds the others within the tests' norms.
    let at = |change: f64| holds(size * change);
    let (mut low, mut high) = (1e-16_f64, 1.0_f64);
    if size == 0.0 || !at(low) {
        return None;
    }
    for _ in 0..HALVINGS {
        let middle = (low * high).sqrt();
        if at(middle) { low = middle } else { high = middle }
    }
    Some(low)
}

/// The change up to which a multiplier still proves that there are none.
pub(super) fn dual(core: &Core, test: &DualTest<'_>, of: &Prepared) -> Option<f64> {
    let of_one = test.moved_by_gain(of, &core.uniform(1.0));
    largest(core, |entry| test.ratio(of, &core.uniform(entry), &(&of_one * entry)).is_some_and(|ratio| ratio > CLEAR))
}

/// c*: `max over ω of −2 Re L/|L|²`, in sampled time of `−(2 Re L + KA⁻¹B)/|L|²`, for one input. `None` where it is
/// infinite, or `A − c*BK` is not stable: then no factor helps.
pub(super) fn factor(core: &Core) -> Option<f64> {
    let Core { a, b, k, clock, .. } = core;
    let n = core.states();
    if k.norm() == 0.0 {
        return None;
    }
    let constant = match clock {
        Clock::Continuous => 0.0,
        Clock::Sampled => (k * a.clone().lu().solve(b)?)[0],
    };
    let complex = |m: &DMatrix<f64>| m.map(|v| Complex64::new(v, 0.0));
    let (complex_a, complex_b) = (complex(a), complex(b));
    let at = |omega: f64| -> f64 {
        let point = match clock {
            Clock::Continuous => Complex64::new(0.0, omega),
            Clock::Sampled => Complex64::from_polar(1.0, omega),
        };
        let pencil = DMatrix::from_diagonal_element(n, n, point) - &complex_a;
        let Some(phi) = pencil.lu().solve(&complex_b) else { return f64::NEG_INFINITY };
        let l: Complex64 = k.iter().zip(phi.iter()).map(|(k, p)| p * *k).sum();
        let value = -(2.0 * l.re + constant) / l.norm_sqr();
        if value.is_finite() { value } else { f64::NEG_INFINITY }
    };
    let mut grid: Vec<f64> = match clock {
        Clock::Sampled => {
            let pi = std::f64::consts::PI;
            let slow = (1..GRID / 2).map(|i| pi * 10f64.powf(-6.0 * i as f64 / (GRID / 2) as f64));
            slow.chain((0..=GRID / 2).map(|i| pi * i as f64 / (GRID / 2) as f64)).collect()
        }
        Clock::Continuous => {
            let poles = linalg::eigenvalues(a).ok()?.into_iter().chain(linalg::eigenvalues(&core.closed_loop()).ok()?);
            let sizes: Vec<f64> = poles.map(|v| v.norm()).filter(|v| *v > 0.0).collect();
            let (low, high) = sizes.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(*v), h.max(*v)));
            let (low, high) = if high > 0.0 { (low * 1e-2, high * 1e2) } else { (1e-2, 1e2) };
            let spread = (0..GRID).map(|i| low * (high / low).powf(i as f64 / (GRID - 1) as f64));
            sizes.iter().copied().chain(spread).chain([0.0]).collect()
        }
    };
    grid.sort_by(f64::total_cmp);
    let values: Vec<f64> = grid.iter().map(|omega| at(*omega)).collect();
    let best = (0..grid.len()).max_by(|i, j| values[*i].total_cmp(&values[*j]))?;
    let mut largest = values[best];
    let (mut low, mut high) = (grid[best.saturating_sub(1)], grid[(best + 1).min(grid.len() - 1)]);
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    for _ in 0..STEPS {
        let (x, y) = (high - golden * (high - low), low + golden * (high - low));
        let (at_x, at_y) = (at(x), at(y));
        largest = largest.max(at_x).max(at_y);
        if at_x > at_y { high = y } else { low = x }
    }
    if *clock == Clock::Continuous {
        let kb = (k * b)[0];
        let kab = (k * a * b)[0];
        // L falls as 1/ω, or faster: then c grows without bound where it is positive at all.
        if kb.abs() <= 1e-14 * k.norm() * b.norm() {
            return None;
        }
        largest = largest.max(2.0 * kab / (kb * kb));
    }
    if !largest.is_finite() || largest <= 0.0 {
        return None;
    }
    let poles = linalg::eigenvalues(&(a - b * k * largest)).ok()?;
    poles.iter().all(|pole| clock.margin(*pole) > 0.0).then_some(largest)
}
