//! Mean and standard deviation of identified controllers over the subjects of a group, frequency by frequency.
//!
//! Two descriptions are given, since they answer different questions. The *complex mean* `(1/n) Σ X_i(jω)` is itself
//! the response of a linear controller (the one whose output is the mean of the subjects' outputs), and its deviation
//! `√(Σ|X_i − X̄|²/(n−1))` is the radius of the cloud in the complex plane; subjects who differ in phase make it small.
//! The *mean gain* in dB and *mean phase* describe the typical subject and are what a Bode plot with a shaded band
//! shows (Zhang 2015, figures 3.6c, 5.16 and 5.18). Phases are only defined up to full turns: deviations are taken
//! around the direction in which the subjects' phases cluster and lie within half a turn, so a full turn between two
//! subjects never counts as spread.

use super::curves::CurveOptions;
use super::frequency_domain::fraction;
use super::groups::{Cell, cells};
use super::inputs::{Identification, IdentifiedControllers, PlantName, Remark, SpecChoice, SubjectInput, TrialInput};
use crate::num::stats::{mean, standard_deviation};
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Which trial of each subject is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TrialSelection {
    /// Its first identified one.
    First,
    /// Its last identified one.
    #[default]
    Last,
    /// The one with this number (in any session, the last one).
    Number(i64),
}

/// Responses over subjects at each frequency; every list is as long as `omega_rad_s` of the answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ResponseStatistics {
    /// Subjects with a finite response.
    pub n: Vec<usize>,
    /// The complex mean, `[re, im]`.
    #[schemars(with = "Vec<Option<Vec<f64>>>")]
    pub mean: Vec<Option<[f64; 2]>>,
    /// Deviation in the complex plane; null with fewer than two subjects.
    pub sd: Vec<Option<f64>>,
    /// Gain of the complex mean, dB.
    pub gain_of_mean_db: Vec<Option<f64>>,
    /// Phase of the complex mean, degrees, unwrapped along the frequencies.
    pub phase_of_mean_deg: Vec<Option<f64>>,
    /// Mean of the gains in dB.
    pub mean_gain_db: Vec<Option<f64>>,
    /// Standard deviation of the gains in dB.
    pub sd_gain_db: Vec<Option<f64>>,
    /// Mean of the phases, degrees, unwrapped along the frequencies.
    pub mean_phase_deg: Vec<Option<f64>>,
    /// Standard deviation of the phases, degrees.
    pub sd_phase_deg: Vec<Option<f64>>,
}

/// Gain and phase of one system.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "GainAndPhase")]
pub struct Response {
    /// Gain in dB; null where it is zero or infinite.
    pub gain_db: Vec<Option<f64>>,
    /// Phase in degrees, unwrapped along the frequencies.
    pub phase_deg: Vec<Option<f64>>,
}

/// The responses of one subject in one trial (Zhang 2015, figures 3.6a and 5.13).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SubjectResponses {
    /// The subject's pseudonym.
    pub code: String,
    /// Gff.
    pub feedforward: Response,
    /// Gfb.
    pub feedback: Response,
    /// Gff·G.
    pub feedforward_plant: Response,
    /// The closed loop from command to output, G(Gff + Gfb)/(1 + G Gfb).
    pub closed_loop: Response,
}

/// The four responses of Zhang 2015, figures 5.13 to 5.18, over some subjects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ControllerStatistics {
    /// The subjects, by pseudonym.
    pub subjects: Vec<String>,
    /// Gff.
    pub feedforward: ResponseStatistics,
    /// Gfb.
    pub feedback: ResponseStatistics,
    /// Gff·G.
    pub feedforward_plant: ResponseStatistics,
    /// The closed loop from command to output, G(Gff + Gfb)/(1 + G Gfb).
    pub closed_loop: ResponseStatistics,
}

/// A group on one plant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroupResponses {
    /// The group; null for subjects without one.
    pub group: Option<String>,
    /// The plant.
    pub plant: PlantName,
    /// The spec whose identifications are shown.
    pub spec: Option<SpecChoice>,
    /// The trials used.
    pub trials: Vec<ResponseTrial>,
    /// The inverse dynamics G⁻¹, in the time base of the controllers, to compare with Gff; null where no trial is
    /// identified.
    pub inverse_plant: Option<Response>,
    /// The plant G in the time base of the controllers; null where no trial is identified.
    pub plant_response: Option<Response>,
    /// The responses of each subject by itself, in the order of `trials`; null unless asked for.
    #[serde(default)]
    pub subjects: Option<Vec<SubjectResponses>>,
    /// Over all of the subjects.
    pub all: ControllerStatistics,
    /// Without the subjects with the largest and smallest ‖Gff G − 1‖ (Zhang 2015, figure 5.18); null where too few
    /// subjects have that norm.
    pub trimmed: Option<ControllerStatistics>,
}

