//! From the request to the design and the records of the fit.

use super::inputs::LqgFitPlant;
use super::signals::{Sampled, Signals, sized};
use super::spec::{LqgFitBelief, LqgFitControl, LqgFitDisturbance, LqgFitInitialState, LqgFitSpec, LqgFitTerm};
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::{wrong_inputs, wrong_spec as wrong};
use crate::control::Discrete;
use crate::likelihood::lqg::{Design, Problem as Trials, Record, RecordError, Recorded, Role, Start, Term, Timing};
use crate::num::linalg::{self, symmetric};
use nalgebra::{DMatrix, DVector};

/// Parameters of a fit at most.
const MAX_PARAMETERS: usize = 30;
/// A matrix differs from its transpose by less than this share of its norm.
const SYMMETRY: f64 = 1e-10;
/// A negative eigenvalue below this share of the largest is rounding.
const SEMIDEFINITE: f64 = 1e-12;
/// A noise of the motor that process noise covers up to this share cannot be told from it.
const COVERED: f64 = 1e-6;

/// The design of a fit with its records.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Assembled {
    pub design: Design,
    pub records: Vec<Record>,
    pub time: Discrete,
    /// What the recorded control was taken for.
    pub control: LqgFitControl,
}

fn spec_wrong(detail: String, at: String) -> Problem {
    wrong(detail, at)
}

/// A covariance or weight of the spec: symmetric and positive semidefinite.
fn semidefinite(rows: &[Vec<f64>], letter: &str, order: usize, at: &str) -> Result<DMatrix<f64>, Problem> {
    let found = sized(rows, letter, (order, order), at, spec_wrong)?;
    if (&found - found.transpose()).norm() > SYMMETRY * found.norm() {
        return Err(wrong(format!("{letter} is not symmetric"), at));
    }
    let found = symmetric(&found);
    let values = found.symmetric_eigenvalues();
    if values.min() < -SEMIDEFINITE * values.amax() {
        let detail = format!("{letter} is not positive semidefinite: its least eigenvalue is {:e}", values.min());
        return Err(wrong(detail, at));
    }
    Ok(found)
}

/// The same, positive definite; the identity where nothing is written.
fn definite(rows: Option<&Vec<Vec<f64>>>, letter: &str, order: usize, at: &str) -> Result<DMatrix<f64>, Problem> {
    let Some(rows) = rows else { return Ok(DMatrix::identity(order, order)) };
    let found = semidefinite(rows, letter, order, at)?;
    if found.clone().cholesky().is_none() {
        return Err(wrong(format!("{letter} is not positive definite"), at));
    }
    Ok(found)
}

/// The terms of a matrix of the spec.
fn terms(written: &[LqgFitTerm], role: Role, order: usize, at: &str) -> Result<Vec<Term>, Problem> {
    let one = |(i, term): (usize, &LqgFitTerm)| {
        let place = |name: &str| format!("{at}/{i}/{name}");
        if term.name.is_empty() {
            return Err(wrong("the name is empty", place("name")));
        }
        let name = &term.name;
        let (shape, where_) = match (&term.diagonal, &term.matrix) {
            (Some(diagonal), None) => {
                if diagonal.len() != order {
                    let detail = format!("the diagonal of {name} has {} entries and must have {order}", diagonal.len());
                    return Err(wrong(detail, place("diagonal")));
                }
                if let Some(value) = diagonal.iter().find(|v| !(**v >= 0.0 && v.is_finite())) {
                    let detail = format!("the diagonal of {name} has the entry {value}, and must not be negative");
                    return Err(wrong(detail, place("diagonal")));
                }
                (DMatrix::from_diagonal(&DVector::from_column_slice(diagonal)), "diagonal")
            }
            (None, Some(rows)) => {
                (semidefinite(rows, &format!("the matrix of {name}"), order, &place("matrix"))?, "matrix")
            }
            (Some(_), Some(_)) => return Err(wrong(format!("{name} has a diagonal and a matrix"), place("matrix"))),
            (None, None) => {
                return Err(wrong(format!("{name} has neither a diagonal nor a matrix"), format!("{at}/{i}")));
            }
        };
        if shape.amax() == 0.0 {
            return Err(wrong(format!("the matrix of {name} is zero"), place(where_)));
        }
        let finite = |value: f64| value.is_finite() && value <= 1e100;
        if let Some(held) = term.held.filter(|v| !(*v >= 0.0 && finite(*v))) {
            return Err(wrong(format!("{name} is held at {held}, and must not be negative"), place("held")));
        }
        if let Some(start) = term.start.filter(|v| !(*v > 0.0 && finite(*v))) {
            return Err(wrong(format!("{name} starts at {start}, and must be positive"), place("start")));
        }
        if term.held.is_some() && term.start.is_some() {
            return Err(wrong(format!("{name} is held and started"), place("start")));
        }
        Ok(Term { name: name.clone(), role, shape, held: term.held, start: term.start })
    };
    written.iter().enumerate().map(one).collect()
}

