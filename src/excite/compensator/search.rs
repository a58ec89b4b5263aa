//! The search for the best compensator of a box.

use super::climb::climb;
use super::design::{Compensator, Design, DesignLimits};
use crate::control::bode::log_grid;
use crate::excite::path::PathError;
use crate::excite::peak::golden;
use crate::num::{Ctl, Stopped};
use rayon::iter::{IntoParallelIterator as _, ParallelIterator as _};
use std::collections::BTreeMap;

/// Gains on the grid where a zero and a pole are free.
const GAINS: usize = 81;
/// Gains on the grid of a single unknown.
const GAINS_ALONE: usize = 801;
/// Zeros and poles on the grid.
const CORNERS: usize = 25;
/// Local maxima of the grid that are climbed from.
const CLIMBS: usize = 12;
/// Answers that differ by less than this share are one.
const SAME: f64 = 1e-6;
/// An unknown within this distance (of its logarithm) from an edge is on it.
const EDGE: f64 = 1e-6;
/// A climb that ends this near an edge is tried on it.
const NEAR_EDGE: f64 = 0.05;

/// Between which values each unknown is looked for; equal ends fix it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SearchBox {
    /// K.
    pub gain: [f64; 2],
    /// f_z and f_p in Hz; none for proportional control.
    pub corners: Option<[[f64; 2]; 2]>,
    /// Whether f_z ≤ f_p is asked for: a lead in the strict sense.
    pub zero_below_pole: bool,
}

/// Why there is no best compensator.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DesignError {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// Nothing in the box is stable.
    #[error("no compensator of the {points} that were tried makes the loop stable with the decay asked for")]
    NothingStable {
        /// Points of the grid.
        points: usize,
    },
    /// Nothing stable in the box keeps the limits.
    #[error(
        "none of the {stable} stable compensators that were tried keeps the limits; the least that was reached: {reached}"
    )]
    Limits {
        /// Stable points of the grid.
        stable: usize,
        /// Each limited quantity, its least value and its limit.
        reached: String,
    },
    /// The answer's loop cannot be judged.
    #[error(transparent)]
    Path(#[from] PathError),
}

/// What was searched.
#[derive(Debug, Clone, PartialEq)]
pub struct SearchSummary {
    /// Points of the grid.
    pub points: usize,
    /// Those whose loop is stable.
    pub stable: usize,
    /// Climbs, each from a local maximum of the grid.
    pub climbs: usize,
    /// Climbs that ended in the answer.
    pub agreeing: usize,
    /// The best value of a climb that ended elsewhere.
    pub runner_up: Option<(Compensator, f64)>,
    /// Edges of the box that hold the answer: `gain`, `zero_hz` or `pole_hz`, each with `lower` or `upper`, or `zero_below_pole`.
    pub edges: Vec<(&'static str, &'static str)>,
}

/// The answer of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// The best compensator.
    pub compensator: Compensator,
    /// Its SFG_xr.
    pub blsfg: f64,
    /// How it was found.
    pub summary: SearchSummary,
}

/// A point in the logarithms of the unknowns.
struct Space {
    bounds: Vec<[f64; 2]>,
    corners: bool,
    zero_below_pole: bool,
}

impl Space {
    fn new(region: &SearchBox) -> Self {
        let logs = |ends: [f64; 2]| ends.map(f64::ln);
        let mut bounds = vec![logs(region.gain)];
        if let Some([zero, pole]) = region.corners {
            bounds.extend([logs(zero), logs(pole)]);
        }
        Self { bounds, corners: region.corners.is_some(), zero_below_pole: region.zero_below_pole }
    }

    fn compensator(&self, x: &[f64]) -> Compensator {
        if self.corners {
            // Equal corners are proportional control exactly.
            let (zero, pole) = (x[1].exp(), if self.zero_below_pole { x[2].max(x[1]) } else { x[2] }.exp());
            Compensator { gain: x[0].exp(), zero_hz: zero, pole_hz: pole }
        } else {
            Compensator::proportional(x[0].exp())
        }
    }

    fn axis(&self, i: usize, count: usize) -> Vec<f64> {
        let [low, high] = self.bounds[i];
        if high - low < EDGE { vec![low] } else { crate::control::bode::linear_grid(low, high, count) }
    }
}

