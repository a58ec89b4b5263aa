//! Whether a time column is a uniform grid, and of which step.
//!
//! A row's deviation is measured from the grid `t₀ + iT` that fits the column robustly (medians, so that one bad row
//! neither hides nor accuses others). It may be [`JITTER_TOLERANCE`] of the sample time. Beyond that, only rounding
//! excuses: where the column is printed in units of `q` seconds (all values are whole multiples of `q = 10⁻ᵏ`,
//! `k ≤ 9`) and `T` is no whole multiple of `q`, a deviation of [`ROUNDING_TOLERANCE`] units passes. Where `T` is a
//! whole multiple of `q`, rounding moves no row and excuses nothing. So 60 Hz printed with five decimals passes (its
//! rows are off by up to 10⁻⁵ s), and so does 500 Hz printed in milliseconds (its rows are exact).

/// Deviation from the uniform grid that every column may show, as a fraction of the sample time.
///
/// At 2 % the phase error at a frequency `f` is below `0.02 · 360° · f T`, a fifteenth of a degree at 1 % of the
/// sampling rate.
pub(crate) const JITTER_TOLERANCE: f64 = 0.02;

/// Deviation that rounding may explain, in units of the last printed decimal: half a unit from the row itself, and up
/// to one from the fitted grid, which was fitted to rounded rows too.
pub(crate) const ROUNDING_TOLERANCE: f64 = 1.5;

/// A step of more than this many median steps, which the next step does not take back, is a gap.
const GAP_STEPS: f64 = 1.5;

/// Share of equal steps from which a column counts as an exact grid with a few defects.
const EXACT_SHARE: f64 = 0.9;

/// The finest unit of printing that is looked for: 10⁻⁹ s.
const FINEST_DECIMALS: i32 = 9;

/// What is wrong with a time column. Samples count from 0.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum TimeDefect {
    /// Time runs backwards.
    #[error("time runs backwards, from {previous_s} s to {time_s} s")]
    Reversed {
        /// The later row.
        sample: usize,
        /// Time of the row before.
        previous_s: f64,
        /// Its time.
        time_s: f64,
    },
    /// Two rows in succession have the same time.
    #[error("the time {time_s} s is there twice")]
    Repeated {
        /// The later row.
        sample: usize,
        /// The time.
        time_s: f64,
    },
    /// Samples are missing.
    #[error(
        "{missing} {} missing: time jumps from {previous_s} s to {time_s} s, and the usual step is {step_s} s",
        if *.missing == 1 { "sample is" } else { "samples are" }
    )]
    Gap {
        /// The row after the gap.
        sample: usize,
        /// How many samples would fill it.
        missing: u64,
        /// Time before the gap.
        previous_s: f64,
        /// Time after the gap.
        time_s: f64,
        /// The usual step.
        step_s: f64,
    },
    /// A row is off the uniform grid.
    #[error(
        "the time {time_s} s is {deviation_s:e} s off the uniform grid of {step_s} s, beyond the tolerance of \
         {tolerance_s:e} s ({rows} of the rows are beyond it, the worst by {worst_s:e} s)"
    )]
    Jitter {
        /// The first such row.
        sample: usize,
        /// Its time.
        time_s: f64,
        /// Its time less the grid's.
        deviation_s: f64,
        /// The largest deviation that passes.
        tolerance_s: f64,
        /// The step of the grid.
        step_s: f64,
        /// How many rows are beyond the tolerance.
        rows: usize,
        /// The largest deviation, without sign.
        worst_s: f64,
    },
    /// Steps of one and of two printed units cannot be told from missing samples.
    #[error(
        "the time column is too coarse: it is printed in units of {unit_s} s, its steps are one or more of these \
         units, and rounding cannot be told from missing samples"
    )]
    TooCoarse {
        /// The unit of printing.
        unit_s: f64,
    },
    /// The sample time given is not the column's.
    #[error(
        "the sample time given is {given_s} s, the time column says {column_s} s: over the record they drift apart by \
         {drift_s:e} s, beyond the tolerance of {tolerance_s:e} s"
    )]
    Disagrees {
        /// The sample time given.
        given_s: f64,
        /// The sample time of the column.
        column_s: f64,
        /// How far the two grids are apart at the end of the record.
        drift_s: f64,
        /// The largest drift that passes.
        tolerance_s: f64,
    },
    /// The span of the column is no usable number of seconds.
    #[error("the time column spans {span_s} s, which gives no usable sample time")]
    NoSpan {
        /// Last time less first time.
        span_s: f64,
    },
}

