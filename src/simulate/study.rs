//! A simulated study: groups of simulated subjects, for the demonstration and the tests.

use super::reference_signals;
use super::subject::{SimulatedSubject, SubjectError};
use crate::num::rng;
use crate::plants::Plant;
use crate::trial::Trial;
use rand::RngExt;
use std::f64::consts::PI;

/// Lines of the disturbance, in periods per minute.
const DISTURBANCE_LINES: [u32; 10] = [5, 8, 11, 17, 23, 31, 41, 53, 67, 89];
/// Amplitude of each, in the unit of the control: together somewhat less than the control that the command asks for.
const DISTURBANCE_AMPLITUDE: f64 = 0.3;

/// A simulated subject with its code in the study.
#[derive(Debug, Clone)]
pub struct Member {
    /// Pseudonym, for example `MP03`.
    pub code: String,
    /// The subject.
    pub subject: SimulatedSubject,
}

/// Subjects who practise on the same plant.
#[derive(Debug, Clone)]
pub struct SimulatedGroup {
    /// Name of the group.
    pub name: &'static str,
    /// The plant of all its subjects.
    pub plant: Plant,
    /// The subjects.
    pub members: Vec<Member>,
}

/// Groups of subjects who all follow one command over a number of trials.
#[derive(Debug, Clone)]
pub struct SimulatedStudy {
    /// Sample time of all trials, s.
    pub sample_time_s: f64,
    /// The command of every trial.
    pub command: Vec<f64>,
    /// The disturbance of every trial, added to the control; none where the command is the only stimulus.
    pub disturbance: Option<Vec<f64>>,
    /// Trials per subject, numbered from 1.
    pub trials: u32,
    /// The groups.
    pub groups: Vec<SimulatedGroup>,
}

impl SimulatedStudy {
    /// Sample time of the study that this one is modelled on (Zhang 2015, section 5.2), s.
    pub const SAMPLE_TIME_S: f64 = 0.02;

    /// Two groups, `minimum_phase` and `nonminimum_phase`, of `subjects` each, with the plants, the command and the
    /// sample time of Zhang 2015, chapter 5. The seed decides who the subjects are and what they do.
    ///
    /// # Errors
    /// [`SubjectError`], which no seed is known to cause.
    pub fn two_groups(subjects: usize, trials: u32, seed: u64) -> Result<Self, SubjectError> {
        let groups = [("minimum_phase", "MP", Plant::MinimumPhase), ("nonminimum_phase", "NP", Plant::NonminimumPhase)];
        let groups = groups.into_iter().map(|(name, prefix, plant)| {
            let members = (1..=subjects).map(|index| {
                let code = format!("{prefix}{index:02}");
                let own_seed = rng::stream(seed, &code).random::<u64>();
                let subject = SimulatedSubject::new(&plant.transfer_function(), Self::SAMPLE_TIME_S, own_seed)?;
                Ok(Member { code, subject })
            });
            Ok(SimulatedGroup { name, plant, members: members.collect::<Result<_, SubjectError>>()? })
        });
        Ok(Self {
            sample_time_s: Self::SAMPLE_TIME_S,
            command: reference_signals::chirp60(Self::SAMPLE_TIME_S),
            disturbance: None,
            trials,
            groups: groups.collect::<Result<_, SubjectError>>()?,
        })
    }

    /// The same people with a second stimulus: a disturbance of the control, ten sines between 0.08 and 1.5 Hz.
    #[must_use]
    pub fn with_disturbance(self) -> Self {
        let sines: Vec<reference_signals::Sine> = DISTURBANCE_LINES
            .iter()
            .enumerate()
            .map(|(i, line)| reference_signals::Sine {
                amplitude: DISTURBANCE_AMPLITUDE,
                omega_rad_s: 2.0 * PI * f64::from(*line) / reference_signals::CHIRP60_DURATION_S,
                // Schroeder's phases keep the peak low.
                phase_rad: -PI * (i * i) as f64 / DISTURBANCE_LINES.len() as f64,
            })
            .collect();
        let duration_s = reference_signals::CHIRP60_DURATION_S;
        let disturbance = reference_signals::sum_of_sines(&sines, self.sample_time_s, duration_s);
        Self { disturbance: Some(disturbance), ..self }
    }

    /// Trial `number` (from 1) of a member.
    ///
    /// # Errors
    /// [`SubjectError`] where the simulation overflows.
    pub fn trial(&self, member: &Member, number: u32) -> Result<Trial, SubjectError> {
        member.subject.trial(number, &self.command, self.disturbance.as_deref())
    }
}
