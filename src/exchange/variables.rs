//! Files that hold named variables: which of them are the signals.
//!
//! A mapping names them by paths as MATLAB writes them: `target`, `data.target`, `trial(2).u`, `runs{3}.y`, `M(:,2)`.
//! Without one, the variables of one struct (or of the top) that are named as signals are taken, where there is one
//! such struct; with several, a path must say which. A matrix alone has its columns mapped by position.

mod path;
mod value;

use super::names;
use super::options::Options;
use super::reading::Reading;
use super::time::{self, Place, Recorded};
use super::understood::{Understood, UnderstoodColumn};
use crate::analysis::{Code, Problem};
use crate::trial::csv::ColumnMapping;
use crate::trial::{Channel, ReadError, Signals};
use path::{fields_at, leaves, lookup};
pub use value::{Numbers, Value, Variables};

/// So many elements of arrays of structs, and columns of matrices, are looked at when nothing is mapped.
const LOOKED_AT: usize = 64;

/// Scalars that say how far samples are apart, in seconds.
const STEPS: [&str; 7] = ["ts", "dt", "t_s", "sample_time", "sample_time_s", "sampletime", "sampling_interval"];

/// Scalars that say how many samples there are in a second.
const RATES: [&str; 8] = [
    "fs",
    "sample_rate",
    "samplerate",
    "sampling_rate",
    "samplingrate",
    "sampling_frequency",
    "samplingfrequency",
    "srate",
];

/// A signal that was found.
struct Signal {
    path: String,
    values: Vec<f64>,
}

/// A trial from the variables of a file.
pub(super) fn read(variables: &Variables, mut understood: Understood, options: &Options) -> Result<Reading, Problem> {
    let root = &variables.named;
    for channel in Channel::ALL {
        if let Some(path) = options.columns.name(channel).filter(|path| path.contains(['.', '(', '{']))
            && let Err(why) = lookup(root, path)
        {
            return Err(no_variable(root, &options.columns, path, &why));
        }
    }
    let group = group(root, &options.columns)?;
    let names: Vec<String> = group.members.iter().map(|(name, _)| name.clone()).collect();
    let mut found: [Option<Signal>; 5] = Default::default();
    let mut of_group = ColumnMapping::default();
    for (slot, channel) in Channel::ALL.into_iter().enumerate() {
        let Some(wanted) = options.columns.name(channel) else { continue };
        match lookup(root, wanted) {
            Ok(values) => found[slot] = Some(Signal { path: wanted.to_owned(), values }),
            // A name of the group, or the position of a column.
            Err(why) => match names.iter().any(|name| name == wanted) || wanted.parse::<usize>().is_ok() {
                true => *of_group.name_mut(channel) = Some(wanted.to_owned()),
                false => return Err(no_variable(root, &options.columns, wanted, &why)),
            },
        }
    }
    // What is mapped elsewhere needs no name in the group.
    let mut names_left = names.clone();
    let mut taken = of_group.clone();
    for (slot, channel) in Channel::ALL.into_iter().enumerate() {
        if let Some(signal) = &found[slot] {
            let own = names.iter().position(|name| format!("{}{name}", group.prefix) == signal.path);
            let own = own.unwrap_or_else(|| {
                names_left.push(signal.path.clone());
                names_left.len() - 1
            });
            *taken.name_mut(channel) = Some((own + 1).to_string());
        }
    }
    let positions = names::find(&names_left, &taken, group.place())
        .map_err(|problem| with_variables(problem, root, &options.columns))?;
    for (slot, at) in positions.positions.iter().enumerate() {
        let Some(at) = at.filter(|_| found[slot].is_none()) else { continue };
        let (name, values) = &group.members[at];
        found[slot] = Some(Signal { path: format!("{}{name}", group.prefix), values: values.clone() });
    }
    let [time, Some(command), Some(control), Some(output), disturbance] = found else {
        return Err(with_variables(
            Problem::new(Code::Malformed, "missing signal", "r, u or y is not there"),
            root,
            &options.columns,
        ));
    };
    let used: Vec<(Channel, &Signal)> = Channel::ALL
        .into_iter()
        .zip([time.as_ref(), Some(&command), Some(&control), Some(&output), disturbance.as_ref()])
        .filter_map(|(channel, signal)| Some((channel, signal?)))
        .collect();
    let ignored: Vec<String> = leaves(root)
        .into_iter()
        .map(|(path, _)| path)
        .filter(|path| !used.iter().any(|(_, s)| &s.path == path || s.path.starts_with(&format!("{path}("))))
        .collect();
    let rounded = rounded(root);
    for (channel, signal) in &used {
        let unit = names::without_unit(&signal.path).1.map(str::to_owned);
        understood.columns.push(UnderstoodColumn { signal: channel.letter(), name: signal.path.clone(), unit });
    }
    let list: Vec<String> = understood.columns.iter().map(|c| format!("{} is {}", c.signal, c.name)).collect();
    understood.words.push(format!("{}.", list.join(", ")));
    if !ignored.is_empty() {
        understood.words.push(format!("Left out: {}.", shown(&ignored)));
    }
    if let Some(name) = rounded {
        understood.words.push(format!("{name} has integers beyond 2^53, rounded to the nearest double."));
    }
    let samples = output.values.len();
    if samples > options.limits.max_rows {
        return Err(ReadError::TooManyRows { limit: options.limits.max_rows }.into());
    }
    let paths: Vec<(Channel, String)> = used.iter().map(|(channel, signal)| (*channel, signal.path.clone())).collect();
    let path = |channel: Channel| {
        paths.iter().find(|(c, _)| *c == channel).map_or_else(|| channel.letter().to_owned(), |(_, path)| path.clone())
    };
    let place = |sample: Option<usize>, channel: Channel| match sample {
        Some(sample) => format!("{}, sample {}", path(channel), sample + 1),
        None => path(channel),
    };
    let row = |sample: usize| (sample + 1).to_string();
    let suggestion = time.is_none().then(|| names::suggestion(&names, &options.columns)).filter(|s| s.contains("t:"));
    let place = Place { of: &place, row: &row, rows: "samples", suggestion };
    let recorded = Recorded {
        written_unit: positions.time_unit.clone(),
        sample_time_s: sample_time(root, &group)?,
        signals: Signals {
            time_s: time.map(|signal| signal.values),
            command: command.values,
            control: control.values,
            output: output.values,
            disturbance: disturbance.map(|signal| signal.values),
        },
    };
    let (trial, warnings) = time::settle(recorded, options, &place, &mut understood)?;
    Ok(Reading { trial, understood, ignored_columns: ignored, warnings, bytes: variables.bytes })
}

