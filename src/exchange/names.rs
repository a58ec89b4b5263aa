//! Which column is which signal.
//!
//! A column is taken for a signal where it is mapped to it, or where its name is the signal's letter or word (`r`,
//! `command`), with a unit behind it or without (`r (deg)`, `t_ms`). All other names only make suggestions: whether
//! "Force" is what the person does or what disturbs them, the file does not say.

use super::options::TimeUnit;
use crate::analysis::{Code, Problem};
use crate::trial::Channel;
use crate::trial::csv::ColumnMapping;

/// The word for a signal, in mappings and headers.
#[must_use]
pub fn word(channel: Channel) -> &'static str {
    match channel {
        Channel::Time => "time",
        Channel::Command => "command",
        Channel::Control => "control",
        Channel::Output => "output",
        Channel::Disturbance => "disturbance",
    }
}

/// Names that suggest a signal, in several languages, each a part of a name between spaces, underscores or capitals.
const SUGGESTIONS: [(Channel, &[&str]); 5] = [
    (
        Channel::Time,
        &["t", "time", "times", "timestamp", "timestamps", "zeit", "temps", "tiempo", "latency", "clock", "x_value"],
    ),
    (
        Channel::Disturbance,
        &["d", "disturbance", "perturbation", "perturb", "stoerung", "störung", "dist", "perturbación"],
    ),
    (
        Channel::Command,
        &[
            "r",
            "command",
            "reference",
            "ref",
            "target",
            "setpoint",
            "goal",
            "desired",
            "sollwert",
            "soll",
            "cible",
            "consigne",
            "stimulus",
            "ziel",
            "forcing",
        ],
    ),
    (
        Channel::Control,
        &[
            "u",
            "control",
            "stick",
            "joystick",
            "force",
            "torque",
            "hand",
            "handle",
            "wheel",
            "steering",
            "motor",
            "stellgröße",
            "kraft",
            "moment",
            "manipulandum",
            "action",
            "commande",
            "emg",
        ],
    ),
    (
        Channel::Output,
        &[
            "y", "output", "cursor", "position", "pos", "response", "actual", "istwert", "ist", "angle", "head",
            "gaze", "eye", "curseur",
        ],
    ),
];

/// A name without its unit, and the unit: `r (deg)`, `r [deg]`.
#[must_use]
pub fn without_unit(name: &str) -> (&str, Option<&str>) {
    let name = name.trim();
    for (open, close) in [('(', ')'), ('[', ']'), ('{', '}')] {
        if let Some(inner) = name.strip_suffix(close)
            && let Some((bare, unit)) = inner.rsplit_once(open)
            && !bare.trim().is_empty()
        {
            let unit = unit.trim();
            // An index of a path is no unit.
            if unit.contains(':') || unit.bytes().all(|byte| byte.is_ascii_digit()) && !unit.is_empty() {
                return (name, None);
            }
            return (bare.trim(), (!unit.is_empty()).then_some(unit));
        }
    }
    (name, None)
}

/// A time column's name that ends in its unit: `t_ms`, `time_us`.
fn time_with_unit(name: &str) -> Option<&str> {
    let (bare, unit) = name.rsplit_once(['_', ' ', '.'])?;
    let is_time = ["t", "time", "timestamp"].iter().any(|word| bare.trim().eq_ignore_ascii_case(word));
    (is_time && TimeUnit::as_written(unit).is_some()).then_some(unit)
}

/// Whether a word is a unit of time, be it one that is read or not.
#[must_use]
pub fn is_unit_of_time(word: &str) -> bool {
    /// Units in which no reader takes times.
    const OTHERS: [&str; 8] = ["min", "mins", "minute", "minutes", "h", "hour", "hours", "ticks"];
    TimeUnit::as_written(word).is_some() || OTHERS.contains(&word.to_lowercase().as_str())
}

