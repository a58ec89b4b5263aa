//! Studies, plants and subjects.

use super::*;
use volition::store::{Plant, PlantPatch, SignalUnits, Study, StudyPatch, Subject, SubjectPatch, TrialRecord};

fn to_name(name: &str) -> PlantPatch {
    PlantPatch { name: Some(name.to_owned()), ..PlantPatch::default() }
}

#[tokio::test]
async fn a_study_comes_back_as_it_was_given() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let made = store.create_study(new_study("Tracking"), None).await.unwrap();
    assert!(is_new(&made));
    let made = made.into_inner();
    assert_eq!(store.study(made.id).await.unwrap(), made);
    assert_eq!((made.name.as_str(), made.description.as_str()), ("Tracking", "of a moving target"));
    assert_eq!((made.display_limit, made.version), (Some(2.0), 1));
    assert_eq!(made.created_at, made.updated_at);
    assert_not_found(store.study(StudyId(uuid::Uuid::nil())).await, "study");
    // Two studies may have one name.
    assert!(is_new(&store.create_study(new_study("Tracking"), None).await.unwrap()));
}

#[tokio::test]
async fn patches_change_what_they_name_and_count_versions() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let study = store.create_study(new_study("Tracking"), None).await.unwrap().into_inner();
    bench.pass(1.0);
    let rename = StudyPatch { name: Some("Reaching".into()), ..StudyPatch::default() };
    let renamed = store.change::<Study>(study.id, rename.clone(), Some(1)).await.unwrap();
    assert_eq!((renamed.name.as_str(), renamed.display_limit, renamed.version), ("Reaching", Some(2.0), 2));
    assert!(renamed.updated_at > renamed.created_at);
    assert_stale(store.change::<Study>(study.id, rename.clone(), Some(1)).await);
    assert_eq!(store.change::<Study>(study.id, StudyPatch::default(), Some(2)).await.unwrap(), renamed);
    let unlimited = StudyPatch { display_limit: Some(None), ..StudyPatch::default() };
    assert_eq!(store.change::<Study>(study.id, unlimited, None).await.unwrap().display_limit, None);
    assert_not_found(store.change::<Study>(StudyId(uuid::Uuid::nil()), rename, None).await, "study");

    let subject = bench.subject(study.id, "S01").await;
    let patch = SubjectPatch { group: Some(None), attributes: Some(json!({"age_years": 32})), code: None };
    let patched = store.change::<Subject>(subject, patch, Some(1)).await.unwrap();
    assert_eq!((patched.code.as_str(), patched.group, patched.version), ("S01", None, 2));
    assert_eq!(patched.attributes, json!({"age_years": 32}));
    assert_stale(store.change::<Subject>(subject, SubjectPatch::default(), Some(1)).await);
    let moved = SubjectPatch { group: Some(Some("gn".into())), code: Some("S09".into()), attributes: None };
    let moved = store.change::<Subject>(subject, moved, None).await.unwrap();
    assert_eq!((moved.code.as_str(), moved.group.as_deref(), moved.version), ("S09", Some("gn"), 3));
    assert_eq!(store.subject(subject).await.unwrap(), moved);
    let nobody = SubjectId(uuid::Uuid::nil());
    assert_not_found(store.change::<Subject>(nobody, SubjectPatch::default(), None).await, "subject");

    let plant = bench.plant(study.id).await;
    let renamed = store.change::<Plant>(plant, to_name("two masses"), Some(1)).await.unwrap();
    assert_eq!((renamed.name.as_str(), renamed.version), ("two masses", 2));
    assert_eq!(store.plant(plant).await.unwrap(), renamed);
    assert_stale(store.change::<Plant>(plant, to_name("again"), Some(1)).await);
    assert_not_found(store.change::<Plant>(PlantId(uuid::Uuid::nil()), to_name("x"), None).await, "plant");
}

