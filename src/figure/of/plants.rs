//! The plants of a study: their frequency responses, what they answer to a step, and to a growing exponential.

use super::provenance::product;
use crate::control::bode::{bode, log_grid};
use crate::control::simulate::{Hold, filter, sampled_response};
use crate::control::{Discrete, Model, System};
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};
use crate::num::Complex64;
use std::f64::consts::{PI, TAU};

/// The names of the figures in addresses: Bode plots,
pub const BODE: &str = "plants";
/// answers to a unit step,
pub const STEPS: &str = "plant_steps";
/// and to the exponential of an unstable zero.
pub const ZERO: &str = "plant_zero";

/// Frequencies of a response.
const FREQUENCIES: usize = 200;
/// Samples of an answer in time.
const SAMPLES: usize = 1200;
/// Time constants of the slowest mode that an answer to a step lasts.
const CONSTANTS: f64 = 6.0;
/// How far the exponential grows: to e⁶.
const GROWTH: f64 = 6.0;

/// A plant that can be drawn.
struct Drawn<'a> {
    name: &'a str,
    system: System,
    delay_s: f64,
    /// Poles and zeros as rates in 1/s.
    poles: Vec<Complex64>,
    zeros: Vec<Complex64>,
}

impl<'a> Drawn<'a> {
    /// None of several channels.
    fn new(name: &'a str, model: &Model) -> Option<Self> {
        let (system, delay_s) = model.check_delayed().ok()?;
        let rates = |all: Vec<Complex64>| match system.sample_time_s() {
            None => all,
            Some(period) => all.into_iter().filter(|z| z.norm() > 0.0).map(|z| z.ln() / period).collect(),
        };
        let (poles, zeros) = (rates(system.poles().ok()?), rates(system.zeros().ok()?));
        Some(Self { name, system, delay_s, poles, zeros })
    }

    fn response(&self, omega: f64) -> Complex64 {
        self.system.response(omega) * Complex64::from_polar(1.0, -omega * self.delay_s)
    }

    /// The output to an input that is given at times; `None` where it leaves the finite numbers, or is improper.
    fn output(&self, input: impl Fn(f64) -> f64, length_s: f64) -> Option<(Vec<f64>, Vec<f64>)> {
        let period = self.system.sample_time_s().unwrap_or(length_s / SAMPLES as f64);
        let count = ((length_s / period).ceil() as usize + 1).clamp(2, 50 * SAMPLES);
        let times: Vec<f64> = (0..count).map(|k| k as f64 * period).collect();
        let values: Vec<f64> = times.iter().map(|t| input(*t)).collect();
        let found = match &self.system {
            System::Continuous(own) => sampled_response(own, &values, Discrete::new(period).ok()?, Hold::First).ok()?,
            System::Discrete(own) => filter(own, &values).ok()?,
        };
        Some((times.into_iter().map(|t| t + self.delay_s).collect(), found))
    }
}

/// Those of a study's plants that can be drawn.
fn drawn(plants: &[(String, Model)]) -> Vec<Drawn<'_>> {
    plants.iter().filter_map(|(name, model)| Drawn::new(name, model)).collect()
}

fn figure(name: &str, title: &str, words: [String; 2], x: Axis, panels: Vec<Panel>) -> Figure {
    let [description, caption] = words;
    let description =
        if description.is_empty() { "No plant of the study can be drawn.".to_owned() } else { description };
    let caption = format!("{caption} {}.", product());
    Figure { name: name.to_owned(), title: title.to_owned(), description, caption, sampling: String::new(), x, panels }
}

