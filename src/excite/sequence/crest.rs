//! The crest factor of a multisine, and phases that make it small.
//!
//! From each start the phases first minimise p-norms of growing p (Guillaume, Schoukens, Pintelon and Kollár 1991), for
//! many lines after swaps between the clipped signal and its amplitudes (Van der Ouderaa, Schoukens and Renneboog
//! 1988). The largest p-norm is still a percent from the peak, so that the peak itself is minimised last: a linear
//! program over a trust region holds all peaks that may matter below one level (Madsen 1975, sequential linear
//! minimax), and the region grows or shrinks with what the true peak does.

use super::error::SequenceError;
use super::multisine::Line;
use crate::convex::box_lp::{BoxLpError, Program};
use crate::ctl::Ctl;
use crate::num::Complex64;
use crate::num::fourier;
use crate::num::least_squares::{LeastSquares, LeastSquaresError, Options, minimise};
use nalgebra::{DMatrix, DVector};
use rayon::iter::{IntoParallelIterator as _, ParallelIterator as _};
use std::f64::consts::PI;

/// Points per shortest wave on which peaks are looked for, before they are refined.
const OVERSAMPLING: usize = 16;
/// Lines up to which there are many starts, and their number beside Schroeder's phases.
const FEW: (usize, usize) = (24, 40);
/// Random starts of more lines.
const STARTS: usize = 8;
/// Swaps between time and frequency from each start.
const SWAPS: usize = 150;
/// Lines up to which phases are polished after the swaps.
const POLISHED_LINES: usize = 64;
/// Starts whose peak is minimised at last, where lines are not few; of few all of them are, since a fifth of the starts
/// ends within 2 % of the best known, and the norms do not tell which.
const LAST: usize = 2;
/// Halves of the exponents of the norms, in turn.
const EXPONENTS: [i32; 3] = [2, 6, 16];
/// Evaluations of a norm at most.
const EVALUATIONS: usize = 30;
/// The first trust region of the minimax, rad, and the last.
const REGION: [f64; 2] = [0.1, 1e-6];
/// Steps of the minimax at most.
const STEPS: usize = 40;
/// A step that promises less than this share of the peak ends it.
const PROMISE: f64 = 1e-6;
/// Peaks in a program for each line at most.
const PEAKS: usize = 4;
/// The gap of the programs.
const GAP: f64 = 1e-6;

