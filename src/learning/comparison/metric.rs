//! One metric: the means of each group, and the difference of two.

use super::effect::{HedgesG, detectable_difference, hedges_g, welch};
use super::mixed_model::{MixedModel, TrialRow, mixed_model};
use super::people::{
    Contrast, CurveForm, LeftOut, PersonCurve, PersonValue, curves, of_curves, of_sessions, of_trials,
};
use super::permutation::{Permutation, signs, two_groups};
use super::random_effects::{Difference, RandomEffects, random_effects};
use super::series::{PersonSeries, PracticeAxis};
use super::shape::{ErrorSource, Law, SharedShape, shared_shape};
use crate::learning::curves::Metric;
use crate::learning::trusted::StatementTrust;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The mixed model takes errors as equal in all trials; known variances may differ by this factor.
const NEARLY_EQUAL: f64 = 4.0;

/// How one metric is compared.
#[derive(Debug, Clone, PartialEq)]
pub struct MetricSettings {
    /// What a person's first and last value are.
    pub form: CurveForm,
    /// What is compared.
    pub contrasts: Vec<Contrast>,
    /// Whether people whose value is an extrapolation are left out of means and tests.
    pub leave_out_extrapolated: bool,
    /// Trials at the end and at the start of a session that retention averages over, at most.
    pub retention_trials: usize,
    /// The seed of random allocations.
    pub seed: u64,
}

/// A person's value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ContrastValue {
    /// The pseudonym.
    pub code: String,
    /// The value, in the unit of the metric.
    pub value: f64,
    /// Its standard error; null where it is not known. Then the spread between people holds it.
    pub standard_error: Option<f64>,
}

/// The mean of a group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupContrast {
    /// What is averaged.
    pub contrast: Contrast,
    /// The session before and the session after, for retention; null otherwise.
    #[schemars(with = "Option<Vec<i64>>")]
    pub sessions: Option<[i64; 2]>,
    /// The people in it.
    pub people: Vec<ContrastValue>,
    /// The people who are not, and why.
    pub left_out: Vec<LeftOut>,
    /// The mean by random effects, with the Knapp–Hartung interval.
    pub mean: Option<RandomEffects>,
    /// Why there is no mean with an interval.
    pub no_mean: Option<String>,
    /// For change and retention: the exact test that ups and downs are equally likely. Null for values, which no one
    /// expects to be 0.
    pub signs: Option<Permutation>,
    /// For change and retention: the p-value of the mean adjusted for all changes that are tested in this answer.
    pub p_adjusted: Option<f64>,
}

/// A group in one metric.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupMetric {
    /// The metric.
    pub metric: Metric,
    /// Where the errors of people's values come from.
    pub errors: ErrorSource,
    /// Everybody's curve.
    pub people: Vec<PersonCurve>,
    /// The means.
    pub contrasts: Vec<GroupContrast>,
    /// How far statements about them may go.
    #[serde(default)]
    pub trust: StatementTrust,
}

/// The same difference under another assumption.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "AlternativeDifference")]
pub struct Alternative {
    /// The assumption, in words.
    pub assumption: String,
    /// The difference, in the unit of the metric.
    pub difference: f64,
    /// Its 95 % interval.
    pub interval95: [f64; 2],
    /// The two-sided p-value of 0, not adjusted.
    pub p: f64,
}

/// The difference between two groups.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairContrast {
    /// What is compared.
    pub contrast: Contrast,
    /// The session before and the session after, for retention; null otherwise.
    #[schemars(with = "Option<Vec<i64>>")]
    pub sessions: Option<[i64; 2]>,
    /// People in the first and in the second group.
    #[schemars(with = "Vec<usize>")]
    pub people: [usize; 2],
    /// The exact permutation test over people, and its interval: it assumes nothing but that people are exchangeable.
    pub permutation: Option<Permutation>,
    /// Its p-value adjusted for all differences that are tested in this answer.
    pub p_adjusted: Option<f64>,
    /// Second mean less first, each with its own τ²: it weighs people by the errors of their values.
    pub difference: Option<Difference>,
    /// Why there is no such difference.
    pub no_difference: Option<String>,
    /// The standardised difference.
    pub hedges: Option<HedgesG>,
    /// The true difference, in standard deviations of people, that a t test at 5 % with so many people finds in 80 % of
    /// studies.
    pub detectable_in_sd: Option<f64>,
    /// The same difference under other assumptions.
    pub alternatives: Vec<Alternative>,
}