/// The unit that the name of a column of times gives: in brackets, or as its last word, or as all of it. To miss it
/// would be to take milliseconds for seconds.
fn unit_of_times(name: &str) -> Option<String> {
    let in_brackets = name.split(['(', '[', '{']).skip(1).filter_map(|rest| rest.split([')', ']', '}']).next());
    let known = in_brackets.map(str::trim).find(|unit| is_unit_of_time(unit)).map(str::to_owned);
    let last = || parts(name).pop().filter(|word| is_unit_of_time(word));
    known.or_else(|| without_unit(name).1.map(str::to_owned)).or_else(last)
}

/// Columns that were found for signals.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Found {
    /// The position of each signal's column, from 0, in the order of [`Channel::ALL`].
    pub positions: [Option<usize>; 5],
    /// The unit that the time column's own name gives.
    pub time_unit: Option<String>,
}

/// Finds the signals among columns.
///
/// # Errors
/// A problem with a mapping to go on with, where a signal has no column, or two.
pub fn find(names: &[String], mapping: &ColumnMapping, place: &str) -> Result<Found, Problem> {
    let mut found = Found::default();
    let mut missing = Vec::new();
    for (slot, channel) in Channel::ALL.into_iter().enumerate() {
        if let Some(wanted) = mapping.name(channel) {
            found.positions[slot] = mapped(names, wanted.trim());
            if found.positions[slot].is_none() {
                missing.push(wanted.trim().to_owned());
            }
        }
    }
    refuse_mapped_twice(names, &found)?;
    for (slot, channel) in Channel::ALL.into_iter().enumerate() {
        if mapping.name(channel).is_some() {
            continue;
        }
        let free: Vec<usize> = (0..names.len()).filter(|at| !found.positions.contains(&Some(*at))).collect();
        found.positions[slot] = named(names, channel, &free, place)?;
        let is_needed = !matches!(channel, Channel::Time | Channel::Disturbance);
        if found.positions[slot].is_none() && is_needed {
            missing.push(channel.letter().to_owned());
        }
    }
    if !missing.is_empty() {
        return Err(missing_columns(names, mapping, &missing).at(place));
    }
    found.time_unit = found.positions[0].and_then(|at| unit_of_times(&names[at]));
    Ok(found)
}

/// The column that a mapping means: by its name, by its name without unit, or by its position from 1.
fn mapped(names: &[String], wanted: &str) -> Option<usize> {
    let by_name = names.iter().position(|name| name == wanted);
    let bare = || names.iter().position(|name| without_unit(name).0 == wanted);
    let position = || wanted.parse::<usize>().ok().filter(|at| (1..=names.len()).contains(at)).map(|at| at - 1);
    by_name.or_else(bare).or_else(position)
}

fn refuse_mapped_twice(names: &[String], found: &Found) -> Result<(), Problem> {
    for (slot, at) in found.positions.iter().enumerate() {
        let Some(at) = at else { continue };
        if let Some(other) = found.positions[slot + 1..].iter().position(|later| *later == Some(*at)) {
            let (first, second) = (Channel::ALL[slot].letter(), Channel::ALL[slot + 1 + other].letter());
            return Err(Problem::new(
                Code::Invalid,
                "column mapped twice",
                format!("{first} and {second} are both mapped to the column {:?}", names[*at]),
            )
            .at(format!("column {}", names[*at]))
            .mend("Map each signal to a column of its own."));
        }
    }
    Ok(())
}

/// The free column that has a signal's own name: its letter before its word.
fn named(names: &[String], channel: Channel, free: &[usize], place: &str) -> Result<Option<usize>, Problem> {
    let letter = |name: &str| name.eq_ignore_ascii_case(channel.letter());
    let is_word = |name: &str| name.eq_ignore_ascii_case(word(channel));
    let with_unit = |name: &str| channel == Channel::Time && time_with_unit(name).is_some();
    let rules: [&dyn Fn(&str) -> bool; 4] =
        [&|name| letter(name), &|name| letter(without_unit(name).0), &|name| is_word(without_unit(name).0), &|name| {
            with_unit(name)
        }];
    for rule in rules {
        let fits: Vec<usize> = free.iter().copied().filter(|at| rule(&names[*at])).collect();
        match fits.as_slice() {
            [] => {}
            [one] => return Ok(Some(*one)),
            [first, second, ..] => {
                let (one, other) = (&names[*first], &names[*second]);
                let what = if one == other {
                    format!("columns {} and {} are both named {one:?}", first + 1, second + 1)
                } else {
                    format!(
                        "columns {} and {}, {one:?} and {other:?}, are both named as {}",
                        first + 1,
                        second + 1,
                        channel.letter()
                    )
                };
                let at = if place.starts_with("row") { format!("column {one}") } else { place.to_owned() };
                return Err(Problem::new(Code::Malformed, "column named twice", what).at(at).mend(format!(
                    "Rename one of them, or say which it is: columns={}:{}.",
                    channel.letter(),
                    first + 1
                )));
            }
        }
    }
    Ok(None)
}

