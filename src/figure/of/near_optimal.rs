//! The candidates that fit nearly as well as the best one.

use super::bode::{Unreadable, result};
use super::provenance::ReportOrigin;
use crate::analysis::ssid::SsidResult;
use crate::analysis::{Analysis as _, Report, ssid};
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, Series, Weight};
use crate::trust::CONSTANTS;

/// The name of the figure in addresses.
pub const NAME: &str = "near_optimal";

/// ‖Gfb‖ and ‖Gff G − 1‖ of each candidate over its cost, the chosen one ringed.
///
/// # Errors
/// [`Unreadable`] where the kind has none, or the report is of a form that this version does not know.
pub fn near_optimal(report: &Report, subject: &str) -> Result<Figure, Unreadable> {
    if report.kind != ssid::Plan::KIND {
        return Err(Unreadable::Kind { kind: report.kind.to_string() });
    }
    let found: SsidResult = result(report)?;
    let mut family = found.near_optimal.family.clone();
    if family.is_empty() {
        return Err(Unreadable::Nothing("the report lists no candidates".to_owned()));
    }
    // In pools that hold the data exactly the smallest cost is rounding: then the places count.
    let is_cost = found.cost > found.near_optimal.rounding;
    family.sort_by(|a, b| a.cost.total_cmp(&b.cost).then(a.index.cmp(&b.index)));
    let place = |(at, cost): (usize, f64)| if is_cost { cost / found.cost } else { at as f64 + 1.0 };
    let x: Vec<f64> = family.iter().map(|own| own.cost).enumerate().map(place).collect();
    let chosen = family.iter().position(|own| own.index == found.certificate.index);
    let panel = |symbol: &str, unit: &str, values: Vec<Option<f64>>| {
        let notes = family.iter().zip(&values).map(|(own, value)| {
            let value = value.map_or_else(|| "infinite".to_owned(), three);
            format!("candidate {} · J {} · {symbol} {value}", own.index, three(own.cost))
        });
        let look = (Mark::Points, Ink::First, Weight::Thin);
        let ring = chosen.map(|at| (vec![x[at]], [values[at]]));
        let dots = Series::values("candidates", look, x.clone(), values.iter().copied()).with_notes(notes.collect());
        let mut series = vec![dots];
        series.extend(ring.map(|(x, y)| Series::values("chosen", (Mark::Rings, Ink::Second, Weight::Thick), x, y)));
        Panel::new("", Axis::linear(symbol, unit).including(&[0.0]), series)
    };
    let panels = vec![
        panel("‖Gfb‖", "unit of u / unit of y", family.iter().map(|own| own.norm_feedback).collect()),
        panel("‖Gff G − 1‖", "1", family.iter().map(|own| own.norm_feedforward_plant_minus_one).collect()),
    ];
    let spread = &found.near_optimal.spread;
    let range = |name: &str, ends: Option<[f64; 2]>| {
        ends.map_or_else(
            || format!("{name} is infinite for some"),
            |[low, high]| {
                let word = if high > CONSTANTS.spread_do_not_use * low { ", which tells it hardly at all" } else { "" };
                format!("{name} runs from {} to {}{word}", three(low), three(high))
            },
        )
    };
    let count = found.near_optimal.count;
    let origin = ReportOrigin { subject: subject.to_owned() };
    Ok(Figure {
        name: NAME.to_owned(),
        title: format!("{subject}: candidates that fit nearly as well"),
        description: format!(
            "{count} of {} candidates fit within {} % of the best: {}; {}.",
            found.certificate.pool_size,
            three(100.0 * found.near_optimal.within),
            range("‖Gfb‖", spread.norm_feedback),
            range("‖Gff G − 1‖", spread.norm_feedforward_plant_minus_one)
        ),
        caption: format!(
            "Dots: {} of these candidates; ring: the one chosen. {}",
            family.len(),
            origin.caption(report)
        ),
        sampling: String::new(),
        x: if is_cost { Axis::linear("J / least J", "1") } else { Axis::linear("place by cost", "") },
        panels,
    })
}
