//! Compensators of several sections, or of sections of second order: from the best of one section less.

use super::ascent::Task;
use super::climbs::{self, climb_from};
use super::design::{Design, DesignLimits};
use super::search::{self, DesignError, Found, best_of};
use super::search_box::{SearchBox, SectionBox};
use super::space::Space;
use super::{Compensator, Section};
use crate::control::bode::log_grid;
use crate::ctl::{Ctl, Stopped};
use rayon::iter::{IntoParallelIterator as _, ParallelIterator as _};

/// Places at which a new section is tried.
const PLACES: usize = 7;
/// How far its zeros are moved from its poles at first, in their logarithm.
const APART: f64 = 0.5;
/// Points spread over the whole box beside.
const SPREAD: usize = 256;
/// Starts that are climbed from.
const CLIMBS: usize = 6;
/// The damping of a new section.
const DAMPING: f64 = 0.7;
/// Shares of the box that a climb's first steps take.
const STEPS: f64 = 25.0;

/// The best compensator; no worse than the best with one section of first order less, whose answer it begins with.
///
/// # Errors
/// [`DesignError`].
pub(super) fn search(
    design: &Design,
    region: &SearchBox,
    limits: &DesignLimits,
    ctl: &Ctl,
) -> Result<Found, DesignError> {
    let (zero_hz, pole_hz) = corners(&region.sections[0]);
    let one = SearchBox { sections: vec![SectionBox::First { zero_hz, pole_hz }], ..region.clone() };
    let mut known = match search::search(design, &one, limits, ctl) {
        Ok(found) => Some(found.compensator),
        // More sections may keep what one cannot.
        Err(DesignError::Limits { .. } | DesignError::Impossible(_)) => None,
        Err(error) => return Err(error),
    };
    let first = usize::from(matches!(region.sections[0], SectionBox::First { .. }));
    ctl.set_total(climbs::STEPS * (CLIMBS * (region.sections.len() - first)) as u64);
    let mut last = None;
    for count in 1 + first..=region.sections.len() {
        let part = SearchBox { sections: region.sections[..count].to_vec(), ..region.clone() };
        let space = Space::new(&part);
        let task = Task { design, space: &space, limits, ctl };
        let found = stage(&task, &part, known.as_ref())?;
        known = Some(found.compensator.clone());
        last = Some(found);
    }
    last.ok_or(DesignError::NothingStable { points: 0 })
}

/// The ranges of zeros and poles.
fn corners(section: &SectionBox) -> ([f64; 2], [f64; 2]) {
    match *section {
        SectionBox::First { zero_hz, pole_hz } | SectionBox::Second { zero_hz, pole_hz, .. } => (zero_hz, pole_hz),
    }
}

/// The best of so many sections, from the best of one less.
fn stage(task: &Task<'_>, region: &SearchBox, known: Option<&Compensator>) -> Result<Found, DesignError> {
    let space = task.space;
    let value = |x: &[f64]| search::value(task.design, &space.compensator(x));
    let mut starts: Vec<Vec<f64>> = known.map_or_else(Vec::new, |known| extended(known, region));
    let beginnings = starts.len();
    starts.extend((1..=SPREAD).map(|i| spread(i, &space.bounds)));
    let points = starts.len();
    let judged: Vec<(f64, bool)> = starts
        .clone()
        .into_par_iter()
        .map(|x| {
            task.ctl.check()?;
            let inside = x.iter().zip(&space.bounds).all(|(x, [low, high])| (low - 1e-9..=high + 1e-9).contains(x));
            let value = if inside { value(&x) } else { f64::NEG_INFINITY };
            Ok((value, value.is_finite() && (!task.is_limited() || task.keeps(&x))))
        })
        .collect::<Result<_, Stopped>>()?;
    let stable = judged.iter().filter(|(value, _)| value.is_finite()).count();
    let mut order: Vec<usize> = (0..points).filter(|i| judged[*i].1).collect();
    order.sort_by(|a, b| judged[*b].0.total_cmp(&judged[*a].0).then(a.cmp(b)));
    // Half of them from the answer of one section less, where there is one.
    let (near, far): (Vec<usize>, Vec<usize>) = order.iter().partition(|i| **i < beginnings);
    let half = CLIMBS / 2;
    let taken = near.iter().take(CLIMBS - far.len().min(half));
    let chosen: Vec<usize> = taken.chain(&far).take(CLIMBS).copied().collect();
    if chosen.is_empty() {
        if stable == 0 {
            return Err(DesignError::NothingStable { points });
        }
        let all: Vec<Vec<f64>> =
            starts.into_iter().zip(&judged).filter(|(_, (value, _))| value.is_finite()).map(|(x, _)| x).collect();
        return Err(DesignError::Limits { stable, reached: search::least_reached(task, &all)? });
    }
    let spacing: Vec<f64> = space.bounds.iter().map(|[low, high]| (high - low) / STEPS).collect();
    let unused = climbs::STEPS * (CLIMBS - chosen.len()) as u64;
    let chosen: Vec<Vec<f64>> = chosen.iter().map(|i| starts[*i].clone()).collect();
    let mut climbed = climb_from(task, &chosen, &spacing)?;
    task.ctl.advance(unused);
    // What is known already is never lost.
    climbed.extend(near.first().map(|i| (starts[*i].clone(), judged[*i].0)));
    best_of(space, climbed, points, stable)
}

