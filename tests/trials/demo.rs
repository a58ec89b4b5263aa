//! The demonstration, from an empty database to learning curves.

use std::process::ExitCode;
use volition::app::demo::{DemoArgs, run};
use volition::config::CacheArgs;
use volition::store::{Page, Store};

const ALL: Page = Page { after: None, limit: 100 };

fn args(seed: u64, force: bool) -> DemoArgs {
    DemoArgs { database: None, force, seed, subjects: 1, compute_threads: None, cache: CacheArgs::default() }
}

async fn text(store: &Store, seed: u64, force: bool) -> String {
    let mut out = Vec::new();
    let code = run(&args(seed, force), store, &mut out).await.unwrap();
    let text = String::from_utf8(out).unwrap();
    assert_eq!(format!("{code:?}"), format!("{:?}", ExitCode::SUCCESS), "{text}");
    text
}

/// Without the line that says how long it took.
fn numbers(text: &str) -> Vec<&str> {
    text.lines().filter(|line| !line.contains(" s, pool ")).collect()
}

#[tokio::test]
async fn the_demonstration_ends_with_learning_curves_and_a_seed_decides_them() {
    let store = Store::open(None).await.unwrap();
    let first = text(&store, 7, false).await;
    eprintln!("{first}");
    for expected in ["Group minimum_phase", "Group nonminimum_phase", "‖e‖", "‖Gff G − 1‖", "‖Gfb‖", "Reading: "]
    {
        assert!(first.contains(expected), "{expected} is missing in\n{first}");
    }
    let refused = run(&args(7, false), &store, &mut Vec::new()).await.unwrap_err();
    assert!(refused.to_string().contains("--force"), "{refused}");
    let again = text(&store, 7, true).await;
    assert_eq!(numbers(&first), numbers(&again));
    assert_eq!(store.studies(ALL).await.unwrap().len(), 2);
    store.close().await;
}
