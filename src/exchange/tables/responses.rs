//! Mean controllers over frequency as tables.

use super::{Record, Table};
use crate::learning::StudyFrequencyResponses;
use crate::learning::bode::{ControllerStatistics, GroupResponses, Response, ResponseStatistics};

/// The columns that every row has.
const COLUMNS: &[&str] = &[
    "group",
    "plant",
    "of",
    "subject",
    "part",
    "omega_rad_s",
    "n",
    "gain_db",
    "phase_deg",
    "mean_re",
    "mean_im",
    "sd",
    "mean_gain_db",
    "sd_gain_db",
    "mean_phase_deg",
    "sd_phase_deg",
];

fn begin(group: &GroupResponses, of: &str, subject: Option<&str>, part: &str, omega: f64) -> Record {
    Record::default()
        .with("group", group.group.clone())
        .with("plant", group.plant.name.as_str())
        .with("of", of)
        .with("subject", subject)
        .with("part", part)
        .with("omega_rad_s", omega)
}

/// A column at a frequency.
fn at<T: Copy>(values: &[Option<T>], k: usize) -> Option<T> {
    values.get(k).copied().flatten()
}

fn statistics(rows: &mut Vec<Record>, group: &GroupResponses, of: &str, own: &ControllerStatistics, omega: &[f64]) {
    let parts: [(&str, &ResponseStatistics); 4] = [
        ("feedforward", &own.feedforward),
        ("feedback", &own.feedback),
        ("feedforward_plant", &own.feedforward_plant),
        ("closed_loop", &own.closed_loop),
    ];
    for (part, found) in parts {
        for (k, omega) in omega.iter().enumerate() {
            let mean = at(&found.mean, k);
            rows.push(
                begin(group, of, None, part, *omega)
                    .with("n", found.n.get(k).copied())
                    .with("gain_db", at(&found.gain_of_mean_db, k))
                    .with("phase_deg", at(&found.phase_of_mean_deg, k))
                    .with("mean_re", mean.map(|z| z[0]))
                    .with("mean_im", mean.map(|z| z[1]))
                    .with("sd", at(&found.sd, k))
                    .with("mean_gain_db", at(&found.mean_gain_db, k))
                    .with("sd_gain_db", at(&found.sd_gain_db, k))
                    .with("mean_phase_deg", at(&found.mean_phase_deg, k))
                    .with("sd_phase_deg", at(&found.sd_phase_deg, k)),
            );
        }
    }
}

/// The mean frequency responses of a study's groups: a row for each group, part of the loop and frequency.
///
/// `of` says what a row is of: `mean` (over all subjects), `trimmed_mean`, `subject` (where each one was asked for) or
/// `plant`. Of means, gain and phase are those of the mean response; the mean of gains stands beside.
#[must_use]
pub fn of_study(responses: &StudyFrequencyResponses) -> Table {
    let omega = &responses.omega_rad_s;
    let mut rows = Vec::new();
    for group in &responses.groups {
        statistics(&mut rows, group, "mean", &group.all, omega);
        if let Some(trimmed) = &group.trimmed {
            statistics(&mut rows, group, "trimmed_mean", trimmed, omega);
        }
        let single = |rows: &mut Vec<Record>, of: &str, subject: Option<&str>, part: &str, own: &Response| {
            for (k, omega) in omega.iter().enumerate() {
                let row = begin(group, of, subject, part, *omega);
                rows.push(row.with("gain_db", at(&own.gain_db, k)).with("phase_deg", at(&own.phase_deg, k)));
            }
        };
        for own in group.subjects.iter().flatten() {
            for (part, response) in [
                ("feedforward", &own.feedforward),
                ("feedback", &own.feedback),
                ("feedforward_plant", &own.feedforward_plant),
                ("closed_loop", &own.closed_loop),
            ] {
                single(&mut rows, "subject", Some(&own.code), part, response);
            }
        }
        for (part, response) in [("plant", &group.plant_response), ("inverse_plant", &group.inverse_plant)] {
            if let Some(response) = response {
                single(&mut rows, "plant", None, part, response);
            }
        }
    }
    rows.into_iter().collect::<Table>().beginning_with(COLUMNS)
}
