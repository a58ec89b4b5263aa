//! The experiment whose worst subject is estimated best: kind `robust_input_design`.
//!
//! ```json
//! {"kind": "robust_input_design", "inputs": {"axis": "flexion_extension"}, "spec": {"draws": 16}}
//! {"kind": "robust_input_design",
//!  "inputs": {"axis": "axial_rotation", "population": {"controller": {"tau": [0.2, 0.3]}, "torque_nm": 5}},
//!  "spec": {"experiment": {"edge_hz": [0.1, 1.5], "width_m": [0.5, 2.5], "duration_s": 30}}}
//! ```
//! The method is that of [`excite::robust`](crate::excite::robust). What the thesis leaves open is declared, and listed in the report as
//! `assumptions`.

mod result;
mod spec;

use super::inputs::{Library, References};
use super::kind::{Kind, Request};
use super::plan::Failure;
use super::problem::{Code, Problem};
use super::report::{Report, Warning, sha256_json};
use crate::ctl::Ctl;
use crate::excite::robust::search::expected_evaluations;
use crate::excite::robust::{DrawCost, Outcome, Search, Worst, costs, draws};
use crate::excite::sequence::SequenceError;
use crate::num::distributions::student_t;
use crate::num::stats::{mean, standard_deviation};
pub use result::{
    CostParts, DesignResult, DifferenceResult, FreshResult, IterationResult, RobustInputDesignResult, SubjectCost,
};
use serde_json::json;
use spec::Checked;
pub use spec::{
    ControllerRanges, ExperimentSpec, PopulationInput, RobustInputDesignInputs, RobustInputDesignSpec, SubjectSpec,
};
use std::collections::BTreeMap;

/// Version of [`RobustInputDesignResult`].
const RESULT_VERSION: u32 = 1;
/// The level of the intervals.
const LEVEL: f64 = 0.95;

fn wrong(detail: impl Into<String>, at: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "impossible experiment", detail).at(at)
}

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    checked: Box<Checked>,
}

/// The costs of an experiment's worst subject with fresh draws.
struct Fresh {
    result: FreshResult,
    totals: Vec<f64>,
}

impl Plan {
    /// Checks a request.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(request: &Request) -> Result<Self, Problem> {
        Ok(Self { checked: Box::new(Checked::parse(&request.inputs, &request.spec)?) })
    }

    /// None: the population comes with the request.
    #[must_use]
    pub fn references(&self) -> References {
        References::default()
    }

    /// The request with its defaults filled in; parsing it again gives an equal plan.
    #[must_use]
    pub fn request(&self) -> Request {
        let (inputs, spec) = (json!(self.checked.inputs), json!(self.checked.spec));
        Request { kind: Kind::RobustInputDesign.name().to_owned(), inputs, spec }
    }

    /// Computes the report; progress counts evaluations of the cost.
    ///
    /// # Errors
    /// [`Failure::Stopped`] when `ctl` says so, [`Failure::Problem`] where a target cannot be made.
    pub fn run(&self, _library: &Library, ctl: &Ctl) -> Result<Report, Failure> {
        let checked = &*self.checked;
        let spec = &checked.spec;
        let total = expected_evaluations(spec.max_iterations, spec.rounds) + 2 * 6;
        ctl.set_total(total);
        let drawn = draws(&checked.setting, spec.draws, spec.seed, "design");
        let mut search = Search::new(&checked.setting, checked.gamma_box, &drawn, ctl);
        let outcome = search
            .run(checked.average, checked.start, spec.max_iterations, spec.rounds)
            .map_err(|error| sequence(&error))?;
        let again = draws(&checked.setting, spec.fresh_draws, spec.seed, "fresh");
        let nominal = self.fresh(&outcome.nominal, &again, ctl)?;
        let robust = self.fresh(&outcome.robust, &again, ctl)?;
        // The search may end long before what was foreseen.
        ctl.advance(total);
        let mut warnings = Vec::new();
        let difference = difference(&nominal, &robust);
        findings(checked, &outcome, &nominal, &robust, &difference, &mut warnings);
        let design = |worst: &Worst, fresh: FreshResult| -> Result<DesignResult, Failure> {
            let target = checked.setting.target_spec(worst.gamma);
            Ok(DesignResult {
                edge_hz: worst.gamma[0],
                width_m: worst.gamma[1],
                worst_cost: worst.cost(),
                worst_subjects: worst.subjects.iter().map(|(theta, cost)| SubjectCost::new(*theta, *cost)).collect(),
                samples: checked.setting.target(worst.gamma, ctl).map_err(|error| sequence(&error))?,
                target: json!(target),
                fresh,
            })
        };
        let result = RobustInputDesignResult {
            axis: checked.inputs.axis,
            robust: design(&outcome.robust, robust.result)?,
            nominal: design(&outcome.nominal, nominal.result)?,
            nominal_cost: outcome.nominal_cost,
            difference,
            trace: outcome.trace.iter().map(IterationResult::from).collect(),
            scenarios: outcome.scenarios.iter().map(|theta| SubjectSpec::from(*theta)).collect(),
            rounds: outcome.rounds,
            closed: outcome.closed,
            evaluations: outcome.evaluations,
            assumptions: checked.assumptions(),
        };
        let hashes: BTreeMap<String, String> = BTreeMap::from([
            ("/inputs/axis".to_owned(), sha256_json(&json!(checked.inputs.axis))),
            ("/inputs/population".to_owned(), sha256_json(&json!(checked.inputs.population))),
        ]);
        let seed = Some(spec.seed);
        Ok(Report::new(Kind::RobustInputDesign, RESULT_VERSION, json!(result), warnings, json!(spec), hashes, seed))
    }

    /// The worst of an experiment's worst subjects, with draws that the search has never seen.
    fn fresh(&self, worst: &Worst, drawn: &[crate::excite::robust::Draw], ctl: &Ctl) -> Result<Fresh, Failure> {
        let setting = &self.checked.setting;
        let target = setting.target(worst.gamma, ctl).map_err(|error| sequence(&error))?;
        let mut most: Option<(f64, [f64; 4], Vec<DrawCost>)> = None;
        for (theta, _) in &worst.subjects {
            let found = costs(setting, *theta, &target, drawn, ctl)?;
            ctl.advance(1);
            let cost = mean(&found.iter().map(DrawCost::total).collect::<Vec<_>>()).unwrap_or(f64::MAX);
            if most.as_ref().is_none_or(|(known, ..)| cost > *known) {
                most = Some((cost, *theta, found));
            }
        }
        let Some((cost, theta, found)) = most else {
            let detail = "the search found no subject";
            return Err(Problem::new(Code::Internal, "no subject", detail).into());
        };
        let totals: Vec<f64> = found.iter().map(DrawCost::total).collect();
        let part = |of: &dyn Fn(&DrawCost) -> f64| mean(&found.iter().map(of).collect::<Vec<_>>()).unwrap_or(0.0);
        let result = FreshResult {
            subject: SubjectSpec::from(theta),
            cost,
            interval: interval(&totals),
            parts: CostParts {
                error: part(&|c| c.error),
                acceleration: part(&|c| c.excursions[0]),
                torque: part(&|c| c.excursions[1]),
                angle: part(&|c| c.excursions[2]),
            },
            draws: found.len(),
            not_converged: found.iter().filter(|c| !c.converged).count(),
        };
        Ok(Fresh { result, totals })
    }
}

