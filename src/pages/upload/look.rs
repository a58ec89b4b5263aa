//! A draft, looked at: what each file was read as, and what is found about it.

use super::settings::{Guess, Settings};
use crate::analysis::ids::{PlantId, SubjectId, TrialId};
use crate::analysis::{Code, Problem, Warning};
use crate::api::{ApiResult, AppState, Preview, Wish, checked_name, off_thread, preview};
use crate::figure::text::three;
use crate::store::{Draft, DraftFile, DraftTrial, Page, Plant, Study, Subject, TrialFilter, TrialRecord};
use std::collections::{BTreeMap, BTreeSet};

/// People and plants of a study that are offered.
pub(super) const MOST: Page = Page { after: None, limit: 1000 };

/// Bytes of a file that cannot be read that are shown.
const HEAD_BYTES: usize = 200;

/// What the study has, beside which the files are looked at.
pub(super) struct Lab {
    pub(super) study: Study,
    pub(super) plants: Vec<Plant>,
    pub(super) subjects: Vec<Subject>,
    trials: Vec<TrialRecord>,
}

/// What became of a file.
pub(super) enum Outcome {
    /// It stands beside a table of Motion-BIDS, and says what is in it.
    Beside,
    /// It is stored.
    Stored(TrialId),
    /// It was read.
    Read(Box<Preview>),
    /// It cannot be stored as it is, and how it begins.
    Refused { head: String },
}

/// A file, looked at.
pub(super) struct Look {
    pub(super) name: String,
    pub(super) settings: Settings,
    pub(super) guess: Guess,
    /// Whose it is, as far as that is known.
    pub(super) code: Option<String>,
    pub(super) plant: Option<PlantId>,
    pub(super) number: Option<i64>,
    pub(super) session: Option<i64>,
    pub(super) outcome: Outcome,
    /// What must be mended before it can be stored.
    pub(super) mend: Vec<Problem>,
    /// What a person should look at.
    pub(super) look: Vec<Warning>,
    /// What else is worth knowing.
    pub(super) notes: Vec<String>,
    /// What was checked, and is as it should be.
    pub(super) checked: Vec<String>,
    /// The trial that has the same content.
    pub(super) same: Option<TrialId>,
}

impl Lab {
    async fn read(state: &AppState, draft: &Draft) -> ApiResult<Self> {
        let filter = TrialFilter { include_divergent: true, ..TrialFilter::default() };
        Ok(Self {
            study: state.store.study(draft.study).await?,
            plants: state.store.plants(draft.study, MOST).await?,
            subjects: state.store.subjects(draft.study, None, MOST).await?,
            trials: state.store.matching_trials(draft.study, &filter).await?,
        })
    }

    fn subject(&self, code: &str) -> Option<&Subject> {
        self.subjects.iter().find(|subject| subject.code == code)
    }

    /// The plant of the subject's last trial, or the only one there is.
    fn usual_plant(&self, subject: Option<&Subject>) -> Option<PlantId> {
        let of = |id: SubjectId| self.trials.iter().rev().find(|trial| trial.subject == id).map(|trial| trial.plant);
        let only = if let [plant] = self.plants.as_slice() { Some(plant.id) } else { None };
        subject.and_then(|subject| of(subject.id)).or(only)
    }
}

impl Look {
    fn new(file: &DraftFile, lab: &Lab, codes: &[String], is_beside: bool) -> Self {
        let settings = Settings::of(&file.settings);
        let guess = Guess::of(&file.name, codes);
        let code = settings.text("subject").map(str::to_owned).or_else(|| guess.subject.clone());
        let plant = settings.plant().or_else(|| lab.usual_plant(code.as_deref().and_then(|code| lab.subject(code))));
        let outcome = match file.trial {
            Some(trial) => Outcome::Stored(trial),
            None if is_beside => Outcome::Beside,
            None => Outcome::Refused { head: head(&file.data) },
        };
        let mut look = Self {
            name: file.name.clone(),
            code,
            plant,
            number: None,
            session: None,
            outcome,
            mend: Vec::new(),
            look: Vec::new(),
            notes: Vec::new(),
            checked: Vec::new(),
            same: None,
            settings,
            guess,
        };
        if look.is_open() {
            look.decide(lab);
        }
        look
    }

