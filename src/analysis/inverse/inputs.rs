//! The matrices of the question.

use crate::num::linalg::symmetric;
use super::problems;
use crate::analysis::kind::Kind;
use crate::analysis::problem::{Code, Problem};
use crate::control::lyapunov::Clock;
use crate::control::riccati::SYMMETRY;
use crate::inverse::Gains;
use crate::inverse::gains::LARGEST_ENTRY;
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

/// Rows of a trajectory at most.
const MAX_SAMPLES: usize = 100_000;

/// Negative eigenvalues of a weight to compare with are rounding below this share of the largest: weights are copied with few digits.
const PRINTED: f64 = 1e-3;

/// A recorded trajectory, along which the cost is shared out: rows are samples, equally spaced in time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Trajectory {
    /// States, one row of n numbers per sample.
    pub x: Vec<Vec<f64>>,
    /// Inputs, one row of m numbers per sample.
    pub u: Vec<Vec<f64>>,
}

/// The weights of another subject or session, to compare with up to the free scale: q and r of a regulator, w and v of a filter, both of a whole
/// controller. All are symmetric, q and w positive semidefinite, r and v positive definite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Comparand {
    /// Q, n×n.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub q: Option<Vec<Vec<f64>>>,
    /// R, m×m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub r: Option<Vec<Vec<f64>>>,
    /// W, n×n.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub w: Option<Vec<Vec<f64>>>,
    /// V, p×p.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub v: Option<Vec<Vec<f64>>>,
}

/// The names of the states, inputs or outputs, and their units where they are given.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Labels {
    pub names: Vec<String>,
    pub units: Option<Vec<String>>,
}

/// Two weights.
type Pair = (DMatrix<f64>, DMatrix<f64>);

/// Checked inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct InverseInputs {
    written: Map<String, Value>,
    /// The question about K.
    pub(super) regulator: Option<Gains>,
    /// The question about L.
    pub(super) filter: Option<Gains>,
    pub(super) sample_time_s: Option<f64>,
    pub(super) states: Labels,
    /// Of the regulator's inputs.
    pub(super) inputs: Labels,
    /// Of the filter's outputs.
    pub(super) outputs: Labels,
    pub(super) trajectory: Option<Pair>,
    /// Another Q and R.
    pub(super) other_cost: Option<Pair>,
    /// Another W and V.
    pub(super) other_noise: Option<Pair>,
}

fn wrong(detail: impl Into<String>, at: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "unusable inputs", detail).at(at)
}

/// A matrix as row-major nested arrays.
pub(in crate::analysis) fn matrix(value: &Value, letter: &str, at: &str) -> Result<DMatrix<f64>, Problem> {
    let advice = format!("Give {letter} as an array of rows, each an array of numbers: [[1, 0], [0, 1]].");
    let rows =
        value.as_array().ok_or_else(|| wrong(format!("{letter} is no array of rows"), at).mend(advice.clone()))?;
    let mut columns = None;
    let mut entries = Vec::new();
    for (i, row) in rows.iter().enumerate() {
        let row = row.as_array().ok_or_else(|| {
            wrong(format!("row {i} of {letter} is no array"), format!("{at}/{i}")).mend(advice.clone())
        })?;
        let width = *columns.get_or_insert(row.len());
        if row.len() != width {
            return Err(wrong(
                format!("row {i} of {letter} has {} entries where row 0 has {width}", row.len()),
                format!("{at}/{i}"),
            ));
        }
        for (j, entry) in row.iter().enumerate() {
            let number = entry.as_f64().ok_or_else(|| {
                wrong(format!("the entry of {letter} at row {i}, column {j} is no number"), format!("{at}/{i}/{j}"))
            })?;
            entries.push(number);
        }
    }
    Ok(DMatrix::from_row_slice(rows.len(), columns.unwrap_or(0), &entries))
}

