//! What a comparison found, and what so many people can and cannot show, in sentences.

use super::counts::Proportion;
use super::metric::{GroupContrast, GroupMetric, PairContrast};
use super::people::{Contrast, CurveForm, PersonCurve};
use super::permutation::{Enumeration, fewest_people};
use super::report::{ComparedGroup, ComparedPair, StudyComparison};
use super::series::PracticeAxis;
use super::shape::ErrorSource;
use super::text::{number, symbol};
use crate::learning::curves::Metric;
use crate::learning::inputs::{Remark, SpecChoice};
use crate::trust::MeanTrust;

/// The level of every test.
const LEVEL: f64 = 0.05;

fn interval([low, high]: [f64; 2]) -> String {
    format!("[{}, {}]", number(low), number(high))
}

impl ComparedGroup {
    /// The group's name, with the plant.
    fn name(&self) -> String {
        format!("{} on {}", self.group.as_deref().unwrap_or("people without a group"), self.plant.name)
    }
}

fn what(contrast: Contrast, sessions: Option<[i64; 2]>, axis: &PracticeAxis) -> String {
    let PracticeAxis { first, last, .. } = axis;
    match (contrast, sessions) {
        (Contrast::First, _) => format!("at trial {first}"),
        (Contrast::Last, _) => format!("at trial {last}"),
        (Contrast::Retention, Some([before, after])) => {
            format!("from the end of session {before} to the start of session {after}")
        }
        _ => format!("change from trial {first} to {last}"),
    }
}

fn adjusted(comparison: &StudyComparison, p: Option<f64>, tests: usize) -> String {
    let Some(p) = p else { return "not adjusted, since it could not have come out otherwise".to_owned() };
    let correction = comparison.settings.correction.name();
    let tests = if tests == 1 { "one test".to_owned() } else { format!("{tests} tests") };
    format!("{} after {correction} over {tests}", number(p))
}

pub(super) fn findings(comparison: &StudyComparison) -> Vec<String> {
    let mut found = Vec::new();
    for group in &comparison.groups {
        for metric in &group.metrics {
            for contrast in &metric.contrasts {
                found.extend(change(comparison, group, metric, contrast));
            }
        }
    }
    for pair in &comparison.pairs {
        let names = [&comparison.groups[pair.first], &comparison.groups[pair.second]].map(ComparedGroup::name);
        for metric in &pair.metrics {
            for contrast in &metric.contrasts {
                let what = what(contrast.contrast, contrast.sessions, &comparison.groups[pair.first].practice);
                let head = format!("{} less {}, {}, {what}", names[1], names[0], symbol(metric.metric));
                found.push(match metric.trust.refusal() {
                    Some(refusal) => format!("{head}: no statement: {refusal}"),
                    None => difference(comparison, &names, &head, contrast),
                });
            }
        }
        found.extend(counts(comparison, pair, &names));
    }
    found
}

/// What a group's people did with practice; nothing for values alone.
fn change(
    comparison: &StudyComparison,
    group: &ComparedGroup,
    metric: &GroupMetric,
    contrast: &GroupContrast,
) -> Option<String> {
    if !matches!(contrast.contrast, Contrast::Change | Contrast::Retention) {
        return None;
    }
    let head = format!(
        "{}, {}, {}",
        group.name(),
        symbol(metric.metric),
        what(contrast.contrast, contrast.sessions, &group.practice)
    );
    if let Some(refusal) = metric.trust.refusal() {
        return Some(format!("{head}: no statement: {refusal}"));
    }
    let Some((mean, all)) = contrast.mean.as_ref().and_then(|m| Some((m.coefficients.first()?, m))) else {
        let why = contrast.no_mean.as_deref().unwrap_or("no reason given");
        return Some(format!("{head}: no mean with an interval: {why}."));
    };
    let mut text = format!(
        "{head}: {} {} ({} people; p {}, {})",
        number(mean.value),
        interval(mean.interval95),
        all.k,
        number(mean.p),
        adjusted(comparison, contrast.p_adjusted, comparison.families.changes)
    );
    if let Some(signs) = &contrast.signs {
        if signs.smallest_p > LEVEL {
            text += &format!(
                "; it rests on changes that are normal over people, since no exact test at 5 % exists with so few (its \
                 smallest p is {})",
                number(signs.smallest_p)
            );
        } else {
            text += &format!("; exact test of signs p {}", number(signs.p));
        }
    }
    if all.knapp_hartung_factor < 1.0 && all.tau2 == 0.0 {
        let safe = interval(mean.interval95_factor_at_least_one);
        text += &format!("; {safe} if the mean is no surer than the errors of the values allow");
    }
    if all.tau2 == 0.0 {
        text += &match all.tau2_interval95 {
            Some([_, most]) => {
                let sd = number(most.sqrt());
                format!("; variation between people is estimated as 0, and may have a standard deviation of up to {sd}")
            }
            None => {
                "; people differ less than the errors of their values explain, which may be stated too large".to_owned()
            }
        };
    }
    Some(text + &metric.trust.reservation() + ".")
}

