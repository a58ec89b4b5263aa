//! What stands around the answer: tests of hypotheses, the change of the feedback, neighbouring forms.

use super::assembly::{Assembly, doubt, noise};
use super::result::{
    FeedbackChange, FeedforwardTestResult, HypothesisResults, InverseTrap, MovingAverageAnswer, NormResult,
    ProfileEntry,
};
use super::spec::{AUTOREGRESSIVE, FEEDBACK_DELAY_S};
use crate::ctl::Ctl;
use crate::prediction_error::change::change_of_feedback;
use crate::prediction_error::controllers::Norm;
use crate::prediction_error::estimate::{Estimate, EstimateError, Settings, estimate};
use crate::prediction_error::hypotheses::{no_feedback, no_feedforward, unchanged_feedback};
use crate::prediction_error::lags::Lags;
use num_complex::Complex64;

/// Steps that progress counts.
pub(super) const ESTIMATES: u64 = 6;

/// Order of the moving average that stands beside an answer whose residuals are not white.
const MOVING_AVERAGE: usize = 2;

/// How far the largest delay is moved in the profile, in seconds.
const DELAY_MOVED_S: f64 = 0.08;

/// `None` in place of an estimate that these trials do not determine.
fn unless_impossible<T>(found: Result<T, EstimateError>) -> Result<Option<T>, EstimateError> {
    match found {
        Ok(found) => Ok(Some(found)),
        Err(EstimateError::Stopped(stopped)) => Err(EstimateError::Stopped(stopped)),
        Err(_) => Ok(None),
    }
}

pub(super) fn hypotheses(assembly: &Assembly<'_>, ctl: &Ctl) -> Result<HypothesisResults, EstimateError> {
    let (records, settings) = (assembly.records, &assembly.resolved.settings);
    let count = records.len();
    let determined = (0..count).all(|i| assembly.found.undetermined(i) == 0);
    let needed = if determined { unless_impossible(no_feedforward(records, settings, ctl))? } else { None };
    let halves: Vec<usize> = (0..count).map(|i| usize::from(2 * i >= count)).collect();
    let unchanged =
        if count > 1 { unless_impossible(unchanged_feedback(records, &halves, settings, ctl))? } else { None };
    let result = HypothesisResults {
        no_feedback: no_feedback(records, settings, ctl)?.into(),
        no_feedforward: needed.map(|found| FeedforwardTestResult {
            test: found.test.into(),
            penalty: found.penalty,
            error_lags: found.lags,
            needed: found.is_needed(),
        }),
        unchanged_feedback: unchanged.map(Into::into),
    };
    ctl.advance(1);
    Ok(result)
}

pub(super) fn change(
    assembly: &Assembly<'_>,
    trials: usize,
    ctl: &Ctl,
) -> Result<Option<FeedbackChange>, EstimateError> {
    let (records, resolved) = (assembly.records, assembly.resolved);
    ctl.advance(1);
    if trials == 0 {
        return Ok(None);
    }
    let (first, last) = (&records[..trials], &records[records.len() - trials..]);
    let found = change_of_feedback(first, last, &resolved.settings, resolved.band_rad_s, ctl);
    let Some(found) = unless_impossible(found)?.flatten() else { return Ok(None) };
    let mut doubts = [None, None];
    for ((block, estimate), into) in [first, last].into_iter().zip(&found.estimates).zip(&mut doubts) {
        *into = doubt(&estimate.residual_tests(block, ctl)?.all_white);
    }
    let reason = doubts[0].clone().or_else(|| doubts[1].clone());
    Ok(Some(FeedbackChange {
        trials,
        first: NormResult::new(&found.first, doubts[0].clone()),
        last: NormResult::new(&found.last, doubts[1].clone()),
        change: found.change,
        interval_95: reason.is_none().then_some(found.interval),
        nominal_interval: found.interval,
        reason,
    }))
}

/// A norm, mean over the trials; `None` where a trial has none.
fn mean_norm(assembly: &Assembly<'_>, found: &Estimate, norm: Norm) -> Option<f64> {
    let of = |i: usize| {
        let undetermined = norm != Norm::Feedback && found.undetermined(i) > 0;
        let value = found.norm(i, norm, &*assembly.plant, assembly.resolved.band_rad_s);
        value.filter(|_| !undetermined).map(|v| v.value)
    };
    let values: Option<Vec<f64>> = (0..found.records.len()).map(of).collect();
    crate::num::stats::mean(&values?)
}

/// Forms beside that of the answer, whose lags are as good a guess.
fn neighbours(lags: &Lags, sample_time_s: f64) -> Vec<(String, Lags)> {
    let moved = ((DELAY_MOVED_S / sample_time_s).round() as usize).max(1);
    let [least, largest] = lags.feedback;
    let mut forms = Vec::new();
    for order in [lags.autoregressive.saturating_sub(1), lags.autoregressive + 1] {
        if order != lags.autoregressive {
            let lags = Lags { autoregressive: order, ..lags.clone() };
            forms.push((format!("lags of the control: {order}"), lags));
        }
    }
    for largest in [largest.saturating_sub(moved).max(least), largest + moved] {
        let delay = largest as f64 * sample_time_s;
        let lags = Lags { feedback: [least, largest], ..lags.clone() };
        forms.push((format!("largest delay of the feedback: {delay:.3} s"), lags));
    }
    if lags.ahead > 0 {
        let lags = Lags { ahead: 0, terms: lags.terms.min(lags.behind), ..lags.clone() };
        forms.push(("no preview".to_owned(), lags));
    }
    let behind = 2 * lags.behind;
    let seconds = behind as f64 * sample_time_s;
    let terms = (lags.terms + 2).min(lags.ahead + behind);
    forms.push((
        format!("memory of the feedforward: {seconds:.3} s, {terms} polynomials"),
        Lags { behind, terms, ..lags.clone() },
    ));
    forms.retain(|(_, lags)| lags.check().is_ok());
    forms
}

