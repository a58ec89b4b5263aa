//! Models as people write them (unchecked) and as algorithms take them (checked).

use super::conversion::{self, ConversionError};
use super::state_space::{StateSpace, StateSpaceError};
use super::time_base::{BadSampleTime, Continuous, Discrete, TimeBase};
use super::transfer_function::{TransferFunction, TransferFunctionError};
use crate::num::Polynomial;
use crate::num::linalg::NoConvergence;
use nalgebra::DMatrix;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A linear time-invariant system as written in JSON; nothing about it is checked yet.
///
/// A transfer function `{"num", "den", "sample_time_s"}` has its coefficients in descending powers; a state space model
/// `{"a", "b", "c", "d", "sample_time_s"}` has row-major nested arrays. `sample_time_s` is null (or absent) in
/// continuous time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, try_from = "Fields")]
#[schemars(!try_from)]
pub enum Model {
    /// Rational transfer function.
    TransferFunction(TransferFunctionModel),
    /// State space matrices.
    StateSpace(StateSpaceModel),
}

/// A transfer function as written in JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(example = serde_json::json!({"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0], "sample_time_s": null}))]
pub struct TransferFunctionModel {
    /// Numerator coefficients, descending powers.
    pub num: Vec<f64>,
    /// Denominator coefficients, descending powers.
    pub den: Vec<f64>,
    /// Sample time in seconds; null in continuous time.
    #[serde(default)]
    pub sample_time_s: Option<f64>,
    /// A pure delay behind it in seconds, `G e^{−sτ}`; of a sampled system whole samples. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay_s: Option<f64>,
}

/// A state space model as written in JSON, row-major.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StateSpaceModel {
    /// State matrix, n×n.
    pub a: Vec<Vec<f64>>,
    /// Input matrix, n×m.
    pub b: Vec<Vec<f64>>,
    /// Output matrix, p×n.
    pub c: Vec<Vec<f64>>,
    /// Feedthrough matrix, p×m.
    pub d: Vec<Vec<f64>>,
    /// Sample time in seconds; null in continuous time.
    #[serde(default)]
    pub sample_time_s: Option<f64>,
}

/// A checked single-input single-output system.
#[derive(Debug, Clone, PartialEq)]
pub enum System {
    /// In continuous time.
    Continuous(TransferFunction<Continuous>),
    /// In sampled time.
    Discrete(TransferFunction<Discrete>),
}

/// Why a [`Model`] is no usable system.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// The coefficients are no transfer function.
    #[error(transparent)]
    TransferFunction(#[from] TransferFunctionError),
    /// The sample time is not positive and finite.
    #[error(transparent)]
    SampleTime(#[from] BadSampleTime),
    /// Rows of a matrix differ in length.
    #[error(
        "{matrix} is ragged: row {row} (counted from 0) has {columns} columns, and row 0 has {expected}; matrices are \
         nested arrays, row by row"
    )]
    Ragged {
        /// `A`, `B`, `C` or `D`.
        matrix: &'static str,
        /// The first row that differs, from 0.
        row: usize,
        /// Its number of columns.
        columns: usize,
        /// The number of columns of row 0.
        expected: usize,
    },
    /// A delay that cannot be.
    #[error("the delay is {delay_s} s, and {why}")]
    Delay {
        /// The delay.
        delay_s: f64,
        /// What it must be.
        why: &'static str,
    },
    /// The matrices are no state space model.
    #[error(transparent)]
    StateSpace(#[from] StateSpaceError),
    /// The state space model has no (usable) transfer function.
    #[error(transparent)]
    Conversion(#[from] ConversionError),
}

/// How many states, inputs and outputs a model has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ModelShape {
    /// Number of states, n; for a transfer function the degree of its denominator.
    pub states: usize,
    /// Number of inputs, m.
    pub inputs: usize,
    /// Number of outputs, p.
    pub outputs: usize,
}

/// Both forms of a model at once, as they are read: only so can an error name the field that is missing.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Fields {
    num: Option<Vec<f64>>,
    den: Option<Vec<f64>>,
    a: Option<Vec<Vec<f64>>>,
    b: Option<Vec<Vec<f64>>>,
    c: Option<Vec<Vec<f64>>>,
    d: Option<Vec<Vec<f64>>>,
    sample_time_s: Option<f64>,
    delay_s: Option<f64>,
}

impl TryFrom<Fields> for Model {
    type Error = String;