/// The phases of the lowest crest factor found from Schroeder's and from random starts, by number.
///
/// # Errors
/// [`SequenceError::Stopped`].
pub(super) fn optimised(
    lines: &[Line],
    random: impl Fn(usize) -> Vec<f64>,
    ctl: &Ctl,
) -> Result<Vec<f64>, SequenceError> {
    let is_few = lines.len() <= FEW.0;
    let count = if is_few { FEW.1 } else { STARTS };
    let starts: Vec<Vec<f64>> = std::iter::once(schroeder(lines)).chain((1..=count).map(random)).collect();
    let mut found: Vec<(f64, Vec<f64>)> = starts
        .into_par_iter()
        .map(|start| {
            let phases = if is_few { normed(lines, start, ctl)? } else { swapped(lines, start, ctl)? };
            Ok((crest_factor(lines, &phases), phases))
        })
        .collect::<Result<_, SequenceError>>()?;
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    if (2..=POLISHED_LINES).contains(&lines.len()) {
        if !is_few {
            found.truncate(LAST);
        }
        found = found
            .into_par_iter()
            .map(|(_, phases)| {
                let phases = if is_few { phases } else { normed(lines, phases, ctl)? };
                let phases = lowered(lines, phases, ctl)?;
                Ok((crest_factor(lines, &phases), phases))
            })
            .collect::<Result<_, SequenceError>>()?;
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    Ok(found.into_iter().next().map_or_else(|| schroeder(lines), |(_, phases)| phases))
}

/// Schroeder's phases, `φ_k = −2π Σ_{j<k} (k − j) p_j` with the lines' shares p of the power.
pub(super) fn schroeder(lines: &[Line]) -> Vec<f64> {
    let total: f64 = lines.iter().map(|line| line.amplitude.powi(2)).sum();
    let (mut turns, mut share) = (0.0, 0.0);
    lines
        .iter()
        .map(|line| {
            // Σ_{j<k} (k − j) p_j grows by Σ_{j<k} p_j from line to line.
            turns += share;
            share += line.amplitude.powi(2) / total;
            -2.0 * PI * turns
        })
        .collect()
}

/// One period on `n` points.
pub(super) fn on_grid(lines: &[Line], phases: &[f64], n: usize) -> Vec<f64> {
    let mut spectrum = vec![Complex64::new(0.0, 0.0); n / 2 + 1];
    for (line, phase) in lines.iter().zip(phases) {
        spectrum[line.harmonic as usize] += Complex64::from_polar(0.5 * n as f64 * line.amplitude, *phase);
    }
    fourier::inverse_real(&spectrum, n)
}

/// Points that show every peak between samples.
fn fine_grid(lines: &[Line]) -> usize {
    let highest = lines.last().map_or(1, |line| line.harmonic as usize);
    (OVERSAMPLING * highest).next_power_of_two()
}

/// Root mean square of the continuous signal.
fn rms(lines: &[Line]) -> f64 {
    lines.iter().map(|line| 0.5 * line.amplitude.powi(2)).sum::<f64>().sqrt()
}

/// Peak over rms of the continuous signal, the peak refined between the points of a fine grid.
pub(super) fn crest_factor(lines: &[Line], phases: &[f64]) -> f64 {
    // A maximum lies at most half a point beside the grid, where the signal is lower by 1 − cos(π/16), 2 %, at most.
    let peaks = peaks(lines, phases, 0.97);
    peaks.iter().map(|(_, x)| x.abs()).fold(0.0, f64::max) / rms(lines)
}

/// Local maxima of the magnitude that reach a share of the largest: place in the period, from 0 to 1, and value.
fn peaks(lines: &[Line], phases: &[f64], share: f64) -> Vec<(f64, f64)> {
    let n = fine_grid(lines);
    let values = on_grid(lines, phases, n);
    let largest = values.iter().fold(0.0_f64, |peak, x| peak.max(x.abs()));
    let is_top = |i: &usize| {
        let (before, here, after) = (values[(i + n - 1) % n].abs(), values[*i].abs(), values[(i + 1) % n].abs());
        here >= share * largest && here >= before && here > after
    };
    (0..n).filter(is_top).map(|i| refined(lines, phases, i as f64 / n as f64, 1.0 / n as f64)).collect()
}

/// The extremum near a point of the grid, by Newton's method on the slope.
fn refined(lines: &[Line], phases: &[f64], start: f64, spacing: f64) -> (f64, f64) {
    let at = |place: f64| {
        let (mut value, mut slope, mut bend) = (0.0, 0.0, 0.0);
        for (line, phase) in lines.iter().zip(phases) {
            let rate = 2.0 * PI * line.harmonic as f64;
            let (sin, cos) = (rate * place + phase).sin_cos();
            value += line.amplitude * cos;
            slope -= line.amplitude * rate * sin;
            bend -= line.amplitude * rate * rate * cos;
        }
        (value, slope, bend)
    };
    let mut best = (start, at(start).0);
    let mut place = start;
    for _ in 0..6 {
        let (value, slope, bend) = at(place);
        if value.abs() > best.1.abs() {
            best = (place, value);
        }
        if bend == 0.0 {
            break;
        }
        place = (place - slope / bend).clamp(start - spacing, start + spacing);
    }
    best
}

/// Phases after swaps: the signal is clipped near its peak, and its lines are given their amplitudes back.
fn swapped(lines: &[Line], start: Vec<f64>, ctl: &Ctl) -> Result<Vec<f64>, SequenceError> {
    let n = fine_grid(lines).min(1 << 18).max(4 * (lines.last().map_or(1, |line| line.harmonic as usize) + 1));
    let mut phases = start.clone();
    let mut best = (f64::INFINITY, start);
    for swap in 0..SWAPS {
        ctl.check()?;
        let mut values = on_grid(lines, &phases, n);
        let peak = values.iter().fold(0.0_f64, |peak, x| peak.max(x.abs()));
        if peak < best.0 {
            best = (peak, phases.clone());
        }
        // Clip hard at first and hardly at the end.
        let level = peak * (0.8 + 0.19 * swap as f64 / SWAPS as f64);
        for x in &mut values {
            *x = x.clamp(-level, level);
        }
        let spectrum = fourier::real_transform(&values);
        for (phase, line) in phases.iter_mut().zip(lines) {
            let value = spectrum[line.harmonic as usize];
            if value.norm() > 0.0 {
                *phase = value.arg();
            }
        }
    }
    Ok(best.1)
}

/// Phases that minimise p-norms of growing p.
fn normed(lines: &[Line], start: Vec<f64>, ctl: &Ctl) -> Result<Vec<f64>, SequenceError> {
    let mut best = (crest_factor(lines, &start), start.clone());
    let mut current = start;
    for exponent in EXPONENTS {
        let options = Options { max_evaluations: EVALUATIONS, gradient_tolerance: 1e-4, ..Options::default() };
        match minimise(&Norm::new(lines, exponent), &current, &options, ctl) {
            Ok(found) => current = found.x,
            Err(LeastSquaresError::Stopped(stopped)) => return Err(stopped.into()),
            Err(_) => break,
        }
        let reached = crest_factor(lines, &current);
        if reached < best.0 {
            best = (reached, current.clone());
        }
    }
    Ok(best.1)
}

/// Phases that minimise the peak itself, from where they are.
fn lowered(lines: &[Line], start: Vec<f64>, ctl: &Ctl) -> Result<Vec<f64>, SequenceError> {
    let n = lines.len();
    let size: f64 = lines.iter().map(|line| line.amplitude).sum();
    let mut phases = start;
    let mut tops = peaks(lines, &phases, 0.2);
    let highest = |tops: &[(f64, f64)]| tops.iter().map(|(_, x)| x.abs()).fold(0.0, f64::max);
    let mut level = highest(&tops);
    let mut region = REGION[0];
    for _ in 0..STEPS {
        ctl.check()?;
        // What no step within the region lifts to the level needs no row.
        let reach = region * size;
        tops.retain(|(_, x)| x.abs() >= level - 2.0 * reach);
        tops.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        tops.truncate(PEAKS * n);
        // Unknowns: phases in units of the region, and g: the level is lowered by reach (1 + g)/2.
        let mut rows = DMatrix::zeros(tops.len(), n + 1);
        let mut limits = [DVector::zeros(tops.len()), DVector::zeros(tops.len())];
        for (i, (place, x)) in tops.iter().enumerate() {
            for (j, (line, phase)) in lines.iter().zip(&phases).enumerate() {
                let slope = -line.amplitude * (2.0 * PI * line.harmonic as f64 * place + phase).sin();
                rows[(i, j)] = x.signum() * slope * region / reach;
            }
            rows[(i, n)] = 0.5;
            limits[0][i] = -4.0 - level / reach;
            limits[1][i] = (level - x.abs()) / reach - 0.5;
        }
        let ends = |sign: f64| DVector::from_element(n + 1, sign);
        let cost = DVector::from_fn(n + 1, |j, _| if j == n { 1.0 } else { 0.0 });
        let program = Program { cost, bounds: [ends(-1.0), ends(1.0)], rows, limits };
        let solution = match program.solve(GAP, ctl) {
            Ok(solution) => solution,
            Err(BoxLpError::Stopped(stopped)) => return Err(stopped.into()),
            Err(_) => break,
        };
        let promised = 0.5 * reach * (1.0 + solution.x[n]);
        let moved: Vec<f64> = phases.iter().zip(solution.x.iter()).map(|(phase, d)| phase + region * d).collect();
        let tops_there = peaks(lines, &moved, 0.2);
        let reached = highest(&tops_there);
        if reached < level {
            region *= if level - reached > 0.5 * promised { 1.5 } else { 0.7 };
            (phases, tops, level) = (moved, tops_there, reached);
        } else {
            region *= 0.35;
            tops = peaks(lines, &phases, 0.2);
        }
        if promised < PROMISE * level || region < REGION[1] {
            break;
        }
    }
    Ok(phases)
}

/// `Σ (x_i/σ)^{2p}` as a sum of squares of `(x_i/σ)^p`.
struct Norm {
    lines: Vec<Line>,
    points: usize,
    exponent: i32,
    scale: f64,
}

impl Norm {
    fn new(lines: &[Line], exponent: i32) -> Self {
        let highest = lines.last().map_or(1, |line| line.harmonic as usize);
        // Few points per wave suffice for a norm; sparse lines of high multiples need no more than this many.
        let points = (6 * highest).clamp(16 * lines.len(), 4096);
        // Near the peak's own size, so that powers neither vanish nor overflow.
        Self { lines: lines.to_vec(), points, exponent, scale: 1.5 * rms(lines) }
    }
}

impl LeastSquares for Norm {
    fn unknowns(&self) -> usize {
        self.lines.len()
    }

    fn equations(&self) -> usize {
        self.points
    }

    fn evaluate(&self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) -> bool {
        let mut values = vec![0.0; self.points];
        let mut slopes = jacobian.is_some().then(|| DMatrix::zeros(self.points, self.lines.len()));
        for (j, (line, phase)) in self.lines.iter().zip(x).enumerate() {
            for (i, value) in values.iter_mut().enumerate() {
                // The whole turns in exact arithmetic.
                let part = (line.harmonic * i as u64 % self.points as u64) as f64 / self.points as f64;
                let (sin, cos) = (2.0 * PI * part + phase).sin_cos();
                *value += line.amplitude / self.scale * cos;
                if let Some(slopes) = &mut slopes {
                    slopes[(i, j)] = -line.amplitude / self.scale * sin;
                }
            }
        }
        for (i, value) in values.iter().enumerate() {
            residuals[i] = value.powi(self.exponent);
        }
        if let (Some(jacobian), Some(slopes)) = (jacobian, slopes) {
            for (i, value) in values.iter().enumerate() {
                let outer = f64::from(self.exponent) * value.powi(self.exponent - 1);
                for j in 0..self.lines.len() {
                    jacobian[(i, j)] = outer * slopes[(i, j)];
                }
            }
        }
        residuals.iter().all(|r| r.is_finite())
    }
}