fn sequence(error: &SequenceError) -> Failure {
    match error {
        SequenceError::Stopped(stopped) => Failure::Stopped(*stopped),
        error => wrong(error.to_string(), "/spec/experiment").into(),
    }
}

/// Mean ± Student's t times the standard error.
fn interval(values: &[f64]) -> [f64; 2] {
    let centre = mean(values).unwrap_or(0.0);
    let n = values.len() as f64;
    let half = standard_deviation(values).map_or(0.0, |s| student_t(LEVEL, n - 1.0) * s / n.sqrt());
    [centre - half, centre + half]
}

/// What the robust experiment spares the worst subject, draw by draw.
fn difference(nominal: &Fresh, robust: &Fresh) -> DifferenceResult {
    let differences: Vec<f64> = nominal.totals.iter().zip(&robust.totals).map(|(n, r)| n - r).collect();
    let interval = interval(&differences);
    let verdict = if interval[0] > 0.0 {
        "robust_better"
    } else if interval[1] < 0.0 {
        "robust_worse"
    } else {
        "not_distinguished"
    };
    DifferenceResult { mean: mean(&differences).unwrap_or(0.0), interval, verdict, no_worse: interval[1] >= 0.0 }
}

/// What a scientist must read.
fn findings(
    checked: &Checked,
    outcome: &Outcome,
    nominal: &Fresh,
    robust: &Fresh,
    difference: &DifferenceResult,
    warnings: &mut Vec<Warning>,
) {
    warnings.push(Warning::new(
        "assumptions_declared",
        "the source leaves out the muscle, the derivative's filter, sample time, length, number of draws, scaling of the noise and the average \
         subject; what stands in their place is listed in `assumptions`, and costs compare only between runs with the same ones",
    ));
    if difference.verdict == "robust_worse" {
        warnings.push(Warning::new(
            "robust_worse",
            "with fresh draws the robust experiment's worst subject costs more than the nominal one's: the search saw too few draws",
        ));
    }
    if !outcome.closed {
        warnings.push(Warning::new(
            "not_closed",
            format!(
                "after {} rounds the search still met worse subjects than it had taken into account",
                outcome.rounds
            ),
        ));
    }
    for (name, worst, fresh) in [("nominal", &outcome.nominal, nominal), ("robust", &outcome.robust, robust)] {
        let [lower, upper] = fresh.result.interval;
        if !(lower..=upper).contains(&worst.cost()) {
            warnings.push(Warning::new(
                "draws_too_few",
                format!(
                    "the search put the worst cost of the {name} experiment at {:.4} where fresh draws give {:.4} ({lower:.4} to {upper:.4}): it \
                     knew its own draws too well; give more draws",
                    worst.cost(),
                    fresh.result.cost
                ),
            ));
        }
        if fresh.result.not_converged > 0 {
            warnings.push(Warning::new(
                "refits_not_converged",
                format!(
                    "{} of {} fits of the {name} experiment's worst subject did not converge; the best that they found counts",
                    fresh.result.not_converged, fresh.result.draws
                ),
            ));
        }
    }
    let gamma = outcome.robust.gamma;
    for ((name, value), [lower, upper]) in crate::excite::robust::GAMMA.into_iter().zip(gamma).zip(checked.gamma_box) {
        if value == lower || value == upper {
            warnings.push(Warning::new(
                "at_the_edge",
                format!(
                    "the robust {name} is {value}, at the edge of its range: a wider one may hold a better experiment"
                ),
            ));
        }
    }
}

#[cfg(test)]
mod tests;
