//! What could be predicted of the trials, and what the estimate shrunk towards the best structure predicts of trials
//! held out.

use super::shares::{Shares, TrialShare};
use crate::analysis::inputs::trials::ResolvedTrial;
use crate::ctl::{Ctl, Stopped};
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
        }
    }
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
    let sizes = learned.sizes();
    Ok(RegularisedResult {
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
