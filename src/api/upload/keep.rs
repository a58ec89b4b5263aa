//! Reading, measuring and storing what was uploaded.

use super::assign::Wanted;
use super::files::{Budget, File};
use crate::analysis::{Code, Problem, Warning};
use crate::api::doubts::doubts;
use crate::api::problem::{ApiError, ApiResult, internal};
use crate::api::state::{AppState, Limits};
use crate::exchange::{Options, Reading, Understood};
use crate::learning::time_domain;
use crate::num::hexadecimal::hexadecimal;
use crate::store::{Created, IdempotencyKey, NewTrial, Plant, StoreError, Subject, TrialFilter, TrialRecord};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// How often numbers are chosen anew when another process takes them at the same time.
const NUMBERING_ATTEMPTS: usize = 5;

/// Plant and trial may give their sample times rounded differently; beyond this share they differ.
const SAMPLE_TIME_TOLERANCE: f64 = 1e-5;

/// What is said of a file besides its recording.
pub(super) struct Said {
    pub(crate) name: Option<String>,
    pub(crate) ignored_columns: Vec<String>,
    pub(crate) understood: Understood,
    pub(crate) warnings: Vec<Warning>,
}

/// Reads and measures a file recorded on `plant`; its number is 0 for now where it has none.
pub(super) fn parse(
    file: &File,
    budget: &mut Budget,
    options: &Options,
    plant: &Plant,
    [number, session]: [Option<i64>; 2],
) -> Result<(NewTrial, Said), Problem> {
    let Reading { trial, understood, ignored_columns, warnings: done, .. } = file.read(budget, options)?;
    let measured = time_domain::metrics(&trial, &plant.model);
    let metrics = serde_json::to_value(&measured).map_err(|error| {
        tracing::error!(%error, "metrics could not be written");
        internal()
    })?;
    let mut warnings = Vec::new();
    if let Some(period) = plant.model.sample_time_s()
        && (period - trial.sample_time_s).abs() > SAMPLE_TIME_TOLERANCE * period
    {
        warnings.push(Warning::new(
            "sample_time_differs",
            format!(
                "the trial's sample time is {} s, that of its plant '{}' is {period} s",
                trial.sample_time_s, plant.name
            ),
        ));
    }
    let mut own = done;
    own.extend(doubts(&trial, &plant.model));
    warnings.extend(own.iter().cloned());
    let new = NewTrial {
        plant: plant.id,
        number: number.unwrap_or(0),
        session,
        sha256: hexadecimal(&trial.content_sha256()),
        max_abs_output: measured.max_abs_output,
        metrics,
        warnings: own,
        trial,
    };
    Ok((new, Said { name: file.name.clone(), ignored_columns, understood, warnings }))
}

/// Reads and measures the files; a number that is left to the server is 0 for now.
pub(super) fn parse_all(
    files: Vec<File>,
    wanted: &[(Wanted, Arc<Plant>)],
    limits: &Limits,
    options: &Options,
) -> Result<(Vec<NewTrial>, Vec<Said>), Problem> {
    let mut budget = Budget::new(limits);
    let parsed = files
        .into_iter()
        .zip(wanted)
        .map(|(file, (wanted, plant))| parse(&file, &mut budget, options, plant, [wanted.number, wanted.session]));
    let parsed: Vec<(NewTrial, Said)> = parsed.collect::<Result<_, _>>()?;
    Ok(parsed.into_iter().unzip())
}

