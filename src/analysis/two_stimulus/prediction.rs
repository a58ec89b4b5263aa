//! What could be predicted of the trials, and what the estimate shrunk towards the best structure predicts of trials
//! held out.

use super::result::{FittedAtLine, PROBABILITY, fitted_at_line, pair};
use super::shares::{Shares, TrialShare};
use crate::analysis::inputs::trials::ResolvedTrial;
use crate::control::System;
use crate::ctl::{Ctl, Stopped};
use crate::num::distributions::student_t;
use crate::response::stimuli::{SegmentLines, StimulusLines};
use crate::two_stimulus::fit::Fitted;
use crate::two_stimulus::regularised::{Regularised, RegularisedError, default_sizes};
use crate::two_stimulus::steady::{Share, accounted_for_at_lines, ceilings, groups_by_stimuli};
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The names of the groups of [`groups_by_stimuli`].
const GROUPS: [&str; 3] = ["command", "disturbance", "both"];

/// Mean shares of control and output; null where a trial has none.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MeanShare {
    /// Of the control.
    pub u: Option<f64>,
    /// Of the output.
    pub y: Option<f64>,
}

impl From<Share> for MeanShare {
    fn from([u, y]: Share) -> Self {
        Self { u, y }
    }
}

/// How much of the variation of the trials a linear response to the stimuli could account for at most: the larger part
/// of what misses from 1 is no response to them. Shares are those of the steady state at the lines, means over the
/// trials; trials are grouped by their stimuli (command, disturbance, both).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Ceiling {
    /// The share of the power that lies at the excited lines: no response can pass it, even one of each trial's own.
    pub at_lines: MeanShare,
    /// With one response for each group of trials, known without error (unbiased estimate): what changes from trial to
    /// trial lies beyond it. Null where a group has a single trial at a line.
    pub by_group: MeanShare,
    /// With one response for each group, estimated from the other trials of the group.
    pub by_group_left_out: MeanShare,
}

/// The estimate without structure of each group of trials, shrunk towards the best structure: a Gaussian process of
/// relative deviations, its sizes those with the smallest error of trials left out of the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RegularisedResult {
    /// Why there is none; everything else is empty then.
    pub reason: Option<String>,
    /// Position of the structure that it is shrunk towards.
    pub structure: Option<usize>,
    /// How far deviations reach, in ln ω.
    pub reach: Option<f64>,
    /// Standard deviation of the relative deviations that all trials share.
    pub shared: Option<f64>,
    /// Of those of each group.
    pub group: Option<f64>,
    /// Of those of each trial, which cannot be predicted.
    pub trial: Option<f64>,
    /// The group of each trial: `command`, `disturbance` or `both`.
    pub groups: Vec<String>,
    /// Shares of the steady state at the lines that the other trials predict of each trial. The sizes were chosen by
    /// them, so they flatter a little.
    pub left_out_vaf: Option<Shares>,
    /// Shares of the steady state at the lines of the trials of `validate_on`.
    pub held_out_vaf: Option<Shares>,
    /// Both controllers with 95 % bands: of all trials, then of each group.
    #[serde(default)]
    pub controllers: Vec<RegularisedControllers>,
    /// What is predicted of each trial of `validate_on` at its excited lines; null without such trials.
    #[serde(default)]
    pub predictions: Option<Vec<TrialPrediction>>,
}

/// Controllers without structure, shrunk towards the best structure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RegularisedControllers {
    /// The group of trials, `command`, `disturbance` or `both`; null for what all trials share, where how groups differ
    /// is not known in advance.
    pub group: Option<String>,
    /// Line by line, in increasing frequency.
    pub lines: Vec<RegularisedLine>,
}

/// Responses of the control and both controllers at a line. Bands are those of the Gaussian process given the structure
/// and its sizes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RegularisedLine {
    /// Frequency in Hz.
    pub frequency_hz: f64,
    /// From command to control as `[re, im]`, in units of u per unit of r.
    pub h_ur: [f64; 2],
    /// Its variance `E|δ|²`, in squared units of it.
    pub variance_ur: f64,
    /// From disturbance to control as `[re, im]`, without unit.
    pub h_ud: [f64; 2],
    /// Its variance `E|δ|²`.
    pub variance_ud: f64,
    /// Gfb.
    pub feedback: FittedAtLine,
    /// Gff.
    pub feedforward: FittedAtLine,
}

