//! The question about one half of a controller, checked: its gain, and what the answer is read with.

use super::problems;
use super::spec::{Form, InverseSpec};
use super::written::{Trajectory, WrittenMatrix};
use crate::analysis::problem::Problem;
use crate::analysis::reading::{wrong_inputs as wrong, wrong_spec};
use crate::control::lyapunov::Clock;
use crate::control::riccati::SYMMETRY;
use crate::inverse::gains::LARGEST_ENTRY;
use crate::inverse::{Gains, GainsError, Knowledge};
use crate::num::linalg::symmetric;
use nalgebra::DMatrix;

/// Rows of a trajectory at most.
const MAX_SAMPLES: usize = 100_000;

/// Negative eigenvalues of a weight to compare with are rounding below this share of the largest: weights are copied
/// with few digits.
const PRINTED: f64 = 1e-3;

/// The names of the states, inputs or outputs, and their units where they are given.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::analysis) struct Labels {
    pub names: Vec<String>,
    pub units: Option<Vec<String>>,
}

/// Names and units as written, of states, inputs or outputs.
pub(in crate::analysis) struct WrittenLabels<'a> {
    /// `state`, `input` or `output`.
    pub of: &'static str,
    pub names: &'a Option<Vec<String>>,
    pub units: &'a Option<Vec<String>>,
}

impl WrittenLabels<'_> {
    fn checked(&self, count: usize) -> Result<Labels, Problem> {
        let Self { of, names, units } = self;
        for (what, texts) in [("names", names), ("units", units)] {
            if let Some(found) = texts.as_ref().map(Vec::len).filter(|found| *found != count) {
                return Err(wrong(format!("there are {found} {what} for {count}"), format!("/inputs/{of}_{what}")));
            }
        }
        let letter = match *of {
            "state" => "x",
            "input" => "u",
            _ => "y",
        };
        let numbered = || (1..=count).map(|i| format!("{letter}{i}")).collect();
        Ok(Labels { names: (*names).clone().unwrap_or_else(numbered), units: (*units).clone() })
    }
}

/// Two matrices: states and inputs along a trajectory, or the weights of a half.
pub(in crate::analysis) type Pair = (DMatrix<f64>, DMatrix<f64>);

/// A question about K, or about L.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::analysis) struct Half {
    pub gains: Gains,
    pub sample_time_s: Option<f64>,
    pub states: Labels,
    /// Of the regulator's inputs, or of the filter's outputs.
    pub ports: Labels,
    /// States and inputs, of a regulator.
    pub trajectory: Option<Pair>,
    /// Other weights on states and ports.
    pub other: Option<Pair>,
    /// A, the input (of a filter: output) matrix and the gain as written, and how far the gain is known.
    pub written: [DMatrix<f64>; 3],
    pub knowledge: Knowledge,
    pub form: Form,
}

fn clock(sample_time_s: Option<f64>) -> Clock {
    if sample_time_s.is_some() { Clock::Sampled } else { Clock::Continuous }
}

impl Half {
    /// About K of `u = −Kx`, from A, B and K; `at` is the pointer of the spec.
    pub(in crate::analysis) fn regulator(
        written: [&WrittenMatrix; 3],
        sample_time_s: Option<f64>,
        labels: [WrittenLabels; 2],
        (spec, at): (&InverseSpec, &str),
    ) -> Result<Self, Problem> {
        let [a, b, k] = written.map(WrittenMatrix::dense);
        if spec.form == Form::Filter {
            let detail = "a regulator's gain has no form; it is for the gain of a sampled filter";
            return Err(wrong_spec(detail, format!("{at}/form")));
        }
        let knowledge = spec.knowledge(k.shape(), at)?;
        let gains = Gains::regulator_with(&a, &b, &k, clock(sample_time_s), &knowledge);
        Self::new(gains, [a, b, k], sample_time_s, labels, (spec, knowledge, at))
    }

    /// About L of a filter, from A, C and L; `at` is the pointer of the spec.
    pub(in crate::analysis) fn filter(
        written: [&WrittenMatrix; 3],
        sample_time_s: Option<f64>,
        labels: [WrittenLabels; 2],
        (spec, at): (&InverseSpec, &str),
    ) -> Result<Self, Problem> {
        let [a, c, mut l] = written.map(WrittenMatrix::dense);
        let mut knowledge = spec.knowledge(l.shape(), at)?;
        if spec.form == Form::Filter {
            if sample_time_s.is_none() {
                let detail = "a filter in continuous time has one gain; the form is for sampled time";
                return Err(wrong_spec(detail, format!("{at}/form")));
            }
            if a.is_square() && a.ncols() == l.nrows() {
                knowledge.gain_rounding = knowledge.gain_rounding.map(|rounding| a.abs() * rounding);
                l = &a * l;
            }
        }
        let gains = Gains::filter_with(&a, &c, &l, clock(sample_time_s), &knowledge);
        Self::new(gains, [a, c, l], sample_time_s, labels, (spec, knowledge, at))
    }

