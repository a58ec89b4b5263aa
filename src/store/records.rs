//! What the store takes and gives, in the words of the domain.

use super::on_plant::OnPlant;
use super::reading::StudyReading;
use super::units::{SignalUnits, UnitsChange};
use super::used::UsedTrials;
use crate::analysis::estimates::KeptEstimate;
use crate::analysis::ids::{AnalysisId, PlantId, StudyId, SubjectId, TrialId};
use crate::analysis::{Incumbent, Kind, Problem, Request, Warning};
use crate::control::Model;
use crate::ctl::{Bracket, Progress};
use crate::jobs::Status;
use crate::trial::Trial;
use time::OffsetDateTime;

/// A key that makes a repeated request harmless, with the hash of the request it was first used for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IdempotencyKey {
    /// The client's key.
    pub key: String,
    /// SHA-256 of the request, in hexadecimal.
    pub request_sha256: String,
}

/// The outcome of storing something.
#[derive(Debug, Clone, PartialEq)]
pub enum Created<T> {
    /// It is new.
    New(T),
    /// The same idempotent request was made before; this is what it made then.
    Replayed(T),
    /// The same content is stored already; this is it.
    Duplicate(T),
}

impl<T> Created<T> {
    /// What is stored, new or not.
    pub fn get(&self) -> &T {
        match self {
            Self::New(value) | Self::Replayed(value) | Self::Duplicate(value) => value,
        }
    }

    /// What is stored, new or not.
    pub fn into_inner(self) -> T {
        match self {
            Self::New(value) | Self::Replayed(value) | Self::Duplicate(value) => value,
        }
    }
}

/// A page of a list in creation order: at most `limit` rows with ids greater than `after`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Page {
    /// The last id of the page before; `None` from the start.
    pub after: Option<uuid::Uuid>,
    /// Rows at most.
    pub limit: u32,
}

/// A study as asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct NewStudy {
    /// Its name.
    pub name: String,
    /// What it is about.
    pub description: String,
    /// A trial whose |y| passes this is divergent; `None` where there is no limit.
    pub display_limit: Option<f64>,
    /// What its files do not say themselves.
    pub reading: StudyReading,
}

/// A study.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// Its id.
    pub id: StudyId,
    /// Its name.
    pub name: String,
    /// What it is about.
    pub description: String,
    /// A trial whose |y| passes this is divergent.
    pub display_limit: Option<f64>,
    /// What its files do not say themselves.
    pub reading: StudyReading,
    /// Counts changes, from 1; the ETag.
    pub version: i64,
    /// When it was made.
    pub created_at: OffsetDateTime,
    /// When it last changed.
    pub updated_at: OffsetDateTime,
}

/// A study with what is in it.
#[derive(Debug, Clone, PartialEq)]
pub struct StudyOverview {
    /// The study.
    pub study: Study,
    /// Its subjects.
    pub subjects: u64,
    /// Their trials.
    pub trials: u64,
    /// How many of the trials an analysis has succeeded for.
    pub analysed: u64,
    /// Analyses that wait.
    pub queued: u64,
    /// Analyses that a worker computes.
    pub running: u64,
    /// Analyses that failed.
    pub failed: u64,
    /// When it or anything in it last changed.
    pub changed_at: OffsetDateTime,
}

/// Changes to a study; `None` leaves a field as it is.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StudyPatch {
    /// A new name.
    pub name: Option<String>,
    /// A new description.
    pub description: Option<String>,
    /// A new display limit, or none at all.
    pub display_limit: Option<Option<f64>>,
    /// What its files do not say themselves, in place of what was kept.
    pub reading: Option<StudyReading>,
}

/// A plant as asked for; its model has been checked.
#[derive(Debug, Clone, PartialEq)]
pub struct NewPlant {
    /// Its name, unique within the study.
    pub name: String,
    /// Its model.
    pub model: Model,
    /// The units of its signals.
    pub units: SignalUnits,
}

/// A plant. Its model never changes: results were computed with it.
#[derive(Debug, Clone, PartialEq)]
pub struct Plant {
    /// Its id.
    pub id: PlantId,
    /// Its study.
    pub study: StudyId,
    /// Its name.
    pub name: String,
    /// Its model.
    pub model: Model,
    /// The units of its signals.
    pub units: SignalUnits,
    /// Counts changes, from 1; the ETag.
    pub version: i64,
    /// When it was made.
    pub created_at: OffsetDateTime,
    /// When it last changed.
    pub updated_at: OffsetDateTime,
}

