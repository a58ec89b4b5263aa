//! The comparison of a study's groups.

use super::metric::{GroupMetric, MetricSettings, PairMetric, group_metric, pair_metric};
use super::multiple::Correction;
use super::people::{Contrast, CurveForm};
use super::people_counts::{TrialKey, group_counts, pair_counts};
use super::report::{ComparedGroup, ComparedPair, ComparisonSettings, Families, StudyComparison};
use super::series::{PersonSeries, PracticeAxis, error_source, series};
use super::shape::ErrorSource;
use super::words;
use crate::learning::curves::{CurveOptions, CurvePoint, Metric, point};
use crate::learning::groups::{Cell, cells};
use crate::learning::inputs::{Estimator, SubjectInput};
use crate::learning::time_domain::START_THRESHOLD;
use crate::learning::trusted::StatementTrust;
use std::collections::BTreeSet;

/// Pairs of groups that are compared at most: the time of a request.
pub const MOST_PAIRS: usize = 6;

/// What is compared, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct ComparisonOptions {
    /// The metrics, each once.
    pub metrics: Vec<Metric>,
    /// How each is compared.
    pub settings: MetricSettings,
    /// How p-values are adjusted.
    pub correction: Correction,
    /// Only these groups; all where it is `None`.
    pub groups: Option<Vec<String>>,
    /// Which estimate of the controllers the norms are of.
    pub estimator: Estimator,
    /// Only identifications with this spec; without it, those with the spec that covers most trials.
    pub spec_sha256: Option<String>,
    /// The threshold on |u| that the trials' first controls were judged with.
    pub right_control_threshold: f64,
}

impl Default for ComparisonOptions {
    /// Error, feedback and feedforward: each other metric is nearly one of them again, and costs power.
    fn default() -> Self {
        Self {
            metrics: vec![Metric::MeanAbsError, Metric::NormFeedback, Metric::NormFeedforwardPlantMinusOne],
            settings: MetricSettings {
                form: CurveForm::Exponential,
                contrasts: vec![Contrast::First, Contrast::Last, Contrast::Change, Contrast::Retention],
                leave_out_extrapolated: true,
                retention_trials: 5,
                seed: 1,
            },
            correction: Correction::Holm,
            groups: None,
            estimator: Estimator::default(),
            spec_sha256: None,
            right_control_threshold: START_THRESHOLD,
        }
    }
}

impl ComparisonOptions {
    fn curves(&self) -> CurveOptions {
        CurveOptions { estimator: self.estimator, spec_sha256: self.spec_sha256.clone(), ..CurveOptions::default() }
    }
}

/// Why groups cannot be compared.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoComparison {
    /// A group that was asked for does not exist.
    #[error("no trial of a group '{name}'; there are trials of {known}")]
    UnknownGroup {
        /// The group.
        name: String,
        /// Those that have trials.
        known: String,
    },
    /// Too many pairs.
    #[error("{pairs} pairs of groups are more than {MOST_PAIRS}")]
    TooManyPairs {
        /// Pairs.
        pairs: usize,
    },
}

fn chosen(subjects: &[SubjectInput], options: &ComparisonOptions) -> Vec<SubjectInput> {
    let wanted = |s: &&SubjectInput| {
        options.groups.as_ref().is_none_or(|names| s.group.as_ref().is_some_and(|group| names.contains(group)))
    };
    subjects.iter().filter(wanted).cloned().collect()
}

/// The first and last trial of the cells that are compared with each other, by session and number: for each cell.
fn ends(cells: &[Cell], pairs: &[(usize, usize)]) -> Vec<(TrialKey, TrialKey)> {
    let mut ends: Vec<(TrialKey, TrialKey)> = Vec::new();
    for cell in cells {
        let keys = || cell.subjects.iter().flat_map(|s| &s.1).map(|t| (t.session, t.number));
        // A cell is made of a trial.
        let (first, last) = keys().min().zip(keys().max()).unwrap_or_default();
        ends.push((first, last));
    }
    // Cells in a chain of pairs share their ends; as many rounds as there are pairs reach the end of any chain.
    for (i, j) in pairs.iter().cycle().take(pairs.len() * pairs.len()) {
        let shared = (ends[*i].0.min(ends[*j].0), ends[*i].1.max(ends[*j].1));
        (ends[*i], ends[*j]) = (shared, shared);
    }
    ends
}