/// Gain and phase of every plant, a decade beyond its slowest and fastest poles and zeros (Zhang 2015, figure 5.3).
#[must_use]
pub fn bode_of_plants(plants: &[(String, Model)]) -> Figure {
    let all = drawn(plants);
    let rates: Vec<f64> = all
        .iter()
        .flat_map(|own| own.poles.iter().chain(&own.zeros))
        .map(|rate| rate.norm())
        .filter(|rate| *rate > 1e-9 && rate.is_finite())
        .collect();
    let slowest = rates.iter().copied().fold(f64::INFINITY, f64::min);
    let fastest = rates.iter().copied().fold(0.0, f64::max);
    let (slowest, fastest) = if slowest <= fastest { (slowest, fastest) } else { (0.1 * TAU, 10.0 * TAU) };
    let nyquist = all.iter().filter_map(|own| own.system.sample_time_s()).map(|t| PI / t).fold(f64::INFINITY, f64::min);
    let (from, to) = (0.1 * slowest, (10.0 * fastest).min(nyquist));
    let omega = log_grid(from.min(0.5 * to), to, FREQUENCIES);
    let x: Vec<f64> = omega.iter().map(|omega| omega / TAU).collect();
    let (mut gains, mut phases, mut sentences) = (Vec::new(), Vec::new(), Vec::new());
    for (at, own) in all.iter().enumerate() {
        let found = bode(&omega, &omega.iter().map(|w| own.response(*w)).collect::<Vec<_>>());
        let look = (Mark::Line, Ink::of_group(at), Weight::Thick);
        let line = |values: Vec<Option<f64>>| Series::values(own.name, look, x.clone(), values).labelled();
        gains.push(line(found.gain_db));
        phases.push(line(found.phase_deg));
        let right = own.zeros.iter().filter(|zero| zero.re > 1e-9).count();
        let kind = if right == 0 {
            "minimum phase".to_owned()
        } else {
            format!("{right} {} on the right", if right == 1 { "zero" } else { "zeros" })
        };
        sentences.push(format!("{}: {kind}.", own.name));
    }
    let panels =
        vec![Panel::new("", Axis::linear("|G|", "dB"), gains), Panel::new("", Axis::linear("∠G", "°"), phases)];
    let words = [sentences.join(" "), "Plants of the study, delays included.".to_owned()];
    figure(BODE, "Plants of the study", words, Axis::logarithmic("frequency", "Hz"), panels)
}

/// What every plant answers to a unit step (Zhang 2015, figure 5.5).
#[must_use]
pub fn steps_of_plants(plants: &[(String, Model)], unit: &str) -> Figure {
    let all = drawn(plants);
    let slowest = all.iter().flat_map(|own| &own.poles).map(|pole| pole.re.abs()).filter(|rate| *rate > 1e-6);
    let length = CONSTANTS / slowest.fold(f64::INFINITY, f64::min);
    let length = if length.is_finite() && length > 0.0 { length.min(600.0) } else { 10.0 };
    let (mut series, mut sentences) = (Vec::new(), Vec::new());
    for (at, own) in all.iter().enumerate() {
        let Some((x, y)) = own.output(|_| 1.0, length) else {
            sentences.push(format!("{}: no finite answer.", own.name));
            continue;
        };
        let end = y.last().copied().unwrap_or(0.0);
        // Undershoot is what goes to the other side than where it ends.
        let under = y.iter().map(|value| -value * end.signum()).fold(0.0, f64::max);
        sentences.push(format!(
            "{} is at {} after {} s{}.",
            own.name,
            three(end),
            three(length),
            if under > 1e-9 * end.abs() {
                format!(", and goes to the other side by up to {}", three(under))
            } else {
                String::new()
            }
        ));
        let look = (Mark::Line, Ink::of_group(at), Weight::Thick);
        series.push(Series::values(own.name, look, x, y.into_iter().map(Some)).labelled());
    }
    let panel = Panel::new("", Axis::linear("y", unit), series).with_rule(0.0, "", RuleKind::Reference);
    let words = [sentences.join(" "), "From rest, u = 1 from time 0 on.".to_owned()];
    figure(STEPS, "Answers of the plants to a unit step", words, Axis::linear("time", "s"), vec![panel])
}

