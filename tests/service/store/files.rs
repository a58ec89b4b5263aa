//! What is on disk: after a restart, after a deletion, after damage, and where there is no database at all.

use super::*;
use sqlx::Connection;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use std::path::{Path, PathBuf};
use volition::jobs::Status;
use volition::store::{AnalysisFilter, Study, Subject, TrialRecord};

pub fn place() -> (tempfile::TempDir, PathBuf) {
    let directory = directory();
    let path = directory.path().join("volition.db");
    (directory, path)
}

pub async fn open(path: &Path) -> Store {
    Store::open(Some(path)).await.unwrap()
}

/// Another program's connection to the file.
pub async fn meddle(path: &Path) -> SqliteConnection {
    SqliteConnection::connect_with(&SqliteConnectOptions::new().filename(path).create_if_missing(true)).await.unwrap()
}

pub async fn tamper(path: &Path, sql: &'static str) -> u64 {
    let mut connection = meddle(path).await;
    let changed = sqlx::query(sql).execute(&mut connection).await.unwrap().rows_affected();
    connection.close().await.unwrap();
    changed
}

/// Every byte that the database has on disk.
pub fn bytes(path: &Path) -> Vec<u8> {
    let directory = path.parent().unwrap();
    let mut all = Vec::new();
    for entry in std::fs::read_dir(directory).unwrap() {
        all.extend(std::fs::read(entry.unwrap().path()).unwrap());
    }
    all
}

fn holds(bytes: &[u8], text: &str) -> bool {
    bytes.windows(text.len()).any(|window| window == text.as_bytes())
}

#[tokio::test]
async fn everything_is_there_after_a_restart() {
    let (_directory, path) = place();
    let store = open(&path).await;
    let study = store.create_study(new_study("Tracking"), None).await.unwrap().into_inner();
    let plant = store.create_plant(study.id, new_plant("mass"), None).await.unwrap().into_inner();
    let subject = store.create_subject(study.id, new_subject("S01"), None).await.unwrap().into_inner();
    let trial =
        store.create_trials(subject.id, vec![new_trial(plant.id, 1)], None).await.unwrap().remove(0).into_inner();
    let analysis = store.create_analysis(new_analysis(vec![trial.id]), None).await.unwrap().into_inner();
    let lease = store.claim("w", 15.0).await.unwrap().unwrap().lease;
    store.succeed(&lease, &report(0.1)).await.unwrap();
    let text = store.report_json(analysis.id).await.unwrap();
    store.close().await;
    drop(store);

    let store = open(&path).await;
    store.ping().await.unwrap();
    assert_eq!(store.study(study.id).await.unwrap(), study);
    assert_eq!(store.plant(plant.id).await.unwrap(), plant);
    assert_eq!(store.subject(subject.id).await.unwrap(), subject);
    assert_eq!(store.trial(trial.id).await.unwrap(), trial);
    assert_eq!(store.trial_signals(trial.id).await.unwrap(), new_trial(plant.id, 1).trial);
    assert_eq!(store.analysis(analysis.id).await.unwrap().status, Status::Succeeded);
    assert_eq!(store.report_json(analysis.id).await.unwrap(), text);
    store.close().await;
    assert!(matches!(store.ping().await, Err(StoreError::Database(sqlx::Error::PoolClosed))));
}

