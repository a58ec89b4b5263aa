//! The queue over the last hours.

use super::provenance::product;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, Series, Weight};

/// The name of the figure in addresses.
pub const NAME: &str = "queue";

/// When an analysis came, was taken up and ended, in hours before now (negative, 0 is now).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passage {
    /// When it was asked for.
    pub created_h: f64,
    /// When its present or last attempt began; `None` before the first.
    pub started_h: Option<f64>,
    /// When it ended; `None` while it waits or runs.
    pub finished_h: Option<f64>,
    /// Whether it ended with a problem.
    pub failed: bool,
}

/// How many analyses waited and ran over the last `hours`, as steps; failed ones as crosses on the ground.
#[must_use]
pub fn queue(passages: &[Passage], hours: f64) -> Figure {
    // Every change of a count: +1 when it begins, −1 when it ends.
    let mut waits: Vec<(f64, i64)> = Vec::new();
    let mut runs: Vec<(f64, i64)> = Vec::new();
    let mut failed: Vec<f64> = Vec::new();
    for own in passages {
        let until = own.started_h.or(own.finished_h);
        waits.push((own.created_h, 1));
        waits.extend(until.map(|at| (at, -1)));
        if let Some(started) = own.started_h {
            runs.push((started, 1));
            runs.extend(own.finished_h.map(|at| (at, -1)));
        }
        failed.extend(own.finished_h.filter(|at| own.failed && (-hours..=0.0).contains(at)));
    }
    failed.sort_by(f64::total_cmp);
    let area = |name: &str, ink, changes: Vec<(f64, i64)>| {
        let (x, counts) = steps(changes, hours);
        let ends = counts.iter().map(|count| Some([0.0, *count])).collect::<Vec<_>>();
        let band = Series::intervals(format!("{name} (area)"), (Mark::Band, ink, Weight::Thin), x.clone(), ends);
        let line = Series::values(name, (Mark::Line, ink, Weight::Thick), x, counts.into_iter().map(Some));
        [band, line.labelled()]
    };
    let now = |changes: &[(f64, i64)]| changes.iter().map(|(_, by)| by).sum::<i64>();
    let (waiting, running) = (now(&waits), now(&runs));
    let mut series = Vec::new();
    series.extend(area("waiting", Ink::Second, waits));
    series.extend(area("running", Ink::First, runs));
    let count = failed.len();
    let crosses = failed.iter().map(|_| Some(0.0)).collect::<Vec<_>>();
    series.push(Series::values("failed", (Mark::Times, Ink::Error, Weight::Thick), failed, crosses));
    let done = passages.iter().filter(|own| own.finished_h.is_some_and(|at| at >= -hours) && !own.failed).count();
    Figure {
        name: NAME.to_owned(),
        title: format!("Queue over the last {hours} hours"),
        description: format!("{waiting} wait and {running} run now; {done} ended and {count} failed in {hours} hours."),
        caption: format!("×: failed. {}.", product()),
        sampling: String::new(),
        x: Axis { range: Some([-hours, 0.0]), ..Axis::linear("time before now", "h") },
        panels: vec![Panel::new("", Axis::linear("analyses", "").including(&[0.0, 1.0]), series)],
    }
}

/// Counts as steps within the last hours: two places where one changes.
fn steps(mut changes: Vec<(f64, i64)>, hours: f64) -> (Vec<f64>, Vec<f64>) {
    changes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut count: i64 = changes.iter().filter(|(at, _)| *at < -hours).map(|(_, by)| by).sum();
    let (mut x, mut y) = (vec![-hours], vec![count as f64]);
    for (at, by) in changes.into_iter().filter(|(at, _)| *at >= -hours) {
        let at = at.min(0.0);
        x.push(at);
        y.push(count as f64);
        count += by;
        x.push(at);
        y.push(count as f64);
    }
    x.push(0.0);
    y.push(count as f64);
    (x, y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_step_where_analyses_come_and_go() {
        let own = |created_h, started_h, finished_h, failed| Passage { created_h, started_h, finished_h, failed };
        let all = [
            own(-30.0, Some(-29.0), Some(-23.0), false),
            own(-5.0, Some(-4.0), Some(-3.0), true),
            own(-2.0, Some(-1.0), None, false),
            own(-0.5, None, None, false),
        ];
        let found = queue(&all, 24.0);
        let of = |name: &str| found.panels[0].series.iter().find(|own| own.name == name).unwrap();
        assert_eq!(of("running").x, [-24.0, -23.0, -23.0, -4.0, -4.0, -3.0, -3.0, -1.0, -1.0, 0.0]);
        let y: Vec<f64> = of("running").y.iter().flatten().copied().collect();
        assert_eq!(y, [1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0]);
        let y: Vec<f64> = of("waiting").y.iter().flatten().copied().collect();
        assert_eq!((y[0], *y.last().unwrap()), (0.0, 1.0));
        assert_eq!(of("failed").x, [-3.0]);
        assert_eq!(found.description, "1 wait and 1 run now; 1 ended and 1 failed in 24 hours.");
    }
}
