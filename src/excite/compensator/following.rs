//! What a loop asks for while it follows the reference from rest: peaks, quickly, for comparing many compensators.
//!
//! The loop of plant and compensator is `x⁺ = A x + B r`, and whatever is limited is a row `c x + d r` (or, of power, a
//! product of two). A sequence stands still between its chips: over a piece of constant r the row's values are
//! `h_i x₀ + g_i r` with `h_i = c A^i` and `g_i = d + Σ_{j<i} c A^j B`, the same for every piece. With `[h g] = Q R` no
//! value of a piece is larger than `max‖q_i‖ ‖R (x₀, r)‖`, and pieces that cannot hold the peak are left out; within
//! the others a block of samples around one in its middle has no value beyond `|y_c| + max‖q_i − q_c‖ ‖R (x₀, r)‖`. A
//! reference without such pieces is followed sample by sample.

mod stretch;

use super::controller::{Compensator, Section};
use crate::control::discretise::zero_order_hold_state_space;
use crate::control::{Discrete, StateSpace, conversion};
use crate::excite::path::SampledPlant;
use stretch::{BLOCK, Stretch};

/// The longest piece; longer ones are cut.
const LONGEST: usize = 256;
/// Lengths of pieces at most.
const LENGTHS: usize = 12;
/// Bounds are taken this much larger than they were computed.
const HAIR: f64 = 1.0 + 1e-9;
/// Pieces are worth it when they are this long on average.
const WORTH: usize = 12;

/// A plant in state space, and what is asked of it.
#[derive(Debug, Clone)]
struct PlantRows {
    n: usize,
    /// n×n, row by row.
    a: Vec<f64>,
    b: Vec<f64>,
    c: Vec<f64>,
    d: f64,
    /// Rows of velocity and acceleration over the state, and what the force adds to the acceleration, of a plant whose
    /// output moves smoothly.
    derivatives: Option<(Vec<f64>, Vec<f64>, f64)>,
}

/// The reference in pieces.
#[derive(Debug, Clone)]
enum Reference {
    /// Its value, and the place of its length among the lengths.
    Pieces { lengths: Vec<usize>, pieces: Vec<(f64, usize)> },
    /// Sample by sample.
    Samples(Vec<f64>),
}

/// A plant that follows a reference in a loop.
#[derive(Debug, Clone)]
pub(super) struct Following {
    plant: PlantRows,
    reference: Reference,
    time: Discrete,
}

/// A row `c x + d r` of the loop.
#[derive(Debug, Clone)]
struct Row {
    c: Vec<f64>,
    d: f64,
}

/// Something that has a peak.
enum Quantity {
    Value(Row),
    Product([Row; 2]),
}

/// What may be limited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Limited {
    Position,
    Velocity,
    Acceleration,
    Force,
    Power,
}

/// The loop with one compensator.
pub(super) struct FollowingLoop<'a> {
    of: &'a Following,
    n: usize,
    a: Vec<f64>,
    b: Vec<f64>,
    force: Row,
}

impl Reference {
    fn new(values: Vec<f64>) -> Self {
        let (mut lengths, mut pieces): (Vec<usize>, Vec<(f64, usize)>) = (Vec::new(), Vec::new());
        let mut start = 0;
        while start < values.len() {
            let run = values[start..].iter().take(LONGEST).take_while(|r| **r == values[start]).count();
            let place = lengths.iter().position(|length| *length == run).unwrap_or_else(|| {
                lengths.push(run);
                lengths.len() - 1
            });
            pieces.push((values[start], place));
            start += run;
            if lengths.len() > LENGTHS || pieces.len() > 1 + start / WORTH {
                return Self::Samples(values);
            }
        }
        Self::Pieces { lengths, pieces }
    }
}