/// Stores the trials; where numbers were left to the server and another process took them meanwhile, with others.
pub(super) async fn store(
    state: &AppState,
    subject: &Subject,
    wanted: &[Wanted],
    mut new: Vec<NewTrial>,
    key: Option<&IdempotencyKey>,
) -> ApiResult<(Vec<i64>, Vec<Created<TrialRecord>>)> {
    let assigned = wanted.iter().any(|w| w.number.is_none());
    let _alone = if assigned { Some(state.numbering.lock().await) } else { None };
    for attempt in 1.. {
        let numbers = numbers(state, subject, wanted, &new).await?;
        for (new, number) in new.iter_mut().zip(&numbers) {
            new.number = *number;
        }
        let last = !assigned || attempt == NUMBERING_ATTEMPTS;
        // Recordings are large; they are only copied where they may be needed again.
        let these = if last { std::mem::take(&mut new) } else { new.clone() };
        match state.store.create_trials(subject.id, these, key).await {
            Ok(outcome) => return Ok((numbers, outcome)),
            Err(StoreError::Conflict { rule: "trial_number_taken", .. }) if !last => {}
            Err(StoreError::Conflict { rule: rule @ "trial_number_taken", detail }) => {
                let problem = Problem::new(Code::Conflict, rule.replace('_', " "), detail)
                    .at("query parameter number")
                    .mend("Give another number or session, or none for the next free one.");
                return Err(problem.into());
            }
            Err(error) => return Err(error.into()),
        }
    }
    Err(ApiError::from(internal()))
}

/// The numbers asked for; for the others the next free ones of the session, leaving out content that is stored already.
async fn numbers(state: &AppState, subject: &Subject, wanted: &[Wanted], new: &[NewTrial]) -> ApiResult<Vec<i64>> {
    let mut stored = Vec::new();
    if wanted.iter().any(|w| w.number.is_none()) {
        let filter = TrialFilter { subject: Some(subject.id), include_divergent: true, ..TrialFilter::default() };
        stored = state.store.matching_trials(subject.study, &filter).await?;
    }
    let mut known: BTreeSet<&str> = stored.iter().map(|trial| trial.sha256.as_str()).collect();
    let mut last: BTreeMap<Option<i64>, i64> = BTreeMap::new();
    let taken = stored.iter().map(|trial| (trial.session, trial.number));
    let asked = wanted.iter().filter_map(|w| Some((w.session, w.number?)));
    for (session, number) in taken.chain(asked) {
        let last = last.entry(session).or_insert(0);
        *last = number.max(*last);
    }
    let mut numbers = Vec::with_capacity(wanted.len());
    for (wanted, new) in wanted.iter().zip(new) {
        let is_new = known.insert(&new.sha256);
        numbers.push(match wanted.number {
            Some(number) => number,
            None => {
                let last = last.entry(wanted.session).or_insert(0);
                *last += i64::from(is_new);
                (*last).max(1)
            }
        });
    }
    Ok(numbers)
}

/// What a scientist must know about a trial that was just stored, or not.
pub(super) async fn remarks(
    state: &AppState,
    subject: &Subject,
    made: &Created<TrialRecord>,
    record: &TrialRecord,
    wanted: &Wanted,
    number: i64,
) -> ApiResult<Vec<Warning>> {
    let mut warnings = Vec::new();
    if matches!(made, Created::Duplicate(_)) {
        let mut message = format!("this recording is stored already as trial {}", record.number);
        if let Some(session) = record.session {
            message.push_str(&format!(" of session {session}"));
        }
        if wanted.number.is_some_and(|_| number != record.number)
            || (wanted.session.is_some() && wanted.session != record.session)
            || wanted.plant != record.plant
        {
            message.push_str("; the number, session or plant given now differ from it and were not used");
        }
        warnings.push(Warning::new("duplicate_content", message));
    } else if wanted.number.is_none() {
        warnings.push(Warning::new(
            "number_assigned",
            format!("no number was given; the next free one, {}, was taken", record.number),
        ));
    }
    let others = state.store.same_content(subject.study, &record.sha256, subject.id).await?;
    if !others.is_empty() {
        let named: Vec<String> =
            others.iter().take(5).map(|trial| format!("{} of subject {}", trial.id, trial.subject)).collect();
        warnings.push(Warning::new(
            "content_of_another_subject",
            format!("the same recording is stored for other subjects too: trial {}", named.join(", trial ")),
        ));
    }
    if record.divergent {
        warnings.push(Warning::new(
            "divergent",
            format!(
                "|y| reaches {}, beyond the study's display limit: the trial is kept, and left out of learning curves",
                record.max_abs_output
            ),
        ));
    }
    Ok(warnings)
}