#[tokio::test]
async fn deleted_people_are_gone_from_the_files() {
    let (_directory, path) = place();
    let store = open(&path).await;
    let study = store.create_study(new_study("Tracking"), None).await.unwrap().into_inner().id;
    let plant = store.create_plant(study, new_plant("mass"), None).await.unwrap().into_inner().id;
    let mut subjects = Vec::new();
    for k in 0..40 {
        let new = NewSubject {
            code: format!("pseudonym-{k:02}-end"),
            group: Some(format!("group-of-{k:02}-end")),
            attributes: json!({"note": format!("attribute-{k:02}-end").repeat(40)}),
        };
        let k_key = key(&format!("upload of pseudonym-{k:02}-end"), "body");
        let subject = store.create_subject(study, new, Some(&k_key)).await.unwrap().into_inner().id;
        let mut trial = new_trial(plant, k + 1);
        trial.metrics = json!({"note": format!("metrics-{k:02}-end").repeat(30)});
        let trial = store.create_trials(subject, vec![trial], Some(&k_key)).await.unwrap().remove(0).into_inner().id;
        let mut new = new_analysis(vec![trial]);
        new.request.spec = json!({"note": format!("request-{k:02}-end").repeat(200)});
        store.create_analysis(new, Some(&k_key)).await.unwrap();
        let lease = store.claim("w", 15.0).await.unwrap().unwrap().lease;
        let mut report = report(1.0);
        report.result = json!({"note": format!("report-{k:02}-end").repeat(300)});
        store.succeed(&lease, &report).await.unwrap();
        subjects.push(subject);
    }
    let traces = |k: usize| {
        ["pseudonym", "group-of", "attribute", "metrics", "request", "report"].map(|what| format!("{what}-{k:02}-end"))
    };
    let before = bytes(&path);
    for k in 0..40 {
        for trace in traces(k) {
            assert!(holds(&before, &trace), "{trace} should be on disk before");
        }
    }
    // Scattered ones first, so that pages are merged and rebuilt around those that stay.
    for k in [7, 8, 9, 20, 31, 0, 39, 14, 15, 16, 17] {
        store.delete::<Subject>(subjects[k], None).await.unwrap();
        let after = bytes(&path);
        for trace in traces(k) {
            assert!(!holds(&after, &trace), "{trace} is still on disk");
        }
    }
    // A changed pseudonym is forgotten as well.
    let patch = volition::store::SubjectPatch { code: Some("renamed".into()), ..Default::default() };
    store.change::<Subject>(subjects[3], patch, None).await.unwrap();
    assert!(!holds(&bytes(&path), "pseudonym-03-end"));
    let kept = bytes(&path);
    assert!(traces(4).iter().all(|trace| holds(&kept, trace)), "those who stay, stay");
    store.delete::<Study>(study, None).await.unwrap();
    let after = bytes(&path);
    for k in 0..40 {
        for trace in traces(k) {
            assert!(!holds(&after, &trace), "{trace} is still on disk");
        }
    }
    store.close().await;
}

/// Many people with long pseudonyms, so that table and index have inner pages, which deletions merge and rebuild.
#[tokio::test]
async fn no_trace_survives_in_rebuilt_pages() {
    use rand::{RngExt, SeedableRng};
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(20_260_722);
    let (_directory, path) = place();
    let store = open(&path).await;
    let study = store.create_study(new_study("Tracking"), None).await.unwrap().into_inner().id;
    let mut living = Vec::new();
    let mut dead: Vec<String> = Vec::new();
    for round in 0..500 {
        let grow = round < 300;
        if grow || living.is_empty() {
            let code = format!("<{round:04}-{}>", "x".repeat(rng.random_range(1..600)));
            let note = "y".repeat(rng.random_range(0..6000));
            let attributes = json!({"mark": format!("[{round:04}]"), "note": note});
            let new = NewSubject { code: code.clone(), group: Some(format!("({round:04})")), attributes };
            living.push((round, store.create_subject(study, new, None).await.unwrap().into_inner().id));
        }
        if rng.random_bool(if grow { 0.3 } else { 0.9 }) {
            let (round, id) = living.swap_remove(rng.random_range(0..living.len()));
            dead.extend([format!("<{round:04}-"), format!("[{round:04}]"), format!("({round:04})")]);
            if rng.random_bool(0.7) {
                store.delete::<Subject>(id, None).await.unwrap();
            } else {
                let long = "z".repeat(rng.random_range(0..3000));
                let patch = volition::store::SubjectPatch {
                    code: Some(format!("renamed {round} {long}")),
                    group: Some(None),
                    attributes: Some(json!({"note": long})),
                };
                store.change::<Subject>(id, patch, None).await.unwrap();
            }
            if round % 20 == 0 || living.len() < 3 {
                let after = bytes(&path);
                let starts: std::collections::HashSet<&[u8]> = after.windows(6).collect();
                for trace in &dead {
                    assert!(!starts.contains(trace.as_bytes()), "{trace} is still on disk in round {round}");
                }
            }
        }
    }
    assert!(dead.len() > 600, "{}", dead.len());
    store.close().await;
}

