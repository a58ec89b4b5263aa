//! What each person contributes to a comparison: a fitted curve, or the trials themselves.

use super::series::{PersonSeries, PracticeAxis, SeriesPoint};
use super::shape::{Bound, ErrorSource, Estimate, Law, PersonFit, fit};
use crate::num::stats::{mean, standard_deviation};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A person whose last trial comes before this share of the study's practice has no last value but an extrapolation.
const NEARLY_ALL: f64 = 0.75;

/// What a person's first and last value are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CurveForm {
    /// Values of a fitted exponential.
    #[default]
    Exponential,
    /// Values of a fitted power law. Its exponent often ends at a bound.
    Power,
    /// The first and the last trial themselves, without a curve: for few trials of each person.
    Trials,
}

impl CurveForm {
    pub(super) fn law(self) -> Option<Law> {
        match self {
            Self::Exponential => Some(Law::Exponential),
            Self::Power => Some(Law::Power),
            Self::Trials => None,
        }
    }
}

/// What is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "ComparedContrast")]
pub enum Contrast {
    /// The value at the study's first trial.
    First,
    /// The value at the study's last trial.
    Last,
    /// Last less first.
    Change,
    /// From the end of one session to the start of the next: the mean over the first trials there less the mean over
    /// the last trials before. 0 is full retention; for an error, positive is forgetting.
    Retention,
}

/// The curve of one person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PersonCurve {
    /// The pseudonym.
    pub code: String,
    /// Trials with a value that the curve is fitted to.
    pub trials: usize,
    /// Divergent trials, which are left out.
    pub divergent: usize,
    /// Trials without a value.
    pub without_value: usize,
    /// The fitted curve; null where there is none, or where trials themselves are compared.
    pub fit: Option<PersonFit>,
    /// Why there is no curve.
    pub no_fit: Option<String>,
    /// The other law on the same trials, for comparison.
    pub other_law: Option<OtherLaw>,
    /// Whether the person has no value at the study's first trial, so that its first value and its change are
    /// extrapolations.
    pub first_extrapolated: bool,
    /// Whether the person's trials end before three quarters of the study's practice, so that its last value and its
    /// change are extrapolations.
    pub last_extrapolated: bool,
}

/// How another law describes a person's trials. It has as many parameters, so that the smaller residual sum fits
/// better.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OtherLaw {
    /// The law.
    pub law: Law,
    /// Its shape parameter.
    pub shape: f64,
    /// The bound that it is at, where it is.
    pub at_bound: Option<Bound>,
    /// Its weighted residual sum of squares.
    pub weighted_rss: f64,
}

/// A person's value with the variance of its error; 0 where that is not known.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PersonValue {
    pub code: String,
    pub value: f64,
    pub variance: f64,
    pub extrapolated: bool,
}

/// A person without a value.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "PersonLeftOut")]
pub struct LeftOut {
    /// The pseudonym.
    pub code: String,
    /// Why.
    pub reason: String,
}

/// The curves of one group in one metric.
pub(super) fn curves(
    people: &[PersonSeries],
    law: Option<Law>,
    errors: ErrorSource,
    axis: &PracticeAxis,
) -> Vec<PersonCurve> {
    let curve = |person: &PersonSeries| {
        let points = person.observations(errors);
        let fitted = law.map(|law| fit(law, &points, errors, axis.first, axis.last));
        let other = law.map(|law| if law == Law::Exponential { Law::Power } else { Law::Exponential });
        let other_law = other.and_then(|law| fit(law, &points, errors, axis.first, axis.last).ok()).map(|fit| {
            let PersonFit { law, shape, at_bound, weighted_rss, .. } = fit;
            OtherLaw { law, shape, at_bound, weighted_rss }
        });
        let begins = points.iter().map(|p| p.k).fold(f64::INFINITY, f64::min);
        let ends = points.iter().map(|p| p.k).fold(f64::NEG_INFINITY, f64::max);
        let reached = axis.first + NEARLY_ALL * (axis.last - axis.first);
        let divergent = person.divergent();
        PersonCurve {
            code: person.code.clone(),
            trials: points.len(),
            divergent,
            without_value: person.points.len() - divergent - points.len(),
            no_fit: fitted.as_ref().and_then(|f| f.as_ref().err()).map(ToString::to_string),
            fit: fitted.and_then(Result::ok),
            other_law,
            first_extrapolated: begins > axis.first,
            last_extrapolated: ends < reached,
        }
    };
    people.iter().map(curve).collect()
}

