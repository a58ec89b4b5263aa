//! The variation of recordings that a steady response at the lines accounts for, and how much any such response could.
//!
//! A prediction `x̂_k` of the amplitudes `x_k` of a signal at the lines accounts for the share
//!
//! `Σ_segments ½ Σ_k (|x_k|² − |x_k − x̂_k|²) / Σ_segments var x`
//!
//! of its variation: what lies off the lines counts as missed. Three ceilings tell how much there is to gain.
//!
//! - *At the lines*: `x̂ = x`. No linear response to these stimuli has a larger share, whatever it follows (each trial
//!   its own).
//! - *One response for each group of trials* (whose segments repeat one another, and are averaged first), known without
//!   error: with the least-squares response of a group and its residuals r_i of n trials with leverages h_i, `E |r_i|²
//!   = σ² (1 − h_i)`, so `|r_i|²/(1 − h_i)` estimates what such a response misses without bias. What is missed beyond
//!   the power off the lines is the change from trial to trial.
//! - *Left out*: the same, each trial predicted from the others of its group, residuals `r_i/(1 − h_i)`. What this
//!   loses against the ceiling before it is the price of few trials, which a structure or a prior can pay back in part.

use crate::response::stimuli::{SegmentLines, StimulusLines};
use num_complex::Complex64;

/// Shares of the control and of the output.
pub type Share = [Option<f64>; 2];

/// The group of each trial by its stimuli: 0 with the command alone, 1 with the disturbance alone, 2 with both.
#[must_use]
pub fn groups_by_stimuli(lines: &StimulusLines) -> Vec<usize> {
    (0..lines.trials)
        .map(|trial| {
            let has = |pick: fn(&SegmentLines) -> &Vec<Complex64>| {
                lines.segments.iter().filter(|s| s.trial == trial).any(|s| pick(s).iter().any(|x| x.norm_sqr() > 0.0))
            };
            match (has(|s| &s.command), has(|s| &s.disturbance)) {
                (_, false) => 0,
                (false, true) => 1,
                (true, true) => 2,
            }
        })
        .collect()
}

/// What predictions account for of each trial; `predict` has the predicted control and output of a segment at a line.
pub fn accounted_for_at_lines(
    lines: &StimulusLines,
    predict: impl Fn(&SegmentLines, usize) -> [Complex64; 2],
) -> Vec<Share> {
    shares(lines, |segment, k| {
        let predicted = predict(segment, k);
        [(segment.control[k] - predicted[0]).norm_sqr(), (segment.output[k] - predicted[1]).norm_sqr()]
    })
}

/// Shares of each trial, from the squared amplitude that is missed of control and output at each line of each segment.
fn shares(lines: &StimulusLines, missed: impl Fn(&SegmentLines, usize) -> [f64; 2]) -> Vec<Share> {
    let mut gained = vec![[0.0; 2]; lines.trials];
    let mut total = vec![[0.0; 2]; lines.trials];
    for segment in &lines.segments {
        let (gained, total) = (&mut gained[segment.trial], &mut total[segment.trial]);
        for k in (0..lines.omega_rad_s.len()).filter(|k| is_excited(segment, *k)) {
            let missed = missed(segment, k);
            gained[0] += 0.5 * (segment.control[k].norm_sqr() - missed[0]);
            gained[1] += 0.5 * (segment.output[k].norm_sqr() - missed[1]);
        }
        (0..2).for_each(|i| total[i] += segment.variance[i]);
    }
    let share = |(gained, total): (&[f64; 2], &[f64; 2])| {
        [0, 1].map(|i| Some(gained[i] / total[i]).filter(|share| total[i] > 0.0 && share.is_finite()))
    };
    gained.iter().zip(&total).map(share).collect()
}

fn is_excited(segment: &SegmentLines, k: usize) -> bool {
    segment.command[k].norm_sqr() + segment.disturbance[k].norm_sqr() > 0.0
}

/// The mean over trials; `None` where one has no share, or there is no trial.
#[must_use]
pub fn mean(shares: &[Share]) -> Share {
    [0, 1].map(|i| {
        let values: Option<Vec<f64>> = shares.iter().map(|share| share[i]).collect();
        crate::num::stats::mean(&values?)
    })
}

/// How much responses at the lines could account for; means over trials.
#[derive(Debug, Clone, PartialEq)]
pub struct Ceilings {
    /// With the recorded amplitudes themselves.
    pub at_lines: Share,
    /// With one response for each group, known without error; `None` where a group has a single trial at a line.
    pub by_group: Share,
    /// With one response for each group, estimated from the other trials of the group; `None` as before.
    pub left_out: Share,
}

