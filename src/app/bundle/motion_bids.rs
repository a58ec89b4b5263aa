//! A study's recordings as a folder of Motion-BIDS: a table without a header for each trial, its channels and its
//! description beside it.
//!
//! Jeung, S. et al. (2024), *Motion-BIDS: an extension to the brain imaging data structure to organize motion data*,
//! Scientific Data 11, 716. Signals of a control task are no positions of markers: channels have the type MISC, their
//! meaning stands in `description`.

use crate::analysis::ids::{PlantId, StudyId, SubjectId};
use crate::store::{Page, Plant, SignalUnits, Store, Subject, TrialFilter};
use crate::trial::{Channel, Trial};
use anyhow::{Context as _, bail};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

/// The version of BIDS that is written.
const BIDS: &str = "1.9.0";

/// What recorded, in names of files.
const SYSTEM: &str = "volition";

/// Rows fetched at once.
const PAGE: u32 = 500;

/// Letters and digits: what labels of BIDS are made of.
fn label(text: &str) -> String {
    text.chars().filter(char::is_ascii_alphanumeric).collect()
}

/// A label for each subject, no two the same.
fn labels(subjects: &[Subject]) -> BTreeMap<String, String> {
    let mut taken = BTreeSet::new();
    let mut found = BTreeMap::new();
    for (i, subject) in subjects.iter().enumerate() {
        let own = label(&subject.code);
        let mut own = if own.is_empty() { format!("{:03}", i + 1) } else { own };
        while !taken.insert(own.to_lowercase()) {
            own = format!("{own}x{}", i + 1);
        }
        found.insert(subject.id.to_string(), own);
    }
    found
}

async fn subjects_of(store: &Store, study: StudyId) -> anyhow::Result<Vec<Subject>> {
    let mut all: Vec<Subject> = Vec::new();
    loop {
        let page = store.subjects(study, None, Page { after: all.last().map(|own| own.id.0), limit: PAGE }).await?;
        let is_last = page.len() < PAGE as usize;
        all.extend(page);
        if is_last {
            return Ok(all);
        }
    }
}

async fn plants_of(store: &Store, study: StudyId) -> anyhow::Result<BTreeMap<PlantId, Plant>> {
    let mut all: Vec<Plant> = Vec::new();
    loop {
        let page = store.plants(study, Page { after: all.last().map(|own| own.id.0), limit: PAGE }).await?;
        let is_last = page.len() < PAGE as usize;
        all.extend(page);
        if is_last {
            return Ok(all.into_iter().map(|own| (own.id, own)).collect());
        }
    }
}

fn write_to(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    }
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

fn document(value: &Value) -> anyhow::Result<Vec<u8>> {
    let mut text = serde_json::to_vec_pretty(value)?;
    text.push(b'\n');
    Ok(text)
}

/// A cell of a table.
fn cell(text: Option<&str>) -> String {
    let plain = text.map(|text| text.replace(['\t', '\r', '\n'], " "));
    plain.filter(|text| !text.trim().is_empty()).unwrap_or_else(|| "n/a".to_owned())
}

fn channels(trial: &Trial) -> Vec<(Channel, &[f64])> {
    Channel::ALL.into_iter().filter_map(|channel| Some((channel, trial.signals.channel(channel)?))).collect()
}

fn meaning(channel: Channel) -> &'static str {
    match channel {
        Channel::Time => "time of the sample",
        Channel::Command => "command, which the person is to follow",
        Channel::Control => "control, what the person does",
        Channel::Output => "output of the plant",
        Channel::Disturbance => "disturbance at the plant's input",
    }
}

fn table(trial: &Trial) -> String {
    let columns = channels(trial);
    let mut text = String::new();
    for k in 0..trial.samples() {
        for (i, (_, values)) in columns.iter().enumerate() {
            // Writing to memory does not fail.
            let _ = write!(text, "{}{:?}", if i > 0 { "\t" } else { "" }, values[k]);
        }
        text.push('\n');
    }
    text
}

fn list_of_channels(trial: &Trial, units: &SignalUnits) -> String {
    let mut text = String::from("name\tcomponent\ttype\ttracked_point\tunits\tdescription\tsampling_frequency\n");
    for (channel, _) in channels(trial) {
        let (kind, unit) = match channel {
            Channel::Time => ("LATENCY", Some("s")),
            Channel::Command | Channel::Output => ("MISC", units.output.as_deref()),
            Channel::Control | Channel::Disturbance => ("MISC", units.control.as_deref()),
        };
        let rate = 1.0 / trial.sample_time_s;
        let (name, unit, meaning) = (channel.letter(), cell(unit), meaning(channel));
        let _ = writeln!(text, "{name}\tn/a\t{kind}\tn/a\t{unit}\t{meaning}\t{rate}");
    }
    text
}