/// Two groups in one metric.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PairMetric {
    /// The metric.
    pub metric: Metric,
    /// The differences.
    pub contrasts: Vec<PairContrast>,
    /// The rate of the exponential that everybody shares, for the mixed model.
    pub shared_rate: Option<SharedShape>,
    /// The mixed model on single trials.
    pub mixed_model: Option<MixedModel>,
    /// Why there is none.
    pub no_mixed_model: Option<String>,
    /// How far statements about them may go: that of the worse group.
    #[serde(default)]
    pub trust: StatementTrust,
}

/// A contrast with the sessions that it is between.
type Asked = (Contrast, Option<[i64; 2]>);

fn asked(settings: &MetricSettings, axis: &PracticeAxis) -> Vec<Asked> {
    let sessions: Vec<i64> = axis.sessions.iter().filter_map(|s| s.session).collect();
    let mut asked = Vec::new();
    for contrast in &settings.contrasts {
        match contrast {
            Contrast::Retention => {
                asked.extend(sessions.windows(2).map(|pair| (Contrast::Retention, Some([pair[0], pair[1]]))));
            }
            one => asked.push((*one, None)),
        }
    }
    asked
}

/// The people's values of one contrast.
struct Values {
    kept: Vec<PersonValue>,
    extrapolated: Vec<PersonValue>,
    left_out: Vec<LeftOut>,
}

/// A group with its curves.
struct Fitted<'a> {
    people: &'a [PersonSeries],
    curves: Vec<PersonCurve>,
}

struct Comparer<'a> {
    settings: &'a MetricSettings,
    axis: &'a PracticeAxis,
    errors: ErrorSource,
}

impl Comparer<'_> {
    fn values(&self, group: &Fitted, (contrast, sessions): Asked) -> Values {
        let (all, mut left_out) = match sessions {
            Some([before, after]) => {
                let block = self.settings.retention_trials;
                of_sessions(group.people, (Some(before), Some(after)), block, self.errors)
            }
            None if self.settings.form == CurveForm::Trials => {
                of_trials(group.people, contrast, self.errors, self.axis)
            }
            None => of_curves(&group.curves, contrast),
        };
        let leave_out = self.settings.leave_out_extrapolated;
        let (extrapolated, kept): (Vec<_>, Vec<_>) = all.into_iter().partition(|v| leave_out && v.extrapolated);
        for person in &extrapolated {
            let reason = "the value is an extrapolation beyond the person's own trials".to_owned();
            left_out.push(LeftOut { code: person.code.clone(), reason });
        }
        Values { kept, extrapolated, left_out }
    }

    fn group_contrast(&self, group: &Fitted, asked: Asked) -> GroupContrast {
        let (contrast, sessions) = asked;
        let Values { kept, left_out, .. } = self.values(group, asked);
        let (y, v) = lists(&kept);
        let mean = random_effects(&y, &v, None);
        let is_change = matches!(contrast, Contrast::Change | Contrast::Retention);
        GroupContrast {
            contrast,
            sessions,
            people: kept
                .iter()
                .map(|p| ContrastValue {
                    code: p.code.clone(),
                    value: p.value,
                    standard_error: (p.variance > 0.0).then(|| p.variance.sqrt()),
                })
                .collect(),
            left_out,
            no_mean: mean.as_ref().err().map(ToString::to_string),
            mean: mean.ok(),
            signs: if is_change { signs(&y, self.settings.seed) } else { None },
            p_adjusted: None,
        }
    }
}

fn lists(values: &[PersonValue]) -> (Vec<f64>, Vec<f64>) {
    values.iter().map(|p| (p.value, p.variance)).unzip()
}

/// A group's curves and means in one metric; nothing is known here of how far the values may be used.
#[must_use]
pub fn group_metric(
    metric: Metric,
    people: &[PersonSeries],
    errors: ErrorSource,
    axis: &PracticeAxis,
    settings: &MetricSettings,
) -> GroupMetric {
    let comparer = Comparer { settings, axis, errors };
    let group = Fitted { people, curves: curves(people, settings.form.law(), errors, axis) };
    let contrasts = asked(settings, axis).into_iter().map(|asked| comparer.group_contrast(&group, asked)).collect();
    GroupMetric { metric, errors, people: group.curves, contrasts, trust: StatementTrust::default() }
}

