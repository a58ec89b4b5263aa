//! What is written of a fit.

use super::assembly::Assembled;
use super::result::{
    LqgFitCombination, LqgFitConvergence, LqgFitExplanation, LqgFitParameter, LqgFitRefusal, LqgFitResult, LqgFitRole,
    LqgFitSignal,
};
use super::spec::LqgFitSpec;
use crate::analysis::inputs::matrix::rows;
use crate::likelihood::lqg::{Climbed, Explanation, Fit, Hills, Inference, Refusal, Role, Term, inference};
use crate::likelihood::residuals;
use crate::num::distributions::chi_square_quantile;
use crate::num::linalg;
use nalgebra::DMatrix;
use std::collections::BTreeMap;

/// A remaining step below this, in standard errors, is none.
const ARRIVED: f64 = 0.01;
/// Logarithms of two explanations that differ by less are the same.
const SAME: f64 = 0.02;
/// Powers below this are left out of a combination's name.
const WORTH_SAYING: f64 = 0.01;

/// A fit, and what it was made of.
pub(super) struct Found<'a> {
    pub spec: &'a LqgFitSpec,
    pub assembled: &'a Assembled,
    pub fit: &'a Fit,
    pub hills: &'a Hills,
    pub best: &'a Climbed,
    pub known: &'a Inference,
    pub explanations: &'a [Explanation],
    /// Prediction errors of every trial in units of their own standard deviations.
    pub errors: &'a [DMatrix<f64>],
}

fn role(role: Role) -> LqgFitRole {
    match role {
        Role::StateWeight => LqgFitRole::StateWeight,
        Role::PerceivedProcessNoise => LqgFitRole::PerceivedProcessNoise,
        Role::ProcessNoise => LqgFitRole::ProcessNoise,
        Role::MeasurementNoise => LqgFitRole::MeasurementNoise,
        Role::MotorNoise => LqgFitRole::MotorNoise,
        Role::TerminalWeight => LqgFitRole::TerminalWeight,
        Role::ControlWeight => LqgFitRole::ControlWeight,
        Role::PerceivedMeasurementNoise => LqgFitRole::PerceivedMeasurementNoise,
        Role::InitialCovariance => LqgFitRole::InitialCovariance,
        Role::ControlDependentNoise => LqgFitRole::ControlDependentNoise,
    }
}

