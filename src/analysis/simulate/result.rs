//! What a simulation answers.

use crate::control::bode;
use crate::learning::bode::Response;
use crate::learning::frequency_domain::ControllerMetrics;
use crate::learning::time_domain::TimeDomainMetrics;
use crate::num::Complex64;
use crate::simulate::closed_loop::Pole;
use schemars::JsonSchema;
use serde::Serialize;

/// The result.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct SimulateResult {
    /// The sample time of the loop in seconds; null of one in continuous time.
    pub sample_time_s: Option<f64>,
    /// The slowest pole of the loop and of the feedforward, which is to the left of the axis; null where all is over
    /// after some samples.
    pub slowest_pole: Option<PoleResult>,
    /// The signals.
    pub signals: SignalsResult,
    /// How exactly they were computed.
    pub numerical_error: NumericalErrorResult,
    /// The metrics that a recorded trial with these signals would have.
    pub metrics: TimeDomainMetrics,
    /// How the metrics spread over draws of the noise; null where nothing is drawn.
    pub realisations: Option<RealisationsResult>,
    /// What is said in place of intervals, where nothing is drawn.
    pub without_interval: Option<String>,
    /// How much of a recording the simulation explains, where the command is that of a trial.
    pub recorded: Option<RecordedResult>,
    /// Band averages of the controllers' distances, the truth that an identification is compared with.
    pub norms: ControllerMetrics,
    /// The answer to a unit step from rest, without noise.
    pub step_response: StepResponse,
    /// The motion from the initial state, without command, disturbance and noise; null where the plant starts at rest.
    pub free_response: Option<FreeResponse>,
    /// Frequency responses of the parts and of the loop, delays included.
    pub frequency_responses: FrequencyResponses,
}

/// A mode of the loop.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct PoleResult {
    /// Its rate in 1/s: negative, the mode decays.
    pub rate_per_s: f64,
    /// Its angular frequency in rad/s, 0 of a real pole; null where only the rate is known.
    pub frequency_rad_s: Option<f64>,
    /// The pole in the plane of z as `[re, im]`, without unit; null in continuous time.
    #[schemars(with = "Option<Vec<f64>>")]
    pub z: Option<[f64; 2]>,
}

impl From<Pole> for PoleResult {
    fn from(pole: Pole) -> Self {
        let Pole { rate_per_s, frequency_rad_s, z } = pole;
        Self { rate_per_s, frequency_rad_s, z: z.map(|z| [z.re, z.im]) }
    }
}

/// Equally long signals.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct SignalsResult {
    /// Time between the samples that were simulated, in seconds.
    pub sample_time_s: f64,
    /// Which of them are shown: every so many-th.
    pub every: usize,
    /// How many were simulated.
    pub samples: usize,
    /// Time in seconds.
    pub t: Vec<f64>,
    /// Command r.
    pub r: Vec<f64>,
    /// Control u with its remnant; null where a controller differentiates, so that its control has no samples.
    pub u: Option<Vec<f64>>,
    /// Output y as recorded, with measurement noise.
    pub y: Vec<f64>,
    /// Error r − y as recorded.
    pub e: Vec<f64>,
    /// Disturbance d; null without one.
    pub d: Option<Vec<f64>>,
}

/// How exactly signals were computed.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct NumericalErrorResult {
    /// Whether they are exact up to rounding: in sampled time, and in continuous time without a delay around the loop,
    /// for stimuli that go straight from sample to sample.
    pub exact: bool,
    /// Steps within a sample.
    pub steps_of_a_sample: usize,
    /// How far y moved when the steps were last halved, at most, in units of y; what is left is smaller.
    pub output: f64,
    /// The same of u, in units of u.
    pub control: f64,
    /// By how much y would move, mean over the samples, if stimuli were smooth between their samples and not straight,
    /// in units of y: a third of what leaving out every second sample does. Null in sampled time.
    pub between_samples: Option<f64>,
}

/// How a metric spreads over draws of the noise.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Spread {
    /// Its mean, in the unit of the metric.
    pub mean: f64,
    /// Its standard deviation; null of one draw.
    pub sd: Option<f64>,
    /// The range that 95 % of trials lie in: from the 2.5 % to the 97.5 % quantile; null of fewer than 40 draws.
    #[schemars(with = "Option<Vec<f64>>")]
    pub range_95: Option<[f64; 2]>,
    /// The 95 % interval of the mean by Student's t; null of one draw.
    #[schemars(with = "Option<Vec<f64>>")]
    pub interval_95: Option<[f64; 2]>,
}

/// Metrics over draws of the noise.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct RealisationsResult {
    /// How many draws.
    pub count: usize,
    /// Of the mean absolute error, in units of y.
    pub mean_abs_error: Spread,
    /// Of the root mean square error, in units of y.
    pub rms_error: Spread,
    /// Of the largest |y|, in units of y.
    pub max_abs_output: Spread,
    /// Of the control's log dimensionless jerk, without unit; null where one of the draws has none.
    pub control_log_dimensionless_jerk: Option<Spread>,
}

/// How much of a recording a simulation explains.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct RecordedResult {
    /// The share of the recorded control's variance, 1 − Σ (u − û)²/Σ (u − mean u)²; null where it does not vary, or
    /// the simulated one has no samples.
    pub accounted_for_u: Option<f64>,
    /// The same of the output.
    pub accounted_for_y: Option<f64>,
}

/// Answers to a unit step at time 0, from rest.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct StepResponse {
    /// Time in seconds.
    pub t: Vec<f64>,
    /// Output of the plant alone to a unit step of its input, in units of y; null where it overflows.
    pub plant: Option<Vec<f64>>,
    /// Output of the loop to a unit step of the command, in units of y.
    pub y: Vec<f64>,
    /// Control of the loop to it, in units of u; null where a controller differentiates.
    pub u: Option<Vec<f64>>,
}

/// The motion from an initial state.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct FreeResponse {
    /// Time in seconds.
    pub t: Vec<f64>,
    /// Output, in its unit.
    pub y: Vec<f64>,
    /// Control, in its unit; null where a controller differentiates.
    pub u: Option<Vec<f64>>,
}

/// Frequency responses on one grid.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct FrequencyResponses {
    /// The frequencies, rad/s.
    pub omega_rad_s: Vec<f64>,
    /// The plant G, with its delay.
    pub plant: Response,
    /// Gff, with delay and preview.
    pub feedforward: Response,
    /// Gfb.
    pub feedback: Response,
    /// Gff G, which is 0 dB and 0° where the feedforward is the inverse of the plant.
    pub feedforward_plant: Response,
    /// The loop gain G Gfb.
    pub loop_gain: Response,
    /// The closed loop from command to output, G (Gff + Gfb)/(1 + G Gfb).
    pub closed_loop: Response,
    /// From command to error, (1 − Gff G)/(1 + G Gfb).
    pub command_to_error: Response,
}

/// Gain and phase of responses on a grid.
pub(super) fn gain_and_phase(omega_rad_s: &[f64], responses: &[Complex64]) -> Response {
    let bode = bode::bode(omega_rad_s, responses);
    Response { gain_db: bode.gain_db, phase_deg: bode.phase_deg }
}
