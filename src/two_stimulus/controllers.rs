//! Feedback and feedforward at each line, without any assumption about their structure.
//!
//! From `u = Gff r + Gfb (r − y)` alone, without the plant,
//!
//! `Gfb = −H_ud/H_yd`, `Gff = H_ur − Gfb (1 − H_yr)`.
//!
//! With `y = G (u + d)` these are `Gfb = 1/H_yd − 1/G` and `Gff = H_yr/H_yd − Gfb`. Written so, the first cancels where
//! `|G Gfb|` is small (`H_yd ≈ G`), and with `H_ud` alone, `Gfb = −H_ud/(G (1 + H_ud))`, it cancels where `|G Gfb|` is
//! large (`H_ud ≈ −1`). The quotient of the two measured responses cancels nowhere, needs no plant, and does not suffer
//! from what the plant's drift leaks into y: whatever y did, u is the person's answer to it.
//!
//! # Interpolation
//! Where the command excites a line and the disturbance does not, Gfb is interpolated between the two nearest lines at
//! which it is known, never beyond them: `ln|Gfb|` linearly in `ln ω`, and the phase linearly in ω (exact for a delay).
//! Phases are unwrapped from line to line, anchored at the lowest: the principal value there, and from each line to the
//! next the branch that is nearest to what the delay so far predicts, or simply nearest at the second line. The error
//! of linear interpolation, `½ |f''| (ω − ω₁)(ω₂ − ω)` with f'' from divided differences of the neighbouring lines, is
//! stated as `interpolation_error` and added to the bands; with fewer than three lines there is no such estimate. The
//! feedforward is never interpolated.
//!
//! # Variance
//! First order in the errors of the four responses (delta method), `E|δ|²` of the complex value, circular noise
//! assumed. Bands are `|X| exp(± q s)` and `arg X ± q s` with `s² = E|δ|²/(2|X|²)` and q Student's quantile for twice
//! the complex degrees of freedom.

use super::responses::{LineResponse, UD, UR, YD, YR};
use crate::num::distributions::student_t;
use num_complex::Complex64;

/// A controller's response at a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimated {
    /// The value.
    pub value: Complex64,
    /// `E|δ|²` from noise, where it is known.
    pub variance: Option<f64>,
    /// Largest relative error that linear interpolation may have here; 0 where nothing was interpolated, `None` where
    /// it cannot be told.
    pub interpolation_error: Option<f64>,
    /// Whether the feedback was interpolated.
    pub interpolated: bool,
    /// Complex degrees of freedom behind the variance.
    pub freedoms: f64,
}

impl Estimated {
    /// Standard deviation of `ln|X|` and of `arg X` in rad, interpolation error included.
    #[must_use]
    pub fn relative_deviation(&self) -> Option<f64> {
        let noise = self.variance? / (2.0 * self.value.norm_sqr());
        let bias = if self.interpolated { self.interpolation_error? } else { 0.0 };
        Some((noise + bias * bias).sqrt())
    }

    /// Half-width of the band of `ln|X|`, and of the phase in rad, with this probability.
    #[must_use]
    pub fn half_width(&self, probability: f64) -> Option<f64> {
        let noise = (self.variance? / (2.0 * self.value.norm_sqr())).sqrt();
        let bias = if self.interpolated { self.interpolation_error? } else { 0.0 };
        let quantile = student_t(probability, 2.0 * self.freedoms);
        Some(((quantile * noise).powi(2) + bias * bias).sqrt())
    }
}

/// Both controllers at a line.
#[derive(Debug, Clone, PartialEq)]
pub struct LineControllers {
    /// The responses.
    pub response: LineResponse,
    /// Gfb; `None` where the disturbance excites neither this line nor one on each side.
    pub feedback: Option<Estimated>,
    /// Gff; `None` where the command does not excite the line or Gfb is not known.
    pub feedforward: Option<Estimated>,
    /// Unwrapped phase of Gfb in rad, as interpolation takes it.
    pub feedback_phase_rad: Option<f64>,
}

/// Both controllers, line by line.
#[derive(Debug, Clone, PartialEq)]
pub struct Controllers {
    /// In increasing frequency.
    pub lines: Vec<LineControllers>,
    /// Steps of the unwrapped phase, from line to line of the disturbance, of more than a third of a turn: other
    /// branches are possible.
    pub ambiguous_phase_hz: Vec<f64>,
}

/// `Gfb = −H_ud/H_yd` with the coefficients of its error.
fn feedback(line: &LineResponse) -> Option<(Estimated, [Complex64; 4])> {
    let [h_ud, h_yd] = line.disturbance?;
    let value = -h_ud / h_yd;
    if !(value.re.is_finite() && value.im.is_finite()) {
        return None;
    }
    let mut c = [Complex64::default(); 4];
    c[UD] = -h_yd.inv();
    c[YD] = -value / h_yd;
    let variance = line.variance_of(&c);
    Some((
        Estimated { value, variance, interpolation_error: Some(0.0), interpolated: false, freedoms: line.freedoms },
        c,
    ))
}

/// Estimates both controllers at every line.
#[must_use]
pub fn controllers(responses: &[LineResponse]) -> Controllers {
    let exact: Vec<(usize, Estimated)> =
        responses.iter().enumerate().filter_map(|(k, line)| Some((k, feedback(line)?.0))).collect();
    let knots = Knots::new(responses, &exact);
    let lines = responses
        .iter()
        .enumerate()
        .map(|(k, line)| {
            let (known, phase) = match exact.iter().position(|(i, _)| *i == k) {
                Some(i) => (Some(exact[i].1), Some(knots.phase[i])),
                None => knots.at(line.omega_rad_s).unzip(),
            };
            LineControllers {
                response: line.clone(),
                feedback: known,
                feedforward: known.and_then(|feedback| feedforward(line, &feedback)),
                feedback_phase_rad: phase,
            }
        })
        .collect();
    Controllers { lines, ambiguous_phase_hz: knots.ambiguous_hz }
}