/// The ceilings of trials in groups.
///
/// # Panics
/// If there is not a group for every trial, which is a mistake of the caller.
#[must_use]
pub fn ceilings(lines: &StimulusLines, groups: &[usize]) -> Ceilings {
    assert_eq!(groups.len(), lines.trials, "a group for every trial");
    let at_lines = mean(&shares(lines, |_, _| [0.0; 2]));
    let fits: Option<Vec<Fit>> = (0..lines.omega_rad_s.len()).map(|k| Fit::new(lines, groups, k)).collect();
    let Some(fits) = fits else { return Ceilings { at_lines, by_group: [None; 2], left_out: [None; 2] } };
    let missed = |power: i32| {
        mean(&shares(lines, |segment, k| {
            let Residual { of_trial, of_segment, kept } = fits[k].residual(lines, groups, segment, k);
            // What segments differ by within a trial sums to zero, and no fit takes from it.
            [0, 1].map(|i| of_trial[i].norm_sqr() / kept.powi(power) + (of_segment[i] - of_trial[i]).norm_sqr())
        }))
    };
    Ceilings { at_lines, by_group: missed(1), left_out: missed(2) }
}

type Square = [[Complex64; 2]; 2];

/// Least squares of every group at a line.
struct Fit {
    /// Inverse Gram matrices and responses `[stimulus][channel]` of each group that excites the line.
    groups: Vec<Option<(Square, Square)>>,
}

/// Residuals of control and output: of a segment, their mean over the segments of its trial, and `1 − h`.
struct Residual {
    of_trial: [Complex64; 2],
    of_segment: [Complex64; 2],
    kept: f64,
}

/// Leverages this near to 1 leave nothing to predict a trial from.
const LONE: f64 = 1.0 - 1e-6;

impl Fit {
    /// `None` where a trial is the only one of its group at the line, or its stimuli are confounded there.
    fn new(lines: &StimulusLines, groups: &[usize], k: usize) -> Option<Self> {
        let count = groups.iter().max().map_or(0, |g| g + 1);
        let mut fit = Self { groups: Vec::new() };
        for group in 0..count {
            let own = || lines.segments.iter().filter(|s| groups[s.trial] == group && is_excited(s, k));
            let (mut gram, mut right) = ([[Complex64::default(); 2]; 2], [[Complex64::default(); 2]; 2]);
            for s in own() {
                let (x, z) = ([s.command[k], s.disturbance[k]], [s.control[k], s.output[k]]);
                for q in 0..2 {
                    for i in 0..2 {
                        gram[q][i] += x[q].conj() * x[i];
                        right[q][i] += x[q].conj() * z[i];
                    }
                }
            }
            if own().next().is_none() {
                fit.groups.push(None);
                continue;
            }
            let inverse = super::responses::inverse(&gram)?;
            let h = std::array::from_fn(|q| {
                std::array::from_fn(|j| inverse[q][0] * right[0][j] + inverse[q][1] * right[1][j])
            });
            fit.groups.push(Some((inverse, h)));
        }
        let is_lone = |s: &SegmentLines| is_excited(s, k) && fit.leverage(lines, groups, s, k) > LONE;
        (!lines.segments.iter().any(is_lone)).then_some(fit)
    }

    /// The leverage of the segment's whole trial: its segments repeat one another, and are left out together.
    fn leverage(&self, lines: &StimulusLines, groups: &[usize], segment: &SegmentLines, k: usize) -> f64 {
        let Some((inverse, _)) = &self.groups[groups[segment.trial]] else { return 1.0 };
        let own = lines.segments.iter().filter(|s| s.trial == segment.trial);
        own.map(|s| {
            let x = [s.command[k], s.disturbance[k]];
            let mut sum = Complex64::default();
            for q in 0..2 {
                for i in 0..2 {
                    sum += x[q] * inverse[q][i] * x[i].conj();
                }
            }
            sum.re
        })
        .sum()
    }

