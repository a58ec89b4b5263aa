//! A recording beside the sequence that it is said to be of.
//!
//! The record is cut into windows that hold some independent pieces of the sequence each; for every window the delay is
//! sought at which it correlates best with the sequence. Delays that grow with time are a clock that runs at another
//! rate, a step between two windows is samples that are missing or there twice, and a correlation that is low at every
//! delay is another sequence. A device does not follow at once: how much of the record a short response to the sequence
//! explains, a few pieces long, is said beside the plain correlation, with what chance would explain.

use crate::ctl::{Ctl, Stopped};
use crate::num::Complex64;
use crate::num::fourier;
use crate::num::linalg::least_squares;
use nalgebra::{DMatrix, DVector};

/// Independent pieces of the sequence in a window at least, and for each e-fold of delays that it may have: among D
/// delays the largest correlation of m pieces by chance is about `√(2 ln D/m)`, here 0.41.
const PIECES: [f64; 2] = [16.0, 12.0];
/// Windows at most.
const WINDOWS: usize = 64;
/// Windows whose delay is sought over the whole sequence.
const ANCHORS: usize = 8;
/// Least correlation of a window whose delay counts.
const CLEAR: f64 = 0.5;
/// A step of the delay between two windows beyond this many samples is missing samples.
const STEP: f64 = 0.7;
/// Two steps in turn, each beyond this many samples and of one sign, are one.
const SPLIT: f64 = 0.25;
/// Values of the short response for each piece, and pieces that it reaches back.
const TAPS: [usize; 2] = [4, 2];
/// Independent pieces for each value of the response at least.
const PER_TAP: f64 = 5.0;
/// Samples that the response is fitted to at most.
const FITTED: usize = 20_000;
/// Share of the record below which it is not the sequence, and how often chance's own share.
const EXPLAINED: [f64; 2] = [0.25, 3.0];
/// Standard errors of a clock's rate that make it one.
const SURE: f64 = 4.0;

/// What a recording is said to be of.
#[derive(Debug, Clone, PartialEq)]
pub struct Declared {
    /// Its samples at the recording's rate: one period, or all of it.
    pub values: Vec<f64>,
    /// Whether it repeats.
    pub is_periodic: bool,
    /// Length of an independent piece, samples: of a chip, or half the shortest wave.
    pub piece: f64,
}

/// A step in the delay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jump {
    /// Sample of the record near which it is: the start of the window that has the new delay.
    pub near: usize,
    /// Samples that are missing there; negative where there are more than there should be.
    pub missing: i64,
}

/// What came of the comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// The correlation coefficient, windows put at their own delays: from −1 to 1.
    pub correlation: f64,
    /// By how many samples the record is behind the sequence, at its first sample.
    pub delay: f64,
    /// Share of the record's variance that a short response to the sequence explains.
    pub explained: f64,
    /// What it would explain by chance.
    pub by_chance: f64,
    /// Samples of delay that each sample of the record gains, and its standard error: positive where the record has too
    /// many samples for the sequence, since it was played too slowly or recorded with too fast a clock. `None` with
    /// fewer than three clear windows.
    pub clock: Option<[f64; 2]>,
    /// Steps of the delay.
    pub jumps: Vec<Jump>,
    /// Windows, and those with a clear delay.
    pub windows: [usize; 2],
    /// Whether it is the declared sequence.
    pub is_declared: bool,
}

impl Comparison {
    /// Whether the clock's rate is off by more than its uncertainty, and by half a sample at least over the record.
    #[must_use]
    pub fn clock_is_off(&self, samples: usize) -> bool {
        self.clock.is_some_and(|[rate, error]| rate.abs() > SURE * error && rate.abs() * samples as f64 > 0.5)
    }
}

/// A window: its first sample, delay and correlation.
#[derive(Debug, Clone, Copy)]
struct Window {
    start: usize,
    delay: f64,
    correlation: f64,
}

struct Pair<'a> {
    record: Vec<f64>,
    declared: &'a Declared,
    reference: Vec<f64>,
}

fn level(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    values.iter().map(|x| x - mean).collect()
}

