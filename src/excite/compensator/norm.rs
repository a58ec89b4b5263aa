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

    /// The largest `|P_num C_den/closed|`, on the grid, at the poles and around each of their maxima.
    pub(super) fn supremum(&self, plant: &SampledPlant, den: &Polynomial, closed: &Polynomial) -> Peak {
        let time: Discrete = plant.time();
        let nyquist = PI / time.period_s();
        let of = |[z, num, _]: &[Complex64; 3]| (num * horner(den, *z) / horner(closed, *z)).norm();
        let mut values: Vec<(f64, f64)> = self.points.iter().map(|(w, point)| (*w, of(point))).collect();
        for [omega, decay] in pole_hints(closed, time) {
            for k in -4_i32..=4 {
                let w = omega + 0.5 * f64::from(k) * decay;
                if (0.0..=nyquist).contains(&w) {
                    values.push((w, of(&at(plant, w))));
                }
            }
        }
        values.sort_by(|a, b| a.0.total_cmp(&b.0));
        let largest = values.iter().fold((0.0, f64::NEG_INFINITY), |best, v| if v.1 > best.1 { *v } else { best });
        let mut best = Peak { at: largest.0, value: largest.1 };
        for i in 0..values.len() {
            let (lower, upper) = (i.saturating_sub(1), (i + 1).min(values.len() - 1));
            let is_top = values[i].1 >= values[lower].1 && values[i].1 >= values[upper].1;
            if is_top && values[i].1 >= WORTH * largest.1 {
                let refined = golden(|w| of(&at(plant, w)), values[lower].0, values[upper].0);
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
