//! Transients of all segments at the lines: estimated with the response, and whether they stand above the noise.

use super::error::FrequencyError;
use super::grids::Grids;
use super::job::{Job, on_grid};
use super::local_polynomial::{LocalLine, Pair, fit};
use super::settings::{Detrend, EndSample, Transients, Window};
use super::warnings::is_periodic;
use crate::ctl::Ctl;
use num_complex::Complex64;
use std::collections::BTreeMap;

/// Lines at most that the variances of the local polynomials are found from.
const SURVEY: usize = 128;

/// With fewer excited lines than these, the lines asked for are surveyed too.
const FEW: usize = 8;

/// How far below the lowest and above the highest line is surveyed, in lines of the grid.
const MARGIN: usize = 8;

/// Neighbouring pairs of dark lines that a verdict on transients needs.
const PAIRS: usize = 16;

/// How far above the highest line transients are looked for, in lines of the grid.
const ABOVE: usize = 64;

/// `n|ρ|²` of the correlation ρ of n neighbouring dark lines is larger in one of e⁹ cases of white noise.
const CORRELATED: f64 = 9.0;

/// Dark lines below this share of the largest line of the output are rounding of the record.
const ROUNDING: f64 = 1e-9;

/// Mean square of the transients against their variance from which they are there.
const SIGNIFICANT: f64 = 4.0;

/// What the local polynomials say at a line about all segments.
#[derive(Debug, Clone)]
pub(super) struct Local {
    pub h: Complex64,
    pub mean_square_error: f64,
    pub leakage: f64,
    pub is_told: bool,
    pub degrees_of_freedom: f64,
    /// Transient of every segment; `None` of a segment of another length that has no input there.
    pub transients: Vec<Option<Complex64>>,
    /// Mean over the segments of the transient's square against its variance.
    pub significance: f64,
    /// Variance of the plain ratio that the noise alone makes.
    pub ratio_variance: f64,
}