/// The best compensator of a box; deterministic, whatever the number of threads.
///
/// Progress counts columns of the grid, then climbs.
///
/// # Errors
/// [`DesignError`].
pub fn search(design: &Design, region: &SearchBox, limits: &DesignLimits, ctl: &Ctl) -> Result<Found, DesignError> {
    let space = Space::new(region);
    let decay = limits.decay_per_s.unwrap_or(0.0);
    let value = |x: &[f64]| -> f64 {
        let compensator = space.compensator(x);
        if !design.is_stable(&compensator, decay) {
            return f64::NEG_INFINITY;
        }
        let blsfg = design.blsfg(&compensator);
        if blsfg.is_finite() { blsfg } else { f64::NEG_INFINITY }
    };
    let keeps =
        |x: &[f64]| design.excess(&space.compensator(x), limits).iter().all(|(_, reached, limit)| reached <= limit);

    // The grid: a column of gains for every zero and pole.
    let gains = space.axis(0, if space.corners { GAINS } else { GAINS_ALONE });
    let columns: Vec<Vec<f64>> = if space.corners {
        let poles = space.axis(2, CORNERS);
        space
            .axis(1, CORNERS)
            .iter()
            .flat_map(|z| poles.iter().map(|p| vec![*z, *p]).collect::<Vec<_>>())
            .filter(|c| !space.zero_below_pole || c[0] <= c[1] + EDGE)
            .collect()
    } else {
        vec![Vec::new()]
    };
    let at = |gain: f64, column: &[f64]| -> Vec<f64> { std::iter::once(gain).chain(column.iter().copied()).collect() };
    ctl.set_total((columns.len() + CLIMBS) as u64);
    let grid: Vec<Vec<f64>> = columns
        .clone()
        .into_par_iter()
        .map(|column| {
            let mut values = Vec::with_capacity(gains.len());
            for gain in &gains {
                ctl.check()?;
                values.push(value(&at(*gain, &column)));
            }
            ctl.advance(1);
            Ok(values)
        })
        .collect::<Result<_, Stopped>>()?;
    let stable = grid.iter().flatten().filter(|v| v.is_finite()).count();
    let points = grid.len() * gains.len();
    if stable == 0 {
        return Err(DesignError::NothingStable { points });
    }
    let starts = starts(design, &space, &gains, &columns, &grid, limits, stable, ctl)?;
    let spacing: Vec<f64> = (0..space.bounds.len())
        .map(|i| {
            let count = if i > 0 { CORNERS } else { gains.len() };
            (space.bounds[i][1] - space.bounds[i][0]) / count as f64
        })
        .collect();
    let limited = !limits.motion().is_empty() || limits.disturbance_norm.is_some();
    let mut best: Option<(Vec<f64>, f64)> = None;
    let mut ends: Vec<(Vec<f64>, f64)> = Vec::new();
    ctl.advance((CLIMBS - starts.len()) as u64);
    for start in &starts {
        let mut stopped = None;
        let mut f = |x: &[f64]| {
            if let Err(reason) = ctl.check() {
                stopped = Some(reason);
            }
            if stopped.is_some() {
                return f64::NEG_INFINITY;
            }
            let reached = value(x);
            if limited && reached.is_finite() && !keeps(x) { f64::NEG_INFINITY } else { reached }
        };
        let end = ascend(&mut f, start, &spacing, &space.bounds);
        if let Some(reason) = stopped {
            return Err(reason.into());
        }
        if best.as_ref().is_none_or(|(_, value)| end.1 > *value) {
            best = Some(end.clone());
        }
        ends.push(end);
        ctl.advance(1);
    }
    let Some((x, blsfg)) = best else {
        return Err(DesignError::NothingStable { points });
    };
    let agrees = |end: &(Vec<f64>, f64)| (end.1 - blsfg).abs() <= SAME * blsfg;
    let runner_up = ends
        .iter()
        .filter(|end| !agrees(end))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(x, value)| (space.compensator(x), *value));
    let compensator = space.compensator(&x);
    let summary = SearchSummary {
        points,
        stable,
        climbs: starts.len(),
        agreeing: ends.iter().filter(|end| agrees(end)).count(),
        runner_up,
        edges: edges(&space, &x),
    };
    Ok(Found { compensator, blsfg, summary })
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

/// A climb in all unknowns, then along the edges where it ended, then in the gain alone.
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
    // The maximum over the gain is flat: a last golden section settles its place.
    if free.contains(&0) {
        let reach = spacing[0].min(0.05);
        let [low, high] = bounds[0];
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
    (x, value)
}