/// Compares a record with what it is said to be of; `None` where one of them is constant.
///
/// # Errors
/// [`Stopped`].
pub fn compare(record: &[f64], declared: &Declared, ctl: &Ctl) -> Result<Option<Comparison>, Stopped> {
    let pair = Pair { record: level(record), declared, reference: level(&declared.values) };
    let energy = |values: &[f64]| values.iter().map(|x| x * x).sum::<f64>();
    let has_both = energy(&pair.record) > 0.0 && energy(&pair.reference) > 0.0;
    if !has_both {
        return Ok(None);
    }
    let n = pair.record.len();
    let span = if declared.is_periodic { declared.values.len() } else { n + declared.values.len() };
    let pieces = PIECES[0].max(PIECES[1] * (span as f64 / declared.piece).max(2.0).ln());
    let length = ((pieces * declared.piece).ceil() as usize).max(n.div_ceil(WINDOWS)).clamp(4.min(n), n);
    let count = n / length;
    let starts: Vec<usize> = (0..count).map(|i| i * length).collect();
    // The delay of a few windows over the whole sequence; the clearest leads the others.
    let mut anchor: Option<Window> = None;
    for i in (0..count).step_by(count.div_ceil(ANCHORS)) {
        let found = pair.anywhere(starts[i], length, ctl)?;
        if anchor.is_none_or(|best| found.correlation > best.correlation) {
            anchor = Some(found);
        }
    }
    let Some(anchor) = anchor else { return Ok(None) };
    let middle = anchor.start / length;
    let mut windows: Vec<Option<Window>> = vec![None; count];
    windows[middle] = Some(anchor);
    for (order, step) in [((middle + 1..count).collect::<Vec<_>>(), -1_isize), ((0..middle).rev().collect(), 1)] {
        for i in order {
            ctl.check()?;
            let before = windows[(i as isize + step) as usize].map_or(anchor.delay, |window| window.delay);
            let mut found = pair.near(starts[i], length, before);
            if found.correlation < CLEAR && anchor.correlation >= CLEAR {
                let elsewhere = pair.anywhere(starts[i], length, ctl)?;
                if elsewhere.correlation > found.correlation.max(CLEAR) {
                    found = elsewhere;
                    found.delay = pair.nearest_turn(found.delay, before);
                } else {
                    found.delay = before;
                }
            }
            windows[i] = Some(found);
        }
    }
    let windows: Vec<Window> = windows.into_iter().flatten().collect();
    Ok(Some(pair.judged(&windows, length)))
}