impl Following {
    /// `None` where the plant has no state space form.
    pub(super) fn new(plant: &SampledPlant, reference: Vec<f64>) -> Option<Self> {
        let time = plant.time();
        let derivatives = plant.smooth().map(|model| {
            let first = model.c() * model.a();
            let second = &first * model.a();
            let direct = (&first * model.b())[(0, 0)];
            let row = |m: &nalgebra::DMatrix<f64>| m.row(0).iter().copied().collect::<Vec<f64>>();
            (row(&first), row(&second), direct)
        });
        let sampled: StateSpace<Discrete> = match plant.smooth() {
            Some(model) => zero_order_hold_state_space(model, time).ok()?,
            None => conversion::to_state_space(plant.sampled()).ok()?.balanced(),
        };
        let n = sampled.states();
        let plant = PlantRows {
            n,
            a: (0..n * n).map(|i| sampled.a()[(i / n, i % n)]).collect(),
            b: sampled.b().column(0).iter().copied().collect(),
            c: sampled.c().row(0).iter().copied().collect(),
            d: sampled.d()[(0, 0)],
            derivatives,
        };
        Some(Self { plant, reference: Reference::new(reference), time })
    }

    /// Whether a quantity follows from the states: velocity, acceleration and power do of a smooth plant alone.
    pub(super) fn knows(&self, quantity: Limited) -> bool {
        matches!(quantity, Limited::Force | Limited::Position) || self.plant.derivatives.is_some()
    }

    /// The loop with a compensator; `None` where it is algebraic and has no solution.
    pub(super) fn with(&self, compensator: &Compensator) -> Option<FollowingLoop<'_>> {
        let sections: Vec<&Section> = compensator.active().collect();
        let states: Vec<_> = sections.iter().map(|section| section.sampled(self.time)).collect();
        let m: usize = states.iter().map(|s| s.2).sum();
        let p = self.plant.n;
        let n = p + m;
        // The signal between the sections, as a row over the compensator's states and the error.
        let (mut signal, mut own, mut at) = (vec![0.0; m + 1], vec![vec![0.0; m + 1]; m], 0);
        signal[m] = 1.0;
        for (b, a, degree) in states {
            for i in 0..degree {
                for (into, w) in own[at + i].iter_mut().zip(&signal) {
                    *into += (b[i + 1] - a[i + 1] * b[0]) * w;
                }
                own[at + i][at] -= a[i + 1];
                if i + 1 < degree {
                    own[at + i][at + i + 1] += 1.0;
                }
            }
            signal.iter_mut().for_each(|w| *w *= b[0]);
            signal[at] += 1.0;
            at += degree;
        }
        signal.iter_mut().for_each(|w| *w *= compensator.gain);
        let solvable = 1.0 + signal[m] * self.plant.d;
        if solvable == 0.0 {
            return None;
        }
        // u = (signal of the states + signal of the error (r − c x))/(1 + direct).
        let mut force = Row { c: vec![0.0; n], d: signal[m] / solvable };
        for (into, c) in force.c.iter_mut().zip(&self.plant.c) {
            *into = -signal[m] * c / solvable;
        }
        for (into, w) in force.c[p..].iter_mut().zip(&signal) {
            *into = w / solvable;
        }
        let (mut a, mut b) = (vec![0.0; n * n], vec![0.0; n]);
        for i in 0..p {
            a[i * n..i * n + p].copy_from_slice(&self.plant.a[i * p..(i + 1) * p]);
            for (into, u) in a[i * n..(i + 1) * n].iter_mut().zip(&force.c) {
                *into += self.plant.b[i] * u;
            }
            b[i] = self.plant.b[i] * force.d;
        }
        // The error, r − c x − d u.
        for (i, row) in own.iter().enumerate() {
            let into = &mut a[(p + i) * n..(p + i + 1) * n];
            into[p..].copy_from_slice(&row[..m]);
            for (j, into) in into.iter_mut().enumerate() {
                let position = if j < p { self.plant.c[j] } else { 0.0 };
                *into -= row[m] * (position + self.plant.d * force.c[j]);
            }
            b[p + i] = row[m] * (1.0 - self.plant.d * force.d);
        }
        Some(FollowingLoop { of: self, n, a, b, force })
    }
}

