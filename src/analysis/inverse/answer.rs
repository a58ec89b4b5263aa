//! The answer to the question about one half.

use super::doubts::{within_digits, would_pass_as_filter};
use super::findings::Findings;
use super::half::Half;
use super::problems;
use super::regulator::InverseLqrResult;
use super::spec::{CheckedSpec, DescentSpec, DescentStart, DescentStartName};
use super::warnings::{Doubts, descent_broke_off, descent_from_identity, fit_left_out, warn};
use crate::analysis::contract::Failure;
use crate::analysis::report::Warning;
use crate::convex::lmi::LmiError;
use crate::ctl::Ctl;
use crate::inverse::fit::{
    CROSS_TERM, CrossTerm, Descent, DescentError, DescentSettings, Objective, descent, fit, fits, smallest_cross_term,
};
use crate::inverse::lqr::gain_factor;
use crate::inverse::{Gains, inverse_lqr};
use nalgebra::DMatrix;

/// Answers with the letters of a regulator: a filter's are those of its dual.
///
/// Progress counts two steps: the verdict and the fit.
///
/// # Errors
/// [`Failure::Stopped`] when `ctl` says so, [`Failure::Problem`] where working precision proves no verdict.
pub(in crate::analysis) fn answer(
    half: &Half,
    spec: &CheckedSpec,
    warnings: &mut Vec<Warning>,
    ctl: &Ctl,
) -> Result<InverseLqrResult, Failure> {
    let gains = &half.gains;
    let settings = spec.settings();
    let mut answer = inverse_lqr(gains, &settings, ctl).map_err(|error| problems::inverse(&error))?;
    answer.decision.factor = gain_factor(gains, &answer.decision, ctl).map_err(|error| problems::inverse(&error))?;
    ctl.advance(1);
    let mut findings = Findings { answer, fitted: None, cross_term: None, descent: None };
    let doubts = Doubts {
        within_digits: within_digits(half, &findings.answer, ctl)?,
        would_pass_as_filter: would_pass_as_filter(half, &findings.answer, ctl)?,
    };
    let wanted = spec.used.fit.as_ref().filter(|_| findings.answer.weights.is_none());
    if wanted.is_some() && !fits(gains, &settings.structure) {
        warnings.push(fit_left_out(gains));
    } else if let Some(written) = wanted {
        let found = fit(gains, &spec.fit_settings(written), ctl).map_err(|error| problems::fit(&error))?;
        findings.fitted = Some(found);
        if settings.structure.is_free() && gains.states() + gains.ports() <= CROSS_TERM {
            findings.cross_term = smallest_cross_term(gains, ctl).map(Some).or_else(|error| match error {
                LmiError::Stopped(stopped) => Err(Failure::Stopped(stopped)),
                LmiError::Infeasible { .. } => Ok(None),
            })?;
        }
        if let Some(wanted) = &written.descent {
            findings.descent = descended(gains, spec, wanted, findings.cross_term.as_ref(), warnings, ctl)?;
        }
    }
    ctl.advance(1);
    warn(gains, &findings.answer, findings.fitted.as_ref(), &doubts, warnings);
    Ok(InverseLqrResult::new(half, &findings))
}

/// The descent of Priess 2015, Table 3.1; a warning in its place where it meets weights without a regulator.
fn descended(
    gains: &Gains,
    spec: &CheckedSpec,
    wanted: &DescentSpec,
    cross_term: Option<&CrossTerm>,
    warnings: &mut Vec<Warning>,
    ctl: &Ctl,
) -> Result<Option<Descent>, Failure> {
    let (n, m) = (gains.states(), gains.ports());
    let identity = || [DMatrix::identity(n, n), DMatrix::identity(m, m)];
    let [q, r] = match (&wanted.start, cross_term) {
        (DescentStart::Name(DescentStartName::Identity), _) => identity(),
        (DescentStart::Name(DescentStartName::CrossTerm), Some(found)) => [found.q.clone(), found.r.clone()],
        (DescentStart::Name(DescentStartName::CrossTerm), None) => {
            warnings.push(descent_from_identity());
            identity()
        }
        (DescentStart::Weights(weights), _) => weights.checked([n, m], "/spec/fit/descent/start")?,
    };
    let settings = DescentSettings { rate: wanted.rate, steps: wanted.steps };
    match descent(&Objective::new(gains, spec.metric.as_ref()), &q, &r, settings, ctl) {
        Ok(found) => Ok(Some(found)),
        Err(DescentError::Stopped(stopped)) => Err(stopped.into()),
        Err(DescentError::Riccati(error)) => {
            warnings.push(descent_broke_off(&error));
            Ok(None)
        }
    }
}