impl Job<'_> {
    /// Whether transients are to be removed.
    pub(super) fn removes_transients(&self) -> bool {
        self.settings.transients == Transients::Remove
    }

    /// Whether every segment is whole periods of the input, and every line is on its grid.
    pub(super) fn is_periodic(&self, frequency_hz: &[f64]) -> bool {
        let plain = self.settings.settings().window == Window::Rectangular;
        plain
            && self.settings.end_sample == EndSample::Excluded
            && self.pieces.iter().all(|piece| {
                let length_s = piece.segment.period as f64 * self.trials[piece.trial].sample_time_s;
                is_periodic(self.input(piece.trial), &piece.segment)
                    && frequency_hz.iter().all(|f| on_grid(*f, length_s).is_some())
            })
    }

    /// Local polynomials at the lines; segments of one length share a response. `None` at a line where there is none.
    pub(super) fn local(
        &self,
        grids: &[Grids],
        frequency_hz: &[f64],
        ctl: &Ctl,
    ) -> Result<Vec<Option<Local>>, FrequencyError> {
        // Offsets are on line 0, which tells something only where they are the response to a constant input.
        let first = usize::from(self.settings.detrend != Detrend::None || !self.removes_transients());
        let mut lengths: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (i, piece) in self.pieces.iter().enumerate() {
            lengths.entry(piece.segment.samples).or_default().push(i);
        }
        let mut found: Vec<Option<Local>> = vec![None; frequency_hz.len()];
        for (samples, members) in lengths {
            let pairs: Vec<Pair<'_>> =
                members.iter().map(|i| Pair { input: &grids[*i].input, output: &grids[*i].output }).collect();
            let length_s = samples as f64 * self.trials[self.pieces[members[0]].trial].sample_time_s;
            let centres: Vec<f64> = frequency_hz.iter().map(|f| f * length_s).collect();
            let survey = self.survey(grids, &members, &centres, first);
            let Some(lines) = fit(&pairs, &centres, &survey, first, ctl)? else { continue };
            for ((sum, line), centre) in found.iter_mut().zip(lines).zip(&centres) {
                let Some(line) = line else { continue };
                let own = self.spread_out(line, &members, &pairs, *centre);
                *sum = Some(match sum.take() {
                    None => own,
                    Some(before) => before.and(own),
                });
            }
        }
        Ok(found)
    }

    /// Excited lines around those asked for, in increasing order, and these themselves where there are few.
    fn survey(&self, grids: &[Grids], members: &[usize], centres: &[f64], first: usize) -> Vec<usize> {
        let lines = members.iter().map(|i| grids[*i].power.len()).min().unwrap_or(0);
        let mean = |k: usize| members.iter().map(|i| grids[*i].power[k]).sum::<f64>();
        let strongest = (1..lines).map(mean).fold(0.0, f64::max);
        let threshold = self.settings.settings().power_threshold * strongest;
        let ends = [centres.first(), centres.last()].map(|c| c.copied().unwrap_or(0.0).round() as usize);
        let from = ends[0].saturating_sub(MARGIN).max(first.max(1));
        let to = (ends[1] + MARGIN).min(lines.saturating_sub(2));
        let mut survey: Vec<usize> = (from..=to).filter(|k| mean(*k) >= threshold && threshold > 0.0).collect();
        if survey.len() < FEW {
            survey.extend(centres.iter().map(|c| c.round() as usize).filter(|k| (first..=to).contains(k)).take(SURVEY));
            survey.sort_unstable();
            survey.dedup();
        }
        let step = survey.len().div_ceil(SURVEY).max(1);
        survey.into_iter().step_by(step).collect()
    }

    fn spread_out(&self, line: LocalLine, members: &[usize], pairs: &[Pair<'_>], centre: f64) -> Local {
        let mut transients = vec![None; self.pieces.len()];
        for (i, transient) in members.iter().zip(&line.transients) {
            transients[*i] = Some(*transient);
        }
        let square = line.transients.iter().map(Complex64::norm_sqr).sum::<f64>() / line.transients.len() as f64;
        let nearest = centre.round() as usize;
        let power: f64 = pairs.iter().filter_map(|p| p.input.get(nearest)).map(Complex64::norm_sqr).sum();
        Local {
            h: line.h,
            mean_square_error: line.mean_square_error,
            leakage: line.leakage,
            is_told: line.is_told,
            degrees_of_freedom: line.degrees_of_freedom,
            transients,
            significance: square / line.transient_variance.max(f64::MIN_POSITIVE),
            ratio_variance: if power > 0.0 { line.noise / power } else { f64::INFINITY },
        }
    }

    /// Whether transients of periodic segments stand above the noise: neighbouring lines without a stimulus are then
    /// alike, and larger than rounding. `None` where there are too few of them to say.
    pub(super) fn dark_lines_are_alike(&self, grids: &[Grids], frequency_hz: &[f64]) -> Option<bool> {
        let (mut cross, mut power, mut count) = (Complex64::default(), 0.0, 0_usize);
        let mut largest = 0.0_f64;
        for (piece, grids) in self.pieces.iter().zip(grids) {
            let length_s = piece.segment.period as f64 * self.trials[piece.trial].sample_time_s;
            let highest = frequency_hz.last().map_or(0, |f| (f * length_s).round() as usize);
            let last = (highest + ABOVE).min(grids.output.len().saturating_sub(2));
            for k in 1..last {
                largest = largest.max(grids.output[k].norm_sqr());
                if grids.dark[k] && grids.dark[k + 1] {
                    cross += grids.output[k] * grids.output[k + 1].conj();
                    power += 0.5 * (grids.output[k].norm_sqr() + grids.output[k + 1].norm_sqr());
                    count += 1;
                }
            }
        }
        let is_more_than_rounding = power > ROUNDING * ROUNDING * largest * count as f64;
        let is_alike = cross.norm_sqr() * count as f64 > CORRELATED * power * power;
        (count >= PAIRS).then_some(is_more_than_rounding && is_alike)
    }
}

/// Whether transients at the lines are larger than their errors.
pub(super) fn are_significant(local: &[Option<Local>]) -> bool {
    let known: Vec<f64> = local.iter().flatten().map(|line| line.significance).collect();
    !known.is_empty() && known.iter().sum::<f64>() > SIGNIFICANT * known.len() as f64
}

impl Local {
    /// Two estimates of one response, weighted by the inverses of their mean square errors.
    fn and(self, other: Self) -> Self {
        let shares = [1.0 / self.mean_square_error, 1.0 / other.mean_square_error];
        let sum = shares[0] + shares[1];
        if !(sum.is_finite() && sum > 0.0) {
            return self;
        }
        let [a, b] = shares.map(|share| share / sum);
        Self {
            h: self.h * a + other.h * b,
            mean_square_error: 1.0 / sum,
            leakage: self.leakage * a + other.leakage * b,
            is_told: self.is_told || other.is_told,
            degrees_of_freedom: self.degrees_of_freedom + other.degrees_of_freedom,
            transients: self.transients.into_iter().zip(other.transients).map(|(a, b)| a.or(b)).collect(),
            significance: 0.5 * (self.significance + other.significance),
            ratio_variance: 1.0 / (1.0 / self.ratio_variance + 1.0 / other.ratio_variance),
        }
    }
}
