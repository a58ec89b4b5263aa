//! The learning curves of a study's groups.

use super::places::{Places, trial};
use super::provenance::{Units, eight, product};
use crate::figure::text::{listed, three};
use crate::figure::{Axis, Figure, Ink, Mark, Panel, RuleKind, Series, Weight};
use crate::learning::StatementTrust;
use crate::learning::StudyLearningCurves;
use crate::learning::curves::{CurvePoint, Metric};
use crate::learning::groups::{GroupCurve, GroupSubject, MetricStatistics, Statistics};
use crate::trust::Level;

/// The quantities that curves are drawn of.
pub const METRICS: [Metric; 7] = Metric::ALL;

/// Groups beyond so many have a panel each.
const MOST_GROUPS: usize = 4;

/// A mean of fewer subjects has no band.
const LEAST_FOR_BAND: usize = 3;

/// The name of a quantity's figure in addresses.
#[must_use]
pub fn name(metric: Metric) -> &'static str {
    metric.name()
}

/// What a quantity is called in a title.
#[must_use]
pub fn title(metric: Metric) -> &'static str {
    match metric {
        Metric::MeanAbsError => "Tracking error",
        Metric::RmsError => "Tracking error, root mean square",
        Metric::NormFeedback => "Mean gain of the feedback",
        Metric::NormFeedforwardMinusInverse => "Distance of the feedforward from the plant's inverse, in its unit",
        Metric::NormFeedforwardPlantMinusOne => "Distance of the feedforward from the inverse dynamics",
        Metric::VarianceAccountedFor => "Share of the output that the controllers explain",
        Metric::ControlLogDimensionlessJerk => "Smoothness of the control, as log dimensionless jerk",
    }
}

/// The same within a sentence.
pub(super) fn phrase(metric: Metric) -> &'static str {
    match metric {
        Metric::MeanAbsError => "the tracking error",
        Metric::RmsError => "the root mean square error",
        Metric::NormFeedback => "‖Gfb‖",
        Metric::NormFeedforwardMinusInverse => "‖Gff − G⁻¹‖",
        Metric::NormFeedforwardPlantMinusOne => "‖Gff G − 1‖",
        Metric::VarianceAccountedFor => "the share explained",
        Metric::ControlLogDimensionlessJerk => "the smoothness of the control",
    }
}

fn axis(metric: Metric, units: &Units) -> Axis {
    let Units { output, control } = units;
    let ratio = format!("{control} / {output}");
    let axis = match metric {
        Metric::MeanAbsError => Axis::linear("mean |r − y|", output.as_str()),
        Metric::RmsError => Axis::linear("rms of r − y", output.as_str()),
        Metric::NormFeedback => Axis::linear("‖Gfb‖", ratio),
        Metric::NormFeedforwardMinusInverse => Axis::linear("‖Gff − G⁻¹‖", ratio),
        Metric::NormFeedforwardPlantMinusOne => Axis::linear("‖Gff G − 1‖", "1"),
        Metric::VarianceAccountedFor => Axis::linear("variance accounted for", "1"),
        Metric::ControlLogDimensionlessJerk => Axis::linear("log dimensionless jerk of u", "1"),
    };
    let including: &[f64] = match metric {
        // A logarithm, whose 0 means nothing.
        Metric::ControlLogDimensionlessJerk => &[],
        Metric::NormFeedforwardPlantMinusOne | Metric::VarianceAccountedFor => &[0.0, 1.0],
        _ => &[0.0],
    };
    axis.including(including)
}

fn statistics(all: &MetricStatistics, metric: Metric) -> &Statistics {
    match metric {
        Metric::MeanAbsError => &all.mean_abs_error,
        Metric::RmsError => &all.rms_error,
        Metric::NormFeedback => &all.norm_feedback,
        Metric::NormFeedforwardMinusInverse => &all.norm_feedforward_minus_inverse,
        Metric::NormFeedforwardPlantMinusOne => &all.norm_feedforward_plant_minus_one,
        Metric::VarianceAccountedFor => &all.variance_accounted_for,
        Metric::ControlLogDimensionlessJerk => &all.control_log_dimensionless_jerk,
    }
}

pub(super) fn interval(point: &CurvePoint, metric: Metric) -> Option<[f64; 2]> {
    match metric {
        Metric::NormFeedback => point.intervals_95.norm_feedback,
        Metric::NormFeedforwardMinusInverse => point.intervals_95.norm_feedforward_minus_inverse,
        Metric::NormFeedforwardPlantMinusOne => point.intervals_95.norm_feedforward_plant_minus_one,
        _ => None,
    }
}

