//! A simulated study in the store, measured and checked like an uploaded one.

use super::tables::Truth;
use crate::analysis::ids::{StudyId, TrialId};
use crate::control::System;
use crate::learning::frequency_domain::{MetricsError, controller_metrics_of};
use crate::learning::time_domain::metrics;
use crate::num::Complex64;
use crate::num::hexadecimal::hexadecimal;
use crate::plants::Plant;
use crate::simulate::SimulatedStudy;
use crate::simulate::study::Member;
use crate::store::{NewPlant, NewStudy, NewSubject, NewTrial, SignalUnits, Store, StudyReading};
use indicatif::ProgressBar;
use serde_json::json;
use std::sync::Arc;

/// The display of Zhang 2015, section 5.4, ends at |y| = 8.
const DISPLAY_LIMIT: f64 = 8.0;

/// A study that was stored.
pub struct Stored {
    /// Its id.
    pub study: StudyId,
    /// Its trials, each with its plant.
    pub trials: Vec<(TrialId, Plant)>,
}

/// Simulates the trials `numbers` of every subject and stores them.
///
/// # Errors
/// When a simulation overflows or the database fails.
pub async fn store_study(
    store: &Store,
    simulated: Arc<SimulatedStudy>,
    numbers: &[u32],
    name: &str,
    bar: &ProgressBar,
) -> anyhow::Result<Stored> {
    let description = "Simulated subjects (volition demo): delayed feedback, a feedforward that approaches the inverse \
                       dynamics over the trials, coloured remnant noise. No human data.";
    let new = NewStudy {
        name: name.to_owned(),
        description: description.to_owned(),
        display_limit: Some(DISPLAY_LIMIT),
        reading: StudyReading::default(),
    };
    let study = store.create_study(new, None).await?.into_inner().id;
    let members: usize = simulated.groups.iter().map(|g| g.members.len()).sum();
    bar.inc_length((members * numbers.len()) as u64);
    let mut trials = Vec::new();
    for group in &simulated.groups {
        let model = System::Continuous(group.plant.transfer_function()).to_model();
        let new = NewPlant { name: group.plant.name().to_owned(), model: model.clone(), units: SignalUnits::default() };
        let plant = store.create_plant(study, new, None).await?.into_inner().id;
        for member in &group.members {
            // Who the subject is: the truth that an identification can be held against.
            let attributes = json!({"simulated": member.subject.parameters()});
            let new = NewSubject { code: member.code.clone(), group: Some(group.name.to_owned()), attributes };
            let subject = store.create_subject(study, new, None).await?.into_inner().id;
            for number in numbers {
                let (simulated, member, number) = (Arc::clone(&simulated), member.clone(), *number);
                let trial = tokio::task::spawn_blocking(move || simulate(&simulated, &member, number)).await??;
                let metrics = metrics(&trial, &model);
                let new = NewTrial {
                    plant,
                    number: i64::from(number),
                    session: None,
                    sha256: hexadecimal(&trial.content_sha256()),
                    max_abs_output: metrics.max_abs_output,
                    metrics: serde_json::to_value(&metrics)?,
                    warnings: Vec::new(),
                    trial,
                };
                let created = store.create_trials(subject, vec![new], None).await?;
                trials.extend(created.into_iter().map(|one| (one.into_inner().id, group.plant)));
                bar.inc(1);
            }
        }
    }
    Ok(Stored { study, trials })
}

/// The norms of the controllers that the simulated subjects really have, delay and preview included, in the trials
/// `numbers`.
///
/// # Errors
/// For a band that makes no sense.
pub fn truth(study: &SimulatedStudy, numbers: &[u32], band_rad_s: (f64, f64)) -> Result<Truth, MetricsError> {
    let one = Complex64::new(1.0, 0.0);
    let mut truth = Truth::new();
    for member in study.groups.iter().flat_map(|g| &g.members) {
        for number in numbers {
            let norms = controller_metrics_of(
                |omega| (member.subject.plant_response(omega), one),
                |omega| member.subject.feedforward_response(*number, omega),
                |omega| member.subject.feedback_response(omega),
                band_rad_s,
            )?;
            truth.insert((member.code.clone(), i64::from(*number)), norms);
        }
    }
    Ok(truth)
}

fn simulate(
    study: &SimulatedStudy,
    member: &Member,
    number: u32,
) -> Result<crate::trial::Trial, crate::simulate::subject::SubjectError> {
    study.trial(member, number)
}
