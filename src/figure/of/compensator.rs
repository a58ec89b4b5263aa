//! The flatness gain of compensators.

use super::bode::Unreadable;
use super::document::{all_numbers, members, number, numbers};
use super::provenance::ReportOrigin;
use crate::analysis::{Analysis as _, Report, compensator_design};
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};

/// The name of the figure in addresses.
pub const NAME: &str = "compensator";

/// The flatness gain over the gain K, a line for each pair of corners of the sweep, the answer ringed; where the loop
/// is not stable there is no line.
///
/// # Errors
/// [`Unreadable`] where the kind is no compensator's, or the spec asked for no sweep.
pub fn compensator(report: &Report, subject: &str) -> Result<Figure, Unreadable> {
    if report.kind != compensator_design::Plan::KIND {
        return Err(Unreadable::Kind { kind: report.kind.to_string() });
    }
    let result = &report.result;
    let sweep = members(result, "/sweep");
    if sweep.is_empty() {
        return Err(Unreadable::Nothing("the spec asked for no sweep; ask with sweep".to_owned()));
    }
    let (mut series, mut resonances, mut disturbances) = (Vec::new(), Vec::new(), Vec::new());
    for (at, curve) in sweep.iter().enumerate() {
        let name = match (number(curve, "/zero_hz"), number(curve, "/pole_hz")) {
            (Some(zero), Some(pole)) => format!("zero {} pole {} Hz", three(zero), three(pole)),
            _ => "proportional".to_owned(),
        };
        let look = (Mark::Line, Ink::of_group(at % 4), Weight::Thin);
        let gain = all_numbers(curve, "/gain")?;
        let flatness = numbers(curve, "/blsfg")?;
        // Disturbances are judged where the loop makes the signal flatter: those parts are strong.
        let norm = numbers(curve, "/disturbance_norm")?;
        let strong = norm.iter().zip(&flatness).map(|(norm, own)| norm.filter(|_| own.is_some_and(|own| own > 1.0)));
        let resonance = numbers(curve, "/resonance_hz")?;
        let faint = (Mark::Line, Ink::of_group(at % 4), Weight::Faint);
        let thick = (Mark::Line, Ink::of_group(at % 4), Weight::Thick);
        resonances.push(Series::values(name.as_str(), look, gain.clone(), resonance));
        disturbances.push(Series::values(name.as_str(), faint, gain.clone(), norm.iter().copied()));
        disturbances.push(Series::values(format!("{name}, flatness gain above 1"), thick, gain.clone(), strong));
        series.push(Series::values(name, look, gain, flatness).labelled());
    }
    let answer = number(result, "/gain").zip(number(result, "/blsfg"));
    if let Some((gain, flatness)) = answer {
        let look = (Mark::Rings, Ink::Fourth, Weight::Thick);
        series.push(Series::values("answer", look, vec![gain], [Some(flatness)]));
    }
    let base = number(result, "/proportional/blsfg");
    let mut panel = Panel::new("", Axis::linear("flatness gain", "1").including(&[0.0]), series);
    if let Some(base) = base {
        panel = panel.with_rule(base, "best proportional control", RuleKind::Reference);
    }
    let mut panels = vec![panel];
    if resonances.iter().any(|own| !own.is_empty()) {
        panels.push(Panel::new("", Axis::linear("resonance", "Hz").including(&[0.0]), resonances));
    }
    if disturbances.iter().any(|own| !own.is_empty()) {
        panels.push(Panel::new("", Axis::logarithmic("‖S P‖∞", "m/N"), disturbances));
    }
    let finding = answer.map_or_else(String::new, |(gain, flatness)| {
        let more = base.filter(|base| *base > 0.0).map_or_else(String::new, |base| {
            format!(", {} times that of the best proportional control", three(flatness / base))
        });
        format!("The answer has K = {} and a flatness gain of {}{more}.", three(gain), three(flatness))
    });
    let origin = ReportOrigin { subject: subject.to_owned() };
    Ok(Figure {
        name: NAME.to_owned(),
        title: format!("{subject}: flatness gain over the gain"),
        description: finding,
        caption: format!(
            "Lines end where the loop is not stable; ring: the answer; ‖S P‖∞ is how far a force moves the output at \
             worst, strong where the flatness gain is above 1. {}",
            origin.caption(report)
        ),
        sampling: String::new(),
        x: Axis::logarithmic("K", "N/m"),
        panels,
    })
}
