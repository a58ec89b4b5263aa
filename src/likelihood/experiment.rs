//! The residuals of all trials and their derivatives.
//!
//! Where the initial states are not known, each trial's is estimated along: the response depends on it linearly, `ŷ =
//! ŷ₀ + Ψ x₀` with the rows `C Aᵏ` of Ψ, so it is projected out. With Q an orthonormal basis of Ψ the residuals are `(I
//! − QQᵀ) e` and their derivatives `(I − QQᵀ) ∂e` at the best x₀ (Kaufman 1975): the gradient and Fisher's information
//! are exact.

use super::model::LoopModel;
use crate::control::Discrete;
use crate::control::parametric::Differentiated;
use crate::num::linalg;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// A direction of the initial state whose response is this small beside the others leaves no trace in the samples.
const TRACE: f64 = 1e-9;
/// Entries from which a matrix is decomposed by blocks.
const LARGE: usize = 100_000;

/// Samples times outputs of all trials, times parameters, at most: the derivatives are held in memory.
pub const MAX_NUMBERS: usize = 20_000_000;

/// A trial as the model takes it.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Inputs of the model, samples × inputs.
    pub stimulus: DMatrix<f64>,
    /// What its outputs are compared with, samples × outputs.
    pub target: DMatrix<f64>,
    /// The initial state of all of the model; `None` for that of the model itself.
    pub initial: Option<DVector<f64>>,
}

/// Trials with the model that they are to identify.
pub struct Experiment<'a> {
    model: &'a dyn LoopModel,
    time: Discrete,
    records: Vec<Record>,
    /// For each record the first one with the same stimulus and initial state.
    twins: Vec<usize>,
    estimate_initial: bool,
    samples: usize,
    sizes: Vec<f64>,
}

/// Trials that do not fit the model.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ExperimentError {
    /// No trial.
    #[error("there is no trial")]
    Empty,
    /// A signal has the wrong number of columns, or another length than the other.
    #[error(
        "the {signal} of trial {trial} (counted from 0) is {rows}x{columns} and must be \
         {expected_rows}x{expected_columns}"
    )]
    Size {
        /// The trial.
        trial: usize,
        /// `stimulus`, `target` or `initial state`.
        signal: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
        /// Rows that it must have.
        expected_rows: usize,
        /// Columns that it must have.
        expected_columns: usize,
    },
    /// Fewer numbers than unknowns.
    #[error("{numbers} numbers were measured in all; {unknowns} unknowns need more")]
    TooShort {
        /// Samples times outputs.
        numbers: usize,
        /// Parameters, and initial states where they are estimated.
        unknowns: usize,
    },
    /// More derivatives than are held.
    #[error(
        "{numbers} numbers were measured in all, and there are {parameters} parameters; their product may be \
         {MAX_NUMBERS} at most"
    )]
    TooLong {
        /// Samples times outputs.
        numbers: usize,
        /// Parameters.
        parameters: usize,
    },
    /// All outputs are zero.
    #[error("every output is zero at all times: there is nothing to explain")]
    Silent,
}

/// The residuals at θ.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// Whitened residuals: trial by trial, sample by sample, output by output.
    pub residuals: DVector<f64>,
    /// Their derivatives; no columns where they were not asked for.
    pub jacobian: DMatrix<f64>,
    /// Initial states that were estimated, one for each trial.
    pub initials: Vec<DVector<f64>>,
    /// Directions of initial states that were estimated, in all.
    pub nuisances: usize,
}

/// Of one trial.
struct Part {
    residuals: DVector<f64>,
    jacobian: DMatrix<f64>,
    initial: Option<DVector<f64>>,
    nuisances: usize,
}

