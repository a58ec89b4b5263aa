//! Keyset pages: complete, in order of creation, without repeats, whatever is added or deleted meanwhile.

use super::*;
use uuid::Uuid;
use volition::store::Study;

/// Walks a list in pages of three.
async fn walk<T>(mut page_of: impl AsyncFnMut(Page) -> Vec<T>, id: impl Fn(&T) -> Uuid) -> Vec<Uuid> {
    let mut found = Vec::new();
    let mut after = None;
    loop {
        let page = page_of(Page { after, limit: 3 }).await;
        assert!(page.len() <= 3);
        found.extend(page.iter().map(&id));
        match page.last() {
            Some(last) => after = Some(id(last)),
            None => return found,
        }
    }
}

#[tokio::test]
async fn pages_walk_every_list_in_order_of_creation() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let (mut studies, mut plants, mut subjects) = (vec![study.0], vec![plant.0], vec![subject.0]);
    let (mut trials, mut analyses) = (Vec::new(), Vec::new());
    for k in 1..=7 {
        studies.push(bench.study().await.0);
        let plant = store.create_plant(study, new_plant(&format!("plant {k}")), None).await.unwrap().into_inner().id;
        plants.push(plant.0);
        subjects.push(bench.subject(study, &format!("T{k:02}")).await.0);
        trials.push(bench.trial(subject, plant, k).await.0);
        analyses.push(bench.queue().await.0);
    }
    // Somebody else's, which must not show up.
    bench.lab().await;
    let study_ids = walk(async |page| store.studies(page).await.unwrap(), |row| row.id.0).await;
    assert_eq!(study_ids[..8], studies[..]);
    assert_eq!(walk(async |page| store.plants(study, page).await.unwrap(), |row| row.id.0).await, plants);
    assert_eq!(walk(async |page| store.subjects(study, None, page).await.unwrap(), |row| row.id.0).await, subjects);
    assert_eq!(walk(async |page| store.trials(subject, page).await.unwrap(), |row| row.id.0).await, trials);
    let found = walk(async |page| store.analyses(Default::default(), page).await.unwrap(), |row| row.id.0).await;
    assert_eq!(found, analyses);
}

#[tokio::test]
async fn a_page_after_a_deleted_row_goes_on_where_it_was() {
    let bench = Bench::new().await;
    let mut ids = Vec::new();
    for _ in 0..5 {
        ids.push(bench.study().await);
    }
    let page = bench.store.studies(Page { after: None, limit: 2 }).await.unwrap();
    assert_eq!(page.iter().map(|study| study.id).collect::<Vec<_>>(), ids[..2]);
    bench.store.delete::<Study>(ids[1], None).await.unwrap();
    let page = bench.store.studies(Page { after: Some(ids[1].0), limit: 2 }).await.unwrap();
    assert_eq!(page.iter().map(|study| study.id).collect::<Vec<_>>(), ids[2..4]);
}

#[tokio::test]
async fn subjects_can_be_listed_by_group() {
    let bench = Bench::new().await;
    let study = bench.study().await;
    bench.subject(study, "S01").await;
    let gn = NewSubject { group: Some("gn".into()), ..new_subject("S02") };
    let gn = bench.store.create_subject(study, gn, None).await.unwrap().into_inner();
    let without = NewSubject { group: None, ..new_subject("S03") };
    bench.store.create_subject(study, without, None).await.unwrap();
    assert_eq!(bench.store.subjects(study, Some("gn"), EVERYTHING).await.unwrap(), [gn]);
    assert_eq!(bench.store.subjects(study, None, EVERYTHING).await.unwrap().len(), 3);
}