/// A trial whose controllers are averaged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ResponseTrial {
    /// The subject's pseudonym.
    pub code: String,
    /// The trial's id.
    pub trial: String,
    /// Its session.
    pub session: Option<i64>,
    /// Its number.
    pub number: i64,
    /// The analysis.
    pub analysis: String,
    /// ‖Gff G − 1‖.
    pub norm_feedforward_plant_minus_one: Option<f64>,
    /// Why the stimuli do not tell its feedback from its feedforward; null where they do.
    #[serde(default)]
    pub feedback_not_told: Option<String>,
}

/// The mean and deviation of a study's identified controllers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StudyFrequencyResponses {
    /// The frequencies, rad/s.
    pub omega_rad_s: Vec<f64>,
    /// Which trial of each subject is shown.
    pub selection: TrialSelection,
    /// Every group on every plant.
    pub groups: Vec<GroupResponses>,
    /// What must be read before using the numbers.
    pub remarks: Vec<Remark>,
}

/// `count` equally spaced frequencies over a band, ends included; just the lower end for one.
#[must_use]
pub fn frequency_grid(band_rad_s: (f64, f64), count: usize) -> Vec<f64> {
    let (from, to) = band_rad_s;
    let step = if count > 1 { (to - from) / (count - 1) as f64 } else { 0.0 };
    (0..count).map(|i| from + step * i as f64).collect()
}

/// The band over which the chosen identifications were made, the widest of them; `None` where none says so.
#[must_use]
pub fn identified_band(subjects: &[SubjectInput]) -> Option<(f64, f64)> {
    let trials = subjects.iter().flat_map(|s| &s.trials);
    let bands = trials.flat_map(|t| &t.identifications).filter_map(|i| i.metrics.as_ref()).map(|m| m.band_rad_s);
    bands.fold(None, |wide, [from, to]| match wide {
        None => Some((from, to)),
        Some((a, b)) => Some((a.min(from), b.max(to))),
    })
}

/// The mean and deviation of the controllers of a study's subjects at the frequencies `omega_rad_s` (rad/s,
/// increasing), with the responses of `each_subject` where they are asked for.
#[must_use]
pub fn study_frequency_responses(
    subjects: &[SubjectInput],
    selection: TrialSelection,
    omega_rad_s: &[f64],
    options: &CurveOptions,
    each_subject: bool,
) -> StudyFrequencyResponses {
    let (cells, mut remarks) = cells(subjects, options);
    let mut groups: Vec<GroupResponses> =
        cells.iter().map(|cell| group_responses(cell, selection, omega_rad_s, options, &mut remarks)).collect();
    if !each_subject {
        groups.iter_mut().for_each(|group| group.subjects = None);
    }
    for group in &groups {
        remarks.extend(group.spec.iter().filter_map(SpecChoice::remark));
    }
    StudyFrequencyResponses { omega_rad_s: omega_rad_s.to_vec(), selection, groups, remarks }
}

struct Chosen<'a> {
    code: &'a str,
    trial: &'a TrialInput,
    found: &'a Identification,
    controllers: &'a IdentifiedControllers,
}

fn group_responses(
    cell: &Cell,
    selection: TrialSelection,
    omega: &[f64],
    options: &CurveOptions,
    remarks: &mut Vec<Remark>,
) -> GroupResponses {
    let mut chosen = Vec::new();
    let mut without = Vec::new();
    for (subject, trials) in &cell.subjects {
        match choose_trial(trials, cell.spec.as_ref(), selection, options) {
            Some((trial, found, controllers)) => {
                chosen.push(Chosen { code: &subject.code, trial, found, controllers });
            }
            None => without.push(subject.code.as_str()),
        }
    }
    let who = format!("{} on {}", cell.group.as_deref().unwrap_or("subjects without a group"), cell.plant.name);
    if !without.is_empty() {
        let codes = without.join(", ");
        remarks
            .push(Remark::new("subjects_without_response", format!("{who}: no identified trial to show of {codes}")));
    }
    if let Some(first) = chosen.first().map(|c| c.controllers) {
        // One spec on one plant gives one time base; should that ever fail, an average would be meaningless.
        let before = chosen.len();
        chosen.retain(|c| c.controllers.plant == first.plant);
        if chosen.len() < before {
            let dropped = before - chosen.len();
            remarks.push(Remark::new(
                "plants_differ_in_reports",
                format!(
                    "{who}: {dropped} subjects were identified with another model of the plant and are not averaged"
                ),
            ));
        }
    }
    let trials = chosen
        .iter()
        .map(|c| ResponseTrial {
            code: c.code.to_owned(),
            trial: c.trial.trial.clone(),
            session: c.trial.session,
            number: c.trial.number,
            analysis: c.found.analysis.clone(),
            norm_feedforward_plant_minus_one: distance(c),
            feedback_not_told: c.found.evidence.feedback_not_told.clone(),
        })
        .collect();
    let plant = chosen.first().map(|c| &c.controllers.plant);
    let inverse_plant = plant.map(|plant| response_at(omega, |w| inverse(fraction(plant, w))));
    let plant_response = plant.map(|plant| response_at(omega, |w| quotient(fraction(plant, w))));
    let subjects = chosen.iter().map(|c| subject_responses(c.code, c.controllers, omega)).collect();
    let all = controller_statistics(&chosen.iter().collect::<Vec<_>>(), omega);
    let trimmed = without_extremes(&chosen, options.trim).map(|kept| controller_statistics(&kept, omega));
    GroupResponses {
        group: cell.group.clone(),
        plant: cell.plant.clone(),
        spec: cell.spec.clone(),
        trials,
        inverse_plant,
        plant_response,
        subjects: Some(subjects),
        all,
        trimmed,
    }
}

