//! Backups: made while others write, whole, named, kept in number, and good for a restore; and what is damaged is
//! named.

use super::files::{meddle, place, tamper};
use super::*;
use std::path::{Path, PathBuf};
use volition::store::{Finding, Manifest, verify_file};

fn files(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

fn manifest(folder: &Path, file: &str) -> Manifest {
    serde_json::from_slice(&std::fs::read(folder.join(format!("{file}.json"))).unwrap()).unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_backup_made_while_others_write_is_whole_and_can_be_restored() {
    let (directory, path) = place();
    let store = Store::open(Some(&path)).await.unwrap();
    let study = store.create_study(new_study("Tracking"), None).await.unwrap().into_inner();
    let plant = store.create_plant(study.id, new_plant("mass"), None).await.unwrap().into_inner();
    let subject = store.create_subject(study.id, new_subject("S01"), None).await.unwrap().into_inner();
    for number in 1..=20 {
        store.create_trials(subject.id, vec![new_trial(plant.id, number)], None).await.unwrap();
    }
    let analysis = store.create_analysis(new_analysis(Vec::new()), None).await.unwrap().into_inner().id;
    let lease = store.claim("w", 15.0).await.unwrap().unwrap().lease;
    store.succeed(&lease, &report(0.5)).await.unwrap();

    let stop = tokio_util::sync::CancellationToken::new();
    let writing = tokio::spawn({
        let (store, stop) = (store.clone(), stop.clone());
        async move {
            let mut many = 0;
            while !stop.is_cancelled() {
                store.create_study(new_study(&format!("meanwhile {many}")), None).await.unwrap();
                many += 1;
            }
            many
        }
    });
    let folder = directory.path().join("backups/of the lab");
    let made = store.backup(&folder).await.unwrap();
    stop.cancel();
    assert!(writing.await.unwrap() > 0, "nobody wrote meanwhile");

    // The manifest says what is there.
    assert_eq!(files(&folder), [made.file.clone(), format!("{}.json", made.file)]);
    assert_eq!(manifest(&folder, &made.file), made);
    let copy = folder.join(&made.file);
    assert_eq!(Manifest::measure(&copy).unwrap(), (made.bytes, made.sha256.clone()));
    assert_eq!((made.rows["trials"], made.rows["analyses"], made.number), (20, 1, 1));
    assert!(made.damaged.is_empty());
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        assert_eq!(std::fs::metadata(&copy).unwrap().permissions().mode() & 0o077, 0, "people's data are in it");
    }
    assert!(verify_file(&copy).await.unwrap().is_sound());

    // Restored to another place, it is the lab as it was.
    let restored = directory.path().join("restored.db");
    std::fs::copy(&copy, &restored).unwrap();
    let other = Store::open(Some(&restored)).await.unwrap();
    assert_eq!(other.study(study.id).await.unwrap(), study);
    let all = other.trials(subject.id, EVERYTHING).await.unwrap();
    assert_eq!(all, store.trials(subject.id, EVERYTHING).await.unwrap());
    for trial in &all {
        assert_eq!(other.trial_signals(trial.id).await.unwrap(), store.trial_signals(trial.id).await.unwrap());
    }
    assert_eq!(other.report_json(analysis).await.unwrap(), store.report_json(analysis).await.unwrap());
    other.create_study(new_study("after the restore"), None).await.unwrap();
    other.close().await;
    store.close().await;
}

#[tokio::test]
async fn the_newest_backups_are_kept_whatever_the_clock_says_and_other_files_are_left_alone() {
    let directory = directory();
    let day = Arc::new(AtomicI64::new(1_790_000_000_000_000));
    let path = directory.path().join("volition.db");
    let store = Store::open_with_clock(Some(&path), Clock::Manual(Arc::clone(&day))).await.unwrap();
    let folder = directory.path().join("backups");
    std::fs::create_dir(&folder).unwrap();
    for name in ["notes.txt", "volition-000001-20200101T000000Z.db", "volition-x.db.json"] {
        std::fs::write(folder.join(name), "{}").unwrap();
    }
    let mut made = Vec::new();
    for _ in 0..5 {
        // Set back by a day each time.
        day.fetch_sub(86_400_000_000, Ordering::SeqCst);
        made.push(store.backup(&folder).await.unwrap().file);
    }
    let gone = Store::retain_backups(&folder, 2).await.unwrap();
    assert_eq!(gone, made[..3]);
    let left = files(&folder);
    for name in &made[3..] {
        assert!(left.contains(name) && left.contains(&format!("{name}.json")), "{left:?}");
    }
    for name in ["notes.txt", "volition-000001-20200101T000000Z.db", "volition-x.db.json"] {
        assert!(left.contains(&name.to_owned()), "{left:?}");
    }
    assert_eq!(left.len(), 7, "{left:?}");
    // The one that was just made is never deleted.
    assert_eq!(Store::retain_backups(&folder, 0).await.unwrap(), made[3..4]);
    day.fetch_add(3_600_000_000, Ordering::SeqCst);
    assert_eq!(store.age_of_newest_backup(&folder), Some(std::time::Duration::from_secs(3600)));
    day.fetch_sub(7_200_000_000, Ordering::SeqCst);
    assert_eq!(store.age_of_newest_backup(&folder), None, "made in the future says nothing");
    store.close().await;
}

#[tokio::test]
async fn a_backup_that_cannot_be_made_leaves_nothing() {
    let (directory, path) = place();
    let store = Store::open(Some(&path)).await.unwrap();
    let in_the_way = directory.path().join("file");
    std::fs::write(&in_the_way, "not a folder").unwrap();
    let outcome = store.backup(&in_the_way).await;
    assert!(matches!(outcome, Err(StoreError::Database(sqlx::Error::Io(_)))), "{outcome:?}");
    assert_eq!(std::fs::read(&in_the_way).unwrap(), b"not a folder");
    store.close().await;
}

/// A database with two of everything, and the ids of the first.
async fn two_of_everything() -> (tempfile::TempDir, PathBuf, Store) {
    let (directory, path) = place();
    let store = Store::open(Some(&path)).await.unwrap();
    let study = store.create_study(new_study("Tracking"), None).await.unwrap().into_inner().id;
    for number in 1..=2 {
        let plant = store.create_plant(study, new_plant(&format!("p{number}")), None).await.unwrap().into_inner().id;
        let subject = store.create_subject(study, new_subject(&format!("S{number}")), None).await.unwrap();
        let subject = subject.into_inner().id;
        let trial = store.create_trials(subject, vec![new_trial(plant, number)], None).await.unwrap().remove(0);
        store.create_analysis(new_analysis(vec![trial.into_inner().id]), None).await.unwrap();
        let lease = store.claim("w", 15.0).await.unwrap().unwrap().lease;
        store.succeed(&lease, &report(0.1)).await.unwrap();
    }
    (directory, path, store)
}

#[tokio::test]
async fn every_damaged_row_is_named_and_breaks_no_list() {
    let (directory, path, store) = two_of_everything().await;
    assert!(verify_file(&path).await.unwrap().is_sound());
    let study = store.studies(EVERYTHING).await.unwrap()[0].id;
    let first = |what: &str| format!("WHERE id = (SELECT min(id) FROM {what})");
    let damages: [(&str, String, &str, &str); 7] = [
        (
            "plants",
            format!("UPDATE plants SET model = replace(model, '0.1', '0.7') {}", first("plants")),
            "plant",
            "model",
        ),
        (
            "subjects",
            format!("UPDATE subjects SET attributes = '{{\"age' {}", first("subjects")),
            "subject",
            "attributes",
        ),
        (
            "trials",
            format!("UPDATE trials SET metrics = replace(metrics, '0.25', '0.26') {}", first("trials")),
            "trial",
            "metrics",
        ),
        ("trials", format!("UPDATE trials SET created_at = 9e18 {}", first("trials")), "trial", "time"),
        (
            "analyses",
            format!("UPDATE analyses SET report = replace(report, '0.1', '0.2') {}", first("analyses")),
            "analysis",
            "report",
        ),
        (
            "analyses",
            format!("UPDATE analyses SET request = replace(request, '_b', '_c') {}", first("analyses")),
            "analysis",
            "request",
        ),
        (
            "trials",
            "UPDATE trial_signals SET data = zeroblob(length(data)) WHERE channel = 'y'
                AND trial_id = (SELECT min(id) FROM trials)"
                .to_owned(),
            "trial",
            "column y",
        ),
    ];
    for (table, sql, noun, says) in damages {
        // Each from the sound state, in a copy of its own.
        let folder = directory.path().join("copy");
        let _ = std::fs::remove_dir_all(&folder);
        let made = store.backup(&folder).await.unwrap();
        let copy = folder.join(&made.file);
        assert_eq!(tamper(&copy, String::leak(sql.clone())).await, 1, "{sql}");
        let verified = verify_file(&copy).await.unwrap();
        let [Finding { noun: found, id, why }] = verified.findings.as_slice() else {
            panic!("{sql}: {verified:?}");
        };
        assert!(*found == noun && why.contains(says), "{sql}: {found} {why}");
        // The other one is still listed; so are both where only what is not listed is damaged.
        let damaged = Store::open(Some(&copy)).await.unwrap();
        let many = match table {
            "plants" => damaged.plants(study, EVERYTHING).await.unwrap().len(),
            "subjects" => damaged.subjects(study, None, EVERYTHING).await.unwrap().len(),
            "trials" => damaged.matching_trials(study, &Default::default()).await.unwrap().len(),
            _ => damaged.analyses(Default::default(), EVERYTHING).await.unwrap().len(),
        };
        let listed_whole = says == "report" || says == "column y";
        assert_eq!(many, if listed_whole { 2 } else { 1 }, "{sql}");
        // Pages are filled from behind a damaged row: nothing is cut short.
        let page = Page { after: None, limit: 1 };
        let many = match table {
            "plants" => damaged.plants(study, page).await.unwrap().len(),
            "subjects" => damaged.subjects(study, None, page).await.unwrap().len(),
            "trials" => 1,
            _ => damaged.analyses(Default::default(), page).await.unwrap().len(),
        };
        assert_eq!(many, 1, "{sql}");
        damaged.quarantine(&verified.findings).await.unwrap();
        assert_eq!(damaged.count_damaged().await.unwrap(), 1, "{sql}");
        // A backup of it is made all the same, and says so.
        let again = damaged.backup(&folder).await.unwrap();
        assert!(again.damaged.len() == 1 && again.damaged[0].contains(id), "{sql}: {again:?}");
        assert_eq!(again.number, 2);
        damaged.quarantine(&[]).await.unwrap();
        damaged.close().await;
    }
    store.close().await;
}

#[tokio::test]
async fn damaged_pages_and_lost_references_are_found() {
    let (directory, path, store) = two_of_everything().await;
    let made = store.backup(&directory.path().join("b")).await.unwrap();
    store.close().await;
    let copy = directory.path().join("b").join(&made.file);
    let sound = std::fs::read(&copy).unwrap();
    // Another program that does not look at references.
    let sql = "PRAGMA foreign_keys = OFF; DELETE FROM subjects";
    let mut meddler = meddle(&copy).await;
    sqlx::raw_sql(sql).execute(&mut meddler).await.unwrap();
    sqlx::Connection::close(meddler).await.unwrap();
    let verified = verify_file(&copy).await.unwrap();
    assert!(verified.references.iter().any(|why| why.contains("trials")), "{verified:?}");
    // Pages overwritten, one after another: found, or not even a database any more; never sound, never a panic.
    for page in 1..sound.len() / 4096 {
        let mut bytes = sound.clone();
        bytes[page * 4096..(page + 1) * 4096].fill(0xA5);
        std::fs::write(&copy, &bytes).unwrap();
        if let Ok(verified) = verify_file(&copy).await {
            assert!(!verified.is_sound(), "page {page} of {} was overwritten", path.display());
        }
    }
    let not_ours = directory.path().join("other.db");
    let mut other = meddle(&not_ours).await;
    sqlx::raw_sql("CREATE TABLE x (y)").execute(&mut other).await.unwrap();
    sqlx::Connection::close(other).await.unwrap();
    assert!(matches!(verify_file(&not_ours).await, Err(StoreError::CannotOpen { .. })));
}