/// Changes to a plant; `None` leaves a field as it is.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PlantPatch {
    /// A new name.
    pub name: Option<String>,
    /// New units.
    pub units: UnitsChange,
}

/// A subject as asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct NewSubject {
    /// Pseudonym, unique within the study.
    pub code: String,
    /// Group.
    pub group: Option<String>,
    /// Free attributes, a JSON object.
    pub attributes: serde_json::Value,
}

/// A subject.
#[derive(Debug, Clone, PartialEq)]
pub struct Subject {
    /// Its id.
    pub id: SubjectId,
    /// Its study.
    pub study: StudyId,
    /// Pseudonym.
    pub code: String,
    /// Group.
    pub group: Option<String>,
    /// Free attributes, a JSON object.
    pub attributes: serde_json::Value,
    /// Counts changes, from 1; the ETag.
    pub version: i64,
    /// When it was made.
    pub created_at: OffsetDateTime,
    /// When it last changed.
    pub updated_at: OffsetDateTime,
}

/// Changes to a subject; `None` leaves a field as it is.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SubjectPatch {
    /// A new pseudonym.
    pub code: Option<String>,
    /// A new group, or none.
    pub group: Option<Option<String>>,
    /// New attributes, replacing all old ones.
    pub attributes: Option<serde_json::Value>,
}

/// A trial as asked for: parsed, checked and measured.
#[derive(Debug, Clone, PartialEq)]
pub struct NewTrial {
    /// The plant it was recorded on; of the subject's study.
    pub plant: PlantId,
    /// Its number, from 1; unique within the subject and session.
    pub number: i64,
    /// Its session.
    pub session: Option<i64>,
    /// The recording.
    pub trial: Trial,
    /// SHA-256 of its content, in hexadecimal.
    pub sha256: String,
    /// The largest |y|, from which divergence is judged against the study's present limit.
    pub max_abs_output: f64,
    /// Time-domain metrics as `learning` wrote them, a JSON object.
    pub metrics: serde_json::Value,
    /// What must be read before the trial is used.
    pub warnings: Vec<Warning>,
}

/// A trial without its signals.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialRecord {
    /// Its id.
    pub id: TrialId,
    /// Its study.
    pub study: StudyId,
    /// Its subject.
    pub subject: SubjectId,
    /// The subject's pseudonym.
    pub subject_code: String,
    /// The plant it was recorded on.
    pub plant: PlantId,
    /// The plant's name.
    pub plant_name: String,
    /// Its number.
    pub number: i64,
    /// Its session.
    pub session: Option<i64>,
    /// Time between samples, in seconds.
    pub sample_time_s: f64,
    /// Number of samples.
    pub samples: u64,
    /// Whether a disturbance was recorded.
    pub has_disturbance: bool,
    /// SHA-256 of the content, in hexadecimal.
    pub sha256: String,
    /// The largest |y|.
    pub max_abs_output: f64,
    /// Whether |y| passed the display limit that the study has now.
    pub divergent: bool,
    /// Time-domain metrics, a JSON object.
    pub metrics: serde_json::Value,
    /// The units of its signals, where they are not those of its plant.
    pub units: SignalUnits,
    /// What must be read before the trial is used, found at its upload.
    pub warnings: Vec<Warning>,
    /// A remark; empty where there is none.
    pub note: String,
    /// Why it is left out of curves and comparisons; `None` where it is not.
    pub excluded: Option<String>,
    /// Counts changes, from 1; the ETag.
    pub version: i64,
    /// When it was uploaded.
    pub created_at: OffsetDateTime,
    /// When it last changed.
    pub updated_at: OffsetDateTime,
}

/// Changes to a trial; `None` leaves a field as it is.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TrialPatch {
    /// A new number.
    pub number: Option<i64>,
    /// A new session, or none.
    pub session: Option<Option<i64>>,
    /// New units.
    pub units: UnitsChange,
    /// A new remark.
    pub note: Option<String>,
    /// A reason to leave it out, or none.
    pub excluded: Option<Option<String>>,
    /// Another plant, with what was measured and doubted on it.
    pub plant: Option<OnPlant>,
}