pub(super) fn profile(assembly: &Assembly<'_>, ctl: &Ctl) -> Result<Vec<ProfileEntry>, EstimateError> {
    let settings = &assembly.resolved.settings;
    let mut entries = vec![entry(assembly, "the answer".to_owned(), Some(assembly.found))];
    for (form, lags) in neighbours(&settings.lags, assembly.resolved.sample_time_s) {
        let moved = Settings { lags, ..settings.clone() };
        let found = unless_impossible(estimate(assembly.records, &moved, ctl))?;
        entries.push(entry(assembly, form, found.as_ref()));
    }
    ctl.advance(1);
    Ok(entries)
}

fn entry(assembly: &Assembly<'_>, form: String, found: Option<&Estimate>) -> ProfileEntry {
    let of = |norm| found.and_then(|found| mean_norm(assembly, found, norm));
    ProfileEntry {
        form,
        norm_feedback: of(Norm::Feedback),
        norm_feedforward_plant_minus_one: of(Norm::FeedforwardPlantMinusOne),
    }
}

pub(super) fn inverse_trap(assembly: &Assembly<'_>, ctl: &Ctl) -> Result<InverseTrap, EstimateError> {
    let (found, resolved) = (assembly.found, assembly.resolved);
    let [from, to] = resolved.band_rad_s;
    let (mut product, mut own, mut inverse) = (0.0, 0.0, 0.0);
    for k in 0..100 {
        let omega = from + (to - from) * (f64::from(k) + 0.5) / 100.0;
        let fb = found.controllers(0, omega).feedback.value;
        let target = -Complex64::from(1.0) / (assembly.plant)(omega);
        product += (fb * target.conj()).re;
        own += fb.norm_sqr();
        inverse += target.norm_sqr();
    }
    let cosine = Some(product / (own * inverse).sqrt()).filter(|c| c.is_finite());
    let time = resolved.sample_time_s;
    let least = ((FEEDBACK_DELAY_S[0] / time - 1e-6).ceil() as usize).max(1);
    let largest = ((FEEDBACK_DELAY_S[1] / time + 1e-6).floor() as usize).max(least);
    let lags = &resolved.settings.lags;
    let default = Lags {
        feedback: [least, largest],
        autoregressive: AUTOREGRESSIVE.min(least),
        moving_average: 0,
        ..lags.clone()
    };
    let ratio_to_default = if default.feedback == lags.feedback && default.autoregressive == lags.autoregressive {
        None
    } else {
        let settings = Settings { lags: default, ..resolved.settings.clone() };
        let other = unless_impossible(estimate(assembly.records, &settings, ctl))?;
        let norms = [Some(found), other.as_ref()].map(|e| e.and_then(|e| mean_norm(assembly, e, Norm::Feedback)));
        norms[0].zip(norms[1]).map(|(a, b)| a / b).filter(|r| r.is_finite())
    };
    let weights = found.feedback_weights(0);
    let largest = weights.iter().fold(0.0_f64, |a, w| a.max(w.abs()));
    let largest_at_least_delay = weights.first().is_some_and(|w| w.abs() >= largest && largest > 0.0);
    ctl.advance(1);
    Ok(InverseTrap { cosine, ratio_to_default, largest_at_least_delay })
}

/// The answer with a moving average, where the residuals are not white.
pub(super) fn moving_average(assembly: &Assembly<'_>, ctl: &Ctl) -> Result<Option<MovingAverageAnswer>, EstimateError> {
    let settings = &assembly.resolved.settings;
    let each_white = assembly.tests.whiteness.iter().all(|test| doubt(test).is_none());
    if settings.lags.moving_average > 0 || (each_white && doubt(&assembly.tests.all_white).is_none()) {
        return Ok(None);
    }
    let lags = Lags { moving_average: MOVING_AVERAGE, ..settings.lags.clone() };
    let settings = Settings { lags, ..settings.clone() };
    let Some(found) = unless_impossible(estimate(assembly.records, &settings, ctl))? else { return Ok(None) };
    let tests = found.residual_tests(assembly.records, ctl)?;
    let of = |norm: Norm| {
        (0..found.records.len()).map(|i| assembly.norm(&found, i, norm, &tests.whiteness[i])).collect::<Vec<_>>()
    };
    Ok(Some(MovingAverageAnswer {
        noise: noise(&found, 0),
        whiteness: tests.all_white.into(),
        settled: found.settled,
        norm_feedback: of(Norm::Feedback),
        norm_feedforward_plant_minus_one: of(Norm::FeedforwardPlantMinusOne),
    }))
}