impl TimeDefect {
    /// The row at fault, from 0, where there is one.
    #[must_use]
    pub fn sample(&self) -> Option<usize> {
        match *self {
            Self::Reversed { sample, .. }
            | Self::Repeated { sample, .. }
            | Self::Gap { sample, .. }
            | Self::Jitter { sample, .. } => Some(sample),
            Self::TooCoarse { .. } | Self::Disagrees { .. } | Self::NoSpan { .. } => None,
        }
    }
}

/// The sample time of a time column of finite numbers, in seconds; a sample time `given` by the caller is checked
/// against the column and returned.
///
/// Without one, `T = (t_last − t_first)/(n − 1)`, or the step itself where the column is an exact decimal grid.
///
/// # Errors
/// The first [`TimeDefect`], looked for in the order reversed or repeated, too coarse, gap, jitter, disagreement.
///
/// # Panics
/// With fewer than two rows, which is a mistake of the caller.
pub fn check(time_s: &[f64], given_s: Option<f64>) -> Result<f64, TimeDefect> {
    let n = time_s.len();
    assert!(n >= 2, "a time column of {n} rows has no step");
    let span_s = time_s[n - 1] - time_s[0];
    for (i, pair) in time_s.windows(2).enumerate() {
        if pair[1] < pair[0] {
            return Err(TimeDefect::Reversed { sample: i + 1, previous_s: pair[0], time_s: pair[1] });
        }
        if pair[1] == pair[0] {
            return Err(TimeDefect::Repeated { sample: i + 1, time_s: pair[1] });
        }
    }
    if !span_s.is_finite() || !(span_s / (n - 1) as f64).is_normal() {
        return Err(TimeDefect::NoSpan { span_s });
    }

    let steps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let step = median(steps.clone());
    let unit = printed_unit(time_s);
    let equal_share = unit.map_or(0.0, |unit| {
        steps.iter().filter(|d| (*d - step).abs() < 0.1 * unit.seconds).count() as f64 / steps.len() as f64
    });
    if let Some(unit) = unit
        && step < 1.5 * unit.seconds
        && equal_share < EXACT_SHARE
        && steps.len() >= 10
    {
        return Err(TimeDefect::TooCoarse { unit_s: unit.seconds });
    }
    find_gap(time_s, step)?;

    let grid = Grid::fit(time_s, step, unit, equal_share);
    grid.check(time_s)?;
    let Some(given_s) = given_s else { return Ok(grid.sample_time_s) };
    let drift_s = (given_s - grid.sample_time_s).abs() * (n - 1) as f64;
    // The comparison is written so that a NaN drift is refused.
    if drift_s <= grid.tolerance_s {
        Ok(given_s)
    } else {
        Err(TimeDefect::Disagrees { given_s, column_s: grid.sample_time_s, drift_s, tolerance_s: grid.tolerance_s })
    }
}

