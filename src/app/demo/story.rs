//! What the demonstration tells: the same people, estimated in several ways, beside what is true of them.

use super::tables::{Truth, number};
use crate::learning::StudyLearningCurves;
use crate::learning::curves::{CurvePoint, Metric};
use crate::learning::inputs::Estimator;
use crate::num::stats::mean;

/// The norms that are told, with their symbol and what they mean.
pub const NORMS: [(Metric, &str, &str); 2] = [
    (Metric::NormFeedforwardPlantMinusOne, "‖Gff G − 1‖", "distance of the feedforward from the inverse of the plant"),
    (Metric::NormFeedback, "‖Gfb‖", "mean gain of the feedback over the band"),
];

/// One way of estimating, with its curves.
pub struct Way {
    /// How controllers are estimated.
    pub estimator: Estimator,
    /// In words.
    pub title: &'static str,
    /// What people were stimulated by.
    pub stimuli: &'static str,
    /// The answer of the API.
    pub curves: StudyLearningCurves,
}

/// The whole of it.
pub struct Story {
    /// What was simulated and computed.
    pub heading: Vec<String>,
    /// Group by group.
    pub groups: Vec<GroupStory>,
    /// The comparison of the groups, in sentences.
    pub findings: Vec<String>,
    /// What the tables teach, in sentences.
    pub lessons: Vec<String>,
    /// Commands to go on with.
    pub next: Vec<String>,
}

/// A group of people on one plant.
pub struct GroupStory {
    /// Its name.
    pub name: String,
    /// Its plant.
    pub plant: String,
    /// How many people.
    pub people: usize,
    /// One table for each norm.
    pub tables: Vec<NormTable>,
}

/// Ways of estimating one norm.
pub struct NormTable {
    /// Its symbol.
    pub symbol: &'static str,
    /// What it means.
    pub meaning: &'static str,
    /// One row a way.
    pub rows: Vec<Row>,
    /// The truth, averaged over the same people, at the first and at the last trial.
    pub truth: [Option<f64>; 2],
    /// The points of the last way, for a figure.
    pub points: Vec<Point>,
}

/// One way of estimating, over the people of a group.
pub struct Row {
    /// The way, in words.
    pub title: &'static str,
    /// The stimuli.
    pub stimuli: &'static str,
    /// At the first and at the last trial.
    pub ends: [End; 2],
    /// How far from the truth single trials are, root mean square over the truth; none without values.
    pub relative_error: Option<f64>,
    /// Intervals that hold the truth, and intervals in all.
    pub held: [usize; 2],
    /// Trials with a value.
    pub values: usize,
}

/// A mean over people with the mean of their intervals.
#[derive(Default)]
pub struct End {
    /// The mean.
    pub value: Option<f64>,
    /// The mean of the lower and of the upper ends, where every value has an interval.
    pub interval: Option<[f64; 2]>,
}

/// One person's trial in a figure.
pub struct Point {
    /// The trial's number.
    pub trial: i64,
    /// The estimate.
    pub value: f64,
    /// Its 95 % interval.
    pub interval: Option<[f64; 2]>,
    /// The truth.
    pub truth: f64,
}

impl Row {
    /// Whether a reader may quote the numbers.
    #[must_use]
    pub fn trust(&self) -> String {
        let [held, all] = self.held;
        match (self.values, all) {
            (0, _) => "no value".to_owned(),
            (_, 0) => "none: no interval".to_owned(),
            _ if all < self.values => format!("{held} of {all} hold; {} refused", self.values - all),
            _ => format!("{held} of {all} hold the truth"),
        }
    }
}

fn interval(point: &CurvePoint, metric: Metric) -> Option<[f64; 2]> {
    match metric {
        Metric::NormFeedback => point.intervals_95.norm_feedback,
        Metric::NormFeedforwardPlantMinusOne => point.intervals_95.norm_feedforward_plant_minus_one,
        _ => None,
    }
}

fn true_value(truth: &Truth, code: &str, number: i64, metric: Metric) -> Option<f64> {
    let norms = truth.get(&(code.to_owned(), number))?;
    match metric {
        Metric::NormFeedback => norms.norm_feedback,
        Metric::NormFeedforwardPlantMinusOne => norms.norm_feedforward_plant_minus_one,
        _ => None,
    }
}

