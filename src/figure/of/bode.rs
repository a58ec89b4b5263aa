//! Bode plots of what was identified: Gff, Gfb and Gff·G.

use super::provenance::ReportOrigin;
use crate::analysis::Report;
use crate::analysis::estimates::evidence;
use crate::control::bode::log_grid;
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};
use crate::learning::Estimator;
use crate::num::Complex64;
use std::f64::consts::TAU;

mod read;

pub(in crate::figure::of) use read::result;
pub use read::{Origin, Unreadable};

/// The name of the figure in addresses.
pub const NAME: &str = "bode";

/// Frequencies that a transfer function is drawn at, beside the lines.
const GRID: usize = 160;

/// A response at a frequency, with its 95 % bands where they exist.
#[derive(Debug, Clone, Copy, PartialEq)]
struct At {
    frequency_hz: f64,
    /// None where it is zero or infinite.
    value: Option<Complex64>,
    /// Ends of the magnitude's band.
    magnitude: Option<[f64; 2]>,
    /// Ends of the phase's band in degrees, around the argument of the value.
    phase_deg: Option<[f64; 2]>,
    /// Whether there could be bands at all: between lines a curve has none, and its band goes on.
    is_line: bool,
}

/// What one estimate says about a controller.
#[derive(Debug, Clone, PartialEq)]
struct Estimate {
    name: String,
    ink: Ink,
    /// Points with whiskers rather than a line with a band.
    is_by_lines: bool,
    at: Vec<At>,
}

/// A controller, or a product of one.
#[derive(Debug, Clone, PartialEq)]
struct Response {
    symbol: &'static str,
    /// The response that it is compared with: 1 for Gff·G.
    reference: bool,
    /// Why it is not to be used; empty where it may be.
    doubt: String,
    estimates: Vec<Estimate>,
}

fn decibels(magnitude: f64) -> Option<f64> {
    Some(20.0 * magnitude.log10()).filter(|gain| gain.is_finite())
}

/// Phases in degrees, with full turns added so that neighbours differ by half a turn at most.
fn unwrapped(values: &[Option<Complex64>]) -> Vec<Option<f64>> {
    let mut last: Option<f64> = None;
    values
        .iter()
        .map(|value| {
            let own = value.filter(|value| value.norm() > 0.0)?.arg().to_degrees();
            let phase = last.map_or(own, |last| own + 360.0 * ((last - own) / 360.0).round());
            last = Some(phase);
            Some(phase)
        })
        .collect()
}

impl Estimate {
    /// The series of gain and of phase.
    fn series(&self) -> [Vec<Series>; 2] {
        let x: Vec<f64> = self.at.iter().map(|at| at.frequency_hz).collect();
        let values: Vec<Option<Complex64>> = self.at.iter().map(|at| at.value).collect();
        let gains: Vec<Option<f64>> = values.iter().map(|value| decibels((*value)?.norm())).collect();
        let phases = unwrapped(&values);
        let gain_ends = |at: &At| {
            let [low, high] = at.magnitude?;
            Some([decibels(low)?, decibels(high)?])
        };
        let gain_bands: Vec<_> = self.at.iter().map(gain_ends).collect();
        // A band lies around the phase as it was given; full turns that were added to one belong to the other.
        let phase_ends = |(at, phase): (&At, &Option<f64>)| {
            let (ends, phase, value) = (at.phase_deg?, (*phase)?, at.value?);
            let turns = 360.0 * ((phase - value.arg().to_degrees()) / 360.0).round();
            Some(ends.map(|end| end + turns))
        };
        let phase_bands: Vec<_> = self.at.iter().zip(&phases).map(phase_ends).collect();
        let (line, interval) = if self.is_by_lines { (Mark::Points, Mark::Bars) } else { (Mark::Line, Mark::Band) };
        [(gains, gain_bands), (phases, phase_bands)].map(|(values, bands)| {
            let mut all = Vec::new();
            // Between lines a band goes on; at a line that has none it is broken.
            let lines = self.at.iter().zip(&bands).filter(|(at, _)| at.is_line);
            let (at, ends): (Vec<f64>, Vec<Option<[f64; 2]>>) =
                lines.map(|(at, band)| (at.frequency_hz, *band)).unzip();
            if ends.iter().any(Option::is_some) {
                let name = format!("{}: 95 %", self.name);
                all.push(Series::intervals(name, (interval, self.ink, Weight::Thin), at, ends));
            }
            let own = Series::values(self.name.as_str(), (line, self.ink, Weight::Thick), x.clone(), values);
            all.push(own.labelled());
            all
        })
    }
}