/// Trials come ordered by session and number.
fn choose_trial<'a>(
    trials: &[&'a TrialInput],
    spec: Option<&SpecChoice>,
    selection: TrialSelection,
    options: &CurveOptions,
) -> Option<(&'a TrialInput, &'a Identification, &'a IdentifiedControllers)> {
    let spec = &spec?.spec_sha256;
    let shown = trials.iter().filter(|t| options.include_divergent || !t.divergent);
    let mut identified = shown.filter_map(|t| {
        let found = t.identified_with(spec)?;
        Some((*t, found, found.controllers.as_ref()?))
    });
    match selection {
        TrialSelection::First => identified.next(),
        TrialSelection::Last => identified.next_back(),
        TrialSelection::Number(number) => identified.rfind(|(t, ..)| t.number == number),
    }
}

fn distance(chosen: &Chosen) -> Option<f64> {
    chosen.found.metrics.as_ref()?.norm_feedforward_plant_minus_one
}

/// The subjects without those with the `trim` largest and smallest ‖Gff G − 1‖, in their own order.
fn without_extremes<'a, 'b>(chosen: &'b [Chosen<'a>], trim: usize) -> Option<Vec<&'b Chosen<'a>>> {
    let mut ranked: Vec<(usize, f64)> =
        chosen.iter().enumerate().filter_map(|(i, c)| Some((i, distance(c)?))).collect();
    ranked.sort_by(|a, b| a.1.total_cmp(&b.1));
    let kept = ranked.get(trim..ranked.len().saturating_sub(trim))?;
    if trim == 0 || kept.is_empty() {
        return None;
    }
    let mut kept: Vec<usize> = kept.iter().map(|k| k.0).collect();
    kept.sort_unstable();
    Some(kept.into_iter().map(|i| &chosen[i]).collect())
}

fn controller_statistics(chosen: &[&Chosen], omega: &[f64]) -> ControllerStatistics {
    let over = |response: fn(&IdentifiedControllers, f64) -> Complex64| {
        let at = |w: &f64| chosen.iter().map(|c| response(c.controllers, *w)).collect::<Vec<_>>();
        response_statistics(&omega.iter().map(at).collect::<Vec<_>>())
    };
    ControllerStatistics {
        subjects: chosen.iter().map(|c| c.code.to_owned()).collect(),
        feedforward: over(feedforward),
        feedback: over(feedback),
        feedforward_plant: over(feedforward_plant),
        closed_loop: over(closed_loop),
    }
}

fn feedforward(found: &IdentifiedControllers, omega: f64) -> Complex64 {
    quotient(fraction(&found.feedforward, omega))
}

fn feedback(found: &IdentifiedControllers, omega: f64) -> Complex64 {
    quotient(fraction(&found.feedback, omega))
}

fn feedforward_plant(found: &IdentifiedControllers, omega: f64) -> Complex64 {
    feedforward(found, omega) * quotient(fraction(&found.plant, omega))
}

fn quotient((num, den): (Complex64, Complex64)) -> Complex64 {
    num / den
}

/// G(Gff + Gfb)/(1 + G Gfb) over common denominators, which stays finite at the plant's poles.
fn closed_loop(found: &IdentifiedControllers, omega: f64) -> Complex64 {
    let (n, d) = fraction(&found.plant, omega);
    let (nff, dff) = fraction(&found.feedforward, omega);
    let (nfb, dfb) = fraction(&found.feedback, omega);
    n * (nff * dfb + nfb * dff) / (dff * (d * dfb + n * nfb))
}

