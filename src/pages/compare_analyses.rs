//! Analyses side by side: what differs beyond its interval first, and in what they were asked differently.

use super::frame::Frame;
use super::layout::{Head, Place, card, page as whole};
use super::numbers::{count, eight, with_interval};
use super::svg::Drawn;
use super::trust::chip;
use crate::analysis::estimates::QuantityTrust;
use crate::analysis::ids::AnalysisId;
use crate::analysis::{Code, Problem, Report};
use crate::api::{ApiResult, AppState, QueryText, drawing, figures_of_analysis, report_text};
use crate::figure::of::overlay::overlay;
use crate::jobs::Status;
use crate::store::AnalysisRecord;
use axum::response::Response;
use maud::{Markup, html};
use serde_json::Value;
use std::collections::BTreeMap;

/// The parameters that name analyses, in their order.
const LETTERS: [&str; 6] = ["a", "b", "c", "d", "e", "f"];

/// The width of the figure, in pixels.
const WHOLE: u32 = 1160;

/// Letters of a value of a spec that are shown.
const MOST_LETTERS: usize = 120;

/// The analyses that an address names; empty where it names none.
///
/// # Errors
/// Of one alone, and of one twice.
pub(super) fn named(query: &mut QueryText) -> Result<Vec<AnalysisId>, Problem> {
    let mut all: Vec<AnalysisId> = Vec::new();
    for letter in LETTERS {
        if let Some(id) = query.id::<AnalysisId>(letter)? {
            if all.contains(&id) {
                return Err(Problem::new(Code::Malformed, "the same twice", format!("{id} is named twice"))
                    .at(format!("query parameter {letter}"))
                    .mend("Name another analysis."));
            }
            all.push(id);
        }
    }
    if all.len() == 1 {
        return Err(Problem::new(Code::Malformed, "one alone", "one analysis cannot be compared")
            .at("query parameter b")
            .mend("Name two to six analyses, as a, b, c and so on."));
    }
    Ok(all)
}

/// An analysis with what it found.
struct Column {
    letter: &'static str,
    record: AnalysisRecord,
    subject: String,
    quantities: Vec<QuantityTrust>,
}

/// The page.
pub(super) async fn page(frame: &Frame, state: &AppState, ids: &[AnalysisId]) -> ApiResult<Response> {
    let mut columns = Vec::new();
    let mut drawn = Vec::new();
    for (letter, id) in LETTERS.into_iter().zip(ids) {
        let record = state.store.analysis(*id).await?;
        let quantities = state.store.trust_of_analysis(*id).await?;
        let drawable = figures_of_analysis(state, &record).await?;
        let subject = drawable.subject().to_owned();
        if record.status == Status::Succeeded {
            drawn.push((letter.to_uppercase(), drawable, report_text(state, *id).await?));
        }
        columns.push(Column { letter, record, subject, quantities });
    }
    let figure = drawing(state, move || {
        let all: Vec<_> = drawn
            .into_iter()
            .filter_map(|(letter, drawable, text)| {
                let report: Report = serde_json::from_str(&text).ok()?;
                Some((letter, drawable.figures(&report)))
            })
            .collect();
        // The first figure that more than one of them has.
        let names = all.iter().flat_map(|(_, figures)| figures).map(|figure| figure.name.clone());
        let mut shared = names.filter_map(|name| {
            let of = |figures: &[crate::figure::Figure]| figures.iter().find(|own| own.name == name).cloned();
            overlay(&all.iter().filter_map(|(letter, own)| Some((letter.clone(), of(own)?))).collect::<Vec<_>>())
        });
        shared.next().map(|figure| Drawn::with_numbers(&figure, WHOLE))
    })
    .await?;
    let mut head = Head::new(Place::Queue, "Compare analyses");
    head.crumbs = vec![("Queue".into(), "/queue".into())];
    head.json = ids.first().map(|id| format!("/v1/analyses/{id}"));
    head.lead = html! { (count(columns.len() as u64, "analysis", "analyses")) " side by side" };
    let body = html! {
        @for warning in doubts(&columns) { section.card.problem role="note" { p { b { (warning) } } } }
        (card("What they found", &html! {}, &table(&columns)))
        (card("What was asked differently", &html! {}, &differences(&columns)))
        @if let Some(figure) = &figure { (figure.plain(&html! {})) }
    };
    Ok(whole(frame, &head, &body))
}

/// What makes a difference one of the method or of the plant, said before the numbers.
fn doubts(columns: &[Column]) -> Vec<String> {
    let differ = |of: &dyn Fn(&Column) -> String| columns.iter().any(|own| of(own) != of(&columns[0]));
    let mut found = Vec::new();
    if differ(&|own| own.record.kind.name().to_owned()) || differ(&|own| own.record.spec_sha256.clone()) {
        found.push("These were identified in different ways: a difference may come from the method.".to_owned());
    }
    if differ(&|own| own.record.request.inputs.get("plant").map_or_else(String::new, Value::to_string)) {
        found.push("These name different plants: a difference may come from the plant.".to_owned());
    }
    let open: Vec<String> = columns
        .iter()
        .filter(|own| own.record.status != Status::Succeeded)
        .map(|own| format!("{} is {}", own.letter.to_uppercase(), own.record.status.name()))
        .collect();
    if !open.is_empty() {
        found.push(format!("{}: there is nothing of it to compare.", open.join(", ")));
    }
    found
}

