//! Learning curves as aligned text.

use super::story::{End, Story};
use crate::learning::StudyLearningCurves;
use crate::learning::curves::{CurvePoint, Metric};
use crate::learning::frequency_domain::ControllerMetrics;
use crate::learning::groups::{GroupCurve, GroupPoint, Statistics};
use crate::num::stats::mean;
use std::collections::BTreeMap;
use std::io::{self, Write};

/// The quantities printed, with their names.
const PRINTED: [(Metric, &str); 2] = [
    (Metric::MeanAbsError, "‖e‖ = mean |r − y|"),
    (Metric::NormFeedforwardPlantMinusOne, "‖Gff G − 1‖: distance of the feedforward from the inverse dynamics"),
];
const LABEL: usize = 10;
const CELL: usize = 8;

/// What simulated subjects really did, by pseudonym and trial number.
pub type Truth = BTreeMap<(String, i64), ControllerMetrics>;

/// Prints a table for each group and quantity: one row per subject, one column per trial, then mean, standard deviation
/// and number of the shown values, and the mean of the truth where it is known.
///
/// # Errors
/// Where `out` cannot be written.
pub fn print(out: &mut impl Write, curves: &StudyLearningCurves, truth: &Truth) -> io::Result<()> {
    for group in &curves.groups {
        let name = group.group.as_deref().unwrap_or("without group");
        writeln!(out, "\nGroup {name} on plant {} ({} subjects)", group.plant.name, group.subjects.len())?;
        for (metric, title) in PRINTED {
            if group.subjects.iter().flat_map(|s| &s.curve.points).any(|p| p.value(metric).is_some()) {
                table(out, group, metric, title, truth)?;
            }
        }
    }
    for remark in &curves.remarks {
        writeln!(out, "note: {}", remark.message)?;
    }
    Ok(())
}

fn table(out: &mut impl Write, group: &GroupCurve, metric: Metric, title: &str, truth: &Truth) -> io::Result<()> {
    writeln!(out, "\n  {title}")?;
    row(out, "trial", group.points.iter().map(heading))?;
    for subject in &group.subjects {
        let cell = |at: &GroupPoint| {
            let same = |session: Option<i64>, number: i64| (session, number) == (at.session, at.number);
            match subject.curve.points.iter().find(|p| same(p.session, p.number)) {
                Some(point) => point.value(metric).map_or_else(|| "?".to_owned(), number),
                None if subject.curve.left_out.iter().any(|t| same(t.session, t.number)) => "div.".to_owned(),
                None => "-".to_owned(),
            }
        };
        row(out, &subject.code, group.points.iter().map(cell))?;
    }
    let statistics = || group.points.iter().map(|p| of(p, metric));
    row(out, "mean", statistics().map(|s| s.mean.map_or_else(|| "-".to_owned(), number)))?;
    row(out, "SD", statistics().map(|s| s.sd.map_or_else(|| "-".to_owned(), number)))?;
    row(out, "n", statistics().map(|s| s.n.to_string()))?;
    let true_means: Vec<Option<f64>> = group.points.iter().map(|at| true_mean(group, at, metric, truth)).collect();
    if true_means.iter().any(Option::is_some) {
        row(out, "true mean", true_means.into_iter().map(|t| t.map_or_else(|| "-".to_owned(), number)))?;
    }
    Ok(())
}

/// Over the same subjects as the mean of what was identified.
fn true_mean(group: &GroupCurve, at: &GroupPoint, metric: Metric, truth: &Truth) -> Option<f64> {
    let shown = group.subjects.iter().filter(|s| {
        let same = |p: &&CurvePoint| (p.session, p.number) == (at.session, at.number);
        s.curve.points.iter().find(same).is_some_and(|p| p.value(metric).is_some())
    });
    let values: Option<Vec<f64>> = shown
        .map(|s| {
            let norms = truth.get(&(s.code.clone(), at.number))?;
            match metric {
                Metric::NormFeedback => norms.norm_feedback,
                Metric::NormFeedforwardMinusInverse => norms.norm_feedforward_minus_inverse,
                Metric::NormFeedforwardPlantMinusOne => norms.norm_feedforward_plant_minus_one,
                Metric::MeanAbsError
                | Metric::RmsError
                | Metric::VarianceAccountedFor
                | Metric::ControlLogDimensionlessJerk => None,
            }
        })
        .collect();
    mean(&values?)
}

fn row(out: &mut impl Write, label: &str, cells: impl Iterator<Item = String>) -> io::Result<()> {
    let cells: String = cells.map(|cell| format!(" {cell:>CELL$}")).collect();
    writeln!(out, "    {label:<LABEL$}{cells}")
}

fn heading(point: &GroupPoint) -> String {
    point.session.map_or_else(|| point.number.to_string(), |session| format!("{session}/{}", point.number))
}

/// Four significant digits.
pub fn number(value: f64) -> String {
    let digits = if value == 0.0 { 0 } else { value.abs().log10().floor() as i32 };
    if !(-4..7).contains(&digits) {
        return format!("{value:.2e}");
    }
    format!("{value:.*}", usize::try_from(3 - digits).unwrap_or(0))
}

