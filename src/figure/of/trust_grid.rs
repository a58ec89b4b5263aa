//! How far a quantity of every trial of a study may be used: subjects down, trials across.

use super::learning_curves::phrase;
use super::places::trial;
use super::provenance::{eight, product};
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, Series, Weight};
use crate::learning::curves::Metric;
use crate::learning::trust_grid::{StudyTrust, TrustCounts, TrustGridRow};
use crate::trust::{Level, advice};
use std::collections::{BTreeMap, BTreeSet};

/// The name of the figure in addresses.
pub const NAME: &str = "trust";

/// A trial's session and number.
type Key = (Option<i64>, i64);

/// The grid of a quantity: a panel for each group on each plant, a cell for each trial with sign and value.
#[must_use]
pub fn trust_grid(trust: &StudyTrust) -> Figure {
    let metric = Metric::ALL.into_iter().find(|metric| metric.name() == trust.quantity);
    let what = metric.map_or_else(|| trust.quantity.clone(), |own| phrase(own).to_owned());
    let keys: BTreeSet<Key> =
        trust.rows.iter().flat_map(|row| &row.trials).map(|cell| (cell.session, cell.number)).collect();
    let keys: Vec<Key> = keys.into_iter().collect();
    let several = keys.iter().any(|(session, _)| *session != keys.first().and_then(|first| first.0));
    let name = |(session, number): &Key| match session {
        Some(session) if several => format!("{session}·{number}"),
        _ => number.to_string(),
    };
    let x = Axis::named(if several { "session · trial" } else { "trial" }, keys.iter().map(name).collect());
    let mut groups: BTreeMap<(Option<&str>, &str), Vec<&TrustGridRow>> = BTreeMap::new();
    for row in &trust.rows {
        groups.entry((row.group.as_deref(), &row.plant.name)).or_default().push(row);
    }
    let panels: Vec<Panel> = groups.iter().map(|(name, rows)| panel(*name, rows, &keys)).collect();
    let TrustCounts { not_identified, ok, read, do_not_use } = trust.counts;
    let all = not_identified + ok + read + do_not_use;
    let mut description = format!(
        "{what}: {do_not_use} of {all} values are not to be used, {read} to be read, {ok} ok, {not_identified} not \
         identified."
    );
    if let Some((code, count)) = gravest(trust) {
        description.push_str(&format!(" Most often ({count}) because of {code}. {}", advice(code)));
    }
    let estimator = trust.estimator.map_or_else(|| "measured in time".to_owned(), |own| own.name().to_owned());
    let spec = trust.spec.as_ref().map_or_else(String::new, |spec| format!(", spec {}", eight(&spec.spec_sha256)));
    Figure {
        name: NAME.to_owned(),
        title: format!("How far {what} may be used"),
        description,
        caption: format!(
            "✓ ok, ! read the warnings, ✕ do not use, · not identified; the number is the value. {estimator}{spec}; \
             rule {}; {}.",
            trust.rule,
            product()
        ),
        sampling: String::new(),
        x,
        panels,
    }
}

/// The code that most of the values that are not to be used have.
fn gravest(trust: &StudyTrust) -> Option<(&str, usize)> {
    let mut codes: BTreeMap<&str, usize> = BTreeMap::new();
    let cells = trust.rows.iter().flat_map(|row| &row.trials);
    for cell in cells.filter(|cell| cell.trust.level == Level::DoNotUse) {
        *codes.entry(&cell.trust.code).or_default() += 1;
    }
    codes.into_iter().max_by_key(|(code, count)| (*count, std::cmp::Reverse(*code)))
}

fn panel((group, plant): (Option<&str>, &str), rows: &[&TrustGridRow], keys: &[Key]) -> Panel {
    // The first subject stands at the top.
    let y = Axis::named("subject", rows.iter().rev().map(|row| row.code.clone()).collect());
    let series = rows.iter().enumerate().map(|(at, row)| {
        let level = (rows.len() - 1 - at) as f64;
        let place = |key: Key| keys.iter().position(|own| *own == key).unwrap_or_default() as f64;
        let text = |value: Option<f64>, level: Level| {
            value.map_or_else(|| level.sign().to_owned(), |value| format!("{} {}", level.sign(), three(value)))
        };
        let cells = &row.trials;
        let notes = cells.iter().map(|cell| {
            let value = cell.value.map_or_else(|| "no value".to_owned(), three);
            let because = &cell.trust.because;
            let trial = trial(cell.session, cell.number);
            format!("{} · {trial} · {value} · {}: {because}", row.code, cell.trust.level.words())
        });
        let x = cells.iter().map(|cell| place((cell.session, cell.number))).collect();
        Series::values(row.code.as_str(), (Mark::Cells, Ink::Muted, Weight::Thin), x, cells.iter().map(|_| Some(level)))
            .with_notes(notes.collect())
            .with_texts(cells.iter().map(|cell| text(cell.value, cell.trust.level)).collect())
            .with_trust(cells.iter().map(|cell| cell.trust.level).collect())
    });
    let title = format!("{} on {plant}", group.unwrap_or("without a group"));
    Panel::new(title, y, series.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_trial_has_a_cell_with_its_value_and_level() {
        let cell = |number: i64, value: Option<f64>, level: &str, code: &str| {
            json!({"trial": format!("t{number}"), "number": number, "session": null, "analysis": "a", "value": value,
                "interval_95": null, "quantity": "norm_feedback", "level": level, "code": code, "because": "so",
                "do": "", "also": []})
        };
        let plant = json!({"id": "p", "name": "lag"});
        let row = |code: &str, trials: Vec<serde_json::Value>| {
            json!({"subject": code, "code": code, "group": "g",
            "plant": plant, "trials": trials})
        };
        let rows = vec![
            row("B", vec![cell(40, Some(0.5), "do_not_use", "spread_too_wide"), cell(1, Some(1.5), "ok", "ok")]),
            row("A", vec![cell(5, None, "not_identified", "not_identified")]),
        ];
        let rows = serde_json::from_value(serde_json::Value::from(rows)).unwrap();
        let trust = StudyTrust::new("norm_feedback", None, None, rows);
        let figure = trust_grid(&trust);
        assert_eq!(figure.x.names, ["1", "5", "40"]);
        assert_eq!(figure.panels[0].y.names, ["B", "A"], "the first at the top");
        let [a, b] = [0, 1].map(|at| &figure.panels[0].series[at]);
        assert_eq!((a.x.as_slice(), a.y.as_slice(), a.texts[0].as_str()), (&[1.0][..], &[Some(1.0)][..], "·"));
        assert_eq!(
            (b.x.as_slice(), b.texts.as_slice()),
            (&[0.0, 2.0][..], &["✓ 1.50".into(), "✕ 0.500".to_owned()][..])
        );
        assert_eq!(b.trust, [Level::Ok, Level::DoNotUse]);
        let expected = "‖Gfb‖: 1 of 3 values are not to be used, 0 to be read, 1 ok, 1 not identified. Most often (1) \
                        because of spread_too_wide.";
        assert!(figure.description.starts_with(expected), "{}", figure.description);
    }
}
