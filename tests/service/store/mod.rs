//! What the store promises, whatever database is behind it: one suite, run on SQLite today.

mod analyses;
mod backups;
mod clocks;
mod files;
mod keys;
mod leases;
mod lists;
mod migrations;
mod nouns;
mod outages;
mod plans;
mod refused_files;
mod trials;

use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use volition::analysis::ids::{PlantId, StudyId, SubjectId, TrialId};
use volition::analysis::{Analysis as _, Code, Problem, Report, Request, frequency_response, ssid};
use volition::control::Model;
use volition::num::hexadecimal::hexadecimal;
use volition::store::{
    Clock, Created, IdempotencyKey, NewAnalysis, NewPlant, NewStudy, NewSubject, NewTrial, Page, SignalUnits, Store,
    StoreError, StudyReading,
};
use volition::trial::{Signals, Trial};

pub const EVERYTHING: Page = Page { after: None, limit: 1000 };

/// A directory in memory where there is one: these tests write thousands of small transactions, each synced to disk.
pub fn directory() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// A store of its own, on a clock that stands still until it is moved.
pub struct Bench {
    pub store: Store,
    now: Arc<AtomicI64>,
    _directory: tempfile::TempDir,
}

impl Bench {
    pub async fn new() -> Self {
        let now = Arc::new(AtomicI64::new(1_790_000_000_000_000));
        let directory = directory();
        let path = directory.path().join("volition.db");
        let store = Store::open_with_clock(Some(&path), Clock::Manual(Arc::clone(&now))).await.unwrap();
        Self { store, now, _directory: directory }
    }

    pub fn pass(&self, seconds: f64) {
        self.now.fetch_add((seconds * 1e6) as i64, Ordering::SeqCst);
    }

    pub async fn study(&self) -> StudyId {
        self.store.create_study(new_study("Tracking"), None).await.unwrap().into_inner().id
    }

    pub async fn plant(&self, study: StudyId) -> PlantId {
        self.store.create_plant(study, new_plant("mass"), None).await.unwrap().into_inner().id
    }

    pub async fn subject(&self, study: StudyId, code: &str) -> SubjectId {
        self.store.create_subject(study, new_subject(code), None).await.unwrap().into_inner().id
    }

    /// A study with one plant and one subject.
    pub async fn lab(&self) -> (StudyId, PlantId, SubjectId) {
        let study = self.study().await;
        (study, self.plant(study).await, self.subject(study, "S01").await)
    }

    pub async fn trial(&self, subject: SubjectId, plant: PlantId, number: i64) -> TrialId {
        let made = self.store.create_trials(subject, vec![new_trial(plant, number)], None).await.unwrap();
        made.into_iter().next().unwrap().into_inner().id
    }

    /// Queues an analysis that carries its own data.
    pub async fn queue(&self) -> volition::analysis::ids::AnalysisId {
        self.store.create_analysis(new_analysis(Vec::new()), None).await.unwrap().into_inner().id
    }
}

pub fn new_study(name: &str) -> NewStudy {
    NewStudy {
        name: name.into(),
        description: "of a moving target".into(),
        display_limit: Some(2.0),
        reading: StudyReading::default(),
    }
}

pub fn model() -> Model {
    serde_json::from_value(json!({"num": [1.0], "den": [1.0, 0.1, 0.0]})).unwrap()
}

pub fn new_plant(name: &str) -> NewPlant {
    NewPlant { name: name.into(), model: model(), units: SignalUnits::default() }
}

pub fn new_subject(code: &str) -> NewSubject {
    NewSubject { code: code.into(), group: Some("gm".into()), attributes: json!({"age_years": 31, "handed": "left"}) }
}

/// A trial whose content depends on its number alone.
pub fn new_trial(plant: PlantId, number: i64) -> NewTrial {
    let wave = |gain: f64| (0..400).map(|k| gain * (0.01 * f64::from(k) * number as f64).sin()).collect::<Vec<f64>>();
    let signals = Signals {
        time_s: Some((0..400).map(|k| f64::from(k) * 0.02).collect()),
        command: wave(1.0),
        control: wave(0.3),
        output: wave(0.9),
        disturbance: (number % 2 == 0).then(|| wave(0.1)),
    };
    of_trial(plant, number, Trial::new(0.02, signals).unwrap())
}

pub fn of_trial(plant: PlantId, number: i64, trial: Trial) -> NewTrial {
    NewTrial {
        plant,
        number,
        session: Some(1),
        sha256: hexadecimal(&trial.content_sha256()),
        max_abs_output: trial.signals.output.iter().fold(0.0, |m: f64, y| m.max(y.abs())),
        warnings: Vec::new(),
        metrics: json!({"mean_abs_error": 0.25}),
        trial,
    }
}

pub fn new_analysis(trials: Vec<TrialId>) -> NewAnalysis {
    NewAnalysis {
        study: None,
        kind: ssid::Plan::KIND,
        request: Request {
            kind: "ssid".into(),
            inputs: json!({"trials": trials}),
            spec: json!({"pool": "zhang2015_appendix_b"}),
        },
        spec_sha256: "5".repeat(64),
        trials,
        plants: Vec::new(),
        analyses: Vec::new(),
    }
}

pub fn report(cost: f64) -> Report {
    let inputs = [("/inputs/trial".to_owned(), "a".repeat(64))].into();
    Report::new(
        ssid::Plan::KIND,
        1,
        json!({"cost": cost, "tiny": 5e-324}),
        Vec::new(),
        json!({"pool": "x"}),
        inputs,
        Some(7),
    )
}

pub fn problem() -> Problem {
    Problem::new(Code::NotIdentifiable, "no power", "r has no power at any line").at("/spec/lines")
}

pub fn key(key: &str, request: &str) -> IdempotencyKey {
    IdempotencyKey { key: key.into(), request_sha256: request.into() }
}

pub fn is_new<T>(created: &Created<T>) -> bool {
    matches!(created, Created::New(_))
}

#[track_caller]
pub fn assert_not_found<T: std::fmt::Debug>(outcome: Result<T, StoreError>, expected: &str) {
    match outcome {
        Err(StoreError::NotFound { noun, .. }) => assert_eq!(noun, expected),
        other => panic!("expected that there is no {expected}, found {other:?}"),
    }
}

#[track_caller]
pub fn assert_conflict<T: std::fmt::Debug>(outcome: Result<T, StoreError>, expected: &str) {
    match outcome {
        Err(StoreError::Conflict { rule, detail }) => {
            assert_eq!(rule, expected);
            assert!(!detail.is_empty());
        }
        other => panic!("expected the conflict {expected}, found {other:?}"),
    }
}

#[track_caller]
pub fn assert_stale<T: std::fmt::Debug>(outcome: Result<T, StoreError>) {
    assert!(matches!(outcome, Err(StoreError::Stale { .. })), "expected a stale version, found {outcome:?}");
}