/// The responses of a subject's controllers and of its loop at some frequencies, rad/s.
#[must_use]
pub fn subject_responses(code: &str, found: &IdentifiedControllers, omega: &[f64]) -> SubjectResponses {
    let of = |response: fn(&IdentifiedControllers, f64) -> Complex64| response_at(omega, |w| response(found, w));
    SubjectResponses {
        code: code.to_owned(),
        feedforward: of(feedforward),
        feedback: of(feedback),
        feedforward_plant: of(feedforward_plant),
        closed_loop: of(closed_loop),
    }
}

fn inverse((num, den): (Complex64, Complex64)) -> Complex64 {
    den / num
}

fn response_at(omega: &[f64], of: impl Fn(f64) -> Complex64) -> Response {
    let values: Vec<Option<Complex64>> = omega.iter().map(|w| Some(of(*w)).filter(|x| x.is_finite())).collect();
    Response {
        gain_db: values.iter().map(|x| (*x).and_then(decibels)).collect(),
        phase_deg: unwrapped(&values.iter().map(|x| x.map(|x| x.arg())).collect::<Vec<_>>()),
    }
}

fn decibels(x: Complex64) -> Option<f64> {
    Some(20.0 * x.norm().log10()).filter(|db| db.is_finite())
}

/// Statistics over subjects of responses `[frequency][subject]`; values that are not finite are left out.
#[must_use]
pub fn response_statistics(responses: &[Vec<Complex64>]) -> ResponseStatistics {
    let mut s = ResponseStatistics {
        n: Vec::new(),
        mean: Vec::new(),
        sd: Vec::new(),
        gain_of_mean_db: Vec::new(),
        phase_of_mean_deg: Vec::new(),
        mean_gain_db: Vec::new(),
        sd_gain_db: Vec::new(),
        mean_phase_deg: Vec::new(),
        sd_phase_deg: Vec::new(),
    };
    let mut phases_of_mean = Vec::new();
    let mut mean_phases = Vec::new();
    for at in responses {
        let finite: Vec<Complex64> = at.iter().copied().filter(|x| x.is_finite()).collect();
        let n = finite.len();
        let centre = (n > 0).then(|| finite.iter().sum::<Complex64>() / n as f64);
        let spread = centre
            .filter(|_| n > 1)
            .map(|c| (finite.iter().map(|x| (x - c).norm_sqr()).sum::<f64>() / (n - 1) as f64).sqrt());
        // A response that is zero has neither a gain in dB nor a phase.
        let gains: Vec<f64> = finite.iter().filter_map(|x| decibels(*x)).collect();
        let phases: Vec<f64> = finite.iter().filter(|x| x.norm() > 0.0).map(|x| x.arg()).collect();
        let (phase, phase_sd) = phase_statistics(&phases);
        s.n.push(n);
        s.mean.push(centre.map(|c| [c.re, c.im]));
        s.sd.push(spread);
        s.gain_of_mean_db.push(centre.and_then(decibels));
        phases_of_mean.push(centre.filter(|c| c.norm() > 0.0).map(|c| c.arg()));
        s.mean_gain_db.push(mean(&gains));
        s.sd_gain_db.push(standard_deviation(&gains));
        mean_phases.push(phase);
        s.sd_phase_deg.push(phase_sd.map(f64::to_degrees));
    }
    s.phase_of_mean_deg = unwrapped(&phases_of_mean);
    s.mean_phase_deg = unwrapped(&mean_phases);
    s
}

/// Mean and standard deviation of angles (rad), as deviations within half a turn of the direction of the summed unit
/// vectors; none of angles that cancel each other.
fn phase_statistics(phases: &[f64]) -> (Option<f64>, Option<f64>) {
    let resultant: Complex64 = phases.iter().map(|p| Complex64::from_polar(1.0, *p)).sum();
    if phases.is_empty() || resultant.norm() < 1e-9 * phases.len() as f64 {
        return (None, None);
    }
    let direction = resultant.arg();
    let deviations: Vec<f64> = phases.iter().map(|p| wrapped(p - direction)).collect();
    (mean(&deviations).map(|d| direction + d), standard_deviation(&deviations))
}

/// Into (−π, π].
fn wrapped(angle: f64) -> f64 {
    angle - 2.0 * PI * (angle / (2.0 * PI) - 0.5).ceil()
}

/// Degrees, with full turns added so that neighbours differ by at most half a turn; the first value lies in (−180,
/// 180].
fn unwrapped(radians: &[Option<f64>]) -> Vec<Option<f64>> {
    let mut last: Option<f64> = None;
    radians
        .iter()
        .map(|phase| {
            let continued = (*phase)?;
            let continued = match last {
                None => wrapped(continued),
                Some(last) => last + wrapped(continued - last),
            };
            last = Some(continued);
            Some(continued.to_degrees())
        })
        .collect()
}