impl FollowingLoop<'_> {
    /// The peak of a quantity over the reference; with a finite `enough` some value that exceeds it where one does, and
    /// some that does not where none does. 0 of one that [`Following::knows`] not.
    pub(super) fn peak(&self, limited: Limited, enough: f64) -> f64 {
        self.quantities(limited).iter().map(|quantity| self.peak_of(quantity, enough)).fold(0.0, f64::max)
    }

    fn quantities(&self, limited: Limited) -> Vec<Quantity> {
        let plant = &self.of.plant;
        let over = |row: &[f64], direct: f64| {
            let mut c: Vec<f64> = self.force.c.iter().map(|u| direct * u).collect();
            for (into, x) in c.iter_mut().zip(row) {
                *into += x;
            }
            Row { c, d: direct * self.force.d }
        };
        match (limited, &plant.derivatives) {
            (Limited::Force, _) => vec![Quantity::Value(self.force.clone())],
            (Limited::Position, _) => vec![Quantity::Value(over(&plant.c, plant.d))],
            (_, None) => Vec::new(),
            (Limited::Velocity, Some((first, ..))) => vec![Quantity::Value(over(first, 0.0))],
            (Limited::Power, Some((first, ..))) => vec![Quantity::Product([self.force.clone(), over(first, 0.0)])],
            (Limited::Acceleration, Some((_, second, direct))) => {
                let before = over(second, *direct);
                // Just before the force changes: the row over the next state with the force as it is.
                let mut after = over(&[], *direct);
                for (i, weight) in second.iter().enumerate() {
                    for (into, a) in after.c.iter_mut().zip(&self.a[i * self.n..(i + 1) * self.n]) {
                        *into += weight * a;
                    }
                    after.d += weight * self.b[i];
                }
                vec![Quantity::Value(before), Quantity::Value(after)]
            }
        }
    }

    fn peak_of(&self, quantity: &Quantity, enough: f64) -> f64 {
        match &self.of.reference {
            Reference::Samples(values) => self.peak_of_samples(quantity, values, enough),
            Reference::Pieces { lengths, pieces } => self.peak_of_pieces(quantity, lengths, pieces, enough),
        }
    }

    fn next(&self, state: &[f64], r: f64, into: &mut [f64]) {
        for (i, into) in into.iter_mut().enumerate() {
            let row = &self.a[i * self.n..(i + 1) * self.n];
            *into = self.b[i] * r + row.iter().zip(state).map(|(a, x)| a * x).sum::<f64>();
        }
    }

    fn peak_of_samples(&self, quantity: &Quantity, values: &[f64], enough: f64) -> f64 {
        let at =
            |row: &Row, state: &[f64], r: f64| row.d * r + row.c.iter().zip(state).map(|(c, x)| c * x).sum::<f64>();
        let (mut state, mut next) = (vec![0.0; self.n], vec![0.0; self.n]);
        let mut peak = 0.0_f64;
        for r in values {
            let value = match quantity {
                Quantity::Value(row) => at(row, &state, *r),
                Quantity::Product(rows) => at(&rows[0], &state, *r) * at(&rows[1], &state, *r),
            };
            peak = peak.max(value.abs());
            if peak > enough {
                break;
            }
            self.next(&state, *r, &mut next);
            std::mem::swap(&mut state, &mut next);
        }
        peak
    }

    fn peak_of_pieces(&self, quantity: &Quantity, lengths: &[usize], pieces: &[(f64, usize)], enough: f64) -> f64 {
        let longest = lengths.iter().copied().max().unwrap_or(0);
        let rows: Vec<Stretch> = match quantity {
            Quantity::Value(row) => vec![Stretch::new(self, row, longest)],
            Quantity::Product(rows) => rows.iter().map(|row| Stretch::new(self, row, longest)).collect(),
        };
        let leaps: Vec<Leap> = lengths.iter().map(|length| self.leap(*length)).collect();
        let width = self.n + 1;
        // (x₀, r) of every piece; the first sample of each is looked at at once.
        let mut starts = vec![0.0; width * pieces.len()];
        let mut peak = 0.0_f64;
        for (place, (r, length)) in pieces.iter().enumerate() {
            let (done, rest) = starts.split_at_mut((place + 1) * width);
            let start = &mut done[place * width..];
            start[self.n] = *r;
            let first: f64 = rows.iter().map(|stretch| stretch.first(start)).product();
            peak = peak.max(first.abs());
            if peak > enough {
                return peak;
            }
            if rest.len() >= width {
                leaps[*length].apply(start, &mut rest[..self.n]);
            }
        }
        // Those that may hold more, the most promising first; with a finite `enough` less is of no interest. A hair
        // above, for the rounding of the bound.
        let floor = if enough.is_finite() { enough } else { 0.0 };
        let bound = |start: &[f64]| rows.iter().map(|stretch| stretch.bound(start)).product::<f64>() * HAIR;
        let mut open: Vec<(f64, usize)> = starts
            .chunks_exact(width)
            .enumerate()
            .filter_map(|(place, start)| Some((bound(start), place)).filter(|(bound, _)| *bound > peak.max(floor)))
            .collect();
        open.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut centres = [[0.0; LONGEST / BLOCK]; 2];
        let mut values = [[0.0; BLOCK]; 2];
        for (bound, place) in open {
            if bound <= peak.max(floor) {
                break;
            }
            let start = &starts[place * width..(place + 1) * width];
            let length = lengths[pieces[place].1];
            let blocks = length.div_ceil(BLOCK);
            let mut norms = [0.0; 2];
            for ((stretch, centres), norm) in rows.iter().zip(&mut centres).zip(&mut norms) {
                stretch.write_centres(start, &mut centres[..blocks]);
                *norm = stretch.norm(start);
            }
            for block in 0..blocks {
                let each = rows.iter().zip(&centres).zip(&norms);
                let most = each.map(|((row, centres), norm)| centres[block].abs() + row.spreads[block] * norm);
                if most.product::<f64>() * HAIR <= peak.max(floor) {
                    continue;
                }
                let from = block * BLOCK;
                let count = BLOCK.min(length - from);
                for (stretch, values) in rows.iter().zip(&mut values) {
                    stretch.write(start, from, &mut values[..count]);
                }
                for i in 0..count {
                    let value: f64 = values[..rows.len()].iter().map(|values| values[i]).product();
                    peak = peak.max(value.abs());
                }
                if peak > enough {
                    return peak;
                }
            }
        }
        peak
    }

    /// The state after so many samples of a constant reference.
    fn leap(&self, length: usize) -> Leap {
        let n = self.n;
        let width = n + 1;
        // [A B; 0 1] to the power.
        let mut base = vec![0.0; width * width];
        for i in 0..n {
            base[i * width..i * width + n].copy_from_slice(&self.a[i * n..(i + 1) * n]);
            base[i * width + n] = self.b[i];
        }
        base[width * width - 1] = 1.0;
        let product = |x: &[f64], y: &[f64]| {
            let mut out = vec![0.0; width * width];
            for i in 0..width {
                for k in 0..width {
                    let factor = x[i * width + k];
                    for j in 0..width {
                        out[i * width + j] += factor * y[k * width + j];
                    }
                }
            }
            out
        };
        let mut power: Option<Vec<f64>> = None;
        let mut left = length;
        while left > 0 {
            if left % 2 == 1 {
                power = Some(power.map_or_else(|| base.clone(), |power| product(&power, &base)));
            }
            left /= 2;
            if left > 0 {
                base = product(&base, &base);
            }
        }
        Leap { width, power: power.unwrap_or_default() }
    }
}

/// From the start of a piece to its end.
struct Leap {
    width: usize,
    power: Vec<f64>,
}

impl Leap {
    fn apply(&self, start: &[f64], into: &mut [f64]) {
        for (row, into) in self.power.chunks(self.width).zip(into) {
            *into = row.iter().zip(start).map(|(a, x)| a * x).sum();
        }
    }
}

#[cfg(test)]
mod tests;