impl Found<'_> {
    fn terms(&self) -> Vec<&Term> {
        self.assembled.design.free().collect()
    }

    /// Why parameter i has no value, beside other explanations.
    fn refusal(&self, i: usize) -> Option<LqgFitRefusal> {
        self.known.refusals[i].map(|refusal| match refusal {
            Refusal::StandardError(_) => LqgFitRefusal::StandardError,
            Refusal::Open(_) => LqgFitRefusal::OpenInterval,
            Refusal::Wide(_) => LqgFitRefusal::WideInterval,
            Refusal::AtBound => LqgFitRefusal::AtBound,
        })
    }

    pub(super) fn result(&self) -> LqgFitResult {
        let Self { assembled, best, known, .. } = *self;
        let design = &assembled.design;
        let parameters: Vec<LqgFitParameter> =
            self.terms().iter().enumerate().map(|(i, t)| self.parameter(i, t)).collect();
        let top = best.evaluation.log_likelihood;
        let log_likelihoods: Vec<f64> = self.fit.climbs.iter().map(|c| c.evaluation.log_likelihood).collect();
        let climbs = self.fit.climbs.iter().chain(&self.hills.climbs);
        let told = design.is_told && assembled.records.iter().any(|r| r.disturbance.amax() > 0.0);
        LqgFitResult {
            combinations: self.combinations(&parameters),
            parameters,
            explanations: self.explanations.iter().map(|e| self.explanation(e)).collect(),
            twins_outside: (!told && self.hills.missing.is_none()).then_some(self.hills.outside),
            control_weight: (!design.has(Role::ControlWeight)).then(|| rows(&design.control_weight)),
            perceived_measurement_noise: (!design.has(Role::PerceivedMeasurementNoise))
                .then(|| rows(&design.perceived_measurement_noise)),
            log_likelihood: top,
            control: assembled.control,
            samples: assembled.records.iter().map(|r| r.measured.nrows()).sum(),
            sample_time_s: assembled.time.period_s(),
            convergence: LqgFitConvergence {
                converged: known.remaining_step <= ARRIVED,
                remaining_step: known.remaining_step,
                starts: self.fit.starts,
                arrived: self.fit.arrived(top),
                log_likelihoods,
                evaluations: climbs.map(|c| c.evaluations).sum::<usize>() + known.evaluations,
                information_is_observed: known.is_observed,
            },
            signals: self.signals(),
        }
    }

    fn parameter(&self, i: usize, term: &Term) -> LqgFitParameter {
        let theta = self.best.theta[i];
        let differs = self.explanations.iter().any(|e| (e.theta[i] - theta).abs() > SAME);
        let refused = self.refusal(i).or(differs.then_some(LqgFitRefusal::OtherExplanations));
        LqgFitParameter {
            name: term.name.clone(),
            role: role(term.role),
            value: refused.is_none().then(|| theta.exp()),
            log_standard_error: self.known.standard_errors[i],
            interval: self.known.intervals[i].map(|end| end.map(f64::exp)),
            refused,
        }
    }

    fn explanation(&self, explanation: &Explanation) -> LqgFitExplanation {
        let Self { assembled, .. } = *self;
        let design = &assembled.design;
        let mut coefficients = BTreeMap::new();
        let mut refused = Vec::new();
        for (at, term) in design.terms.iter().enumerate() {
            let known = design.parameter(at).is_none_or(|i| self.refusal(i).is_none());
            if !known {
                refused.push(term.role);
            }
            coefficients.insert(term.name.clone(), known.then(|| design.coefficient(at, &explanation.theta)));
        }
        let member = &explanation.member;
        let [of_k, of_l] = explanation.gain_errors();
        let is_known =
            |value: &DMatrix<f64>, error: &DMatrix<f64>| error.norm() <= inference::LARGEST_ERROR * value.norm();
        let knows = |role: Role| !refused.contains(&role);
        let k = is_known(&member.k, &of_k);
        // Without the line that what is sensed goes through.
        let own = assembled.states;
        let square = |m: &DMatrix<f64>| rows(&m.view((0, 0), (own, own)).into_owned());
        let left = |m: &DMatrix<f64>| rows(&m.columns(0, own).into_owned());
        let upper = |m: &DMatrix<f64>| rows(&m.rows(0, own).into_owned());
        let internal = design.internal();
        let poles = || {
            let closed = &internal.a - &internal.b * &member.k;
            let closed = closed.view((0, 0), (own, own)).into_owned();
            let poles = linalg::eigenvalues(&closed).ok()?;
            Some(poles.iter().map(|pole| [pole.re, pole.im]).collect())
        };
        LqgFitExplanation {
            log_likelihood: explanation.log_likelihood,
            coefficients,
            q: knows(Role::StateWeight).then(|| square(&member.q)),
            perceived_process_noise: knows(Role::PerceivedProcessNoise).then(|| square(&member.perceived)),
            k: k.then(|| left(&member.k)),
            k_standard_error: left(&of_k),
            l: is_known(&member.l, &of_l).then(|| upper(&member.l)),
            l_standard_error: upper(&of_l),
            regulator_poles: if k && design.horizon.is_none() { poles() } else { None },
        }
    }

    /// Ratios within a matrix that a refused parameter is in, and the best determined products of refused parameters.
    fn combinations(&self, parameters: &[LqgFitParameter]) -> Vec<LqgFitCombination> {
        let terms = self.terms();
        // Other explanations have other ratios too.
        let is_told_apart = self.explanations.len() <= 1;
        let refused: Vec<usize> = (0..terms.len())
            .filter(|i| is_told_apart && parameters[*i].refused.is_some() && self.best.at_bound[*i] == 0)
            .collect();
        let mut found = Vec::new();
        let mut add = |exponents: Vec<f64>, name: String| {
            let error = self.known.error_of(&exponents);
            if error > inference::LARGEST_ERROR || !error.is_finite() {
                return false;
            }
            let log: f64 = exponents.iter().zip(&self.best.theta).map(|(v, theta)| v * theta).sum();
            let width = chi_square_quantile(self.spec.confidence, 1.0).sqrt() * error;
            let named = terms.iter().zip(&exponents).filter(|(_, v)| **v != 0.0);
            found.push(LqgFitCombination {
                name,
                exponents: named.map(|(term, v)| (term.name.clone(), *v)).collect(),
                value: log.exp(),
                log_standard_error: error,
                interval: [(log - width).exp(), (log + width).exp()],
            });
            true
        };
        let is_inside = |i: usize| self.best.at_bound[i] == 0;
        for (i, first) in terms.iter().enumerate().filter(|(i, _)| is_inside(*i)) {
            for (j, second) in terms.iter().enumerate().skip(i + 1).filter(|(j, _)| is_inside(*j)) {
                if first.role == second.role && (refused.contains(&i) || refused.contains(&j)) {
                    let mut exponents = vec![0.0; terms.len()];
                    (exponents[i], exponents[j]) = (1.0, -1.0);
                    add(exponents, format!("{}/{}", first.name, second.name));
                }
            }
        }
        if refused.len() < 2 {
            return found;
        }
        let covariance =
            DMatrix::from_fn(refused.len(), refused.len(), |i, j| self.known.covariance[(refused[i], refused[j])]);
        let eigen = covariance.symmetric_eigen();
        let mut order: Vec<usize> = (0..refused.len()).collect();
        order.sort_by(|x, y| eigen.eigenvalues[*x].total_cmp(&eigen.eigenvalues[*y]));
        for at in order {
            let vector = eigen.eigenvectors.column(at);
            // The largest power is positive, so that equal answers have equal names.
            let sign = if vector[vector.iamax()] < 0.0 { -1.0 } else { 1.0 };
            let mut exponents = vec![0.0; terms.len()];
            let mut name = Vec::new();
            for (row, i) in refused.iter().enumerate() {
                let power = sign * vector[row];
                exponents[*i] = power;
                if power.abs() >= WORTH_SAYING {
                    name.push(format!("{}^{power:.2}", terms[*i].name));
                }
            }
            if !add(exponents, name.join(" ")) {
                break;
            }
        }
        found
    }

    fn signals(&self) -> Vec<LqgFitSignal> {
        let recorded = &self.assembled.design.recorded;
        let outputs = self.assembled.design.outputs();
        let targets: Vec<&DMatrix<f64>> = self.errors.iter().collect();
        let is_exact = |channel: usize| {
            let noise = recorded.control.as_ref().filter(|_| channel >= outputs && !recorded.is_applied);
            noise.is_some_and(|noise| noise[(channel - outputs, channel - outputs)] == 0.0)
        };
        let name = |i: usize| {
            if i < outputs { format!("output {}", i + 1) } else { format!("control {}", i - outputs + 1) }
        };
        residuals::whiteness(self.errors, &targets)
            .into_iter()
            .enumerate()
            .filter(|(i, _)| !is_exact(*i))
            .map(|(i, white)| LqgFitSignal {
                signal: name(i),
                lag_one_correlation: white.lag_one,
                lags: white.lags,
                whiteness_p: white.p_value,
            })
            .collect()
    }
}
