//! What a scientist must read before using frequency data.

use super::error::{name, other};
use super::job::{Job, Piece, Transformed};
use super::result::{Estimate, VarianceSource};
use super::segments::Segment;
use super::settings::{Average, EndSample, Stimulus};

/// Averages below this number leave the variance itself uncertain by a third or more.
const FEW_AVERAGES: usize = 10;

/// Leakage below this share of the response is named nowhere: rounding of records, or of the transform.
const NEGLIGIBLE: f64 = 1e-6;

/// Leakage that is worth a word where no error is known, as a share of the response.
const SMALL_LEAKAGE: f64 = 0.01;

/// A finding about an estimate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EstimateWarning {
    /// A stable name, in `snake_case`.
    pub code: &'static str,
    /// The finding, in words and numbers.
    pub message: String,
}

impl EstimateWarning {
    pub(super) fn new(code: &'static str, message: impl Into<String>) -> Self {
        Self { code, message: message.into() }
    }
}

/// Difference from the neighbouring period, as a fraction of the signal's spread, from which a signal is not periodic.
const PERIOD_MISMATCH: f64 = 0.01;

/// How much more than anywhere within the segment a periodic signal may bend where its end meets its start.
const SEAM_BEND: f64 = 1.5;

/// Whether the input is periodic with the segment's period, as far as the record shows.
///
/// Where the record goes on for a quarter of a period before or after the segment, one of the two must repeat it.
/// Otherwise the end must meet the start as smoothly as the signal runs elsewhere (second differences).
pub(super) fn is_periodic(column: &[f64], segment: &Segment) -> bool {
    let Segment { start, period, .. } = *segment;
    let inside = &column[start..start + period];
    let mean = inside.iter().sum::<f64>() / period as f64;
    let spread = (inside.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / period as f64).sqrt();
    let mismatch = |pairs: &mut dyn Iterator<Item = (f64, f64)>| {
        let (mut sum, mut count) = (0.0, 0_usize);
        for (a, b) in pairs {
            sum += (a - b) * (a - b);
            count += 1;
        }
        (sum / count as f64).sqrt()
    };
    let before = start.min(period);
    let after = (column.len() - start - period).min(period);
    let mut neighbours = Vec::new();
    if before * 4 >= period {
        let pairs = (1..=before).map(|i| (column[start - i], column[start + period - i]));
        neighbours.push(mismatch(&mut { pairs }));
    }
    if after * 4 >= period {
        let pairs = (0..after).map(|i| (column[start + period + i], column[start + i]));
        neighbours.push(mismatch(&mut { pairs }));
    }
    if !neighbours.is_empty() {
        return neighbours.iter().any(|difference| *difference <= PERIOD_MISMATCH * spread);
    }
    let bend = |a: f64, b: f64, c: f64| (a - 2.0 * b + c).abs();
    let within = inside.windows(3).map(|w| bend(w[0], w[1], w[2])).fold(0.0, f64::max);
    let (first, second) = (inside[0], inside[1]);
    let (last, last_but_one) = (inside[period - 1], inside[period - 2]);
    bend(last_but_one, last, first).max(bend(last, first, second)) <= SEAM_BEND * within
}

/// At most eight frequencies, in words.
pub(super) fn hertz(frequency_hz: &[f64]) -> String {
    const NAMED: usize = 8;
    let named: Vec<String> = frequency_hz.iter().take(NAMED).map(|f| format!("{}", (f * 1e6).round() / 1e6)).collect();
    let more = frequency_hz.len().saturating_sub(NAMED);
    if more > 0 { format!("{} Hz and {more} more", named.join(", ")) } else { format!("{} Hz", named.join(", ")) }
}

