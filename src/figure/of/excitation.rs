//! An excitation signal: its course, its spectrum, its autocorrelation and its flatness.

use super::bode::Unreadable;
use super::document::{members, number, numbers};
use super::provenance::ReportOrigin;
use crate::analysis::{Analysis as _, Report, excitation_quality, registry};
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};

/// The names of the figures in addresses.
pub const SIGNAL: &str = "signal";
/// The power at the lines.
pub const SPECTRUM: &str = "spectrum";
/// The autocorrelation over the lag.
pub const AUTOCORRELATION: &str = "autocorrelation";
/// The flatness over the upper end of the band.
pub const FLATNESS: &str = "flatness";

/// A figure of an excitation by its name.
///
/// # Errors
/// [`Unreadable`] where the kind is no excitation's, or the report has nothing of that sort.
pub fn excitation(report: &Report, name: &str, subject: &str) -> Result<Figure, Unreadable> {
    if report.kind != excitation_quality::Plan::KIND {
        return Err(Unreadable::Kind { kind: report.kind.to_string() });
    }
    let (what, x, panels, description, caption) = match name {
        SPECTRUM => spectrum(report)?,
        AUTOCORRELATION => autocorrelation(report)?,
        FLATNESS => flatness(report)?,
        _ => signal(report)?,
    };
    let origin = ReportOrigin { subject: subject.to_owned() };
    Ok(Figure {
        name: name.to_owned(),
        title: format!("{subject}: {what}"),
        description,
        caption: format!("{caption} {}", origin.caption(report)).trim().to_owned(),
        sampling: String::new(),
        x,
        panels,
    })
}

