//! How the database finds what lists ask for.

use super::analyses::{COUNTS, asked_for, of_run, run_counts, run_latest};
use super::error::StoreResult;
use super::estimates::ESTIMATES_OF_TRIALS;
use super::lists::{Filter, Order};
use super::open::Store;
use super::plants::of_study;
use super::queue::{CLAIM, RUNNING, end_of_line};
use super::records::{AnalysisFilter, AnalysisRecord, Plant, RunFilter, Study, Subject, TrialFilter, TrialRecord};
use super::subjects::of_group;
use super::trial_lists::{IN_ORDER, matching, of_subject};
use crate::analysis::ids::{StudyId, SubjectId, TrialId};
use crate::analysis::{Analysis as _, ssid};
use crate::jobs::Status;
use sqlx::AssertSqlSafe;
use uuid::Uuid;

/// Every statement whose cost must not grow with what is stored beside what it asks for.
fn statements() -> Vec<(String, String)> {
    let (study, subject, trial) = (StudyId(Uuid::nil()), SubjectId(Uuid::nil()), TrialId(Uuid::nil()));
    let page_of_analyses = |filter: AnalysisFilter| asked_for(&filter).page::<AnalysisRecord>(Order::CREATED);
    let trials = |filter: TrialFilter| matching(study, &filter).select::<TrialRecord>(&[], IN_ORDER);
    let mut all = vec![
        ("studies".to_owned(), Filter::default().page::<Study>(Order::CREATED)),
        ("plants of a study".to_owned(), of_study(study).page::<Plant>(Order::CREATED)),
        ("subjects of a study".to_owned(), of_group(study, None).page::<Subject>(Order::CREATED)),
        ("subjects of a group".to_owned(), of_group(study, Some("g")).page::<Subject>(Order::CREATED)),
        ("trials of a subject".to_owned(), of_subject(subject).page::<TrialRecord>(Order::CREATED)),
        (
            "trials of a study".to_owned(),
            matching(study, &TrialFilter { include_divergent: true, ..TrialFilter::default() })
                .page::<TrialRecord>(Order::CREATED),
        ),
        ("trials of a study, to be drawn".to_owned(), trials(TrialFilter::default())),
        (
            "trials of a subject, to be drawn".to_owned(),
            trials(TrialFilter { subject: Some(subject), ..TrialFilter::default() }),
        ),
        ("estimates of trials".to_owned(), ESTIMATES_OF_TRIALS.to_owned()),
        ("analyses by status".to_owned(), COUNTS.to_owned()),
        ("the next in the queue".to_owned(), CLAIM.to_owned()),
        ("what is under way".to_owned(), RUNNING.to_owned()),
        ("the end of a line".to_owned(), concat!("SELECT ", end_of_line!("$1", "$2")).to_owned()),
    ];
    for which in 0..16 {
        let asked = |bit: u32| which >> bit & 1 == 1;
        let filter = AnalysisFilter {
            study: asked(0).then_some(study),
            trial: asked(1).then_some(trial),
            kind: asked(2).then_some(ssid::Plan::KIND),
            status: asked(3).then_some(Status::Failed),
        };
        let names = [(0, "study"), (1, "trial"), (2, "kind"), (3, "status")];
        let names: Vec<&str> = names.iter().filter(|(bit, _)| asked(*bit)).map(|(_, name)| *name).collect();
        all.push((format!("analyses by [{}]", names.join(", ")), page_of_analyses(filter)));
    }
    let runs = [
        ("a study", RunFilter::default()),
        ("a kind", RunFilter { kind: Some(ssid::Plan::KIND), spec_sha256: None }),
        ("a spec", RunFilter { kind: Some(ssid::Plan::KIND), spec_sha256: Some("5".repeat(64)) }),
    ];
    for (name, run) in runs {
        let filter = of_run(study, &run);
        all.push((format!("counts of a run of {name}"), run_counts(&filter)));
        all.push((format!("the latest of a run of {name}"), run_latest(&filter)));
    }
    all
}

impl Store {
    /// For each list what it is called, its statement, and the steps by which the database finds its rows.
    ///
    /// # Errors
    /// The database's own.
    pub async fn plans(&self) -> StoreResult<Vec<(String, String, Vec<String>)>> {
        let mut connection = self.readers()?.acquire().await?;
        let mut plans = Vec::new();
        for (name, sql) in statements() {
            let explain = AssertSqlSafe(format!("EXPLAIN QUERY PLAN {sql}"));
            let steps: Vec<(i64, i64, i64, String)> = sqlx::query_as(explain).fetch_all(&mut *connection).await?;
            plans.push((name, sql, steps.into_iter().map(|(.., step)| step).collect()));
        }
        Ok(plans)
    }
}