fn find_gap(time_s: &[f64], step_s: f64) -> Result<(), TimeDefect> {
    for i in 1..time_s.len() {
        let jump = time_s[i] - time_s[i - 1];
        let taken_back = time_s.get(i + 1).is_some_and(|next| next - time_s[i - 1] < (1.0 + GAP_STEPS) * step_s);
        if jump > GAP_STEPS * step_s && !taken_back {
            // A float beyond the range of u64 saturates, which is what is wanted here.
            let missing = ((jump / step_s).round() as u64).saturating_sub(1).max(1);
            return Err(TimeDefect::Gap { sample: i, missing, previous_s: time_s[i - 1], time_s: time_s[i], step_s });
        }
    }
    Ok(())
}

/// A unit of printing, 10⁻ᵏ seconds.
#[derive(Clone, Copy)]
struct Unit {
    seconds: f64,
    per_second: f64,
}

/// The coarsest unit 10⁻ᵏ, `k = 0..=9`, of which every value is a whole multiple.
fn printed_unit(values: &[f64]) -> Option<Unit> {
    let mut decimals = 0;
    for value in values {
        // m/10ᵏ is the double nearest to the decimal number, exactly as a parser rounds it.
        while (value * 10_f64.powi(decimals)).round() / 10_f64.powi(decimals) != *value {
            decimals += 1;
            if decimals > FINEST_DECIMALS {
                return None;
            }
        }
    }
    let per_second = 10_f64.powi(decimals);
    Some(Unit { seconds: 1.0 / per_second, per_second })
}

/// The uniform grid that a column is held against.
struct Grid {
    offset_s: f64,
    step_s: f64,
    sample_time_s: f64,
    tolerance_s: f64,
}

impl Grid {
    fn fit(time_s: &[f64], median_step_s: f64, unit: Option<Unit>, equal_share: f64) -> Self {
        let n = time_s.len();
        let span_s = time_s[n - 1] - time_s[0];
        let drift_s = (span_s - (n - 1) as f64 * median_step_s).abs();
        let exact = unit.filter(|unit| {
            drift_s < 0.1 * unit.seconds || (equal_share >= EXACT_SHARE && drift_s < 2.1 * unit.seconds)
        });
        let (step_s, sample_time_s, tolerance_s) = if let Some(unit) = exact {
            let step_s = (median_step_s * unit.per_second).round() / unit.per_second;
            (step_s, step_s, JITTER_TOLERANCE * step_s)
        } else {
            let reach = (n / 2).max(1);
            let slopes = (0..n - reach).map(|i| (time_s[i + reach] - time_s[i]) / reach as f64).collect();
            let step_s = median(slopes);
            let rounding_s = unit.map_or(0.0, |unit| ROUNDING_TOLERANCE * unit.seconds);
            (step_s, span_s / (n - 1) as f64, rounding_s.max(JITTER_TOLERANCE * step_s))
        };
        let offset_s = median(time_s.iter().enumerate().map(|(i, t)| t - i as f64 * step_s).collect());
        Self { offset_s, step_s, sample_time_s, tolerance_s }
    }

    fn check(&self, time_s: &[f64]) -> Result<(), TimeDefect> {
        let deviation = |i: usize| (time_s[i] - i as f64 * self.step_s) - self.offset_s;
        // A row that lies on the grid but for the rounding of its own double must pass, however late it is.
        let rounding = 4.0 * f64::EPSILON * time_s[0].abs().max(time_s[time_s.len() - 1].abs());
        let tolerance_s = self.tolerance_s + rounding;
        let beyond: Vec<usize> = (0..time_s.len()).filter(|i| deviation(*i).abs() > tolerance_s).collect();
        let Some(first) = beyond.first().copied() else { return Ok(()) };
        Err(TimeDefect::Jitter {
            sample: first,
            time_s: time_s[first],
            deviation_s: deviation(first),
            tolerance_s,
            step_s: self.step_s,
            rows: beyond.len(),
            worst_s: beyond.iter().map(|i| deviation(*i).abs()).fold(0.0, f64::max),
        })
    }
}

/// The (lower) median of at least one value.
fn median(mut values: Vec<f64>) -> f64 {
    let middle = (values.len() - 1) / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