    /// Whether it is neither stored nor beside another.
    pub(super) fn is_open(&self) -> bool {
        matches!(self.outcome, Outcome::Read(_) | Outcome::Refused { .. })
    }

    /// Whether it is stored when that is asked for.
    pub(super) fn will_be_stored(&self) -> bool {
        matches!(self.outcome, Outcome::Read(_))
            && self.mend.is_empty()
            && self.settings.takes().unwrap_or(self.same.is_none())
    }

    /// Whose it is, and which one.
    fn decide(&mut self, lab: &Lab) {
        match &self.code {
            None => self.mend.push(
                Problem::new(Code::Invalid, "whose recording is it?", "the name of the file does not say")
                    .at("field subject")
                    .mend("Write the code of the person, one that the study has or a new one."),
            ),
            Some(code) => match checked_name(code, "field subject") {
                Ok(clean) => self.code = Some(clean),
                Err(problem) => self.mend.push(problem),
            },
        }
        if !self.plant.is_some_and(|id| lab.plants.iter().any(|plant| plant.id == id)) {
            let detail = if lab.plants.is_empty() {
                "the study has no plant yet"
            } else {
                "the study has several, and nothing says which one it is"
            };
            self.mend.push(
                Problem::new(Code::Invalid, "on which plant was it recorded?", detail)
                    .at("field plant")
                    .mend("Choose the plant; a new one is made at the study's own address in the interface."),
            );
        }
        for (name, least) in [("number", 1), ("session", 0)] {
            match self.settings.integer(name, least) {
                Ok(value) if name == "number" => self.number = value.or(self.guess.number),
                Ok(value) => self.session = value.or(self.guess.session),
                Err(problem) => self.mend.push(problem),
            }
        }
    }

    /// How it is read, where enough is known: what is wrong with a file is said whosever it is.
    fn wish(&mut self, lab: &Lab) -> Option<Wish> {
        if !self.is_open() {
            return None;
        }
        // What a file is does not hang on its plant: where that is not known yet, any will do to read it.
        let named = lab.plants.iter().find(|plant| Some(plant.id) == self.plant);
        let plant = named.or(lab.plants.first())?.clone();
        match self.settings.options() {
            Ok(options) => Some(Wish { plant, number: self.number, session: self.session, options }),
            Err(problem) => {
                self.mend.push(problem);
                None
            }
        }
    }

    /// Takes in what the file was read as.
    fn take(&mut self, read: Result<Preview, Problem>, lab: &Lab) {
        let mut found = match read {
            Ok(found) => found,
            Err(problem) => return self.mend.push(problem),
        };
        if self.plant.is_none() {
            // They would be about another plant.
            found.warnings.clear();
        }
        let trial = &found.new.trial;
        let seconds = trial.sample_time_s * trial.samples().saturating_sub(1) as f64;
        self.checked.push(format!(
            "{} samples, {} s, evenly spaced at {} Hz, without a gap",
            trial.samples(),
            three(seconds),
            three(1.0 / trial.sample_time_s)
        ));
        self.look.extend(found.warnings.iter().cloned());
        let subject = self.code.as_deref().and_then(|code| lab.subject(code));
        let same = lab.trials.iter().find(|stored| stored.sha256 == found.new.sha256);
        match same {
            Some(same) => {
                let whose = lab.subjects.iter().find(|subject| subject.id == same.subject);
                let whose = whose.map_or("another person", |subject| subject.code.as_str());
                let message = format!("already stored as {whose} trial {}", same.number);
                self.same = Some(same.id);
                let code = if subject.is_some_and(|subject| subject.id == same.subject) {
                    "duplicate_content"
                } else {
                    "content_of_another_subject"
                };
                self.look.push(Warning::new(code, message));
            }
            None => self.checked.push("no trial of the study has the same content".to_owned()),
        }
        if let Some(limit) = lab.study.display_limit {
            let reach = three(found.new.max_abs_output);
            if found.new.max_abs_output > limit {
                let message = format!(
                    "|y| reaches {reach}, beyond the study's display limit of {}: the trial is kept, and left out of \
                     learning curves",
                    three(limit)
                );
                self.look.push(Warning::new("divergent", message));
            } else {
                self.checked.push(format!("|y| reaches {reach}, within the display limit of {}", three(limit)));
            }
        }
        if let Some(code) = self.code.as_deref().filter(|_| subject.is_none()) {
            self.notes
                .push(format!("the study has nobody with the code {code} yet: the person is made with the trial"));
        }
        self.outcome = Outcome::Read(Box::new(found));
    }
}