fn difference(comparison: &StudyComparison, names: &[String; 2], head: &str, contrast: &PairContrast) -> String {
    let estimate = contrast.difference.as_ref().map_or_else(
        || {
            let why = contrast.no_difference.as_deref().unwrap_or("no reason given");
            format!("no difference with an interval: {why}")
        },
        |d| format!("{} {}", number(d.difference), interval(d.interval95)),
    );
    let Some(test) = &contrast.permutation else {
        return format!("{head}: {estimate}; one of the groups has nobody with a value.");
    };
    let [n, m] = contrast.people;
    let tests = comparison.families.differences;
    let p = contrast.p_adjusted.unwrap_or(test.p);
    let kind = if test.enumeration == Enumeration::Exact { "exact permutation" } else { "random permutation" };
    let result = format!("{kind} of {n} and {m} people p {}, {}", number(test.p), adjusted(comparison, Some(p), tests));
    let verdict = if test.smallest_p > LEVEL {
        format!(
            "no test at 5 % exists with {n} and {m} people, whose smallest possible p is {}: this says nothing \
             for or against a difference; it takes {} in each group",
            number(test.smallest_p),
            fewest_people(LEVEL)
        )
    } else if test.smallest_p * tests as f64 > LEVEL && p > LEVEL {
        format!(
            "with {tests} tests adjusted for and {n} and {m} people, no single result could have reached 5 %: \
             ask for fewer tests, or take {} people in each group",
            fewest_people(LEVEL / tests as f64)
        )
    } else if p <= LEVEL {
        let higher = if test.difference > 0.0 { &names[1] } else { &names[0] };
        format!("the groups differ, {higher} being higher")
    } else {
        let bounds = test.interval95.or(contrast.difference.as_ref().map(|d| d.interval95));
        let bounds = bounds.map_or_else(String::new, |b| format!(": the data allow anything in {}", interval(b)));
        format!("no difference is shown, which is no proof that there is none{bounds}")
    };
    let power = contrast.detectable_in_sd.map_or_else(String::new, |sd| {
        let here =
            contrast.hedges.as_ref().map_or_else(String::new, |h| format!(" (here {})", number(sd * h.pooled_sd)));
        format!(
            " So many people find a true difference of {} standard deviations{here} in 80 % of studies.",
            number(sd)
        )
    });
    format!("{head}: {estimate}; {result}: {verdict}.{power}")
}

fn share(p: &Proportion) -> String {
    let exact = p.clopper_pearson95.map_or_else(String::new, |i| format!(" {}", interval(i)));
    format!("{} of {}{exact}", p.count, p.of)
}