/// A matrix within a member, its size and entries checked.
fn part_of(
    value: &Value,
    member: &str,
    name: &str,
    rows: Option<usize>,
    columns: usize,
) -> Result<DMatrix<f64>, Problem> {
    let at = format!("/inputs/{member}/{name}");
    let written = value.get(name).filter(|v| !v.is_null());
    let written = written.ok_or_else(|| wrong(format!("there is no {name}"), format!("/inputs/{member}")))?;
    let found = matrix(written, name, &at)?;
    let shape = format!("{}x{}", found.nrows(), found.ncols());
    if found.ncols() != columns || rows.is_some_and(|rows| found.nrows() != rows) {
        let expected = rows.map_or_else(|| format!("have {columns} columns"), |rows| format!("be {rows}x{columns}"));
        return Err(wrong(format!("{name} is {shape} and must {expected}"), at));
    }
    for (i, row) in found.row_iter().enumerate() {
        if let Some((j, entry)) = row.iter().enumerate().find(|(_, v)| v.is_nan() || v.abs() > LARGEST_ENTRY) {
            return Err(wrong(
                format!(
                    "{name} ({shape}) has the entry {entry:e} at row {i}, column {j} (counted from 0); magnitudes up to {LARGEST_ENTRY:e} are taken"
                ),
                format!("{at}/{i}/{j}"),
            ));
        }
    }
    Ok(found)
}

/// A weight of `compare_with`.
fn other(value: &Value, name: &str, order: usize, is_definite: bool) -> Result<DMatrix<f64>, Problem> {
    let found = part_of(value, "compare_with", name, Some(order), order)?;
    let at = format!("/inputs/compare_with/{name}");
    if (&found - found.transpose()).amax() > SYMMETRY * found.amax() {
        return Err(wrong(format!("{name} ({order}x{order}) is not symmetric"), at));
    }
    let found = symmetric(&found);
    let values = found.symmetric_eigenvalues();
    let (least, largest) = (values.min(), values.amax());
    if is_definite && least <= 0.0 {
        let detail = format!("{name} ({order}x{order}) is not positive definite: its least eigenvalue is {least:e}");
        return Err(wrong(detail, at));
    }
    if least < -PRINTED * largest {
        let detail =
            format!("{name} ({order}x{order}) is not positive semidefinite: its least eigenvalue is {least:e}");
        return Err(wrong(detail, at));
    }
    Ok(found)
}

