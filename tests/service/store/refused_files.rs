//! Files that are no database of ours, or a damaged one.

use super::files::{open, place, tamper};
use super::*;
use std::path::Path;

fn assert_cannot_open(outcome: Result<Store, StoreError>, says: &str) {
    match outcome {
        Err(StoreError::CannotOpen { path, reason }) => {
            assert!(!path.is_empty());
            assert!(reason.contains(says), "{reason}");
        }
        other => panic!("expected that it cannot be opened ({says}), found {other:?}"),
    }
}

#[tokio::test]
async fn what_is_no_database_of_ours_is_refused_with_the_reason() {
    let (directory, path) = place();
    assert_cannot_open(Store::open(Some(directory.path())).await, "directory");
    let nowhere = directory.path().join("no/such/place.db");
    assert_cannot_open(Store::open(Some(&nowhere)).await, "cannot be created");
    assert!(!directory.path().join("no").exists());
    let text = directory.path().join("notes.txt");
    let words = "t,r,u,y\n0.0,1.0,2.0,3.0\n".repeat(500);
    std::fs::write(&text, &words).unwrap();
    assert_cannot_open(Store::open(Some(&text)).await, "not a database");
    assert_eq!(std::fs::read_to_string(&text).unwrap(), words, "what is not ours is not touched");
    let foreign = directory.path().join("music.db");
    tamper(&foreign, "CREATE TABLE songs (title TEXT)").await;
    assert_cannot_open(Store::open(Some(&foreign)).await, "another program");
    assert_cannot_open(Store::open(Some(Path::new("/dev/null"))).await, "regular file");
    // Read-only even for root.
    assert_cannot_open(Store::open(Some(Path::new("/proc/volition.db"))).await, "cannot be created");

    open(&path).await.close().await;
    tamper(&path, "INSERT INTO _sqlx_migrations VALUES (9999, 'from the future', '2030-01-01', TRUE, x'00', 1)").await;
    assert_cannot_open(Store::open(Some(&path)).await, "newer version");
    tamper(&path, "DELETE FROM _sqlx_migrations WHERE version = 9999").await;
    open(&path).await.close().await;
    tamper(&path, "UPDATE _sqlx_migrations SET checksum = x'00'").await;
    let edited = Store::open(Some(&path)).await;
    assert!(matches!(edited, Err(StoreError::Migration(_))), "{edited:?}");
}

#[tokio::test]
async fn a_damaged_file_is_refused_when_opened_or_read() {
    let (_directory, path) = place();
    let store = open(&path).await;
    store.create_study(new_study("Tracking"), None).await.unwrap();
    store.close().await;
    let mut file = std::fs::read(&path).unwrap();
    let header = file.len().min(4096);
    file[100..header].fill(0xA5);
    std::fs::write(&path, &file).unwrap();
    assert_cannot_open(Store::open(Some(&path)).await, "damaged");
}