/// The ids of everybody's first and last trial, whose first controls are counted: with another threshold than the
/// stored one these must be judged anew.
#[must_use]
pub fn first_and_last_trials(subjects: &[SubjectInput], options: &ComparisonOptions) -> Vec<String> {
    let subjects = chosen(subjects, options);
    let (cells, _) = cells(&subjects, &options.curves());
    let ends = ends(&cells, &pairs(&cells));
    let mut found = Vec::new();
    for (cell, (first, last)) in cells.iter().zip(ends) {
        let trials = cell.subjects.iter().flat_map(|s| &s.1);
        found.extend(trials.filter(|t| [first, last].contains(&(t.session, t.number))).map(|t| t.trial.clone()));
    }
    found
}

/// Compares the groups of a study.
///
/// # Errors
/// [`NoComparison`].
pub fn compare(subjects: &[SubjectInput], options: &ComparisonOptions) -> Result<StudyComparison, NoComparison> {
    let groups_with_trials: BTreeSet<&str> =
        subjects.iter().filter(|s| !s.trials.is_empty()).filter_map(|s| s.group.as_deref()).collect();
    for name in options.groups.iter().flatten() {
        if !groups_with_trials.contains(name.as_str()) {
            let known: Vec<&str> = groups_with_trials.iter().copied().collect();
            let known = if known.is_empty() { "no group".to_owned() } else { known.join(", ") };
            return Err(NoComparison::UnknownGroup { name: name.clone(), known });
        }
    }
    let subjects = chosen(subjects, options);
    let (cells, mut remarks) = cells(&subjects, &options.curves());
    let pairs = pairs(&cells);
    if pairs.len() > MOST_PAIRS {
        return Err(NoComparison::TooManyPairs { pairs: pairs.len() });
    }
    let MetricSettings { form, leave_out_extrapolated, retention_trials, seed, .. } = options.settings;
    let mut comparison = StudyComparison {
        settings: ComparisonSettings {
            curve: form,
            correction: options.correction,
            leave_out_extrapolated,
            retention_trials,
            right_control_threshold: options.right_control_threshold,
            seed,
        },
        groups: Vec::new(),
        pairs: Vec::new(),
        families: Families { differences: 0, changes: 0, counts: 0 },
        findings: Vec::new(),
        remarks: Vec::new(),
    };
    if let Some(whole) = axis(&subjects) {
        fill(&mut comparison, &cells, &pairs, &whole, options);
    }
    adjust(&mut comparison, options.correction);
    remarks.append(&mut comparison.remarks);
    remarks.extend(words::remarks(&comparison));
    comparison.remarks = remarks;
    comparison.findings = words::findings(&comparison);
    Ok(comparison)
}

fn axis(subjects: &[SubjectInput]) -> Option<PracticeAxis> {
    let keys: Vec<Vec<TrialKey>> =
        subjects.iter().map(|s| s.trials.iter().map(|t| (t.session, t.number)).collect()).collect();
    PracticeAxis::new(keys.iter().map(Vec::as_slice))
}

/// Which cells are compared, by index.
fn pairs(cells: &[Cell]) -> Vec<(usize, usize)> {
    let mut pairs = Vec::new();
    for (i, first) in cells.iter().enumerate() {
        for (j, second) in cells.iter().enumerate().skip(i + 1) {
            if first.group == second.group {
                continue;
            }
            let plants = |group| cells.iter().filter(move |c| c.group == group).map(|c| &c.plant.id);
            let second_plants: BTreeSet<_> = plants(second.group.clone()).collect();
            let share = plants(first.group.clone()).any(|plant| second_plants.contains(plant));
            if !share || first.plant.id == second.plant.id {
                pairs.push((i, j));
            }
        }
    }
    pairs
}