/// The differences of two groups in one metric, second less first; likewise.
#[must_use]
pub fn pair_metric(
    metric: Metric,
    first: &[PersonSeries],
    second: &[PersonSeries],
    errors: ErrorSource,
    axis: &PracticeAxis,
    settings: &MetricSettings,
) -> PairMetric {
    let comparer = Comparer { settings, axis, errors };
    let law = settings.form.law();
    let fitted = |people, law| Fitted { people, curves: curves(people, law, errors, axis) };
    let groups = [fitted(first, law), fitted(second, law)];
    let other_law = law.map(|law| if law == Law::Exponential { Law::Power } else { Law::Exponential });
    let others = other_law.map(|law| (law, [fitted(first, Some(law)), fitted(second, Some(law))]));
    let shared_rate = shared_rate(first, second);
    let models = models(first, second, errors, shared_rate.as_ref());
    let mut contrasts = Vec::new();
    for asked in asked(settings, axis) {
        let values = groups.each_ref().map(|group| comparer.values(group, asked));
        let mut pair = pair_contrast(asked, [&values[0].kept, &values[1].kept], settings.seed);
        if values.iter().any(|v| !v.extrapolated.is_empty()) {
            let all = values.each_ref().map(|v| [v.kept.clone(), v.extrapolated.clone()].concat());
            let assumption = "people whose value is an extrapolation are taken in";
            pair.alternatives.extend(own_tau2(&all[0], &all[1]).map(|d| alternative(assumption.to_owned(), &d)));
        }
        if let (Some((law, others)), None) = (&others, asked.1) {
            let values = others.each_ref().map(|group| comparer.values(group, asked));
            let assumption = format!("the curves are {}", law.name());
            let difference = own_tau2(&values[0].kept, &values[1].kept);
            pair.alternatives.extend(difference.map(|d| alternative(assumption, &d)));
        }
        if asked.1.is_none() {
            pair.alternatives.extend(models.iter().flatten().filter_map(|model| from_model(model, asked.0, axis)));
        }
        contrasts.push(pair);
    }
    let (mixed_model, no_mixed_model) = match models {
        Ok(models) => (models.into_iter().next(), None),
        Err(why) => (None, Some(why)),
    };
    PairMetric { metric, contrasts, shared_rate, mixed_model, no_mixed_model, trust: StatementTrust::default() }
}

impl Law {
    /// In a sentence.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Exponential => "exponentials",
            Self::Power => "power laws",
        }
    }
}

fn alternative(assumption: String, difference: &Difference) -> Alternative {
    let Difference { difference, interval95, p, .. } = *difference;
    Alternative { assumption, difference, interval95, p }
}

fn own_tau2(first: &[PersonValue], second: &[PersonValue]) -> Option<Difference> {
    let of = |values: &[PersonValue]| {
        let (y, v) = lists(values);
        random_effects(&y, &v, None).ok()
    };
    Difference::of_means(&of(first)?, &of(second)?)
}