/// Variables that lie side by side: at the top, or in one struct.
struct Group {
    /// What stands before their names in paths: empty, or `data.`.
    prefix: String,
    members: Vec<(String, Vec<f64>)>,
    scalars: Vec<(String, f64)>,
}

impl Group {
    fn of(prefix: String, values: &[(String, &Value)]) -> Self {
        let mut group = Self { prefix, members: Vec::new(), scalars: Vec::new() };
        for (name, value) in values {
            let Value::Numbers(numbers) = value else { continue };
            if numbers.is_complex {
                continue;
            }
            if numbers.is_vector() {
                group.members.push((name.clone(), numbers.values.clone()));
            } else if let [one] = numbers.values.as_slice() {
                group.scalars.push((name.clone(), *one));
            }
        }
        group
    }

    fn place(&self) -> &str {
        self.prefix.strip_suffix('.').unwrap_or("the variables")
    }
}

/// The group whose members are the signals.
fn group(root: &[(String, Value)], mapping: &ColumnMapping) -> Result<Group, Problem> {
    // Where one is mapped, the others lie beside it.
    for channel in Channel::ALL {
        if let Some(path) = mapping.name(channel)
            && lookup(root, path).is_ok()
            && let Some((parent, _)) = path.rsplit_once('.')
            && let Some(fields) = fields_at(root, parent)
        {
            return Ok(Group::of(format!("{parent}."), &fields));
        }
    }
    let top: Vec<(String, &Value)> = root.iter().map(|(name, value)| (name.clone(), value)).collect();
    let top = Group::of(String::new(), &top);
    let mut groups = structs(root);
    groups.retain(|group| {
        let names: Vec<String> = group.members.iter().map(|(name, _)| name.clone()).collect();
        names::find(&names, &ColumnMapping::default(), "").is_ok()
    });
    let names: Vec<String> = top.members.iter().map(|(name, _)| name.clone()).collect();
    let is_top = names::find(&names, &ColumnMapping::default(), "").is_ok();
    let is_mapped = Channel::ALL.into_iter().any(|channel| mapping.name(channel).is_some());
    if is_top || is_mapped && groups.is_empty() || groups.is_empty() && !top.members.is_empty() {
        if top.members.is_empty()
            && let Some(matrix) = only_matrix(root)
        {
            return Ok(matrix);
        }
        return Ok(top);
    }
    match groups.len() {
        0 => only_matrix(root).map_or_else(|| Ok(top), Ok),
        1 => Ok(groups.remove(0)),
        several => {
            let (first, second) = (groups[0].place(), groups[1].place());
            let of = |group: &Group| {
                let names: Vec<String> = group.members.iter().map(|(n, _)| format!("{}{n}", group.prefix)).collect();
                names::suggestion(&names, &ColumnMapping::default())
            };
            Err(Problem::new(
                Code::Malformed,
                "several recordings",
                format!("the file holds {several} recordings, {first} and {second} among them, and a trial is one"),
            )
            .at(first)
            .mend(format!("Say which: {}.", of(&groups[0]))))
        }
    }
}

