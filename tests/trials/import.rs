//! Importing folders of trials into a temporary database.

use indicatif::ProgressBar;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::process::ExitCode;
use volition::app::import::index::{self, Condition};
use volition::app::import::load::{Outcome, PlantOptions, common_display_limit, find_or_create_study, load};
use volition::app::import::{ImportArgs, import as import_command};
use volition::app::recordings::ReadingArgs;
use volition::exchange::tables::study::TRIAL_COLUMNS;
use volition::exchange::{Options, TimeUnit, options::columns};
use volition::store::{Page, Store, Study, Subject, TrialRecord};

const ALL: Page = Page { after: None, limit: 500 };

async fn import(
    store: &Store,
    folder: &Path,
    study: &str,
    conditions: &[Condition],
    plants: &PlantOptions,
) -> (Study, Outcome) {
    let index = index::read(folder, None, conditions).unwrap();
    let limit = common_display_limit(&index).unwrap();
    let study = find_or_create_study(store, study, limit).await.unwrap();
    let outcome =
        load(store, &study, folder, &index, plants, &Options::default(), &ProgressBar::hidden()).await.unwrap();
    (study, outcome)
}

async fn stored(store: &Store, study: &Study) -> Vec<(Subject, Vec<TrialRecord>)> {
    let mut all = Vec::new();
    for subject in store.subjects(study.id, None, ALL).await.unwrap() {
        let trials = store.trials(subject.id, ALL).await.unwrap();
        all.push((subject, trials));
    }
    all
}

fn recording(scale: f64) -> String {
    let mut text = "t,r,u,y\n".to_owned();
    for i in 0..50 {
        let t = f64::from(i) * 0.02;
        writeln!(text, "{t:.3},{:.5},{:.5},{:.5}", t.sin(), scale * t, scale * t * t).unwrap();
    }
    text
}

#[tokio::test]
async fn a_folder_is_imported_once_and_what_is_wrong_is_refused_with_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("one.csv", &recording(1.0));
    write("two.csv", &recording(20.0));
    write("jitter.csv", &recording(2.0).replace("0.100,", "0.113,"));
    write("text.csv", &recording(3.0).replace("0.200,0.19867", "0.200,high"));
    write(
        "index.csv",
        "file,subject,trial,group,plant,display_limit,hand\n\
         one.csv,S1,1,g,1/s,8,left\n\
         two.csv,S1,2,g,1/s,8,right\n\
         jitter.csv,S1,3,g,1/s,8,\n\
         text.csv,S1,4,g,1/s,8,\n\
         missing.csv,S1,5,g,1/s,8,\n\
         ../outside.csv,S1,6,g,1/s,8,\n\
         one.csv,S1,1,other,1/s,8,\n\
         one.csv,S2,1,g,1/s(s+1),8,\n\
         two.csv,S1,1,g,1/s,8,\n\
         one.csv,S3,1,g,minimum_phase,8,\n",
    );
    let store = Store::open(None).await.unwrap();
    let plants = PlantOptions::default();
    let (study, outcome) = import(&store, folder.path(), "lab", &[], &plants).await;
    assert_eq!(study.display_limit, Some(8.0));
    assert_eq!((outcome.imported, outcome.divergent, outcome.already_there), (3, 1, 1), "{outcome:?}");
    let reasons: BTreeMap<&str, &str> = outcome.refused.iter().map(|r| (r.file.as_str(), r.reason.as_str())).collect();
    assert_eq!(outcome.refused.len(), 6, "{reasons:?}");
    assert!(reasons["jitter.csv"].contains("grid"), "{reasons:?}");
    assert!(reasons["text.csv"].contains("high"), "{reasons:?}");
    assert!(reasons["missing.csv"].contains("No such file"), "{reasons:?}");
    assert!(reasons["../outside.csv"].contains("out of the folder"), "{reasons:?}");
    let of_one: Vec<_> = outcome.refused.iter().filter(|r| r.file == "one.csv").map(|r| r.reason.as_str()).collect();
    assert!(of_one[0].contains("group") && of_one[1].contains("--plant"), "{of_one:?}");
    assert!(outcome.notes.iter().any(|n| n.contains("stored already, as trial 2")), "{:?}", outcome.notes);
    assert!(outcome.notes.iter().any(|n| n.contains("equals trial 1 of subject S1")), "{:?}", outcome.notes);

    let before = stored(&store, &study).await;
    assert_eq!(before.len(), 2, "a refused file leaves no subject behind");
    let columns = &before[0].0.attributes[TRIAL_COLUMNS];
    assert_eq!((&columns["1"]["hand"], &columns["2"]["hand"]), (&"left".into(), &"right".into()));

    let (again, outcome) = import(&store, folder.path(), "lab", &[], &plants).await;
    assert_eq!((again.id, outcome.imported, outcome.already_there), (study.id, 0, 4));
    assert_eq!(stored(&store, &study).await, before, "a repetition changes nothing");
    store.close().await;
}

