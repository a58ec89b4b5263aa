//! Models as people write them (unchecked) and as algorithms take them (checked).

use super::time_base::{BadSampleTime, Continuous, Discrete};
use super::transfer_function::{TransferFunction, TransferFunctionError};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A linear time-invariant system as written in JSON; nothing about it is checked yet.
///
/// A transfer function `{"num", "den", "sample_time_s"}` has its coefficients in descending powers; a state space model
/// `{"a", "b", "c", "d", "sample_time_s"}` has row-major nested arrays. `sample_time_s` is null (or absent) in
/// continuous time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum Model {
    /// Rational transfer function.
    TransferFunction(TransferFunctionModel),
    /// State space matrices.
    StateSpace(StateSpaceModel),
}

/// A transfer function as written in JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0], "sample_time_s": null}))]
pub struct TransferFunctionModel {
    /// Numerator coefficients, descending powers.
    pub num: Vec<f64>,
    /// Denominator coefficients, descending powers.
    pub den: Vec<f64>,
    /// Sample time in seconds; null in continuous time.
    #[serde(default)]
    pub sample_time_s: Option<f64>,
}

/// A state space model as written in JSON, row-major.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
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
}
