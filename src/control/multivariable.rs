//! Systems with several inputs and outputs, as people write them and as algorithms take them.

use super::discretise::{DiscretiseError, zero_order_hold_state_space};
use super::matrix_fraction::{FractionError, RightFraction};
use super::model::{ModelError, StateSpaceModel, TransferFunctionModel};
use super::polynomial_matrix::{PolynomialMatrix, PolynomialMatrixError};
use super::state_space::{StateSpace, StateSpaceError};
use super::time_base::{BadSampleTime, Continuous, Discrete, TimeBase};
use super::transfer_function::{TransferFunction, TransferFunctionError};
use crate::num::Polynomial;
use nalgebra::DMatrix;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A system with any number of inputs and outputs as written in JSON; nothing about it is checked yet. Four forms:
///
/// - state space `{"a", "b", "c", "d", "sample_time_s"}`, row-major nested arrays;
/// - transfer matrix `{"transfer_functions": [[{"num", "den"}, ..], ..], "sample_time_s"}`, one row for each output;
/// - right matrix fraction `N D⁻¹` as `{"numerator": [[[..], ..], ..], "denominator": [[[..], ..], ..],
///   "sample_time_s"}`, entries in descending powers;
/// - transfer function `{"num", "den", "sample_time_s"}`, one input and one output.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum MultivariableModel {
    /// State space matrices.
    StateSpace(StateSpaceModel),
    /// A matrix of transfer functions.
    TransferMatrix(TransferMatrixModel),
    /// A right matrix fraction.
    Fraction(RightFractionModel),
    /// One transfer function.
    TransferFunction(TransferFunctionModel),
}

/// A matrix of transfer functions as written in JSON.
///
/// Entries of a column that share their denominator (number by number) share its modes; any other two denominators of a
/// column are multiplied, and modes of different columns are always different ones. Where columns share modes, give
/// state space or a fraction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TransferMatrixModel {
    /// Row by row: one row for each output, one column for each input.
    pub transfer_functions: Vec<Vec<TransferEntry>>,
    /// Sample time in seconds; null in continuous time.
    #[serde(default)]
    pub sample_time_s: Option<f64>,
}

/// An entry of a matrix of transfer functions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TransferEntry {
    /// Numerator coefficients, descending powers.
    pub num: Vec<f64>,
    /// Denominator coefficients, descending powers.
    pub den: Vec<f64>,
}

/// A right matrix fraction `N D⁻¹` as written in JSON: nested rows of coefficients in descending powers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RightFractionModel {
    /// N, p×m.
    pub numerator: Vec<Vec<Vec<f64>>>,
    /// D, m×m, column reduced.
    pub denominator: Vec<Vec<Vec<f64>>>,
    /// Sample time in seconds; null in continuous time.
    #[serde(default)]
    pub sample_time_s: Option<f64>,
}

impl<'de> Deserialize<'de> for MultivariableModel {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        fn parse<E: serde::de::Error, T: serde::de::DeserializeOwned>(value: serde_json::Value) -> Result<T, E> {
            serde_json::from_value(value).map_err(E::custom)
        }
        // serde's own untagged enums answer "did not match any variant"; the form that was meant says what is wrong.
        let value = serde_json::Value::deserialize(deserializer)?;
        if value.get("transfer_functions").is_some() {
            parse(value).map(Self::TransferMatrix)
        } else if value.get("numerator").is_some() || value.get("denominator").is_some() {
            parse(value).map(Self::Fraction)
        } else if value.get("num").is_some() || value.get("den").is_some() {
            parse(value).map(Self::TransferFunction)
        } else if value.get("a").is_some() || value.get("d").is_some() {
            parse(value).map(Self::StateSpace)
        } else {
            Err(serde::de::Error::custom(
                "a model has a, b, c and d (state space), transfer_functions, numerator and denominator (right matrix \
                 fraction), or num and den",
            ))
        }
    }
}