/// Points of a box that are, or are near, a compensator of one section less: with a section that is 1 at each of some
/// places, and with its zeros moved.
fn extended(known: &Compensator, region: &SearchBox) -> Vec<Vec<f64>> {
    let count = region.sections.len();
    let mut before = vec![known.gain.ln()];
    for section in &known.sections {
        match *section {
            Section::First { zero_hz, pole_hz } => before.extend([zero_hz.ln(), pole_hz.ln()]),
            Section::Second { zero_hz, zero_damping, pole_hz, pole_damping } => {
                before.extend([zero_hz, zero_damping, pole_hz, pole_damping].map(f64::ln));
            }
        }
    }
    let (zeros, poles) = corners(&region.sections[count - 1]);
    let places = log_grid(zeros[0].max(poles[0]), zeros[1].min(poles[1]), PLACES);
    let with = |rest: &[f64], at: usize| -> Vec<f64> { before[..at].iter().chain(rest).copied().collect() };
    let mut found = Vec::new();
    match (&region.sections[count - 1], known.sections.len() < count) {
        // The lead, times a section that is 1: both of second order.
        (SectionBox::Second { .. }, false) => {
            let Some(Section::First { zero_hz: z, pole_hz: p }) = known.sections.first().copied() else {
                return found;
            };
            let product = |a: f64, q: f64| [(a * q).sqrt().ln(), (0.5 * (a + q) / (a * q).sqrt()).ln()];
            for q in [z, p, (z * p).sqrt()].into_iter().chain(places) {
                let ([wz, dz], [wp, dp]) = (product(z, q), product(p, q));
                for apart in [0.0, APART, -APART] {
                    found.push(with(&[wz + apart, dz, wp, dp], 1));
                }
            }
        }
        (SectionBox::Second { .. }, true) => {
            for f in places.into_iter().map(f64::ln) {
                for apart in [0.0, APART, -APART] {
                    found.push(with(&[f + apart, DAMPING.ln(), f, DAMPING.ln()], before.len()));
                }
            }
        }
        (SectionBox::First { .. }, _) => {
            for f in places.into_iter().map(f64::ln) {
                for apart in [0.0, APART, -APART] {
                    found.push(with(&[f + apart, f], before.len()));
                }
            }
        }
    }
    found
}

/// Point number i of a sequence that is spread evenly over a box (Halton 1960).
fn spread(i: usize, bounds: &[[f64; 2]]) -> Vec<f64> {
    const PRIMES: [usize; 17] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59];
    bounds
        .iter()
        .zip(PRIMES)
        .map(|([low, high], prime)| {
            let (mut left, mut share, mut unit) = (i, 0.0, 1.0);
            while left > 0 {
                unit /= prime as f64;
                share += unit * (left % prime) as f64;
                left /= prime;
            }
            low + share * (high - low)
        })
        .collect()
}
