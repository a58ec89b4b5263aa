//! The matrices of the question.

use super::problems;
use crate::analysis::kind::Kind;
use crate::analysis::problem::{Code, Problem};
use crate::control::lyapunov::Clock;
use crate::inverse::Gains;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use utoipa::ToSchema;

/// Rows of a trajectory at most.
const MAX_SAMPLES: usize = 100_000;

/// A recorded trajectory, along which the cost is shared out: rows are samples, equally spaced in time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Trajectory {
    /// States, one row of n numbers per sample.
    pub x: Vec<Vec<f64>>,
    /// Inputs, one row of m numbers per sample.
    pub u: Vec<Vec<f64>>,
}

/// Another cost, to compare with up to the free scale.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Comparand {
    /// Q, n×n.
    pub q: Vec<Vec<f64>>,
    /// R, m×m.
    pub r: Vec<Vec<f64>>,
}

/// Checked inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct InverseInputs {
    written: Map<String, Value>,
    /// The question about K.
    pub(super) regulator: Option<Gains>,
    /// The question about L.
    pub(super) filter: Option<Gains>,
    pub(super) sample_time_s: Option<f64>,
    pub(super) state_names: Vec<String>,
    pub(super) port_names: Vec<String>,
    pub(super) trajectory: Option<(DMatrix<f64>, DMatrix<f64>)>,
    pub(super) comparand: Option<(DMatrix<f64>, DMatrix<f64>)>,
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

impl InverseInputs {
    pub(super) fn parse(inputs: &Value, kind: Kind) -> Result<Self, Problem> {
        let members = inputs.as_object().ok_or_else(|| wrong("the inputs are no object", "/inputs"))?;
        let (needed, optional): (&[&str], &[&str]) = match kind {
            Kind::InverseLqe => (&["a", "c", "l"], &["d", "state_names", "output_names", "sample_time_s"]),
            Kind::InverseLqg => (
                &["a", "b", "c", "k", "l"],
                &["d", "state_names", "input_names", "sample_time_s", "trajectory", "compare_with"],
            ),
            _ => (&["a", "b", "k"], &["state_names", "input_names", "sample_time_s", "trajectory", "compare_with"]),
        };
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
        let (n, m) = (a.nrows(), regulator.as_ref().or(filter.as_ref()).map_or(0, Gains::ports));
        let names = |field: &str, count: usize, letter: &str| -> Result<Vec<String>, Problem> {
            let Some(value) = present(field) else {
                return Ok((1..=count).map(|i| format!("{letter}{i}")).collect());
            };
            let at = format!("/inputs/{field}");
            let names: Vec<String> =
                serde_json::from_value(value.clone()).map_err(|error| wrong(error.to_string(), at.clone()))?;
            if names.len() == count {
                Ok(names)
            } else {
                Err(wrong(format!("there are {} names for {count}", names.len()), at))
            }
        };
        let state_names = names("state_names", n, "x")?;
        let port_names = match kind {
            Kind::InverseLqe => names("output_names", m, "y")?,
            _ => names("input_names", m, "u")?,
        };
        let sized = |value: &Value, field: &str, rows: Option<usize>, columns: usize| {
            let found = matrix(value, field, &format!("/inputs/{field}"))?;
            if found.ncols() != columns || rows.is_some_and(|rows| found.nrows() != rows) {
                let expected =
                    rows.map_or_else(|| format!("{columns} columns"), |rows| format!("size {rows}x{columns}"));
                return Err(wrong(
                    format!("{field} is {}x{} and must be of {expected}", found.nrows(), found.ncols()),
                    format!("/inputs/{field}"),
                ));
            }
            Ok(found)
        };
        let trajectory = match present("trajectory") {
            None => None,
            Some(value) => {
                let part = |name: &str| {
                    value.get(name).ok_or_else(|| wrong(format!("there is no {name}"), "/inputs/trajectory"))
                };
                let x = sized(part("x")?, "trajectory/x", None, n)?;
                let u = sized(part("u")?, "trajectory/u", Some(x.nrows()), m)?;
                if x.nrows() > MAX_SAMPLES {
                    return Err(wrong(
                        format!("there are {} samples; at most {MAX_SAMPLES} are taken", x.nrows()),
                        "/inputs/trajectory/x",
                    ));
                }
                Some((x, u))
            }
        };
        let comparand = match present("compare_with") {
            None => None,
            Some(value) => {
                let part = |name: &str| {
                    value.get(name).ok_or_else(|| wrong(format!("there is no {name}"), "/inputs/compare_with"))
                };
                Some((
                    sized(part("q")?, "compare_with/q", Some(n), n)?,
                    sized(part("r")?, "compare_with/r", Some(m), m)?,
                ))
            }
        };
        let mut written = members.clone();
        written.insert("sample_time_s".to_owned(), json!(sample_time_s));
        Ok(Self { written, regulator, filter, sample_time_s, state_names, port_names, trajectory, comparand })
    }

    pub(super) fn to_value(&self) -> Value {
        Value::Object(self.written.clone())
    }
}