#[tokio::test]
async fn a_reader_in_the_way_only_delays_the_scrubbing() {
    let (_directory, path) = place();
    let store = open(&path).await;
    let study = store.create_study(new_study("secret-study-name"), None).await.unwrap().into_inner().id;
    store.close().await;
    let store = open(&path).await;
    // Another process looks at an old state of the file.
    let mut reader = meddle(&path).await;
    sqlx::raw_sql("BEGIN; SELECT count(*) FROM studies").execute(&mut reader).await.unwrap();
    let deletion = tokio::spawn({
        let store = store.clone();
        async move { store.delete::<Study>(study, None).await }
    });
    assert_not_found_soon(&store, study).await;
    sqlx::raw_sql("COMMIT").execute(&mut reader).await.unwrap();
    reader.close().await.unwrap();
    deletion.await.unwrap().unwrap();
    // What a worker does every few seconds.
    store.rescue(5).await.unwrap();
    assert!(!holds(&bytes(&path), "secret-study-name"));
    store.close().await;
}

async fn assert_not_found_soon(store: &Store, study: StudyId) {
    for _ in 0..2000 {
        if matches!(store.study(study).await, Err(StoreError::NotFound { .. })) {
            return;
        }
        tokio::time::sleep(std::time::Duration::from_millis(5)).await;
    }
    panic!("the study is still there");
}

#[track_caller]
fn assert_damaged<T: std::fmt::Debug>(outcome: Result<T, StoreError>, says: &str) {
    match outcome {
        Err(StoreError::Damaged(why)) => assert!(why.contains(says), "{why}"),
        other => panic!("expected damage, found {other:?}"),
    }
}

