//! The estimate of one or several trials.

use super::design::{Columns, Form, Layout};
use super::feedforward::FeedforwardBasis;
use super::lags::{Lags, LagsError, Sharing};
use super::moving_average::solve_with_moving_average;
use super::record::Record;
use super::regression::{Joint, RegressionError, Solution, solve};
use crate::ctl::{Ctl, Stopped};
use nalgebra::{DMatrix, DVector};

/// The correlation of scores that the covariance allows for, in seconds.
pub const CORRELATION_S: f64 = 0.5;

/// Rows that a record must have for each parameter.
const ROWS_FOR_EACH: usize = 5;

/// How an estimate is made.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// The lags of the regression.
    pub lags: Lags,
    /// What trials share.
    pub sharing: Sharing,
    /// The polynomial of the plant's slow zeros ([`super::feedforward::slow_zeros`]).
    pub zeros: Vec<f64>,
}

/// Why there is no estimate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EstimateError {
    /// The lags.
    #[error(transparent)]
    Lags(#[from] LagsError),
    /// There is no record.
    #[error("there is no record")]
    NoRecord,
    /// Records differ in their sample time.
    #[error("record {record} has the sample time {found} s, the first one {expected} s")]
    SampleTimes {
        /// Which record, from 0.
        record: usize,
        /// Its sample time.
        found: f64,
        /// That of the first.
        expected: f64,
    },
    /// A record is too short.
    #[error("record {record} has {rows} samples with all their lags, and {needed} are needed for its parameters")]
    TooShort {
        /// Which record, from 0.
        record: usize,
        /// Samples with all their lags.
        rows: usize,
        /// How many are needed.
        needed: usize,
    },
    /// A regressor depends on others.
    #[error("{what} depends on the other regressors: the records do not tell them apart")]
    Dependent {
        /// Which.
        what: String,
    },
    /// Nothing is left to explain.
    #[error("record {record} is explained without any error, so that nothing tells feedback from feedforward")]
    NoNoise {
        /// Which record, from 0.
        record: usize,
    },
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

/// The estimate of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordEstimate {
    pub(super) parameters: DVector<f64>,
    pub(super) covariance: DMatrix<f64>,
    /// The residuals w of the samples that have all their lags.
    pub residuals: Vec<f64>,
    /// Their mean square σ².
    pub variance: f64,
    /// The first of these samples.
    pub first: usize,
}

/// The estimate of all records.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    pub(super) lags: Lags,
    pub(super) sharing: Sharing,
    pub(super) layout: Layout,
    /// The columns of the feedforward.
    pub basis: FeedforwardBasis,
    /// Time between samples in seconds.
    pub sample_time_s: f64,
    /// Record by record.
    pub records: Vec<RecordEstimate>,
    /// `Σ n_i ln σ_i²`.
    pub deviance: f64,
    /// Whether the iterations of the moving average came to rest; true without one.
    pub settled: bool,
}

/// Estimates the controllers from records.
///
/// # Errors
/// [`EstimateError`].
pub fn estimate(records: &[Record], settings: &Settings, ctl: &Ctl) -> Result<Estimate, EstimateError> {
    estimate_form(records, settings, &Form::default(), true, ctl)
}

/// The samples over which scores may be correlated.
fn correlation(sample_time_s: f64) -> usize {
    (CORRELATION_S / sample_time_s).round().max(1.0) as usize
}