/// Which trials of a study.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TrialFilter {
    /// Only subjects of this group.
    pub group: Option<String>,
    /// Only this subject.
    pub subject: Option<SubjectId>,
    /// Only this plant.
    pub plant: Option<PlantId>,
    /// Only this session.
    pub session: Option<i64>,
    /// Only numbers from here on.
    pub number_from: Option<i64>,
    /// Only numbers up to here.
    pub number_to: Option<i64>,
    /// Divergent trials too.
    pub include_divergent: bool,
    /// Only divergent trials.
    pub only_divergent: bool,
    /// Only excluded trials, or only others.
    pub excluded: Option<bool>,
}

/// An analysis as asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct NewAnalysis {
    /// The study, where the inputs are stored things.
    pub study: Option<StudyId>,
    /// The kind.
    pub kind: Kind,
    /// The request with its defaults filled in.
    pub request: Request,
    /// SHA-256 of the spec with its defaults filled in.
    pub spec_sha256: String,
    /// The stored trials that it uses.
    pub trials: Vec<TrialId>,
    /// The stored plants that it uses.
    pub plants: Vec<PlantId>,
    /// Earlier analyses that it carries on from: it uses what they use, and goes with it.
    pub analyses: Vec<AnalysisId>,
}

/// An analysis: the row is the job.
#[derive(Debug, Clone, PartialEq)]
pub struct AnalysisRecord {
    /// Its id.
    pub id: AnalysisId,
    /// The study, where the inputs are stored things.
    pub study: Option<StudyId>,
    /// Which stored trials it uses.
    pub uses: UsedTrials,
    /// The kind.
    pub kind: Kind,
    /// The request with its defaults filled in.
    pub request: Request,
    /// SHA-256 of the spec.
    pub spec_sha256: String,
    /// Where it stands.
    pub status: Status,
    /// How often a worker took it.
    pub attempts: u32,
    /// How far it is, as of the last heartbeat.
    pub progress: Progress,
    /// How near its search is, as of the last heartbeat; kept when it is stopped.
    pub bracket: Option<Bracket>,
    /// The best controllers found, where it was stopped before its search had ended.
    pub incumbent: Option<Incumbent>,
    /// Seconds left as of the last heartbeat; `None` while it is not running or nothing is known.
    pub eta_s: Option<f64>,
    /// Whether somebody asked for it to be cancelled.
    pub cancel_requested: bool,
    /// What went wrong, if it failed.
    pub problem: Option<Problem>,
    /// Counts changes, from 1; the ETag.
    pub version: i64,
    /// When it was asked for.
    pub created_at: OffsetDateTime,
    /// When the present or last attempt began.
    pub started_at: Option<OffsetDateTime>,
    /// When it finished.
    pub finished_at: Option<OffsetDateTime>,
    /// When anything about it last changed.
    pub updated_at: OffsetDateTime,
}

/// Which analyses to list.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct AnalysisFilter {
    /// Only of this study.
    pub study: Option<StudyId>,
    /// Only those that use this trial.
    pub trial: Option<TrialId>,
    /// Only of this kind.
    pub kind: Option<Kind>,
    /// Only in this status.
    pub status: Option<Status>,
}

/// Which analyses of a study belong to a run.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RunFilter {
    /// Only of this kind.
    pub kind: Option<Kind>,
    /// Only with a spec of this SHA-256, in lower-case hexadecimal.
    pub spec_sha256: Option<String>,
}

/// How far a run is.
#[derive(Debug, Clone, PartialEq)]
pub struct RunProgress {
    /// How many analyses there are in each status, zeros included.
    pub counts: Vec<(Status, u64)>,
    /// Seconds that the last attempts of those took that succeeded latest.
    pub latest_s: Vec<f64>,
}

/// The first trial of an analysis, as people name it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FirstTrial {
    /// The code of its subject.
    pub code: String,
    /// Its number.
    pub number: i64,
    /// How many trials the analysis has.
    pub trials: u64,
}

/// What an analysis found of a trial by an estimator.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialEstimate {
    /// The trial.
    pub trial: TrialId,
    /// Its position among the trials of the analysis, from 0.
    pub position: usize,
    /// The analysis.
    pub analysis: AnalysisId,
    /// SHA-256 of its spec.
    pub spec_sha256: String,
    /// By which estimator, by name.
    pub estimator: String,
    /// What was found.
    pub estimate: KeptEstimate,
}

/// What analyses found of trials.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TrialEstimates {
    /// In the order of the trials asked for, each trial's oldest first.
    pub found: Vec<TrialEstimate>,
    /// Analyses of which what is kept is damaged, by which estimator, and why.
    pub damaged: Vec<(AnalysisId, String, String)>,
}
