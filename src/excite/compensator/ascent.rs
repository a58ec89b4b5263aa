//! Climbing to the best compensator near a start.

use super::climb::climb;
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
/// An edge is found when it is known this well, in the logarithm of the gain.
const NARROW: f64 = 1e-8;
/// A gain whose excess is this little below zero is on the edge.
const AT_LIMIT: f64 = 1e-9;
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
    pub(super) fn climb(&self, start: &[f64], spacing: &[f64]) -> Result<(Vec<f64>, f64), Stopped> {
        let mut stopped = None;
        let mut f = |x: &[f64]| {
            if let Err(reason) = self.ctl.check() {
                stopped = Some(reason);
            }
            if stopped.is_some() { f64::NEG_INFINITY } else { self.value(x) }
        };
        let (mut x, mut value) = ascend(&mut f, start, spacing, &self.space.bounds);
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
    pub(super) fn climb_along_limits(&self, start: &[f64], spacing: &[f64]) -> Result<(Vec<f64>, f64), Stopped> {
        let mut stopped = None;
        let mut best = (start.to_vec(), f64::NEG_INFINITY);
        let mut f = |corners: &[f64]| {
            if stopped.is_some() {
                return f64::NEG_INFINITY;
            }
            match self.best_gain(best.0[0], corners) {
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
            ascend(&mut f, &start[1..], &spacing[1..], &self.space.bounds[1..]);
        }
        stopped.map_or(Ok(best), Err)
    }

    /// The best gain near `near` for some corners that keeps the limits; `None` where none was found.
    fn best_gain(&self, near: f64, corners: &[f64]) -> Result<Option<(f64, f64)>, Stopped> {
        let [low, high] = self.space.bounds[0];
        let at = |gain: f64| -> Vec<f64> { std::iter::once(gain).chain(corners.iter().copied()).collect() };
        let value = |gain: f64| self.value(&at(gain));
        self.ctl.check()?;
        let top = if high - low < EDGE {
            low
        } else {
            let peak = golden_in(value, (near - REACH).max(low), (near + REACH).min(high), ALONG);
            if peak.value > value(near) { peak.at } else { near }
        };
        let kept = |gain: f64| value(gain).is_finite() && self.keeps(&at(gain));
        let excess = |gain: f64| if value(gain).is_finite() { self.excess(&at(gain)) } else { f64::INFINITY };
        if kept(top) {
            return Ok(Some((top, value(top))));
        }
        // From where the last one was kept, the way to the top ends at a limit.
        let mut best: Option<(f64, f64)> = None;
        if kept(near) {
            let edge = edge_of(&excess, near, top);
            best = Some((edge, value(edge)));
        }
        for (from, outward) in [(top, FROM_TOP), (near, FROM_NEAR)] {
            if from == near && best.is_some() {
                break;
            }
            for direction in [-1.0, 1.0] {
                let Some(inside) = self.first_kept(&kept, &excess, from, direction, outward)? else { continue };
                // Within what keeps the limits there may be a better place than its edge.
                let further = if direction > 0.0 { (inside + REACH).min(high) } else { (inside - REACH).max(low) };
                let peak = golden_in(value, inside.min(further), inside.max(further), ALONG);
                for gain in [inside, peak.at] {
                    let reached = value(gain);
                    if best.is_none_or(|(_, value)| reached > value) && kept(gain) {
                        best = Some((gain, reached));
                    }
                }
            }
        }
        Ok(best)
    }

    /// The edge of what keeps the limits, from a gain that does not, in a direction.
    fn first_kept(
        &self,
        kept: &impl Fn(f64) -> bool,
        excess: &impl Fn(f64) -> f64,
        from: f64,
        direction: f64,
        outward: Outward,
    ) -> Result<Option<f64>, Stopped> {
        let [low, high] = self.space.bounds[0];
        let (mut outside, mut step) = (from, outward.first);
        for _ in 0..outward.steps {
            self.ctl.check()?;
            let inside = from + direction * step;
            if inside < low || inside > high {
                break;
            }
            if kept(inside) {
                return Ok(Some(edge_of(excess, inside, outside)));
            }
            outside = inside;
            step *= GROWTH;
        }
        Ok(None)
    }
}

/// The last gain that keeps the limits on the way from one that does to one that does not: where their excess passes
/// zero, by false position with halved ends (the Illinois method), and by halving where the excess is infinite.
fn edge_of(excess: &impl Fn(f64) -> f64, mut inside: f64, mut outside: f64) -> f64 {
    // The excess at both ends, halved where the other end moves twice.
    let (mut below, mut above) = (excess(inside), excess(outside));
    let (mut at_limit, mut last) = (below >= -AT_LIMIT, 0);
    for _ in 0..NARROWINGS {
        if (outside - inside).abs() <= NARROW || at_limit {
            break;
        }
        let share = if below.is_finite() && above.is_finite() { -below / (above - below) } else { 0.5 };
        let next = inside + share.clamp(1e-3, 1.0 - 1e-3) * (outside - inside);
        let reached = excess(next);
        if reached <= 0.0 {
            (inside, below, at_limit) = (next, reached, reached >= -AT_LIMIT);
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
    let (found, reached) = climb(&mut part, &pick(x), &pick(spacing), &inside);
    if reached > *value {
        for (i, y) in unknowns.iter().zip(found) {
            x[*i] = y;
        }
        *value = reached;
    }
}

/// A climb in all free unknowns, then along the edges near which it ended.
fn ascend(f: &mut impl FnMut(&[f64]) -> f64, start: &[f64], spacing: &[f64], bounds: &[[f64; 2]]) -> (Vec<f64>, f64) {
    let free: Vec<usize> = (0..bounds.len()).filter(|i| bounds[*i][1] - bounds[*i][0] > EDGE).collect();
    let (mut x, mut value) = (start.to_vec(), f(start));
    climb_among(f, &free, (&mut x, &mut value), spacing, bounds);
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
        climb_among(f, &inner, (&mut x, &mut value), spacing, bounds);
    }
    (x, value)
}