/// What a row is of: the place of the trial in the analysis, how it was estimated, and the quantity.
type Key = (usize, Option<&'static str>, String);

fn key(own: &QuantityTrust) -> Key {
    (own.position, own.estimator.map(crate::learning::Estimator::name), own.trust.quantity.clone())
}

/// Whether two of the values lie apart by more than their intervals.
fn differs(cells: &[Option<&QuantityTrust>]) -> bool {
    let ends: Vec<[f64; 2]> = cells.iter().flatten().filter_map(|own| own.interval_95).collect();
    ends.iter().enumerate().any(|(at, a)| ends[at + 1..].iter().any(|b| a[1] < b[0] || b[1] < a[0]))
}

fn table(columns: &[Column]) -> Markup {
    let mut rows: BTreeMap<Key, Vec<Option<&QuantityTrust>>> = BTreeMap::new();
    for (at, column) in columns.iter().enumerate() {
        for own in &column.quantities {
            rows.entry(key(own)).or_insert_with(|| vec![None; columns.len()])[at] = Some(own);
        }
    }
    let mut rows: Vec<(Key, Vec<Option<&QuantityTrust>>)> = rows.into_iter().collect();
    rows.sort_by_key(|(_, cells)| !differs(cells));
    let several = rows.iter().any(|((position, ..), _)| *position > 0);
    html! {
        @if rows.is_empty() {
            p { "None of them has a quantity that is judged; their figures and reports say what they found." }
        }
        p.muted {
            "Values with 95 % intervals. What lies apart by more than its intervals stands first, in bold; where a "
            "value has no interval nothing is said."
        }
        div.scroll tabindex="0" role="region" aria-label="Quantities by analysis" {
            table {
                caption.hidden { "Quantities by analysis" }
                thead { tr {
                    th scope="col" { "Quantity" }
                    @for Column { letter, record, subject, .. } in columns {
                        th scope="col" {
                            (letter.to_uppercase()) ": "
                            a href={ "/analyses/" (record.id) } { (record.kind.name()) }
                            br; (subject)
                        }
                    }
                } }
                tbody { @for ((position, estimator, quantity), cells) in &rows {
                    @let is_apart = differs(cells);
                    tr data-differs[is_apart] {
                        th scope="row" {
                            (quantity.replace('_', " "))
                            @if let Some(estimator) = estimator { span.muted { " · " (estimator.replace('_', " ")) } }
                            @if several { span.muted { " · trial " (position + 1) } }
                        }
                        @for cell in cells { td { (value(*cell, is_apart)) } }
                    }
                } }
            }
        }
    }
}

fn value(cell: Option<&QuantityTrust>, is_apart: bool) -> Markup {
    let Some(own) = cell else { return html! { "–" } };
    let written = own.value.map_or_else(|| "–".to_owned(), |value| with_interval(value, own.interval_95));
    html! {
        @if is_apart { b { (written) } } @else { (written) }
        " " (chip(own.trust.level, own.trust.level.words()))
    }
}

/// The members of a document by their place.
fn flat(value: &Value, at: &str, out: &mut BTreeMap<String, String>) {
    match value {
        Value::Object(fields) => fields.iter().for_each(|(name, own)| flat(own, &format!("{at}/{name}"), out)),
        other => {
            let text = other.to_string();
            let cut = text.char_indices().nth(MOST_LETTERS).map(|(end, _)| format!("{}…", &text[..end]));
            out.insert(at.to_owned(), cut.unwrap_or(text));
        }
    }
}

fn differences(columns: &[Column]) -> Markup {
    let all: Vec<BTreeMap<String, String>> = columns
        .iter()
        .map(|own| {
            let mut out = BTreeMap::from([("kind".to_owned(), own.record.kind.name().to_owned())]);
            flat(&own.record.request.inputs, "inputs", &mut out);
            flat(&own.record.request.spec, "spec", &mut out);
            out
        })
        .collect();
    let mut names: Vec<&String> = all.iter().flat_map(BTreeMap::keys).collect();
    names.sort_unstable();
    names.dedup();
    names.retain(|name| all.iter().any(|own| own.get(*name) != all[0].get(*name)));
    html! {
        @if names.is_empty() { p { "Nothing: the requests are equal." } } @else {
            div.scroll tabindex="0" role="region" aria-label="Differences of the requests" {
                table {
                    caption.hidden { "Members of the requests that differ" }
                    thead { tr { th scope="col" { "Member" } @for own in columns { th scope="col" {
                        (own.letter.to_uppercase()) " · spec " code { (eight(&own.record.spec_sha256)) }
                    } } } }
                    tbody { @for name in names { tr {
                        th scope="row" { code { (name) } }
                        @for own in &all { td { @match own.get(name) {
                            Some(text) => code { (text) },
                            None => "–",
                        } } }
                    } } }
                }
            }
        }
    }
}