impl Pair<'_> {
    fn at(&self, k: isize) -> f64 {
        let n = self.reference.len() as isize;
        if self.declared.is_periodic {
            self.reference[k.rem_euclid(n) as usize]
        } else {
            usize::try_from(k).ok().and_then(|k| self.reference.get(k)).copied().unwrap_or(0.0)
        }
    }

    /// The correlation coefficient of a window at a delay.
    fn correlation(&self, start: usize, length: usize, delay: isize) -> f64 {
        let (mut cross, mut own, mut other) = (0.0, 0.0, 0.0);
        for (k, y) in self.record[start..start + length].iter().enumerate() {
            let r = self.at((start + k) as isize - delay);
            cross += y * r;
            own += y * y;
            other += r * r;
        }
        if own > 0.0 && other > 0.0 { cross / (own * other).sqrt() } else { 0.0 }
    }

    /// The best delay within a few samples of another.
    fn near(&self, start: usize, length: usize, delay: f64) -> Window {
        let reach = (self.declared.piece / 4.0).clamp(8.0, 64.0) as isize;
        let centre = delay.round() as isize;
        let found: Vec<f64> = (centre - reach..=centre + reach).map(|d| self.correlation(start, length, d)).collect();
        let best = (0..found.len()).max_by(|a, b| found[*a].total_cmp(&found[*b])).unwrap_or(0);
        let offset =
            if best > 0 && best + 1 < found.len() { vertex([best - 1, best, best + 1].map(|i| found[i])) } else { 0.0 };
        Window { start, delay: (centre - reach + best as isize) as f64 + offset, correlation: found[best] }
    }

    /// The best delay of a window over the whole sequence, by the fast transform.
    fn anywhere(&self, start: usize, length: usize, ctl: &Ctl) -> Result<Window, Stopped> {
        let period = self.reference.len();
        let window = &self.record[start..start + length];
        let n = if self.declared.is_periodic { period } else { (period + length).next_power_of_two() };
        let mut own = vec![0.0; n];
        // A window longer than a period is laid over itself, which the sum over all its samples allows.
        for (k, y) in window.iter().enumerate() {
            own[k % n] += y;
        }
        let mut other = self.reference.clone();
        other.resize(n, 0.0);
        let mut squares: Vec<f64> = vec![0.0; n];
        for (k, into) in squares.iter_mut().enumerate() {
            *into = other[k] * other[k];
        }
        let mut ones = vec![0.0; n];
        for k in 0..length {
            ones[k % n] += 1.0;
        }
        let transform = |values: &[f64]| fourier::real_transform_in_parts(values, ctl);
        let product = |a: &[Complex64], b: &[Complex64]| a.iter().zip(b).map(|(a, b)| a.conj() * b).collect::<Vec<_>>();
        // Σ_k y_k r_{k+s} and Σ_k r_{k+s}² over the window, for every shift s.
        let cross = fourier::inverse_real_in_parts(&product(&transform(&own)?, &transform(&other)?), n, ctl)?;
        let power = fourier::inverse_real_in_parts(&product(&transform(&ones)?, &transform(&squares)?), n, ctl)?;
        let energy: f64 = window.iter().map(|y| y * y).sum();
        let least = 1e-9 * power.iter().copied().fold(0.0, f64::max);
        let value =
            |s: usize| if power[s] > least && energy > 0.0 { cross[s] / (power[s] * energy).sqrt() } else { 0.0 };
        let best = (0..n).max_by(|a, b| value(*a).total_cmp(&value(*b))).unwrap_or(0);
        // Record sample start + k meets r_{k+s}: the delay is start − s.
        let shift =
            if !self.declared.is_periodic && best >= period { best as isize - n as isize } else { best as isize };
        let coarse = start as isize - shift;
        let delay = if self.declared.is_periodic { coarse.rem_euclid(period as isize) } else { coarse };
        let around = [-1, 0, 1].map(|d| self.correlation(start, length, delay + d));
        Ok(Window { start, delay: delay as f64 + vertex(around), correlation: around[1] })
    }

    /// A delay of a periodic sequence, by whole periods next to another.
    fn nearest_turn(&self, delay: f64, other: f64) -> f64 {
        if !self.declared.is_periodic {
            return delay;
        }
        let period = self.reference.len() as f64;
        delay + period * ((other - delay) / period).round()
    }

    fn judged(&self, windows: &[Window], length: usize) -> Comparison {
        let clear: Vec<&Window> = windows.iter().filter(|window| window.correlation >= CLEAR).collect();
        let mut steps: Vec<f64> = clear.windows(2).map(|pair| pair[1].delay - pair[0].delay).collect();
        let mut sorted = steps.clone();
        sorted.sort_by(f64::total_cmp);
        let usual = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        let mut jumps = Vec::new();
        let mut i = 0;
        while i < steps.len() {
            let beyond = steps[i] - usual;
            // A step within a window is seen half before it and half behind it.
            let next = steps.get(i + 1).map_or(0.0, |step| step - usual);
            let is_split = beyond.abs() > SPLIT && next.abs() > SPLIT && (beyond > 0.0) == (next > 0.0);
            let whole = if is_split { beyond + next } else { beyond };
            // Samples that are missing let the record run ahead: the delay falls.
            if whole.abs() > STEP && whole.round() != 0.0 {
                jumps.push(Jump { near: clear[i + 1].start, missing: -(whole.round() as i64) });
                steps[i] = usual + whole - whole.round();
                if is_split {
                    steps[i + 1] = usual;
                    i += 1;
                }
            }
            i += 1;
        }
        // Without the steps the delay is a line over time.
        let mut delays = Vec::with_capacity(clear.len());
        for (i, window) in clear.iter().enumerate() {
            let delay = if i == 0 { window.delay } else { delays[i - 1] + steps[i - 1] };
            delays.push(delay);
        }
        let times: Vec<f64> = clear.iter().map(|window| window.start as f64 + 0.5 * length as f64).collect();
        let line = line(&times, &delays);
        let clock = line.map(|[_, slope, error]| [slope, error]);
        let best = windows.iter().copied().max_by(|a, b| a.correlation.total_cmp(&b.correlation));
        let first = best.map_or(0.0, |best| best.delay);
        let mut delay = line.map_or(first, |[at_zero, ..]| at_zero);
        if self.declared.is_periodic {
            let period = self.reference.len() as f64;
            delay = delay.rem_euclid(period);
            // Rounding below zero is no delay, and not one of a whole period.
            if period - delay < 0.5 {
                delay -= period;
            }
        }
        let (correlation, explained, by_chance) = self.fit(windows, length);
        let is_declared = explained >= EXPLAINED[0].max(EXPLAINED[1] * by_chance).min(0.9);
        let windows = [windows.len(), clear.len()];
        Comparison { correlation, delay, explained, by_chance, clock, jumps, windows, is_declared }
    }

    /// The correlation, the share that a short response explains, and what it would by chance.
    fn fit(&self, windows: &[Window], length: usize) -> (f64, f64, f64) {
        let (n, piece) = (self.record.len(), self.declared.piece.max(1.0));
        // What repeats is not independent.
        let distinct = if self.declared.is_periodic { n.min(self.reference.len()) } else { n } as f64 / piece;
        let wanted = TAPS[0] * TAPS[1];
        let taps = if distinct >= PER_TAP * wanted as f64 { wanted } else { ((distinct / PER_TAP) as usize).max(1) };
        let spacing = if taps == 1 { 0.0 } else { piece / TAPS[0] as f64 };
        let every = (windows.len() * length).div_ceil(FITTED).max(1);
        let (mut cross, mut own, mut other, mut sums) = (0.0, 0.0, 0.0, [0.0; 2]);
        let (mut rows, mut answers) = (Vec::new(), Vec::new());
        for window in windows {
            let delay = window.delay.round() as isize;
            for k in window.start..window.start + length {
                let (y, r) = (self.record[k], self.at(k as isize - delay));
                cross += y * r;
                own += y * y;
                other += r * r;
                sums = [sums[0] + y, sums[1] + r];
                if k % every == 0 {
                    rows.push(1.0);
                    // Around the best delay, which lies in the midst of a device's answer.
                    let late = |tap: usize| ((tap as f64 - taps as f64 / 2.0 + 0.5).ceil() * spacing).round() as isize;
                    rows.extend((0..taps).map(|tap| self.at(k as isize - delay - late(tap))));
                    answers.push(y);
                }
            }
        }
        // About the means of what was compared, which is no whole number of periods.
        let count = (windows.len() * length) as f64;
        cross -= sums[0] * sums[1] / count;
        own -= sums[0] * sums[0] / count;
        other -= sums[1] * sums[1] / count;
        let correlation = if own > 0.0 && other > 0.0 { cross / (own * other).sqrt() } else { 0.0 };
        let matrix = DMatrix::from_row_slice(answers.len(), taps + 1, &rows);
        let answers = DVector::from_vec(answers);
        let total = answers.add_scalar(-answers.mean()).norm_squared();
        let explained = least_squares(&matrix, &answers)
            .filter(|_| total > 0.0)
            .map_or(correlation * correlation, |(x, _)| 1.0 - (&answers - &matrix * x).norm_squared() / total);
        (correlation, explained.clamp(0.0, 1.0), (taps as f64 / distinct.max(1.0)).min(1.0))
    }
}

/// Where a parabola through three values has its top, from the middle one.
fn vertex([before, here, after]: [f64; 3]) -> f64 {
    let bend = before - 2.0 * here + after;
    if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

/// The line through points: value at zero, slope, and the slope's standard error; `None` of fewer than three.
fn line(x: &[f64], y: &[f64]) -> Option<[f64; 3]> {
    let n = x.len() as f64;
    if x.len() < 3 {
        return None;
    }
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let spread: f64 = x.iter().map(|x| (x - mx).powi(2)).sum();
    let slope = x.iter().zip(y).map(|(x, y)| (x - mx) * (y - my)).sum::<f64>() / spread;
    let left: f64 = x.iter().zip(y).map(|(x, y)| (y - my - slope * (x - mx)).powi(2)).sum();
    // A delay is read to a tenth of a sample at best, whatever the points scatter by.
    let variance = (left / (n - 2.0)).max(0.01);
    Some([my - slope * mx, slope, (variance / spread).sqrt()])
}
