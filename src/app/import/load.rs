//! From the rows of an index into the store, file by file.

use super::index::{Index, Refused, Row};
use super::plant_text;
use crate::analysis::Warning;
use crate::analysis::ids::{PlantId, StudyId, SubjectId};
use crate::app::recordings;
use crate::control::Model;
use crate::exchange::tables::study::TRIAL_COLUMNS;
use crate::exchange::{Options, Reading};
use crate::learning::recording::doubts;
use crate::learning::time_domain::{TimeDomainMetrics, metrics};
use crate::num::hexadecimal::hexadecimal;
use crate::plants::catalogue;
use crate::store::{
    Created, NewPlant, NewStudy, NewSubject, NewTrial, Page, Plant, SignalUnits, Store, StoreError, Study,
    StudyReading, Subject, SubjectPatch,
};
use anyhow::{Context as _, bail};
use indicatif::ProgressBar;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

const PAGE: u32 = 500;

/// A file that is written into the store.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Files stored now.
    pub imported: usize,
    /// Files whose content was stored before.
    pub already_there: usize,
    /// Files stored now that are divergent.
    pub divergent: usize,
    /// Files that were not stored, and why.
    pub refused: Vec<Refused>,
    /// What should be looked at: equal content under other names, columns of files that are no signals.
    pub notes: BTreeSet<String>,
    /// Trials stored now or before, per plant.
    pub per_plant: BTreeMap<String, usize>,
    /// Subjects met.
    pub subjects: BTreeSet<String>,
}

/// Plants that the caller names.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PlantOptions {
    /// By the text that stands in the index.
    pub named: BTreeMap<String, Model>,
    /// For rows without a plant.
    pub default: Option<(String, Model)>,
}

/// Why one file is refused, or why nothing more can be done.
enum Stop {
    File(String),
    All(anyhow::Error),
}

impl From<StoreError> for Stop {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::Conflict { detail, .. } => Self::File(detail),
            other => Self::All(other.into()),
        }
    }
}

/// The study with this name, made if there is none.
///
/// # Errors
/// Where several studies have that name, or the existing one has another display limit.
pub async fn find_or_create_study(store: &Store, name: &str, display_limit: Option<f64>) -> anyhow::Result<Study> {
    let mut found = Vec::new();
    let mut page = Page { after: None, limit: PAGE };
    loop {
        let studies = store.studies(page).await?;
        page.after = studies.last().map(|s| s.id.0);
        let last = studies.len() < PAGE as usize;
        found.extend(studies.into_iter().filter(|s| s.name == name));
        if last {
            break;
        }
    }
    if found.len() > 1 {
        bail!("{} studies are named {name:?}; rename all but one", found.len());
    }
    let Some(study) = found.pop() else {
        let new = NewStudy {
            name: name.to_owned(),
            description: String::new(),
            display_limit,
            reading: StudyReading::default(),
        };
        return Ok(store.create_study(new, None).await?.into_inner());
    };
    match display_limit {
        Some(limit) if study.display_limit != Some(limit) => bail!(
            "the study {name:?} has the display limit {:?}, and {limit} is asked for; change the study or leave the \
             limit out",
            study.display_limit
        ),
        _ => Ok(study),
    }
}

/// The display limit that all rows agree on, where they give one.
///
/// # Errors
/// Where they disagree.
pub fn common_display_limit(index: &Index) -> anyhow::Result<Option<f64>> {
    let mut limits: Vec<f64> = index.rows.iter().flatten().filter_map(|r| r.display_limit).collect();
    limits.sort_by(f64::total_cmp);
    limits.dedup();
    match limits.as_slice() {
        [] => Ok(None),
        [one] => Ok(Some(*one)),
        several => bail!("the index gives several display limits ({several:?}); choose with --display-limit"),
    }
}

/// Stores every file of the index, each of them whole or not at all.
///
/// # Errors
/// When the database fails. Files stored before stay, and importing again recognises them.
pub async fn load(
    store: &Store,
    study: &Study,
    folder: &Path,
    index: &Index,
    plants: &PlantOptions,
    reading: &Options,
    bar: &ProgressBar,
) -> anyhow::Result<Outcome> {
    let mut loader = Loader::open(store, study, folder, plants, reading).await?;
    bar.set_length(index.rows.len() as u64);
    for row in &index.rows {
        match row {
            Err(refused) => loader.outcome.refused.push(refused.clone()),
            Ok(row) => match loader.one(row).await {
                Ok(()) => {}
                Err(Stop::File(reason)) => {
                    loader.outcome.refused.push(Refused { file: row.file.clone(), reason });
                }
                Err(Stop::All(error)) => return Err(error.context(format!("while importing {}", row.file))),
            },
        }
        bar.inc(1);
    }
    loader.keep_extras().await?;
    Ok(loader.outcome)
}