    fn new(
        gains: Result<Gains, GainsError>,
        written: [DMatrix<f64>; 3],
        sample_time_s: Option<f64>,
        [states, ports]: [WrittenLabels; 2],
        (spec, knowledge, at): (&InverseSpec, Knowledge, &str),
    ) -> Result<Self, Problem> {
        let gains = gains.map_err(|error| problems::gains(&error, at))?;
        let (states, ports) = (states.checked(gains.states())?, ports.checked(gains.ports())?);
        let form = spec.form;
        Ok(Self { gains, sample_time_s, states, ports, trajectory: None, other: None, written, knowledge, form })
    }

    /// Shares the cost out along a trajectory.
    pub(in crate::analysis) fn along(mut self, trajectory: Option<&Trajectory>) -> Result<Self, Problem> {
        let Some(trajectory) = trajectory else { return Ok(self) };
        let part = |matrix: &WrittenMatrix, name: &str, columns: usize| {
            sized(matrix.dense(), &format!("/inputs/trajectory/{name}"), name, None, columns)
        };
        let x = part(&trajectory.x, "x", self.gains.states())?;
        let u = part(&trajectory.u, "u", self.gains.ports())?;
        if x.nrows() != u.nrows() {
            let detail = format!("x has {} samples and u has {}", x.nrows(), u.nrows());
            return Err(wrong(detail, "/inputs/trajectory/u"));
        }
        if x.nrows() > MAX_SAMPLES {
            let detail = format!("there are {} samples; at most {MAX_SAMPLES} are taken", x.nrows());
            return Err(wrong(detail, "/inputs/trajectory/x"));
        }
        self.trajectory = Some((x, u));
        Ok(self)
    }

    /// Compares the answer with other weights on states and ports; `names` are their letters.
    pub(in crate::analysis) fn beside(
        mut self,
        names: [&str; 2],
        other: Option<(&WrittenMatrix, &WrittenMatrix)>,
    ) -> Result<Self, Problem> {
        let Some((state, port)) = other else { return Ok(self) };
        let state = weight(state, names[0], self.gains.states(), false)?;
        self.other = Some((state, weight(port, names[1], self.gains.ports(), true)?));
        Ok(self)
    }
}

/// Checks the size of the feedthrough, which no answer depends on: outputs by inputs, where they are known.
pub(in crate::analysis) fn check_feedthrough(
    d: Option<&WrittenMatrix>,
    outputs: usize,
    inputs: Option<usize>,
) -> Result<(), Problem> {
    let Some(d) = d.map(WrittenMatrix::dense) else { return Ok(()) };
    let inputs = inputs.unwrap_or(d.ncols());
    if d.shape() == (outputs, inputs) {
        return Ok(());
    }
    Err(wrong(format!("D is {}x{} and must be {outputs}x{inputs}", d.nrows(), d.ncols()), "/inputs/d"))
}

/// A matrix whose size and entries are as they must be.
fn sized(
    found: DMatrix<f64>,
    at: &str,
    name: &str,
    rows: Option<usize>,
    columns: usize,
) -> Result<DMatrix<f64>, Problem> {
    let shape = format!("{}x{}", found.nrows(), found.ncols());
    if found.ncols() != columns || rows.is_some_and(|rows| found.nrows() != rows) {
        let expected = rows.map_or_else(|| format!("have {columns} columns"), |rows| format!("be {rows}x{columns}"));
        return Err(wrong(format!("{name} is {shape} and must {expected}"), at));
    }
    for (i, row) in found.row_iter().enumerate() {
        if let Some((j, entry)) = row.iter().enumerate().find(|(_, v)| v.is_nan() || v.abs() > LARGEST_ENTRY) {
            let detail = format!(
                "{name} ({shape}) has the entry {entry:e} at row {i}, column {j} (counted from 0); \
                 magnitudes up to {LARGEST_ENTRY:e} are taken"
            );
            return Err(wrong(detail, format!("{at}/{i}/{j}")));
        }
    }
    Ok(found)
}

/// A weight of `compare_with`.
fn weight(written: &WrittenMatrix, name: &str, order: usize, is_definite: bool) -> Result<DMatrix<f64>, Problem> {
    let at = format!("/inputs/compare_with/{name}");
    let found = sized(written.dense(), &at, name, Some(order), order)?;
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
