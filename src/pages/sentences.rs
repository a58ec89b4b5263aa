//! Who learned what, in sentences that say no more than their numbers carry.

use super::numbers::{p_value, share, with_interval};
use super::trust::chip;
use crate::figure::text::{listed, three};
use crate::learning::comparison::metric::{GroupContrast, MetricSettings};
use crate::learning::comparison::people::{Contrast, CurveForm};
use crate::learning::comparison::report::ComparedGroup;
use crate::learning::curves::{CurveOptions, CurvePoint, Metric};
use crate::learning::groups::GroupCurve;
use crate::learning::{ComparisonOptions, StatementTrust, StudyLearningCurves, SubjectInput, compare};
use crate::trust::{Level, ROWS, Trust};
use maud::{Markup, html};
use std::collections::BTreeMap;

/// What the sentences are about, in their order.
const METRICS: [Metric; 3] = [Metric::MeanAbsError, Metric::NormFeedforwardPlantMinusOne, Metric::NormFeedback];

/// Fewer people than this are no group to speak of.
const LEAST_PEOPLE: usize = 3;

/// What a quantity is called within a sentence.
pub(super) fn phrase(metric: Metric) -> &'static str {
    match metric {
        Metric::MeanAbsError => "the tracking error",
        Metric::RmsError => "the root mean square error",
        Metric::NormFeedback => "the gain of the feedback, ‖Gfb‖,",
        Metric::NormFeedforwardMinusInverse => "the distance ‖Gff\u{a0}−\u{a0}G⁻¹‖",
        Metric::NormFeedforwardPlantMinusOne => {
            "the distance of the feedforward from the inverse, ‖Gff\u{a0}G\u{a0}−\u{a0}1‖,"
        }
        Metric::VarianceAccountedFor => "the share of the output that is explained",
        Metric::ControlLogDimensionlessJerk => "the smoothness of the control",
    }
}

/// A quantity of a group from its first trial to its last.
struct Step {
    metric: Metric,
    /// First and last values of the people who have both.
    pairs: Vec<[f64; 2]>,
    /// How far each of these may be used.
    trust: Vec<Trust>,
    /// How far a sentence about them may go.
    statement: StatementTrust,
    change: Option<GroupContrast>,
    tests: usize,
}

/// The sentences of a group.
pub(super) struct Told {
    name: String,
    plant: String,
    /// First and last trial in words.
    ends: [String; 2],
    steps: Vec<Step>,
    /// People who lack a first or a last value, with why.
    lacking: Vec<String>,
}

/// Of every group on every plant.
pub(super) fn told(curves: &StudyLearningCurves, subjects: &[SubjectInput], options: &CurveOptions) -> Vec<Told> {
    curves.groups.iter().filter_map(|group| of_group(group, subjects, options)).collect()
}

fn of_group(group: &GroupCurve, subjects: &[SubjectInput], options: &CurveOptions) -> Option<Told> {
    // By itself: tests between groups belong to a page of their own, and take long with many people.
    let own: Vec<SubjectInput> = subjects.iter().filter(|subject| subject.group == group.group).cloned().collect();
    let settings = MetricSettings {
        form: CurveForm::Trials,
        contrasts: vec![Contrast::Change],
        ..ComparisonOptions::default().settings
    };
    let asked = ComparisonOptions {
        metrics: METRICS.to_vec(),
        settings,
        estimator: options.estimator,
        spec_sha256: group.spec.as_ref().map(|spec| spec.spec_sha256.clone()),
        ..ComparisonOptions::default()
    };
    let comparison = compare(&own, &asked).ok()?;
    let tests = comparison.families.changes;
    let found = comparison.groups.into_iter().find(|found| found.plant == group.plant)?;
    let steps: Vec<Step> = METRICS.iter().filter_map(|metric| step(*metric, group, &found, tests)).collect();
    let mut lacking: Vec<String> = Vec::new();
    for left in steps.iter().filter_map(|step| step.change.as_ref()).flat_map(|change| &change.left_out) {
        let words = format!("{}: {}", left.code, left.reason);
        if !lacking.contains(&words) {
            lacking.push(words);
        }
    }
    let ends = [found.practice.first, found.practice.last].map(|k| format!("trial {k}"));
    let name = group.group.clone().unwrap_or_else(|| "Without a group".to_owned());
    Some(Told { name, plant: group.plant.name.clone(), ends, steps, lacking })
}

fn step(metric: Metric, group: &GroupCurve, found: &ComparedGroup, tests: usize) -> Option<Step> {
    let own = found.metrics.iter().find(|own| own.metric == metric)?;
    let change = own.contrasts.iter().find(|own| own.contrast == Contrast::Change).cloned();
    let sessions = &found.practice.sessions;
    let k = |point: &CurvePoint| {
        let offset = sessions.iter().find(|own| own.session == point.session).map_or(0, |own| own.offset);
        (point.number + offset) as f64
    };
    let (mut pairs, mut trust) = (Vec::new(), Vec::new());
    for person in change.iter().flat_map(|change| &change.people) {
        let Some(subject) = group.subjects.iter().find(|subject| subject.code == person.code) else { continue };
        let at = |end: f64| subject.curve.points.iter().find(|point| k(point) == end);
        let Some((first, last)) = at(found.practice.first).zip(at(found.practice.last)) else { continue };
        let Some((from, to)) = first.value(metric).zip(last.value(metric)) else { continue };
        pairs.push([from, to]);
        trust.extend([first, last].into_iter().filter_map(|point| point.trust(metric)).cloned());
    }
    let statement = StatementTrust::of(&trust);
    Some(Step { metric, pairs, trust, statement, change, tests })
}