#[tokio::test]
async fn damage_is_noticed_and_named() {
    let (_directory, path) = place();
    let store = open(&path).await;
    let study = store.create_study(new_study("Tracking"), None).await.unwrap().into_inner();
    let plant = store.create_plant(study.id, new_plant("mass"), None).await.unwrap().into_inner();
    let subject = store.create_subject(study.id, new_subject("S01"), None).await.unwrap().into_inner();
    let new = (1..=5).map(|number| new_trial(plant.id, number)).collect();
    let trials = store.create_trials(subject.id, new, None).await.unwrap();
    let id = |k: usize| trials[k].clone().into_inner().id;
    let analysis = store.create_analysis(new_analysis(vec![id(0)]), None).await.unwrap().into_inner();
    let lease = store.claim("w", 15.0).await.unwrap().unwrap().lease;
    store.succeed(&lease, &report(0.1)).await.unwrap();

    // One bit of one packed column.
    let mut meddler = meddle(&path).await;
    let trial = id(0).to_string();
    let (data,): (Vec<u8>,) = sqlx::query_as("SELECT data FROM trial_signals WHERE trial_id = $1 AND channel = 'y'")
        .bind(&trial)
        .fetch_one(&mut meddler)
        .await
        .unwrap();
    let mut flipped = data.clone();
    flipped[data.len() / 2] ^= 1;
    sqlx::query("UPDATE trial_signals SET data = $2 WHERE trial_id = $1 AND channel = 'y'")
        .bind(&trial)
        .bind(flipped)
        .execute(&mut meddler)
        .await
        .unwrap();
    // A whole, valid column in another's place: only the content hash can tell.
    sqlx::query(
        "UPDATE trial_signals SET (data, sha256, samples) =
           (SELECT data, sha256, samples FROM trial_signals s
            WHERE s.trial_id = trial_signals.trial_id AND s.channel = 'r')
         WHERE trial_id = $1 AND channel = 'y'",
    )
    .bind(id(1).to_string())
    .execute(&mut meddler)
    .await
    .unwrap();
    sqlx::query("DELETE FROM trial_signals WHERE trial_id = $1 AND channel = 'u'")
        .bind(id(2).to_string())
        .execute(&mut meddler)
        .await
        .unwrap();
    sqlx::query("UPDATE trials SET sample_time_s = 0.01 WHERE id = $1")
        .bind(id(3).to_string())
        .execute(&mut meddler)
        .await
        .unwrap();
    meddler.close().await.unwrap();
    assert_eq!(tamper(&path, "UPDATE analyses SET report = replace(report, '0.1', '0.2')").await, 1);
    assert_damaged(store.trial_signals(id(0)).await, "column y");
    assert_damaged(store.trial_signals(id(1)).await, "content");
    assert_damaged(store.trial_signals(id(2)).await, "column u is missing");
    assert_damaged(store.trial_signals(id(3)).await, "sample time");
    assert_eq!(store.trial_signals(id(4)).await.unwrap(), new_trial(plant.id, 5).trial);
    assert_damaged(store.report_json(analysis.id).await, "report");
    // What is kept of a report needs no report. Where that is damaged too, the others are given, and it is named.
    let estimates = store.estimates_of_trials(&[id(0)], None).await.unwrap();
    assert_eq!((estimates.found.len(), estimates.damaged.len()), (1, 0));
    assert_eq!(tamper(&path, "UPDATE analysis_estimates SET estimate = replace(estimate, 'it', 'It')").await, 1);
    let estimates = store.estimates_of_trials(&[id(0)], None).await.unwrap();
    assert_eq!((estimates.found.len(), estimates.damaged.len()), (0, 1));
    assert!(estimates.damaged[0].0 == analysis.id && estimates.damaged[0].2.contains("hash"), "{estimates:?}");
    let references = volition::analysis::References { trials: vec![id(0)], ..Default::default() };
    assert_damaged(store.library(&references).await, "column y");
    // Still a model, and a wrong one.
    assert_eq!(tamper(&path, "UPDATE plants SET model = replace(model, '0.1', '0.7')").await, 1);
    assert_damaged(store.plant(plant.id).await, "model");
    assert_eq!(store.plants(study.id, EVERYTHING).await.unwrap(), []);
    let references = volition::analysis::References { trials: vec![id(4)], ..Default::default() };
    assert_damaged(store.library(&references).await, "model");
    assert_eq!(tamper(&path, "UPDATE analyses SET request = replace(request, 'appendix_b', 'appendix_c')").await, 1);
    assert_damaged(store.analysis(analysis.id).await, "request");
    // Not computed, and not tried again and again either.
    let spoiled = store.create_analysis(new_analysis(Vec::new()), None).await.unwrap().into_inner().id;
    let sound = store.create_analysis(new_analysis(Vec::new()), None).await.unwrap().into_inner().id;
    let mut meddler = meddle(&path).await;
    sqlx::query("UPDATE analyses SET request = replace(request, 'appendix_b', 'appendix_c') WHERE id = $1")
        .bind(spoiled.to_string())
        .execute(&mut meddler)
        .await
        .unwrap();
    meddler.close().await.unwrap();
    assert_eq!(store.claim("w", 15.0).await.unwrap().unwrap().lease.analysis, sound);
    let failed = AnalysisFilter { status: Some(Status::Failed), ..AnalysisFilter::default() };
    assert_eq!(store.analyses(failed, EVERYTHING).await.unwrap(), []);
    assert_damaged(store.analysis(spoiled).await, &spoiled.to_string());
    // A report, a plant, two requests.
    assert_eq!(store.count_damaged().await.unwrap(), 3);
    store.close().await;
}

