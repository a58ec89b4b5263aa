//! What was recorded against what the identified loop makes of the command.

use super::bode::Unreadable;
use super::provenance::{ReportOrigin, TrialOrigin};
use super::signals::{samples, times};
use crate::analysis::ssid::SsidResult;
use crate::analysis::{Analysis as _, Report, ssid};
use crate::control::{Model, System};
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Panel, Weight};
use crate::identify::validation::simulated_loop;
use crate::num::stats::accounted_for;
use crate::trial::Trial;

/// The name of the figure in addresses.
pub const NAME: &str = "simulated";

/// y and u as recorded, and as the best candidate of the pool gives them from the command (and the disturbance) alone.
///
/// # Errors
/// [`Unreadable`] where the kind has no such loop, the report is of a form that this version does not know, or the loop
/// cannot be simulated.
pub fn simulated(
    report: &Report,
    trial: &Trial,
    origin: &TrialOrigin,
    plant: Option<&Model>,
) -> Result<Figure, Unreadable> {
    if report.kind != ssid::Plan::KIND {
        return Err(Unreadable::Kind { kind: report.kind.to_string() });
    }
    let result: SsidResult = super::bode::result(report)?;
    let delay_s = plant.and_then(|plant| plant.check_delayed().ok()).map_or(0.0, |(_, delay_s)| delay_s);
    let system = |model: &Model| model.check().map_err(|error| Unreadable::Form(error.to_string()));
    let (plant, feedforward, feedback) =
        (system(&result.plant)?, system(&result.feedforward)?, system(&result.feedback)?);
    if delay_s > 0.0 && matches!(plant, System::Continuous(_)) {
        return Err(Unreadable::Nothing("a continuous plant with a delay is not simulated".to_owned()));
    }
    let found = simulated_loop(trial, &plant, &feedforward, &feedback)
        .map_err(|error| Unreadable::Nothing(error.to_string()))?;
    let time = times(trial);
    let own = &trial.signals;
    let panel = |name: &str, unit: &str, ink, recorded: &[f64], simulated: Option<&[f64]>| {
        let mut series = vec![samples(&format!("{name}, recorded"), Ink::Command, Weight::Wide, &time, recorded)];
        if let Some(simulated) = simulated {
            series.push(samples(&format!("{name}, simulated"), ink, Weight::Thin, &time, simulated));
        }
        let title = format!("{name}, recorded (wide) and simulated (thin)");
        Panel::new(title, Axis::linear(name, unit), series)
    };
    let share = |recorded: &[f64], simulated: Option<&[f64]>| {
        let share = simulated.and_then(|simulated| accounted_for(recorded, simulated));
        share.map_or_else(|| "unknown".to_owned(), |share| format!("{} %", three(100.0 * share)))
    };
    let control = found.control.as_deref();
    let (of_y, of_u) = (share(&own.output, Some(&found.output)), share(&own.control, control));
    let about = ReportOrigin { subject: origin.name() };
    Ok(Figure {
        name: NAME.to_owned(),
        title: format!("{}: recorded and simulated", origin.name()),
        description: format!(
            "From the command alone the identified loop explains {of_y} of the variation of y and {of_u} of that of u."
        ),
        caption: format!(
            "Simulated from rest with the pool's best candidate, driven by the command{}: variance accounted for \
             {of_y} of y, {of_u} of u. {}",
            if own.disturbance.is_some() { " and the disturbance" } else { "" },
            about.caption(report)
        ),
        sampling: String::new(),
        x: Axis::linear("time", "s"),
        panels: vec![
            panel("y", &origin.units.output, Ink::Output, &own.output, Some(&found.output)),
            panel("u", &origin.units.control, Ink::Control, &own.control, control),
        ],
    })
}
