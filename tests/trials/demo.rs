//! The demonstration, from an empty database to learning curves.

use std::path::PathBuf;
use std::process::ExitCode;
use volition::app::demo::{DemoArgs, run};
use volition::config::{CacheArgs, ListenArgs};
use volition::store::{Page, Store};

const ALL: Page = Page { after: None, limit: 100 };

fn args(seed: u64, force: bool, html: Option<PathBuf>) -> DemoArgs {
    let listen = ListenArgs { listen: "127.0.0.1:0".parse().unwrap(), port: None };
    let cache = CacheArgs::default();
    let (database, serve, compute_threads) = (None, false, None);
    DemoArgs { database, force, seed, subjects: 2, html, serve, listen, compute_threads, cache }
}

async fn text(store: &Store, seed: u64, force: bool, html: Option<PathBuf>) -> String {
    let mut out = Vec::new();
    let code = run(&args(seed, force, html), store, &mut out).await.unwrap();
    let text = String::from_utf8(out).unwrap();
    assert_eq!(format!("{code:?}"), format!("{:?}", ExitCode::SUCCESS), "{text}");
    text
}

/// Without the line that says how long it took.
fn numbers(text: &str) -> Vec<&str> {
    text.lines().filter(|line| !line.contains(" s; the pool ") && !line.contains("as a page")).collect()
}

#[tokio::test]
async fn the_demonstration_tells_estimates_beside_the_truth_and_a_seed_decides_them() {
    let store = Store::open(None).await.unwrap();
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("demo.html");
    let first = text(&store, 7, false, Some(page.clone())).await;
    eprintln!("{first}");
    for expected in [
        "Group minimum_phase",
        "Group nonminimum_phase",
        "‖e‖",
        "pool, best candidate",
        "prediction error",
        "two stimuli",
        "none: no interval",
        "hold",
        "Next:",
        "volition compare",
    ] {
        assert!(first.contains(expected), "{expected} is missing in\n{first}");
    }
    // The same story, in one file without scripts or anything to fetch.
    let html = std::fs::read_to_string(&page).unwrap();
    assert!(html.starts_with("<!doctype html>") && html.contains("<svg") && html.contains("‖Gff G − 1‖"));
    assert!(!html.contains("<script") && !html.contains("http"), "{html}");
    let refused = run(&args(7, false, None), &store, &mut Vec::new()).await.unwrap_err();
    assert!(refused.to_string().contains("--force"), "{refused}");
    let again = text(&store, 7, true, None).await;
    assert_eq!(
        numbers(&first).iter().filter(|line| !line.is_empty()).collect::<Vec<_>>(),
        numbers(&again).iter().filter(|line| !line.is_empty()).collect::<Vec<_>>()
    );
    assert_eq!(store.studies(ALL).await.unwrap().len(), 4);
    store.close().await;
}

/// Of the trials with an interval nearly all hold the truth: what the column "trust" promises.
#[tokio::test]
async fn nearly_all_intervals_of_the_demonstration_hold_the_truth() {
    let store = Store::open(None).await.unwrap();
    let told = text(&store, 1, false, None).await;
    let mut held = [0, 0];
    for line in told.lines().filter(|line| line.trim_start().starts_with("prediction error")) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let Some(at) = words.iter().position(|word| *word == "of") else { continue };
        held[0] += words[at - 1].parse::<usize>().unwrap();
        held[1] += words[at + 1].parse::<usize>().unwrap();
    }
    eprintln!("{held:?}");
    assert!(held[1] >= 60 && held[0] * 10 >= held[1] * 8, "{held:?}\n{told}");
    store.close().await;
}
