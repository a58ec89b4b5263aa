//! Inverse optimal control: kinds `inverse_lqr`, `inverse_lqe` and `inverse_lqg`.
//!
//! ```json
//! {"kind": "inverse_lqr", "inputs": {"a": [[0, 1], [2, 0]], "b": [[0], [1]], "k": [[5, 4]], "sample_time_s": null}}
//! {"kind": "inverse_lqe", "inputs": {"a": [[0, 1], [2, 0]], "c": [[1, 0]], "l": [[4], [5]]}}
//! {"kind": "inverse_lqg", "inputs": {"a": [[0, 1], [2, 0]], "b": [[0], [1]], "c": [[1, 0]], "k": [[5, 4]], "l": [[4], [5]]},
//!  "spec": {"regulator": {"state_weight": "diagonal"}}}
//! ```
//! The method is that of [`inverse`](crate::inverse). An infeasible verdict is a result: it comes with its certificate, and with the weights
//! whose gain comes nearest.

mod inputs;
mod problems;
mod result;
mod spec;
mod units;

use super::inputs::{Library, References};
use super::kind::{Kind, Request};
use super::plan::Failure;
use super::problem::Problem;
use super::report::{Report, Warning, sha256_json};
use crate::control::structural::{StructuralError, check_detectable};
use crate::ctl::Ctl;
use crate::inverse::fit::{
    CrossTerm, Descent, DescentError, DescentSettings, Fit, Objective, descent, fit, smallest_cross_term,
};
use crate::inverse::lqr::Weights;
use crate::inverse::{Gains, InverseLqr, Role, Settings, UNDECIDED, Verdict, inverse_lqr};
pub use inputs::{Comparand, InverseInputs, Trajectory};
use nalgebra::DMatrix;
pub use result::{
    AxisResult, ComparisonResult, CrossTermResult, DescentResult, EquivalentResult, FitPointResult, FitResult,
    InverseLqrResult, ProofResult, ReadingResult, ReturnDifferenceResult, SharesResult,
};
use serde_json::{Map, Value, json};
use spec::{Checked, CheckedSpecs};
pub use spec::{DescentSpec, DescentStart, FitSpec, InverseLqgSpec, InverseSpec, PortWeight, StateWeight, WeightName};

pub(in crate::analysis) use inputs::matrix;
pub(in crate::analysis) use result::{rows, shares};
pub(in crate::analysis) use spec::structure;
use std::collections::BTreeMap;

/// Version of [`InverseLqrResult`].
const RESULT_VERSION: u32 = 1;
/// Condition numbers above this deserve a warning: weights then differ by more than measured gains tell.
const ILL_CONDITIONED: f64 = 1e8;
/// The share of starts that must agree on the best fit for it to be trusted.
const AGREEMENT: f64 = 0.3;

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    kind: Kind,
    inputs: Box<InverseInputs>,
    specs: Box<CheckedSpecs>,
}

impl Plan {
    /// Checks a request of one of the three kinds.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(request: &Request, kind: Kind) -> Result<Self, Problem> {
        let inputs = InverseInputs::parse(&request.inputs, kind)?;
        let specs = CheckedSpecs::parse(&request.spec, kind, &inputs)?;
        Ok(Self { kind, inputs: Box::new(inputs), specs: Box::new(specs) })
    }

    /// Which of the three it is.
    #[must_use]
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// None: the matrices come with the request.
    #[must_use]
    pub fn references(&self) -> References {
        References::default()
    }

    /// The request with its defaults filled in; parsing it again gives an equal plan.
    #[must_use]
    pub fn request(&self) -> Request {
        Request { kind: self.kind.name().to_owned(), inputs: self.inputs.to_value(), spec: self.specs.to_value() }
    }

    /// Computes the report; progress counts the verdict and the fit of each half.
    ///
    /// # Errors
    /// [`Failure::Stopped`] when `ctl` says so, [`Failure::Problem`] where working precision proves no verdict.
    pub fn run(&self, _library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        let halves: Vec<(&Gains, &Checked)> = [
            self.inputs.regulator.as_ref().zip(self.specs.regulator.as_ref()),
            self.inputs.filter.as_ref().zip(self.specs.filter.as_ref()),
        ]
        .into_iter()
        .flatten()
        .collect();
        ctl.set_total(2 * halves.len() as u64);
        let mut warnings = Vec::new();
        let mut results = Vec::new();
        for (gains, spec) in halves {
            results.push((gains.role(), self.half(gains, spec, &mut warnings, ctl)?));
        }
        let result = match self.kind {
            Kind::InverseLqg => both(results),
            _ => results.pop().map_or(Value::Null, |(role, result)| lettered(role, &result)),
        };
        let seed = self.specs.seed();
        let hashes: BTreeMap<String, String> = self
            .inputs
            .to_value()
            .as_object()
            .into_iter()
            .flatten()
            .map(|(name, value)| (format!("/inputs/{name}"), sha256_json(value)))
            .collect();
        Ok(Report::new(self.kind, RESULT_VERSION, result, warnings, self.specs.to_value(), hashes, seed))
    }

    fn half(
        &self,
        gains: &Gains,
        spec: &Checked,
        warnings: &mut Vec<Warning>,
        ctl: &Ctl,
    ) -> Result<InverseLqrResult, Failure> {
        let settings = Settings { structure: spec.structure.clone() };
        let answer = inverse_lqr(gains, &settings, ctl).map_err(|error| problems::inverse(&error))?;
        ctl.advance(1);
        let fitted = if answer.weights.is_none() && spec.written.fit.is_some() {
            let settings = spec.fit_settings();
            Some(fit(gains, &settings, ctl).map_err(|error| problems::fit(&error))?)
        } else {
            None
        };
        let wants_start = spec.written.fit.as_ref().and_then(|f| f.descent).filter(|_| fitted.is_some());
        let cross_term = if fitted.is_some() && settings.structure.is_free() {
            smallest_cross_term(gains, ctl).map(Some).or_else(|error| match error {
                crate::convex::lmi::LmiError::Stopped(stopped) => Err(Failure::Stopped(stopped)),
                crate::convex::lmi::LmiError::Infeasible { .. } => Ok(None),
            })?
        } else {
            None
        };
        let descended = match wants_start {
            None => None,
            Some(wanted) => descended(gains, spec, wanted, cross_term.as_ref(), warnings, ctl)?,
        };
        ctl.advance(1);
        warn(gains, &answer, fitted.as_ref(), warnings);
        Ok(InverseLqrResult::new(
            gains,
            &answer,
            fitted.as_ref(),
            (cross_term.as_ref(), descended.as_ref()),
            &self.inputs,
        ))
    }
}