    fn try_from(fields: Fields) -> Result<Self, String> {
        const FORMS: &str = "a model has either num and den (transfer function) or a, b, c and d (state space)";
        let Fields { num, den, a, b, c, d, sample_time_s, delay_s } = fields;
        if delay_s.is_some() && num.is_none() {
            return Err("delay_s belongs to a transfer function, num and den".to_owned());
        }
        let given: Vec<&str> = [
            ("num", num.is_some()),
            ("den", den.is_some()),
            ("a", a.is_some()),
            ("b", b.is_some()),
            ("c", c.is_some()),
            ("d", d.is_some()),
        ]
        .into_iter()
        .filter_map(|(name, is_given)| is_given.then_some(name))
        .collect();
        match (num, den, a, b, c, d) {
            (Some(num), Some(den), None, None, None, None) => {
                Ok(Self::TransferFunction(TransferFunctionModel { num, den, sample_time_s, delay_s }))
            }
            (None, None, Some(a), Some(b), Some(c), Some(d)) => {
                Ok(Self::StateSpace(StateSpaceModel { a, b, c, d, sample_time_s }))
            }
            _ if given.is_empty() => Err(format!("{FORMS}; this one has neither")),
            _ => Err(format!("{FORMS}; this one has {}", given.join(", "))),
        }
    }
}

/// A model in its own form, with its time base.
enum Checked {
    TransferFunction(System),
    Continuous(StateSpace<Continuous>),
    Discrete(StateSpace<Discrete>),
}

impl Model {
    /// The sample time in seconds; `None` in continuous time.
    #[must_use]
    pub fn sample_time_s(&self) -> Option<f64> {
        match self {
            Self::TransferFunction(m) => m.sample_time_s,
            Self::StateSpace(m) => m.sample_time_s,
        }
    }

    /// The checked single-input single-output system; a state space model is converted to its transfer function
    /// ([`conversion::to_transfer_function`]).
    ///
    /// # Errors
    /// [`ModelError`], also for a model with several inputs or outputs, and for a continuous one with a delay, which is
    /// no rational function ([`Model::check_delayed`] takes it).
    pub fn check(&self) -> Result<System, ModelError> {
        match self.check_delayed()? {
            (system, 0.0) => Ok(system),
            (_, delay_s) => Err(ModelError::Delay {
                delay_s,
                why: "only ssid takes a plant with a delay in continuous time; in sampled time any kind does",
            }),
        }
    }

    /// The checked system and the delay behind it in seconds, which is 0 for a sampled system: whole samples are poles
    /// at the origin.
    ///
    /// # Errors
    /// [`ModelError`], also for a model with several inputs or outputs.
    pub fn check_delayed(&self) -> Result<(System, f64), ModelError> {
        let delay_s = match self {
            Self::TransferFunction(m) => m.delay_s.unwrap_or(0.0),
            Self::StateSpace(_) => 0.0,
        };
        Ok(match self.checked()? {
            Checked::TransferFunction(system @ System::Continuous(_)) => (system, delay_s),
            // With its samples of delay already.
            Checked::TransferFunction(system) => (system, 0.0),
            Checked::Continuous(model) => (System::Continuous(conversion::to_transfer_function(&model)?), 0.0),
            Checked::Discrete(model) => (System::Discrete(conversion::to_transfer_function(&model)?), 0.0),
        })
    }

    /// The number of states, inputs and outputs of any well-formed model, several inputs and outputs included.
    ///
    /// # Errors
    /// [`ModelError`] where sizes disagree, rows are ragged, the sample time is not positive, or a coefficient is not
    /// finite.
    pub fn shape(&self) -> Result<ModelShape, ModelError> {
        fn shape<T: TimeBase>(model: &StateSpace<T>) -> ModelShape {
            ModelShape { states: model.states(), inputs: model.inputs(), outputs: model.outputs() }
        }
        Ok(match self.checked()? {
            Checked::TransferFunction(system) => ModelShape { states: system.den().degree(), inputs: 1, outputs: 1 },
            Checked::Continuous(model) => shape(&model),
            Checked::Discrete(model) => shape(&model),
        })
    }

    fn checked(&self) -> Result<Checked, ModelError> {
        let time = self.sample_time_s().map(Discrete::new).transpose()?;
        match self {
            Self::TransferFunction(m) => {
                let delay_s = m.delay_s.unwrap_or(0.0);
                if !(delay_s >= 0.0 && delay_s.is_finite()) {
                    return Err(ModelError::Delay { delay_s, why: "must be a number that is not negative" });
                }
                Ok(Checked::TransferFunction(match time {
                    None => System::Continuous(TransferFunction::new(&m.num, &m.den, Continuous)?),
                    Some(time) => {
                        let samples = whole_samples(delay_s, time.period_s())?;
                        let den = [m.den.as_slice(), &vec![0.0; samples]].concat();
                        System::Discrete(TransferFunction::new(&m.num, &den, time)?)
                    }
                }))
            }
            Self::StateSpace(m) => Ok(match time {
                None => Checked::Continuous(m.check(Continuous)?),
                Some(time) => Checked::Discrete(m.check(time)?),
            }),
        }
    }
}

/// Samples of delay at most: each is a pole.
const MOST_SAMPLES: f64 = 200.0;

