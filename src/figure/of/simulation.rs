//! What a simulation answers: its signals, its responses, its answer to a step.

use super::bode::Unreadable;
use super::document::{all_numbers, number, numbers};
use super::provenance::ReportOrigin;
use crate::analysis::{Analysis as _, Report, simulate};
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};
use std::f64::consts::TAU;

/// The names of the figures in addresses: signals,
pub const SIGNALS: &str = "signals";
/// frequency responses of controllers and loop,
pub const BODE: &str = "bode";
/// and the answer to a unit step.
pub const STEP: &str = "step";

/// A figure of a simulation by its name.
///
/// # Errors
/// [`Unreadable`] where the kind is no simulation's, or the report is of a form that this version does not know.
pub fn simulation(report: &Report, name: &str, subject: &str) -> Result<Figure, Unreadable> {
    if report.kind != simulate::Plan::KIND {
        return Err(Unreadable::Kind { kind: report.kind.to_string() });
    }
    let (what, x, panels, description) = match name {
        STEP => step(report)?,
        BODE => bode(report)?,
        _ => signals(report)?,
    };
    let origin = ReportOrigin { subject: subject.to_owned() };
    Ok(Figure {
        name: name.to_owned(),
        title: format!("{subject}: {what}"),
        description,
        caption: format!("Simulated. {}", origin.caption(report)),
        sampling: String::new(),
        x,
        panels,
    })
}

type Found = (&'static str, Axis, Vec<Panel>, String);

/// A list of a result as a line; `None` where it is null.
fn line(report: &Report, x: &[f64], root: &str, name: &str, look: (Mark, Ink, Weight)) -> Option<Series> {
    let values = numbers(&report.result, &format!("{root}/{name}")).ok()?;
    (values.len() == x.len()).then(|| Series::values(name, look, x.to_vec(), values))
}

fn signals(report: &Report) -> Result<Found, Unreadable> {
    let t = all_numbers(&report.result, "/signals/t")?;
    let of = |name: &str, ink, weight| line(report, &t, "/signals", name, (Mark::Samples, ink, weight));
    let panel = |title: &str, label: &str, unit: &str, series: Vec<Option<Series>>| {
        let series: Vec<Series> = series.into_iter().flatten().collect();
        (!series.is_empty()).then(|| Panel::new(title, Axis::linear(label, unit), series))
    };
    let followed = [of("r", Ink::Command, Weight::Wide), of("y", Ink::Output, Weight::Thin)];
    let driven = [of("d", Ink::Command, Weight::Thin), of("u", Ink::Control, Weight::Thin)];
    let panels = [
        panel("r, command (wide), and y, output (thin)", "r, y", "unit of y", followed.into()),
        panel("u, control", "u", "unit of u", driven.into()),
        panel("e = r − y", "e", "unit of y", vec![of("e", Ink::Error, Weight::Thin)]),
    ];
    let of = |pointer: &str| number(&report.result, pointer).map_or_else(|| "unknown".to_owned(), three);
    let description = format!(
        "The simulated output misses the command by {} on average (mean of |r − y|); ‖Gfb‖ is {}, ‖Gff G − 1‖ {}.",
        of("/metrics/mean_abs_error"),
        of("/norms/norm_feedback"),
        of("/norms/norm_feedforward_plant_minus_one")
    );
    Ok(("simulated signals", Axis::linear("time", "s"), panels.into_iter().flatten().collect(), description))
}

fn bode(report: &Report) -> Result<Found, Unreadable> {
    let root = "/frequency_responses";
    let x: Vec<f64> = all_numbers(&report.result, &format!("{root}/omega_rad_s"))?.iter().map(|w| w / TAU).collect();
    let mut panels = Vec::new();
    let drawn = [("feedforward", "Gff", ""), ("feedback", "Gfb", ""), ("closed_loop", "Gyr", "y follows r")];
    for (column, (part, symbol, zero)) in drawn.into_iter().enumerate() {
        let of = |name: &str| {
            let look = (Mark::Line, Ink::First, Weight::Thick);
            line(report, &x, &format!("{root}/{part}"), name, look).into_iter().collect::<Vec<_>>()
        };
        let (gains, phases) = (of("gain_db"), of("phase_deg"));
        // A controller that is not there has no gain in decibels.
        if gains.iter().all(Series::is_empty) {
            continue;
        }
        let mut gain = Panel::new(symbol, Axis::linear(format!("|{symbol}|"), "dB"), gains).in_column(column);
        let phase = Panel::new("", Axis::linear(format!("∠{symbol}"), "°"), phases).in_column(column);
        if !zero.is_empty() {
            gain.y = gain.y.including(&[0.0]);
            gain = gain.with_rule(0.0, zero, RuleKind::Reference);
        }
        panels.extend([gain, phase]);
    }
    let far = panels.iter().filter(|panel| panel.title == "Gyr").flat_map(|panel| &panel.series);
    let far = far.flat_map(|series| series.y.iter().flatten()).copied().max_by(|a, b| a.abs().total_cmp(&b.abs()));
    let far = far.map_or_else(|| "unknown".to_owned(), three);
    let description = format!("The closed loop is at most {far} dB from 1 over these frequencies.");
    Ok(("frequency responses", Axis::logarithmic("frequency", "Hz"), panels, description))
}

fn step(report: &Report) -> Result<Found, Unreadable> {
    let t = all_numbers(&report.result, "/step_response/t")?;
    let of = |name: &str, ink, weight| line(report, &t, "/step_response", name, (Mark::Line, ink, weight));
    let outputs = [of("plant", Ink::Muted, Weight::Thin), of("y", Ink::Output, Weight::Thick)];
    let outputs: Vec<Series> = outputs.into_iter().flatten().map(Series::labelled).collect();
    let controls: Vec<Series> = of("u", Ink::Control, Weight::Thick).into_iter().collect();
    let end = outputs.last().and_then(|series| series.y.iter().flatten().last().copied());
    let mut panels =
        vec![Panel::new("y of the loop, and of the plant alone", Axis::linear("y", "unit of y"), outputs).with_rule(
            1.0,
            "command",
            RuleKind::Reference,
        )];
    if !controls.is_empty() {
        panels.push(Panel::new("u of the loop", Axis::linear("u", "unit of u"), controls));
    }
    let end = end.map_or_else(|| "unknown".to_owned(), three);
    Ok(("answer to a unit step", Axis::linear("time", "s"), panels, format!("The output ends at {end}.")))
}