/// What every plant answers to `u = e^{zt}`, with z the least real zero on the right of any of them: that one's output
/// dies out although its input grows (Zhang 2015, figure 5.4). `None` where no plant has such a zero.
#[must_use]
pub fn zero_of_plants(plants: &[(String, Model)], unit: &str) -> Option<Figure> {
    let all = drawn(plants);
    let real = |own: &Drawn<'_>| -> Vec<f64> {
        own.zeros.iter().filter(|zero| zero.re > 1e-9 && zero.im.abs() < 1e-6 * zero.norm()).map(|z| z.re).collect()
    };
    let (zero, owner) = all
        .iter()
        .flat_map(|own| real(own).into_iter().map(move |zero| (zero, own.name)))
        .min_by(|a, b| a.0.total_cmp(&b.0))?;
    let length = GROWTH / zero;
    let (mut series, mut sentences) = (Vec::new(), Vec::new());
    for (at, own) in all.iter().enumerate() {
        let Some((x, y)) = own.output(|t| (zero * t).exp(), length) else { continue };
        sentences.push(format!("{} ends at {}.", own.name, three(y.last().copied().unwrap_or(0.0))));
        let look = (Mark::Line, Ink::of_group(at), Weight::Thick);
        series.push(Series::values(own.name, look, x, y.into_iter().map(Some)).labelled());
    }
    let panel = Panel::new("", Axis::linear("y", unit), series).with_rule(0.0, "", RuleKind::Reference);
    let words = [
        format!("The input grows with {} 1/s, the zero of {owner}. {}", three(zero), sentences.join(" ")),
        format!("From rest, u = exp({} t).", three(zero)),
    ];
    Some(figure(
        ZERO,
        "Answers of the plants to the exponential of a zero",
        words,
        Axis::linear("time", "s"),
        vec![panel],
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn plants() -> Vec<(String, Model)> {
        let model = |num: &[f64], den: &[f64]| serde_json::from_value(json!({"num": num, "den": den})).unwrap();
        vec![
            ("right".to_owned(), model(&[-1.0, 2.0], &[1.0, 3.0, 2.0])),
            ("left".to_owned(), model(&[1.0, 2.0], &[1.0, 3.0, 2.0])),
        ]
    }

    /// `(2 − s)/((s + 1)(s + 2))` answers a step with `1 − 3e^{−t} + 2e^{−2t}`, and `e^{2t}` with no growing part.
    #[test]
    fn answers_are_those_of_partial_fractions() {
        let steps = steps_of_plants(&plants(), "cm");
        let right = &steps.panels[0].series[0];
        for (t, y) in right.x.iter().zip(&right.y) {
            let expected = 1.0 - 3.0 * (-t).exp() + 2.0 * (-2.0 * t).exp();
            assert!((y.unwrap() - expected).abs() < 1e-9, "{t}");
        }
        assert!(steps.description.contains("right is at 0.99"), "{}", steps.description);
        assert!(steps.description.contains("other side by up to 0.125"), "{}", steps.description);
        let zero = zero_of_plants(&plants(), "cm").unwrap();
        let of = |at: usize| zero.panels[0].series[at].y.last().unwrap().unwrap();
        // −e^{−t} + e^{−2t} for the one, and for the other a share of e^{2t}: 1/3 of it.
        assert!((of(0) - (-(-3.0_f64).exp() + (-6.0_f64).exp())).abs() < 0.01, "{}", of(0));
        assert!((of(1) - (6.0_f64).exp() / 3.0).abs() < 0.2, "{}", of(1));
        assert!(zero_of_plants(&plants()[1..], "cm").is_none());
    }

    #[test]
    fn responses_are_those_of_the_plants() {
        let figure = bode_of_plants(&plants());
        let gain = &figure.panels[0].series[0];
        for (f, value) in gain.x.iter().zip(&gain.y) {
            let w = TAU * f;
            let expected = -10.0 * (1.0 + w * w).log10();
            assert!((value.unwrap() - expected).abs() < 1e-9, "{f}");
        }
        assert_eq!(figure.description, "right: 1 zero on the right. left: minimum phase.");
    }
}