/// A term for every entry of the diagonal.
fn one_each(prefix: &str, role: Role, order: usize) -> Vec<Term> {
    let one = |i: usize| Term {
        name: format!("{prefix}{}", i + 1),
        role,
        shape: DMatrix::from_fn(order, order, |row, column| if row == i && column == i { 1.0 } else { 0.0 }),
        held: None,
        start: None,
    };
    (0..order).map(one).collect()
}

impl Assembled {
    /// Design and records of a request with these signals; `place` gives the pointer of a trial.
    ///
    /// # Errors
    /// A [`Problem`] with the pointer of what is wrong, or of what these records cannot tell.
    pub(super) fn new(
        plant: &LqgFitPlant,
        spec: &LqgFitSpec,
        signals: &[Signals],
        place: &dyn Fn(usize) -> String,
    ) -> Result<Self, Problem> {
        let period = signals.first().map_or(f64::NAN, |s| s.sample_time_s);
        if let Some(i) = signals.iter().position(|s| s.sample_time_s != period) {
            let detail =
                format!("the sample time is {} s, and {period} s in the first trial", signals[i].sample_time_s);
            return Err(wrong_inputs(detail, format!("{}/sample_time_s", place(i))));
        }
        let sampled = Sampled::new(plant, period, &format!("{}/sample_time_s", place(0)))?;
        let control = used_control(spec, signals, place)?;
        let design = design(&sampled, spec, control)?;
        let [n, m, p, q] = design.sizes();
        let mut records = Vec::new();
        for (i, s) in signals.iter().enumerate() {
            let samples = s.output.nrows();
            let disturbance = s.disturbance.clone().unwrap_or_else(|| DMatrix::zeros(samples, q));
            let used = s.control.as_ref().filter(|_| control != LqgFitControl::NotUsed);
            for (name, found, expected) in
                [("disturbance", Some(&disturbance), q), ("output", Some(&s.output), p), ("control", used, m)]
            {
                if let Some(found) = found.filter(|found| found.ncols() != expected) {
                    let detail = format!(
                        "the {name} has {} columns and must have {expected} ({n} states, {m} controls, {p} outputs, \
                         {q} disturbances of the plant)",
                        found.ncols()
                    );
                    return Err(wrong_inputs(detail, format!("{}/{name}", place(i))));
                }
            }
            let mut measured = DMatrix::zeros(samples, design.channels());
            measured.columns_mut(0, p).copy_from(&s.output);
            if let Some(used) = used {
                measured.columns_mut(p, m).copy_from(used);
            }
            records.push(Record { disturbance, measured });
        }
        let numbers = records.iter().map(|r| r.measured.len()).sum::<usize>();
        let unknowns = design.free().count();
        if numbers <= 2 * unknowns {
            let detail = format!("{numbers} numbers were measured in all; {unknowns} unknowns need more");
            return Err(wrong_inputs(detail, "/inputs").mend("Record longer trials or more of them."));
        }
        Trials::new(&design, &records).map_err(|error| unusable(&error, place))?;
        Ok(Self { design, records, time: sampled.time, control })
    }
}