/// What could be meant, as a mapping that can be given; `?` where nothing suggests a column.
#[must_use]
pub fn suggestion(names: &[String], mapping: &ColumnMapping) -> String {
    let mut taken: Vec<usize> = Vec::new();
    let mut pairs = Vec::new();
    let given = |channel: Channel| mapping.name(channel).and_then(|wanted| mapped(names, wanted.trim()));
    taken.extend(Channel::ALL.into_iter().filter_map(given));
    let mut chosen = [None; 5];
    for (slot, channel) in Channel::ALL.into_iter().enumerate() {
        chosen[slot] = given(channel);
    }
    for (channel, words) in SUGGESTIONS {
        let slot = Channel::ALL.iter().position(|c| *c == channel).unwrap_or_default();
        if chosen[slot].is_some() {
            continue;
        }
        let is_word = |name: &String| {
            words.contains(&name.to_lowercase().as_str()) || parts(name).iter().any(|p| words.contains(&p.as_str()))
        };
        let fits = |at: &usize| !taken.contains(at) && is_word(&names[*at]);
        if let Some(at) = (0..names.len()).find(fits) {
            taken.push(at);
            chosen[slot] = Some(at);
        }
    }
    for (slot, channel) in Channel::ALL.into_iter().enumerate() {
        match chosen[slot] {
            // A name with a comma cannot stand in a list of pairs; its position can.
            Some(at) if names[at].is_empty() || names[at].contains(',') => {
                pairs.push(format!("{}:{}", channel.letter(), at + 1));
            }
            Some(at) => pairs.push(format!("{}:{}", channel.letter(), names[at])),
            None if channel == Channel::Disturbance || channel == Channel::Time => {}
            None => pairs.push(format!("{}:?", channel.letter())),
        }
    }
    format!("columns={}", pairs.join(","))
}

fn parts(name: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    let mut previous = ' ';
    for c in without_unit(name).0.chars() {
        if !c.is_alphanumeric() || (c.is_uppercase() && previous.is_lowercase()) {
            parts.push(String::new());
        }
        if c.is_alphanumeric()
            && let Some(last) = parts.last_mut()
        {
            last.extend(c.to_lowercase());
        }
        previous = c;
    }
    parts.retain(|part| !part.is_empty());
    parts
}

fn missing_columns(names: &[String], mapping: &ColumnMapping, missing: &[String]) -> Problem {
    const SHOWN: usize = 40;
    let list = |names: &[String]| {
        let shown: Vec<String> = names.iter().take(SHOWN).map(|name| format!("{:?}", short(name))).collect();
        let more = names.len().saturating_sub(SHOWN);
        if more > 0 { format!("{} and {more} more", shown.join(", ")) } else { shown.join(", ") }
    };
    let detail = format!("there is no column {}; the columns are {}", list(missing), list(names));
    let suggestion = suggestion(names, mapping);
    let hint = if suggestion.contains('?') { "with the names in place of the ?" } else { "if these are they" };
    Problem::new(Code::Malformed, "missing column", detail)
        .mend(format!("Name the columns t, r, u, y (and d), or say which they are: {suggestion} ({hint})."))
}

fn short(name: &str) -> String {
    const KEPT: usize = 40;
    match name.char_indices().nth(KEPT) {
        Some((end, _)) => format!("{}…", &name[..end]),
        None => name.to_owned(),
    }
}