impl Step {
    fn mean(&self, end: usize) -> f64 {
        self.pairs.iter().map(|pair| pair[end]).sum::<f64>() / self.pairs.len() as f64
    }

    /// The sentence, without the group's name; `ends` are the trials in words where it is the first.
    fn sentence(&self, ends: Option<&[String; 2]>) -> Markup {
        let what = phrase(self.metric);
        let n = self.pairs.len();
        if n == 0 {
            return html! { b { "No statement" } " about " (what.trim_end_matches(','))
            ": nobody has both a first and a last value. " };
        }
        let (from, to) = (self.mean(0), self.mean(1));
        if let Some(refusal) = self.statement.refusal() {
            return html! {
                b { "No statement" } " about " (what.trim_end_matches(',')) " (means " (three(from)) " → " (three(to))
                "): " (refusal) " "
            };
        }
        if n < LEAST_PEOPLE {
            return html! {
                b { "No statement" } " about " (what.trim_end_matches(',')) ": of " (LEAST_PEOPLE)
                " people who are needed, " (n) " " (if n == 1 { "has" } else { "have" })
                " both a first and a last value (means " (three(from)) " → " (three(to)) "). "
            };
        }
        let mean = self.change.as_ref().and_then(|change| change.mean.as_ref());
        let named = if ends.is_some() { what.to_owned() } else { capital(what) };
        let coefficient = mean.and_then(|mean| mean.coefficients.first());
        let is_told = coefficient.is_some_and(|c| c.interval95[0] > 0.0 || c.interval95[1] < 0.0);
        let verb = match (is_told, to < from) {
            (true, true) => "fell",
            (true, false) => "rose",
            (false, _) => "went",
        };
        let adjusted = self.change.as_ref().and_then(|change| change.p_adjusted);
        html! {
            @if let Some([first, last]) = ends { "from " (first) " to " (last) " " }
            (named) " " (verb) " from " (three(from)) " to " (three(to)) " ("
            @if let Some(share) = share(to - from, from) { b { (share) } ", " }
            @if let Some(c) = coefficient { "mean change " (with_interval(c.value, Some(c.interval95))) ", " }
            "n = " (n)
            @if let Some(p) = adjusted.or(coefficient.map(|c| c.p)) { ", " (p_value(p)) }
            ")" (self.statement.reservation())
            @if coefficient.is_some() && !is_told { ", a change that its interval does not tell from none" }
            @if coefficient.is_none() {
                @if let Some(why) = self.change.as_ref().and_then(|change| change.no_mean.as_deref()) {
                    "; no interval: " (why)
                }
            }
            ". "
        }
    }
}

/// The card's content: a paragraph for each group, then what the trust in them rests on.
pub(super) fn markup(all: &[Told]) -> Markup {
    html! {
        @for (at, told) in all.iter().enumerate() {
            p.told {
                (key(at, all.len())) " "
                b { (told.name) } " on " (told.plant) ": "
                @for (at, step) in told.steps.iter().enumerate() { (step.sentence((at == 0).then_some(&told.ends))) }
                @if !told.lacking.is_empty() {
                    span.muted { "Left out: " (listed(&told.lacking.iter().take(4).cloned().collect::<Vec<_>>())) "." }
                }
            }
        }
        div.basis { (basis(all)) }
    }
}

/// The line that stands for a group in figures; more groups than inks share none.
pub(super) fn key(at: usize, groups: usize) -> Markup {
    let class = if groups > 4 { "fi-1".to_owned() } else { format!("fi-{}", at + 1) };
    html! {
        svg.key viewBox="0 0 22 8" width="22" height="8" aria-hidden="true" {
            path class={ (class) " f-line f-thick" } d="M0 4h22" {}
        }
    }
}

/// For each quantity the level of its sentences, with the reason that most of its values have.
fn basis(all: &[Told]) -> Markup {
    let of = |metric: Metric| {
        let steps = all.iter().flat_map(|told| &told.steps).filter(move |step| step.metric == metric);
        steps.flat_map(|step| &step.trust)
    };
    let tests = all.iter().flat_map(|told| &told.steps).map(|step| step.tests).max().unwrap_or(0);
    html! {
        @for metric in METRICS {
            @let trust: Vec<&Trust> = of(metric).collect();
            @if let Some(worst) = trust.iter().map(|trust| trust.level).max() {
                p {
                    (chip(worst, worst.words())) " " (capital(phrase(metric).trim_end_matches(',')))
                    @match most_usual(&trust, worst) {
                        Some((why, n)) => { ": in " (n) " of " (trust.len()) " values, " (why) "." },
                        None => { ": measured, not identified; nothing speaks against it." },
                    }
                }
            }
        }
        @if tests > 0 {
            p.muted {
                "First and last values are those of the trials themselves; the change is the mean over people with its "
                "95 % interval (random effects, Knapp–Hartung)"
                @if tests > 1 { "; p is adjusted after Holm over the " (tests) " tests of a group" } "."
            }
        }
    }
}

/// The finding that decides in most values of the worst level; where its numbers differ, as the rule has it. None where
/// nothing speaks against any value.
fn most_usual(trust: &[&Trust], worst: Level) -> Option<(String, usize)> {
    let mut by_code: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for own in trust.iter().filter(|own| own.level == worst && own.level != Level::Ok) {
        by_code.entry(&own.code).or_default().push(&own.because);
    }
    let (code, found) = by_code.into_iter().max_by_key(|(_, found)| found.len())?;
    let first = *found.first()?;
    let row = ROWS.iter().find(|row| row.code == code);
    let said = if found.iter().all(|own| *own == first) { first } else { row.map_or(first, |row| row.condition) };
    Some((said.to_owned(), found.len()))
}

/// With a capital letter first.
pub(super) fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}