fn counts(comparison: &StudyComparison, pair: &ComparedPair, names: &[String; 2]) -> Vec<String> {
    let groups = [&comparison.groups[pair.first].counts, &comparison.groups[pair.second].counts];
    let tests = comparison.families.counts;
    let mut found = Vec::new();
    let divergent = groups.map(|g| g.divergent.iter().map(|p| p.divergent.count).sum::<usize>());
    if let (Some(test), true) = (&pair.counts.divergent, divergent.iter().sum::<usize>() > 0) {
        let bounds = test.interval95.map_or_else(String::new, |i| format!(" {}", interval(i)));
        found.push(format!(
            "Divergent trials: {} in {}, {} in {}; their mean share of a person's trials differs by {}{bounds} \
             (permutation of people p {}, {}).",
            divergent[0],
            names[0],
            divergent[1],
            names[1],
            number(test.difference),
            number(test.p),
            adjusted(comparison, pair.counts.divergent_p_adjusted, tests)
        ));
    }
    let threshold = number(comparison.settings.right_control_threshold);
    for (difference, at, of) in [
        (&pair.counts.right_control_first, "first", groups.map(|g| &g.right_control_first.people)),
        (&pair.counts.right_control_last, "last", groups.map(|g| &g.right_control_last.people)),
    ] {
        let Some(d) = difference else { continue };
        let none = if d.p_adjusted.is_some() && d.smallest_p > LEVEL {
            "; no table with these totals reaches 5 %"
        } else {
            ""
        };
        found.push(format!(
            "Right control at the start of the study's {at} trial (|u| > {threshold}): {} people in {}, {} in \
             {}; difference {} {} (Fisher p {}, {}{none}).",
            share(of[0]),
            names[0],
            share(of[1]),
            names[1],
            number(d.difference),
            interval(d.newcombe95),
            number(d.fisher_p),
            adjusted(comparison, d.p_adjusted, tests)
        ));
    }
    found
}

pub(super) fn errors_partly_known(metric: Metric) -> Remark {
    Remark::new(
        "errors_partly_known",
        format!(
            "only some values of {} have a standard error, so that errors are taken from the scatter around each curve",
            symbol(metric)
        ),
    )
}

pub(super) fn jerk_depends_on_duration() -> Remark {
    Remark::new(
        "jerk_depends_on_duration",
        format!(
            "the {} falls with the sixth power of a trial's duration and with the frequencies of its command: its \
             differences are of smoothness only between trials of one command and length",
            symbol(Metric::ControlLogDimensionlessJerk)
        ),
    )
}

pub(super) fn remarks(comparison: &StudyComparison) -> Vec<Remark> {
    let mut remarks = Vec::new();
    for group in &comparison.groups {
        of_group(comparison, group, &mut remarks);
    }
    for pair in &comparison.pairs {
        of_pair(comparison, pair, &mut remarks);
    }
    let mut names: Vec<_> = comparison.groups.iter().map(|g| &g.group).collect();
    names.dedup();
    if names.len() == 1 {
        let text = "there is one group, so that only its change with practice is described";
        remarks.push(Remark::new("one_group", text.to_owned()));
    }
    if comparison.groups.iter().any(|g| g.practice.sessions.len() > 1) && comparison.settings.curve != CurveForm::Trials
    {
        remarks.push(Remark::new(
            "curve_over_sessions",
            "one curve goes through all sessions, as if nothing were forgotten between them; retention says whether"
                .to_owned(),
        ));
    }
    remarks
}