/// What is drawn, and by what.
struct Drawer {
    metric: Metric,
    places: Places,
}

/// A value of a subject.
struct Value {
    at: f64,
    value: Option<f64>,
    interval: Option<[f64; 2]>,
    level: Level,
    note: String,
}

impl Drawer {
    fn level(&self, point: &CurvePoint) -> Level {
        point.level(self.metric)
    }

    /// The values of a subject, in the order of the axis.
    fn values(&self, code: &str, points: &[CurvePoint]) -> Vec<Value> {
        let mut values: Vec<Value> = points
            .iter()
            .map(|point| {
                let judged = point.trust(self.metric);
                let level = self.level(point);
                let value = point.value(self.metric);
                let number = value.map_or_else(|| "no value".to_owned(), three);
                let ends = interval(point, self.metric)
                    .map_or_else(String::new, |[low, high]| format!(" [{}, {}]", three(low), three(high)));
                let because = judged.filter(|_| level != Level::Ok);
                let because = because.map_or_else(String::new, |own| format!(": {}", own.because));
                let trial = trial(point.session, point.number);
                Value {
                    at: self.places.at(point.session, point.number),
                    value,
                    interval: interval(point, self.metric),
                    level,
                    note: format!("{code} · {trial} · {number}{ends} · {}{because}", level.words()),
                }
            })
            .collect();
        values.sort_by(|a, b| a.at.total_cmp(&b.at));
        values
    }

    /// Band, subjects, intervals, mean and crosses of a group.
    fn group(&self, name: &str, ink: Ink, group: &GroupCurve) -> Vec<Series> {
        let of = |mark, weight| (mark, ink, weight);
        let at: Vec<f64> = group.points.iter().map(|point| self.places.at(point.session, point.number)).collect();
        let own: Vec<&Statistics> = group.points.iter().map(|point| statistics(&point.metrics, self.metric)).collect();
        let ends = own.iter().map(|own| {
            let (mean, sd) = own.mean.zip(own.sd).filter(|_| own.n >= LEAST_FOR_BAND)?;
            Some([mean - sd, mean + sd])
        });
        let band = format!("{name}: mean ± 1 SD");
        let mut all = vec![Series::intervals(band, of(Mark::Band, Weight::Thin), at.clone(), ends)];
        let mut crosses: Vec<Value> = Vec::new();
        let mut bars: Vec<(f64, Option<[f64; 2]>)> = Vec::new();
        for subject in &group.subjects {
            let values = self.values(&subject.code, &subject.curve.points);
            let x: Vec<f64> = values.iter().map(|value| value.at).collect();
            let notes = values.iter().map(|value| value.note.clone()).collect();
            let trust = values.iter().map(|value| value.level).collect();
            let line = Series::values(
                subject.code.as_str(),
                of(Mark::Line, Weight::Faint),
                x,
                values.iter().map(|value| value.value),
            );
            all.push(line.with_notes(notes).with_trust(trust));
            bars.extend(values.iter().filter(|value| value.interval.is_some()).map(|value| (value.at, value.interval)));
            crosses.extend(values.into_iter().filter(|value| value.level == Level::DoNotUse && value.value.is_some()));
        }
        if !bars.is_empty() {
            bars.sort_by(|a, b| a.0.total_cmp(&b.0));
            let (x, ends): (Vec<f64>, Vec<_>) = bars.into_iter().unzip();
            let name = format!("{name}: 95 % intervals of subjects");
            all.push(Series::intervals(name, of(Mark::Bars, Weight::Faint), x, ends));
        }
        let levels: Vec<Level> = own.iter().map(|own| own.trust.level).collect();
        let notes: Vec<String> = group
            .points
            .iter()
            .zip(&own)
            .zip(&levels)
            .map(|((point, own), level)| {
                let sd = own.sd.map_or_else(String::new, |sd| format!(" ± {} (SD)", three(sd)));
                let mean = own.mean.map_or_else(|| "no value".to_owned(), three);
                let trial = trial(point.session, point.number);
                format!("{name} · {trial} · mean {mean}{sd} of {} · {}", own.n, level.words())
            })
            .collect();
        let means = || own.iter().map(|own| own.mean);
        all.push(Series::values(name, of(Mark::Line, Weight::Thick), at.clone(), means()).labelled());
        let dots = Series::values(format!("{name}: mean"), of(Mark::Points, Weight::Thick), at, means());
        all.push(dots.with_notes(notes).with_trust(levels));
        if !crosses.is_empty() {
            crosses.sort_by(|a, b| a.at.total_cmp(&b.at));
            let (x, y): (Vec<f64>, Vec<_>) = crosses.iter().map(|cross| (cross.at, cross.value)).unzip();
            let marks = Series::values(format!("{name}: not to be used"), of(Mark::Crosses, Weight::Thin), x, y);
            let trust = vec![Level::DoNotUse; crosses.len()];
            all.push(marks.with_notes(crosses.into_iter().map(|cross| cross.note).collect()).with_trust(trust));
        }
        all
    }

