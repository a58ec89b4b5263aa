//! Frequency responses: what was measured of the closed loop, and what was identified from it.

use super::bode::Unreadable;
use super::provenance::ReportOrigin;
use crate::analysis::frequency_response::FrequencyResponseResult;
use crate::analysis::ssid::SsidResult;
use crate::analysis::{Analysis as _, Report, frequency_response, ssid};
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};
use crate::num::Complex64;
use crate::num::distributions::student_t;
use std::f64::consts::TAU;

/// The name of the figure in addresses.
pub const NAME: &str = "response";

/// Probability of the whiskers.
const PROBABILITY: f64 = 0.95;

/// Degrees of freedom beyond which a variance is as good as known.
const MANY: f64 = 1e6;

/// What was measured at the lines, beside what was identified (`ssid`) or by itself (`frequency_response`).
///
/// # Errors
/// [`Unreadable`] where the kind has no response, or the report is of a form that this version does not know.
pub fn response(report: &Report, subject: &str) -> Result<Figure, Unreadable> {
    let found = if report.kind == frequency_response::Plan::KIND {
        measured(&super::bode::result(report)?)
    } else if report.kind == ssid::Plan::KIND {
        identified(&super::bode::result(report)?)
    } else {
        return Err(Unreadable::Kind { kind: report.kind.to_string() });
    };
    let origin = ReportOrigin { subject: subject.to_owned() };
    let channel = |name: &str| report.provenance.spec.get(name).and_then(|own| own.as_str()).map(str::to_owned);
    let between = channel("input").zip(channel("output"));
    let between = between.map_or_else(String::new, |(input, output)| format!(" from {input} to {output}"));
    Ok(Figure {
        name: NAME.to_owned(),
        title: format!("{subject}: frequency response{between}"),
        description: found.finding,
        caption: format!("{} {}", found.caption, origin.caption(report)),
        sampling: String::new(),
        x: Axis::logarithmic("frequency", "Hz"),
        panels: found.panels,
    })
}

struct Found {
    panels: Vec<Panel>,
    finding: String,
    caption: String,
}

/// Values of a response at increasing frequencies, as gain and phase.
struct Values {
    frequency_hz: Vec<f64>,
    gain_db: Vec<Option<f64>>,
    phase_deg: Vec<Option<f64>>,
    /// Half-widths relative to the values, where they are known.
    width: Vec<Option<f64>>,
}

impl Values {
    /// Lines at 0 Hz have no place on a logarithmic axis.
    fn new(lines: impl Iterator<Item = (f64, Option<Complex64>, Option<f64>)>) -> Self {
        let (mut frequency_hz, mut gain_db, mut phase_deg, mut width) = (vec![], vec![], vec![], vec![]);
        let mut last: Option<f64> = None;
        for (frequency, value, half) in lines.filter(|(frequency, ..)| *frequency > 0.0) {
            let value = value.filter(|value| value.is_finite() && value.norm() > 0.0);
            let phase = value.map(|value| {
                let own = value.arg().to_degrees();
                last.map_or(own, |last| own + 360.0 * ((last - own) / 360.0).round())
            });
            last = phase.or(last);
            frequency_hz.push(frequency);
            gain_db.push(value.map(|value| 20.0 * value.norm().log10()));
            phase_deg.push(phase);
            width.push(value.zip(half).map(|(value, half)| half / value.norm()));
        }
        Self { frequency_hz, gain_db, phase_deg, width }
    }

    /// Those that are marked, the others left out.
    fn only(&self, marked: &[bool]) -> Self {
        let of =
            |values: &[Option<f64>]| values.iter().zip(marked).map(|(value, own)| value.filter(|_| *own)).collect();
        Self {
            frequency_hz: self.frequency_hz.clone(),
            gain_db: of(&self.gain_db),
            phase_deg: of(&self.phase_deg),
            width: of(&self.width),
        }
    }

