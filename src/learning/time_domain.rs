//! Metrics of one trial in the time domain (Zhang 2015, sections 3.3, 5.4 and 5.8).

use super::smoothness::log_dimensionless_jerk;
use crate::control::Model;
use crate::control::model::StateSpaceModel;
use crate::trial::Trial;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Control signals no larger than this are taken for the tremor of a hand at rest (Zhang 2015, section 5.8: the largest
/// |u| of a person who holds the joystick and means not to move it). In units of u.
pub const START_THRESHOLD: f64 = 0.05;

/// A Markov parameter below this share of the product of norms that bounds it counts as zero.
const MARKOV_ZERO: f64 = 1e-12;

/// Time-domain metrics of a trial (divergence is judged where the display limit is known).
///
/// Every number is finite: a value beyond the largest `f64` is given as the largest `f64`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TimeDomainMetrics {
    /// ‖e‖ = (1/n) Σ |r_i − y_i| over all n samples, in units of y (Zhang 2015, section 3.3).
    pub mean_abs_error: f64,
    /// √((1/n) Σ (r_i − y_i)²), in units of y.
    pub rms_error: f64,
    /// The largest |y|, in units of y.
    pub max_abs_output: f64,
    /// How smooth the control is: its log dimensionless jerk −ln(D⁵/A² ∫ (d³u/dt³)² dt), D the length of the trial and
    /// A the range of u, without unit; greater is smoother. Comparable between trials of one command and length. Null
    /// where u does not move or the trial is too short, and of trials stored by versions before it was introduced.
    #[serde(default)]
    pub control_log_dimensionless_jerk: Option<f64>,
    /// Whether the first deliberate control moves the output towards the command: at the sample after the first one
    /// (the sample at time zero not counted) with |u| above the threshold, the signs of u and r agree for a plant
    /// that at first moves with its input, and differ for one with initial undershoot (Zhang 2015, section 5.8).
    /// Null where that cannot be said.
    pub right_control_at_start: Option<bool>,
    /// Why `right_control_at_start` is null.
    #[serde(default)]
    pub right_control_undetermined: Option<String>,
    /// The time of the control that was judged, in seconds from the first sample.
    #[serde(default)]
    pub right_control_time_s: Option<f64>,
    /// The threshold on |u|.
    pub right_control_threshold: f64,
}

/// Where a plant's output goes first when its input steps upwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InitialDirection {
    /// With the input.
    Along,
    /// Against the input (initial undershoot, where the steady state goes along).
    Against,
}

/// Why a plant has no initial direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NoDirection {
    /// Several inputs or outputs.
    #[error("the plant has {inputs} inputs and {outputs} outputs; an initial direction exists for one of each")]
    NotSiso {
        /// Columns of B.
        inputs: usize,
        /// Rows of C.
        outputs: usize,
    },
    /// No input ever moves the output.
    #[error("the plant's output never answers to its input")]
    Silent,
    /// The model is not well formed; whoever stores plants checks them before.
    #[error("the plant's model is not well formed")]
    Malformed,
}

/// The sign of the first nonzero derivative (sampled: of the first nonzero value) of the step response.
///
/// For a transfer function `b_m x^m + … / (a_n x^n + …)` that is the sign of `b_m/a_n`, by the initial value theorem.
/// For a state space model it is the sign of the first nonzero one of D, CB, CAB, …, CA^{n−1}B; one below `1e-12` times
/// ‖C‖‖A‖^k‖B‖ counts as zero, so that rounding does not decide.
///
/// # Errors
/// [`NoDirection`] for several inputs or outputs, for a plant that is zero, and for a model that is not well formed.
pub fn initial_direction(plant: &Model) -> Result<InitialDirection, NoDirection> {
    let leading = match plant {
        Model::TransferFunction(m) => {
            let lead = |c: &[f64]| c.iter().copied().find(|x| *x != 0.0);
            let den = lead(&m.den).ok_or(NoDirection::Malformed)?;
            lead(&m.num).ok_or(NoDirection::Silent)?.signum() * den.signum()
        }
        Model::StateSpace(m) => first_markov_parameter(m)?,
    };
    if leading.is_nan() {
        return Err(NoDirection::Malformed);
    }
    Ok(if leading > 0.0 { InitialDirection::Along } else { InitialDirection::Against })
}