type Found = (&'static str, Axis, Vec<Panel>, String, String);

fn signal(report: &Report) -> Result<Found, Unreadable> {
    let found = registry::samples(report)
        .ok_or_else(|| Unreadable::Nothing("the report has no samples; ask for them in the spec".to_owned()))?;
    let inks = [Ink::Command, Ink::Output, Ink::Control, Ink::Error];
    // What the device does is the output of its loop where that is known, and the signal itself elsewhere.
    let moved = if found.columns.iter().any(|(name, _)| name == "output") { "output" } else { "signal" };
    let limit = |name: &str| {
        let of = |quantity: &str| number(&report.provenance.spec, &format!("/limits/{quantity}"));
        if name == moved { of("position") } else { of("force").filter(|_| name == "force") }
    };
    let panel = |(at, (name, values)): (usize, &(String, Vec<f64>))| {
        let x = (0..values.len()).map(|i| i as f64 * found.sample_time_s).collect();
        let look = (Mark::Samples, inks[at % inks.len()], Weight::Thin);
        let line = Series::values(name.as_str(), look, x, values.iter().copied().map(Some));
        let panel = Panel::new("", Axis::linear(name.as_str(), "unit of the signal"), vec![line]);
        match limit(name) {
            Some(limit) => {
                panel.with_rule(limit, "limit of the device", RuleKind::Limit).with_rule(-limit, "", RuleKind::Limit)
            }
            None => panel,
        }
    };
    let panels = found.columns.iter().enumerate().map(panel).collect();
    let result = &report.result;
    let of = |pointer: &str| number(result, pointer).map_or_else(|| "unknown".to_owned(), three);
    let limits = ["position", "velocity", "acceleration", "force", "power"].into_iter().filter_map(|name| {
        let limit = number(&report.provenance.spec, &format!("/limits/{name}"))?;
        let peak = number(result, &format!("/motion/{name}/peak"))?;
        let side = if peak > limit { "above" } else { "within" };
        Some(format!(" The {name} reaches {}, {side} the limit of {}.", three(peak), three(limit)))
    });
    let description = format!(
        "{} samples, peak {}, root mean square {}, crest factor {}.{}",
        of("/signal/samples"),
        of("/signal/peak"),
        of("/signal/rms"),
        of("/signal/crest_factor"),
        limits.collect::<String>()
    );
    Ok(("the signal", Axis::linear("time", "s"), panels, description, String::new()))
}

fn spectrum(report: &Report) -> Result<Found, Unreadable> {
    let result = &report.result;
    let frequency = super::document::all_numbers(result, "/lines/frequency_hz")?;
    let of = |name: &str, pointer: &str, ink| -> Result<Option<Series>, Unreadable> {
        if result.pointer(pointer).is_none_or(serde_json::Value::is_null) {
            return Ok(None);
        }
        let power = numbers(result, pointer)?;
        Ok(Some(Series::values(name, (Mark::Points, ink, Weight::Thin), frequency.clone(), power).labelled()))
    };
    let all = [
        of("signal", "/lines/power", Ink::First)?,
        of("output", "/lines/output_power", Ink::Second)?,
        of("noise", "/lines/noise_power", Ink::Third)?,
    ];
    let panel = Panel::new("", Axis::logarithmic("power", "unit²"), all.into_iter().flatten().collect());
    let description = format!(
        "{} lines, {} Hz apart; the whole band's flatness is {}.",
        number(result, "/lines/count").map_or_else(|| "No".to_owned(), |count| format!("{count}")),
        number(result, "/lines/spacing_hz").map_or_else(|| "unknown".to_owned(), three),
        number(result, "/whole_band/sfm").map_or_else(|| "unknown".to_owned(), three)
    );
    let caption = "Powers are mean squares of the lines.".to_owned();
    Ok(("power at its lines", Axis::logarithmic("frequency", "Hz"), vec![panel], description, caption))
}

fn autocorrelation(report: &Report) -> Result<Found, Unreadable> {
    let result = &report.result;
    let lag = super::document::all_numbers(result, "/autocorrelation/lag_s")?;
    let value = numbers(result, "/autocorrelation/value")?;
    let line = Series::values("autocorrelation", (Mark::Line, Ink::First, Weight::Thin), lag, value);
    let panel =
        Panel::new("", Axis::linear("autocorrelation", "1"), vec![line]).with_rule(0.0, "", RuleKind::Reference);
    let side =
        number(result, "/autocorrelation/largest_sidelobe").zip(number(result, "/autocorrelation/sidelobe_lag_s"));
    let description = side.map_or_else(
        || "It has no sidelobe.".to_owned(),
        |(value, lag)| format!("The largest sidelobe is {} at a lag of {} s.", three(value), three(lag)),
    );
    Ok(("autocorrelation", Axis::linear("lag", "s"), vec![panel], description, String::new()))
}

/// A band by its upper end, with the flatness of the signal and of the output, the flatness gain, and the shares of the
/// power of signal and output that lie in it.
type Band = (f64, [Option<f64>; 5]);

fn flatness(report: &Report) -> Result<Found, Unreadable> {
    let mut bands: Vec<Band> = members(&report.result, "/flatness")
        .iter()
        .filter_map(|own| {
            let upper = number(own, "/band_hz/1").or_else(|| number(own, "/band_hz"))?;
            let of = ["/sfm", "/output_sfm", "/blsfg", "/energy_fraction", "/output_energy_fraction"];
            Some((upper, of.map(|pointer| number(own, pointer))))
        })
        .collect();
    if bands.is_empty() {
        return Err(Unreadable::Nothing("the report has no band".to_owned()));
    }
    bands.sort_by(|a, b| a.0.total_cmp(&b.0));
    let x: Vec<f64> = bands.iter().map(|band| band.0).collect();
    let points = |name: &str, ink, values: Vec<Option<f64>>| {
        Series::values(name, (Mark::Points, ink, Weight::Thick), x.clone(), values).labelled()
    };
    let of = |place: usize| bands.iter().map(|band| band.1[place]).collect::<Vec<_>>();
    let flat = vec![points("signal", Ink::First, of(0)), points("output", Ink::Second, of(1))];
    let mut panels = vec![Panel::new("", Axis::linear("spectral flatness", "1").including(&[0.0, 1.0]), flat)];
    let shares = vec![points("signal", Ink::First, of(3)), points("output", Ink::Second, of(4))];
    let gains: Vec<Option<f64>> = of(2);
    if gains.iter().any(Option::is_some) {
        let gain = points("gain", Ink::Third, gains);
        let panel = Panel::new("", Axis::linear("flatness gain", "1").including(&[0.0]), vec![gain]);
        panels.push(panel.with_rule(1.0, "as flat as the signal", RuleKind::Reference));
    }
    if shares.iter().any(|own| !own.is_empty()) {
        panels.push(Panel::new("", Axis::linear("share of the power", "1").including(&[0.0, 1.0]), shares));
    }
    let (upper, [sfm, ..]) = bands[bands.len() - 1];
    let description = format!(
        "Up to {} Hz the signal's flatness is {}; 1 is a flat spectrum.",
        three(upper),
        sfm.map_or_else(|| "unknown".to_owned(), three)
    );
    Ok(("flatness", Axis::linear("upper end of the band", "Hz").including(&[0.0]), panels, description, String::new()))
}