    /// Ends of gain and phase of a disc around each value; a disc that holds zero has none.
    fn ends(&self) -> [Vec<Option<[f64; 2]>>; 2] {
        let inside = |width: &Option<f64>| (*width).filter(|width| *width < 1.0);
        let gains = self.gain_db.iter().zip(&self.width).map(|(gain, width)| {
            let (gain, width) = ((*gain)?, inside(width)?);
            Some([gain + 20.0 * (1.0 - width).log10(), gain + 20.0 * (1.0 + width).log10()])
        });
        let phases = self.phase_deg.iter().zip(&self.width).map(|(phase, width)| {
            let (phase, half) = ((*phase)?, inside(width)?.asin().to_degrees());
            Some([phase - half, phase + half])
        });
        [gains.collect(), phases.collect()]
    }

    fn series(&self, name: &str, look: (Mark, Ink, Weight)) -> [Series; 2] {
        let of = |values: &[Option<f64>]| Series::values(name, look, self.frequency_hz.clone(), values.iter().copied());
        [of(&self.gain_db), of(&self.phase_deg)]
    }
}

/// Gain and phase panels.
fn panels(symbol: &str, [gain, phase]: [Vec<Series>; 2]) -> Vec<Panel> {
    vec![
        Panel::new("", Axis::linear(format!("|{symbol}|"), "dB"), gain),
        Panel::new("", Axis::linear(format!("∠{symbol}"), "°"), phase),
    ]
}

fn measured(result: &FrequencyResponseResult) -> Found {
    let quantile = |at: usize| {
        let own = result.variance_degrees_of_freedom;
        let averages = result.averages.get(at).copied().unwrap_or(0);
        let degrees = match (own, result.variance_source.as_deref()) {
            (Some(degrees), _) => degrees,
            (None, Some("repetition")) if averages > 1 => 2.0 * (averages as f64 - 1.0),
            _ => MANY,
        };
        student_t(PROBABILITY, degrees.max(1.0))
    };
    let lines = result.frequency_hz.iter().enumerate().map(|(at, frequency)| {
        let value = result.h.get(at).copied().flatten().map(|[re, im]| Complex64::new(re, im));
        // Half of the variance of a complex error lies along the value.
        let variance = result.variance.get(at).copied().flatten();
        (*frequency, value, variance.map(|variance| quantile(at) * (0.5 * variance).sqrt()))
    });
    let all = Values::new(lines);
    let positive: Vec<usize> = (0..result.frequency_hz.len()).filter(|at| result.frequency_hz[*at] > 0.0).collect();
    let usable: Vec<bool> = positive.iter().map(|at| result.usable.get(*at).copied().unwrap_or(true)).collect();
    let unusable: Vec<bool> = usable.iter().map(|own| !own).collect();
    let values = all.only(&usable);
    let dots = values.series("measured", (Mark::Points, Ink::First, Weight::Thick));
    let bars = values.ends().map(|ends| {
        let look = (Mark::Bars, Ink::First, Weight::Thin);
        Series::intervals("95 %", look, values.frequency_hz.clone(), ends)
    });
    let [dots_of_gain, dots_of_phase] = dots;
    let [bars_of_gain, bars_of_phase] = bars;
    let (mut of_gain, mut of_phase) = (vec![bars_of_gain, dots_of_gain], vec![bars_of_phase, dots_of_phase]);
    let doubtful = unusable.iter().filter(|own| **own).count();
    if doubtful > 0 {
        let crosses = all.only(&unusable).series("not to be used", (Mark::Crosses, Ink::Muted, Weight::Thin));
        let [crosses_of_gain, crosses_of_phase] = crosses;
        of_gain.push(crosses_of_gain);
        of_phase.push(crosses_of_phase);
    }
    let mut panels = panels("H", [of_gain, of_phase]);
    let places: Vec<f64> = positive.iter().map(|at| result.frequency_hz[*at]).collect();
    let of = |list: &[Option<f64>]| positive.iter().map(|at| list.get(*at).copied().flatten()).collect::<Vec<_>>();
    let coherence = of(&result.coherence);
    let known: Vec<f64> = coherence.iter().flatten().copied().collect();
    if !known.is_empty() {
        let line = Series::values("coherence", (Mark::Line, Ink::First, Weight::Thin), places.clone(), coherence);
        let panel = Panel::new("", Axis::linear("coherence", "1").including(&[0.0, 1.0]), vec![line]);
        panels.push(panel.of_height(0.7));
    }
    let power: Vec<Option<f64>> = positive.iter().map(|at| result.command_power.get(*at).copied()).collect();
    let line = Series::values("power", (Mark::Points, Ink::Command, Weight::Thin), places.clone(), power);
    panels.push(Panel::new("", Axis::logarithmic("input power", "unit²"), vec![line]).of_height(0.7));
    let least = known.iter().copied().reduce(f64::min);
    let ends = [places.first(), places.last()].map(|end| end.map_or_else(|| "none".to_owned(), |end| three(*end)));
    let coherent = least.map_or_else(
        || "The coherence of one segment is not known.".to_owned(),
        |least| format!("The least coherence is {}.", three(least)),
    );
    Found {
        finding: format!(
            "{} lines from {} to {} Hz{}. {coherent}",
            places.len(),
            ends[0],
            ends[1],
            if doubtful > 0 { format!(", {doubtful} not to be used") } else { String::new() }
        ),
        caption: match &result.variance_source {
            Some(source) => format!(
                "Crosses: lines whose error exceeds a fifth of the response, or is not known. Whiskers: 95 % of \
                 each line, its noise by {}.",
                source.replace('_', " ")
            ),
            None => "The variance of the lines is not known, so that there are no whiskers.".to_owned(),
        },
        panels,
    }
}

