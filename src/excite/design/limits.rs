//! What an input must keep to.

use super::responses::Response;

/// A limit on a signal of the model.
#[derive(Debug, Clone, PartialEq)]
pub struct OutputLimit {
    /// Its name.
    pub name: String,
    /// The signal.
    pub response: Response,
    /// Least and largest value.
    pub range: [f64; 2],
}

/// A limit on how far the normalised autocorrelation may be from a reference (Priess 2015, eq. 5.9):
/// `|R_uu(u; j)/R_uu(u; 0) − R*_j| ≤ β` for the lags `j = 1 …`, `R_uu(u; j) = Σ_k u_k u_{k−j}`.
#[derive(Debug, Clone, PartialEq)]
pub struct Autocorrelation {
    /// R* of the lags 1, 2, ….
    pub reference: Vec<f64>,
    /// β.
    pub tolerance: f64,
    /// γ: a step aims at `max(β − γ, |deviation|)`, so that what its linearisation misses stays within β.
    pub margin: f64,
}

/// All limits of a design.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    /// Least and largest sample of the input.
    pub input: [f64; 2],
    /// The largest change of the input from sample to sample.
    pub change: Option<f64>,
    /// On signals of the model.
    pub outputs: Vec<OutputLimit>,
    /// On the autocorrelation.
    pub autocorrelation: Option<Autocorrelation>,
}

/// A limit that an input breaks.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Broken {
    /// A sample of the input.
    #[error("sample {sample} of the input is {value}, beyond {limit}")]
    Input {
        /// Which sample.
        sample: usize,
        /// Its value.
        value: f64,
        /// The limit.
        limit: f64,
    },
    /// A change of the input.
    #[error("the input changes by {value} to sample {sample}, beyond {limit}")]
    Change {
        /// The later sample.
        sample: usize,
        /// The change.
        value: f64,
        /// The limit.
        limit: f64,
    },
    /// A signal of the model.
    #[error("{name} is {value} at sample {sample}, beyond {limit}")]
    Output {
        /// The name of the limit.
        name: String,
        /// Which sample of the record.
        sample: usize,
        /// The value.
        value: f64,
        /// The limit.
        limit: f64,
    },
    /// The autocorrelation.
    #[error("the autocorrelation at lag {lag} is {deviation} from its reference, beyond {tolerance}")]
    Autocorrelation {
        /// The lag.
        lag: usize,
        /// The deviation.
        deviation: f64,
        /// β.
        tolerance: f64,
    },
    /// The input is zero throughout, and has no autocorrelation.
    #[error("the input is zero throughout, and has no autocorrelation")]
    Zero,
}

/// `R_uu(u; j)/R_uu(u; 0)` for the lags 1 to `lags`; `None` of an input that is zero throughout.
#[must_use]
pub fn autocorrelation(u: &[f64], lags: usize) -> Option<Vec<f64>> {
    let power: f64 = u.iter().map(|u| u * u).sum();
    (power > 0.0).then(|| (1..=lags).map(|lag| lagged(u, lag) / power).collect())
}

/// `Σ_k u_k u_{k−j}`.
pub(super) fn lagged(u: &[f64], lag: usize) -> f64 {
    u.iter().skip(lag).zip(u).map(|(a, b)| a * b).sum()
}

impl Autocorrelation {
    /// Deviations from the reference; `None` of an input that is zero throughout.
    #[must_use]
    pub fn deviations(&self, u: &[f64]) -> Option<Vec<f64>> {
        let found = autocorrelation(u, self.reference.len())?;
        Some(found.iter().zip(&self.reference).map(|(found, wanted)| found - wanted).collect())
    }
}

impl Limits {
    /// The limit that an input breaks the most, relative to the width of its range; `None` where it keeps to all of
    /// them, exactly.
    #[must_use]
    pub fn broken(&self, u: &[f64]) -> Option<Broken> {
        let mut worst: Option<(f64, Broken)> = None;
        let mut beyond = |share: f64, broken: Broken| {
            // A NaN is beyond every limit.
            if share.is_nan() || share > 0.0 {
                let share = if share.is_nan() { f64::INFINITY } else { share };
                if worst.as_ref().is_none_or(|(most, _)| share > *most) {
                    worst = Some((share, broken));
                }
            }
        };
        let over = |value: f64, [lower, upper]: [f64; 2]| {
            let limit = if value < lower { lower } else { upper };
            ((lower - value).max(value - upper) / (upper - lower), limit)
        };
        for (sample, value) in u.iter().copied().enumerate() {
            let (share, limit) = over(value, self.input);
            beyond(share, Broken::Input { sample, value, limit });
        }
        if let Some(limit) = self.change {
            for (i, pair) in u.windows(2).enumerate() {
                let value = pair[1] - pair[0];
                beyond((value.abs() - limit) / limit, Broken::Change { sample: i + 1, value, limit });
            }
        }
        for output in &self.outputs {
            for (sample, value) in output.response.to(u).into_iter().enumerate() {
                let (share, limit) = over(value, output.range);
                beyond(share, Broken::Output { name: output.name.clone(), sample, value, limit });
            }
        }
        if let Some(wanted) = &self.autocorrelation {
            match wanted.deviations(u) {
                None => beyond(f64::INFINITY, Broken::Zero),
                Some(deviations) => {
                    let tolerance = wanted.tolerance;
                    for (i, deviation) in deviations.into_iter().enumerate() {
                        let broken = Broken::Autocorrelation { lag: i + 1, deviation, tolerance };
                        beyond((deviation.abs() - tolerance) / tolerance, broken);
                    }
                }
            }
        }
        worst.map(|(_, broken)| broken)
    }

    /// The largest factor up to 1 by which an input can be scaled so that it keeps to every limit but that on the
    /// autocorrelation, which no factor changes; `None` where not even the input zero does.
    #[must_use]
    pub fn largest_scale(&self, u: &[f64]) -> Option<f64> {
        // Inside by more than the rounding of the sums.
        const INSIDE: f64 = 1.0 - 1e-9;
        let mut scale: f64 = 1.0;
        let mut admit = |free: f64, forced: f64, [lower, upper]: [f64; 2]| {
            if !(lower..=upper).contains(&free) {
                return false;
            }
            let room = if forced > 0.0 { upper - free } else { free - lower };
            if forced.abs() > room {
                scale = scale.min(INSIDE * room / forced.abs());
            }
            true
        };
        let mut fits = u.iter().all(|u| admit(0.0, *u, self.input));
        if let Some(limit) = self.change {
            fits &= u.windows(2).all(|pair| admit(0.0, pair[1] - pair[0], [-limit, limit]));
        }
        for output in &self.outputs {
            let forced = output.response.forced(u);
            fits &= forced.iter().zip(&output.response.free).all(|(forced, free)| admit(*free, *forced, output.range));
        }
        fits.then_some(scale)
    }
}
