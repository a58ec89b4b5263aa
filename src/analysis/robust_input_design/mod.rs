//! The experiment whose worst subject is estimated best: kind `robust_input_design`.
//!
//! ```json
//! {"kind": "robust_input_design", "inputs": {"axis": "flexion_extension"}, "spec": {"draws": 16}}
//! {"kind": "robust_input_design",
//!  "inputs": {"axis": "axial_rotation", "population": {"controller": {"tau": [0.2, 0.3]}, "torque_nm": 5}},
//!  "spec": {"experiment": {"edge_hz": [0.1, 1.5], "width_m": [0.5, 2.5], "duration_s": 30}}}
//! ```
//! The method is that of [`excite::robust`](crate::excite::robust). What the thesis leaves open is declared, and listed
//! in the report as `assumptions`.

mod checked;
mod findings;
mod refusal;
mod result;
mod spec;
#[cfg(test)]
mod tests;

use super::contract::{Analysis, Failure, Outcome, Samples};
use super::inputs::library::Library;
use super::kind::Kind;
use super::problem::{Code, Problem};
use crate::ctl::{Ctl, Phase};
use crate::excite::robust::cost::TOLERANCE;
use crate::excite::robust::search::expected_evaluations;
use crate::excite::robust::{Draw, DrawCost, Search, Worst, costs, draws};
use crate::excite::sequence::SequenceError;
use crate::num::distributions::student_t;
use crate::num::stats::{mean, standard_deviation};
use checked::Checked;
use refusal::wrong;
pub use result::{
    CostDifference, CostParts, DesignResult, DifferenceResult, FreshResult, GivenResult, IterationResult,
    RobustInputDesignResult, RobustVerdict, SubjectCost,
};
use serde_json::Value;
pub use spec::{
    ControllerRanges, ExperimentSpec, GivenExperiment, PopulationInput, RobustInputDesignInputs, RobustInputDesignSpec,
    SubjectSpec,
};

/// The level of the intervals.
const LEVEL: f64 = 0.95;

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

impl Analysis for Plan {
    const KIND: Kind = Kind::named("robust_input_design");
    const TITLE: &'static str = "Robust input design";
    const SUMMARY: &'static str = "The target for a person who follows it with the head, by the edge of its band and \
        the width of the screen, with which the worst subject of a population is estimated best: a min-max search over \
        subjects and targets, checked with fresh draws against the target that is best for the average subject (Priess \
        2015, chapter 2).";
    const RESULT_VERSION: u32 = 2;
    const EXAMPLE: &'static str = include_str!("example.json");

    type Inputs = RobustInputDesignInputs;
    type Spec = RobustInputDesignSpec;
    type Result = RobustInputDesignResult;

    fn check(inputs: RobustInputDesignInputs, spec: RobustInputDesignSpec) -> Result<Self, Problem> {
        Ok(Self { checked: Box::new(Checked::new(inputs, spec)?) })
    }

    fn inputs(&self) -> &RobustInputDesignInputs {
        &self.checked.inputs
    }

    fn spec(&self) -> &RobustInputDesignSpec {
        &self.checked.spec
    }

    fn seed(&self) -> Option<u64> {
        Some(self.checked.spec.seed)
    }

    /// The robust target as `signal`, and the `nominal` one.
    fn samples(result: &Value) -> Option<Samples> {
        let (robust, nominal) = (&result["robust"], &result["nominal"]);
        Samples::named(
            &robust["target"]["sample_time_s"],
            &[("signal", &robust["samples"]), ("nominal", &nominal["samples"])],
        )
    }