/// `Gff = H_ur − Gfb (1 − H_yr)`.
fn feedforward(line: &LineResponse, known: &Estimated) -> Option<Estimated> {
    let [h_ur, h_yr] = line.command?;
    let value = h_ur - known.value * (1.0 - h_yr);
    if !(value.re.is_finite() && value.im.is_finite()) {
        return None;
    }
    let mut c = [Complex64::default(); 4];
    c[UR] = Complex64::from(1.0);
    c[YR] = known.value;
    let from_feedback = -(1.0 - h_yr);
    let variance = match feedback(line) {
        Some((_, own)) => {
            for (c, own) in c.iter_mut().zip(own) {
                *c += from_feedback * own;
            }
            line.variance_of(&c)
        }
        // Other lines have other noise.
        None => line.variance_of(&c).zip(known.variance).map(|(a, b)| a + from_feedback.norm_sqr() * b),
    };
    // What the interpolation may be wrong by, relative to this value.
    let interpolation_error = known
        .interpolation_error
        .map(|relative| relative * (from_feedback * known.value).norm() / value.norm().max(f64::MIN_POSITIVE));
    Some(Estimated {
        value,
        variance,
        interpolation_error,
        interpolated: known.interpolated,
        freedoms: line.freedoms.min(known.freedoms),
    })
}

/// Lines at which Gfb is known.
struct Knots {
    omega: Vec<f64>,
    estimated: Vec<Estimated>,
    phase: Vec<f64>,
    ambiguous_hz: Vec<f64>,
}

impl Knots {
    fn new(responses: &[LineResponse], exact: &[(usize, Estimated)]) -> Self {
        let omega: Vec<f64> = exact.iter().map(|(k, _)| responses[*k].omega_rad_s).collect();
        let estimated: Vec<Estimated> = exact.iter().map(|(_, e)| *e).collect();
        let mut phase: Vec<f64> = Vec::with_capacity(omega.len());
        let mut ambiguous_hz = Vec::new();
        for (i, e) in estimated.iter().enumerate() {
            let principal = e.value.arg();
            let Some(last) = phase.last().copied() else {
                phase.push(principal);
                continue;
            };
            // A person lags more with frequency: the slope so far, if it is one of a lag, predicts the next phase.
            let slope = if i >= 2 { (last - phase[0]) / (omega[i - 1] - omega[0]) } else { 0.0 };
            let expected = last + slope.min(0.0) * (omega[i] - omega[i - 1]);
            let turns = ((expected - principal) / std::f64::consts::TAU).round();
            let own = principal + turns * std::f64::consts::TAU;
            if (own - expected).abs() > std::f64::consts::TAU / 3.0 {
                ambiguous_hz.push(omega[i] / std::f64::consts::TAU);
            }
            phase.push(own);
        }
        Self { omega, estimated, phase, ambiguous_hz }
    }

    /// `f''` of a function given at the knots: the largest of the divided differences that hold the interval `i, i +
    /// 1`.
    fn curvature(x: &[f64], f: &[f64], i: usize) -> Option<f64> {
        let second = |a: usize| {
            let slopes = [(f[a + 1] - f[a]) / (x[a + 1] - x[a]), (f[a + 2] - f[a + 1]) / (x[a + 2] - x[a + 1])];
            (2.0 * (slopes[1] - slopes[0]) / (x[a + 2] - x[a])).abs()
        };
        let first = i.saturating_sub(1);
        let last = (i + 2).min(x.len() - 1);
        (first + 2 <= last).then(|| (first..=last - 2).map(second).fold(0.0, f64::max))
    }

    /// Gfb between the knots, with its unwrapped phase.
    fn at(&self, omega: f64) -> Option<(Estimated, f64)> {
        let i = self.omega.windows(2).position(|pair| pair[0] < omega && omega < pair[1])?;
        let (low, high) = (&self.estimated[i], &self.estimated[i + 1]);
        let logs: Vec<f64> = self.omega.iter().map(|w| w.ln()).collect();
        let magnitudes: Vec<f64> = self.estimated.iter().map(|e| e.value.norm().ln()).collect();
        let (t, s) = (
            (omega.ln() - logs[i]) / (logs[i + 1] - logs[i]),
            (omega - self.omega[i]) / (self.omega[i + 1] - self.omega[i]),
        );
        let magnitude = (1.0 - t) * magnitudes[i] + t * magnitudes[i + 1];
        let phase = (1.0 - s) * self.phase[i] + s * self.phase[i + 1];
        let value = Complex64::from_polar(magnitude.exp(), phase);
        // Errors of ln|Gfb| and of the phase, from independent lines.
        let variance = low.variance.zip(high.variance).map(|(a, b)| {
            let (a, b) = (a / low.value.norm_sqr(), b / high.value.norm_sqr());
            let relative = 0.5 * ((1.0 - t).powi(2) * a + t * t * b + (1.0 - s).powi(2) * a + s * s * b);
            relative * value.norm_sqr()
        });
        let bound = |x: &[f64], f: &[f64], at: f64| {
            Self::curvature(x, f, i).map(|second| 0.5 * second * (at - x[i]) * (x[i + 1] - at))
        };
        let interpolation_error =
            bound(&logs, &magnitudes, omega.ln()).zip(bound(&self.omega, &self.phase, omega)).map(|(a, b)| a.hypot(b));
        let freedoms = low.freedoms.min(high.freedoms);
        Some((Estimated { value, variance, interpolation_error, interpolated: true, freedoms }, phase))
    }
}
