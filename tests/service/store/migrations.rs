//! Databases of every earlier schema are brought up to date, with nothing lost and a copy kept.

use super::files::{meddle, place};
use super::*;
use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::{Connection as _, SqlSafeStr as _};
use std::path::Path;
use volition::store::verify_file;

/// The steps, as the files have them: version, description and statements.
fn steps() -> Vec<(i64, String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("migrations");
    let mut steps: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "sql"))
        .map(|path| {
            let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
            let (version, description) = name.split_once('_').unwrap();
            let sql = std::fs::read_to_string(&path).unwrap();
            (version.parse().unwrap(), description.replace('_', " "), sql)
        })
        .collect();
    steps.sort();
    steps
}

/// A database as the program of that step left it.
async fn database_of(path: &Path, steps: &[(i64, String, String)]) {
    let migrations = steps.iter().map(|(version, description, sql)| {
        let sql = sqlx::AssertSqlSafe(sql.clone()).into_sql_str();
        Migration::new(*version, description.clone().into(), MigrationType::Simple, sql, false)
    });
    let mut connection = meddle(path).await;
    Migrator::with_migrations(migrations.collect()).run(&mut connection).await.unwrap();
    connection.close().await.unwrap();
}

#[tokio::test]
async fn a_database_of_every_earlier_schema_is_brought_up_to_date() {
    let steps = steps();
    assert!(steps.len() >= 5 && steps[0].0 == 1, "{steps:?}");
    // What the newest program writes, row by row, in the columns of the oldest schema.
    let (_source_directory, source) = place();
    let store = Store::open(Some(&source)).await.unwrap();
    let study = store.create_study(new_study("Tracking"), None).await.unwrap().into_inner();
    let plant = store.create_plant(study.id, new_plant("mass"), None).await.unwrap().into_inner();
    let subject = store.create_subject(study.id, new_subject("S01"), None).await.unwrap().into_inner();
    let made = store.create_trials(subject.id, vec![new_trial(plant.id, 1)], None).await.unwrap();
    let trial = made.into_iter().next().unwrap().into_inner();
    let mut waiting = Vec::new();
    for _ in 0..3 {
        waiting.push(store.create_analysis(new_analysis(vec![trial.id]), None).await.unwrap().into_inner().id);
    }
    let done = store.claim("w", 15.0).await.unwrap().unwrap().lease;
    assert_eq!(done.analysis, waiting.remove(0));
    assert!(store.succeed(&done, &report(0.1)).await.unwrap());
    let text = store.report_json(done.analysis).await.unwrap();
    let counts = store.count_by_status().await.unwrap();
    store.close().await;

    for newest in 0..steps.len() - 1 {
        let earlier = &steps[..=newest];
        let (_directory, path) = place();
        database_of(&path, earlier).await;
        let mut connection = meddle(&path).await;
        let attach = sqlx::AssertSqlSafe(format!("ATTACH '{}' AS source", source.display()));
        sqlx::raw_sql(attach).execute(&mut connection).await.unwrap();
        for table in ["studies", "plants", "subjects", "trials", "trial_signals", "analyses", "analysis_trials"] {
            let of = |schema: &str| {
                sqlx::AssertSqlSafe(format!("SELECT name FROM pragma_table_info('{table}', '{schema}')"))
            };
            let old: Vec<String> = sqlx::query_scalar(of("main")).fetch_all(&mut connection).await.unwrap();
            let all: Vec<String> = sqlx::query_scalar(of("source")).fetch_all(&mut connection).await.unwrap();
            let kept: Vec<String> = old.into_iter().filter(|column| all.contains(column)).collect();
            let columns = kept.join(", ");
            let copy = format!("INSERT INTO main.{table} ({columns}) SELECT {columns} FROM source.{table}");
            sqlx::raw_sql(sqlx::AssertSqlSafe(copy)).execute(&mut connection).await.unwrap();
        }
        connection.close().await.unwrap();
        let version = earlier.last().unwrap().0;

        let store = Store::open(Some(&path)).await.unwrap();
        assert_eq!(store.study(study.id).await.unwrap(), study, "step {version}");
        assert_eq!(store.plant(plant.id).await.unwrap(), plant);
        assert_eq!(store.subject(subject.id).await.unwrap(), subject);
        assert_eq!(store.trial(trial.id).await.unwrap(), trial);
        assert_eq!(store.trial_signals(trial.id).await.unwrap(), new_trial(plant.id, 1).trial);
        assert_eq!(store.report_json(done.analysis).await.unwrap(), text);
        assert_eq!(store.count_by_status().await.unwrap(), counts);
        for expected in &waiting {
            assert_eq!(store.claim("w", 15.0).await.unwrap().unwrap().lease.analysis, *expected, "step {version}");
        }
        store.ping().await.unwrap();
        store.close().await;
        assert!(verify_file(&path).await.unwrap().is_sound(), "step {version}");

        // As it was, beside it, and still to be opened.
        let copy = path.with_file_name(format!("volition.db.step{version}"));
        assert!(copy.exists(), "no copy of step {version}");
        let mut old = meddle(&copy).await;
        let has: i64 =
            sqlx::query_scalar("SELECT max(version) FROM _sqlx_migrations").fetch_one(&mut old).await.unwrap();
        let rows: i64 = sqlx::query_scalar("SELECT count(*) FROM analyses").fetch_one(&mut old).await.unwrap();
        assert_eq!((has, rows), (version, 3));
        old.close().await.unwrap();
    }
    // A new database, or one that is up to date, leaves no copy.
    let store = Store::open(Some(&source)).await.unwrap();
    store.close().await;
    let left: Vec<_> =
        std::fs::read_dir(source.parent().unwrap()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(left, [source]);
}