/// Trials that do not fit the design.
fn unusable(error: &RecordError, place: &dyn Fn(usize) -> String) -> Problem {
    let detail = error.to_string();
    match error {
        RecordError::Empty => wrong_inputs(detail, "/inputs"),
        RecordError::TooLong { .. } | RecordError::TooLarge { .. } => {
            Problem::new(Code::Unaffordable, "too many samples", detail).at("/inputs")
        }
        RecordError::Size { trial, .. } => wrong_inputs(detail, place(*trial)),
        RecordError::NotAtRest { trial } => wrong_inputs(detail, format!("{}/control", place(*trial)))
            .mend("Let the trials start anywhere: {\"initial_state\": \"settled\"}."),
    }
}

/// What the recorded control is taken for.
fn used_control(
    spec: &LqgFitSpec,
    signals: &[Signals],
    place: &dyn Fn(usize) -> String,
) -> Result<LqgFitControl, Problem> {
    let without = signals.iter().position(|s| s.control.is_none());
    match (spec.control, without) {
        (Some(LqgFitControl::NotUsed), _) | (None, Some(_)) => {
            if spec.control_variance.is_some() {
                return Err(wrong("no control is used that a variance could belong to", "/spec/control_variance"));
            }
            Ok(LqgFitControl::NotUsed)
        }
        (Some(_), Some(i)) => Err(wrong_inputs("the trial has no control", format!("{}/control", place(i)))
            .mend("Leave the control out of the fit: {\"control\": \"not_used\"}.")),
        (Some(used), None) => Ok(used),
        (None, None) => Ok(LqgFitControl::Commanded),
    }
}