/// What is predicted of a trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrialPrediction {
    /// The trial, by its place in the request.
    pub trial: String,
    /// Its group: `command`, `disturbance` or `both`.
    pub group: String,
    /// Line by line, those that its stimuli excite.
    pub lines: Vec<PredictedLine>,
    /// How many of the recorded controls lie within the range of 95 %, of those lines whose noise is known.
    pub within: usize,
    /// Lines whose noise is known.
    pub compared: usize,
}

/// Amplitudes of a trial at a line, means over its segments.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PredictedLine {
    /// Frequency in Hz.
    pub frequency_hz: f64,
    /// Predicted amplitude of the control as `[re, im]`, in units of u.
    pub u: [f64; 2],
    /// Predicted amplitude of the output as `[re, im]`, in units of y.
    pub y: [f64; 2],
    /// The recorded amplitude of the control, in units of u.
    pub recorded_u: [f64; 2],
    /// The radius of the circle about `u` in which the recorded amplitude lies with 95 %, with the noise of the line,
    /// in units of u; null where that noise is not known.
    pub radius_95: Option<f64>,
}

impl RegularisedResult {
    fn none(reason: impl Into<String>) -> Self {
        Self {
            reason: Some(reason.into()),
            structure: None,
            reach: None,
            shared: None,
            group: None,
            trial: None,
            groups: Vec::new(),
            left_out_vaf: None,
            held_out_vaf: None,
            controllers: Vec::new(),
            predictions: None,
        }
    }
}

/// Controllers of all trials, and of each group that there is.
fn controllers(learned: &Regularised, lines: &StimulusLines, groups: &[usize]) -> Vec<RegularisedControllers> {
    let quantile = student_t(PROBABILITY, f64::INFINITY);
    let present = (0..GROUPS.len()).filter(|group| groups.contains(group)).map(Some);
    let of = |group: Option<usize>| RegularisedControllers {
        group: group.map(|group| GROUPS[group].to_owned()),
        lines: (0..lines.omega_rad_s.len())
            .map(|k| {
                let found = learned.posterior(lines.omega_rad_s[k], group);
                let [feedback, feedforward] = found.controllers.map(|band| fitted_at_line(&band, quantile));
                RegularisedLine {
                    frequency_hz: lines.frequency_hz[k],
                    h_ur: pair(found.responses[0]),
                    variance_ur: found.response_variances[0],
                    h_ud: pair(found.responses[1]),
                    variance_ud: found.response_variances[1],
                    feedback,
                    feedforward,
                }
            })
            .collect(),
    };
    std::iter::once(None).chain(present).map(of).collect()
}

/// What is predicted of each trial, beside what was recorded.
fn predictions(
    learned: &Regularised,
    plant: &System,
    lines: &StimulusLines,
    groups: &[usize],
    trials: &[ResolvedTrial],
) -> Vec<TrialPrediction> {
    // |δ|² of a circular error of variance v is v/2 times a χ² of two degrees of freedom.
    let radius = |variance: f64| (-(1.0 - PROBABILITY).ln() * variance).sqrt();
    let of = |(trial, resolved): (usize, &ResolvedTrial)| {
        let own: Vec<&SegmentLines> = lines.segments.iter().filter(|s| s.trial == trial).collect();
        let count = own.len() as f64;
        let mean = |pick: &dyn Fn(&SegmentLines) -> Complex64| -> Complex64 {
            own.iter().map(|s| pick(s)).sum::<Complex64>() / count
        };
        let mut found = Vec::new();
        let (mut within, mut compared) = (0, 0);
        for (k, omega) in lines.omega_rad_s.iter().enumerate() {
            let (r, d) = (mean(&|s| s.command[k]), mean(&|s| s.disturbance[k]));
            if own.is_empty() || r.norm_sqr() + d.norm_sqr() == 0.0 {
                continue;
            }
            let predicted = learned.predicted(*omega, groups[trial], r, d);
            let recorded = mean(&|s| s.control[k]);
            let radius_95 = predicted.noise.map(|noise| radius(predicted.variance + noise / count));
            if let Some(radius) = radius_95 {
                compared += 1;
                within += usize::from((recorded - predicted.value).norm() <= radius);
            }
            found.push(PredictedLine {
                frequency_hz: lines.frequency_hz[k],
                u: pair(predicted.value),
                y: pair(plant.response(*omega) * (predicted.value + d)),
                recorded_u: pair(recorded),
                radius_95,
            });
        }
        let group = GROUPS[groups[trial]].to_owned();
        TrialPrediction { trial: resolved.name.clone(), group, lines: found, within, compared }
    };
    trials.iter().enumerate().map(of).collect()
}