fn first_markov_parameter(m: &StateSpaceModel) -> Result<f64, NoDirection> {
    let states = m.a.len();
    let inputs = m.d.first().map_or(0, Vec::len);
    let outputs = m.d.len();
    if inputs != 1 || outputs != 1 {
        return Err(NoDirection::NotSiso { inputs, outputs });
    }
    let well_formed = m.a.iter().all(|row| row.len() == states)
        && m.b.len() == states
        && m.b.iter().all(|row| row.len() == 1)
        && (states == 0 || m.c.len() == 1 && m.c[0].len() == states);
    if !well_formed {
        return Err(NoDirection::Malformed);
    }
    if m.d[0][0] != 0.0 {
        return Ok(m.d[0][0]);
    }
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    let a_norm = norm(&mut m.a.iter().flatten().copied());
    let c_norm = norm(&mut m.c.iter().flatten().copied());
    let mut x: Vec<f64> = m.b.iter().map(|row| row[0]).collect();
    let mut bound = c_norm * norm(&mut x.iter().copied());
    for _ in 0..states {
        let parameter: f64 = m.c[0].iter().zip(&x).map(|(c, x)| c * x).sum();
        if parameter.abs() > MARKOV_ZERO * bound {
            return Ok(parameter);
        }
        x = m.a.iter().map(|row| row.iter().zip(&x).map(|(a, x)| a * x).sum()).collect();
        bound *= a_norm;
    }
    Err(NoDirection::Silent)
}

/// The metrics of a trial recorded on `plant`.
///
/// # Panics
/// If the trial has no sample, which the readers of trials refuse.
#[must_use]
pub fn metrics(trial: &Trial, plant: &Model) -> TimeDomainMetrics {
    let error = trial.error();
    assert!(!error.is_empty(), "a trial without samples has no metrics");
    let n = error.len() as f64;
    let largest = largest_modulus(&error);
    // Scaled, so that squares of large numbers do not overflow and those of tiny ones do not vanish.
    let scaled = |x: &f64| if largest > 0.0 { (x.clamp(-f64::MAX, f64::MAX) / largest).abs() } else { 0.0 };
    let mean = error.iter().map(scaled).sum::<f64>() / n;
    let mean_square = error.iter().map(|x| scaled(x).powi(2)).sum::<f64>() / n;
    let mut metrics = TimeDomainMetrics {
        mean_abs_error: mean * largest,
        rms_error: mean_square.sqrt() * largest,
        max_abs_output: largest_modulus(&trial.signals.output),
        control_log_dimensionless_jerk: log_dimensionless_jerk(&trial.signals.control, trial.sample_time_s).ok(),
        right_control_at_start: None,
        right_control_time_s: None,
        right_control_undetermined: None,
        right_control_threshold: START_THRESHOLD,
    };
    metrics.judge_start(trial, plant, START_THRESHOLD);
    metrics
}

impl TimeDomainMetrics {
    /// Judges the first deliberate control of the trial that these metrics are of, with a threshold on |u|.
    pub fn judge_start(&mut self, trial: &Trial, plant: &Model, threshold: f64) {
        let start = right_control(trial, plant, threshold);
        self.right_control_at_start = start.as_ref().ok().map(|s| s.right);
        self.right_control_time_s = start.as_ref().ok().map(|s| s.sample as f64 * trial.sample_time_s);
        self.right_control_undetermined = start.err();
        self.right_control_threshold = threshold;
    }
}

fn largest_modulus(values: &[f64]) -> f64 {
    values.iter().fold(0.0_f64, |m, x| m.max(x.abs())).min(f64::MAX)
}

struct StartControl {
    right: bool,
    sample: usize,
}

fn right_control(trial: &Trial, plant: &Model, threshold: f64) -> Result<StartControl, String> {
    let direction = initial_direction(plant).map_err(|e| e.to_string())?;
    let (u, r) = (&trial.signals.control, &trial.signals.command);
    // Section 5.8 takes the smallest positive integer: the sample at time zero is before the start.
    let first = (1..u.len())
        .find(|i| u[*i].abs() > threshold)
        .ok_or_else(|| format!("|u| never passes {threshold} after the first sample"))?;
    let sample = first + 1;
    if sample >= u.len() {
        return Err(format!("|u| passes {threshold} only at the last sample, {first}"));
    }
    for (name, value) in [("control u", u[sample]), ("command r", r[sample])] {
        if value == 0.0 {
            return Err(format!("the {name} has no direction: it is zero at sample {sample}, just after the start"));
        }
    }
    let along = (u[sample] > 0.0) == (r[sample] > 0.0);
    Ok(StartControl { right: along == (direction == InitialDirection::Along), sample })
}