#[tokio::test]
async fn the_database_itself_refuses_what_the_rules_forbid() {
    let (_directory, path) = place();
    let store = open(&path).await;
    store.create_analysis(new_analysis(Vec::new()), None).await.unwrap();
    let mut meddler = meddle(&path).await;
    let refusals = [
        ("UPDATE analyses SET status = 'paused'", "status IN"),
        ("UPDATE analyses SET status = 'running', attempts = 1, started_at = 1", "leased_when_running"),
        ("UPDATE analyses SET lease_token = 'x', lease_expires_at = 1", "leased_when_running"),
        ("UPDATE analyses SET status = 'failed', attempts = 1, started_at = 1, finished_at = 1", "problem_on_failure"),
        (
            "UPDATE analyses SET status = 'succeeded', attempts = 1, started_at = 1, finished_at = 1",
            "reported_on_success",
        ),
        ("UPDATE analyses SET status = 'cancelled', finished_at = 1", "cancelled_on_request"),
        ("UPDATE analyses SET status = 'cancelled', cancel_requested = 1", "finished_when_final"),
        ("UPDATE analyses SET finished_at = 1", "finished_when_final"),
        ("UPDATE analyses SET report = '{}', report_sha256 = ''", "reported_on_success"),
        ("UPDATE analyses SET problem = '{}'", "problem_on_failure"),
        ("UPDATE analyses SET cancel_requested = 1", "queued_means_wanted"),
        ("UPDATE analyses SET progress_done = 2, progress_total = 1", "progress_in_range"),
        (
            "UPDATE analyses SET status = 'running', lease_token = 'x', lease_expires_at = 1, started_at = 1",
            "attempted_when_taken",
        ),
        (
            "UPDATE analyses SET status = 'running', lease_token = 'x', lease_expires_at = 1, attempts = 1",
            "started_when_taken",
        ),
        ("UPDATE analyses SET attempts = 'three'", "cannot store TEXT"),
        ("UPDATE analyses SET incumbent_cost = 1.0, lower_bound = 0.5", "incumbent_is_one_candidate"),
        ("UPDATE analyses SET incumbent_cost = 1.0, incumbent_index = 3", "bracket_is_whole"),
        ("UPDATE analyses SET incumbent_cost = 1.0, incumbent_index = 3, lower_bound = 1.5", "bracket_is_whole"),
        ("UPDATE analyses SET incumbent = '{}'", "incumbent_has_its_cost"),
    ];
    for (sql, rule) in refusals {
        let error = sqlx::query(sql).execute(&mut meddler).await.expect_err(sql).to_string();
        assert!(error.contains(rule), "{sql}: {error}");
    }
    meddler.close().await.unwrap();
    store.close().await;
}

#[track_caller]
#[cfg(unix)]
#[tokio::test]
async fn only_the_owner_can_read_the_files() {
    use std::os::unix::fs::PermissionsExt;
    let (directory, path) = place();
    let store = open(&path).await;
    store.create_study(new_study("Tracking"), None).await.unwrap();
    let mut seen = 0;
    for entry in std::fs::read_dir(directory.path()).unwrap() {
        let entry = entry.unwrap();
        assert_eq!(entry.metadata().unwrap().permissions().mode() & 0o077, 0, "{:?}", entry.path());
        seen += 1;
    }
    assert!(seen >= 2, "the log is a file as well");
    store.close().await;
}

#[tokio::test]
async fn a_temporary_database_leaves_nothing_behind() {
    let ours = || -> Vec<PathBuf> {
        let pid = std::process::id();
        std::fs::read_dir(format!("/proc/{pid}/fd"))
            .map(|fds| fds.filter_map(|fd| std::fs::read_link(fd.ok()?.path()).ok()).collect())
            .unwrap_or_default()
    };
    let store = Store::open(None).await.unwrap();
    store.create_study(new_study("temporary"), None).await.unwrap();
    // Other tests of this process have temporary databases as well; find ours by what it holds.
    let file = ours().into_iter().find(|path| {
        path.to_string_lossy().ends_with("volition.db")
            && std::fs::read(path.with_extension("db-wal")).is_ok_and(|bytes| holds(&bytes, "temporary"))
    });
    let copy = store.clone();
    store.close().await;
    drop(store);
    if let Some(file) = &file {
        assert!(file.exists(), "a handle is left");
    }
    drop(copy);
    if let Some(file) = file {
        assert!(!file.parent().unwrap().exists(), "{file:?}");
    }
}

