//! Least peaks over a whole box of compensators, proven before anything is searched.
//!
//! For a stable loop that is at rest until the first sample of the reference that is not zero, and any real z ≥ 1,
//!
//! ```text
//! Σ_k u_k z^{−k} = C(z)/(1 + C(z) P(z)) · Σ_k r_k z^{−k},     so     peak |u| ≥ |Σ u_k z^{−k}| / Σ z^{−k}
//! ```
//! `C/(1 + C P) = 1/(1/C + P)` grows with C(z) wherever the loop is stable (there `1 + C P > 0`), C(z) grows with the
//! gain and the zeros and falls with the poles, so that one corner of a box bounds the force of every compensator in
//! it; likewise the position, `1/(1 + 1/(C P))`, and, by the maximum principle outside the unit circle, `‖S P‖∞ ≥
//! 1/(C(z) + 1/P(z))`. A compensator whose closed-loop polynomial has the wrong sign at z = ±ρ has a root beyond the
//! radius ρ that the decay asks for, and does not count. Boxes are cut in two where the bound is lowest (branch and
//! bound).
//!
//! The reference may go on after the record as it likes; what that could add is left out where z^{−N} is below 1e-30,
//! which is far below rounding for every loop whose gain from reference to force is a number of working precision.

use super::design::{Design, DesignLimits};
use super::search_box::{SearchBox, SectionBox};
use std::collections::BinaryHeap;
use std::f64::consts::PI;

/// Boxes that are looked at.
const BOXES: usize = 8_000;
/// Points z.
const POINTS: usize = 24;
/// `ln` of what z^N must exceed.
const FORGOTTEN: f64 = 69.0;
/// For the rounding of the sums.
const ROUNDING: f64 = 1.0 - 1e-9;

/// What no compensator of a box can go below.
#[derive(Debug, Clone, PartialEq)]
pub struct Impossible {
    /// Each limited quantity by name: the least value that is proven, and its limit.
    pub least: Vec<(&'static str, f64, f64)>,
}

/// A point z ≥ 1: its substitute s = (2/T)(z − 1)/(z + 1), the mean of the reference weighted by z^{−k}, and P(z).
struct Probe {
    s: f64,
    reference: f64,
    plant: f64,
}

/// The quantities that are bounded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Quantity {
    Force,
    Position,
    DisturbanceNorm,
}

struct Bounds {
    probes: Vec<Probe>,
    /// Numerator and denominator of the plant at z = ρ and at z = −ρ, with z, and the degree of the denominator.
    signs: [(f64, f64, f64); 2],
    degree: usize,
    k: f64,
    /// Whether each section is of second order.
    sections: Vec<bool>,
    limited: Vec<(&'static str, Quantity, f64)>,
    zero_below_pole: bool,
}

/// A box with its bound, so ordered that the lowest comes first.
struct Open {
    bound: f64,
    bounds: Vec<[f64; 2]>,
}

impl PartialEq for Open {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}
impl Eq for Open {}
impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Open {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        other.bound.total_cmp(&self.bound)
    }
}

/// A proof that no stable compensator of a box keeps the limits; `None` where there is none.
#[must_use]
pub fn impossible(design: &Design, region: &SearchBox, limits: &DesignLimits) -> Option<Impossible> {
    let all = [
        ("force", Quantity::Force, limits.force),
        ("position", Quantity::Position, limits.position),
        ("disturbance_norm", Quantity::DisturbanceNorm, limits.disturbance_norm),
    ];
    let limited: Vec<_> =
        all.into_iter().filter_map(|(name, quantity, limit)| Some((name, quantity, limit?))).collect();
    if limited.is_empty() {
        return None;
    }
    let bounds = Bounds::new(design, region, limits, limited)?;
    let start = plain(region);
    // All limits at once, in shares of each; a bound above 1 everywhere is the proof.
    let together = |cell: &[[f64; 2]]| {
        let shares = bounds.limited.iter().map(|(_, quantity, limit)| bounds.least(cell, *quantity) / limit);
        shares.fold(0.0, f64::max)
    };
    if bounds.lowest(&start, together, 1.0) <= 1.0 {
        return None;
    }
    let least = bounds
        .limited
        .iter()
        .map(|(name, quantity, limit)| {
            let alone = |cell: &[[f64; 2]]| bounds.least(cell, *quantity);
            (*name, bounds.lowest(&start, alone, f64::INFINITY), *limit)
        })
        .collect();
    Some(Impossible { least })
}