impl InverseInputs {
    pub(super) fn parse(inputs: &Value, kind: Kind) -> Result<Self, Problem> {
        let members = inputs.as_object().ok_or_else(|| wrong("the inputs are no object", "/inputs"))?;
        let (needed, own): (&[&str], &[&str]) = match kind {
            Kind::InverseLqe => (&["a", "c", "l"], &["d", "output_names", "output_units"]),
            Kind::InverseLqg => (
                &["a", "b", "c", "k", "l"],
                &["d", "input_names", "input_units", "output_names", "output_units", "trajectory"],
            ),
            _ => (&["a", "b", "k"], &["input_names", "input_units", "trajectory"]),
        };
        let optional = [&["sample_time_s", "state_names", "state_units", "compare_with"], own].concat();
        for name in members.keys() {
            if !needed.contains(&name.as_str()) && !optional.contains(&name.as_str()) {
                return Err(wrong(
                    format!("{kind} takes no input {name:?}"),
                    format!("/inputs/{}", name.replace('~', "~0").replace('/', "~1")),
                )
                .mend(format!(
                    "It takes {} and, if wanted, {}.",
                    needed.join(", "),
                    optional.join(", ")
                )));
            }
        }
        let present = |name: &str| members.get(name).filter(|value| !value.is_null());
        let get = |name: &str| -> Result<DMatrix<f64>, Problem> {
            let value = present(name).ok_or_else(|| {
                wrong(format!("there is no matrix {name}"), "/inputs").mend(format!("Give {}.", needed.join(", ")))
            })?;
            matrix(value, &name.to_uppercase(), &format!("/inputs/{name}"))
        };
        let sample_time_s = match present("sample_time_s") {
            None => None,
            Some(value) => Some(value.as_f64().filter(|t| *t > 0.0 && t.is_finite()).ok_or_else(|| {
                wrong(format!("the sample time {value} is no positive number of seconds"), "/inputs/sample_time_s")
                    .mend("Give the sample time in seconds, or null for continuous time.")
            })?),
        };
        let clock = if sample_time_s.is_some() { Clock::Sampled } else { Clock::Continuous };
        let a = get("a")?;
        let regulator = match kind {
            Kind::InverseLqe => None,
            _ => Some(Gains::regulator(&a, &get("b")?, &get("k")?, clock).map_err(|e| problems::gains(&e))?),
        };
        let filter = match kind {
            Kind::InverseLqr => None,
            _ => Some(Gains::filter(&a, &get("c")?, &get("l")?, clock).map_err(|e| problems::gains(&e))?),
        };
        if let Some(value) = present("d") {
            let d = matrix(value, "D", "/inputs/d")?;
            let outputs = filter.as_ref().map_or(0, Gains::ports);
            let inputs = regulator.as_ref().map_or(d.ncols(), Gains::ports);
            if d.shape() != (outputs, inputs) {
                return Err(wrong(
                    format!("D is {}x{} and must be {outputs}x{inputs}", d.nrows(), d.ncols()),
                    "/inputs/d",
                ));
            }
        }
        let n = a.nrows();
        let [m, p] = [&regulator, &filter].map(|half| half.as_ref().map_or(0, Gains::ports));
        let texts = |field: &str, count: usize| -> Result<Option<Vec<String>>, Problem> {
            let Some(value) = present(field) else { return Ok(None) };
            let at = format!("/inputs/{field}");
            let texts: Vec<String> =
                serde_json::from_value(value.clone()).map_err(|error| wrong(error.to_string(), at.clone()))?;
            let what = field.rsplit('_').next().unwrap_or(field);
            if texts.len() == count {
                Ok(Some(texts))
            } else {
                Err(wrong(format!("there are {} {what} for {count}", texts.len()), at))
            }
        };
        let labels = |of: &str, count: usize, letter: &str| -> Result<Labels, Problem> {
            let numbered = || (1..=count).map(|i| format!("{letter}{i}")).collect();
            let names = texts(&format!("{of}_names"), count)?.unwrap_or_else(numbered);
            Ok(Labels { names, units: texts(&format!("{of}_units"), count)? })
        };
        let (states, inputs, outputs) = (labels("state", n, "x")?, labels("input", m, "u")?, labels("output", p, "y")?);
        let trajectory = match present("trajectory") {
            None => None,
            Some(value) => {
                let part = |name: &str, columns: usize| part_of(value, "trajectory", name, None, columns);
                let (x, u) = (part("x", n)?, part("u", m)?);
                if x.nrows() != u.nrows() {
                    return Err(wrong(
                        format!("x has {} samples and u has {}", x.nrows(), u.nrows()),
                        "/inputs/trajectory/u",
                    ));
                }
                if x.nrows() > MAX_SAMPLES {
                    return Err(wrong(
                        format!("there are {} samples; at most {MAX_SAMPLES} are taken", x.nrows()),
                        "/inputs/trajectory/x",
                    ));
                }
                Some((x, u))
            }
        };
        let (mut other_cost, mut other_noise) = (None, None);
        if let Some(value) = present("compare_with") {
            let halves: &[([&str; 2], usize, bool)] =
                &[(["q", "r"], m, regulator.is_some()), (["w", "v"], p, filter.is_some())];
            let asked = |names: &[&str; 2]| names.iter().any(|name| value.get(name).is_some_and(|v| !v.is_null()));
            for (names, ports, exists) in halves {
                if !asked(names) {
                    continue;
                }
                if !exists {
                    return Err(wrong(
                        format!("{kind} has no {} to compare with", names[0]),
                        format!("/inputs/compare_with/{}", names[0]),
                    ));
                }
                let [state, port] = names;
                let pair = (other(value, state, n, false)?, other(value, port, *ports, true)?);
                *(if *state == "q" { &mut other_cost } else { &mut other_noise }) = Some(pair);
            }
            if other_cost.is_none() && other_noise.is_none() {
                return Err(wrong("there are no weights", "/inputs/compare_with")
                    .mend("Give q and r of another regulator, or w and v of another filter."));
            }
        }
        let mut written = members.clone();
        written.insert("sample_time_s".to_owned(), json!(sample_time_s));
        Ok(Self {
            written,
            regulator,
            filter,
            sample_time_s,
            states,
            inputs,
            outputs,
            trajectory,
            other_cost,
            other_noise,
        })
    }

    pub(super) fn to_value(&self) -> Value {
        Value::Object(self.written.clone())
    }
}