impl Job<'_> {
    fn label(&self, piece: &Piece) -> String {
        if self.trials.len() == 1 {
            format!("segment {}", piece.segment.number + 1)
        } else {
            format!("segment {} of trial {}", piece.segment.number + 1, piece.trial + 1)
        }
    }

    pub(super) fn warnings(&self, estimate: &Estimate, transformed: &[Transformed]) -> Vec<EstimateWarning> {
        let mut warnings = Vec::new();
        self.warn_of_power(estimate, transformed, &mut warnings);
        self.warn_of_leakage(estimate, &mut warnings);
        warn_of_errors(estimate, &mut warnings);
        let n = transformed.len();
        if n < FEW_AVERAGES {
            let uncertain = match n {
                1 => "one segment was transformed: nothing was averaged, and no variance comes from repetition"
                    .to_owned(),
                _ => format!(
                    "{n} segments were averaged: the variances have a standard error of {:.0} % themselves",
                    100.0 / ((n - 1) as f64).sqrt()
                ),
            };
            warnings.push(EstimateWarning::new("few_averages", uncertain));
        }
        let unknown: Vec<f64> =
            chosen(estimate, |line| estimate.h[line].is_some() && estimate.variance[line].is_none());
        if !unknown.is_empty() {
            let reason = if n >= 2 {
                "only one segment has power there"
            } else if self.settings.end_sample == EndSample::Included {
                "there is one segment, and with its end sample it has no grid on which noise could be told from signal"
            } else {
                "there is one segment, and fewer than four nearby lines of its grid are without a stimulus"
            };
            let message = format!("the variance is unknown at {}: {reason}", hertz(&unknown));
            warnings.push(EstimateWarning::new("variance_unknown", message));
        }
        if let Some(piece) = self.pieces.iter().find(|piece| piece.segment.end_sample_missing) {
            let message = format!("the record ends before the end sample of {}, which was left out", self.label(piece));
            warnings.push(EstimateWarning::new("segment_truncated", message));
        }
        if self.unused > 0 {
            let message = format!(
                "the last {} s of the record are in no segment, since no whole one fits",
                self.unused as f64 * self.trials[0].sample_time_s
            );
            warnings.push(EstimateWarning::new("segment_truncated", message));
        }
        warnings
    }

    fn warn_of_power(&self, estimate: &Estimate, transformed: &[Transformed], warnings: &mut Vec<EstimateWarning>) {
        let input = name(self.channels.input);
        let code = match self.channels.input {
            Stimulus::Command => "command_without_power",
            Stimulus::Disturbance => "disturbance_without_power",
        };
        let threshold = self.settings.settings().power_threshold;
        let none: Vec<f64> = chosen(estimate, |line| estimate.h[line].is_none());
        if !none.is_empty() {
            let message = format!("the {input} has no power at {}: there is no response to estimate", hertz(&none));
            warnings.push(EstimateWarning::new(code, message));
        }
        let strongest = transformed.iter().map(|t| t.strongest).sum::<f64>() / transformed.len() as f64;
        let weak = |line: usize| estimate.h[line].is_some() && estimate.input_power[line] < threshold * strongest;
        let weak_lines = chosen(estimate, weak);
        if !weak_lines.is_empty() {
            let message = format!(
                "the {input} has less than {threshold} of the power of its strongest line at {}: what is estimated \
                 there is mostly noise and leakage",
                hertz(&weak_lines)
            );
            warnings.push(EstimateWarning::new(code, message));
        }
        if self.settings.settings().average == Average::Ratios {
            // A mean of ratios takes a segment without power as seriously as any other.
            for (piece, t) in self.pieces.iter().zip(transformed) {
                let here = chosen(estimate, |line| {
                    !weak(line) && estimate.h[line].is_some() && t.power[line] < threshold * t.strongest
                });
                if !here.is_empty() {
                    let message = format!(
                        "in {} the {input} has less than {threshold} of the power of its strongest line at {}, and its \
                         ratios there count as much as those of the other segments",
                        self.label(piece),
                        hertz(&here)
                    );
                    warnings.push(EstimateWarning::new(code, message));
                    break;
                }
            }
        }
        let shared = chosen(estimate, |line| transformed.iter().any(|t| t.shared[line]));
        if !shared.is_empty() {
            let other = name(other(self.channels.input));
            let message = format!(
                "the {other} has power at {} too: part of what answers there answers to the {other}",
                hertz(&shared)
            );
            warnings.push(EstimateWarning::new("other_stimulus_on_line", message));
        }
    }

    fn warn_of_leakage(&self, estimate: &Estimate, warnings: &mut Vec<EstimateWarning>) {
        // With a variance, what leaks is compared with the error of the line; without one, with the response itself.
        let matters = |line: usize| {
            let (Some(h), Some(leakage)) = (estimate.h[line], estimate.leakage[line]) else { return false };
            let own = match estimate.variance_source {
                Some(VarianceSource::LocalPolynomial) => None,
                _ => estimate.variance[line],
            };
            match (own, estimate.transients_removed) {
                (Some(variance), _) => leakage > variance.sqrt().max(NEGLIGIBLE * h.norm()),
                // The error of local polynomials holds what is left.
                (None, true) => false,
                (None, false) => leakage > SMALL_LEAKAGE * h.norm(),
            }
        };
        let lines = chosen(estimate, matters);
        if !lines.is_empty() {
            let (worst, leakage, h) = (0..estimate.h.len())
                .filter(|line| matters(*line))
                .filter_map(|line| Some((line, estimate.leakage[line]?, estimate.h[line]?.norm())))
                .max_by(|a, b| a.1.total_cmp(&b.1))
                .unwrap_or_default();
            let mend = if self.removes_transients() {
                "use segments that are whole periods of the stimulus, after its start has died away"
            } else {
                "\"transients\": \"remove\" takes off what is no window's"
            };
            let message = format!(
                "transients, slopes or the window leak into {} more than the error that is reported there, at {} Hz \
                 {leakage:.3} of |h| = {h:.3}: see leakage; {mend}",
                hertz(&lines),
                (estimate.frequency_hz[worst] * 1e6).round() / 1e6
            );
            warnings.push(EstimateWarning::new("leakage", message));
        }
        let untold = chosen(estimate, |line| estimate.h[line].is_some() && estimate.leakage[line].is_none());
        if !untold.is_empty() {
            let message = format!(
                "how much transients leak into {} cannot be told: the segments have too few lines for it",
                hertz(&untold)
            );
            warnings.push(EstimateWarning::new("leakage", message));
        }
    }
}

/// Lines whose error is larger than what they are good for.
fn warn_of_errors(estimate: &Estimate, warnings: &mut Vec<EstimateWarning>) {
    let lines = chosen(estimate, |line| estimate.h[line].is_some() && !estimate.usable[line]);
    if !lines.is_empty() {
        let message = format!(
            "the error at {} is more than a fifth of the response (of the median response, where that is larger), or \
             the command hardly tells the response from the transient there: these lines are not usable",
            hertz(&lines)
        );
        warnings.push(EstimateWarning::new("line_not_usable", message));
    }
}

/// The frequencies of the lines that are meant.
fn chosen(estimate: &Estimate, meant: impl Fn(usize) -> bool) -> Vec<f64> {
    (0..estimate.frequency_hz.len()).filter(|line| meant(*line)).map(|line| estimate.frequency_hz[line]).collect()
}