/// Local maxima of the grid along the gain that keep the limits, best first and from different places.
#[expect(clippy::too_many_arguments, reason = "one call, of what the search has at hand")]
fn starts(
    design: &Design,
    space: &Space,
    gains: &[f64],
    columns: &[Vec<f64>],
    grid: &[Vec<f64>],
    limits: &DesignLimits,
    stable: usize,
    ctl: &Ctl,
) -> Result<Vec<Vec<f64>>, DesignError> {
    let limited = !limits.motion().is_empty() || limits.disturbance_norm.is_some();
    let mut order: Vec<(usize, usize)> = Vec::new();
    for (c, values) in grid.iter().enumerate() {
        for (g, value) in values.iter().enumerate() {
            let around = [g.checked_sub(1), (g + 1 < values.len()).then_some(g + 1)];
            let is_top = around.into_iter().flatten().all(|other| values[other] <= *value);
            // Limits may cut off every top, so that any point can be the best one that keeps them.
            if value.is_finite() && (limited || is_top) {
                order.push((c, g));
            }
        }
    }
    // Ties go to the first.
    order.sort_by(|a, b| grid[b.0][b.1].total_cmp(&grid[a.0][a.1]).then(a.cmp(b)));
    let mut chosen: Vec<Vec<f64>> = Vec::new();
    let mut least: BTreeMap<&'static str, (f64, f64)> = BTreeMap::new();
    let apart = |x: &[f64], y: &[f64]| {
        (0..x.len()).any(|i| {
            let count = if i > 0 { CORNERS } else { gains.len().min(GAINS) };
            (x[i] - y[i]).abs() > 1.5 * (space.bounds[i][1] - space.bounds[i][0]) / count as f64
        })
    };
    for (c, g) in order {
        ctl.check()?;
        let x: Vec<f64> = std::iter::once(gains[g]).chain(columns[c].iter().copied()).collect();
        if chosen.iter().any(|y| !apart(&x, y)) {
            continue;
        }
        if limited {
            let found = design.excess(&space.compensator(&x), limits);
            let kept = found.iter().all(|(_, reached, limit)| reached <= limit);
            for (name, reached, limit) in found {
                let entry = least.entry(name).or_insert((f64::INFINITY, limit));
                entry.0 = entry.0.min(reached);
            }
            if !kept {
                continue;
            }
        }
        chosen.push(x);
        if chosen.len() == CLIMBS {
            break;
        }
    }
    if chosen.is_empty() {
        let reached = least
            .iter()
            .map(|(name, (least, limit))| format!("{name} {least:.6} where the limit is {limit}"))
            .collect::<Vec<_>>()
            .join(", ");
        return Err(DesignError::Limits { stable, reached });
    }
    Ok(chosen)
}

fn edges(space: &Space, x: &[f64]) -> Vec<(&'static str, &'static str)> {
    let mut edges = Vec::new();
    for (i, name) in ["gain", "zero_hz", "pole_hz"].into_iter().enumerate().take(space.bounds.len()) {
        let [low, high] = space.bounds[i];
        if high - low < EDGE {
            continue;
        }
        if x[i] - low < EDGE {
            edges.push((name, "lower"));
        } else if high - x[i] < EDGE {
            edges.push((name, "upper"));
        }
    }
    if space.corners && space.zero_below_pole && x[2] - x[1] < EDGE {
        edges.push(("zero_below_pole", "equal"));
    }
    edges
}

/// SFG_xr and what goes with it over a range of gains, for one zero and pole (Qiu 2021, figure 5).
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// f_z and f_p in Hz; none for proportional control.
    pub corners: Option<[f64; 2]>,
    /// K.
    pub gain: Vec<f64>,
    /// SFG_xr; `None` where the loop is not stable.
    pub blsfg: Vec<Option<f64>>,
    /// The resonance in rad/s; `None` where there is none, or no stability.
    pub resonance_rad_s: Vec<Option<f64>>,
    /// ‖S P‖∞; `None` where the loop is not stable.
    pub disturbance_norm: Vec<Option<f64>>,
}

/// A curve over `count` gains, equally spaced on a logarithmic scale.
///
/// # Errors
/// [`DesignError::Stopped`].
pub fn sweep(
    design: &Design,
    corners: Option<[f64; 2]>,
    gain: [f64; 2],
    count: usize,
    ctl: &Ctl,
) -> Result<Curve, DesignError> {
    let gains = log_grid(gain[0], gain[1], count);
    let judged: Vec<Option<(f64, Option<f64>, f64)>> = gains
        .clone()
        .into_par_iter()
        .map(|gain| {
            ctl.check()?;
            let compensator = corners.map_or_else(
                || Compensator::proportional(gain),
                |[zero_hz, pole_hz]| Compensator { gain, zero_hz, pole_hz },
            );
            let Some(path) = design.is_stable(&compensator, 0.0).then(|| design.path(&compensator).ok()).flatten()
            else {
                return Ok(None);
            };
            let nyquist = std::f64::consts::PI / design.plant().time().period_s();
            let peak = crate::excite::peak::resonance(|w| path.response(w).norm(), nyquist, &path.pole_hints());
            Ok(Some((design.blsfg(&compensator), peak.map(|p| p.at), design.disturbance_norm(&compensator).value)))
        })
        .collect::<Result<_, Stopped>>()?;
    ctl.advance(1);
    Ok(Curve {
        corners,
        gain: gains,
        blsfg: judged.iter().map(|j| j.map(|j| j.0)).collect(),
        resonance_rad_s: judged.iter().map(|j| j.and_then(|j| j.1)).collect(),
        disturbance_norm: judged.iter().map(|j| j.map(|j| j.2)).collect(),
    })
}