/// Why a [`MultivariableModel`] is no usable system.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MultivariableError {
    /// The state space matrices or the single transfer function are none.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The sample time is not positive and finite.
    #[error(transparent)]
    SampleTime(#[from] BadSampleTime),
    /// A matrix of polynomials or of transfer functions is none.
    #[error("{matrix}: {error}")]
    Matrix {
        /// `numerator`, `denominator` or `transfer_functions`.
        matrix: &'static str,
        /// What is wrong with it.
        error: PolynomialMatrixError,
    },
    /// An entry is no transfer function.
    #[error("transfer_functions, row {row}, column {column} (counted from 0): {error}")]
    Entry {
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
        /// What is wrong with it.
        error: TransferFunctionError,
    },
    /// Numerator and denominator make no fraction.
    #[error(transparent)]
    Fraction(#[from] FractionError),
    /// The realisation overflows.
    #[error(transparent)]
    StateSpace(#[from] StateSpaceError),
    /// The system cannot be sampled.
    #[error(transparent)]
    Discretise(#[from] DiscretiseError),
}

/// A checked proper system with p outputs and m inputs, in the form in which it was given.
#[derive(Debug, Clone, PartialEq)]
pub enum Multivariable<T> {
    /// State space.
    StateSpace(StateSpace<T>),
    /// Right matrix fraction.
    Fraction(RightFraction<T>),
}

/// A checked system in either time base.
#[derive(Debug, Clone, PartialEq)]
pub enum MultivariableSystem {
    /// In continuous time.
    Continuous(Multivariable<Continuous>),
    /// In sampled time.
    Discrete(Multivariable<Discrete>),
}

impl MultivariableModel {
    /// The sample time in seconds; `None` in continuous time.
    #[must_use]
    pub fn sample_time_s(&self) -> Option<f64> {
        match self {
            Self::StateSpace(m) => m.sample_time_s,
            Self::TransferMatrix(m) => m.sample_time_s,
            Self::Fraction(m) => m.sample_time_s,
            Self::TransferFunction(m) => m.sample_time_s,
        }
    }

    /// The checked system.
    ///
    /// # Errors
    /// [`MultivariableError`], which names the matrix and its size.
    pub fn check(&self) -> Result<MultivariableSystem, MultivariableError> {
        match self.sample_time_s().map(Discrete::new).transpose()? {
            None => self.check_in(Continuous).map(MultivariableSystem::Continuous),
            Some(time) => self.check_in(time).map(MultivariableSystem::Discrete),
        }
    }

    fn check_in<T: TimeBase>(&self, time: T) -> Result<Multivariable<T>, MultivariableError> {
        let polynomials = |matrix: &'static str, nested: &[Vec<Vec<f64>>]| {
            PolynomialMatrix::new(nested).map_err(|error| MultivariableError::Matrix { matrix, error })
        };
        Ok(match self {
            Self::StateSpace(m) => Multivariable::StateSpace(m.check(time)?),
            Self::Fraction(m) => Multivariable::Fraction(RightFraction::new(
                polynomials("numerator", &m.numerator)?,
                polynomials("denominator", &m.denominator)?,
                time,
            )?),
            Self::TransferFunction(m) => {
                let entry = TransferEntry { num: m.num.clone(), den: m.den.clone() };
                Multivariable::Fraction(by_columns(&[vec![entry]], time)?)
            }
            Self::TransferMatrix(m) => Multivariable::Fraction(by_columns(&m.transfer_functions, time)?),
        })
    }
}

/// The right fraction with a diagonal denominator: in each column the product of its different denominators.
fn by_columns<T: TimeBase>(entries: &[Vec<TransferEntry>], time: T) -> Result<RightFraction<T>, MultivariableError> {
    // Checks that the rows are equally long.
    let nested: Vec<Vec<Vec<f64>>> = entries.iter().map(|row| row.iter().map(|_| vec![1.0]).collect()).collect();
    let shape = PolynomialMatrix::new(&nested)
        .map_err(|error| MultivariableError::Matrix { matrix: "transfer_functions", error })?;
    let mut checked: Vec<Vec<TransferFunction<T>>> = Vec::new();
    for (row, written) in entries.iter().enumerate() {
        let row: Result<Vec<_>, _> = written
            .iter()
            .enumerate()
            .map(|(column, entry)| {
                TransferFunction::new(&entry.num, &entry.den, time).map_err(|error| MultivariableError::Entry {
                    row,
                    column,
                    error,
                })
            })
            .collect();
        checked.push(row?);
    }
    let mut different: Vec<Vec<&Polynomial>> = vec![Vec::new(); shape.columns()];
    for row in &checked {
        for (known, entry) in different.iter_mut().zip(row) {
            // A zero entry needs no denominator.
            if !entry.num().is_zero() && !known.contains(&entry.den()) {
                known.push(entry.den());
            }
        }
    }
    let product = |column: usize, without: Option<&Polynomial>| {
        different[column]
            .iter()
            .filter(|den| without != Some(**den))
            .fold(Polynomial::new(vec![1.0]), |product, den| product.mul(den))
    };
    let numerator = PolynomialMatrix::from_fn(shape.rows(), shape.columns(), |i, j| {
        let entry = &checked[i][j];
        if entry.num().is_zero() { entry.num().clone() } else { entry.num().mul(&product(j, Some(entry.den()))) }
    });
    let denominator = PolynomialMatrix::from_fn(shape.columns(), shape.columns(), |i, j| {
        if i == j { product(j, None) } else { Polynomial::new(Vec::new()) }
    });
    Ok(RightFraction::new(numerator, denominator, time)?)
}

impl<T: TimeBase> Multivariable<T> {
    /// The number of outputs, p.
    #[must_use]
    pub fn outputs(&self) -> usize {
        match self {
            Self::StateSpace(m) => m.outputs(),
            Self::Fraction(m) => m.numerator().rows(),
        }
    }

    /// The number of inputs, m.
    #[must_use]
    pub fn inputs(&self) -> usize {
        match self {
            Self::StateSpace(m) => m.inputs(),
            Self::Fraction(m) => m.numerator().columns(),
        }
    }

    /// The number of states, hidden modes included.
    #[must_use]
    pub fn states(&self) -> usize {
        match self {
            Self::StateSpace(m) => m.states(),
            Self::Fraction(m) => m.states(),
        }
    }

    /// The time base.
    #[must_use]
    pub fn time(&self) -> T {
        match self {
            Self::StateSpace(m) => m.time(),
            Self::Fraction(m) => m.time(),
        }
    }

    /// The value at infinity, p×m.
    #[must_use]
    pub(crate) fn feedthrough(&self) -> DMatrix<f64> {
        match self {
            Self::StateSpace(m) => m.d().clone(),
            Self::Fraction(m) => m.feedthrough(),
        }
    }

    /// The value at a point of the complex plane, p×m; `None` at a pole.
    #[must_use]
    pub fn eval(&self, x: Complex64) -> Option<DMatrix<Complex64>> {
        match self {
            Self::StateSpace(m) => m.eval(x),
            Self::Fraction(m) => m.eval(x),
        }
    }

    /// A state space form with the same modes.
    ///
    /// # Errors
    /// [`StateSpaceError`] where a coefficient overflows.
    pub fn to_state_space(&self) -> Result<StateSpace<T>, StateSpaceError> {
        match self {
            Self::StateSpace(m) => Ok(m.clone()),
            Self::Fraction(m) => m.to_state_space(),
        }
    }
}

impl Multivariable<Continuous> {
    /// The exact samples behind a zero-order hold, in state space.
    ///
    /// # Errors
    /// [`MultivariableError`] where the realisation or the matrix exponential overflows.
    pub fn zero_order_hold(&self, time: Discrete) -> Result<Multivariable<Discrete>, MultivariableError> {
        let model = self.to_state_space()?.balanced();
        Ok(Multivariable::StateSpace(zero_order_hold_state_space(&model, time)?))
    }
}

fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

impl<T: TimeBase> From<&Multivariable<T>> for MultivariableModel {
    fn from(system: &Multivariable<T>) -> Self {
        let sample_time_s = system.time().sample_time_s();
        match system {
            Multivariable::StateSpace(m) => Self::StateSpace(StateSpaceModel {
                a: rows(m.a()),
                b: rows(m.b()),
                c: rows(m.c()),
                d: rows(m.d()),
                sample_time_s,
            }),
            Multivariable::Fraction(m) => Self::Fraction(RightFractionModel {
                numerator: m.numerator().to_nested(),
                denominator: m.denominator().to_nested(),
                sample_time_s,
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn system(value: serde_json::Value) -> Result<MultivariableSystem, String> {
        let model: MultivariableModel = serde_json::from_value(value).map_err(|e| e.to_string())?;
        model.check().map_err(|e| e.to_string())
    }

    fn discrete(value: serde_json::Value) -> Multivariable<Discrete> {
        match system(value).unwrap() {
            MultivariableSystem::Discrete(system) => system,
            MultivariableSystem::Continuous(system) => panic!("{system:?}"),
        }
    }

    #[test]
    fn all_forms_agree_on_one_system() {
        // Two outputs of one chain: 1/(z - 0.5) and 0.3 z/((z - 0.5)(z - 0.2)), and a second input to the first output.
        let matrix = discrete(json!({"transfer_functions": [
            [{"num": [1.0], "den": [1.0, -0.5]}, {"num": [2.0], "den": [1.0, 0.1]}],
            [{"num": [0.3, 0.0], "den": [1.0, -0.7, 0.1]}, {"num": [0], "den": [1.0, 9.0]}],
        ], "sample_time_s": 0.1}));
        assert_eq!((matrix.outputs(), matrix.inputs(), matrix.states()), (2, 2, 4));
        let x = Complex64::new(0.3, 0.8);
        let (a, b) = (1.0 / (x - 0.5), 0.3 * x / ((x - 0.5) * (x - 0.2)));
        let expected = DMatrix::from_row_slice(2, 2, &[a, 2.0 / (x + 0.1), b, Complex64::new(0.0, 0.0)]);
        let fraction = discrete(json!({
            "numerator": [[[1.0, -0.2], [2.0]], [[0.3, 0.0], [0.0]]],
            "denominator": [[[1.0, -0.7, 0.1], [0.0]], [[0.0], [1.0, 0.1]]],
            "sample_time_s": 0.1,
        }));
        assert_eq!(fraction.states(), 3);
        let realised = Multivariable::StateSpace(fraction.to_state_space().unwrap());
        for form in [&matrix, &fraction, &realised] {
            let difference = form.eval(x).unwrap() - &expected;
            assert!(difference.iter().all(|d| d.norm() < 1e-14), "{form:?} {difference}");
            let again = discrete(json!(MultivariableModel::from(form)));
            assert!((again.eval(x).unwrap() - &expected).iter().all(|d| d.norm() < 1e-14));
        }
    }

    #[test]
    fn a_sampled_integrator_pair() {
        let MultivariableSystem::Continuous(continuous) = system(json!({"transfer_functions": [
            [{"num": [1.0], "den": [1.0, 0.0]}, {"num": [0.0], "den": [1.0]}],
            [{"num": [0.0], "den": [1.0]}, {"num": [1.0], "den": [1.0, 2.0]}],
        ]}))
        .unwrap() else {
            panic!()
        };
        let sampled = continuous.zero_order_hold(Discrete::new(0.1).unwrap()).unwrap();
        let x = Complex64::new(0.0, 1.0);
        let value = sampled.eval(x).unwrap();
        let decay = (-0.2_f64).exp();
        assert!((value[(0, 0)] - 0.1 / (x - 1.0)).norm() < 1e-15);
        assert!((value[(1, 1)] - 0.5 * (1.0 - decay) / (x - decay)).norm() < 1e-15);
        assert!(value[(0, 1)].norm() == 0.0 && value[(1, 0)].norm() == 0.0);
    }

    #[test]
    fn refusals_name_matrix_and_size() {
        for (value, words) in [
            (json!({"x": 1}), "transfer_functions"),
            (json!({"transfer_functions": [[{"num": [1], "den": [1]}], []]}), "ragged"),
            (json!({"transfer_functions": [[{"num": [1], "den": [0]}]]}), "row 0, column 0"),
            (json!({"transfer_functions": [[{"num": [1, 0], "den": [1]}]]}), "improper"),
            (json!({"numerator": [[[1], [1]]], "denominator": [[[1, 0]]]}), "must be 2x2"),
            (json!({"numerator": [[[1]]]}), "denominator"),
            (json!({"numerator": [[[]]], "denominator": [[[1, 0]]]}), "numerator: the entry"),
            (json!({"a": [[0.5]], "b": [[1, 1]], "c": [[1], [1]], "d": [[0, 0]], "sample_time_s": 1}), "C is 2x1"),
            (json!({"num": [1], "den": [1, 0.5], "sample_time_s": -1}), "sample time"),
        ] {
            let error = system(value.clone()).unwrap_err();
            assert!(error.contains(words), "{value}: {error}");
        }
    }
}