#[tokio::test]
async fn names_and_codes_are_unique_within_their_study() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let other_study = bench.study().await;
    assert_conflict(store.create_plant(study, new_plant("mass"), None).await, "plant_name_taken");
    assert_conflict(store.create_subject(study, new_subject("S01"), None).await, "subject_code_taken");
    assert!(is_new(&store.create_plant(other_study, new_plant("mass"), None).await.unwrap()));
    assert!(is_new(&store.create_subject(other_study, new_subject("S01"), None).await.unwrap()));
    store.create_plant(study, new_plant("spring"), None).await.unwrap();
    store.create_subject(study, new_subject("S02"), None).await.unwrap();
    assert_conflict(store.change::<Plant>(plant, to_name("spring"), None).await, "plant_name_taken");
    let patch = SubjectPatch { code: Some("S02".into()), ..SubjectPatch::default() };
    assert_conflict(store.change::<Subject>(subject, patch, None).await, "subject_code_taken");
    // A refused write leaves everything as it was.
    assert_eq!(store.subject(subject).await.unwrap().version, 1);
    assert_eq!(store.plant(plant).await.unwrap().version, 1);
}

#[tokio::test]
async fn what_belongs_to_a_study_needs_it() {
    let bench = Bench::new().await;
    let (store, nowhere) = (&bench.store, StudyId(uuid::Uuid::nil()));
    assert_not_found(store.create_plant(nowhere, new_plant("mass"), None).await, "study");
    assert_not_found(store.create_subject(nowhere, new_subject("S01"), None).await, "study");
    assert_not_found(store.plants(nowhere, EVERYTHING).await, "study");
    assert_not_found(store.subjects(nowhere, None, EVERYTHING).await, "study");
    assert_not_found(store.matching_trials(nowhere, &Default::default()).await, "study");
    assert_not_found(store.delete::<Study>(nowhere, None).await, "study");
    assert_not_found(store.plant(PlantId(uuid::Uuid::nil())).await, "plant");
    assert_not_found(store.delete::<Plant>(PlantId(uuid::Uuid::nil()), None).await, "plant");
    assert_not_found(store.subject(SubjectId(uuid::Uuid::nil())).await, "subject");
    assert_not_found(store.delete::<Subject>(SubjectId(uuid::Uuid::nil()), None).await, "subject");
    assert_not_found(store.trials(SubjectId(uuid::Uuid::nil()), EVERYTHING).await, "subject");
}

#[tokio::test]
async fn models_come_back_bit_for_bit() {
    let bench = Bench::new().await;
    let study = bench.study().await;
    let model: Model = serde_json::from_value(json!({
        "a": [[0.1, 1.0 / 3.0], [-5e-324, 1e308]], "b": [[0.0], [1.0]], "c": [[1.0, 0.0]], "d": [[0.0]],
        "sample_time_s": 0.02
    }))
    .unwrap();
    let new = NewPlant { name: "odd numbers".into(), model: model.clone(), units: SignalUnits::default() };
    let made = bench.store.create_plant(study, new, None).await.unwrap().into_inner();
    assert_eq!(bench.store.plant(made.id).await.unwrap().model, model);
}

#[tokio::test]
async fn deleting_a_study_takes_everything_in_it_and_nothing_else() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let (other_study, other_plant, other_subject) = bench.lab().await;
    let trial = bench.trial(subject, plant, 1).await;
    let kept = bench.trial(other_subject, other_plant, 1).await;
    let analysis = store.create_analysis(new_analysis(vec![trial]), None).await.unwrap().into_inner();
    assert_eq!(analysis.study, Some(study));
    let of_plant = NewAnalysis { plants: vec![plant], ..new_analysis(Vec::new()) };
    let of_plant = store.create_analysis(of_plant, None).await.unwrap().into_inner();
    let kept_analysis = store.create_analysis(new_analysis(vec![kept]), None).await.unwrap().into_inner();
    assert_stale(store.delete::<Study>(study, Some(7)).await);
    store.delete::<Study>(study, Some(1)).await.unwrap();
    assert_not_found(store.study(study).await, "study");
    assert_not_found(store.plant(plant).await, "plant");
    assert_not_found(store.subject(subject).await, "subject");
    assert_not_found(store.trial(trial).await, "trial");
    assert_not_found(store.trial_signals(trial).await, "trial");
    assert_not_found(store.analysis(analysis.id).await, "analysis");
    assert_not_found(store.analysis(of_plant.id).await, "analysis");
    assert_eq!(store.study(other_study).await.unwrap().id, other_study);
    assert_eq!(store.trial_signals(kept).await.unwrap(), new_trial(other_plant, 1).trial);
    assert_eq!(store.analysis(kept_analysis.id).await.unwrap(), kept_analysis);
}