fn description(plant: &Plant, trial: &Trial, task: &str) -> anyhow::Result<Value> {
    let latency = usize::from(trial.signals.time_s.is_some());
    Ok(json!({
        "TaskName": task,
        // The form of these documents is closed: what was controlled has no member of its own.
        "TaskDescription": format!("control of the plant {}, {}", plant.name, serde_json::to_string(&plant.model)?),
        "SamplingFrequency": 1.0 / trial.sample_time_s,
        "TrackingSystemName": SYSTEM,
        "MotionChannelCount": channels(trial).len(),
        "LATENCYChannelCount": latency,
        "MISCChannelCount": channels(trial).len() - latency,
        "RecordingDuration": trial.sample_time_s * trial.samples() as f64,
        "RecordingType": "continuous",
    }))
}

/// Writes the folder, and says what it holds.
///
/// # Errors
/// Where a recording is damaged, two would have the same name, or a file cannot be written.
pub(super) async fn write(store: &Store, study: StudyId, folder: &Path, task: &str) -> anyhow::Result<String> {
    if task.is_empty() || label(task) != task {
        bail!("the task {task:?} is no label of BIDS: letters and digits");
    }
    let record = store.study(study).await?;
    let subjects = subjects_of(store, study).await?;
    let plants = plants_of(store, study).await?;
    let labels = labels(&subjects);
    let filter = TrialFilter { include_divergent: true, ..TrialFilter::default() };
    let trials = store.matching_trials(study, &filter).await?;
    let with_trials: BTreeSet<SubjectId> = trials.iter().map(|trial| trial.subject).collect();
    write_to(
        &folder.join("dataset_description.json"),
        &document(&json!({
            "Name": record.name,
            "BIDSVersion": BIDS,
            "DatasetType": "raw",
            "GeneratedBy": [{"Name": "Volition", "Version": env!("CARGO_PKG_VERSION")}],
        }))?,
    )?;
    let about = format!(
        "# {}\n\n{}\n\nRecordings of a control task: command r, control u, output y and, where there was one, \
         disturbance d.\nThe model of what was controlled stands in each `_motion.json` under TaskDescription.\n",
        record.name, record.description
    );
    write_to(&folder.join("README.md"), about.as_bytes())?;
    let mut participants = String::from("participant_id\tcode\tgroup\n");
    for subject in subjects.iter().filter(|subject| with_trials.contains(&subject.id)) {
        let own = labels.get(&subject.id.to_string()).map_or("", String::as_str);
        let _ = writeln!(participants, "sub-{own}\t{}\t{}", cell(Some(&subject.code)), cell(subject.group.as_deref()));
    }
    write_to(&folder.join("participants.tsv"), participants.as_bytes())?;
    write_to(
        &folder.join("participants.json"),
        &document(&json!({
            "code": {"Description": "pseudonym in the laboratory's own records"},
            "group": {"Description": "group of the study"},
        }))?,
    )?;
    for own in &trials {
        let subject = labels.get(&own.subject.to_string()).context("a trial's subject is missing")?;
        let plant = plants.get(&own.plant).context("a trial's plant is missing")?;
        let session = own.session.map_or_else(String::new, |session| format!("_ses-{session}"));
        let stem = format!("sub-{subject}{session}_task-{task}_tracksys-{SYSTEM}_run-{}", own.number);
        let mut place = folder.join(format!("sub-{subject}"));
        if let Some(session) = own.session {
            place.push(format!("ses-{session}"));
        }
        let place = place.join("motion");
        let path = place.join(format!("{stem}_motion.tsv"));
        if path.exists() {
            bail!("{} is there already", path.display());
        }
        let trial = store.trial_signals(own.id).await?;
        write_to(&path, table(&trial).as_bytes())?;
        let units = own.units.or(&plant.units);
        write_to(&place.join(format!("{stem}_channels.tsv")), list_of_channels(&trial, &units).as_bytes())?;
        let said = description(plant, &trial, task)?;
        write_to(&place.join(format!("{stem}_motion.json")), &document(&said)?)?;
    }
    let (people, trials) = (with_trials.len(), trials.len());
    Ok(format!(
        "study {:?}: {trials} recordings of {people} subjects as Motion-BIDS in {}",
        record.name,
        folder.display()
    ))
}