pub(super) fn estimate_form(
    records: &[Record],
    settings: &Settings,
    form: &Form,
    with_covariance: bool,
    ctl: &Ctl,
) -> Result<Estimate, EstimateError> {
    let lags = &settings.lags;
    lags.check()?;
    let first = records.first().ok_or(EstimateError::NoRecord)?;
    let basis = FeedforwardBasis::new(lags, settings.zeros.clone());
    let layout = Layout::new(lags, settings.sharing, basis.columns(), form);
    let needed = ROWS_FOR_EACH * layout.all;
    for (i, record) in records.iter().enumerate() {
        if (record.sample_time_s / first.sample_time_s - 1.0).abs() > 1e-5 {
            let (found, expected) = (record.sample_time_s, first.sample_time_s);
            return Err(EstimateError::SampleTimes { record: i, found, expected });
        }
        let rows = lags.rows(record.samples()).len();
        if rows < needed {
            return Err(EstimateError::TooShort { record: i, rows, needed });
        }
    }
    let columns = records.iter().enumerate().map(|(i, record)| {
        let block = form.blocks.as_ref().map_or(0, |blocks| blocks[i]);
        Columns::new(record, lags, &basis, &layout, block, ctl)
    });
    let correlation = correlation(first.sample_time_s);
    let found: Result<(Joint, bool), RegressionError> = if lags.moving_average == 0 {
        solve(columns, &layout, with_covariance.then_some(correlation), ctl).map(|joint| (joint, true))
    } else {
        let columns = columns.collect::<Result<Vec<_>, Stopped>>()?;
        solve_with_moving_average(&columns, &layout, correlation, ctl)
    };
    let (joint, settled) = found.map_err(|error| match error {
        RegressionError::Dependent(column) => EstimateError::Dependent { what: name(&layout, lags, column) },
        RegressionError::NoNoise(record) => EstimateError::NoNoise { record },
        RegressionError::Stopped(stopped) => EstimateError::Stopped(stopped),
    })?;
    let of = |solution: Solution, record: &Record| RecordEstimate {
        parameters: solution.parameters,
        covariance: solution.covariance,
        residuals: solution.residuals.iter().copied().collect(),
        variance: solution.variance,
        first: lags.rows(record.samples()).start,
    };
    Ok(Estimate {
        lags: lags.clone(),
        sharing: settings.sharing,
        layout,
        basis,
        sample_time_s: first.sample_time_s,
        records: joint.records.into_iter().zip(records).map(|(solution, record)| of(solution, record)).collect(),
        deviance: joint.deviance,
        settled,
    })
}

/// A column, for people.
fn name(layout: &Layout, lags: &Lags, column: usize) -> String {
    if layout.feedforward.contains(&column) {
        format!("column {} of the feedforward", column - layout.feedforward.start + 1)
    } else if layout.autoregressive.contains(&column) {
        format!("lag {} of the control", column - layout.autoregressive.start + 1)
    } else if layout.feedback.contains(&column) {
        format!("lag {} of the error", column - layout.feedback.start + lags.feedback[0])
    } else if layout.moving_average.contains(&column) {
        format!("term {} of the moving average", column - layout.moving_average.start + 1)
    } else {
        "the change of the feedback between blocks".to_owned()
    }
}

impl Estimate {
    /// The lags of the regression.
    #[must_use]
    pub fn lags(&self) -> &Lags {
        &self.lags
    }

    /// What records share.
    #[must_use]
    pub fn sharing(&self) -> Sharing {
        self.sharing
    }

    fn part(&self, record: usize, range: &std::ops::Range<usize>) -> Vec<f64> {
        self.records[record].parameters.as_slice()[range.clone()].to_vec()
    }

    /// a₁, a₂, … of a record.
    #[must_use]
    pub fn autoregressive(&self, record: usize) -> Vec<f64> {
        self.part(record, &self.layout.autoregressive)
    }

    /// The weights of the lags of e, from the least, of a record.
    #[must_use]
    pub fn feedback_weights(&self, record: usize) -> Vec<f64> {
        self.part(record, &self.layout.feedback)
    }

    /// The coefficients of the feedforward's columns of a record.
    #[must_use]
    pub fn feedforward_coefficients(&self, record: usize) -> Vec<f64> {
        self.part(record, &self.layout.feedforward)
    }

    /// c₁, c₂, … of a record.
    #[must_use]
    pub fn moving_average(&self, record: usize) -> Vec<f64> {
        self.part(record, &self.layout.moving_average)
    }

    /// How many of a record's coefficients of the feedforward its command does not determine.
    #[must_use]
    pub fn undetermined(&self, record: usize) -> usize {
        let covariance = &self.records[record].covariance;
        self.layout.feedforward.clone().filter(|j| covariance.get((*j, *j)).is_none_or(|v| *v <= 0.0)).count()
    }

    /// The parameters of a record.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.layout.all
    }
}
