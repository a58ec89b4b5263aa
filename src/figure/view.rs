//! What is looked at of a figure.

use super::decimate::{KEPT, kept};
use super::value::{Axis, Figure, Mark, Panel, Scale, Series};

/// A y axis that follows its numbers goes on beyond them by this share, and an x axis by this one where there are
/// marks, which an edge would cut in half.
const MARGIN: f64 = 0.05;
const MARGIN_OF_MARKS: f64 = 0.015;

/// What a scale can hold; longer axes end here.
const LARGEST: f64 = 8e307;

/// Which part of a figure is looked at, and how finely.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Where the x axis begins, in its unit; at its own beginning where this is `None`.
    pub from: Option<f64>,
    /// Where it ends.
    pub to: Option<f64>,
    /// Pixel columns of a panel.
    pub columns: usize,
}

/// Why there is nothing to look at.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ViewError {
    /// It ends where it begins, or before.
    #[error("the view goes from {from} to {to}, which is nothing")]
    Empty {
        /// Where it begins.
        from: f64,
        /// Where it ends.
        to: f64,
    },
    /// The figure has nothing there.
    #[error("the view goes from {from} to {to}, and the figure from {begin} to {end}")]
    Outside {
        /// Where the view begins.
        from: f64,
        /// Where it ends.
        to: f64,
        /// Where the figure begins.
        begin: f64,
        /// Where it ends.
        end: f64,
    },
}

impl Axis {
    /// Where a value lies on the axis, 0 at its beginning and 1 at its end.
    pub(super) fn position(&self, value: f64) -> f64 {
        let [from, to] = self.range.unwrap_or([0.0, 1.0]);
        let share = match self.scale {
            Scale::Linear => (value - from) / (to - from),
            Scale::Logarithmic => (value / from).ln() / (to / from).ln(),
        };
        // What is not finite has no place at all, and what is far away is not drawn.
        if share.is_nan() { 0.0 } else { share.clamp(-1e3, 1e3) }
    }

    /// Whether the scale can show a value.
    fn holds(&self, value: f64) -> bool {
        value.is_finite() && (self.scale == Scale::Linear || value > 0.0)
    }

    /// The ends of the axis over some numbers, or beyond them by a share of their range.
    fn over(&self, numbers: impl Iterator<Item = f64>, margin: f64) -> [f64; 2] {
        if let Some(range) = self.range {
            return range;
        }
        let all = numbers.chain(self.include.iter().copied()).filter(|value| self.holds(*value));
        let [low, high] =
            all.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)]);
        let is_empty = low > high;
        match self.scale {
            Scale::Linear if is_empty => [0.0, 1.0],
            Scale::Logarithmic if is_empty => [0.1, 10.0],
            Scale::Linear => {
                let (low, high) = (low.max(-LARGEST), high.min(LARGEST));
                if low == high {
                    let half = if low == 0.0 { 1.0 } else { 0.5 * low.abs() };
                    return [low - half, high + half];
                }
                // An axis that begins at zero by intention begins there.
                let more = margin * (high - low);
                let begins = |end: f64| end == 0.0 && self.include.contains(&0.0);
                [if begins(low) { low } else { low - more }, if begins(high) { high } else { high + more }]
            }
            Scale::Logarithmic => {
                let (low, high) = (low.max(1.0 / LARGEST), high.min(LARGEST));
                if high < low * (1.0 + 1e-12) {
                    return [low / 1.25, high * 1.25];
                }
                let more = (high / low).powf(margin);
                [low / more, high * more]
            }
        }
    }
}