/// The descent of Table 3.1; a warning in its place where it meets weights without a regulator.
fn descended(
    gains: &Gains,
    spec: &Checked,
    wanted: DescentSpec,
    cross_term: Option<&CrossTerm>,
    warnings: &mut Vec<Warning>,
    ctl: &Ctl,
) -> Result<Option<Descent>, Failure> {
    let (n, m) = (gains.states(), gains.ports());
    let identity = (DMatrix::identity(n, n), DMatrix::identity(m, m));
    let (q, r) = match (wanted.start, cross_term) {
        (DescentStart::CrossTerm, Some(found)) => (found.q.clone(), found.r.clone()),
        _ => identity,
    };
    let settings = DescentSettings { rate: wanted.rate, steps: wanted.steps };
    match descent(&Objective::new(gains, spec.metric.as_ref()), &q, &r, settings, ctl) {
        Ok(found) => Ok(Some(found)),
        Err(DescentError::Stopped(stopped)) => Err(stopped.into()),
        Err(DescentError::Riccati(error)) => {
            warnings.push(Warning::new(
                "descent_broke_off",
                format!("The descent met weights without a regulator: {error}"),
            ));
            Ok(None)
        }
    }
}

/// A regulator's result with the letters of its role: W, V and H in place of Q, R and P.
fn lettered(role: Role, result: &InverseLqrResult) -> Value {
    let mut value = json!(result);
    if role == Role::Filter {
        rename(&mut value);
    }
    value
}

