//! Idempotency keys.

use super::*;
use volition::store::{Subject, TrialRecord};

#[tokio::test]
async fn the_same_request_twice_makes_one_thing() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let k = key("retry-1", "hash-a");
    let made = store.create_study(new_study("Tracking"), Some(&k)).await.unwrap();
    assert!(is_new(&made));
    let again = store.create_study(new_study("Tracking"), Some(&k)).await.unwrap();
    assert_eq!(again, Created::Replayed(made.into_inner()));
    assert_eq!(store.studies(EVERYTHING).await.unwrap().len(), 1);
    let other = key("retry-1", "hash-b");
    assert!(matches!(store.create_study(new_study("Other"), Some(&other)).await, Err(StoreError::KeyReused)));
    assert_eq!(store.studies(EVERYTHING).await.unwrap().len(), 1);
}

#[tokio::test]
async fn keys_are_scoped_by_noun_and_parent() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (one, two) = (bench.study().await, bench.study().await);
    let k = key("the same key", "the same body");
    assert!(is_new(&store.create_plant(one, new_plant("mass"), Some(&k)).await.unwrap()));
    assert!(is_new(&store.create_plant(two, new_plant("mass"), Some(&k)).await.unwrap()));
    assert!(is_new(&store.create_subject(one, new_subject("S01"), Some(&k)).await.unwrap()));
    assert!(is_new(&store.create_analysis(new_analysis(Vec::new()), Some(&k)).await.unwrap()));
    // Again: each answers with its own, and without a conflict of names.
    let Created::Replayed(plant) = store.create_plant(two, new_plant("mass"), Some(&k)).await.unwrap() else {
        panic!("not replayed")
    };
    assert_eq!(plant.study, two);
    let Created::Replayed(_) = store.create_subject(one, new_subject("S01"), Some(&k)).await.unwrap() else {
        panic!("not replayed")
    };
    assert_eq!(store.analyses(Default::default(), EVERYTHING).await.unwrap().len(), 1);
    let Created::Replayed(_) = store.create_analysis(new_analysis(Vec::new()), Some(&k)).await.unwrap() else {
        panic!("not replayed")
    };
    assert_eq!(store.analyses(Default::default(), EVERYTHING).await.unwrap().len(), 1);
}

#[tokio::test]
async fn batches_replay_in_order() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let k = key("upload", "files");
    let batch = || (1..=3).map(|number| new_trial(plant, number)).collect::<Vec<_>>();
    let made = store.create_trials(subject, batch(), Some(&k)).await.unwrap();
    assert!(made.iter().all(is_new));
    let again = store.create_trials(subject, batch(), Some(&k)).await.unwrap();
    let replayed: Vec<_> = made.into_iter().map(|trial| Created::Replayed(trial.into_inner())).collect();
    assert_eq!(again, replayed);
    let reused = key("upload", "other files");
    assert!(matches!(store.create_trials(subject, batch(), Some(&reused)).await, Err(StoreError::KeyReused)));

    let trials: Vec<TrialId> = again.into_iter().map(|trial| trial.into_inner().id).collect();
    let analyses =
        || trials.iter().map(|trial| NewAnalysis { study: Some(study), ..new_analysis(vec![*trial]) }).collect();
    let made = store.create_analyses(analyses(), Some(&k)).await.unwrap();
    assert_eq!(store.create_analyses(analyses(), Some(&k)).await.unwrap(), made);
    assert!(matches!(store.create_analyses(analyses(), Some(&reused)).await, Err(StoreError::KeyReused)));
    assert_eq!(store.analyses(Default::default(), EVERYTHING).await.unwrap(), made);
    assert_eq!(store.create_analyses(Vec::new(), Some(&reused)).await.unwrap(), []);
}

#[tokio::test]
async fn a_failed_request_leaves_its_key_free() {
    let bench = Bench::new().await;
    let study = bench.study().await;
    bench.subject(study, "S01").await;
    let k = key("k", "body");
    assert_conflict(bench.store.create_subject(study, new_subject("S01"), Some(&k)).await, "subject_code_taken");
    assert!(is_new(&bench.store.create_subject(study, new_subject("S02"), Some(&k)).await.unwrap()));
}

#[tokio::test]
async fn what_was_deleted_is_not_made_again() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let k = key("k", "body");
    let made = store.create_subject(study, new_subject("S02"), Some(&k)).await.unwrap().into_inner();
    store.delete::<Subject>(made.id, None).await.unwrap();
    let late = store.create_subject(study, new_subject("S02"), Some(&k)).await;
    assert_conflict(late, "idempotent_result_deleted");
    let trial = store.create_trials(subject, vec![new_trial(plant, 1)], Some(&k)).await.unwrap().remove(0).into_inner();
    store.delete::<TrialRecord>(trial.id, None).await.unwrap();
    let late = store.create_trials(subject, vec![new_trial(plant, 1)], Some(&k)).await;
    assert_conflict(late, "idempotent_result_deleted");
    assert_eq!(store.trials(subject, EVERYTHING).await.unwrap(), []);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn the_same_request_at_once_makes_one_thing() {
    let bench = Bench::new().await;
    let start = Arc::new(tokio::sync::Barrier::new(8));
    let requests: Vec<_> = (0..8)
        .map(|_| {
            let (store, start) = (bench.store.clone(), Arc::clone(&start));
            tokio::spawn(async move {
                start.wait().await;
                store.create_study(new_study("Tracking"), Some(&key("k", "body"))).await.unwrap()
            })
        })
        .collect();
    let mut new = 0;
    for request in requests {
        new += usize::from(is_new(&request.await.unwrap()));
    }
    assert_eq!(new, 1);
    assert_eq!(bench.store.studies(EVERYTHING).await.unwrap().len(), 1);
}