impl<'a> Experiment<'a> {
    /// The same trials with another model of the same ports.
    #[must_use]
    pub fn with_model<'b>(&self, model: &'b dyn LoopModel) -> Experiment<'b> {
        Experiment {
            model,
            time: self.time,
            records: self.records.clone(),
            twins: self.twins.clone(),
            estimate_initial: self.estimate_initial,
            samples: self.samples,
            sizes: self.sizes.clone(),
        }
    }

    /// Trials of one sample time.
    ///
    /// # Errors
    /// [`ExperimentError`].
    pub fn new(
        model: &'a dyn LoopModel,
        time: Discrete,
        records: Vec<Record>,
        estimate_initial: bool,
    ) -> Result<Self, ExperimentError> {
        let (inputs, outputs) = model.ports();
        if records.is_empty() {
            return Err(ExperimentError::Empty);
        }
        for (trial, record) in records.iter().enumerate() {
            let rows = record.target.nrows();
            for (signal, found, columns) in
                [("stimulus", &record.stimulus, inputs), ("target", &record.target, outputs)]
            {
                if found.shape() != (rows, columns) {
                    return Err(ExperimentError::Size {
                        trial,
                        signal,
                        rows: found.nrows(),
                        columns: found.ncols(),
                        expected_rows: rows,
                        expected_columns: columns,
                    });
                }
            }
        }
        let samples: usize = records.iter().map(|r| r.target.nrows()).sum();
        let numbers = samples * outputs;
        let parameters = model.names().len();
        if numbers.saturating_mul(parameters) > MAX_NUMBERS {
            return Err(ExperimentError::TooLong { numbers, parameters });
        }
        let unknowns = parameters + outputs * (outputs + 1) / 2;
        if numbers < 2 * unknowns {
            return Err(ExperimentError::TooShort { numbers, unknowns });
        }
        let size = |output: usize| {
            let squares: f64 = records.iter().map(|r| r.target.column(output).norm_squared()).sum();
            (squares / samples as f64).sqrt()
        };
        let sizes: Vec<f64> = (0..outputs).map(size).collect();
        if sizes.iter().all(|s| *s == 0.0) {
            return Err(ExperimentError::Silent);
        }
        let same = |x: &Record, y: &Record| x.stimulus == y.stimulus && x.initial == y.initial;
        let twins = records
            .iter()
            .enumerate()
            .map(|(i, record)| records[..i].iter().position(|other| same(other, record)).unwrap_or(i))
            .collect();
        Ok(Self { model, time, records, twins, estimate_initial, samples, sizes })
    }

    /// The model.
    #[must_use]
    pub fn model(&self) -> &dyn LoopModel {
        self.model
    }

    /// The sample time.
    #[must_use]
    pub fn time(&self) -> Discrete {
        self.time
    }

    /// The trials.
    #[must_use]
    pub fn records(&self) -> &[Record] {
        &self.records
    }

    /// Samples of all trials.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// The root mean square of each output.
    #[must_use]
    pub fn sizes(&self) -> &[f64] {
        &self.sizes
    }

    /// p.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.sizes.len()
    }

    /// The largest modulus of the poles of the loop at θ; `None` where there is no loop.
    #[must_use]
    pub fn spectral_radius(&self, theta: &[f64]) -> Option<f64> {
        let model = self.model.sampled(theta, self.time, false)?.value.model;
        let poles = linalg::eigenvalues(model.a()).ok()?;
        Some(poles.iter().map(|p| p.norm()).fold(0.0, f64::max))
    }

    /// The residuals at θ, multiplied by the whitening matrix (p×p), with their derivatives if asked; `None` where the
    /// model is not defined or runs away.
    #[must_use]
    pub fn evaluate(&self, theta: &[f64], whitening: &DMatrix<f64>, slopes: bool) -> Option<Evaluation> {
        let model = self.model.sampled(theta, self.time, slopes)?;
        let parts: Option<Vec<Part>> = if self.estimate_initial {
            self.records.par_iter().map(|record| projected(&model, record, whitening)).collect()
        } else {
            self.shared(&model, whitening)
        };
        let parts = parts?;
        let rows = self.samples * self.outputs();
        let columns = if slopes { theta.len() } else { 0 };
        let mut evaluation = Evaluation {
            residuals: DVector::zeros(rows),
            jacobian: DMatrix::zeros(rows, columns),
            initials: Vec::new(),
            nuisances: 0,
        };
        let mut first = 0;
        for part in parts {
            let count = part.residuals.len();
            evaluation.residuals.rows_mut(first, count).copy_from(&part.residuals);
            evaluation.jacobian.view_mut((first, 0), (count, columns)).copy_from(&part.jacobian);
            evaluation.initials.extend(part.initial);
            evaluation.nuisances += part.nuisances;
            first += count;
        }
        evaluation.residuals.iter().all(|v| v.is_finite()).then_some(evaluation)
    }

    /// Trials whose initial states are known: those with the same input share their simulation.
    fn shared(&self, model: &Differentiated<Discrete>, whitening: &DMatrix<f64>) -> Option<Vec<Part>> {
        let responses: Vec<Option<(DVector<f64>, DMatrix<f64>)>> = self
            .records
            .par_iter()
            .enumerate()
            .map(|(i, record)| {
                if self.twins[i] != i {
                    return Some((DVector::zeros(0), DMatrix::zeros(0, 0)));
                }
                let mut started = model.clone();
                if let Some(initial) = &record.initial {
                    started.value.initial.copy_from(initial);
                }
                let found = started.respond(&record.stimulus).ok()?;
                let response = whitened(&found.output, whitening);
                let slopes = columns(&found.slopes, response.len(), whitening);
                Some((response, slopes))
            })
            .collect();
        let responses: Option<Vec<_>> = responses.into_iter().collect();
        let responses = responses?;
        let part = |(i, record): (usize, &Record)| {
            let (response, jacobian) = &responses[self.twins[i]];
            let residuals = whitened(&record.target, whitening) - response;
            Part { residuals, jacobian: -jacobian, initial: None, nuisances: 0 }
        };
        Some(self.records.iter().enumerate().map(part).collect())
    }

    /// `Σ_k e_k e_kᵀ` of residuals that were multiplied by `whitening`.
    #[must_use]
    pub fn scatter(&self, residuals: &DVector<f64>, whitening: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let p = self.outputs();
        let white = DMatrix::from_column_slice(p, residuals.len() / p, residuals.as_slice());
        let errors = whitening.clone().solve_lower_triangular(&white)?;
        Some(&errors * errors.transpose())
    }

    /// The residuals in the units of the outputs, trial by trial, samples × outputs.
    #[must_use]
    pub fn errors(&self, residuals: &DVector<f64>, whitening: &DMatrix<f64>) -> Option<Vec<DMatrix<f64>>> {
        let p = self.outputs();
        let white = DMatrix::from_column_slice(p, residuals.len() / p, residuals.as_slice());
        let errors = whitening.clone().solve_lower_triangular(&white)?.transpose();
        let mut first = 0;
        let each = self.records.iter().map(|record| {
            let count = record.target.nrows();
            first += count;
            errors.rows(first - count, count).into_owned()
        });
        Some(each.collect())
    }
}

