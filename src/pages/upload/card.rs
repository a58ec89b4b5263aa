//! A file of a draft: what was understood, to be changed; the picture; what was found.

use super::super::layout::card as in_card;
use super::super::problems;
use super::super::svg::Drawn;
use super::super::trust::chip;
use super::super::warnings;
use super::look::{Lab, Look, Outcome};
use super::settings::SIGNALS;
use crate::analysis::Problem;
use crate::analysis::ids::DraftId;
use crate::api::Preview;
use crate::figure::of::plant_check::plant_check;
use crate::figure::of::signals::signals;
use crate::figure::of::{TrialOrigin, Units};
use crate::figure::text::number;
use crate::trust::Level;
use maud::{Markup, html};

/// The width of a figure, in pixels.
const HALF: u32 = 560;

/// Files up to so many are drawn; of more, the one that is asked for.
const MOST_DRAWN: usize = 4;

/// Rows of the file that are shown.
const ROWS: usize = 5;

/// Which files are drawn.
pub(super) fn drawn(files: &[Look], show: Option<usize>) -> Vec<usize> {
    let read: Vec<usize> = (0..files.len()).filter(|place| matches!(files[*place].outcome, Outcome::Read(_))).collect();
    match show {
        Some(place) => vec![place],
        None if read.len() <= MOST_DRAWN => read,
        None => Vec::new(),
    }
}

/// The codes of people that fields offer.
pub(super) fn lists(lab: &Lab) -> Markup {
    html! {
        datalist #people { @for subject in &lab.subjects { option value=(subject.code) {} } }
    }
}

/// The card.
pub(super) fn file(id: DraftId, place: usize, look: &Look, lab: &Lab, units: &Units, is_drawn: bool) -> Markup {
    let found = if let Outcome::Read(found) = &look.outcome { Some(&**found) } else { None };
    let state = if !look.mend.is_empty() {
        chip(Level::DoNotUse, "must be mended")
    } else if look.same.is_some() && !look.will_be_stored() {
        chip(Level::NotIdentified, "stored already: left out")
    } else if !look.look.is_empty() {
        chip(Level::Read, "please look")
    } else {
        chip(Level::Ok, "checked")
    };
    let title = match (&look.code, look.number) {
        (Some(code), Some(number)) => format!("{} → {code}, trial {number}", look.name),
        _ => look.name.clone(),
    };
    in_card(
        &title,
        &state,
        &html! {
            @for problem in &look.mend { (refusal(problem)) }
            @if let Outcome::Refused { head } = &look.outcome {
                @if !head.is_empty() { details { summary { "How the file begins" } pre tabindex="0" { (head) } } }
            }
            @if let Some(found) = found { (understood(found)) }
            (fields(place, look, lab, found))
            @if let Some(found) = found {
                @if is_drawn { (pictures(look, lab, units, found)) } @else {
                    p { a href={ "/upload/" (id) "?show=" (place) } { "Draw its signals" } }
                }
            }
            (findings(look))
        },
    )
}

fn refusal(problem: &Problem) -> Markup {
    html! {
        div.refusal role="alert" {
            p { (chip(Level::DoNotUse, "must be mended")) " " b { (super::super::sentences::capital(&problem.title)) } }
            (problems::parts(&problem.detail, problem.location.as_deref(), problem.mend.as_deref()))
        }
    }
}

/// What the file was taken for, in words, with its first rows.
fn understood(found: &Preview) -> Markup {
    let trial = &found.new.trial;
    let columns: Vec<(&str, &str, Option<&str>)> =
        found.understood.columns.iter().map(|own| (own.signal, own.name.as_str(), own.unit.as_deref())).collect();
    let rows = trial.samples().min(ROWS);
    let value = |signal: &str, row: usize| {
        let own = &trial.signals;
        let column = match signal {
            "r" => Some(&own.command),
            "u" => Some(&own.control),
            "y" => Some(&own.output),
            "d" => own.disturbance.as_ref(),
            _ => own.time_s.as_ref(),
        };
        column.and_then(|values| values.get(row)).map_or_else(|| "–".to_owned(), |value| number(*value, 5))
    };
    html! {
        p { (found.understood.words.join(" ")) }
        div.scroll tabindex="0" role="region" aria-label="The first rows" {
            table {
                caption { "The first rows, as they were read" }
                thead { tr {
                    @for (signal, name, unit) in &columns {
                        th.number scope="col" { (signal) " ← " (name) @if let Some(unit) = unit { " (" (unit) ")" } }
                    }
                } }
                tbody { @for row in 0..rows { tr { @for (signal, ..) in &columns { td.number { (value(signal, row)) } }
                    } } }
            }
        }
    }
}

