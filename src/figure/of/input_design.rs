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
/// How much better the experiment became with every step.
pub const IMPROVEMENT: &str = "improvement";
/// What the model's outputs do, with their limits.
pub const OUTPUTS: &str = "outputs";
/// The autocorrelation of the inputs, with its limits.
pub const AUTOCORRELATION: &str = "autocorrelation";

/// The input, before pale and after dark; what each parameter's standard deviation becomes; how the design went; the
/// outputs and the autocorrelation with their limits (Priess 2015, figures 5.6 and 5.7).
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
    match name {
        DEVIATIONS => return deviations(report, &factor, &origin),
        IMPROVEMENT => return improvement(report, &factor, &origin),
        OUTPUTS => return outputs(report, &origin),
        AUTOCORRELATION => return autocorrelation(report, &origin),
        _ => {}
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

/// The factor over the steps of the best climb.
fn improvement(report: &Report, factor: &str, origin: &ReportOrigin) -> Result<Figure, Unreadable> {
    let history = all_numbers(&report.result, "/history")?;
    let x: Vec<f64> = (1..=history.len()).map(|step| step as f64).collect();
    let look = (Mark::Line, Ink::First, Weight::Thick);
    let line = Series::values("factor", look, x, history.iter().copied().map(Some));
    let axis = Axis::linear("better than the start by", "1").including(&[0.0, 1.0]);
    Ok(Figure {
        name: IMPROVEMENT.to_owned(),
        title: format!("{}: how the design went", origin.subject),
        description: format!("After {} steps the experiment is better by a factor of {factor}.", history.len()),
        caption: format!("The best of the climbs. {}", origin.caption(report)),
        sampling: String::new(),
        x: Axis::linear("step", "").including(&[0.0]),
        panels: vec![Panel::new("", axis, vec![line]).with_rule(1.0, "as the start", RuleKind::Reference)],
    })
}

/// Values before, wide and pale, under values after.
fn pair(x: &[f64], mark: Mark, before: Vec<f64>, after: Vec<f64>) -> Vec<Series> {
    let line = |name: &str, ink, weight, values: Vec<f64>| {
        Series::values(name, (mark, ink, weight), x.to_vec(), values.into_iter().map(Some))
    };
    vec![line("before", Ink::Command, Weight::Wide, before), line("after", Ink::First, Weight::Thin, after)]
}

fn outputs(report: &Report, origin: &ReportOrigin) -> Result<Figure, Unreadable> {
    let result = &report.result;
    let step = number(result, "/sample_time_s").ok_or_else(|| Unreadable::Form("it has no sample time".to_owned()))?;
    let mut panels = Vec::new();
    let mut findings = Vec::new();
    for course in members(result, "/courses") {
        let name = text(course, "/name").unwrap_or("output");
        let (before, after) = (all_numbers(course, "/before")?, all_numbers(course, "/after")?);
        let x: Vec<f64> = (0..after.len()).map(|k| k as f64 * step).collect();
        let peak = after.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        let mut panel = Panel::new(
            format!("{name}, before (wide) and after (thin)"),
            Axis::linear(name, "unit of the output"),
            pair(&x, Mark::Samples, before, after),
        );
        let ends = ["/range/0", "/range/1"].map(|end| number(course, end));
        for at in ends.into_iter().flatten() {
            panel = panel.with_rule(at, "limit", RuleKind::Limit);
        }
        let limit = ends[1].map_or_else(String::new, |limit| format!(" of {} allowed", three(limit)));
        findings.push(format!("{name} reaches {}{limit}.", three(peak)));
        panels.push(panel);
    }
    if panels.is_empty() {
        return Err(Unreadable::Nothing("a design of an earlier version has no outputs; ask for it again".to_owned()));
    }
    Ok(Figure {
        name: OUTPUTS.to_owned(),
        title: format!("{}: outputs before and after", origin.subject),
        description: findings.join(" "),
        caption: format!("Simulated by the recursion of the model, without noise. {}", origin.caption(report)),
        sampling: String::new(),
        x: Axis::linear("time", "s"),
        panels,
    })
}

fn autocorrelation(report: &Report, origin: &ReportOrigin) -> Result<Figure, Unreadable> {
    let result = &report.result;
    let of = |name: &str| all_numbers(result, &format!("/autocorrelation/{name}"));
    let none = || Unreadable::Nothing("the spec does not limit the autocorrelation".to_owned());
    let tolerance = number(result, "/autocorrelation/tolerance").ok_or_else(none)?;
    let lag = of("lag")?;
    let (before, after, reference) = (of("before")?, of("after")?, of("reference")?);
    let far = after.iter().zip(&reference).map(|(value, wanted)| (value - wanted).abs()).fold(0.0, f64::max);
    let ends = reference.iter().map(|wanted| Some([wanted - tolerance, wanted + tolerance]));
    let band = Series::intervals("allowed", (Mark::Band, Ink::Muted, Weight::Thin), lag.clone(), ends);
    let mut series = vec![band];
    series.extend(pair(&lag, Mark::Line, before, after));
    let panel =
        Panel::new("before (wide) and after (thin); shaded: allowed", Axis::linear("autocorrelation", "1"), series);
    Ok(Figure {
        name: AUTOCORRELATION.to_owned(),
        title: format!("{}: autocorrelation before and after", origin.subject),
        description: format!(
            "After the design it is at most {} from what it is to stay near to; {} is allowed.",
            three(far),
            three(tolerance)
        ),
        caption: origin.caption(report),
        sampling: String::new(),
        x: Axis::linear("lag", "samples"),
        panels: vec![panel.with_rule(0.0, "", RuleKind::Reference)],
    })
}