/// The points of one group in one way.
fn points(way: &Way, group: usize, metric: Metric, truth: &Truth) -> Vec<Point> {
    let Some(curve) = way.curves.groups.get(group) else { return Vec::new() };
    let of_subject = |subject: &crate::learning::groups::GroupSubject| {
        let one = |point: &CurvePoint| {
            Some(Point {
                trial: point.number,
                value: point.value(metric)?,
                interval: interval(point, metric),
                truth: true_value(truth, &subject.code, point.number, metric)?,
            })
        };
        subject.curve.points.iter().filter_map(one).collect::<Vec<_>>()
    };
    curve.subjects.iter().flat_map(of_subject).collect()
}

/// The groups of the story; `trials` are the first and the last.
#[must_use]
pub fn groups(ways: &[Way], truth: &Truth, trials: [i64; 2]) -> Vec<GroupStory> {
    let Some(first) = ways.first() else { return Vec::new() };
    let one = |(at, group): (usize, &crate::learning::groups::GroupCurve)| {
        let table = |(metric, symbol, meaning): (Metric, &'static str, &'static str)| {
            let all: Vec<Vec<Point>> = ways.iter().map(|way| points(way, at, metric, truth)).collect();
            let rows = ways.iter().zip(&all).map(|(way, points)| row(way, points, trials)).collect();
            let truths = |trial: i64| {
                let same = |point: &&Point| point.trial == trial;
                mean(&all.last()?.iter().filter(same).map(|point| point.truth).collect::<Vec<_>>())
            };
            let truth = trials.map(truths);
            NormTable { symbol, meaning, rows, truth, points: all.into_iter().next_back().unwrap_or_default() }
        };
        GroupStory {
            name: group.group.clone().unwrap_or_else(|| "without group".to_owned()),
            plant: group.plant.name.clone(),
            people: group.subjects.len(),
            tables: NORMS.into_iter().map(table).collect(),
        }
    };
    first.curves.groups.iter().enumerate().map(one).collect()
}

fn row(way: &Way, points: &[Point], trials: [i64; 2]) -> Row {
    let end = |trial: i64| {
        let there: Vec<&Point> = points.iter().filter(|point| point.trial == trial).collect();
        let intervals: Option<Vec<[f64; 2]>> = there.iter().map(|point| point.interval).collect();
        let ends = intervals.filter(|all| !all.is_empty()).and_then(|all| {
            let at = |i: usize| mean(&all.iter().map(|interval| interval[i]).collect::<Vec<_>>());
            Some([at(0)?, at(1)?])
        });
        End { value: mean(&there.iter().map(|point| point.value).collect::<Vec<_>>()), interval: ends }
    };
    let with: Vec<(&Point, [f64; 2])> = points.iter().filter_map(|p| Some((p, p.interval?))).collect();
    let held = with.iter().filter(|(point, [low, high])| (*low..=*high).contains(&point.truth)).count();
    let errors: Vec<f64> = points.iter().map(|point| (point.value / point.truth - 1.0).powi(2)).collect();
    Row {
        title: way.title,
        stimuli: way.stimuli,
        ends: trials.map(end),
        relative_error: mean(&errors).map(f64::sqrt),
        held: [held, with.len()],
        values: points.len(),
    }
}

/// What the tables teach: how well each way tells the feedback, and how often its intervals hold.
#[must_use]
pub fn lessons(groups: &[GroupStory]) -> Vec<String> {
    let mut lessons = Vec::new();
    for (at, (_, symbol, _)) in NORMS.iter().enumerate() {
        let tables = || groups.iter().filter_map(move |group| group.tables.get(at));
        let Some(ways) = tables().next().map(|table| table.rows.len()) else { continue };
        let told: Vec<String> = (0..ways)
            .filter_map(|way| {
                let rows: Vec<&Row> = tables().filter_map(|table| table.rows.get(way)).collect();
                let squares: Vec<f64> = rows.iter().filter_map(|row| Some(row.relative_error?.powi(2))).collect();
                let error = mean(&squares)?.sqrt();
                let row = rows.first()?;
                Some(format!("{} % ({}, {})", number(100.0 * error), row.title, row.stimuli))
            })
            .collect();
        lessons.push(format!("{symbol} of a single trial is off by {}, root mean square.", told.join(", ")));
    }
    lessons
}
