//! Poles of the controllers and of the closed loop.

use super::bode::{Unreadable, result};
use super::provenance::ReportOrigin;
use crate::analysis::ssid::SsidResult;
use crate::analysis::{Analysis as _, Report, ssid};
use crate::control::Model;
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};

/// The name of the figure in addresses.
pub const NAME: &str = "poles";

/// Points of each half of a circle.
const HALF: usize = 90;

/// Open poles × of plant and controllers, closed ones +, with the border of stability and the margin.
///
/// # Errors
/// [`Unreadable`] where the kind has none, or the report is of a form that this version does not know.
pub fn poles(report: &Report, subject: &str) -> Result<Figure, Unreadable> {
    if report.kind != ssid::Plan::KIND {
        return Err(Unreadable::Kind { kind: report.kind.to_string() });
    }
    let found: SsidResult = result(report)?;
    let sample_time_s = found.feedback.check().ok().and_then(|system| system.sample_time_s());
    let unit = if sample_time_s.is_some() { "1" } else { "1/s" };
    let mut series = Vec::new();
    let mut borders = Vec::new();
    match sample_time_s {
        Some(period) => {
            series.extend(circle("unit circle", 1.0, Weight::Thin));
            let margin = (-found.stability.margin_per_s * period).exp();
            if margin < 1.0 {
                series.extend(circle("stability margin", margin, Weight::Faint));
            }
        }
        None => {
            borders.push((0.0, "border of stability"));
            if found.stability.margin_per_s > 0.0 {
                borders.push((-found.stability.margin_per_s, "margin"));
            }
        }
    }
    for (name, model, ink) in [
        ("poles of the plant", &found.plant, Ink::Muted),
        ("poles of Gff", &found.feedforward, Ink::First),
        ("poles of Gfb", &found.feedback, Ink::Second),
    ] {
        series.push(marks(name, Mark::Times, ink, open(model)?).labelled());
    }
    let closed = found.closed_loop_poles.clone();
    series.push(marks("closed loop", Mark::Plus, Ink::Third, closed).labelled());
    let mut panel = Panel::new("", Axis::linear("Im", unit).including(&[0.0]), series);
    for (at, label) in borders {
        panel = panel.with_rule(at, label, RuleKind::Border);
    }
    let slowest = match (found.stability.largest_exponent_per_s, found.stability.spectral_radius) {
        (Some(exponent), _) => {
            format!("The slowest mode of the loop decays with {} per second", three(-exponent))
        }
        (None, Some(radius)) => format!("The largest closed-loop pole has the modulus {}", three(radius)),
        (None, None) => "The loop has no poles".to_owned(),
    };
    let origin = ReportOrigin { subject: subject.to_owned() };
    Ok(Figure {
        name: NAME.to_owned(),
        title: format!("{subject}: poles"),
        description: format!("{slowest}; the margin asked for is {} per second.", three(found.stability.margin_per_s)),
        caption: format!(
            "×: poles of plant and controllers; +: of the closed loop. The axes differ in scale. {}",
            origin.caption(report)
        ),
        sampling: String::new(),
        x: Axis::linear("Re", unit).including(&[0.0]),
        panels: vec![panel],
    })
}

fn open(model: &Model) -> Result<Vec<[f64; 2]>, Unreadable> {
    let system = model.check().map_err(|error| Unreadable::Form(error.to_string()))?;
    let found = system.poles().map_err(|error| Unreadable::Nothing(error.to_string()))?;
    Ok(found.iter().map(|pole| [pole.re, pole.im]).collect())
}

fn marks(name: &str, mark: Mark, ink: Ink, mut poles: Vec<[f64; 2]>) -> Series {
    poles.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let notes = poles.iter().map(|[re, im]| format!("{name} · {} {} {}j", three(*re), sign(*im), three(im.abs())));
    let notes = notes.collect();
    let (x, y): (Vec<f64>, Vec<f64>) = poles.into_iter().map(|[re, im]| (re, im)).unzip();
    Series::values(name, (mark, ink, Weight::Thin), x, y.into_iter().map(Some)).with_notes(notes)
}

fn sign(value: f64) -> &'static str {
    if value < 0.0 { "−" } else { "+" }
}

/// The upper and the lower half of a circle around zero.
fn circle(name: &str, radius: f64, weight: Weight) -> [Series; 2] {
    [1.0, -1.0].map(|side| {
        let angles = (0..=HALF).map(|i| std::f64::consts::PI * (1.0 - i as f64 / HALF as f64));
        let (x, y): (Vec<f64>, Vec<f64>) = angles.map(|a| (radius * a.cos(), side * radius * a.sin())).unzip();
        Series::values(name, (Mark::Line, Ink::Muted, weight), x, y.into_iter().map(Some))
    })
}
