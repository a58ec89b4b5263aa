//! Plant and trials as matrices, checked.

use super::inputs::{LqgFitInputs, LqgFitPlant, LqgFitTrial, LqgFitTrialInput};
use crate::analysis::inputs::library::Library;
use crate::analysis::inputs::matrix::dense;
use crate::analysis::inputs::recorded;
use crate::analysis::inputs::sampled_signal::SampledSignal;
use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_inputs as wrong;
use crate::control::stochastic::sample_noise;
use crate::control::{Continuous, Discrete, StateSpace, discretise};
use crate::likelihood::lqg::Plant;
use nalgebra::DMatrix;

/// States at most.
const MAX_STATES: usize = 16;
/// Entries of larger magnitude would overflow in products of a few matrices.
const LARGEST: f64 = 1e30;

/// The signals of a trial, samples × channels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Signals {
    pub sample_time_s: f64,
    /// `None` where nothing was done.
    pub disturbance: Option<DMatrix<f64>>,
    pub output: DMatrix<f64>,
    pub control: Option<DMatrix<f64>>,
    pub initial_state: Option<Vec<f64>>,
}

/// The plant in the samples of the trials.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sampled {
    pub plant: Plant,
    /// Rows of the states that were recorded, where those are others than the sensed ones.
    pub recorded: Option<DMatrix<f64>>,
    pub time: Discrete,
    /// The covariance over a sample of white noise of intensity one in all controls, n×n; in sampled time `BBᵀ`.
    pub control_borne: DMatrix<f64>,
}

/// A matrix whose entries are numbers of moderate size, of this shape where one is asked for.
pub(super) fn sized(
    rows: &[Vec<f64>],
    letter: &str,
    shape: (usize, usize),
    at: &str,
    wrong: fn(String, String) -> Problem,
) -> Result<DMatrix<f64>, Problem> {
    let found = dense(rows, letter, at).map_err(|problem| wrong(problem.detail, at.to_owned()))?;
    if found.shape() != shape {
        let (rows, columns) = found.shape();
        return Err(wrong(format!("{letter} is {rows}x{columns} and must be {}x{}", shape.0, shape.1), at.to_owned()));
    }
    if let Some(value) = found.iter().find(|v| v.is_nan() || v.abs() > LARGEST) {
        let detail = format!("{letter} has the entry {value:e}; magnitudes up to {LARGEST:e} are taken");
        return Err(wrong(detail, at.to_owned()));
    }
    Ok(found)
}

fn inputs_wrong(detail: String, at: String) -> Problem {
    wrong(detail, at)
}

