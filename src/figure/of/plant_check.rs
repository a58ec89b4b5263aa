//! Whether the output follows from the control through the plant.

use super::provenance::TrialOrigin;
use super::signals::{samples, times};
use crate::control::Model;
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Panel, RuleKind, Weight};
use crate::learning::recording::predicted_output;
use crate::trial::Trial;

/// The name of the figure in addresses.
pub const NAME: &str = "plant_check";

/// Shares of the output's variation that are left over, from which the recording is in doubt, and not to be used.
const DOUBTFUL: f64 = 0.05;
const FOREIGN: f64 = 0.2;

/// y with G·u from the initial states that fit best, and below what is left over; `None` where that cannot be judged
/// (several channels, a plant that cannot be sampled, an output that never moves).
#[must_use]
pub fn plant_check(trial: &Trial, plant: &Model, origin: &TrialOrigin) -> Option<Figure> {
    let found = predicted_output(trial, plant)?;
    let time = times(trial);
    let residual: Vec<f64> = trial.signals.output.iter().zip(&found.output).map(|(y, own)| y - own).collect();
    let input = if trial.signals.disturbance.is_some() { "G·(u + d)" } else { "G·u" };
    let unit = origin.units.output.as_str();
    let both = Panel::new(
        format!("y, recorded (wide), and {input}, what the plant makes of the control (thin)"),
        Axis::linear("y", unit),
        vec![
            samples("y", Ink::Command, Weight::Wide, &time, &trial.signals.output),
            samples(input, Ink::Control, Weight::Thin, &time, &found.output),
        ],
    );
    let left = Panel::new(
        format!("y − {input}"),
        Axis::linear("residual", unit),
        vec![samples("residual", Ink::Error, Weight::Thin, &time, &residual)],
    )
    .with_rule(0.0, "", RuleKind::Reference)
    .of_height(0.7);
    let missed = (1.0 - found.explained).max(0.0);
    let percent = three(100.0 * missed);
    let description = if missed > FOREIGN {
        format!(
            "y does not follow from {input} through this plant: {percent} % of its variation is unexplained. Wrong \
             plant, swapped columns or another sample time?"
        )
    } else if missed > DOUBTFUL {
        format!("y follows from {input} through this plant to {percent} %, which is more than noise should leave.")
    } else {
        format!("y follows from {input} through this plant to {percent} %.")
    };
    let pieces = match found.pieces {
        1 => "from the initial state that fits best".to_owned(),
        count => format!("in {count} pieces, each from the initial state that fits best, since the plant runs away"),
    };
    Some(Figure {
        name: NAME.to_owned(),
        title: format!("{}: does y follow from the control through the plant?", origin.name()),
        caption: format!("{input} {pieces}; {percent} % of the variation of y is left over. {}", origin.caption(trial)),
        description,
        sampling: String::new(),
        x: Axis::linear("time", "s"),
        panels: vec![both, left],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::of::signals::tests::origin;
    use crate::learning::recording::explained_output;
    use crate::simulate::reference_signals::chirp60;
    use crate::simulate::subject::SimulatedSubject;

    #[test]
    fn what_is_left_over_is_the_share_that_the_check_of_recordings_finds() {
        let subject = SimulatedSubject::new(&crate::plants::catalogue::minimum_phase(), 0.05, 1).unwrap();
        let trial = subject.trial(1, &chirp60(0.05), None).unwrap();
        let own: Model =
            serde_json::from_value(serde_json::json!({"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0]})).unwrap();
        let other: Model = serde_json::from_value(serde_json::json!({"num": [-1.0], "den": [1.0, 0.2, 9.0]})).unwrap();
        for (plant, word) in [(own, "y follows from G·u"), (other, "y does not follow from G·u")] {
            let figure = plant_check(&trial, &plant, &origin()).unwrap();
            assert!(figure.description.starts_with(word), "{}", figure.description);
            let residual = &figure.panels[1].series[0].y;
            let missed: f64 = residual.iter().map(|e| e.unwrap().powi(2)).sum();
            let mean = trial.signals.output.iter().sum::<f64>() / trial.samples() as f64;
            let variation: f64 = trial.signals.output.iter().map(|y| (y - mean).powi(2)).sum();
            let share = explained_output(&trial, &plant).unwrap();
            assert!((1.0 - missed / variation - share).abs() < 1e-9, "{share}");
        }
    }
}