fn of_group(comparison: &StudyComparison, group: &ComparedGroup, remarks: &mut Vec<Remark>) {
    let who = group.name();
    let mut add = |code: &str, text: String| remarks.push(Remark::new(code, format!("{who}: {text}")));
    if let Some(remark) = group.spec.as_ref().and_then(SpecChoice::remark) {
        add("several_specs", remark.message);
    }
    let divergent: usize = group.counts.divergent.iter().map(|p| p.divergent.count).sum();
    if divergent > 0 {
        add("divergent_left_out", format!("{divergent} divergent trials are left out of curves, and counted"));
    }
    for metric in &group.metrics {
        let name = symbol(metric.metric);
        let codes = |chosen: &dyn Fn(&PersonCurve) -> bool| {
            metric.people.iter().filter(|p| chosen(p)).map(|p| p.code.as_str()).collect::<Vec<_>>().join(", ")
        };
        let MeanTrust { do_not_use, of, .. } = metric.trust.mean;
        if do_not_use > 0 {
            let text = format!("{do_not_use} of the {of} values of {name} are not to be used; curves take them in");
            add("values_not_to_be_used", text);
        }
        let without = codes(&|p| p.no_fit.is_some());
        if !without.is_empty() {
            add("person_without_curve", format!("no curve of {name} for {without}; `curve=trials` needs none"));
        }
        let at_bound = codes(&|p| p.fit.as_ref().is_some_and(|f| f.at_bound.is_some()));
        if !at_bound.is_empty() {
            add("shape_at_bound", format!("the rate or exponent of {name} ends at its bound for {at_bound}"));
        }
        let scaled = |p: &PersonCurve| p.fit.as_ref().is_some_and(|f| f.variance_factor > 1.0);
        let scaled = codes(&|p| metric.errors == ErrorSource::Known && scaled(p));
        if !scaled.is_empty() {
            add(
                "known_errors_too_small",
                format!(
                    "the values of {name} scatter more than their errors allow for {scaled}; their errors are scaled up"
                ),
            );
        }
        let extrapolated = |p: &PersonCurve| p.fit.is_some() && (p.first_extrapolated || p.last_extrapolated);
        let beyond = codes(&extrapolated);
        if !beyond.is_empty() {
            let divergent = metric.people.iter().filter(|p| extrapolated(p) && p.divergent > 0).count();
            let fate = if comparison.settings.leave_out_extrapolated { "left out" } else { "taken in" };
            let mut text =
                format!("the first or last value of {name} is an extrapolation for {beyond}, who are {fate}");
            if divergent > 0 {
                text += &format!(
                    "; {divergent} of them have divergent trials: people who could not hold the object are not \
                     missing at random"
                );
            }
            add("extrapolated_people", text);
        }
    }
}

fn of_pair(comparison: &StudyComparison, pair: &ComparedPair, remarks: &mut Vec<Remark>) {
    let names = [&comparison.groups[pair.first], &comparison.groups[pair.second]].map(ComparedGroup::name);
    let who = format!("{} and {}", names[0], names[1]);
    let mut no_test = None;
    let mut random = false;
    for metric in &pair.metrics {
        for contrast in &metric.contrasts {
            if let Some(test) = &contrast.permutation {
                random |= test.enumeration == Enumeration::MonteCarlo;
                if test.smallest_p > LEVEL {
                    no_test = Some((contrast.people, test.smallest_p));
                }
            }
            let Some(main) = &contrast.difference else { continue };
            let exact =
                contrast.permutation.as_ref().map(|test| ("people are only exchangeable (permutation)", test.p));
            let otherwise: Vec<String> = contrast
                .alternatives
                .iter()
                .map(|a| (a.assumption.as_str(), a.p))
                .chain(exact.filter(|_| no_test.is_none()))
                .filter(|(_, p)| (*p <= LEVEL) != (main.p <= LEVEL))
                .map(|(assumption, p)| format!("{assumption} p {}", number(p)))
                .collect();
            if !otherwise.is_empty() {
                remarks.push(Remark::new(
                    "assumption_decides",
                    format!(
                        "{who}, {}, {}: p {} lies on the other side of 5 % where {}",
                        symbol(metric.metric),
                        what(contrast.contrast, contrast.sessions, &comparison.groups[pair.first].practice),
                        number(main.p),
                        otherwise.join("; where ")
                    ),
                ));
            }
        }
    }
    if let Some(([n, m], smallest)) = no_test {
        remarks.push(Remark::new(
            "no_test_exists",
            format!(
                "{who}: with {n} and {m} people the smallest p is {}, so that no test at 5 % exists",
                number(smallest)
            ),
        ));
    }
    if random {
        let text =
            format!("{who}: too many allocations to go through all; p is from random ones, with its standard error");
        remarks.push(Remark::new("random_permutation", text));
    }
}
