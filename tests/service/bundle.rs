//! A study taken along: out of one database into another, byte for byte; one flipped bit; the recordings as
//! Motion-BIDS.

use crate::api::harness::TestServer;
use crate::api::trust::identified;
use clap::Parser;
use std::fs::File;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, ExitCode};
use volition::analysis::ids::{StudyId, TrialId};
use volition::app::bundle::{ExportArgs, export};
use volition::app::import::{ImportArgs, import};
use volition::app::recordings;
use volition::exchange::Options;
use volition::exchange::bundle::Bundle;
use volition::store::{Store, verify_file};

#[derive(Parser)]
struct Export {
    #[command(flatten)]
    args: ExportArgs,
}

#[derive(Parser)]
struct Import {
    #[command(flatten)]
    args: ImportArgs,
}

async fn exported(study: &str, target: &Path, database: &Path, more: &[&str]) -> anyhow::Result<ExitCode> {
    let (target, database) = (target.display().to_string(), database.display().to_string());
    let line = ["export", study, &target, "--database", &database];
    export(&Export::try_parse_from(line.iter().chain(more)).unwrap().args).await
}

async fn imported(file: &Path, database: &Path, more: &[&str]) -> String {
    let (file, database) = (file.display().to_string(), database.display().to_string());
    let line = ["import", &file, "--database", &database];
    format!("{:?}", import(&Import::try_parse_from(line.iter().chain(more)).unwrap().args).await.unwrap())
}

fn code(code: u8) -> String {
    format!("{:?}", ExitCode::from(code))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_study_goes_to_another_database_and_comes_back_the_same_bytes() {
    let server = TestServer::start().await;
    let lab = identified(&server).await;
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("first.zip"), folder.path().join("second.zip"));
    let other = folder.path().join("other.db");
    exported(&lab.study, &first, &server.database(), &[]).await.unwrap();
    // Nothing is written over.
    assert!(exported(&lab.study, &first, &server.database(), &[]).await.is_err());
    assert_eq!(imported(&first, &other, &["--recompute"]).await, code(0));
    let found = verify_file(&other).await.unwrap();
    assert!(found.is_sound(), "{found:?}");
    exported(&lab.study, &second, &other, &[]).await.unwrap();
    let bytes = std::fs::read(&first).unwrap();
    assert!(bytes == std::fs::read(&second).unwrap(), "the second export differs");
    // The same things under the same ids, the recordings bit for bit, what was judged as it was.
    let study: StudyId = lab.study.parse().unwrap();
    let there = Store::open(Some(&other)).await.unwrap();
    let (mine, theirs) = (server.store.study(study).await.unwrap(), there.study(study).await.unwrap());
    assert_eq!(mine, theirs);
    let filter = volition::store::TrialFilter { include_divergent: true, ..Default::default() };
    let trials = server.store.matching_trials(study, &filter).await.unwrap();
    assert_eq!(trials, there.matching_trials(study, &filter).await.unwrap());
    assert_eq!(trials.len(), 6);
    let one = trials[3].id;
    assert_eq!(server.store.trial_signals(one).await.unwrap(), there.trial_signals(one).await.unwrap());
    let trust = volition::store::TrustFilter::default();
    let judged = server.store.trust_of_study(study, &trust).await.unwrap();
    assert!(!judged.is_empty());
    assert_eq!(judged, there.trust_of_study(study, &trust).await.unwrap());
    there.close().await;
    // Twice is once: nothing is mixed.
    assert_eq!(imported(&first, &other, &[]).await, code(2));

    // One bit, anywhere. Bits of packed files are named by file.
    let damaged = folder.path().join("damaged.zip");
    let empty = folder.path().join("empty.db");
    let mut named = Vec::new();
    for k in 0..60 {
        let mut flipped = bytes.clone();
        let at = (k * 7_919 + 13) * 104_729 % bytes.len();
        flipped[at] ^= 1 << (k % 8);
        std::fs::write(&damaged, &flipped).unwrap();
        let refused = Bundle::open(File::open(&damaged).unwrap()).map(drop).unwrap_err();
        named.extend(refused.location);
    }
    assert!(named.iter().any(|name| name.starts_with("signals/") && name.ends_with(".csv")), "{named:?}");
    assert!(named.iter().any(|name| name.starts_with("reports/") && name.ends_with(".json")), "{named:?}");
    assert_eq!(imported(&damaged, &empty, &[]).await, code(2));
    assert!(!empty.exists(), "a database was made for a bundle that was refused");
    server.finish().await;
}

