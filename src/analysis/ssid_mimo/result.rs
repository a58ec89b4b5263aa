//! The result of a multivariable identification.

use crate::analysis::ssid::Stability;
use crate::control::model::TransferFunctionModel;
use crate::control::transfer_function::TransferFunctionError;
use crate::control::{Discrete, LeftFraction, MultivariableModel};
use crate::identify::identifiability::Identifiability;
use crate::identify::mimo::{Identified, Plant};
use crate::identify::problem::NEAR;
use crate::identify::time::Time;
use nalgebra::DMatrix;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A controller as left matrix fraction `D⁻¹ N` and as transfer matrix.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MatrixFraction {
    /// D, controls by controls: nested rows of coefficients in descending powers of z.
    pub denominator: Vec<Vec<Vec<f64>>>,
    /// N, controls by fed-back outputs.
    pub numerator: Vec<Vec<Vec<f64>>>,
    /// `adj(D) N / det(D)`, row by row; common factors are not cancelled.
    pub transfer_functions: Vec<Vec<TransferFunctionModel>>,
}

/// Why the best candidate is the best one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MatrixCertificate {
    /// True: no stable candidate has a smaller cost, and none with the same cost a lower index. Costs that are zero but
    /// for rounding are the same.
    pub exact: bool,
    /// How it was found: `exhaustive`.
    pub method: String,
    /// Candidates on the grids.
    pub listed: u64,
    /// M, those with a stable closed loop. A pole on the boundary to working precision is not stable.
    pub pool_size: u64,
    /// Index of the best candidate among the stable ones, from 0.
    pub index: u64,
    /// Index of the best candidate among the listed ones, from 0.
    pub listed_index: u64,
    /// Candidates evaluated one by one.
    pub evaluated: u64,
    /// Candidates that rounding could not tell from the best one of their part of the pool, and that orthogonalisation
    /// decided.
    pub decided_by_qr: u64,
    /// J once more, from the coefficients of the fractions as written here.
    pub cost_of_coefficients: f64,
}

/// Candidates that fit nearly as well.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MatrixNearOptimal {
    /// Within this share of the smallest cost, or not to be told from it by rounding.
    pub within: f64,
    /// How many, the best one included.
    pub count: u64,
    /// Whether counting stopped there.
    pub is_lower_bound: bool,
}

/// A frequency line; matrices are measured outputs by commands, entries `[re, im]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MatrixFit {
    /// Angular frequency in rad/s.
    pub omega_rad_s: f64,
    /// The data.
    pub h: Vec<Vec<[f64; 2]>>,
    /// The identified closed loop.
    pub model: Vec<Vec<[f64; 2]>>,
    /// model − h.
    pub residual: Vec<Vec<[f64; 2]>>,
    /// Weight of its squared Frobenius norm in the cost.
    pub weight: f64,
}

/// The result of the multivariable form of `ssid`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SsidMimoResult {
    /// Gff; its denominator is a power of z.
    pub feedforward: MatrixFraction,
    /// Gfb.
    pub feedback: MatrixFraction,
    /// The plant in sampled time.
    pub plant: MultivariableModel,
    /// Which of its outputs were measured, from 0.
    pub measured_outputs: Vec<usize>,
    /// Which of its outputs were fed back, from 0.
    pub fed_back_outputs: Vec<usize>,
    /// `J = Σ weight ‖model − h‖_F²` at the best candidate, by orthogonalisation.
    pub cost: f64,
    /// The part of it that no controller can explain, since the plant does not reach it; 0 with as many controls as
    /// measured outputs.
    pub unreachable_cost: f64,
    /// Why it is the best one.
    pub certificate: MatrixCertificate,
    /// Candidates that fit nearly as well.
    pub near_optimal: MatrixNearOptimal,
    /// Poles of the feedback loop as `[re, im]`; the FIR feedforward adds poles at the origin.
    pub closed_loop_poles: Vec<[f64; 2]>,
    /// Closed-loop stability.
    pub stability: Stability,
    /// Line by line.
    pub fit: Vec<MatrixFit>,
    /// Channel by channel the share `Σ weight |residual|² / Σ weight |h|²`; null where h is zero.
    pub residual_share: Vec<Vec<Option<f64>>>,
    /// How well the lines tell the coefficients apart.
    pub identifiability: Identifiability,
}

fn fraction(of: &LeftFraction<Discrete>) -> Result<MatrixFraction, TransferFunctionError> {
    let rows = of.transfer_functions()?;
    Ok(MatrixFraction {
        denominator: of.denominator().to_nested(),
        numerator: of.numerator().to_nested(),
        transfer_functions: rows.iter().map(|row| row.iter().map(TransferFunctionModel::from).collect()).collect(),
    })
}

fn rows(matrix: &DMatrix<Complex64>) -> Vec<Vec<[f64; 2]>> {
    matrix.row_iter().map(|row| row.iter().map(|v| [v.re, v.im]).collect()).collect()
}

impl SsidMimoResult {
    pub(super) fn new(found: &Identified, plant: &Plant, margin: f64) -> Result<Self, TransferFunctionError> {
        let optimum = &found.optimum;
        let (measured, commands) = (plant.measured.len(), plant.fed_back.len());
        let share = |i: usize, j: usize| {
            let sum = |of: &dyn Fn(&DMatrix<Complex64>, &DMatrix<Complex64>) -> f64| -> f64 {
                found.lines.iter().map(|(line, model)| line.weight * of(&line.response, model)).sum()
            };
            let data = sum(&|h, _| h[(i, j)].norm_sqr());
            (data > 0.0).then(|| sum(&|h, model| (model[(i, j)] - h[(i, j)]).norm_sqr()) / data)
        };
        let time = Time::Sampled(plant.system.time());
        Ok(Self {
            feedforward: fraction(&found.feedforward)?,
            feedback: fraction(&found.feedback)?,
            plant: MultivariableModel::from(&plant.system),
            measured_outputs: plant.measured.clone(),
            fed_back_outputs: plant.fed_back.clone(),
            cost: optimum.fit.cost,
            unreachable_cost: found.unreachable_cost,
            certificate: MatrixCertificate {
                exact: true,
                method: "exhaustive".to_owned(),
                listed: found.listed,
                pool_size: optimum.pool_size,
                index: optimum.index,
                listed_index: optimum.listed_index,
                evaluated: optimum.pool_size,
                decided_by_qr: optimum.decided_by_qr,
                cost_of_coefficients: found.cost_of_coefficients,
            },
            near_optimal: MatrixNearOptimal {
                within: NEAR,
                count: optimum.near_optimal,
                is_lower_bound: optimum.near_optimal_is_capped,
            },
            closed_loop_poles: found.closed_loop_poles.iter().map(|p| [p.re, p.im]).collect(),
            stability: Stability {
                largest_exponent_per_s: time.slowest_exponent(&found.closed_loop_poles).filter(|e| e.is_finite()),
                spectral_radius: Some(found.closed_loop_poles.iter().map(|p| p.norm()).fold(0.0, f64::max)),
                margin_per_s: margin,
            },
            fit: found
                .lines
                .iter()
                .map(|(line, model)| MatrixFit {
                    omega_rad_s: line.omega_rad_s,
                    h: rows(&line.response),
                    model: rows(model),
                    residual: rows(&(model - &line.response)),
                    weight: line.weight,
                })
                .collect(),
            residual_share: (0..measured).map(|i| (0..commands).map(|j| share(i, j)).collect()).collect(),
            identifiability: found.identifiability.clone(),
        })
    }
}
