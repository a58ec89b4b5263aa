//! ‖S P‖∞ of many loops around one plant.

use crate::control::{Discrete, TimeBase as _};
use crate::excite::path::{SampledPlant, pole_hints};
use crate::excite::peak::{Peak, golden, grid};
use crate::num::{Complex64, Polynomial};
use std::f64::consts::PI;

/// Maxima of the grid below this share of the largest are not refined: the points at the poles look at every narrow
/// one.
const WORTH: f64 = 0.5;

/// The grid of frequencies, and the plant there.
#[derive(Debug, Clone)]
pub(super) struct NormGrid {
    /// ω, z, and numerator and denominator of the plant.
    points: Vec<(f64, [Complex64; 3])>,
}

fn horner(p: &Polynomial, z: Complex64) -> Complex64 {
    p.coefficients().iter().fold(Complex64::new(0.0, 0.0), |sum, c| sum * z + c)
}

impl NormGrid {
    pub(super) fn new(plant: &SampledPlant) -> Self {
        let point = |w| at(plant, w);
        Self { points: grid(PI / plant.time().period_s(), &[]).into_iter().map(|w| (w, point(w))).collect() }
    }

    /// The largest `|P_num C_den/closed|`, on the grid, at the poles and around each of their maxima; or some value
    /// that exceeds `enough`.
    pub(super) fn supremum(&self, plant: &SampledPlant, den: &Polynomial, closed: &Polynomial, enough: f64) -> Peak {
        let time: Discrete = plant.time();
        let nyquist = PI / time.period_s();
        // Squares, until the end.
        let of =
            |[z, num, _]: &[Complex64; 3]| num.norm_sqr() * horner(den, *z).norm_sqr() / horner(closed, *z).norm_sqr();
        let enough = enough * enough;
        let root = |at: f64, square: f64| Peak { at, value: square.sqrt() };
        let mut values: Vec<(f64, f64)> = Vec::with_capacity(self.points.len() + 32);
        // At the poles first, where most of what exceeds a limit does so.
        for [omega, decay] in pole_hints(closed, time) {
            for k in -4_i32..=4 {
                let w = omega + 0.5 * f64::from(k) * decay;
                if (0.0..=nyquist).contains(&w) {
                    values.push((w, of(&at(plant, w))));
                }
            }
        }
        if let Some((w, value)) = values.iter().find(|(_, value)| *value > enough) {
            return root(*w, *value);
        }
        for (w, point) in &self.points {
            let value = of(point);
            if value > enough {
                return root(*w, value);
            }
            values.push((*w, value));
        }
        values.sort_by(|a, b| a.0.total_cmp(&b.0));
        let largest = values.iter().fold((0.0, f64::NEG_INFINITY), |best, v| if v.1 > best.1 { *v } else { best });
        let mut best = root(largest.0, largest.1);
        for i in 0..values.len() {
            let (lower, upper) = (i.saturating_sub(1), (i + 1).min(values.len() - 1));
            let is_top = values[i].1 >= values[lower].1 && values[i].1 >= values[upper].1;
            if is_top && values[i].1 >= WORTH * WORTH * largest.1 {
                let refined = golden(|w| of(&at(plant, w)), values[lower].0, values[upper].0);
                let refined = root(refined.at, refined.value);
                if refined.value > best.value {
                    best = refined;
                }
            }
        }
        best
    }
}

fn at(plant: &SampledPlant, omega: f64) -> [Complex64; 3] {
    let z = plant.time().point(omega);
    [z, horner(plant.sampled().num(), z), horner(plant.sampled().den(), z)]
}