impl Figure {
    /// The figure with what is looked at of it: its axes have their ends, and its series the numbers that are drawn.
    ///
    /// A line that comes from outside keeps the value before and the one behind, so that it runs to the edge. Of
    /// samples closer than four a pixel column, each column keeps the first, the least, the greatest and the last.
    ///
    /// # Errors
    /// [`ViewError`] where nothing of the figure is in the view.
    pub fn view(&self, view: &View) -> Result<Self, ViewError> {
        let series = || self.panels.iter().flat_map(|panel| &panel.series);
        let is_mark = |series: &Series| {
            use Mark::{Bars, Columns, Crosses, Plus, Points, Rings, Times};
            matches!(series.mark, Points | Crosses | Bars | Columns | Times | Plus | Rings)
        };
        let margin = if series().any(is_mark) { MARGIN_OF_MARKS } else { 0.0 };
        let [begin, end] = self.x.over(series().flat_map(Series::numbers).map(|(x, _)| x), margin);
        let (from, to) = (view.from.unwrap_or(begin), view.to.unwrap_or(end));
        if from.partial_cmp(&to) != Some(std::cmp::Ordering::Less) {
            return Err(ViewError::Empty { from, to });
        }
        if to <= begin || from >= end {
            return Err(ViewError::Outside { from, to, begin, end });
        }
        let x = Axis { range: Some([from.max(begin), to.min(end)]), ..self.x.clone() };
        let mut most = Seen::default();
        let panels = self.panels.iter().map(|panel| panel.view(&x, view.columns.max(1), &mut most)).collect();
        Ok(Self { x, panels, sampling: most.words(), ..self.clone() })
    }
}

/// How many numbers the longest series has in sight, and how many of them are drawn.
#[derive(Debug, Default)]
struct Seen {
    samples: usize,
    values: usize,
    is_thinned: bool,
}

impl Seen {
    fn words(&self) -> String {
        match (self.is_thinned, self.samples) {
            (true, samples) => format!("one line per pixel: least and greatest of {samples} samples"),
            (false, 0) => format!("all {} values", self.values),
            (false, samples) => format!("all {samples} samples"),
        }
    }
}

impl Panel {
    fn view(&self, x: &Axis, columns: usize, seen: &mut Seen) -> Self {
        let series: Vec<Series> = self.series.iter().map(|series| series.view(x, &self.y, columns, seen)).collect();
        let range = self.y.over(series.iter().flat_map(Series::numbers).map(|(_, y)| y), MARGIN);
        Self { y: Axis { range: Some(range), ..self.y.clone() }, series, ..self.clone() }
    }
}

