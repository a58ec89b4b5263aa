//! The search for the best compensator of a box.

use super::ascent::Task;
use super::bound::{Impossible, impossible};
use super::climbs::{STEPS, climb_from};
use super::controller::Compensator;
use super::design::{Design, DesignLimits};
use super::edge::Edge;
use super::search_box::{SearchBox, SectionBox};
use super::several;
use super::space::{EDGE, Space};
use crate::control::bode::log_grid;
use crate::ctl::{Ctl, Phase, Stopped};
use crate::excite::path::PathError;
use rayon::iter::{IntoParallelIterator as _, IntoParallelRefIterator as _, ParallelIterator as _};
use std::collections::BTreeMap;

/// Gains on the grid where a zero and a pole are free.
const GAINS: usize = 81;
/// Gains on the grid of a single unknown.
const GAINS_ALONE: usize = 801;
/// Zeros and poles on the grid.
const CORNERS: usize = 25;
/// Local maxima of the grid that are climbed from.
const CLIMBS: usize = 8;
/// Answers that differ by less than this share are one.
pub(super) const SAME: f64 = 1e-6;
/// Points whose limits are checked at once.
const BATCH: usize = 256;
/// Points that are looked at closely where none keeps the limits.
const LOOKED_AT: usize = 400;

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
    /// It is proven that nothing stable in the box keeps the limits.
    #[error("no stable compensator within the ranges keeps the limits: {}", impossible_words(.0))]
    Impossible(Impossible),
    /// Nothing stable that was tried keeps the limits.
    #[error(
        "none of the {stable} stable compensators that were tried keeps the limits together; each by itself reaches \
         at least: {reached}"
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