fn design(sampled: &Sampled, spec: &LqgFitSpec, control: LqgFitControl) -> Result<Design, Problem> {
    let plant = sampled.plant.clone();
    let (n, m, p) = (plant.a.nrows(), plant.b.ncols(), plant.c.nrows());
    let borne = |name: &str, role| {
        vec![Term { name: name.to_owned(), role, shape: sampled.control_borne.clone(), held: None, start: None }]
    };
    let mut all: Vec<(Term, String)> = Vec::new();
    let parts = [
        ("state_weight", &spec.state_weight, Role::StateWeight, n, one_each("q", Role::StateWeight, n)),
        (
            "perceived_process_noise",
            &spec.perceived_process_noise,
            Role::PerceivedProcessNoise,
            n,
            borne("wp", Role::PerceivedProcessNoise),
        ),
        ("process_noise", &spec.process_noise, Role::ProcessNoise, n, borne("w", Role::ProcessNoise)),
        (
            "measurement_noise",
            &spec.measurement_noise,
            Role::MeasurementNoise,
            p,
            one_each("v", Role::MeasurementNoise, p),
        ),
        ("motor_noise", &spec.motor_noise, Role::MotorNoise, m, Vec::new()),
    ];
    for (name, written, role, order, usual) in parts {
        let at = format!("/spec/{name}");
        let found = written.as_ref().map(|written| terms(written, role, order, &at)).transpose()?.unwrap_or(usual);
        for (i, term) in found.into_iter().enumerate() {
            let place = format!("{at}/{i}/name");
            if all.iter().any(|(other, _)| other.name == term.name) {
                return Err(wrong(format!("the name {:?} is taken already", term.name), place)
                    .mend("Every parameter needs a name of its own: q1, q2, wp, w, v1 where nothing is written."));
            }
            all.push((term, place));
        }
    }
    let terms: Vec<Term> = all.into_iter().map(|(term, _)| term).collect();
    let has = |role: Role| terms.iter().any(|term| term.role == role && term.held != Some(0.0));
    for (role, name) in [(Role::StateWeight, "state_weight"), (Role::PerceivedProcessNoise, "perceived_process_noise")]
    {
        if !has(role) {
            return Err(wrong(format!("{name} has no term"), format!("/spec/{name}")));
        }
    }
    let free = terms.iter().filter(|term| term.held.is_none()).count();
    if free == 0 || free > MAX_PARAMETERS {
        let detail = format!("there are {free} parameters; 1 to {MAX_PARAMETERS} are fitted");
        return Err(wrong(detail, "/spec/state_weight"));
    }
    let instrument = spec
        .instrument_variance
        .as_ref()
        .map(|rows| definite(Some(rows), "the covariance of the instrument", p, "/spec/instrument_variance"))
        .transpose()?;
    let recorder = spec
        .control_variance
        .as_ref()
        .map(|rows| semidefinite(rows, "the covariance of the control's recorder", m, "/spec/control_variance"))
        .transpose()?
        .unwrap_or_else(|| DMatrix::zeros(m, m));
    let is_applied = control == LqgFitControl::Applied;
    let sensed: Vec<&Term> = terms.iter().filter(|t| t.role == Role::MeasurementNoise && t.held != Some(0.0)).collect();
    let v = sensed.iter().fold(DMatrix::zeros(p, p), |sum, term| sum + &term.shape);
    if instrument.is_none() && v.cholesky().is_none() {
        return Err(wrong(
            "an output that is sensed without noise leaves nothing to predict",
            "/spec/measurement_noise",
        )
        .mend("Give every output a noise, or the variance of the instrument that recorded it."));
    }
    let is_exact = recorder.clone().cholesky().is_none() && !(is_applied && has(Role::MotorNoise));
    if control != LqgFitControl::NotUsed && instrument.is_none() && is_exact {
        return Err(wrong(
            "the control and what the person sensed are both recorded exactly: the belief is then known, and any \
             misfit impossible",
            "/spec/control_variance",
        )
        .mend(
            "Give the variance of what recorded the control, or of the instrument that recorded the outputs \
             (instrument_variance).",
        ));
    }
    covered(&terms, &plant.b, is_applied)?;
    Ok(Design {
        plant,
        terms,
        control_weight: definite(spec.control_weight.as_ref(), "R", m, "/spec/control_weight")?,
        perceived_measurement_noise: definite(
            spec.perceived_measurement_noise.as_ref(),
            "V_p",
            p,
            "/spec/perceived_measurement_noise",
        )?,
        is_told: spec.disturbance == LqgFitDisturbance::KnownToPerson,
        timing: match spec.belief {
            LqgFitBelief::Predicted => Timing::Predictor,
            LqgFitBelief::Filtered => Timing::Filter,
        },
        recorded: Recorded { instrument, control: (control != LqgFitControl::NotUsed).then_some(recorder), is_applied },
        start: match spec.initial_state {
            LqgFitInitialState::Rest => Start::Rest,
            LqgFitInitialState::Settled => Start::Settled,
        },
    })
}

/// Refuses a noise of the motor that the process noise covers: only `W + BMBᵀ` shows, unless the applied control is
/// recorded.
fn covered(terms: &[Term], b: &DMatrix<f64>, is_applied: bool) -> Result<(), Problem> {
    let free = |role: Role| terms.iter().filter(move |t| t.role == role && t.held.is_none());
    let process: Vec<DVector<f64>> =
        free(Role::ProcessNoise).map(|term| DVector::from_column_slice(term.shape.as_slice())).collect();
    if is_applied || process.is_empty() {
        return Ok(());
    }
    for term in free(Role::MotorNoise) {
        let moved = b * &term.shape * b.transpose();
        let moved = DVector::from_column_slice(moved.as_slice());
        let (u, sigma, _) = linalg::svd(&DMatrix::from_columns(&process))
            .map_err(|error| wrong(error.to_string(), "/spec/process_noise"))?;
        let largest = sigma.first().copied().unwrap_or(0.0);
        let rank = sigma.iter().filter(|s| **s > 1e-10 * largest).count();
        let basis = u.columns(0, rank);
        let left = &moved - basis * basis.tr_mul(&moved);
        if left.norm() <= COVERED * moved.norm() {
            return Err(wrong(
                format!(
                    "{} and the process noise cannot be told apart: only their sum W + BMBᵀ moves what was recorded",
                    term.name
                ),
                "/spec/motor_noise",
            )
            .mend("Record the applied control, hold one of both, or leave the motor's noise to the process noise."));
        }
    }
    Ok(())
}
