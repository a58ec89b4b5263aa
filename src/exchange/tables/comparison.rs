//! The comparison of a study's groups as a table.

use super::{Record, Table, word};
use crate::learning::comparison::report::ComparedGroup;
use crate::learning::{StatementTrust, StudyComparison};

/// The columns that every row has.
const COLUMNS: &[&str] = &[
    "of",
    "group",
    "against",
    "plant",
    "against_plant",
    "metric",
    "contrast",
    "session_from",
    "session_to",
    "people",
    "against_people",
    "value",
    "standard_error",
    "low",
    "high",
    "p",
    "p_adjusted",
    "hedges_g",
    "no_value",
    "trust",
    "do_not_use",
];

fn begin(of: &str, group: &ComparedGroup, against: Option<&ComparedGroup>, trust: &StatementTrust) -> Record {
    Record::default()
        .with("of", of)
        .with("group", group.group.clone())
        .with("against", against.and_then(|other| other.group.clone()))
        .with("plant", group.plant.name.as_str())
        .with("against_plant", against.map(|other| other.plant.name.clone()))
        .with("trust", word(&trust.mean.level))
        .with("do_not_use", trust.mean.do_not_use)
}

/// A comparison: a row for each mean of a group (`of` is `group`), each person's own value (`person`) and each
/// difference between groups (`difference`: `group` less `against`), by metric and contrast.
///
/// Of a difference the interval and p are those of the exact permutation of people; where that gives no interval, the
/// ends are those of the difference of the two means.
#[must_use]
pub fn of_study(comparison: &StudyComparison) -> Table {
    let mut rows = Vec::new();
    let sessions = |row: Record, of: Option<[i64; 2]>| {
        row.with("session_from", of.map(|ends| ends[0])).with("session_to", of.map(|ends| ends[1]))
    };
    for group in &comparison.groups {
        for metric in &group.metrics {
            for contrast in &metric.contrasts {
                let begin = |of: &str| {
                    let row = begin(of, group, None, &metric.trust).with("metric", metric.metric.name());
                    sessions(row.with("contrast", word(&contrast.contrast)), contrast.sessions)
                };
                let mean = contrast.mean.as_ref().and_then(|mean| mean.coefficients.first());
                rows.push(
                    begin("group")
                        .with("people", contrast.people.len())
                        .with("value", mean.map(|own| own.value))
                        .with("standard_error", mean.map(|own| own.standard_error))
                        .with("low", mean.map(|own| own.interval95[0]))
                        .with("high", mean.map(|own| own.interval95[1]))
                        .with("p", contrast.signs.as_ref().map(|own| own.p))
                        .with("p_adjusted", contrast.p_adjusted)
                        .with("no_value", contrast.no_mean.clone()),
                );
                for person in &contrast.people {
                    rows.push(
                        begin("person")
                            .with("subject", person.code.as_str())
                            .with("value", person.value)
                            .with("standard_error", person.standard_error),
                    );
                }
            }
        }
    }
    for pair in &comparison.pairs {
        let (Some(first), Some(second)) = (comparison.groups.get(pair.first), comparison.groups.get(pair.second))
        else {
            continue;
        };
        for metric in &pair.metrics {
            for contrast in &metric.contrasts {
                let row = begin("difference", second, Some(first), &metric.trust).with("metric", metric.metric.name());
                let (exact, by_means) = (contrast.permutation.as_ref(), contrast.difference.as_ref());
                let interval = exact.and_then(|own| own.interval95).or(by_means.map(|own| own.interval95));
                rows.push(
                    sessions(row.with("contrast", word(&contrast.contrast)), contrast.sessions)
                        .with("people", contrast.people[1])
                        .with("against_people", contrast.people[0])
                        .with("value", exact.map(|own| own.difference).or(by_means.map(|own| own.difference)))
                        .with("standard_error", by_means.map(|own| own.standard_error))
                        .with("low", interval.map(|ends| ends[0]))
                        .with("high", interval.map(|ends| ends[1]))
                        .with("p", exact.map(|own| own.p))
                        .with("p_adjusted", contrast.p_adjusted)
                        .with("hedges_g", contrast.hedges.as_ref().map(|own| own.g))
                        .with("no_value", contrast.no_difference.clone()),
                );
            }
        }
    }
    rows.into_iter().collect::<Table>().beginning_with(COLUMNS)
}