/// How a file begins, as text.
fn head(data: &[u8]) -> String {
    let text = String::from_utf8_lossy(data.get(..HEAD_BYTES).unwrap_or(data)).into_owned();
    text.chars().map(|c| if c.is_control() && c != '\n' && c != '\t' { '·' } else { c }).collect()
}

/// The numbers of all files: as said or guessed, else the next free ones; a number that another trial has is to be
/// mended.
fn number_all(files: &mut [Look], lab: &Lab) {
    let mut taken: BTreeMap<(String, Option<i64>), BTreeSet<i64>> = BTreeMap::new();
    for trial in &lab.trials {
        let Some(subject) = lab.subjects.iter().find(|subject| subject.id == trial.subject) else { continue };
        taken.entry((subject.code.clone(), trial.session)).or_default().insert(trial.number);
    }
    for look in files {
        let Some(code) = look.code.clone().filter(|_| matches!(look.outcome, Outcome::Read(_))) else { continue };
        if look.same.is_some() && look.settings.takes() != Some(true) {
            continue;
        }
        let own = taken.entry((code, look.session)).or_default();
        let number = look.number.unwrap_or_else(|| own.last().map_or(1, |last| last + 1));
        let is_free = own.insert(number);
        if !is_free && look.same.is_none() {
            let detail = format!("the person has a trial number {number} already, stored or among these files");
            look.mend.push(Problem::new(Code::Conflict, "the number is taken", detail).at("field number").mend(
                format!("Write another number, such as {}, or another session.", own.last().map_or(1, |n| n + 1)),
            ));
        }
        look.number = Some(number);
        if let Outcome::Read(found) = &mut look.outcome {
            found.new.number = number;
        }
    }
}

/// Reads every file of a draft.
pub(super) async fn look_at(state: &AppState, draft: &Draft) -> ApiResult<(Lab, Vec<Look>)> {
    let lab = Lab::read(state, draft).await?;
    let codes: Vec<String> = lab.subjects.iter().map(|subject| subject.code.clone()).collect();
    let names: Vec<&str> = draft.files.iter().map(|file| file.name.as_str()).collect();
    let beside = crate::api::stand_beside(&names);
    let mut files: Vec<Look> =
        draft.files.iter().zip(beside).map(|(file, is_beside)| Look::new(file, &lab, &codes, is_beside)).collect();
    let wishes: Vec<Option<Wish>> = files.iter_mut().map(|look| look.wish(&lab)).collect();
    let named: Vec<(String, Vec<u8>)> = draft.files.iter().map(|file| (file.name.clone(), file.data.clone())).collect();
    let limits = state.limits;
    let read = off_thread(move || preview(named, &wishes, &limits)).await?;
    for (look, read) in files.iter_mut().zip(read) {
        if let Some(read) = read {
            look.take(read, &lab);
        }
    }
    number_all(&mut files, &lab);
    Ok((lab, files))
}

/// The files that are stored when that is asked for.
pub(super) fn to_store(files: Vec<Look>) -> Vec<DraftTrial> {
    let one = |(position, look): (usize, Look)| {
        if !look.will_be_stored() {
            return None;
        }
        let group = look.settings.text("group").map(str::to_owned);
        let Outcome::Read(found) = look.outcome else { return None };
        Some(DraftTrial { position, code: look.code?, group, new: found.new })
    };
    files.into_iter().enumerate().filter_map(one).collect()
}