impl Response {
    /// Gain above phase.
    fn panels(&self, column: usize) -> [Panel; 2] {
        let (mut gains, mut phases) = (Vec::new(), Vec::new());
        for estimate in &self.estimates {
            let [gain, phase] = estimate.series();
            gains.extend(gain);
            phases.extend(phase);
        }
        let symbol = self.symbol;
        let title = if self.doubt.is_empty() { symbol.to_owned() } else { format!("{symbol}: × do not use") };
        let mut gain = Panel::new(title, Axis::linear(format!("|{symbol}|"), "dB"), gains).in_column(column);
        let mut phase = Panel::new("", Axis::linear(format!("∠{symbol}"), "°"), phases).in_column(column);
        if self.reference {
            (gain.y, phase.y) = (gain.y.including(&[0.0]), phase.y.including(&[0.0]));
            gain = gain.with_rule(0.0, "inverse of the plant", RuleKind::Reference);
            phase = phase.with_rule(0.0, "", RuleKind::Reference);
        }
        [gain, phase]
    }
}

/// Gff, Gfb and Gff·G of an identification, with bands where the report has them; Gff·G only where the plant is known.
///
/// # Errors
/// [`Unreadable`] where the kind has no controllers, or the report is of a form that this version does not know.
pub fn bode(report: &Report, about: &Origin<'_>) -> Result<Figure, Unreadable> {
    let found = read::responses(report, about)?;
    let mut responses = found.responses;
    // What the stimuli tell does not depend on the estimator.
    if let Some(doubt) = evidence(report, Estimator::default(), 0).feedback_not_told {
        let feedback = responses.iter_mut().filter(|response| response.symbol == "Gfb");
        feedback.for_each(|own| own.doubt.clone_from(&doubt));
    }
    let panels = responses.iter().enumerate().flat_map(|(column, response)| response.panels(column)).collect();
    let doubts: Vec<String> = responses
        .iter()
        .filter(|response| !response.doubt.is_empty())
        .map(|response| format!("{} is not to be used: {}.", response.symbol, response.doubt))
        .collect();
    let band = found.band_hz.map(three);
    let estimates = responses.iter().flat_map(|response| &response.estimates);
    let reaches_zero = |at: &At| at.magnitude.is_some_and(|[low, _]| low <= 0.0);
    let mut bands = found.bands;
    if estimates.flat_map(|estimate| &estimate.at).any(reaches_zero) {
        bands.push_str(" There is none where it reaches zero, which has no decibels.");
    }
    let origin = ReportOrigin { subject: about.subject.to_owned() };
    Ok(Figure {
        name: NAME.to_owned(),
        title: format!("{}: controllers", about.subject),
        description: [found.finding, doubts.join(" ")].join(" ").trim().to_owned(),
        caption: [format!("{bands} From {} to {} Hz.", band[0], band[1]), doubts.join(" "), origin.caption(report)]
            .join(" ")
            .replace("  ", " "),
        sampling: String::new(),
        x: Axis::logarithmic("frequency", "Hz"),
        panels,
    })
}

/// A grid of frequencies in rad/s over a band, with the lines in it.
fn grid(lines: &[f64]) -> Vec<f64> {
    let mut all: Vec<f64> = lines.iter().copied().filter(|omega| *omega > 0.0 && omega.is_finite()).collect();
    all.sort_by(f64::total_cmp);
    if let (Some(first), Some(last)) = (all.first().copied(), all.last().copied())
        && first < last
    {
        all.extend(log_grid(first, last, GRID));
        all.sort_by(f64::total_cmp);
    }
    all.dedup();
    all
}

/// Hz of rad/s.
fn hertz(omega_rad_s: f64) -> f64 {
    omega_rad_s / TAU
}

#[cfg(test)]
mod tests;
