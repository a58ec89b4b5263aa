//! The power of a trial's signals over frequency.

use super::provenance::TrialOrigin;
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, Series, Weight};
use crate::num::fourier::real_transform;
use crate::num::stats::mean;
use crate::trial::Trial;

/// The name of the figure in addresses.
pub const NAME: &str = "spectra";

/// Lines of the command with less than this share of its greatest power are none.
const SHARE: f64 = 1e-3;

/// The power of each line k/T of a record, in squared units of the signal: half the squared amplitude, so that the
/// powers add up to the mean square of the signal less its mean.
fn powers(values: &[f64]) -> Vec<f64> {
    let n = values.len();
    let middle = mean(values).unwrap_or(0.0);
    let without: Vec<f64> = values.iter().map(|value| value - middle).collect();
    let lines = real_transform(&without);
    let own = |(k, line): (usize, &crate::num::Complex64)| {
        // The line at the Nyquist frequency has no mirror image.
        let images = if 2 * k == n { 1.0 } else { 2.0 };
        images * line.norm_sqr() / (n as f64).powi(2)
    };
    lines.iter().enumerate().skip(1).map(own).collect()
}

/// Powers of r and y, of u (and d), and of e at the lines k/T of the whole record.
#[must_use]
pub fn spectra(trial: &Trial, origin: &TrialOrigin) -> Figure {
    let n = trial.samples();
    let spacing = 1.0 / (n as f64 * trial.sample_time_s);
    let frequency: Vec<f64> = (1..=n / 2).map(|k| k as f64 * spacing).collect();
    let signals = &trial.signals;
    let line = |name: &str, ink, weight, values: &[f64]| {
        let power = powers(values).into_iter().map(|power| Some(power).filter(|power| *power > 0.0));
        Series::values(name, (Mark::Line, ink, weight), frequency.clone(), power)
    };
    let error = trial.error();
    let command = powers(&signals.command);
    let most = command.iter().copied().fold(0.0, f64::max);
    let excited: Vec<f64> =
        frequency.iter().zip(&command).filter(|(_, power)| **power > SHARE * most).map(|(f, _)| *f).collect();
    let (of_y, of_u) = (&origin.units.output, &origin.units.control);
    let squared = |unit: &str| format!("({unit})²");
    let mut driven = vec![line("u", Ink::Control, Weight::Thin, &signals.control)];
    if let Some(disturbance) = &signals.disturbance {
        driven.insert(0, line("d", Ink::Command, Weight::Wide, disturbance));
    }
    let panels = vec![
        Panel::new(
            "power of r, command (wide), and y, output (thin)",
            Axis::logarithmic("power", squared(of_y)),
            vec![
                line("r", Ink::Command, Weight::Wide, &signals.command),
                line("y", Ink::Output, Weight::Thin, &signals.output),
            ],
        ),
        Panel::new("power of u, control", Axis::logarithmic("power", squared(of_u)), driven),
        Panel::new(
            "power of e = r − y",
            Axis::logarithmic("power", squared(of_y)),
            vec![line("e", Ink::Error, Weight::Thin, &error)],
        ),
    ];
    let shared: f64 = powers(&error).iter().zip(&command).filter(|(_, r)| **r > SHARE * most).map(|(e, _)| *e).sum();
    let whole: f64 = powers(&error).iter().sum();
    let finding = match (excited.first(), excited.last()) {
        (Some(first), Some(last)) if most > 0.0 && whole > 0.0 => format!(
            "The command has power at {} lines from {} to {} Hz; {} % of the power of the error lies at these lines.",
            excited.len(),
            three(*first),
            three(*last),
            three(100.0 * shared / whole)
        ),
        _ => "The command has no power.".to_owned(),
    };
    Figure {
        name: NAME.to_owned(),
        title: format!("{}: power over frequency", origin.name()),
        description: finding,
        caption: format!(
            "Powers at the lines k/T of the whole record, less its mean: they add up to the mean square. {}",
            origin.caption(trial)
        ),
        sampling: String::new(),
        x: Axis::logarithmic("frequency", "Hz"),
        panels,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::of::signals::tests::{origin, trial};

    /// Parseval, for even and odd lengths.
    #[test]
    fn the_powers_add_up_to_the_mean_square() {
        for samples in [400, 401] {
            let trial = trial(samples, 0.3);
            let figure = spectra(&trial, &origin());
            let of = |panel: usize, series: usize| figure.panels[panel].series[series].y.iter().flatten().sum::<f64>();
            let variance = |values: &[f64]| {
                let middle = values.iter().sum::<f64>() / values.len() as f64;
                values.iter().map(|v| (v - middle).powi(2)).sum::<f64>() / values.len() as f64
            };
            let own = &trial.signals;
            for (found, values) in [
                (of(0, 0), &own.command),
                (of(0, 1), &own.output),
                (of(1, 0), &own.control),
                (of(2, 0), &trial.error()),
            ] {
                let expected = variance(values);
                assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
            }
        }
        let sine: Vec<f64> =
            (0..100).map(|i| 3.0 * (std::f64::consts::TAU * 5.0 * f64::from(i) / 100.0).sin()).collect();
        let found = powers(&sine);
        assert!((found[4] - 4.5).abs() < 1e-9 && found[3] < 1e-20, "{found:?}");
    }
}
