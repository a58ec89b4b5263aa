//! What a cost weighs.

use super::bode::Unreadable;
use super::document::{all_numbers, members, text, texts};
use super::provenance::ReportOrigin;
use crate::analysis::{Analysis as _, Report, inverse_lqg, inverse_lqr};
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, Series, Weight};
use serde_json::Value;

/// The name of the figure in addresses.
pub const NAME: &str = "cost";

/// The shares of the cost that states (Q) and inputs (R) have; `inputs` are those of the request, which name them.
///
/// # Errors
/// [`Unreadable`] where the kind has no cost, or no weights were found.
pub fn cost(report: &Report, inputs: &Value, subject: &str) -> Result<Figure, Unreadable> {
    let root = if report.kind == inverse_lqr::Plan::KIND {
        ""
    } else if report.kind == inverse_lqg::Plan::KIND {
        "/regulator"
    } else {
        return Err(Unreadable::Kind { kind: report.kind.to_string() });
    };
    let at = |pointer: &str| format!("{root}{pointer}");
    let result = &report.result;
    let reading = result.pointer(&at("/reading")).filter(|reading| !reading.is_null());
    let reading = reading.ok_or_else(|| Unreadable::Nothing("no weights make the gain optimal".to_owned()))?;
    let along = [
        ("trajectory_shares", "along the recorded trajectory"),
        ("stationary_shares", "under white noise on the inputs"),
    ];
    let found = along.into_iter().find(|(name, _)| reading.get(name).is_some_and(|own| !own.is_null()));
    let (states, ports, what) = match found {
        Some((name, what)) => {
            (all_numbers(reading, &format!("/{name}/states"))?, all_numbers(reading, &format!("/{name}/ports"))?, what)
        }
        None => (diagonal(reading, "/normalised_q")?, diagonal(reading, "/normalised_r")?, "of the diagonal weights"),
    };
    let named = |own: &str, letter: &str, count: usize| {
        let given = texts(inputs, own);
        if given.len() == count { given } else { (1..=count).map(|i| format!("{letter}{i}")).collect() }
    };
    let own_states: Vec<String> =
        members(reading, "/equivalents").iter().filter_map(|own| text(own, "/state").map(str::to_owned)).collect();
    let of_states =
        if own_states.len() == states.len() { own_states } else { named("/state_names", "x", states.len()) };
    let of_ports = named("/input_names", "u", ports.len());
    let columns = |name: &str, ink, first: usize, names: &[String], shares: &[f64]| {
        let x = (0..shares.len()).map(|i| (first + i) as f64).collect();
        let notes = names.iter().zip(shares).map(|(own, share)| format!("{name} · {own} · {} %", three(100.0 * share)));
        Series::values(name, (Mark::Columns, ink, Weight::Thick), x, shares.iter().map(|share| Some(100.0 * share)))
            .with_notes(notes.collect())
            .labelled()
    };
    let series = vec![
        columns("Q", Ink::First, 0, &of_states, &states),
        columns("R", Ink::Second, states.len(), &of_ports, &ports),
    ];
    let all: Vec<(&String, &f64)> = of_states.iter().zip(&states).chain(of_ports.iter().zip(&ports)).collect();
    let most = all.iter().max_by(|a, b| a.1.total_cmp(b.1));
    let verdict = text(result, &at("/verdict")).unwrap_or("unknown");
    let fitted = if result.pointer(&at("/q")).is_some_and(|q| !q.is_null()) { "" } else { " of the nearest fit" };
    let origin = ReportOrigin { subject: subject.to_owned() };
    Ok(Figure {
        name: NAME.to_owned(),
        title: format!("{subject}: what the cost weighs"),
        description: most.map_or_else(String::new, |(name, share)| {
            format!("{} has the largest share{fitted}, {} %; the verdict is {verdict}.", name, three(100.0 * *share))
        }),
        caption: format!(
            "Shares of the cost {what}: Q of the states, R of the inputs. No interval: the error of the gain is not \
             carried on. {}",
            origin.caption(report)
        ),
        sampling: String::new(),
        x: Axis::named("state or input", [of_states, of_ports].concat()),
        panels: vec![Panel::new("", Axis::linear("share", "%").including(&[0.0]), series)],
    })
}

/// The diagonal of a weight over the sum of its entries.
fn diagonal(reading: &Value, pointer: &str) -> Result<Vec<f64>, Unreadable> {
    let found = super::document::matrix(reading, pointer)?.diagonal();
    let sum = found.sum();
    Ok(found.iter().map(|own| if sum > 0.0 { own / sum } else { 0.0 }).collect())
}