    /// One subject with its intervals, before the mean and the spread of its group.
    fn subject(&self, name: &str, group: &GroupCurve, subject: &GroupSubject) -> Vec<Series> {
        let of = |mark, ink, weight| (mark, ink, weight);
        let at: Vec<f64> = group.points.iter().map(|point| self.places.at(point.session, point.number)).collect();
        let own: Vec<&Statistics> = group.points.iter().map(|point| statistics(&point.metrics, self.metric)).collect();
        let ends = own.iter().map(|own| {
            let (mean, sd) = own.mean.zip(own.sd).filter(|_| own.n >= LEAST_FOR_BAND)?;
            Some([mean - sd, mean + sd])
        });
        let band = of(Mark::Band, Ink::Muted, Weight::Thin);
        let mean = of(Mark::Line, Ink::Muted, Weight::Thin);
        let values = self.values(&subject.code, &subject.curve.points);
        let x: Vec<f64> = values.iter().map(|value| value.at).collect();
        let y = || values.iter().map(|value| value.value);
        let code = subject.code.as_str();
        let mut all = vec![
            Series::intervals(format!("{name}: mean ± 1 SD"), band, at.clone(), ends),
            Series::values(name, mean, at, own.iter().map(|own| own.mean)).labelled(),
        ];
        if values.iter().any(|value| value.interval.is_some()) {
            let bars = of(Mark::Bars, Ink::First, Weight::Thin);
            let ends = values.iter().map(|value| value.interval);
            all.push(Series::intervals(format!("{code}: 95 % intervals"), bars, x.clone(), ends));
        }
        all.push(Series::values(code, of(Mark::Line, Ink::First, Weight::Thick), x.clone(), y()).labelled());
        let dots = Series::values(format!("{code}: trials"), of(Mark::Points, Ink::First, Weight::Thick), x, y());
        let notes = values.iter().map(|value| value.note.clone()).collect();
        all.push(dots.with_notes(notes).with_trust(values.iter().map(|value| value.level).collect()));
        let bad: Vec<&Value> =
            values.iter().filter(|value| value.level == Level::DoNotUse && value.value.is_some()).collect();
        if !bad.is_empty() {
            let look = of(Mark::Crosses, Ink::First, Weight::Thin);
            let x = bad.iter().map(|value| value.at).collect();
            let crosses = Series::values(format!("{code}: not to be used"), look, x, bad.iter().map(|v| v.value));
            let notes = bad.iter().map(|value| value.note.clone()).collect();
            all.push(crosses.with_notes(notes).with_trust(vec![Level::DoNotUse; bad.len()]));
        }
        all
    }

    /// How many values of a group there are, and how many of them are not to be used.
    fn count(&self, group: &GroupCurve) -> [usize; 2] {
        let points = group.subjects.iter().flat_map(|subject| &subject.curve.points);
        points
            .filter(|point| point.value(self.metric).is_some())
            .fold([0, 0], |[all, bad], point| [all + 1, bad + usize::from(self.level(point) == Level::DoNotUse)])
    }