    fn residual(&self, lines: &StimulusLines, groups: &[usize], segment: &SegmentLines, k: usize) -> Residual {
        let zero = [Complex64::default(); 2];
        let Some((_, h)) = &self.groups[groups[segment.trial]] else {
            return Residual { of_trial: zero, of_segment: zero, kept: 1.0 };
        };
        let of = |s: &SegmentLines| {
            let (x, z) = ([s.command[k], s.disturbance[k]], [s.control[k], s.output[k]]);
            [0, 1].map(|j| z[j] - x[0] * h[0][j] - x[1] * h[1][j])
        };
        let own: Vec<[Complex64; 2]> =
            lines.segments.iter().filter(|s| s.trial == segment.trial && is_excited(s, k)).map(of).collect();
        let of_trial = [0, 1].map(|j| own.iter().map(|r| r[j]).sum::<Complex64>() / own.len() as f64);
        Residual { of_trial, of_segment: of(segment), kept: 1.0 - self.leverage(lines, groups, segment, k) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Trials with known responses by group and known changes from trial to trial.
    fn simulated(trials: usize, change: f64, noise: f64, seed: u64) -> (StimulusLines, Vec<usize>) {
        let mut random = rng::stream(seed, "steady");
        let mut normal = |size: f64| -> Complex64 {
            let mut draw = || -> f64 { StandardNormal.sample(&mut random) };
            size * Complex64::new(draw(), draw())
        };
        let omega: Vec<f64> = (1..=6).map(f64::from).collect();
        let zero = Complex64::default();
        let (mut segments, mut groups) = (Vec::new(), Vec::new());
        for trial in 0..trials {
            let group = trial % 3;
            groups.push(group);
            let stimuli: Vec<[Complex64; 2]> = (0..6)
                .map(|k| match group {
                    0 => [normal(1.0), zero],
                    1 => [zero, normal(1.0)],
                    _ if k % 2 == 0 => [normal(1.0), zero],
                    _ => [zero, normal(1.0)],
                })
                .collect();
            let changed: Vec<[Complex64; 2]> = (0..6).map(|_| [normal(change), normal(change)]).collect();
            for _ in 0..2 {
                let respond = |k: usize, channel: usize, normal: &mut dyn FnMut(f64) -> Complex64| {
                    let [r, d] = stimuli[k];
                    let h = Complex64::new(0.8 + 0.1 * group as f64, 0.3 * channel as f64 - 0.2);
                    h * r - 0.7 * h * d + changed[k][channel] + normal(noise)
                };
                let control: Vec<Complex64> = (0..6).map(|k| respond(k, 0, &mut normal)).collect();
                let output: Vec<Complex64> = (0..6).map(|k| respond(k, 1, &mut normal)).collect();
                // Half as much again off the lines.
                let variance = [&control, &output].map(|x| 0.75 * x.iter().map(Complex64::norm_sqr).sum::<f64>());
                segments.push(SegmentLines {
                    trial,
                    command: stimuli.iter().map(|s| s[0]).collect(),
                    disturbance: stimuli.iter().map(|s| s[1]).collect(),
                    control,
                    output,
                    noise: vec![None; 6],
                    variance,
                });
            }
        }
        let frequency_hz = omega.iter().map(|w| w / std::f64::consts::TAU).collect();
        let lines = StimulusLines { frequency_hz, omega_rad_s: omega, trials, segments, warnings: Vec::new() };
        (lines, groups)
    }

    #[test]
    fn the_ceiling_of_a_group_is_what_its_true_response_accounts_for() {
        let mut sums = [[0.0; 3]; 2];
        for seed in 0..200 {
            let (lines, groups) = simulated(12, 0.3, 0.1, seed);
            assert_eq!(groups_by_stimuli(&lines), groups);
            let truth = mean(&accounted_for_at_lines(&lines, |s, k| {
                let group = groups[s.trial];
                [0, 1].map(|channel| {
                    let h = Complex64::new(0.8 + 0.1 * group as f64, 0.3 * channel as f64 - 0.2);
                    h * s.command[k] - 0.7 * h * s.disturbance[k]
                })
            }));
            let found = ceilings(&lines, &groups);
            for i in 0..2 {
                assert!((found.at_lines[i].unwrap() - 2.0 / 3.0).abs() < 1e-12);
                let (limit, left_out) = (found.by_group[i].unwrap(), found.left_out[i].unwrap());
                assert!(left_out < limit && limit < found.at_lines[i].unwrap(), "{found:?}");
                sums[i][0] += truth[i].unwrap() / 200.0;
                sums[i][1] += limit / 200.0;
                sums[i][2] += left_out / 200.0;
            }
        }
        for [truth, limit, left_out] in sums {
            assert!((truth - limit).abs() < 0.01, "{truth} {limit}");
            assert!(limit - left_out > 0.02, "{limit} {left_out}");
        }
    }

    #[test]
    fn a_lone_trial_has_no_ceiling_of_its_group() {
        let (lines, groups) = simulated(3, 0.1, 0.1, 1);
        let found = ceilings(&lines, &groups);
        assert_eq!((found.by_group, found.left_out), ([None; 2], [None; 2]));
        assert!(found.at_lines[0].is_some());
    }
}