/// A signal, samples × p, multiplied by W sample by sample and stacked.
fn whitened(signal: &DMatrix<f64>, whitening: &DMatrix<f64>) -> DVector<f64> {
    let product = whitening * signal.transpose();
    DVector::from_column_slice(product.as_slice())
}

fn columns(slopes: &[DMatrix<f64>], rows: usize, whitening: &DMatrix<f64>) -> DMatrix<f64> {
    let mut all = DMatrix::zeros(rows, slopes.len());
    for (j, slope) in slopes.iter().enumerate() {
        all.set_column(j, &whitened(slope, whitening));
    }
    all
}

/// A trial whose initial state is not known.
fn projected(model: &Differentiated<Discrete>, record: &Record, whitening: &DMatrix<f64>) -> Option<Part> {
    let samples = record.target.nrows();
    let mut resting = Differentiated { value: model.value.clone(), slopes: Vec::new() };
    resting.value.initial.fill(0.0);
    let forced = resting.respond(&record.stimulus).ok()?;
    let mut residuals = whitened(&(&record.target - forced.output), whitening);
    let p = record.target.ncols();
    let free = free_responses(&(whitening * model.value.model.c()), model.value.model.a(), samples);
    let (basis, triangle) = orthonormal(free)?;
    let across = basis.transpose();
    let coefficients = &across * &residuals;
    // x₀ = Σ over the directions that leave a trace.
    let initial = &triangle * &coefficients;
    residuals -= &basis * coefficients;
    let nuisances = basis.ncols();
    let mut jacobian = DMatrix::zeros(samples * p, model.slopes.len());
    if !model.slopes.is_empty() {
        let mut started = model.clone();
        started.value.initial.copy_from(&initial);
        for slope in &mut started.slopes {
            slope.initial.fill(0.0);
        }
        jacobian = -columns(&started.respond(&record.stimulus).ok()?.slopes, samples * p, whitening);
        let within = &across * &jacobian;
        jacobian.gemm(-1.0, &basis, &within, 1.0);
    }
    Some(Part { residuals, jacobian, initial: Some(initial), nuisances })
}