impl Sampled {
    /// The plant of this member of the inputs in the samples of this period.
    ///
    /// # Errors
    /// A [`Problem`] with the pointer of the matrix that is wrong.
    pub(super) fn new(written: &LqgFitPlant, member: &str, period: f64, at_period: &str) -> Result<Self, Problem> {
        let at = |name: &str| format!("/inputs/{member}/{name}");
        let width = |rows: &[Vec<f64>]| rows.first().map_or(0, Vec::len);
        let n = written.a.len();
        if n == 0 || n > MAX_STATES {
            return Err(wrong(format!("A has {n} rows; 1 to {MAX_STATES} states are taken"), at("a")));
        }
        let m = width(&written.b);
        let p = written.c.as_ref().map_or(n, Vec::len);
        let q = written.e.as_ref().map_or(m, |rows| width(rows));
        for (letter, count, port) in [("B", m, "control"), ("C", p, "output"), ("E", q, "disturbance")] {
            if count == 0 {
                let detail = format!("{letter} is empty: there must be at least one {port}");
                return Err(wrong(detail, at(&letter.to_lowercase())));
            }
        }
        let read = |rows: &[Vec<f64>], letter: &str, shape| {
            sized(rows, letter, shape, &at(&letter.to_lowercase()), inputs_wrong)
        };
        let a = read(&written.a, "A", (n, n))?;
        let b = read(&written.b, "B", (n, m))?;
        let c = written.c.as_deref().map(|rows| read(rows, "C", (p, n))).transpose()?;
        let e = written.e.as_deref().map(|rows| read(rows, "E", (n, q))).transpose()?;
        let c = c.unwrap_or_else(|| DMatrix::identity(n, n));
        let d = written.d.as_deref().map(|rows| read(rows, "D", (p, q))).transpose()?;
        let d = d.unwrap_or_else(|| DMatrix::zeros(p, q));
        let recorded = written
            .c_recorded
            .as_deref()
            .map(|rows| sized(rows, "C_r", (rows.len().max(1), n), &at("c_recorded"), inputs_wrong))
            .transpose()?;
        let e = e.unwrap_or_else(|| b.clone());
        let time = Discrete::new(period).map_err(|error| wrong(error.to_string(), at_period))?;
        if let Some(own) = written.sample_time_s {
            let is_same = (own / period - 1.0).abs() <= 1e-9;
            if !is_same {
                let detail = format!("the plant is sampled every {own} s and the trials every {period} s");
                return Err(wrong(detail, at("sample_time_s")));
            }
            let control_borne = &b * b.transpose();
            return Ok(Self { plant: Plant { a, b, c, e, d }, recorded, time, control_borne });
        }
        let overflow = |detail: String| wrong(detail, at("a")).mend("Choose a shorter sample time, or other units.");
        let control_borne =
            sample_noise(&a, &(&b * b.transpose()), time).map_err(|error| overflow(error.to_string()))?.covariance;
        let mut both = DMatrix::zeros(n, m + q);
        both.columns_mut(0, m).copy_from(&b);
        both.columns_mut(m, q).copy_from(&e);
        let model = StateSpace::new(a, both, c.clone(), DMatrix::zeros(p, m + q), Continuous)
            .map_err(|error| overflow(error.to_string()))?;
        let model =
            discretise::zero_order_hold_state_space(&model, time).map_err(|error| overflow(error.to_string()))?;
        let plant = Plant {
            a: model.a().clone(),
            b: model.b().columns(0, m).into_owned(),
            c,
            e: model.b().columns(m, q).into_owned(),
            d,
        };
        Ok(Self { plant, recorded, time, control_borne })
    }
}

impl Signals {
    fn of_request(trial: &LqgFitTrial, at: &str) -> Result<Self, Problem> {
        let checked = |written: &SampledSignal, name: &str| written.checked(name, LARGEST, &format!("{at}/{name}"));
        let output = checked(&trial.output, "output")?;
        let disturbance = trial.disturbance.as_ref().map(|d| checked(d, "disturbance")).transpose()?;
        let control = trial.control.as_ref().map(|u| checked(u, "control")).transpose()?;
        recorded::as_long(&output, &[("disturbance", disturbance.as_ref()), ("control", control.as_ref())], at)?;
        let initial_state = trial.initial_state.clone();
        Ok(Self { sample_time_s: trial.sample_time_s, disturbance, output, control, initial_state })
    }
}

/// The signals in the request; `None` where its trials are stored ones.
///
/// # Errors
/// A [`Problem`] with the pointer of the signal.
pub(super) fn of_request(inputs: &LqgFitInputs) -> Result<Option<Vec<Signals>>, Problem> {
    let mut signals = Vec::new();
    for (i, trial) in inputs.trials().iter().enumerate() {
        let LqgFitTrialInput::Inline(trial) = trial else { return Ok(None) };
        signals.push(Signals::of_request(trial, &inputs.place(i))?);
    }
    Ok(Some(signals))
}

/// The signals of stored trials. A trial's disturbance is d where it has one, its command otherwise.
///
/// # Errors
/// `not_found` for a trial that is gone, `invalid` for the same recording twice.
pub(super) fn of_library(inputs: &LqgFitInputs, library: &Library) -> Result<Vec<Signals>, Problem> {
    let mut signals: Vec<Signals> = Vec::new();
    for (i, trial) in inputs.trials().iter().enumerate() {
        let LqgFitTrialInput::Stored(id) = trial else { continue };
        let at = inputs.place(i);
        let stored = recorded::stored(library, *id, &at)?;
        let recorded = &stored.trial.signals;
        let column = |values: &[f64]| DMatrix::from_column_slice(values.len(), 1, values);
        let found = Signals {
            sample_time_s: stored.trial.sample_time_s,
            disturbance: Some(column(recorded.disturbance.as_deref().unwrap_or(&recorded.command))),
            output: column(&recorded.output),
            control: Some(column(&recorded.control)),
            initial_state: None,
        };
        recorded::add(&mut signals, found, &at)?;
    }
    Ok(signals)
}
