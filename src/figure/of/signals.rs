//! The signals of a trial: r and y, u (and d), e = r − y.

use super::provenance::TrialOrigin;
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};
use crate::num::stats::mean;
use crate::trial::Trial;

/// The name of the figure in addresses.
pub const NAME: &str = "signals";

/// The times of a trial's samples in seconds: as recorded, or from 0.
pub(super) fn times(trial: &Trial) -> Vec<f64> {
    trial
        .signals
        .time_s
        .clone()
        .unwrap_or_else(|| (0..trial.samples()).map(|i| i as f64 * trial.sample_time_s).collect())
}

/// A recorded signal.
pub(super) fn samples(name: &str, ink: Ink, weight: Weight, time: &[f64], values: &[f64]) -> Series {
    Series::values(name, (Mark::Samples, ink, weight), time.to_vec(), values.iter().copied().map(Some))
}

/// The signals of a trial.
#[must_use]
pub fn signals(trial: &Trial, origin: &TrialOrigin) -> Figure {
    let time = times(trial);
    let error = trial.error();
    let own = &trial.signals;
    let (of_y, of_u) = (&origin.units.output, &origin.units.control);
    let mut followed = Panel::new(
        "r, command (wide), and y, output (thin)",
        Axis::linear("r, y", of_y.as_str()),
        vec![
            samples("r", Ink::Command, Weight::Wide, &time, &own.command),
            samples("y", Ink::Output, Weight::Thin, &time, &own.output),
        ],
    );
    if let Some(limit) = origin.display_limit {
        for at in [limit, -limit] {
            followed = followed.with_rule(at, "display limit", RuleKind::Limit);
        }
    }
    let mut driven = vec![samples("u", Ink::Control, Weight::Thin, &time, &own.control)];
    let mut title = "u, control";
    if let Some(disturbance) = &own.disturbance {
        driven.insert(0, samples("d", Ink::Command, Weight::Thin, &time, disturbance));
        title = "u, control (coloured), and d, disturbance (grey)";
    }
    let driven = Panel::new(title, Axis::linear("u", of_u.as_str()), driven).of_height(0.8);
    let missed = Panel::new(
        "e = r − y",
        Axis::linear("e", of_y.as_str()),
        vec![samples("e", Ink::Error, Weight::Thin, &time, &error)],
    )
    .with_rule(0.0, "", RuleKind::Reference)
    .of_height(0.8);
    Figure {
        name: NAME.to_owned(),
        title: format!("Signals of {}", origin.name()),
        description: description(&own.output, &error, origin),
        caption: origin.caption(trial),
        sampling: String::new(),
        x: Axis::linear("time", "s"),
        panels: vec![followed, driven, missed],
    }
}

fn description(output: &[f64], error: &[f64], origin: &TrialOrigin) -> String {
    let size = |values: &[f64]| values.iter().map(|value| value.abs()).collect::<Vec<f64>>();
    let largest = size(output).into_iter().fold(0.0, f64::max);
    let missed = mean(&size(error)).unwrap_or(0.0);
    let limit = origin.display_limit.map_or_else(String::new, |limit| {
        let side = if largest > limit { "above" } else { "below" };
        format!(", {side} the display limit of {}", three(limit))
    });
    format!(
        "The output misses the command by {} on average (mean of |r − y|); the largest |y| is {}{limit}.",
        three(missed),
        three(largest)
    )
}

#[cfg(test)]
pub(in crate::figure) mod tests {
    use super::*;
    use crate::figure::of::Units;
    use crate::trial::Signals;

    pub(in crate::figure) fn origin() -> TrialOrigin {
        TrialOrigin {
            subject: "MP01".into(),
            number: 40,
            session: None,
            plant: "minimum phase".into(),
            sha256: "7674f7bf00".into(),
            display_limit: Some(8.0),
            units: Units::default(),
        }
    }

    /// A minute of tracking with noise, `samples` long.
    pub(in crate::figure) fn trial(samples: usize, noise: f64) -> Trial {
        use crate::num::rng::stream;
        use rand::RngExt;
        let mut random = stream(20_261_130, "signals");
        let step = 60.0 / (samples - 1) as f64;
        let mut with_noise = |x: f64| x + noise * (random.random::<f64>() - 0.5);
        let (mut command, mut control, mut output) = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..samples {
            let t = step * i as f64;
            command.push(2.0 * (0.6 * t + 0.02 * t * t).sin());
            output.push(with_noise(1.95 * (0.6 * t + 0.02 * t * t - 0.1).sin()));
            control.push(with_noise(2.5 * (0.6 * t + 0.02 * t * t + 0.4).sin()));
        }
        Trial::new(step, Signals { time_s: None, command, control, output, disturbance: None }).unwrap()
    }

    #[test]
    fn a_trial_has_three_panels_that_hold_its_numbers() {
        let trial = trial(812, 0.1);
        let figure = signals(&trial, &origin());
        assert_eq!(figure.panels.len(), 3);
        let series = |panel: usize, at: usize| &figure.panels[panel].series[at];
        let values = |series: &Series| series.y.iter().map(|y| y.unwrap()).collect::<Vec<f64>>();
        assert_eq!(values(series(0, 0)), trial.signals.command);
        assert_eq!(values(series(0, 1)), trial.signals.output);
        assert_eq!(values(series(1, 0)), trial.signals.control);
        assert_eq!(values(series(2, 0)), trial.error());
        assert_eq!(figure.panels[0].y.text(), "r, y (unit of y)");
        assert!(figure.description.contains("below the display limit of 8.00"), "{}", figure.description);
        assert!(figure.caption.contains("MP01, trial 40 on minimum phase: 812 samples, 60.0 s"), "{}", figure.caption);
        assert!(figure.caption.contains("sha256 7674f7bf;"), "{}", figure.caption);
        let mut disturbed = trial.clone();
        disturbed.signals.disturbance = Some(vec![0.5; 812]);
        assert_eq!(signals(&disturbed, &origin()).panels[1].series.len(), 2);
    }
}