    /// What happened from first to last trials, in a sentence; no more than the values allow.
    fn sentence(&self, name: &str, group: &GroupCurve) -> String {
        let mut pairs: Vec<[f64; 2]> = Vec::new();
        let mut judged = Vec::new();
        for first in &group.first_trials.rows {
            let last = group.last_trials.rows.iter().find(|last| last.subject == first.subject);
            let Some(last) = last.filter(|last| last.point.position != first.point.position) else { continue };
            let values = first.point.value(self.metric).zip(last.point.value(self.metric));
            let Some((from, to)) = values else { continue };
            pairs.push([from, to]);
            judged.extend([first, last].into_iter().filter_map(|row| row.point.trust(self.metric)));
        }
        let what = phrase(self.metric);
        let n = pairs.len();
        if n == 0 {
            return format!("{name}: nobody has both a first and a last value of {what}.");
        }
        let trust = StatementTrust::of(judged);
        if let Some(refusal) = trust.refusal() {
            return format!("{name}: no statement about {what}: {refusal}");
        }
        let mean = |end: usize| pairs.iter().map(|pair| pair[end]).sum::<f64>() / n as f64;
        let (from, to) = (mean(0), mean(1));
        let verb = if to < from { "fell" } else { "rose" };
        let share = 100.0 * (to - from) / from;
        let share =
            if share.is_finite() { format!("{} %, ", crate::figure::text::number(share, 2)) } else { String::new() };
        format!(
            "{name}: from the first trial to the last {what} {verb} from {} to {} ({share}n = {n}{}).",
            three(from),
            three(to),
            trust.reservation()
        )
    }
}

/// The names of the groups; with their plants where a group worked on several.
pub(super) fn names(curves: &StudyLearningCurves) -> Vec<String> {
    let of = |group: &GroupCurve| group.group.clone().unwrap_or_else(|| "without a group".to_owned());
    let is_on_several = |name: &str| curves.groups.iter().filter(|group| of(group) == name).count() > 1;
    let named = |group: &GroupCurve| {
        let name = of(group);
        if is_on_several(&name) { format!("{name} on {}", group.plant.name) } else { name }
    };
    curves.groups.iter().map(named).collect()
}

/// The curve of a quantity over the trials of a study: subjects thin, means thick, what is not to be used crossed out.
#[must_use]
pub fn learning_curve(curves: &StudyLearningCurves, metric: Metric, units: &Units) -> Figure {
    let drawer = Drawer { metric, places: Places::of(curves) };
    let names = names(curves);
    let groups = names.iter().zip(&curves.groups);
    let own = |at: usize, name: &str, group| drawer.group(name, Ink::of_group(at), group);
    let mut panels = if curves.groups.len() <= MOST_GROUPS {
        let all = groups.clone().enumerate().flat_map(|(at, (name, group))| own(at, name, group)).collect();
        vec![Panel::new("", axis(metric, units), all)]
    } else {
        let panel = |(name, group): (&String, _)| Panel::new(name.as_str(), axis(metric, units), own(0, name, group));
        let mut panels: Vec<Panel> = groups.clone().map(panel).collect();
        // One scale for all, so that heights can be compared.
        let numbers = panels.iter().flat_map(|panel| &panel.series).flat_map(Series::numbers).map(|(_, y)| y);
        let most = numbers.fold([0.0, 0.0], |[low, high], y: f64| [f64::min(low, y), f64::max(high, y)]);
        panels.iter_mut().for_each(|panel| panel.y.include.extend(most));
        panels
    };
    for panel in &mut panels {
        if metric == Metric::NormFeedforwardPlantMinusOne {
            *panel = panel.clone().with_rule(1.0, "feedforward does nothing", RuleKind::Reference);
        }
        for (at, session) in &drawer.places.borders {
            *panel = panel.clone().with_rule(*at, format!("session {session}"), RuleKind::Border);
        }
    }
    let [all, bad] = curves
        .groups
        .iter()
        .map(|group| drawer.count(group))
        .fold([0, 0], |sum, own| [sum[0] + own[0], sum[1] + own[1]]);
    let sentences: Vec<String> = groups.map(|(name, group)| drawer.sentence(name, group)).collect();
    let label = if drawer.places.are_counted_on { "trial, counted on through the sessions" } else { "trial" };
    let last = drawer.places.last;
    let x = Axis { range: Some([0.0, last + f64::max(0.5, 0.03 * last)]), ..Axis::linear(label, "") };
    Figure {
        name: name(metric).to_owned(),
        title: title(metric).to_owned(),
        description: sentences.join(" "),
        caption: caption(curves, metric, [all, bad]),
        sampling: String::new(),
        x,
        panels,
    }
}

