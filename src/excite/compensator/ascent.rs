//! Climbing to the best compensator near a start.

use super::climb::{Ending, climb};
use super::design::{Design, DesignLimits};
use super::space::{EDGE, Space};
use crate::ctl::{Ctl, Stopped};
use crate::excite::peak::{golden, golden_in};

/// A climb that ends this near an edge is tried on it.
const NEAR_EDGE: f64 = 0.05;
/// How far from its last place the best gain is looked for, in its logarithm.
const REACH: f64 = 0.4;
/// Steps outwards, each [`GROWTH`] times as long, in which a gain that keeps the limits is looked for.
#[derive(Clone, Copy)]
struct Outward {
    steps: usize,
    first: f64,
}

/// From the best gain without limits, which may be far from what they allow.
const FROM_TOP: Outward = Outward { steps: 16, first: 0.004 };
/// From the last gain that kept the limits: what two of them leave between them may be so narrow that longer steps pass
/// it by.
const FROM_NEAR: Outward = Outward { steps: 25, first: 1e-5 };
/// How much longer each step is.
const GROWTH: f64 = 1.6;
/// Steps between a gain that breaks a limit and one that keeps it.
const NARROWINGS: usize = 40;
/// An edge is found when it is known to this share of the climb's ending, in the logarithm of the gain.
const NARROW: f64 = 0.1;
/// A gain whose excess is this share of the ending below zero is on the edge.
const AT_LIMIT: f64 = 0.01;
/// Gains this far apart tell which way is uphill.
const SLOPE: f64 = 1e-5;
/// The first step from a gain near an edge, at least and at most, by how much each is longer, and how many there are.
const NEAREST: f64 = 1e-7;
const FARTHEST: f64 = 0.05;
const NEAR_GROWTH: f64 = 2.5;
const NEAR_STEPS: usize = 6;
/// Steps of a golden section along the gain, where the maximum is flat: to 5e-5.
const ALONG: usize = 20;

/// What is climbed.
pub(super) struct Task<'a> {
    /// The loop.
    pub design: &'a Design,
    /// The box.
    pub space: &'a Space,
    /// What must be kept.
    pub limits: &'a DesignLimits,
    /// Who may stop it.
    pub ctl: &'a Ctl,
}