fn rename(value: &mut Value) {
    match value {
        Value::Object(members) => {
            let renamed: Map<String, Value> = std::mem::take(members)
                .into_iter()
                .map(|(name, mut value)| {
                    rename(&mut value);
                    let name = match name.as_str() {
                        "q" => "w".to_owned(),
                        "r" => "v".to_owned(),
                        "p" => "h".to_owned(),
                        "k" => "l".to_owned(),
                        "q_axes" => "w_axes".to_owned(),
                        "r_axes" => "v_axes".to_owned(),
                        "normalised_q" => "normalised_w".to_owned(),
                        "normalised_r" => "normalised_v".to_owned(),
                        "normalised_q_units" => "normalised_w_units".to_owned(),
                        "normalised_r_units" => "normalised_v_units".to_owned(),
                        _ => name,
                    };
                    (name, value)
                })
                .collect();
            *members = renamed;
            for name in ["l", "forward_gain"] {
                if let Some(gain) = members.get_mut(name) {
                    transpose(gain);
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(rename),
        _ => {}
    }
}

/// The gain of a filter is n×p, that of the dual regulator p×n.
fn transpose(value: &mut Value) {
    if let Ok(rows) = serde_json::from_value::<Vec<Vec<f64>>>(value.clone())
        && let Some(first) = rows.first()
    {
        *value = json!((0..first.len()).map(|j| rows.iter().map(|row| row[j]).collect()).collect::<Vec<Vec<f64>>>());
    }
}

/// Both halves: each in full, with the verdict that holds for the controller as a whole and the four weights beside them.
fn both(results: Vec<(Role, InverseLqrResult)>) -> Value {
    let mut whole = Map::new();
    let worst = results.iter().map(|(_, result)| result.verdict.as_str()).max_by_key(|verdict| match *verdict {
        "feasible" => 0,
        "boundary" => 1,
        _ => 2,
    });
    whole.insert("verdict".to_owned(), json!(worst));
    for (role, result) in &results {
        let value = lettered(*role, result);
        let letters = if *role == Role::Filter { ["w", "v"] } else { ["q", "r"] };
        for letter in letters {
            whole.insert(letter.to_owned(), value[letter].clone());
        }
        let name = if *role == Role::Filter { "filter" } else { "regulator" };
        whole.insert(name.to_owned(), value);
    }
    Value::Object(whole)
}

/// Q as far as it is more than rounding: on the boundary its least eigenvalues are zero to the precision of the margin.
fn seen(gains: &Gains, verdict: Verdict, weights: &Weights) -> DMatrix<f64> {
    if verdict != Verdict::Boundary {
        return weights.q.clone();
    }
    let size = weights.q.norm().max(gains.k().tr_mul(&(&weights.r * gains.k())).norm());
    let eigen = weights.q.clone().symmetric_eigen();
    let values = eigen.eigenvalues.map(|v| if v > UNDECIDED * size { v } else { 0.0 });
    &eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose()
}

fn warn(gains: &Gains, answer: &InverseLqr, fitted: Option<&Fit>, warnings: &mut Vec<Warning>) {
    let role = gains.role();
    let half = if role == Role::Filter { "filter" } else { "regulator" };
    if answer.verdict == Verdict::Boundary {
        warnings.push(Warning::new(
            "boundary",
            format!(
                "the {half}'s margin t* is zero to working precision: only singular weights may make this gain optimal, and a small \
                 change of the gain may make it infeasible"
            ),
        ));
    }
    if answer.verdict == Verdict::Infeasible && answer.t_star_scaled.is_none() {
        warnings.push(Warning::new(
            "structure_leaves_nothing",
            format!(
                "no weights of this structure satisfy the equalities for exactly the {half}'s gain, whatever their signs: with so few unknowns the \
                 last digit of a gain decides. Read the distance of the fit, not the verdict"
            ),
        ));
    }
    if let Some(weights) = &answer.weights
        && let Err(error) = check_detectable(gains.a(), &seen(gains, answer.verdict, weights), gains.clock())
    {
        let mode = match error {
            StructuralError::NotDetectable(mode) => mode.to_string(),
            other => other.to_string(),
        };
        let misses = if role == Role::Filter { "W does not drive" } else { "Q does not see" };
        warnings.push(Warning::new(
            "undetectable",
            format!(
                "the {half}'s {misses} the mode {mode} of the plant, which does not decay by itself: among all gains another one costs less, and this one is \
                 the best of those that stabilise"
            ),
        ));
    }
    if let Some(conditioning) = answer.conditioning {
        if !answer.best_conditioned {
            warnings.push(Warning::new(
                "not_best_conditioned",
                format!(
                    "rounding keeps the {half}'s weights of the least condition number from returning the gain; those of the largest \
                     margin are given, which do"
                ),
            ));
        }
        if conditioning.alpha > ILL_CONDITIONED {
            warnings.push(Warning::new(
                "ill_conditioned",
                format!(
                    "the best conditioned weights of the {half} have the condition number {:.2e}: the smallest of them say nothing that a \
                     measured gain could tell",
                    conditioning.alpha
                ),
            ));
        }
        if conditioning.solution_dimension > 0 {
            let which = conditioning.solution_width.map_or_else(
                || "it was not measured, and the weights given are any of it".to_owned(),
                |width| {
                    format!("those of least Frobenius norm are given, and a diagonal weight may range over {width:.2e} of its value")
                },
            );
            warnings.push(Warning::new(
                "not_unique",
                format!(
                    "the {half}'s weights of least condition number form a set of dimension {}; {which}",
                    conditioning.solution_dimension
                ),
            ));
        }
    }
    let Some(fitted) = fitted else { return };
    if let Some((best, first)) = fitted.curve.last().zip(fitted.curve.first()) {
        let agreeing = best.agreeing_starts as f64;
        if agreeing < AGREEMENT * best.starts as f64 {
            warnings.push(Warning::new(
                "local_minima",
                format!(
                    "{} of {} starts agree on the {half}'s best fit: others end in worse minima, and a better one may exist",
                    best.agreeing_starts, best.starts
                ),
            ));
        }
        if best.residual < 0.9 * first.residual && fitted.curve.len() > 1 {
            warnings.push(Warning::new(
                "condition_number_trade_off",
                format!(
                    "no weights make the {half}'s gain optimal; the squared distance falls from {:.4e} to {:.4e} as the condition number \
                     goes from {:.0e} to {:.0e}: read the whole curve",
                    first.residual, best.residual, first.condition_number, best.condition_number
                ),
            ));
        }
    }
}

#[cfg(test)]
mod tests;