impl Series {
    fn view(&self, x: &Axis, y: &Axis, columns: usize, seen: &mut Seen) -> Self {
        let [from, to] = x.range.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
        let (mut begin, mut end) =
            (self.x.partition_point(|place| *place < from), self.x.partition_point(|place| *place <= to));
        let in_sight = end.saturating_sub(begin);
        let is_joined = matches!(self.mark, Mark::Line | Mark::Samples | Mark::Band);
        if is_joined {
            // The neighbours outside, to which the line runs.
            begin = begin.saturating_sub(1);
            end = (end + 1).min(self.x.len());
        }
        let column = |place: usize| (x.position(self.x[place]) * columns as f64).floor() as i64;
        let is_line = matches!(self.mark, Mark::Line | Mark::Samples);
        let is_thinned = is_line && in_sight > KEPT * columns;
        let places: Vec<usize> = if is_thinned {
            kept(&self.y[begin..end], |i| column(begin + i)).into_iter().map(|i| begin + i).collect()
        } else {
            (begin..end.max(begin)).collect()
        };
        if self.mark == Mark::Samples {
            seen.samples = seen.samples.max(in_sight);
            seen.is_thinned |= is_thinned;
        }
        seen.values += in_sight;
        let mut picked = self.picked(&places);
        for list in [&mut picked.y, &mut picked.low, &mut picked.high] {
            for value in list {
                *value = value.filter(|value| y.holds(*value));
            }
        }
        picked
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::{Ink, Weight};

    fn figure(scale: Scale, x: Vec<f64>, y: Vec<Option<f64>>) -> Figure {
        let series = Series::values("y", (Mark::Samples, Ink::Output, Weight::Thin), x, y);
        let axis = |label| Axis { scale, ..Axis::linear(label, "1") };
        Figure {
            name: "signals".into(),
            title: "Signals".into(),
            description: "None.".into(),
            caption: String::new(),
            sampling: String::new(),
            x: axis("x"),
            panels: vec![Panel::new("", axis("y"), vec![series])],
        }
    }

    fn view(from: Option<f64>, to: Option<f64>, columns: usize) -> View {
        View { from, to, columns }
    }

    #[test]
    fn a_view_keeps_the_neighbours_that_lines_run_to() {
        let whole =
            figure(Scale::Linear, (0..10).map(f64::from).collect(), (0..10).map(|i| Some(f64::from(i))).collect());
        let seen = whole.view(&view(Some(2.5), Some(5.0), 100)).unwrap();
        assert_eq!(seen.x.range, Some([2.5, 5.0]));
        assert_eq!(seen.panels[0].series[0].x, [2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(seen.sampling, "all 3 samples");
        let between = whole.view(&view(Some(2.2), Some(2.8), 100)).unwrap();
        assert_eq!(between.panels[0].series[0].x, [2.0, 3.0]);
        // The figure does not go on beyond its numbers.
        assert_eq!(whole.view(&view(Some(-5.0), None, 9)).unwrap().x.range, Some([0.0, 9.0]));
        let nothing = |from, to| whole.view(&view(Some(from), Some(to), 9)).unwrap_err();
        assert_eq!(nothing(3.0, 3.0), ViewError::Empty { from: 3.0, to: 3.0 });
        assert_eq!(nothing(3.0, f64::NAN).to_string(), "the view goes from 3 to NaN, which is nothing");
        assert_eq!(nothing(9.0, 12.0), ViewError::Outside { from: 9.0, to: 12.0, begin: 0.0, end: 9.0 });
    }

    #[test]
    fn from_four_samples_a_column_down_all_are_drawn() {
        let x: Vec<f64> = (0..=400).map(f64::from).collect();
        let y = x.iter().map(|x| Some((7.0 * x).sin())).collect();
        let whole = figure(Scale::Linear, x, y);
        let seen = |columns| whole.view(&view(None, None, columns)).unwrap();
        assert_eq!(seen(101).sampling, "all 401 samples");
        assert_eq!(seen(101).panels[0].series[0].x.len(), 401);
        assert_eq!(seen(50).sampling, "one line per pixel: least and greatest of 401 samples");
        assert!((100..=4 * 50 + 1).contains(&seen(50).panels[0].series[0].x.len()));
    }

    #[test]
    fn logarithmic_axes_hold_positive_numbers_only() {
        let whole = figure(Scale::Logarithmic, vec![0.1, 1.0, 10.0], vec![Some(1.0), Some(0.0), Some(100.0)]);
        let seen = whole.view(&view(None, None, 100)).unwrap();
        assert_eq!(seen.panels[0].series[0].y, [Some(1.0), None, Some(100.0)]);
        assert_eq!(seen.x.range, Some([0.1, 10.0]));
        assert!((seen.x.position(1.0) - 0.5).abs() < 1e-12);
        let [low, high] = seen.panels[0].y.range.unwrap();
        assert!((low * high - 100.0).abs() < 1e-9 && low < 1.0 && high > 100.0);
    }

    #[test]
    fn axes_of_norms_begin_at_zero_and_flat_lines_have_one() {
        let mut whole = figure(Scale::Linear, vec![0.0, 1.0], vec![Some(2.0), Some(4.0)]);
        assert_eq!(whole.view(&view(None, None, 9)).unwrap().panels[0].y.range, Some([1.9, 4.1]));
        whole.panels[0].y.include = vec![0.0];
        assert_eq!(whole.view(&view(None, None, 9)).unwrap().panels[0].y.range, Some([0.0, 4.2]));
        let flat = figure(Scale::Linear, vec![0.0, 1.0], vec![Some(3.0), Some(3.0)]);
        assert_eq!(flat.view(&view(None, None, 9)).unwrap().panels[0].y.range, Some([1.5, 4.5]));
        let huge = figure(Scale::Linear, vec![0.0, 1.0], vec![Some(f64::MAX), Some(f64::MIN)]);
        let [low, high] = huge.view(&view(None, None, 9)).unwrap().panels[0].y.range.unwrap();
        assert!((high - low).is_finite() && low < high);
        let none = figure(Scale::Linear, vec![0.0, 1.0], vec![None, None]);
        assert_eq!(none.view(&view(None, None, 9)).unwrap().panels[0].y.range, Some([0.0, 1.0]));
    }
}