/// How many samples a delay is.
///
/// # Errors
/// [`ModelError::Delay`] where it is no whole number of them.
pub fn whole_samples(delay_s: f64, sample_time_s: f64) -> Result<usize, ModelError> {
    let samples = delay_s / sample_time_s;
    if (samples - samples.round()).abs() > 1e-6 * samples.max(1.0) {
        return Err(ModelError::Delay { delay_s, why: "must be whole samples in sampled time" });
    }
    if samples > MOST_SAMPLES {
        return Err(ModelError::Delay { delay_s, why: "may be 200 samples at most in sampled time" });
    }
    Ok(samples.round() as usize)
}

impl StateSpaceModel {
    /// The checked matrices in the given time base, several inputs and outputs included.
    ///
    /// # Errors
    /// [`ModelError`] where a matrix is ragged, sizes disagree or an entry is not finite.
    pub fn check<T: TimeBase>(&self, time: T) -> Result<StateSpace<T>, ModelError> {
        let (a, d) = (matrix("A", &self.a)?, matrix("D", &self.d)?);
        // Without states B has no rows to count columns in, and C may be written without rows.
        let empty = a.nrows() == 0;
        let b = if empty && self.b.is_empty() { DMatrix::zeros(0, d.ncols()) } else { matrix("B", &self.b)? };
        let c = if empty && self.c.is_empty() { DMatrix::zeros(d.nrows(), 0) } else { matrix("C", &self.c)? };
        Ok(StateSpace::new(a, b, c, d, time)?)
    }
}

/// The matrix written as nested rows.
fn matrix(name: &'static str, rows: &[Vec<f64>]) -> Result<DMatrix<f64>, ModelError> {
    let columns = rows.first().map_or(0, Vec::len);
    if let Some(row) = rows.iter().position(|r| r.len() != columns) {
        return Err(ModelError::Ragged { matrix: name, row, columns: rows[row].len(), expected: columns });
    }
    Ok(DMatrix::from_fn(rows.len(), columns, |i, j| rows[i][j]))
}

impl System {
    /// The frequency response at the angular frequency `omega_rad_s`; not finite where a pole lies there.
    #[must_use]
    pub fn response(&self, omega_rad_s: f64) -> Complex64 {
        match self {
            Self::Continuous(system) => system.response(omega_rad_s),
            Self::Discrete(system) => system.response(omega_rad_s),
        }
    }

    /// The sample time in seconds; `None` in continuous time.
    #[must_use]
    pub fn sample_time_s(&self) -> Option<f64> {
        match self {
            Self::Continuous(_) => None,
            Self::Discrete(system) => Some(system.time().period_s()),
        }
    }

    /// The numerator.
    #[must_use]
    pub fn num(&self) -> &Polynomial {
        match self {
            Self::Continuous(system) => system.num(),
            Self::Discrete(system) => system.num(),
        }
    }

    /// The denominator.
    #[must_use]
    pub fn den(&self) -> &Polynomial {
        match self {
            Self::Continuous(system) => system.den(),
            Self::Discrete(system) => system.den(),
        }
    }

    /// Degree of the denominator minus degree of the numerator; negative for an improper system.
    #[must_use]
    pub(crate) fn relative_degree(&self) -> i64 {
        self.den().degree() as i64 - self.num().degree() as i64
    }

    /// The roots of the denominator.
    ///
    /// # Errors
    /// [`NoConvergence`] if the eigenvalue iteration fails.
    pub fn poles(&self) -> Result<Vec<Complex64>, NoConvergence> {
        self.den().roots()
    }

    /// The roots of the numerator.
    ///
    /// # Errors
    /// [`NoConvergence`] if the eigenvalue iteration fails.
    pub fn zeros(&self) -> Result<Vec<Complex64>, NoConvergence> {
        self.num().roots()
    }

    /// As written in JSON.
    #[must_use]
    pub fn to_model(&self) -> Model {
        Model::TransferFunction(TransferFunctionModel {
            num: self.num().coefficients().to_vec(),
            den: self.den().coefficients().to_vec(),
            sample_time_s: self.sample_time_s(),
            delay_s: None,
        })
    }
}

impl From<TransferFunction<Continuous>> for System {
    fn from(system: TransferFunction<Continuous>) -> Self {
        Self::Continuous(system)
    }
}

impl From<TransferFunction<Discrete>> for System {
    fn from(system: TransferFunction<Discrete>) -> Self {
        Self::Discrete(system)
    }
}

impl<T: TimeBase> From<&TransferFunction<T>> for TransferFunctionModel {
    fn from(system: &TransferFunction<T>) -> Self {
        Self {
            num: system.num().coefficients().to_vec(),
            den: system.den().coefficients().to_vec(),
            sample_time_s: system.time().sample_time_s(),
            delay_s: None,
        }
    }
}