/// What the files do not say is said once, for all of a folder.
#[tokio::test]
async fn names_and_units_are_given_for_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    let mut text = "Zeit;Ziel;Kraft;Ort\n".to_owned();
    for i in 0..50 {
        let row = [20.0 * f64::from(i), 0.5, 0.25, f64::from(i) * 0.125];
        writeln!(text, "{}", row.map(|value| value.to_string().replace('.', ",")).join(";")).unwrap();
    }
    std::fs::write(folder.path().join("a.txt"), &text).unwrap();
    std::fs::write(folder.path().join("index.csv"), "file,subject,trial,plant\na.txt,S1,1,1/s\n").unwrap();
    let index = index::read(folder.path(), None, &[]).unwrap();
    let store = Store::open(None).await.unwrap();
    let study = find_or_create_study(&store, "named", None).await.unwrap();
    let plants = PlantOptions::default();
    let bare = Options::default();
    let refused = load(&store, &study, folder.path(), &index, &plants, &bare, &ProgressBar::hidden()).await.unwrap();
    assert!(refused.refused[0].reason.contains("columns=t:Zeit,r:Ziel,u:Kraft,y:?"), "{:?}", refused.refused);
    let options = Options {
        columns: columns("t:Zeit,r:Ziel,u:Kraft,y:Ort").unwrap(),
        time_unit: Some(TimeUnit::Milliseconds),
        ..Options::default()
    };
    let done = load(&store, &study, folder.path(), &index, &plants, &options, &ProgressBar::hidden()).await.unwrap();
    assert_eq!((done.imported, done.refused), (1, vec![]));
    assert_eq!(stored(&store, &study).await[0].1[0].sample_time_s, 0.02);
    store.close().await;
}

#[tokio::test]
async fn other_content_under_a_taken_number_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.csv"), recording(1.0)).unwrap();
    std::fs::write(folder.path().join("b.csv"), recording(2.0)).unwrap();
    std::fs::write(folder.path().join("index.csv"), "file,subject,trial\na.csv,S,1\nb.csv,S,1\n").unwrap();
    let store = Store::open(None).await.unwrap();
    let none = import(&store, folder.path(), "lab", &[], &PlantOptions::default()).await.1;
    assert!(none.refused.iter().all(|r| r.reason.contains("--plant")), "{none:?}");
    let model = volition::app::import::load::named_model("integrator").unwrap();
    let plants = PlantOptions { default: Some(("integrator".to_owned(), model)), ..PlantOptions::default() };
    let outcome = import(&store, folder.path(), "lab", &[], &plants).await.1;
    assert_eq!((outcome.imported, outcome.refused.len()), (1, 1));
    assert!(outcome.refused[0].reason.contains('1'), "{:?}", outcome.refused);
    store.close().await;
}

