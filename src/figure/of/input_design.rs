//! An input design before and after.

use super::bode::Unreadable;
use super::document::{all_numbers, members, number, text};
use super::provenance::ReportOrigin;
use crate::analysis::{Analysis as _, Report, input_design as kind};
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};

/// The names of the figures in addresses.
pub const INPUT: &str = "input";
/// Standard deviations after over before.
pub const DEVIATIONS: &str = "deviations";

/// The input, before pale and after dark; or what each parameter's standard deviation becomes.
///
/// # Errors
/// [`Unreadable`] where the kind is no input design's, or the report is of a form that this version does not know.
pub fn input_design(report: &Report, name: &str, subject: &str) -> Result<Figure, Unreadable> {
    if report.kind != kind::Plan::KIND {
        return Err(Unreadable::Kind { kind: report.kind.to_string() });
    }
    let result = &report.result;
    let origin = ReportOrigin { subject: subject.to_owned() };
    let factor = number(result, "/factor").map_or_else(|| "unknown".to_owned(), three);
    if name == DEVIATIONS {
        return deviations(report, &factor, &origin);
    }
    let step = number(result, "/sample_time_s").ok_or_else(|| Unreadable::Form("it has no sample time".to_owned()))?;
    let (before, after) = (all_numbers(result, "/start_input")?, all_numbers(result, "/input")?);
    let line = |name: &str, ink, weight, values: Vec<f64>| {
        let x = (0..values.len()).map(|i| i as f64 * step).collect();
        Series::values(name, (Mark::Samples, ink, weight), x, values.into_iter().map(Some))
    };
    let mut panel = Panel::new(
        "before (wide) and after (thin)",
        Axis::linear("input", "unit of the input"),
        vec![line("before", Ink::Command, Weight::Wide, before), line("after", Ink::First, Weight::Thin, after)],
    );
    let limit = members(result, "/limits").iter().find(|own| text(own, "/name") == Some("input"));
    for end in ["/range/0", "/range/1"] {
        if let Some(at) = limit.and_then(|own| number(own, end)) {
            panel = panel.with_rule(at, "limit", RuleKind::Limit);
        }
    }
    Ok(Figure {
        name: INPUT.to_owned(),
        title: format!("{subject}: input before and after"),
        description: format!("The experiment is better by a factor of {factor} after the design."),
        caption: format!("Each sample is held until the next. {}", origin.caption(report)),
        sampling: String::new(),
        x: Axis::linear("time", "s"),
        panels: vec![panel],
    })
}

fn deviations(report: &Report, factor: &str, origin: &ReportOrigin) -> Result<Figure, Unreadable> {
    let parameters = members(&report.result, "/parameters");
    let names: Vec<String> = parameters.iter().filter_map(|own| text(own, "/name").map(str::to_owned)).collect();
    let ratios: Vec<Option<f64>> = parameters
        .iter()
        .map(|own| {
            let [before, after] = ["/standard_deviation/0", "/standard_deviation/1"].map(|end| number(own, end));
            before.zip(after).map(|(before, after)| after / before)
        })
        .collect();
    if names.is_empty() || names.len() != ratios.len() {
        return Err(Unreadable::Form("it has no parameters".to_owned()));
    }
    let x: Vec<f64> = (0..names.len()).map(|i| i as f64).collect();
    let notes = names
        .iter()
        .zip(&ratios)
        .map(|(name, ratio)| format!("{name} · {}", ratio.map_or_else(|| "not determined".to_owned(), three)));
    let look = (Mark::Columns, Ink::First, Weight::Thick);
    let columns = Series::values("σ after / before", look, x, ratios.iter().copied()).with_notes(notes.collect());
    let panel = Panel::new("", Axis::linear("σ after / before", "1").including(&[0.0, 1.0]), vec![columns]).with_rule(
        1.0,
        "as before",
        RuleKind::Reference,
    );
    let worst = names.iter().zip(&ratios).filter_map(|(name, ratio)| Some((name, (*ratio)?)));
    let worst = worst.max_by(|a, b| a.1.total_cmp(&b.1));
    let finding = worst.map_or_else(
        || "No parameter is determined with both inputs.".to_owned(),
        |(name, ratio)| format!("{name} gains least: its standard deviation becomes {} of what it was.", three(ratio)),
    );
    Ok(Figure {
        name: DEVIATIONS.to_owned(),
        title: format!("{}: standard deviations after over before", origin.subject),
        description: format!("{finding} The experiment is better by a factor of {factor}."),
        caption: format!("Bounds of Cramér and Rao. {}", origin.caption(report)),
        sampling: String::new(),
        x: Axis::named("parameter", names),
        panels: vec![panel],
    })
}