    /// Progress counts evaluations of the cost. A target that cannot be made is a problem.
    fn run(&self, _library: &Library, ctl: &Ctl) -> Result<Outcome<RobustInputDesignResult>, Failure> {
        let checked = &*self.checked;
        let spec = &checked.spec;
        ctl.enter(Phase::Search, 0.9);
        ctl.set_total(expected_evaluations(spec.max_iterations, spec.rounds) + 40);
        let drawn = draws(&checked.setting, spec.draws, spec.seed, "design");
        let mut search = Search::new(&checked.setting, checked.gamma_box, &drawn, ctl);
        let outcome = search
            .run(checked.average, checked.start, spec.max_iterations, spec.rounds)
            .map_err(|error| sequence(&error))?;
        let given = match &spec.given {
            None => None,
            Some(given) => {
                let known = [outcome.nominal.subjects[0].0, outcome.robust.subjects[0].0, checked.average];
                Some(search.worst([given.edge_hz, given.width_m], &known).map_err(|error| sequence(&error))?)
            }
        };
        ctl.enter(Phase::Verification, 0.1);
        ctl.set_total(3 * 8);
        let again = draws(&checked.setting, spec.fresh_draws, spec.seed, "fresh");
        let fresh = |worst: &Worst| self.fresh(worst, &drawn, &again, ctl);
        let nominal = fresh(&outcome.nominal)?;
        let robust = fresh(&outcome.robust)?;
        let given = match given {
            None => None,
            Some(worst) => {
                let fresh = fresh(&worst)?;
                Some((worst, fresh))
            }
        };
        let difference = difference(&nominal, &robust);
        let warnings = findings::warnings(checked, &outcome, &nominal.result, &robust.result, &difference);
        let design = |worst: &Worst, fresh: FreshResult| -> Result<DesignResult, Failure> {
            let target = checked.setting.target_spec(worst.gamma);
            Ok(DesignResult {
                edge_hz: worst.gamma[0],
                width_m: worst.gamma[1],
                worst_cost: worst.cost(),
                worst_subjects: worst.subjects.iter().map(|(theta, cost)| SubjectCost::new(*theta, *cost)).collect(),
                samples: checked.setting.target(worst.gamma, ctl).map_err(|error| sequence(&error))?,
                target,
                fresh,
            })
        };
        let given = given
            .map(|(worst, fresh)| -> Result<GivenResult, Failure> {
                Ok(GivenResult {
                    over_nominal: paired(&fresh, &nominal),
                    over_robust: paired(&fresh, &robust),
                    design: design(&worst, fresh.result)?,
                })
            })
            .transpose()?;
        let result = RobustInputDesignResult {
            conclusion: findings::conclusion(&nominal.result, &robust.result, &difference),
            axis: checked.inputs.axis,
            robust: design(&outcome.robust, robust.result)?,
            nominal: design(&outcome.nominal, nominal.result)?,
            given,
            average_subject: checked.average.into(),
            nominal_cost: outcome.nominal_cost,
            difference,
            trace: outcome.trace.iter().map(IterationResult::from).collect(),
            scenarios: outcome.scenarios.iter().map(|theta| SubjectSpec::from(*theta)).collect(),
            rounds: outcome.rounds,
            closed: outcome.closed,
            evaluations: outcome.evaluations,
            assumptions: checked.assumptions(),
        };
        Ok(Outcome::new(result, warnings))
    }
}

impl Plan {
    /// What the worst of an experiment's worst subjects costs: chosen with one half of draws that the search has never
    /// seen, estimated with the other, which the choice has not seen either; beside it what the search saw.
    fn fresh(&self, worst: &Worst, seen: &[Draw], again: &[Draw], ctl: &Ctl) -> Result<Fresh, Failure> {
        let setting = &self.checked.setting;
        let target = setting.target(worst.gamma, ctl).map_err(|error| sequence(&error))?;
        let estimate = |theta: [f64; 4], draws: &[Draw]| -> Result<Vec<DrawCost>, Failure> {
            let found = costs(setting, theta, &target, draws, TOLERANCE[1], f64::INFINITY, ctl)?;
            ctl.advance(1);
            Ok(found)
        };
        let (choosing, judging) = again.split_at(again.len() / 2);
        let mut most: Option<(f64, [f64; 4])> = None;
        for (theta, _) in &worst.subjects {
            let cost = mean(&totals(&estimate(*theta, choosing)?)).unwrap_or(f64::MAX);
            if most.is_none_or(|(known, _)| cost > known) {
                most = Some((cost, *theta));
            }
        }
        let Some((_, theta)) = most else {
            let detail = "the search found no subject";
            return Err(Problem::new(Code::Internal, "no subject", detail).into());
        };
        let (found, searched) = (estimate(theta, judging)?, totals(&estimate(theta, seen)?));
        let totals = totals(&found);
        let part = |of: &dyn Fn(&DrawCost) -> f64| mean(&found.iter().map(of).collect::<Vec<_>>()).unwrap_or(0.0);
        let result = FreshResult {
            subject: SubjectSpec::from(theta),
            cost: mean(&totals).unwrap_or(f64::MAX),
            interval: interval(&totals),
            optimism: independent(&totals, &searched),
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

fn totals(costs: &[DrawCost]) -> Vec<f64> {
    costs.iter().map(DrawCost::total).collect()
}

/// The mean of one sample less that of an independent other, with Welch's interval.
fn independent(one: &[f64], other: &[f64]) -> CostDifference {
    let centre = mean(one).unwrap_or(0.0) - mean(other).unwrap_or(0.0);
    let part = |values: &[f64]| {
        let n = values.len() as f64;
        (standard_deviation(values).unwrap_or(0.0).powi(2) / n, n - 1.0)
    };
    let ((a, na), (b, nb)) = (part(one), part(other));
    let variance = a + b;
    let freedom = if variance > 0.0 { variance * variance / (a * a / na + b * b / nb) } else { na + nb };
    let half = student_t(LEVEL, freedom.max(1.0)) * variance.sqrt();
    CostDifference { mean: centre, interval: [centre - half, centre + half] }
}

/// The mean of one experiment's costs less the other's with the same draws.
fn paired(one: &Fresh, other: &Fresh) -> CostDifference {
    let differences: Vec<f64> = one.totals.iter().zip(&other.totals).map(|(a, b)| a - b).collect();
    CostDifference { mean: mean(&differences).unwrap_or(0.0), interval: interval(&differences) }
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
    let CostDifference { mean, interval } = paired(nominal, robust);
    let verdict = if interval[0] > 0.0 {
        RobustVerdict::RobustBetter
    } else if interval[1] < 0.0 {
        RobustVerdict::RobustWorse
    } else {
        RobustVerdict::NotDistinguished
    };
    DifferenceResult { mean, interval, verdict, no_worse: interval[1] >= 0.0 }
}