/// A file with one matrix: its columns, by position.
fn only_matrix(root: &[(String, Value)]) -> Option<Group> {
    let mut matrices = root.iter().filter_map(|(name, value)| match value {
        Value::Numbers(numbers) if numbers.rows > 1 && numbers.columns > 1 && !numbers.is_complex => {
            Some((name, numbers))
        }
        _ => None,
    });
    let (_, matrix) = matrices.next()?;
    if matrices.next().is_some() || matrix.columns > LOOKED_AT {
        return None;
    }
    let column = |at: usize| Some(((at + 1).to_string(), matrix.column(at)?.to_vec()));
    Some(Group {
        prefix: String::new(),
        members: (0..matrix.columns).filter_map(column).collect(),
        scalars: Vec::new(),
    })
}

/// All structs, to any depth, with the vectors in them.
fn structs(root: &[(String, Value)]) -> Vec<Group> {
    let mut groups = Vec::new();
    for (name, value) in root {
        collect(name, value, &mut groups);
    }
    groups
}

fn collect(path: &str, value: &Value, groups: &mut Vec<Group>) {
    match value {
        Value::Structs { count, fields } => {
            for element in 0..(*count).min(LOOKED_AT) {
                let path = if *count == 1 { path.to_owned() } else { format!("{path}({})", element + 1) };
                let values: Vec<(String, &Value)> =
                    fields.iter().filter_map(|(name, values)| Some((name.clone(), values.get(element)?))).collect();
                groups.push(Group::of(format!("{path}."), &values));
                for (name, value) in values {
                    collect(&format!("{path}.{name}"), value, groups);
                }
            }
        }
        Value::Cells(items) => {
            for (at, item) in items.iter().enumerate().take(LOOKED_AT) {
                collect(&format!("{path}{{{}}}", at + 1), item, groups);
            }
        }
        _ => {}
    }
}

fn rounded(root: &[(String, Value)]) -> Option<String> {
    leaves(root).into_iter().find(|(_, numbers)| numbers.is_rounded).map(|(path, _)| path)
}

/// The sample time that a scalar beside the signals, or at the top, says.
fn sample_time(root: &[(String, Value)], group: &Group) -> Result<Option<f64>, Problem> {
    let top: Vec<(String, &Value)> = root.iter().map(|(name, value)| (name.clone(), value)).collect();
    let top = Group::of(String::new(), &top);
    for (name, value) in group.scalars.iter().chain(&top.scalars) {
        let lower = name.to_ascii_lowercase();
        let seconds = if STEPS.contains(&lower.as_str()) {
            *value
        } else if RATES.contains(&lower.as_str()) {
            1.0 / value
        } else {
            continue;
        };
        if !(seconds.is_normal() && seconds > 0.0) {
            return Err(Problem::new(
                Code::BadSignal,
                "unusable sample time",
                format!("{name} is {value}, which is no time between samples, and no rate"),
            )
            .at(name.clone())
            .mend("Correct it in the file, or rename it and give the sample time (sample_time_s)."));
        }
        return Ok(Some(seconds));
    }
    Ok(None)
}

fn shown(names: &[String]) -> String {
    const SHOWN: usize = 20;
    let mut text = names.iter().take(SHOWN).cloned().collect::<Vec<_>>().join(", ");
    if names.len() > SHOWN {
        text.push_str(&format!(" and {} more", names.len() - SHOWN));
    }
    text
}

/// The variables with their sizes, as a refusal lists them.
fn list(root: &[(String, Value)]) -> String {
    let leaves = leaves(root);
    let mut named: Vec<String> = leaves.iter().map(|(path, n)| format!("{path} ({}×{})", n.rows, n.columns)).collect();
    for (name, value) in root {
        match value {
            Value::Other(what) => named.push(format!("{name} ({what})")),
            Value::Text(_) => named.push(format!("{name} (text)")),
            _ => {}
        }
    }
    if named.is_empty() { "there are none".to_owned() } else { format!("there are {}", shown(&named)) }
}

fn with_variables(problem: Problem, root: &[(String, Value)], mapping: &ColumnMapping) -> Problem {
    let paths: Vec<String> = leaves(root).into_iter().map(|(path, _)| path).collect();
    let suggestion = names::suggestion(&paths, mapping);
    let detail = match problem.detail.split_once("; the columns are") {
        Some((missing, _)) => format!("{}; of variables {}", missing.replace("column", "variable"), list(root)),
        None => problem.detail.clone(),
    };
    let hint = if suggestion.contains('?') { "with paths in place of the ?" } else { "if these are they" };
    Problem { detail, ..problem }.mend(format!(
        "Name the variables t, r, u, y (and d), or say which they are, with paths such as data.target, trial(2).u or \
         M(:,3): {suggestion} ({hint})."
    ))
}

fn no_variable(root: &[(String, Value)], mapping: &ColumnMapping, wanted: &str, why: &str) -> Problem {
    let mut others = mapping.clone();
    for channel in Channel::ALL {
        if mapping.name(channel) == Some(wanted) {
            *others.name_mut(channel) = None;
        }
    }
    let detail = format!("{why}; of variables {}", list(root));
    with_variables(Problem::new(Code::Malformed, "no such variable", detail).at(wanted), root, &others)
}