/// The ceiling of the trials.
pub(super) fn ceiling(lines: &StimulusLines) -> Ceiling {
    let found = ceilings(lines, &groups_by_stimuli(lines));
    Ceiling {
        at_lines: found.at_lines.into(),
        by_group: found.by_group.into(),
        by_group_left_out: found.left_out.into(),
    }
}

fn named(shares: &[Share], trials: &[ResolvedTrial]) -> Shares {
    let of =
        |(share, trial): (&Share, &ResolvedTrial)| TrialShare { trial: trial.name.clone(), u: share[0], y: share[1] };
    Shares::new(shares.iter().zip(trials).map(of).collect())
}

/// Learns from the trials and predicts them, and those held out.
pub(super) fn regularised(
    best: Option<(usize, &Fitted)>,
    [lines, held_lines]: [Option<&StimulusLines>; 2],
    [trials, held_out]: [&[ResolvedTrial]; 2],
    ctl: &Ctl,
) -> Result<RegularisedResult, Stopped> {
    let (Some((structure, law)), Some(lines)) = (best, lines) else {
        return Ok(RegularisedResult::none("no structure was fitted that it could be shrunk towards"));
    };
    let groups = groups_by_stimuli(lines);
    let learned = match Regularised::new(lines, &groups, law, &default_sizes(), ctl) {
        Ok(learned) => learned,
        Err(RegularisedError::Stopped(stopped)) => return Err(stopped),
        Err(error) => return Ok(RegularisedResult::none(error.to_string())),
    };
    let plant = |lines: &StimulusLines, k: usize| law.person.plant().response(lines.omega_rad_s[k]);
    let loop_of =
        |g: Complex64, control: Complex64, s: &SegmentLines, k: usize| [control, g * (control + s.disturbance[k])];
    let own = accounted_for_at_lines(lines, |s, k| {
        let segments = lines.segments.iter().filter(|other| other.trial == s.trial);
        let (sum, count) =
            segments.fold((Complex64::default(), 0.0), |(sum, n), other| (sum + other.control[k], n + 1.0));
        let error = learned.left_out_error(s.trial, k).unwrap_or_default();
        loop_of(plant(lines, k), sum / count - error, s, k)
    });
    let held = held_lines.map(|lines| {
        let groups = groups_by_stimuli(lines);
        accounted_for_at_lines(lines, |s, k| {
            let control = learned.control(lines.omega_rad_s[k], groups[s.trial], s.command[k], s.disturbance[k]);
            loop_of(plant(lines, k), control, s, k)
        })
    });
    let predictions =
        held_lines.map(|lines| predictions(&learned, law.person.plant(), lines, &groups_by_stimuli(lines), held_out));
    let sizes = learned.sizes();
    Ok(RegularisedResult {
        controllers: controllers(&learned, lines, &groups),
        predictions,
        reason: None,
        structure: Some(structure),
        reach: Some(sizes.reach),
        shared: Some(sizes.shared),
        group: Some(sizes.group),
        trial: Some(sizes.trial),
        groups: groups.iter().map(|g| GROUPS[*g].to_owned()).collect(),
        left_out_vaf: Some(named(&own, trials)),
        held_out_vaf: held.map(|shares| named(&shares, held_out)),
    })
}