/// The box in the unknowns themselves: K, then zero, pole (rad/s) of each section, with dampings behind.
fn plain(region: &SearchBox) -> Vec<[f64; 2]> {
    let rad = |hz: [f64; 2]| hz.map(|f| 2.0 * PI * f);
    let mut all = vec![region.gain];
    for section in &region.sections {
        match *section {
            SectionBox::First { zero_hz, pole_hz } => all.extend([rad(zero_hz), rad(pole_hz)]),
            SectionBox::Second { zero_hz, pole_hz, damping } => {
                all.extend([rad(zero_hz), damping, rad(pole_hz), damping]);
            }
        }
    }
    all
}

impl Bounds {
    fn new(
        design: &Design,
        region: &SearchBox,
        limits: &DesignLimits,
        limited: Vec<(&'static str, Quantity, f64)>,
    ) -> Option<Self> {
        let plant = design.plant();
        if plant.sampled().relative_degree() < 1 {
            // With a force that reaches the position at once, 1 + C P says less.
            return None;
        }
        let period = plant.time().period_s();
        let k = 2.0 / period;
        let reference = design.reference();
        let first = reference.iter().position(|r| *r != 0.0)?;
        let reference = &reference[first..];
        let n = reference.len() as f64;
        let value = |p: &[f64], z: f64| p.iter().fold(0.0, |sum, c| sum * z + c);
        let (num, den) = (plant.sampled().num().coefficients(), plant.sampled().den().coefficients());
        // From the slowest decay that forgets the end of the record to all weight on the first sample.
        let (slow, fast) = ((FORGOTTEN / n).ln(), 8.0_f64.ln());
        let probes = (0..POINTS).filter_map(|i| {
            let rate = (slow + (fast - slow) * i as f64 / (POINTS - 1) as f64).exp();
            let z = rate.exp();
            let (mut weight, mut sum, mut total) = (1.0, 0.0, 0.0);
            for r in reference {
                sum += weight * r;
                total += weight;
                weight /= z;
                if weight < 1e-40 {
                    break;
                }
            }
            let plant = value(num, z) / value(den, z);
            let s = k * (z - 1.0) / (z + 1.0);
            Some(Probe { s, reference: (sum / total).abs(), plant }).filter(|probe| probe.plant.is_finite())
        });
        let mut probes: Vec<Probe> = if slow < fast { probes.collect() } else { Vec::new() };
        // At z = 1 for what no reference enters.
        let plant_at_one = value(num, 1.0) / value(den, 1.0);
        probes.push(Probe { s: 0.0, reference: 0.0, plant: plant_at_one });
        let radius = (-limits.decay_per_s.unwrap_or(0.0).max(0.0) * period).exp();
        let sign = |z: f64| (z, value(num, z) / den[0], value(den, z) / den[0]);
        Some(Self {
            probes,
            signs: [sign(radius), sign(-radius)],
            degree: plant.sampled().den().degree(),
            k,
            sections: region.sections.iter().map(|section| matches!(section, SectionBox::Second { .. })).collect(),
            limited,
            zero_below_pole: region.zero_below_pole,
        })
    }

    /// Least and largest C(s) of a box, for real s ≥ 0.
    fn gain(&self, cell: &[[f64; 2]], s: f64) -> [f64; 2] {
        let mut gain = cell[0];
        let mut at = 1;
        for second in &self.sections {
            for (side, gain) in gain.iter_mut().enumerate() {
                let other = 1 - side;
                if *second {
                    let square = |w: f64, damping: f64| s * s + 2.0 * damping * w * s + w * w;
                    *gain *= square(cell[at][side], cell[at + 1][side]);
                    *gain /= square(cell[at + 2][other], cell[at + 3][other]);
                } else {
                    // With the zero held below the pole a section is no larger than 1.
                    let most = (s + cell[at][side]) / (s + cell[at + 1][other]);
                    *gain *= if self.zero_below_pole { most.min(1.0) } else { most };
                }
            }
            at += if *second { 4 } else { 2 };
        }
        gain
    }

    /// The least value of a quantity over a box; infinite where no compensator of it is stable with the decay.
    fn least(&self, cell: &[[f64; 2]], quantity: Quantity) -> f64 {
        if self.is_unstable(cell) {
            return f64::INFINITY;
        }
        let mut most = 0.0_f64;
        for probe in &self.probes {
            let [low, high] = self.gain(cell, probe.s);
            let reached = match quantity {
                Quantity::Force => probe.reference / (low.recip() + probe.plant),
                Quantity::Position if probe.plant > 0.0 => probe.reference / (1.0 + (low * probe.plant).recip()),
                Quantity::DisturbanceNorm if probe.plant > 0.0 => (high + probe.plant.recip()).recip(),
                _ => 0.0,
            };
            // Where 1 + C P is not positive at the lowest C, stable compensators have more gain there, and no bound.
            if reached.is_finite() {
                most = most.max(reached * ROUNDING);
            }
        }
        most
    }

    /// Whether every compensator of a box has a root of the loop on or beyond the radius that the decay asks for.
    fn is_unstable(&self, cell: &[[f64; 2]]) -> bool {
        self.signs.iter().enumerate().any(|(side, (z, num, den))| {
            let (minus, plus) = (self.k * (z - 1.0), z + 1.0);
            let (mut above, mut below) = (cell[0].map(|gain| gain * num), [*den; 2]);
            if *num < 0.0 {
                above.swap(0, 1);
            }
            let (mut at, mut poles, mut is_certain) = (1, 0, true);
            for second in &self.sections {
                let factor = |w: [f64; 2], damping: Option<[f64; 2]>| -> [f64; 2] {
                    match damping {
                        None => [minus + w[0] * plus, minus + w[1] * plus],
                        Some(damping) => {
                            let squares = w.map(|w| w * w * plus * plus);
                            let cross = times(times(w, damping), [2.0 * minus * plus; 2]);
                            [minus * minus + squares[0] + cross[0], minus * minus + squares[1] + cross[1]]
                        }
                    }
                };
                let (zero, pole) = if *second {
                    (factor(cell[at], Some(cell[at + 1])), factor(cell[at + 2], Some(cell[at + 3])))
                } else {
                    (factor(cell[at], None), factor(cell[at + 1], None))
                };
                (above, below) = (times(above, zero), times(below, pole));
                let step = if *second { 4 } else { 2 };
                // A section that may be 1 leaves its pole out of the loop; its sign must then be that of a root within.
                let within = if side == 0 || *second { pole[0] > 0.0 } else { pole[1] < 0.0 };
                let may_be_one = cell[at][0] <= cell[at + step / 2][1] && cell[at + step / 2][0] <= cell[at][1];
                is_certain &= within || !may_be_one;
                poles += if *second { 2 } else { 1 };
                at += step;
            }
            let sum = [above[0] + below[0], above[1] + below[1]];
            let rounding = 1e-12 * above.iter().chain(&below).fold(0.0_f64, |most, v| most.max(v.abs()));
            let is_even = side == 0 || (self.degree + poles).is_multiple_of(2);
            let is_wrong = if is_even { sum[1] < -rounding } else { sum[0] > rounding };
            is_wrong && is_certain
        })
    }

    /// The lowest bound of a box by branch and bound: what no part of it goes below. Ends early beyond `enough`.
    fn lowest(&self, start: &[[f64; 2]], of: impl Fn(&[[f64; 2]]) -> f64, enough: f64) -> f64 {
        let mut open = BinaryHeap::from([Open { bound: of(start), bounds: start.to_vec() }]);
        let mut looked = 1;
        while let Some(cell) = open.pop() {
            let widest = (0..cell.bounds.len())
                .max_by(|a, b| {
                    let ratio = |i: usize| cell.bounds[i][1] / cell.bounds[i][0];
                    ratio(*a).total_cmp(&ratio(*b))
                })
                .unwrap_or(0);
            let [low, high] = cell.bounds[widest];
            if cell.bound > enough || looked >= BOXES || high <= low * (1.0 + 1e-6) {
                return cell.bound;
            }
            let middle = (low * high).sqrt();
            for part in [[low, middle], [middle, high]] {
                let mut bounds = cell.bounds.clone();
                bounds[widest] = part;
                // A part is no lower than the whole.
                let bound = of(&bounds).max(cell.bound);
                looked += 1;
                if bound.is_finite() {
                    open.push(Open { bound, bounds });
                }
            }
        }
        f64::INFINITY
    }
}

/// The product of two intervals.
fn times(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    let all = [a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]];
    [all.iter().copied().fold(f64::INFINITY, f64::min), all.iter().copied().fold(f64::NEG_INFINITY, f64::max)]
}