#[tokio::test]
async fn the_virtual_subjects_are_imported_with_the_metrics_of_their_truth() {
    let folder = crate::virtual_subjects::folder();
    let store = Store::open(None).await.unwrap();
    let (study, outcome) = import(&store, &folder, "virtual", &[], &PlantOptions::default()).await;
    assert_eq!((outcome.imported, outcome.refused.len(), outcome.divergent), (60, 0, 1), "{outcome:?}");
    let plants: Vec<_> = outcome.per_plant.iter().map(|(p, n)| (p.as_str(), *n)).collect();
    assert_eq!(plants.len(), 4);
    assert!(plants.contains(&("minimum_phase", 18)) && plants.contains(&("slow_nonminimum_phase", 18)), "{plants:?}");

    let text = std::fs::read_to_string(folder.join("truth.json")).unwrap();
    let truths: Vec<serde_json::Value> = serde_json::from_str(&text).unwrap();
    let stored = stored(&store, &study).await;
    let mut compared = 0;
    for truth in &truths {
        let (subject, trials) = stored.iter().find(|(s, _)| truth["subject"] == s.code.as_str()).unwrap();
        assert_eq!(truth["group"], subject.group.as_deref().unwrap());
        let trial = trials.iter().find(|t| truth["trial"] == t.number).unwrap();
        let error = trial.metrics["mean_abs_error"].as_f64().unwrap();
        assert!((error - truth["mean_abs_error"].as_f64().unwrap()).abs() < 5e-6, "{}", truth["file"]);
        assert_eq!(truth["divergent"], trial.divergent, "{}", truth["file"]);
        assert_eq!(subject.attributes[TRIAL_COLUMNS][trial.number.to_string()]["feedback"], truth["feedback"]);
        compared += 1;
    }
    assert_eq!(compared, 60);

    let (chirp, outcome) =
        import(&store, &folder, "chirp60 only", &["study=chirp60".parse().unwrap()], &PlantOptions::default()).await;
    assert_eq!((outcome.imported, outcome.subjects.len()), (54, 9));
    assert_ne!(chirp.id, study.id);
    store.close().await;
}

#[tokio::test]
async fn the_command_says_by_its_exit_code_whether_anything_was_refused() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.csv"), recording(1.0)).unwrap();
    std::fs::write(folder.path().join("index.csv"), "file,subject,trial,plant\na.csv,S,1,lab plant\n").unwrap();
    std::fs::write(folder.path().join("model.json"), r#"{"num": [1], "den": [1, 0]}"#).unwrap();
    let arguments = |plants: Vec<String>| ImportArgs {
        folder: folder.path().to_owned(),
        study: Some("lab".to_owned()),
        database: folder.path().join("lab.db"),
        index: None,
        plants,
        display_limit: None,
        conditions: Vec::new(),
        recompute: None,
        remember: false,
        reading: ReadingArgs::default(),
    };
    let code = |outcome: anyhow::Result<ExitCode>| format!("{:?}", outcome.unwrap());
    let (refused, success) = (format!("{:?}", ExitCode::from(2)), format!("{:?}", ExitCode::SUCCESS));
    assert_eq!(code(import_command(&arguments(Vec::new())).await), refused);
    let model = folder.path().join("model.json");
    assert_eq!(code(import_command(&arguments(vec![format!("lab plant={}", model.display())])).await), success);
    // The same plant name with another model: what is stored was computed with the first one.
    assert_eq!(code(import_command(&arguments(vec!["lab plant=1/(s+1)".to_owned()])).await), refused);
    let unreadable = import_command(&arguments(vec!["lab plant=1/s(s+1)".to_owned()])).await.unwrap_err();
    assert!(format!("{unreadable:#}").contains("parentheses"), "{unreadable:#}");
    let limit = ImportArgs { display_limit: Some(-1.0), ..arguments(Vec::new()) };
    assert!(import_command(&limit).await.unwrap_err().to_string().contains("-1"));
}