/// A change that takes nothing away that may name a person leaves the file as it is laid out; one that does is
/// vacuumed, which counts the layout of the file up.
#[tokio::test]
async fn only_what_may_name_a_person_is_scrubbed() {
    use volition::store::{SubjectPatch, TrialPatch};
    let (_directory, path) = place();
    let store = open(&path).await;
    let study = store.create_study(new_study("Tracking"), None).await.unwrap().into_inner().id;
    let plant = store.create_plant(study, new_plant("mass"), None).await.unwrap().into_inner().id;
    let subject = store.create_subject(study, new_subject("S01"), None).await.unwrap().into_inner().id;
    let trial = store.create_trials(subject, vec![new_trial(plant, 1)], None).await.unwrap().remove(0).into_inner().id;
    let layout = async || -> i64 {
        let mut connection = meddle(&path).await;
        sqlx::query_scalar("PRAGMA schema_version").fetch_one(&mut connection).await.unwrap()
    };
    let first = layout().await;
    let note = |text: &str| Some(text.to_owned());
    for patch in [
        TrialPatch { number: Some(7), session: Some(None), ..TrialPatch::default() },
        TrialPatch {
            note: note("told by Anna-Maria"),
            excluded: Some(note("left by Bert-Otto")),
            ..TrialPatch::default()
        },
        TrialPatch { note: note("told by Anna-Maria"), number: Some(8), ..TrialPatch::default() },
    ] {
        store.change::<TrialRecord>(trial, patch, None).await.unwrap();
    }
    let named = |code: &str| SubjectPatch { code: Some(code.into()), ..SubjectPatch::default() };
    store.change::<Subject>(subject, named("S01"), None).await.unwrap();
    assert_eq!(layout().await, first);
    assert!(holds(&bytes(&path), "Anna-Maria") && holds(&bytes(&path), "Bert-Otto"));
    for (patch, name) in [
        (TrialPatch { note: note(""), ..TrialPatch::default() }, "Anna-Maria"),
        (TrialPatch { excluded: Some(None), ..TrialPatch::default() }, "Bert-Otto"),
    ] {
        let before = layout().await;
        store.change::<TrialRecord>(trial, patch, None).await.unwrap();
        assert!(layout().await > before && !holds(&bytes(&path), name), "{name}");
    }
    let before = layout().await;
    assert_eq!(store.change::<Subject>(subject, named("S02"), None).await.unwrap().code, "S02");
    assert!(layout().await > before);
    store.close().await;
}

/// A large database owes its vacuum until a moment later, or until the next process.
#[tokio::test]
async fn a_large_database_is_scrubbed_later_but_surely() {
    use rand::{RngExt, SeedableRng};
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("volition.db");
    let owed = async |path: &Path| -> i64 {
        let mut connection = meddle(path).await;
        sqlx::query_scalar("PRAGMA user_version").fetch_one(&mut connection).await.unwrap()
    };
    let store = open(&path).await;
    let study = store.create_study(new_study("Tracking"), None).await.unwrap().into_inner().id;
    let plant = store.create_plant(study, new_plant("mass"), None).await.unwrap().into_inner().id;
    let keep = store.create_subject(study, new_subject("who-stays"), None).await.unwrap().into_inner().id;
    let gone = store.create_subject(study, new_subject("who-goes"), None).await.unwrap().into_inner().id;
    // Noise hardly compresses: 3 columns of 2 million samples are some 40 MB.
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let mut noise = || (0..2_000_000).map(|_| rng.random::<f64>()).collect::<Vec<f64>>();
    let signals = Signals { time_s: None, command: noise(), control: noise(), output: noise(), disturbance: None };
    let large = of_trial(plant, 1, Trial::new(0.001, signals).unwrap());
    let large_id = store.create_trials(keep, vec![large.clone()], None).await.unwrap().remove(0).into_inner().id;
    store.create_analysis(new_analysis(Vec::new()), None).await.unwrap();
    let lease = store.claim("w", 1e-3).await.unwrap().unwrap().lease;

    // Asserted only while the pause after which it is paid cannot be over, however busy the machine is.
    let pause = std::time::Duration::from_secs(4);
    let begin = std::time::Instant::now();
    store.delete::<Subject>(gone, None).await.unwrap();
    let debt = owed(&path).await;
    assert!(debt == 1 || begin.elapsed() > pause, "the vacuum is owed");
    assert!(!holds(&bytes(&path), "who-goes"), "the row itself goes at once");
    store.close().await;
    let debt = owed(&path).await;
    let begin = std::time::Instant::now();
    let store = open(&path).await;
    assert!(owed(&path).await == debt || begin.elapsed() > pause, "a restart does not forget it");
    store.scrub().await.unwrap();
    assert_eq!(owed(&path).await, 0);
    assert!(!holds(&bytes(&path), "who-goes"));
    assert_eq!(store.trial_signals(large_id).await.unwrap(), large.trial);
    assert_eq!(store.peek(&lease).await.unwrap(), volition::store::LeaseState::Held);
    // Small again: the next deletion is scrubbed before it returns, and the space is given back.
    store.delete::<TrialRecord>(large_id, None).await.unwrap();
    store.scrub().await.unwrap();
    assert_eq!(owed(&path).await, 0);
    assert!(std::fs::metadata(&path).unwrap().len() < 1 << 20);
    store.close().await;
}