impl Task<'_> {
    /// Whether anything must be kept beside stability.
    pub(super) fn is_limited(&self) -> bool {
        !self.limits.motion().is_empty()
            || self.limits.disturbance_norm.is_some()
            || self.limits.decay_per_s.is_some_and(|decay| decay > 0.0)
    }

    /// Whether the limits are kept at a point whose loop is stable.
    pub(super) fn keeps(&self, x: &[f64]) -> bool {
        self.design.keeps(&self.space.compensator(x), self.limits)
    }

    /// By how much they are broken there; see [`Design::excess`].
    fn excess(&self, x: &[f64]) -> f64 {
        self.design.excess(&self.space.compensator(x), self.limits, false)
    }

    fn value(&self, x: &[f64]) -> f64 {
        super::search::value(self.design, &self.space.compensator(x))
    }

    /// In all unknowns at once, then along the edges where it ended, then in the gain alone; stability is all that is
    /// kept.
    ///
    /// # Errors
    /// [`Stopped`].
    pub(super) fn climb(&self, start: &[f64], spacing: &[f64], ending: Ending) -> Result<(Vec<f64>, f64), Stopped> {
        let mut stopped = None;
        let mut f = |x: &[f64]| {
            if let Err(reason) = self.ctl.check() {
                stopped = Some(reason);
            }
            if stopped.is_some() { f64::NEG_INFINITY } else { self.value(x) }
        };
        let (mut x, mut value) = ascend(&mut f, start, spacing, &self.space.bounds, ending);
        let [low, high] = self.space.bounds[0];
        if high - low > EDGE {
            // The maximum over the gain is flat: a last golden section settles its place.
            let reach = spacing[0].min(0.05);
            let mut along = |gain: f64| {
                let mut moved = x.clone();
                moved[0] = gain;
                f(&moved)
            };
            let peak = golden(&mut along, (x[0] - reach).max(low), (x[0] + reach).min(high));
            if peak.value > value {
                x[0] = peak.at;
                value = peak.value;
            }
        }
        stopped.map_or(Ok((x, value)), Err)
    }

    /// In the corners, where each pair has the best gain near the last one that keeps the limits. That profile is
    /// smooth where a climb in all unknowns would run against the limit as against a wall.
    ///
    /// # Errors
    /// [`Stopped`].
    pub(super) fn climb_along_limits(
        &self,
        start: &[f64],
        spacing: &[f64],
        ending: Ending,
    ) -> Result<(Vec<f64>, f64), Stopped> {
        let mut stopped = None;
        let mut best = (start.to_vec(), f64::NEG_INFINITY);
        let mut f = |corners: &[f64]| {
            if stopped.is_some() {
                return f64::NEG_INFINITY;
            }
            match self.best_gain(best.0[0], corners, ending) {
                Err(reason) => {
                    stopped = Some(reason);
                    f64::NEG_INFINITY
                }
                Ok(None) => f64::NEG_INFINITY,
                Ok(Some((gain, value))) => {
                    if value > best.1 {
                        best = (std::iter::once(gain).chain(corners.iter().copied()).collect(), value);
                    }
                    value
                }
            }
        };
        if start.len() == 1 {
            f(&[]);
        } else {
            ascend(&mut f, &start[1..], &spacing[1..], &self.space.bounds[1..], ending);
        }
        stopped.map_or(Ok(best), Err)
    }

    /// The best gain near `near` for some corners that keeps the limits; `None` where none was found.
    fn best_gain(&self, near: f64, corners: &[f64], ending: Ending) -> Result<Option<(f64, f64)>, Stopped> {
        let [low, high] = self.space.bounds[0];
        let along = Along { task: self, corners, ending };
        let value = |gain: f64| along.value(gain);
        self.ctl.check()?;
        if ending.is_local
            && let Some(edge) = along.near_edge(near)
        {
            return Ok(Some(edge));
        }
        let top = if high - low < EDGE {
            low
        } else {
            let peak = golden_in(value, (near - REACH).max(low), (near + REACH).min(high), ALONG);
            if peak.value > value(near) { peak.at } else { near }
        };
        if along.keeps(top) {
            return Ok(Some((top, value(top))));
        }
        // From where the last one was kept, the way to the top ends at a limit.
        let mut best: Option<(f64, f64)> = None;
        let mut known: Option<f64> = None;
        if along.keeps(near) {
            let edge = along.edge(near, top);
            (best, known) = (Some((edge, value(edge))), Some(edge));
        }
        for (from, outward) in [(top, FROM_TOP), (near, FROM_NEAR)] {
            if from == near && best.is_some() {
                break;
            }
            for direction in [-1.0, 1.0] {
                let Some([inside, outside]) = along.first_kept(from, direction, outward)? else { continue };
                // Back on the way from where the last one was kept, the edge is that which is known.
                let known = known.filter(|edge| (near.min(*edge)..=near.max(*edge)).contains(&inside));
                let inside = known.unwrap_or_else(|| along.edge(inside, outside));
                // Within what keeps the limits there may be a better place than its edge.
                let further = if direction > 0.0 { (inside + REACH).min(high) } else { (inside - REACH).max(low) };
                let peak = golden_in(value, inside.min(further), inside.max(further), ALONG);
                for gain in [inside, peak.at] {
                    let reached = value(gain);
                    if best.is_none_or(|(_, value)| reached > value) && along.keeps(gain) {
                        best = Some((gain, reached));
                    }
                }
            }
        }
        Ok(best)
    }
}

/// The gains for some corners.
struct Along<'a> {
    task: &'a Task<'a>,
    corners: &'a [f64],
    ending: Ending,
}

impl Along<'_> {
    fn at(&self, gain: f64) -> Vec<f64> {
        std::iter::once(gain).chain(self.corners.iter().copied()).collect()
    }

    fn value(&self, gain: f64) -> f64 {
        self.task.value(&self.at(gain))
    }

    fn is_stable(&self, x: &[f64]) -> bool {
        self.task.design.is_stable(&self.task.space.compensator(x), 0.0)
    }

    fn keeps(&self, gain: f64) -> bool {
        let x = self.at(gain);
        self.is_stable(&x) && self.task.keeps(&x)
    }

    fn excess(&self, gain: f64) -> f64 {
        let x = self.at(gain);
        if self.is_stable(&x) { self.task.excess(&x) } else { f64::INFINITY }
    }

    fn edge(&self, inside: f64, outside: f64) -> f64 {
        let excess = |gain: f64| self.excess(gain);
        edge_of(&excess, (inside, excess(inside)), (outside, excess(outside)), self.ending)
    }

    /// The edge that bounds the better gains, where `near` is close to it: a few steps in place of a look around.
    /// `None` where it is not, or where the better gains are not bounded there.
    fn near_edge(&self, near: f64) -> Option<(f64, f64)> {
        let [low, high] = self.task.space.bounds[0];
        let inner = |gain: f64| gain >= low && gain <= high;
        if !(inner(near - SLOPE) && inner(near + SLOPE)) {
            return None;
        }
        let (down, up) = (self.value(near - SLOPE), self.value(near + SLOPE));
        let uphill = if up > down { 1.0 } else { -1.0 };
        let here = self.excess(near);
        if !(down.is_finite() && up.is_finite() && here.is_finite()) {
            return None;
        }
        // What keeps the limits lies downhill of what breaks them, or better gains lie beyond.
        let towards = if here > 0.0 { -uphill } else { uphill };
        let (mut last, mut step) = ((near, here), here.abs().clamp(NEAREST, FARTHEST));
        for _ in 0..NEAR_STEPS {
            let gain = near + towards * step;
            if !inner(gain) {
                return None;
            }
            let next = (gain, self.excess(gain));
            let is_kept = next.1 <= 0.0;
            if is_kept != (here <= 0.0) {
                let (inside, outside) = if is_kept { (next, last) } else { (last, next) };
                let edge = edge_of(&|gain| self.excess(gain), inside, outside, self.ending);
                // Beyond the edge it must go on uphill.
                let value = self.value(edge);
                return (self.value(edge + uphill * SLOPE) > value).then_some((edge, value));
            }
            last = next;
            step *= NEAR_GROWTH;
        }
        None
    }

    /// The first gain that keeps the limits, from one that does not, in a direction, and the last that does not.
    fn first_kept(&self, from: f64, direction: f64, outward: Outward) -> Result<Option<[f64; 2]>, Stopped> {
        let [low, high] = self.task.space.bounds[0];
        let (mut outside, mut step) = (from, outward.first);
        for _ in 0..outward.steps {
            self.task.ctl.check()?;
            let inside = from + direction * step;
            if inside < low || inside > high {
                break;
            }
            if self.keeps(inside) {
                return Ok(Some([inside, outside]));
            }
            outside = inside;
            step *= GROWTH;
        }
        Ok(None)
    }
}