struct Loader<'a> {
    store: &'a Store,
    study: &'a Study,
    folder: &'a Path,
    options: &'a PlantOptions,
    reading: &'a Options,
    plants: BTreeMap<String, Plant>,
    subjects: BTreeMap<String, Subject>,
    /// Per subject: the other columns of its trials.
    extras: BTreeMap<String, Map<String, Value>>,
    outcome: Outcome,
}

impl<'a> Loader<'a> {
    async fn open(
        store: &'a Store,
        study: &'a Study,
        folder: &'a Path,
        options: &'a PlantOptions,
        reading: &'a Options,
    ) -> anyhow::Result<Self> {
        let plants = all_plants(store, study.id).await?;
        let subjects = all_subjects(store, study.id).await?;
        Ok(Self {
            store,
            study,
            folder,
            options,
            reading,
            plants: plants.into_iter().map(|p| (p.name.clone(), p)).collect(),
            subjects: subjects.into_iter().map(|s| (s.code.clone(), s)).collect(),
            extras: BTreeMap::new(),
            outcome: Outcome::default(),
        })
    }

    async fn one(&mut self, row: &Row) -> Result<(), Stop> {
        let (plant_name, model) = resolve_plant(row, self.options).map_err(Stop::File)?;
        model.shape().map_err(|e| Stop::File(format!("the plant {plant_name:?} cannot be used: {e}")))?;
        if let Some(subject) = self.subjects.get(&row.subject).filter(|s| row.group.is_some() && s.group != row.group) {
            return Err(Stop::File(format!(
                "subject {} is in the group {:?}, and the index says {:?}",
                row.subject, subject.group, row.group
            )));
        }
        let path = inside(self.folder, &row.file).map_err(Stop::File)?;
        let measured = {
            let (model, options) = (model.clone(), self.reading.clone());
            tokio::task::spawn_blocking(move || measure(&path, &model, &options))
                .await
                .map_err(|e| Stop::All(e.into()))?
        };
        let (read, metrics, warnings) = measured.map_err(Stop::File)?;
        let plant = self.plant(&plant_name, model).await?;
        let subject = self.subject(row).await?;
        let sha256 = hexadecimal(&read.trial.content_sha256());
        let max_abs_output = metrics.max_abs_output;
        for warning in &warnings {
            self.outcome.notes.insert(format!("{}: {} ({})", row.file, warning.message, warning.code));
        }
        let new = NewTrial {
            plant,
            number: row.number,
            session: row.session,
            trial: read.trial,
            sha256: sha256.clone(),
            max_abs_output,
            metrics: serde_json::to_value(&metrics).map_err(|e| Stop::All(e.into()))?,
            warnings,
        };
        let created = self.store.create_trials(subject, vec![new], None).await?;
        for one in created {
            match one {
                Created::New(_) => {
                    self.outcome.imported += 1;
                    let limit = self.study.display_limit;
                    self.outcome.divergent += usize::from(limit.is_some_and(|limit| max_abs_output > limit));
                    for other in self.store.same_content(self.study.id, &sha256, subject).await? {
                        let whose = self.subjects.values().find(|s| s.id == other.subject).map_or("?", |s| &s.code);
                        let number = other.number;
                        self.outcome.notes.insert(format!("{} equals trial {number} of subject {whose}", row.file));
                    }
                }
                Created::Duplicate(there) | Created::Replayed(there) => {
                    if there.plant != plant {
                        return Err(Stop::File(format!(
                            "its content is stored already, as trial {} on another plant",
                            there.number
                        )));
                    }
                    self.outcome.already_there += 1;
                    if (there.number, there.session) != (row.number, row.session) {
                        let number = there.number;
                        self.outcome.notes.insert(format!("{} is stored already, as trial {number}", row.file));
                        return Ok(());
                    }
                }
            }
        }
        for column in read.ignored_columns {
            self.outcome.notes.insert(format!("the column {column:?} of trial files is no signal and was left out"));
        }
        *self.outcome.per_plant.entry(plant_name).or_default() += 1;
        self.outcome.subjects.insert(row.subject.clone());
        if !row.extras.is_empty() {
            let key = row.session.map_or_else(|| row.number.to_string(), |s| format!("{s}/{}", row.number));
            let of_subject = self.extras.entry(row.subject.clone()).or_default();
            of_subject.insert(key, Value::Object(row.extras.clone()));
        }
        Ok(())
    }

    async fn plant(&mut self, name: &str, model: Model) -> Result<PlantId, Stop> {
        if let Some(plant) = self.plants.get(name) {
            if plant.model != model {
                return Err(Stop::File(format!("the study's plant {name:?} has another model than this file's")));
            }
            return Ok(plant.id);
        }
        let new = NewPlant { name: name.to_owned(), model, units: SignalUnits::default() };
        let plant = self.store.create_plant(self.study.id, new, None).await?.into_inner();
        let id = plant.id;
        self.plants.insert(name.to_owned(), plant);
        Ok(id)
    }