/// The curve of a quantity of one subject, by id, before its group: mean and spread behind, its own values with
/// intervals in front. Where it worked on several plants, a panel for each.
#[must_use]
pub fn learning_curve_of(curves: &StudyLearningCurves, subject: &str, metric: Metric, units: &Units) -> Figure {
    let drawer = Drawer { metric, places: Places::of(curves) };
    let (mut panels, mut sentences, mut code) = (Vec::new(), Vec::new(), String::new());
    for (name, group) in names(curves).iter().zip(&curves.groups) {
        let Some(own) = group.subjects.iter().find(|own| own.subject == subject) else { continue };
        code.clone_from(&own.code);
        let mut panel = Panel::new(group.plant.name.as_str(), axis(metric, units), drawer.subject(name, group, own));
        if metric == Metric::NormFeedforwardPlantMinusOne {
            panel = panel.with_rule(1.0, "feedforward does nothing", RuleKind::Reference);
        }
        for (at, session) in &drawer.places.borders {
            panel = panel.with_rule(*at, format!("session {session}"), RuleKind::Border);
        }
        panels.push(panel);
        let known: Vec<Value> = drawer.values(&own.code, &own.curve.points);
        let known: Vec<&Value> = known.iter().filter(|value| value.value.is_some()).collect();
        let what = phrase(metric);
        sentences.push(match (known.first(), known.last()) {
            (Some(first), Some(last)) if first.at < last.at => {
                let bad = known.iter().filter(|value| value.level == Level::DoNotUse).count();
                let reserve = if bad > 0 {
                    format!(" {bad} of {} values are not to be used.", known.len())
                } else {
                    String::new()
                };
                let ends = [first, last].map(|value| value.value.map_or_else(String::new, three));
                format!("On {}: {what} went from {} to {}.{reserve}", group.plant.name, ends[0], ends[1])
            }
            _ => format!("On {}: fewer than two trials have a value of {what}.", group.plant.name),
        });
    }
    let label = if drawer.places.are_counted_on { "trial, counted on through the sessions" } else { "trial" };
    let last = drawer.places.last;
    Figure {
        name: name(metric).to_owned(),
        title: format!("{}: {}", code, title(metric)),
        description: if sentences.is_empty() { "It has no trial.".to_owned() } else { sentences.join(" ") },
        caption: format!(
            "Grey: mean of the group, band ± 1 SD of three subjects or more; whiskers: 95 % intervals; ×: do not \
             use. {}.",
            product()
        ),
        sampling: String::new(),
        x: Axis { range: Some([0.0, last + f64::max(0.5, 0.03 * last)]), ..Axis::linear(label, "") },
        panels,
    }
}

fn caption(curves: &StudyLearningCurves, metric: Metric, [all, bad]: [usize; 2]) -> String {
    let mut text = "Thick: mean of the group; band: ± 1 SD of three subjects or more; thin: each subject".to_owned();
    let intervals = curves.groups.iter().flat_map(|group| &group.subjects).flat_map(|subject| &subject.curve.points);
    if intervals.clone().any(|point| interval(point, metric).is_some()) {
        text.push_str("; whiskers: 95 % intervals");
    }
    text.push('.');
    match metric {
        Metric::NormFeedforwardPlantMinusOne => {
            text.push_str(" 0: the feedforward is the plant's inverse; 1: it does nothing.");
        }
        Metric::VarianceAccountedFor => text.push_str(" Simulations that explain nothing have no share here."),
        _ => {}
    }
    if bad > 0 {
        text.push_str(&format!(" ×: do not use, {bad} of {all} values; the means take them in."));
    }
    let left_out: usize =
        curves.groups.iter().flat_map(|group| &group.subjects).map(|subject| subject.curve.left_out_count).sum();
    if left_out > 0 {
        text.push_str(&format!(" {left_out} divergent trials are left out."));
    }
    if !matches!(metric, Metric::MeanAbsError | Metric::RmsError) {
        let first =
            curves.groups.iter().flat_map(|group| &group.subjects).map(|subject| subject.curve.estimator).next();
        let specs = curves.groups.iter().filter_map(|group| group.spec.as_ref()).map(|spec| eight(&spec.spec_sha256));
        let mut specs: Vec<String> = specs.map(str::to_owned).collect();
        specs.dedup();
        if let Some(estimator) = first.filter(|_| !specs.is_empty()) {
            text.push_str(&format!(" Estimator {}, spec {}.", estimator.name(), listed(&specs)));
        }
    }
    text.push_str(&format!(" {}.", product()));
    text
}

#[cfg(test)]
mod tests;