/// The last gain that keeps the limits on the way from one that does to one that does not: where their excess passes
/// zero, by false position with halved ends (the Illinois method), and by halving where the excess is infinite.
///
/// Both come with their excess.
fn edge_of(
    excess: &impl Fn(f64) -> f64,
    (mut inside, mut below): (f64, f64),
    (mut outside, mut above): (f64, f64),
    ending: Ending,
) -> f64 {
    let (narrow, near) = (NARROW * ending.small, -AT_LIMIT * ending.small);
    // The excess at an end is halved where the other end moves twice.
    let (mut at_limit, mut last) = (below >= near, 0);
    for _ in 0..NARROWINGS {
        if (outside - inside).abs() <= narrow || at_limit {
            break;
        }
        let share = if below.is_finite() && above.is_finite() { -below / (above - below) } else { 0.5 };
        let next = inside + share.clamp(1e-3, 1.0 - 1e-3) * (outside - inside);
        let reached = excess(next);
        if reached <= 0.0 {
            (inside, below, at_limit) = (next, reached, reached >= near);
            if last < 0 {
                above *= 0.5;
            }
            last = -1;
        } else {
            (outside, above) = (next, reached);
            if last > 0 {
                below *= 0.5;
            }
            last = 1;
        }
    }
    inside
}

/// A climb in some of the unknowns, the others held; `x` and `value` move where it gains.
fn climb_among(
    f: &mut impl FnMut(&[f64]) -> f64,
    unknowns: &[usize],
    (x, value): (&mut Vec<f64>, &mut f64),
    spacing: &[f64],
    bounds: &[[f64; 2]],
    ending: Ending,
) {
    if unknowns.is_empty() {
        return;
    }
    let pick = |all: &[f64]| unknowns.iter().map(|i| all[*i]).collect::<Vec<f64>>();
    let mut whole = x.clone();
    let mut part = |y: &[f64]| {
        for (i, y) in unknowns.iter().zip(y) {
            whole[*i] = *y;
        }
        f(&whole)
    };
    let inside: Vec<[f64; 2]> = unknowns.iter().map(|i| bounds[*i]).collect();
    let (found, reached) = climb(&mut part, &pick(x), &pick(spacing), &inside, ending);
    if reached > *value {
        for (i, y) in unknowns.iter().zip(found) {
            x[*i] = y;
        }
        *value = reached;
    }
}

/// A climb in all free unknowns, then along the edges near which it ended.
fn ascend(
    f: &mut impl FnMut(&[f64]) -> f64,
    start: &[f64],
    spacing: &[f64],
    bounds: &[[f64; 2]],
    ending: Ending,
) -> (Vec<f64>, f64) {
    let free: Vec<usize> = (0..bounds.len()).filter(|i| bounds[*i][1] - bounds[*i][0] > EDGE).collect();
    let (mut x, mut value) = (start.to_vec(), f(start));
    climb_among(f, &free, (&mut x, &mut value), spacing, bounds, ending);
    let mut inner = Vec::new();
    for i in free.iter().copied() {
        let [low, high] = bounds[i];
        if (x[i] - low).min(high - x[i]) > NEAR_EDGE {
            inner.push(i);
            continue;
        }
        let mut moved = x.clone();
        moved[i] = if x[i] - low <= NEAR_EDGE { low } else { high };
        let reached = f(&moved);
        if reached > value {
            (x, value) = (moved, reached);
        }
    }
    if inner.len() < free.len() {
        climb_among(f, &inner, (&mut x, &mut value), spacing, bounds, ending);
    }
    (x, value)
}
