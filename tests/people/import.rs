//! The folder is imported as its index stands.

use crate::recordings::folder;
use indicatif::ProgressBar;
use std::path::Path;
use volition::app::import::index;
use volition::app::import::load::{Outcome, PlantOptions, common_display_limit, find_or_create_study, load};
use volition::exchange::Options;
use volition::exchange::tables::study::TRIAL_COLUMNS;
use volition::store::{Page, Store, Study};

const ALL: Page = Page { after: None, limit: 500 };

async fn imported(store: &Store, folder: &Path) -> (Study, Outcome) {
    let index = index::read(folder, None, &[]).unwrap();
    let study = find_or_create_study(store, "cphs", common_display_limit(&index).unwrap()).await.unwrap();
    let (plants, reading) = (PlantOptions::default(), Options::default());
    let outcome = load(store, &study, folder, &index, &plants, &reading, &ProgressBar::hidden()).await.unwrap();
    (study, outcome)
}

#[tokio::test]
async fn real_people_are_imported_as_their_index_stands() {
    let folder = folder();
    let store = Store::open(None).await.unwrap();
    let (study, outcome) = imported(&store, &folder).await;
    assert_eq!((outcome.imported, outcome.refused.len()), (120, 0), "{outcome:?}");
    let plants: Vec<_> = outcome.per_plant.iter().map(|(p, n)| (p.as_str(), *n)).collect();
    assert_eq!(plants, [("1/(s(s+1))", 60), ("1/s", 60)]);
    let stored = store.subjects(study.id, None, ALL).await.unwrap();
    assert_eq!(stored.len(), 2);
    for subject in &stored {
        let trials = store.trials(subject.id, ALL).await.unwrap();
        assert_eq!(trials.len(), 60);
        assert!(trials.iter().all(|t| (t.sample_time_s - 1.0 / 60.0).abs() < 1e-6), "{}", trials[0].sample_time_s);
        assert!(subject.attributes[TRIAL_COLUMNS]["31"]["protocol"].is_string());
    }
    store.close().await;
}