fn of(point: &GroupPoint, metric: Metric) -> &Statistics {
    let m = &point.metrics;
    match metric {
        Metric::MeanAbsError => &m.mean_abs_error,
        Metric::RmsError => &m.rms_error,
        Metric::NormFeedback => &m.norm_feedback,
        Metric::NormFeedforwardMinusInverse => &m.norm_feedforward_minus_inverse,
        Metric::NormFeedforwardPlantMinusOne => &m.norm_feedforward_plant_minus_one,
        Metric::VarianceAccountedFor => &m.variance_accounted_for,
        Metric::ControlLogDimensionlessJerk => &m.control_log_dimensionless_jerk,
    }
}

/// The ways of estimating side by side, group by group, then what they teach and how to go on.
///
/// # Errors
/// Where `out` cannot be written.
pub fn print_story(out: &mut impl Write, story: &Story) -> io::Result<()> {
    writeln!(out)?;
    for line in &story.heading {
        writeln!(out, "{line}")?;
    }
    for group in &story.groups {
        writeln!(out, "\nGroup {} on plant {} ({} people)", group.name, group.plant, group.people)?;
        for table in &group.tables {
            writeln!(out, "\n  {}: {}", table.symbol, table.meaning)?;
            let heading = ["estimator", "stimuli", "first trial", "last trial", "trust"];
            story_row(out, heading.map(str::to_owned))?;
            for row in &table.rows {
                let [first, last] = &row.ends;
                let cells = [row.title.to_owned(), row.stimuli.to_owned(), end(first), end(last), row.trust()];
                story_row(out, cells)?;
            }
            let [first, last] = table.truth.map(|value| value.map_or_else(|| "-".to_owned(), number));
            story_row(out, ["truth".to_owned(), String::new(), first, last, String::new()])?;
        }
    }
    writeln!(out)?;
    for sentence in story.lessons.iter().chain(&story.findings) {
        writeln!(out, "- {sentence}")?;
    }
    writeln!(out, "\nNext:")?;
    for command in &story.next {
        writeln!(out, "  {command}")?;
    }
    Ok(())
}

fn story_row(out: &mut impl Write, cells: [String; 5]) -> io::Result<()> {
    let [title, stimuli, first, last, trust] = cells;
    let line = format!("    {title:<21} {stimuli:<14} {first:<24} {last:<24} {trust}");
    writeln!(out, "{}", line.trim_end())
}

/// A mean with the mean of its intervals.
pub fn end(end: &End) -> String {
    match (end.value, end.interval) {
        (None, _) => "-".to_owned(),
        (Some(value), None) => number(value),
        (Some(value), Some([low, high])) => format!("{} [{}, {}]", number(value), number(low), number(high)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learning::time_domain::TimeDomainMetrics;
    use crate::learning::{CurveOptions, PlantName, SubjectInput, TrialInput, study_learning_curves};

    fn trial(number: i64, error: f64, divergent: bool) -> TrialInput {
        TrialInput {
            trial: number.to_string(),
            number,
            session: None,
            plant: PlantName { id: "p".to_owned(), name: "lag".to_owned() },
            divergent,
            excluded: None,
            metrics: TimeDomainMetrics {
                mean_abs_error: error,
                rms_error: error,
                max_abs_output: 1.0,
                control_log_dimensionless_jerk: None,
                right_control_at_start: None,
                right_control_undetermined: None,
                right_control_time_s: None,
                right_control_threshold: 0.05,
            },
            identifications: Vec::new(),
            by_other_estimators: Vec::new(),
        }
    }

    #[test]
    fn a_table_has_a_row_per_subject_and_says_what_is_missing() {
        let subject = |code: &str, trials| SubjectInput {
            subject: code.to_owned(),
            code: code.to_owned(),
            group: Some("g".to_owned()),
            trials,
        };
        let study = [
            subject("A", vec![trial(1, 1.0, false), trial(2, 0.5, false)]),
            subject("B", vec![trial(1, 3.0, false), trial(2, 9.0, true), trial(3, 0.25, false)]),
        ];
        let curves = study_learning_curves(&study, &CurveOptions::default());
        let mut text = Vec::new();
        print(&mut text, &curves, &Truth::new()).unwrap();
        let text = String::from_utf8(text).unwrap();
        let rows: Vec<Vec<&str>> = text.lines().map(|l| l.split_whitespace().collect()).collect();
        for expected in [
            vec!["trial", "1", "2", "3"],
            vec!["A", "1.000", "0.5000", "-"],
            vec!["B", "3.000", "div.", "0.2500"],
            vec!["mean", "2.000", "0.5000", "0.2500"],
            vec!["SD", "1.414", "-", "-"],
            vec!["n", "2", "1", "1"],
        ] {
            assert!(rows.contains(&expected), "{expected:?} in\n{text}");
        }
        assert!(!text.contains("Gfb"), "a quantity that no trial has needs no table:\n{text}");
        assert!(text.contains("1 divergent trials are left out"), "{text}");
    }

    #[test]
    fn numbers_have_four_digits() {
        let cases = [
            (0.0, "0.000"),
            (0.12345, "0.1235"),
            (1.0, "1.000"),
            (-12.345, "-12.35"),
            (12345.0, "12345"),
            (1e-9, "1.00e-9"),
        ];
        for (value, text) in cases {
            assert_eq!(number(value), text);
        }
    }
}