/// Asks the validator of BIDS; left out, which is said aloud, where `tests/exchange/install` has not run.
fn validate(folder: &Path) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let validator = root.join("target/exchange/bids/node_modules/.bin/bids-validator");
    if !validator.exists() {
        let said = "\nLEFT OUT: Motion-BIDS by the validator of BIDS; run tests/exchange/install\n";
        std::io::stderr().write_all(said.as_bytes()).unwrap();
        return;
    }
    let output = Command::new(validator).arg("--json").arg(folder).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let answer: serde_json::Value = serde_json::from_str(&text).unwrap_or_else(|_| panic!("{output:?}"));
    assert_eq!(answer["issues"]["errors"], serde_json::json!([]), "{answer:#}");
    assert_eq!(answer["summary"]["subjects"], serde_json::json!(["s01"]), "{answer:#}");
    assert!(answer["summary"]["dataTypes"].to_string().contains("motion"), "{answer:#}");
}

#[tokio::test(flavor = "multi_thread")]
async fn recordings_are_a_folder_of_motion_bids() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let units = serde_json::json!({"units": {"output": "cm", "control": "N"}});
    server.patch(&format!("/v1/plants/{}", lab.plant), &units).await.json(200);
    let mut ids = Vec::new();
    for number in 1..=2 {
        ids.push(server.trial(&lab, number).await);
    }
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("bids");
    exported(&lab.study, &target, &server.database(), &["--motion-bids"]).await.unwrap();
    let place = target.join("sub-s01/ses-1/motion");
    for (number, id) in (1..).zip(&ids) {
        let stem = format!("sub-s01_ses-1_task-tracking_tracksys-volition_run-{number}");
        let read = recordings::read(&place.join(format!("{stem}_motion.tsv")), &Options::default()).unwrap();
        let id: TrialId = id.parse().unwrap();
        let stored = server.store.trial_signals(id).await.unwrap();
        assert_eq!(read.trial.signals_sha256(), stored.signals_sha256());
        assert!((read.trial.sample_time_s / stored.sample_time_s - 1.0).abs() < 1e-12);
        let channels = std::fs::read_to_string(place.join(format!("{stem}_channels.tsv"))).unwrap();
        assert!(channels.starts_with("name\tcomponent\ttype\ttracked_point\tunits\t"), "{channels}");
        assert!(channels.contains("\ny\tn/a\tMISC\tn/a\tcm\t"), "{channels}");
    }
    validate(&target);
    server.finish().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_archive_of_a_folder_is_imported_and_what_was_said_of_it_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let rows = |scale: f64| {
        let mut text = String::from("Clock,Target,Stick,Cursor\n");
        for i in 0..80 {
            let x = scale * (f64::from(i) * 0.3).sin();
            text.push_str(&format!("{},{x},{},{}\n", 20 * i, 0.5 * x, 0.1 * x));
        }
        text.into_bytes()
    };
    let index = b"file,subject,trial\ndata/a.csv,s01,1\ndata/b.csv,s01,2\n".to_vec();
    let zip = |files: Vec<(&str, Vec<u8>)>| {
        volition::exchange::write::zip::write(files.into_iter().map(|(name, bytes)| (name.to_owned(), bytes)).collect())
    };
    let file = folder.path().join("lab.zip");
    let files = vec![("lab/index.csv", index.clone()), ("lab/data/a.csv", rows(1.0)), ("lab/data/b.csv", rows(2.0))];
    std::fs::write(&file, zip(files)).unwrap();
    let database = folder.path().join("lab.db");
    let mapping = ["--columns", "t:Clock,r:Target,u:Stick,y:Cursor", "--time-unit", "ms", "--remember"];
    let study = ["--study", "lab", "--plant", "1/(s+1)"];
    let said: Vec<&str> = study.iter().chain(&mapping).copied().collect();
    assert_eq!(imported(&file, &database, &said).await, code(0));
    // Nothing is said the second time: it was kept.
    std::fs::write(
        &file,
        zip(vec![("index.csv", b"file,subject,trial\nc.csv,s02,1\n".to_vec()), ("c.csv", rows(3.0))]),
    )
    .unwrap();
    assert_eq!(imported(&file, &database, &study).await, code(0));
    let store = Store::open(Some(&database)).await.unwrap();
    let page = volition::store::Page { after: None, limit: 10 };
    let kept = store.studies(page).await.unwrap().remove(0);
    assert_eq!(kept.reading.columns.as_deref(), Some("t:Clock,r:Target,u:Stick,y:Cursor"));
    let trials = store.matching_trials(kept.id, &volition::store::TrialFilter::default()).await.unwrap();
    assert_eq!(trials.len(), 3);
    assert!(trials.iter().all(|trial| (trial.sample_time_s - 0.02).abs() < 1e-12), "{trials:?}");
    store.close().await;
    // Out of the folder is out of the question.
    std::fs::write(&file, zip(vec![("../index.csv", index)])).unwrap();
    let (path, database) = (file.display().to_string(), database.display().to_string());
    let line = ["import", &path, "--database", &database, "--study", "lab"];
    let refused = import(&Import::try_parse_from(line).unwrap().args).await.unwrap_err();
    assert!(refused.to_string().contains("outside"), "{refused}");
}