    async fn subject(&mut self, row: &Row) -> Result<SubjectId, Stop> {
        if let Some(subject) = self.subjects.get(&row.subject) {
            return Ok(subject.id);
        }
        let attributes = Value::Object(Map::new());
        let new = NewSubject { code: row.subject.clone(), group: row.group.clone(), attributes };
        let subject = self.store.create_subject(self.study.id, new, None).await?.into_inner();
        let id = subject.id;
        self.subjects.insert(row.subject.clone(), subject);
        Ok(id)
    }

    /// Writes the other columns into the subjects' attributes, beside what stands there; not at all where nothing
    /// changes.
    async fn keep_extras(&mut self) -> anyhow::Result<()> {
        for (code, extras) in std::mem::take(&mut self.extras) {
            let Some(subject) = self.subjects.get(&code) else { continue };
            let mut attributes = subject.attributes.as_object().cloned().unwrap_or_default();
            let mut columns = attributes.get(TRIAL_COLUMNS).and_then(Value::as_object).cloned().unwrap_or_default();
            columns.extend(extras);
            attributes.insert(TRIAL_COLUMNS.to_owned(), Value::Object(columns));
            let attributes = Value::Object(attributes);
            if attributes != subject.attributes {
                let patch = SubjectPatch { attributes: Some(attributes), ..SubjectPatch::default() };
                // Whoever changed the subject meanwhile must not lose what was written.
                self.store
                    .change::<Subject>(subject.id, patch, Some(subject.version))
                    .await
                    .with_context(|| format!("the trials are stored, but not the other columns of subject {code}"))?;
            }
        }
        Ok(())
    }
}

async fn all_plants(store: &Store, study: StudyId) -> anyhow::Result<Vec<Plant>> {
    let mut all: Vec<Plant> = Vec::new();
    loop {
        let page = store.plants(study, Page { after: all.last().map(|p| p.id.0), limit: PAGE }).await?;
        let last = page.len() < PAGE as usize;
        all.extend(page);
        if last {
            return Ok(all);
        }
    }
}

async fn all_subjects(store: &Store, study: StudyId) -> anyhow::Result<Vec<Subject>> {
    let mut all: Vec<Subject> = Vec::new();
    loop {
        let page = store.subjects(study, None, Page { after: all.last().map(|s| s.id.0), limit: PAGE }).await?;
        let last = page.len() < PAGE as usize;
        all.extend(page);
        if last {
            return Ok(all);
        }
    }
}

/// A file of the index that lies in the folder; an index from elsewhere must not reach out of it.
fn inside(folder: &Path, file: &str) -> Result<PathBuf, String> {
    let relative = Path::new(file);
    if relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir)) {
        Ok(folder.join(relative))
    } else {
        Err("the path leads out of the folder".to_owned())
    }
}

type Measured = (Reading, TimeDomainMetrics, Vec<Warning>);

fn measure(path: &Path, model: &Model, options: &Options) -> Result<Measured, String> {
    let mut read = recordings::read(path, options).map_err(|problem| problem.to_string())?;
    let metrics = metrics(&read.trial, model);
    let mut warnings = std::mem::take(&mut read.warnings);
    let doubts = doubts(&read.trial, Some(model));
    warnings.extend(doubts.into_iter().map(|doubt| Warning::new(doubt.code, doubt.message)));
    Ok((read, metrics, warnings))
}

fn resolve_plant(row: &Row, options: &PlantOptions) -> Result<(String, Model), String> {
    if let Some(text) = &row.plant
        && let Some(model) = options.named.get(text)
    {
        return Ok((text.clone(), model.clone()));
    }
    if let Some(model) = &row.model {
        let known = catalogue::Plant::ALL.into_iter().find(|p| {
            let g = p.transfer_function();
            model.sample_time_s.is_none() && g.num().coefficients() == model.num && g.den().coefficients() == model.den
        });
        let described = || known.map_or_else(|| plant_text::write(model), |p| p.name().to_owned());
        return Ok((row.plant.clone().unwrap_or_else(described), Model::TransferFunction(model.clone())));
    }
    match (&row.plant, &options.default) {
        (Some(text), _) => match named_model(text) {
            Ok(model) => Ok((text.clone(), model)),
            Err(why) => Err(format!("{why}; give its model with --plant '{text}=MODEL'")),
        },
        (None, Some((name, model))) => Ok((name.clone(), model.clone())),
        (None, None) => Err("the index names no plant; give one with --plant MODEL".to_owned()),
    }
}

/// The model that a catalogue name or a transfer function in `s` stands for.
///
/// # Errors
/// Why it is neither.
pub fn named_model(text: &str) -> Result<Model, String> {
    match catalogue::Plant::by_name(text) {
        Ok(plant) => Ok(crate::control::System::Continuous(plant.transfer_function()).to_model()),
        Err(unknown) => {
            plant_text::parse(text).map_err(|e| format!("{unknown}; nor is it a transfer function in s: {e}"))
        }
    }
}