fn pair_contrast((contrast, sessions): Asked, groups: [&[PersonValue]; 2], seed: u64) -> PairContrast {
    let [(y1, v1), (y2, v2)] = groups.map(lists);
    let means = [random_effects(&y1, &v1, None), random_effects(&y2, &v2, None)];
    let no_mean = means.iter().zip(["first", "second"]).find_map(|(mean, which)| {
        mean.as_ref().err().map(|why| format!("the {which} group has no mean with an interval: {why}"))
    });
    let mut alternatives = Vec::new();
    let difference = match &means {
        [Ok(first), Ok(second)] => {
            if first.knapp_hartung_factor < 1.0 || second.knapp_hartung_factor < 1.0 {
                let assumption =
                    "means are no surer than the errors of their values allow (factor at least 1)".to_owned();
                let safe = Difference::of_means_with_factor_at_least_one(first, second);
                alternatives.extend(safe.map(|d| alternative(assumption, &d)));
            }
            Difference::of_means(first, second)
        }
        _ => None,
    };
    let no_difference =
        difference.is_none().then(|| no_mean.unwrap_or_else(|| "the difference is not finite".to_owned()));
    let all: Vec<f64> = y1.iter().chain(&y2).copied().collect();
    let variances: Vec<f64> = v1.iter().chain(&v2).copied().collect();
    let group: Vec<f64> = y1.iter().map(|_| 0.0).chain(y2.iter().map(|_| 1.0)).collect();
    if let Some(found) =
        random_effects(&all, &variances, Some(&group)).ok().and_then(|m| m.coefficients.into_iter().nth(1))
    {
        alternatives.push(Alternative {
            assumption: "people vary as much in both groups (one τ²)".to_owned(),
            difference: found.value,
            interval95: found.interval95,
            p: found.p,
        });
    }
    let assumption = "people count equally, whatever the errors of their values (Welch)".to_owned();
    alternatives.extend(welch(&y1, &y2).map(|d| alternative(assumption, &d)));
    PairContrast {
        contrast,
        sessions,
        people: [y1.len(), y2.len()],
        permutation: two_groups(&y1, &y2, seed),
        p_adjusted: None,
        difference,
        no_difference,
        hedges: hedges_g(&y1, &y2),
        detectable_in_sd: detectable_difference(y1.len(), y2.len()),
        alternatives,
    }
}

fn shared_rate(first: &[PersonSeries], second: &[PersonSeries]) -> Option<SharedShape> {
    let people = first.iter().chain(second).map(|p| p.observations(ErrorSource::Residuals));
    shared_shape(Law::Exponential, &people.filter(|points| !points.is_empty()).collect::<Vec<_>>())
}

/// The mixed model at the shared rate, and at the ends of its interval.
fn models(
    first: &[PersonSeries],
    second: &[PersonSeries],
    errors: ErrorSource,
    rate: Option<&SharedShape>,
) -> Result<Vec<MixedModel>, String> {
    let rate = rate.ok_or("there are too few trials for a rate that people share")?;
    if rate.at_bound.is_some() {
        return Err("the rate that people share is at its bound: no exponential describes them".to_owned());
    }
    if errors == ErrorSource::Known {
        let known = first.iter().chain(second).flat_map(PersonSeries::used).filter_map(|p| p.0.standard_error);
        let (least, largest) = known.fold((f64::INFINITY, 0.0_f64), |(a, b), e| (a.min(e), b.max(e)));
        let ratio = (largest / least).powi(2);
        if ratio > NEARLY_EQUAL {
            return Err(format!(
                "it takes errors as equal in all trials, and the known variances differ by a factor of {}",
                super::text::number(ratio)
            ));
        }
    }
    let mut rows = Vec::new();
    let mut people = 0;
    let mut in_group = [0; 2];
    for (at, person) in first.iter().map(|p| (0, p)).chain(second.iter().map(|p| (1, p))) {
        let before = rows.len();
        rows.extend(person.used().map(|(p, value)| TrialRow { person: people, second: at == 1, k: p.k, value }));
        if rows.len() > before {
            people += 1;
            in_group[at] += 1;
        }
    }
    if in_group.iter().any(|people| *people < 2) {
        return Err("it needs two people in each group".to_owned());
    }
    let main = mixed_model(&rows, people, rate.shape).map_err(|why| why.to_string())?;
    let ends = rate.interval95.into_iter().flatten().filter_map(|tau| mixed_model(&rows, people, tau).ok());
    Ok(std::iter::once(main).chain(ends.collect::<Vec<_>>()).collect())
}

fn from_model(model: &MixedModel, contrast: Contrast, axis: &PracticeAxis) -> Option<Alternative> {
    let decay = |k: f64| Law::Exponential.basis(k, model.tau_trials);
    let (asymptotes, decay) = match contrast {
        Contrast::First => (1.0, decay(axis.first)),
        Contrast::Last => (1.0, decay(axis.last)),
        Contrast::Change => (0.0, decay(axis.last) - decay(axis.first)),
        Contrast::Retention => return None,
    };
    let found = model.difference(asymptotes, decay)?;
    let tau = super::text::number(model.tau_trials);
    Some(Alternative {
        assumption: format!("mixed model on single trials, everybody with τ = {tau} trials"),
        difference: found.difference,
        interval95: found.interval95,
        p: found.p,
    })
}