/// What can be said of the file, as it is now.
fn fields(place: usize, look: &Look, lab: &Lab, found: Option<&Preview>) -> Markup {
    let own = |name: &str| format!("{place}.{name}");
    let text = |name: &str| look.settings.text(name).unwrap_or_default();
    let guessed = |is: bool| html! { @if is { span.muted { " from the name “" (look.name) "”" } } };
    let code = look.code.as_deref().unwrap_or_default();
    let is_new = !code.is_empty() && lab.subjects.iter().all(|subject| subject.code != code);
    let as_number = |value: Option<i64>| value.map(|value| value.to_string()).unwrap_or_default();
    // Fields are filled with what was said or guessed; a number that the page chose itself is a hint.
    let said = |name: &str, guess: Option<i64>| {
        if text(name).is_empty() { as_number(guess) } else { text(name).to_owned() }
    };
    let taken = |signal: &str| {
        found
            .and_then(|found| found.understood.columns.iter().find(|own| own.signal == signal))
            .map(|own| own.name.as_str())
    };
    let all: Vec<&str> = found.map_or_else(Vec::new, |found| {
        let used = found.understood.columns.iter().map(|own| own.name.as_str());
        used.chain(found.ignored_columns.iter().map(String::as_str)).collect()
    });
    html! {
        div.row {
            label.check {
                input type="checkbox" name=(own("take")) value="yes"
                    checked[look.settings.takes().unwrap_or(look.same.is_none())];
                " Store it"
            }
            label { "Subject" (guessed(text("subject").is_empty() && look.guess.subject.is_some()))
                input type="text" name=(own("subject")) value=(code) list="people" autocomplete="off"; }
            @if is_new { label { "Group of the new subject" input type="text" name=(own("group")) value=(text("group"));
                } }
            label { "Plant"
                select name=(own("plant")) {
                    @if look.plant.is_none() { option value="" { "choose" } }
                    @for plant in &lab.plants {
                        option value=(plant.id) selected[look.plant == Some(plant.id)] { (plant.name) }
                    }
                }
            }
            label { "Trial" (guessed(text("number").is_empty() && look.guess.number.is_some()))
                input type="text" inputmode="numeric" name=(own("number")) value=(said("number", look.guess.number))
                    placeholder=(as_number(look.number)); }
            label { "Session" input type="text" inputmode="numeric" name=(own("session"))
                value=(said("session", look.guess.session)) placeholder="none"; }
        }
        details open[!look.mend.is_empty() && found.is_none()] {
            summary { "Columns and time" }
            div.row {
                @for (signal, what) in SIGNALS {
                    label { (signal) ", " (what)
                        input type="text" name=(own(signal)) value=(text(signal)) list={ "columns-" (place) }
                            placeholder=(taken(signal).unwrap_or(lacking(signal))); }
                }
                label { "Time counts"
                    select name=(own("time_unit")) {
                        option value="" { "as the file says, or s" }
                        @for unit in ["s", "ms", "us", "ns", "samples"]
                            { option value=(unit) selected[text("time_unit") == unit] { (unit) } }
                    }
                }
                label { "Sample time (s)" input type="text" inputmode="decimal" name=(own("sample_time_s"))
                    value=(text("sample_time_s"))
                    placeholder=(found.map(|found| found.new.trial.sample_time_s.to_string()).unwrap_or_default()); }
                label { "Uneven times"
                    select name=(own("resample")) {
                        option value="" { "are refused" }
                        option value="linear" selected[text("resample") == "linear"]
                            { "are brought to a grid, on straight lines" }
                    }
                }
            }
            datalist id={ "columns-" (place) } { @for name in &all { option value=(name) {} } }
            p.muted { "A column by its name, or by its position from 1. Empty: as it was understood." }
        }
    }
}

/// What is said of a signal that the file has not: time and disturbance may be missing.
fn lacking(signal: &str) -> &'static str {
    if ["t", "d"].contains(&signal) { "none" } else { "not found" }
}

fn pictures(look: &Look, lab: &Lab, units: &Units, found: &Preview) -> Markup {
    let plant = lab.plants.iter().find(|plant| Some(plant.id) == look.plant);
    let origin = TrialOrigin {
        subject: look.code.clone().unwrap_or_default(),
        number: look.number.unwrap_or_default(),
        session: look.session,
        plant: plant.map(|plant| plant.name.clone()).unwrap_or_default(),
        sha256: found.new.sha256.clone(),
        display_limit: lab.study.display_limit,
        units: units.clone(),
    };
    let trial = &found.new.trial;
    let check = plant.and_then(|plant| plant_check(trial, &plant.model, &origin));
    let all = [Some(signals(trial, &origin)), check];
    html! {
        div.pair { @for figure in all.iter().flatten() {
            div.figure { h3 { (figure.title) } (Drawn::new(figure, HALF, [None, None]).inside())
                @if figure.name == crate::figure::of::plant_check::NAME { p { b { (figure.description) } } } }
        } }
    }
}

/// What was found, in three groups; what must be mended stands at the top.
fn findings(look: &Look) -> Markup {
    html! {
        @if !look.look.is_empty() || !look.notes.is_empty() {
            p { (chip(Level::Read, "please look")) }
            ul.plain { @for note in &look.notes { li { (note) } } }
            (warnings::list(&look.look))
        }
        @if !look.checked.is_empty() {
            p { (chip(Level::Ok, "checked")) }
            ul.plain { @for note in &look.checked { li { (super::super::sentences::capital(note)) "." } } }
        }
    }
}