/// What is proven, in words.
fn impossible_words(found: &Impossible) -> String {
    let words = found.least.iter().map(|(name, least, limit)| {
        if least.is_finite() {
            format!("the {name} of each is at least {least:.4e}, and {limit} is allowed")
        } else {
            format!("none decays as fast as asked, whatever its {name}")
        }
    });
    let together = if found.least.iter().any(|(_, least, limit)| least > limit) { "" } else { " (not both at once)" };
    words.collect::<Vec<_>>().join("; ") + together
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
    /// Edges of the box that hold the answer.
    pub edges: Vec<Edge>,
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

/// The best compensator of a box; deterministic, whatever the number of threads.
///
/// Progress counts columns of the grid, then climbs.
///
/// # Errors
/// [`DesignError`].
pub fn search(design: &Design, region: &SearchBox, limits: &DesignLimits, ctl: &Ctl) -> Result<Found, DesignError> {
    if let Some(found) = impossible(design, region, limits) {
        return Err(DesignError::Impossible(found));
    }
    if region.sections.len() > 1 || region.sections.iter().any(|s| matches!(s, SectionBox::Second { .. })) {
        return several::search(design, region, limits, ctl);
    }
    let space = Space::new(region);
    let value = |x: &[f64]| value(design, &space.compensator(x));
    let has_corners = !region.sections.is_empty();
    // The grid: a column of gains for every zero and pole.
    let gains = space.axis(0, if has_corners { GAINS } else { GAINS_ALONE });
    let columns: Vec<Vec<f64>> = if has_corners {
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
    ctl.enter(Phase::Search, 0.2);
    ctl.set_total(columns.len() as u64);
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
    let task = Task { design, space: &space, limits, ctl };
    let starts = starts(&task, &gains, &columns, &grid, stable)?;
    let spacing: Vec<f64> = (0..space.bounds.len())
        .map(|i| {
            let count = if i > 0 { CORNERS } else { gains.len() };
            (space.bounds[i][1] - space.bounds[i][0]) / count as f64
        })
        .collect();
    ctl.enter(Phase::Fit, 0.8);
    ctl.set_total(STEPS * starts.len() as u64);
    let climbed = climb_from(&task, &starts, &spacing)?;
    best_of(&space, climbed, points, stable)
}

/// The best end of all climbs.
pub(super) fn best_of(
    space: &Space,
    climbed: Vec<(Vec<f64>, f64)>,
    points: usize,
    stable: usize,
) -> Result<Found, DesignError> {
    let ends: Vec<(Vec<f64>, f64)> = climbed.into_iter().filter(|(_, value)| value.is_finite()).collect();
    // Ties go to the first.
    let best = ends.iter().fold(None, |best: Option<&(Vec<f64>, f64)>, end| match best {
        Some(best) if best.1 >= end.1 => Some(best),
        _ => Some(end),
    });
    let Some((x, blsfg)) = best.cloned() else {
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
        climbs: ends.len(),
        agreeing: ends.iter().filter(|end| agrees(end)).count(),
        runner_up,
        edges: space.edges(&x),
    };
    Ok(Found { compensator, blsfg, summary })
}

/// SFG_xr of a stable loop, and −∞ of any other.
pub(super) fn value(design: &Design, compensator: &Compensator) -> f64 {
    if !design.is_stable(compensator, 0.0) {
        return f64::NEG_INFINITY;
    }
    let blsfg = design.blsfg(compensator);
    if blsfg.is_finite() { blsfg } else { f64::NEG_INFINITY }
}

/// Local maxima of the grid that keep the limits, best first and from different places.
fn starts(
    task: &Task,
    gains: &[f64],
    columns: &[Vec<f64>],
    grid: &[Vec<f64>],
    stable: usize,
) -> Result<Vec<Vec<f64>>, DesignError> {
    let bounds = &task.space.bounds;
    let mut order: Vec<(usize, usize)> = Vec::new();
    for (c, values) in grid.iter().enumerate() {
        for (g, value) in values.iter().enumerate() {
            let around = [g.checked_sub(1), (g + 1 < values.len()).then_some(g + 1)];
            let is_top = around.into_iter().flatten().all(|other| values[other] <= *value);
            // Limits may cut off every top, so that any point can be the best one that keeps them.
            if value.is_finite() && (task.is_limited() || is_top) {
                order.push((c, g));
            }
        }
    }
    // Ties go to the first.
    order.sort_by(|a, b| grid[b.0][b.1].total_cmp(&grid[a.0][a.1]).then(a.cmp(b)));
    let points: Vec<Vec<f64>> =
        order.into_iter().map(|(c, g)| std::iter::once(gains[g]).chain(columns[c].iter().copied()).collect()).collect();
    let apart = |x: &[f64], y: &[f64]| {
        (0..x.len()).any(|i| {
            let count = if i > 0 { CORNERS } else { gains.len().min(GAINS) };
            (x[i] - y[i]).abs() > 1.5 * (bounds[i][1] - bounds[i][0]) / count as f64
        })
    };
    let mut chosen: Vec<Vec<f64>> = Vec::new();
    for batch in points.chunks(BATCH) {
        task.ctl.check()?;
        let wanted: Vec<&Vec<f64>> = batch.iter().filter(|x| chosen.iter().all(|y| apart(x, y))).collect();
        // Limits on the motion simulate every candidate, so that a batch takes its time.
        let kept: Vec<bool> = wanted
            .par_iter()
            .map(|x| {
                task.ctl.check()?;
                Ok(task.keeps(x))
            })
            .collect::<Result<_, Stopped>>()?;
        for (x, _) in wanted.into_iter().zip(kept).filter(|(_, kept)| *kept) {
            if chosen.len() < CLIMBS && chosen.iter().all(|y| apart(x, y)) {
                chosen.push(x.clone());
            }
        }
        if chosen.len() == CLIMBS {
            break;
        }
    }
    if chosen.is_empty() {
        return Err(DesignError::Limits { stable, reached: least_reached(task, &points)? });
    }
    Ok(chosen)
}

/// The least of each limited quantity over some of the stable points, in words.
pub(super) fn least_reached(task: &Task, points: &[Vec<f64>]) -> Result<String, Stopped> {
    let some: Vec<&Vec<f64>> = points.iter().step_by(points.len().div_ceil(LOOKED_AT)).collect();
    let found: Vec<Vec<(&'static str, f64, f64)>> = some
        .into_par_iter()
        .map(|x| {
            task.ctl.check()?;
            Ok(task.design.reached(&task.space.compensator(x), task.limits))
        })
        .collect::<Result<_, Stopped>>()?;
    let mut least: BTreeMap<&'static str, (f64, f64)> = BTreeMap::new();
    for (name, reached, limit) in found.into_iter().flatten() {
        let entry = least.entry(name).or_insert((f64::INFINITY, limit));
        entry.0 = entry.0.min(reached);
    }
    let mut words: Vec<String> =
        least.iter().map(|(name, (least, limit))| format!("{name} {least:.4e} where the limit is {limit}")).collect();
    words.extend(task.limits.decay_per_s.map(|decay| format!("every pole must decay at {decay} per second")));
    Ok(words.join(", "))
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
            let compensator = corners
                .map_or_else(|| Compensator::proportional(gain), |[zero, pole]| Compensator::lead(gain, zero, pole));
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