#[tokio::test]
async fn deleting_a_subject_takes_its_trials_and_their_analyses() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let other = bench.subject(study, "S02").await;
    let (gone, stays) = (bench.trial(subject, plant, 1).await, bench.trial(other, plant, 1).await);
    // An analysis of both people's trials holds something of each.
    let both = store.create_analysis(new_analysis(vec![gone, stays]), None).await.unwrap().into_inner();
    let alone = store.create_analysis(new_analysis(vec![stays]), None).await.unwrap().into_inner();
    let lease = store.claim("w", 15.0).await.unwrap().unwrap().lease;
    store.succeed(&lease, &report(1.0)).await.unwrap();
    assert_stale(store.delete::<Subject>(subject, Some(2)).await);
    store.delete::<Subject>(subject, Some(1)).await.unwrap();
    assert_not_found(store.trial(gone).await, "trial");
    assert_not_found(store.analysis(both.id).await, "analysis");
    assert_not_found(store.report_json(both.id).await, "analysis");
    assert_eq!(store.analysis(alone.id).await.unwrap(), alone);
    assert_eq!(store.subjects(study, None, EVERYTHING).await.unwrap().len(), 1);
}

#[tokio::test]
async fn a_plant_in_use_stays_and_an_unused_one_goes_with_its_analyses() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (_, plant, subject) = bench.lab().await;
    let trial = bench.trial(subject, plant, 1).await;
    let named = NewAnalysis { plants: vec![plant], ..new_analysis(Vec::new()) };
    let named = store.create_analysis(named, None).await.unwrap().into_inner();
    assert_conflict(store.delete::<Plant>(plant, None).await, "plant_in_use");
    assert_eq!(store.analysis(named.id).await.unwrap(), named);
    store.delete::<TrialRecord>(trial, None).await.unwrap();
    assert_stale(store.delete::<Plant>(plant, Some(3)).await);
    store.delete::<Plant>(plant, Some(1)).await.unwrap();
    assert_not_found(store.plant(plant).await, "plant");
    assert_not_found(store.analysis(named.id).await, "analysis");
}

/// A client that hangs up drops the handler's future wherever it is; the one writer must come back whole.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn abandoned_requests_do_not_wedge_the_writer() {
    let bench = Bench::new().await;
    let study = bench.study().await;
    let mut finished = 0;
    for k in 0..300_u64 {
        let patience = std::time::Duration::from_micros(7 * (k % 100));
        let code = format!("S{k:03}");
        let request = bench.store.create_subject(study, new_subject(&code), None);
        finished += usize::from(tokio::time::timeout(patience, request).await.is_ok());
    }
    let last = bench.store.create_subject(study, new_subject("last"), None);
    let last =
        tokio::time::timeout(std::time::Duration::from_secs(30), last).await.expect("the writer is wedged").unwrap();
    let stored = bench.store.subjects(study, None, EVERYTHING).await.unwrap();
    // Whoever got an answer is stored; of those who hung up, each is stored whole or not at all.
    assert!(stored.len() > finished && stored.len() <= 301);
    assert_eq!(stored.last().unwrap(), &last.into_inner());
    assert!(stored.iter().all(|subject| subject.attributes == new_subject("").attributes));
}