fn identified(result: &SsidResult) -> Found {
    let pair = |[re, im]: [f64; 2]| Some(Complex64::new(re, im));
    let data = Values::new(result.fit.iter().map(|line| (line.omega_rad_s / TAU, pair(line.h), None)));
    let mut model = Values::new(result.fit.iter().map(|line| (line.omega_rad_s / TAU, pair(line.model), None)));
    // The model lies within half a turn of the data that it was fitted to.
    for (own, measured) in model.phase_deg.iter_mut().zip(&data.phase_deg) {
        if let (Some(own), Some(measured)) = (own, measured) {
            *own += 360.0 * ((*measured - *own) / 360.0).round();
        }
    }
    let dots = data.series("measured", (Mark::Points, Ink::Muted, Weight::Thin));
    let line = model.series("identified loop", (Mark::Line, Ink::First, Weight::Thick)).map(Series::labelled);
    let [dots_of_gain, dots_of_phase] = dots;
    let [line_of_gain, line_of_phase] = line;
    let mut all = panels("Gyr", [vec![dots_of_gain, line_of_gain], vec![dots_of_phase, line_of_phase]]);
    all[0] = all[0].clone().with_rule(0.0, "y follows r", RuleKind::Reference);
    let worst = result.fit.iter().map(|line| {
        let size = line.h[0].hypot(line.h[1]);
        (line.residual[0].hypot(line.residual[1]) / size, line.omega_rad_s / TAU)
    });
    let worst = worst.filter(|(share, _)| share.is_finite()).max_by(|a, b| a.0.total_cmp(&b.0));
    let worst = worst.map_or_else(String::new, |(share, frequency)| {
        format!(
            "The identified loop misses the data by at most {} % of their size, at {} Hz.",
            three(100.0 * share),
            three(frequency)
        )
    });
    Found {
        finding: worst,
        caption: format!("Dots: measured at {} lines; line: the pool's best candidate.", data.frequency_hz.len()),
        panels: all,
    }
}