/// The rows `C Aᵏ`, k from 0, of all samples, samples·p × n. By doubling: products of large matrices take a tenth of
/// the time of one row after another.
fn free_responses(c: &DMatrix<f64>, a: &DMatrix<f64>, samples: usize) -> DMatrix<f64> {
    let (p, n) = c.shape();
    let mut rows = DMatrix::zeros(samples * p, n);
    rows.rows_mut(0, p).copy_from(c);
    let (mut known, mut power) = (1, a.clone());
    while known < samples {
        let more = known.min(samples - known);
        let next = rows.rows(0, more * p) * &power;
        rows.rows_mut(known * p, more * p).copy_from(&next);
        known += more;
        if known < samples {
            power = &power * &power;
        }
    }
    rows
}

/// Q and R of a tall matrix; of a large one by blocks.
fn thin_qr(m: DMatrix<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
    if m.len() < LARGE {
        let qr = m.qr();
        return (qr.q(), qr.r());
    }
    let qr = faer::MatRef::from_column_major_slice(m.as_slice(), m.nrows(), m.ncols()).qr();
    let (q, r) = (qr.compute_thin_Q(), qr.thin_R());
    let from = |rows, columns, m: faer::MatRef<'_, f64>| DMatrix::from_fn(rows, columns, |i, j| m[(i, j)]);
    (from(m.nrows(), m.ncols(), q.as_ref()), from(m.ncols(), m.ncols(), r))
}

/// An orthonormal basis Q of the columns of Ψ, and the matrix T with `Ψ T = Q`.
fn orthonormal(free: DMatrix<f64>) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
    let n = free.ncols();
    let lengths: Vec<f64> = free.column_iter().map(|c| c.norm()).collect();
    let longest = lengths.iter().copied().fold(0.0, f64::max);
    // Columns of one length, so that units of the states do not matter.
    let kept: Vec<usize> = (0..n).filter(|j| lengths[*j] > TRACE * longest).collect();
    let scaled = DMatrix::from_fn(free.nrows(), kept.len(), |i, j| free[(i, kept[j])] / lengths[kept[j]]);
    if kept.is_empty() {
        return Some((DMatrix::zeros(free.nrows(), 0), DMatrix::zeros(n, 0)));
    }
    let (q, r) = thin_qr(scaled);
    let (u, sigma, v) = linalg::svd(&r).ok()?;
    let rank = sigma.iter().filter(|s| **s > TRACE * sigma[0]).count();
    let basis = q * u.columns(0, rank);
    let triangle = DMatrix::from_fn(n, rank, |i, j| {
        kept.iter().position(|k| *k == i).map_or(0.0, |at| v[(at, j)] / (sigma[j] * lengths[i]))
    });
    Some((basis, triangle))
}
