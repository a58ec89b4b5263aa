//! Files that go, futures that are dropped.

use super::files::place;
use super::*;
use std::time::Duration;
use volition::store::{Study, Trouble};

#[cfg(unix)]
#[tokio::test]
async fn a_file_that_is_gone_or_replaced_is_said_and_one_that_comes_back_is_used_again() {
    let (directory, path) = place();
    let store = Store::open(Some(&path)).await.unwrap();
    let study = store.create_study(new_study("before"), None).await.unwrap().into_inner().id;
    let away = directory.path().join("away.db");
    std::fs::rename(&path, &away).unwrap();
    for another in [false, true] {
        if another {
            std::fs::write(&path, "somebody else's").unwrap();
        }
        let outcomes = [
            store.create_study(new_study("lost"), None).await.map(drop),
            store.study(study).await.map(drop),
            store.delete::<Study>(study, None).await,
            store.ping().await,
            store.claim("w", 15.0).await.map(drop),
            store.rescue(5).await.map(drop),
        ];
        for outcome in outcomes {
            let error = outcome.unwrap_err();
            assert!(matches!(&error, StoreError::Moved { .. }), "{error}");
            assert_eq!(error.trouble(), Some(Trouble::Unusable));
            assert!(error.to_string().contains(if another { "replaced" } else { "gone" }), "{error}");
        }
    }
    assert_eq!(std::fs::read(&path).unwrap(), b"somebody else's", "what is not ours is not touched");
    std::fs::rename(&away, &path).unwrap();
    store.ping().await.unwrap();
    assert_eq!(store.study(study).await.unwrap().name, "before");
    store.create_study(new_study("after"), None).await.unwrap();
    store.close().await;
    let store = Store::open(Some(&path)).await.unwrap();
    assert_eq!(store.studies(EVERYTHING).await.unwrap().len(), 2);
    store.close().await;
}

/// Futures dropped after every span of time that a write takes: what was begun is finished or was never begun, and no
/// connection is left within a transaction.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_write_that_nobody_waits_for_leaves_no_transaction_open() {
    use rand::{RngExt, SeedableRng};
    let (_directory, path) = place();
    let store = Store::open(Some(&path)).await.unwrap();
    let (study, other) = (new_study("kept"), new_study("other"));
    let study = store.create_study(study, None).await.unwrap().into_inner().id;
    let plant = store.create_plant(study, new_plant("mass"), None).await.unwrap().into_inner().id;
    let subject = store.create_subject(study, new_subject("S01"), None).await.unwrap().into_inner().id;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(19);
    let mut answered = 0;
    for round in 0..400_i64 {
        let patience = Duration::from_micros(rng.random_range(0..6_000));
        let in_time = match round % 6 {
            0 => tokio::time::timeout(patience, store.create_study(other.clone(), None)).await.map(drop),
            1 => tokio::time::timeout(patience, store.create_analysis(new_analysis(Vec::new()), None)).await.map(drop),
            2 => {
                let trial = vec![new_trial(plant, round + 1)];
                tokio::time::timeout(patience, store.create_trials(subject, trial, None)).await.map(drop)
            }
            3 => tokio::time::timeout(patience, store.claim("w", 15.0)).await.map(drop),
            4 => tokio::time::timeout(patience, store.subjects(study, None, EVERYTHING)).await.map(drop),
            _ => tokio::time::timeout(patience, store.ping()).await.map(drop),
        };
        answered += usize::from(in_time.is_ok());
    }
    assert!((4..396).contains(&answered), "{answered} of 400 were waited for: the spans test little");
    // Every connection, several times over, and at once.
    let all = (0..32).map(|k| {
        let store = store.clone();
        tokio::spawn(async move {
            store.create_study(new_study(&format!("after {k}")), None).await.unwrap();
            store.subjects(study, None, EVERYTHING).await.unwrap();
        })
    });
    for task in all.collect::<Vec<_>>() {
        tokio::time::timeout(Duration::from_secs(30), task).await.unwrap().unwrap();
    }
    assert_eq!(store.count_replaced(), 0);
    // All or nothing: every trial that is there has its columns.
    for trial in store.trials(subject, EVERYTHING).await.unwrap() {
        store.trial_signals(trial.id).await.unwrap();
    }
    store.close().await;
}