fn fill(
    comparison: &mut StudyComparison,
    cells: &[Cell],
    pairs: &[(usize, usize)],
    whole: &PracticeAxis,
    options: &ComparisonOptions,
) {
    let settings = &options.settings;
    let ends = ends(cells, pairs);
    let k = |(session, number): TrialKey| whole.k(session, number);
    let axes: Vec<PracticeAxis> = ends
        .iter()
        .map(|(first, last)| PracticeAxis { first: k(*first), last: k(*last), sessions: whole.sessions.clone() })
        .collect();
    // One source of errors for everybody, so that groups are not weighed differently.
    let mut by_metric: Vec<(Metric, Vec<Vec<PersonSeries>>, ErrorSource)> = Vec::new();
    for metric in &options.metrics {
        let people: Vec<Vec<PersonSeries>> = cells.iter().map(|cell| series(cell, *metric, whole)).collect();
        let (errors, is_mixed) = error_source(people.iter().flatten());
        if is_mixed {
            comparison.remarks.push(words::errors_partly_known(*metric));
        }
        by_metric.push((*metric, people, errors));
    }
    if options.metrics.contains(&Metric::ControlLogDimensionlessJerk) {
        comparison.remarks.push(words::jerk_depends_on_duration());
    }
    let has_values = |people: &[PersonSeries]| people.iter().any(|p| p.used().next().is_some());
    for (i, cell) in cells.iter().enumerate() {
        let metrics = by_metric
            .iter()
            .filter(|(_, people, _)| has_values(&people[i]))
            .map(|(metric, people, errors)| GroupMetric {
                trust: statement(cell, *metric, options.estimator),
                ..group_metric(*metric, &people[i], *errors, &axes[i], settings)
            })
            .collect();
        let (first, last) = ends[i];
        comparison.groups.push(ComparedGroup {
            group: cell.group.clone(),
            plant: cell.plant.clone(),
            spec: cell.spec.clone(),
            practice: axes[i].clone(),
            people: cell.subjects.len(),
            metrics,
            counts: group_counts(cell, first, last, options.right_control_threshold),
        });
    }
    for (first, second) in pairs {
        let metrics = by_metric
            .iter()
            .filter(|(_, people, _)| has_values(&people[*first]) && has_values(&people[*second]))
            .map(|(metric, people, errors)| PairMetric {
                trust: trust_of_pair(&comparison.groups, [*first, *second], *metric),
                ..pair_metric(*metric, &people[*first], &people[*second], *errors, &axes[*first], settings)
            })
            .collect();
        let counts = pair_counts(&comparison.groups[*first].counts, &comparison.groups[*second].counts, settings.seed);
        comparison.pairs.push(ComparedPair { first: *first, second: *second, metrics, counts });
    }
}

/// How far a statement about everybody's values in a group may go; divergent trials are part of none.
fn statement(cell: &Cell, metric: Metric, estimator: Estimator) -> StatementTrust {
    let trials = cell.subjects.iter().flat_map(|(_, trials)| trials).filter(|trial| !trial.divergent);
    let points: Vec<CurvePoint> = trials.map(|trial| point(trial, 1, cell.spec.as_ref(), estimator)).collect();
    let with = points.iter().filter(|point| point.value(metric).is_some());
    StatementTrust::of(with.filter_map(|point| point.trust(metric)))
}

/// How far statements about the difference of two groups may go: that of the worse one.
fn trust_of_pair(groups: &[ComparedGroup], pair: [usize; 2], metric: Metric) -> StatementTrust {
    let of = |group: usize| groups[group].metrics.iter().find(|own| own.metric == metric).map(|own| &own.trust);
    match pair.map(of) {
        [Some(first), Some(second)] => first.worse(second).clone(),
        _ => StatementTrust::default(),
    }
}

/// Adjusts a family of p-values: each is read and given back adjusted. Returns how many there are.
fn adjust_family(correction: Correction, tests: Vec<(f64, &mut Option<f64>)>) -> usize {
    let (p, targets): (Vec<f64>, Vec<_>) = tests.into_iter().unzip();
    for (adjusted, target) in correction.adjust(&p).into_iter().zip(targets) {
        *target = Some(adjusted);
    }
    p.len()
}

fn adjust(comparison: &mut StudyComparison, correction: Correction) {
    let contrasts = comparison.pairs.iter_mut().flat_map(|p| &mut p.metrics).flat_map(|m| &mut m.contrasts);
    let tests = contrasts.filter_map(|c| Some((c.permutation.as_ref()?.p, &mut c.p_adjusted))).collect();
    comparison.families.differences = adjust_family(correction, tests);

    let contrasts = comparison.groups.iter_mut().flat_map(|g| &mut g.metrics).flat_map(|m| &mut m.contrasts);
    let changes = contrasts.filter(|c| matches!(c.contrast, Contrast::Change | Contrast::Retention));
    let tests = changes.filter_map(|c| Some((c.mean.as_ref()?.coefficients.first()?.p, &mut c.p_adjusted))).collect();
    comparison.families.changes = adjust_family(correction, tests);

    let mut tests = Vec::new();
    let groups = &comparison.groups;
    let has_divergent = |i: usize| groups[i].counts.people_with_divergent_trials.count > 0;
    for pair in &mut comparison.pairs {
        let counts = &mut pair.counts;
        // Counts that could not have come out otherwise are no tests.
        let divergent = counts.divergent.as_ref().filter(|_| has_divergent(pair.first) || has_divergent(pair.second));
        tests.extend(divergent.map(|d| d.p).map(|p| (p, &mut counts.divergent_p_adjusted)));
        let of_people =
            [&mut counts.people_with_divergent_trials, &mut counts.right_control_first, &mut counts.right_control_last];
        let could_differ = of_people.into_iter().flatten().filter(|d| d.smallest_p < 1.0 - 1e-9);
        tests.extend(could_differ.map(|d| (d.fisher_p, &mut d.p_adjusted)));
    }
    comparison.families.counts = adjust_family(correction, tests);
}