/// The values of a contrast that curves give, and who has none.
pub(super) fn of_curves(curves: &[PersonCurve], contrast: Contrast) -> (Vec<PersonValue>, Vec<LeftOut>) {
    let (mut values, mut left_out) = (Vec::new(), Vec::new());
    for curve in curves {
        let Some(fit) = &curve.fit else {
            let reason = curve.no_fit.clone().unwrap_or_else(|| "no curve".to_owned());
            left_out.push(LeftOut { code: curve.code.clone(), reason });
            continue;
        };
        let (Estimate { value, standard_error }, extrapolated) = match contrast {
            Contrast::First => (fit.first, curve.first_extrapolated),
            Contrast::Last => (fit.last, curve.last_extrapolated),
            Contrast::Change | Contrast::Retention => (fit.change, curve.first_extrapolated || curve.last_extrapolated),
        };
        let variance = standard_error * standard_error;
        values.push(PersonValue { code: curve.code.clone(), value, variance, extrapolated });
    }
    (values, left_out)
}

/// The values of a contrast from the first and last trial themselves.
pub(super) fn of_trials(
    people: &[PersonSeries],
    contrast: Contrast,
    errors: ErrorSource,
    axis: &PracticeAxis,
) -> (Vec<PersonValue>, Vec<LeftOut>) {
    let (mut values, mut left_out) = (Vec::new(), Vec::new());
    for person in people {
        let at = |k: f64| trial_value(person, k, errors);
        let found = match contrast {
            Contrast::First => at(axis.first),
            Contrast::Last => at(axis.last),
            Contrast::Change | Contrast::Retention => {
                at(axis.first).and_then(|first| at(axis.last).map(|last| (last.0 - first.0, last.1 + first.1)))
            }
        };
        match found {
            Ok((value, variance)) => {
                values.push(PersonValue { code: person.code.clone(), value, variance, extrapolated: false });
            }
            Err(reason) => left_out.push(LeftOut { code: person.code.clone(), reason }),
        }
    }
    (values, left_out)
}

fn trial_value(person: &PersonSeries, k: f64, errors: ErrorSource) -> Result<(f64, f64), String> {
    let point = person.points.iter().find(|p| p.k == k).ok_or_else(|| format!("trial {k} was not recorded"))?;
    if point.divergent {
        return Err(format!("trial {k} is divergent"));
    }
    let value = point.value.ok_or_else(|| format!("trial {k} has no value"))?;
    Ok((value, known_variance(point, errors)))
}

fn known_variance(point: &SeriesPoint, errors: ErrorSource) -> f64 {
    point.standard_error.filter(|_| errors == ErrorSource::Known).map_or(0.0, |e| e * e)
}

/// From the last trials of `before` to the first of `after`: at most `block` of each.
///
/// Where errors are not known, that of a block's mean is the scatter within it, learning within the block included.
pub(super) fn of_sessions(
    people: &[PersonSeries],
    (before, after): (Option<i64>, Option<i64>),
    block: usize,
    errors: ErrorSource,
) -> (Vec<PersonValue>, Vec<LeftOut>) {
    let (mut values, mut left_out) = (Vec::new(), Vec::new());
    let needed = if errors == ErrorSource::Known { 1 } else { 2 };
    let summary = |points: &[(&SeriesPoint, f64)], session: Option<i64>| {
        let trials: Vec<f64> = points.iter().map(|p| p.1).collect();
        let name = session.map_or_else(|| "the trials without session".to_owned(), |s| format!("session {s}"));
        let too_few = || format!("{name} has {} trials with a value, and {needed} are needed", trials.len());
        if trials.len() < needed {
            return Err(too_few());
        }
        let n = trials.len() as f64;
        let centre = mean(&trials).ok_or_else(too_few)?;
        let variance = match errors {
            ErrorSource::Known => points.iter().map(|p| known_variance(p.0, errors)).sum::<f64>() / (n * n),
            ErrorSource::Residuals => standard_deviation(&trials).map_or(0.0, |sd| sd * sd / n),
        };
        Ok((centre, variance))
    };
    for person in people {
        let of = |session| person.used().filter(move |p| p.0.session == session);
        let mut ends: Vec<_> = of(before).rev().take(block).collect();
        ends.reverse();
        let begins: Vec<_> = of(after).take(block).collect();
        let found = summary(&ends, before).and_then(|end| Ok((end, summary(&begins, after)?)));
        match found {
            Ok((end, begin)) => values.push(PersonValue {
                code: person.code.clone(),
                value: begin.0 - end.0,
                variance: begin.1 + end.1,
                extrapolated: false,
            }),
            Err(reason) => left_out.push(LeftOut { code: person.code.clone(), reason }),
        }
    }
    (values, left_out)
}
