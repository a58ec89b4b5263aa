use super::*;
use crate::property::from_seed;
use proptest::prelude::*;
use volition::analysis::References;
use volition::store::{Study, StudyPatch, TrialFilter, TrialPatch, TrialRecord};

#[tokio::test]
async fn a_trial_comes_back_as_it_was_given() {
    let bench = Bench::new().await;
    let (study, plant, subject) = bench.lab().await;
    let new = new_trial(plant, 2);
    let made = bench.store.create_trials(subject, vec![new.clone()], None).await.unwrap().remove(0).into_inner();
    assert_eq!((made.study, made.subject, made.plant), (study, subject, plant));
    assert_eq!((made.number, made.session, made.samples, made.has_disturbance), (2, Some(1), 400, true));
    assert_eq!((made.sample_time_s, made.max_abs_output), (0.02, new.max_abs_output));
    assert_eq!((made.sha256.clone(), made.metrics.clone(), made.divergent), (new.sha256, new.metrics, false));
    assert_eq!(bench.store.trial(made.id).await.unwrap(), made);
    assert_eq!(bench.store.trial_signals(made.id).await.unwrap(), new.trial);
    let nothing = TrialId(uuid::Uuid::nil());
    assert_not_found(bench.store.trial(nothing).await, "trial");
    assert_not_found(bench.store.trial_signals(nothing).await, "trial");
    assert_not_found(bench.store.delete::<TrialRecord>(nothing, None).await, "trial");
    assert_not_found(bench.store.change::<TrialRecord>(nothing, TrialPatch::default(), None).await, "trial");
}

#[tokio::test]
async fn a_trial_without_time_or_disturbance_has_none_afterwards() {
    let bench = Bench::new().await;
    let (_, plant, subject) = bench.lab().await;
    let signals = Signals {
        time_s: None,
        command: vec![-0.0; 9],
        control: vec![5e-324; 9],
        output: vec![0.0; 9],
        disturbance: None,
    };
    let new = of_trial(plant, 1, Trial::new(0.1, signals).unwrap());
    let made = bench.store.create_trials(subject, vec![new.clone()], None).await.unwrap().remove(0).into_inner();
    let back = bench.store.trial_signals(made.id).await.unwrap();
    assert_eq!(back, new.trial);
    assert!(back.signals.command.iter().all(|r| r.is_sign_negative()));
    assert!(!made.has_disturbance);
}

proptest! {
    #![proptest_config(from_seed(2, 24))]
    /// Through the database and back, to the bit.
    #[test]
    fn any_finite_signals_round_trip(words in prop::collection::vec(any::<u64>(), 2..200)) {
        let finite = |x: f64| if x.is_finite() { x } else { -0.0 };
        let column: Vec<f64> = words.iter().map(|w| finite(f64::from_bits(*w))).collect();
        let reversed: Vec<f64> = column.iter().rev().copied().collect();
        let signals = Signals {
            time_s: None, command: column.clone(), control: reversed, output: column.clone(), disturbance: Some(column),
        };
        let trial = Trial::new(0.01, signals).unwrap();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let back = runtime.block_on(async {
            let bench = Bench::new().await;
            let (_, plant, subject) = bench.lab().await;
            let mut new = of_trial(plant, 1, trial.clone());
            new.max_abs_output = 1.0;
            let id = bench.store.create_trials(subject, vec![new], None).await.unwrap().remove(0).into_inner().id;
            bench.store.trial_signals(id).await.unwrap()
        });
        // The hash goes by bits, where == would not tell -0 from 0.
        prop_assert_eq!(back.content_sha256(), trial.content_sha256());
    }
}

#[tokio::test]
async fn the_same_content_is_recognised_and_not_stored_again() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let first = bench.trial(subject, plant, 1).await;
    let mut renumbered = new_trial(plant, 1);
    renumbered.number = 9;
    let again = store.create_trials(subject, vec![renumbered, new_trial(plant, 2)], None).await.unwrap();
    let Created::Duplicate(known) = &again[0] else { panic!("{again:?}") };
    assert_eq!((known.id, known.number), (first, 1));
    assert!(is_new(&again[1]));
    // Twice within one request as well.
    let twice = store.create_trials(subject, vec![new_trial(plant, 3), new_trial(plant, 3)], None).await.unwrap();
    assert!(is_new(&twice[0]) && matches!(&twice[1], Created::Duplicate(_)));
    assert_eq!(store.trials(subject, EVERYTHING).await.unwrap().len(), 3);
    // Another person's recording with the same content is stored, and can be found for a warning.
    let other = bench.subject(study, "S02").await;
    let copy = bench.trial(other, plant, 1).await;
    let sha256 = new_trial(plant, 1).sha256;
    let found = |except| store.same_content(study, &sha256, except);
    assert_eq!(found(subject).await.unwrap().iter().map(|trial| trial.id).collect::<Vec<_>>(), [copy]);
    assert_eq!(found(other).await.unwrap().iter().map(|trial| trial.id).collect::<Vec<_>>(), [first]);
}

#[tokio::test]
async fn numbers_are_unique_within_subject_and_session() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let numbered = |content, number, session| NewTrial { number, session, ..new_trial(plant, content) };
    bench.trial(subject, plant, 1).await;
    let taken = store.create_trials(subject, vec![numbered(50, 2, Some(1)), numbered(51, 1, Some(1))], None).await;
    assert_conflict(taken, "trial_number_taken");
    assert_eq!(store.trials(subject, EVERYTHING).await.unwrap().len(), 1, "all or none");
    let free = vec![numbered(52, 1, Some(2)), numbered(53, 1, None)];
    assert!(store.create_trials(subject, free, None).await.unwrap().iter().all(is_new));
    assert_conflict(store.create_trials(subject, vec![numbered(54, 1, None)], None).await, "trial_number_taken");
    let other = bench.subject(study, "S02").await;
    assert!(is_new(&store.create_trials(other, vec![numbered(55, 1, Some(1))], None).await.unwrap()[0]));
}

#[tokio::test]
async fn a_trial_needs_its_subject_and_a_plant_of_the_same_study() {
    let bench = Bench::new().await;
    let (_, plant, subject) = bench.lab().await;
    let (_, foreign_plant, _) = bench.lab().await;
    let nobody = SubjectId(uuid::Uuid::nil());
    assert_not_found(bench.store.create_trials(nobody, vec![new_trial(plant, 1)], None).await, "subject");
    assert_not_found(bench.store.create_trials(subject, vec![new_trial(foreign_plant, 1)], None).await, "plant");
    let forged = NewTrial { sha256: "0".repeat(64), ..new_trial(plant, 1) };
    let refused = bench.store.create_trials(subject, vec![forged], None).await;
    assert!(matches!(refused, Err(StoreError::Damaged(_))), "{refused:?}");
    assert_eq!(bench.store.trials(subject, EVERYTHING).await.unwrap(), []);
}

#[tokio::test]
async fn a_trial_can_be_renumbered_but_not_onto_another() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (_, plant, subject) = bench.lab().await;
    let (first, second) = (bench.trial(subject, plant, 1).await, bench.trial(subject, plant, 2).await);
    let number = |number| TrialPatch { number: Some(number), session: None, ..TrialPatch::default() };
    assert_conflict(store.change::<TrialRecord>(second, number(1), None).await, "trial_number_taken");
    let moved = store
        .change::<TrialRecord>(
            second,
            TrialPatch { number: Some(1), session: Some(None), ..TrialPatch::default() },
            Some(1),
        )
        .await
        .unwrap();
    assert_eq!((moved.number, moved.session, moved.version), (1, None, 2));
    assert_stale(store.change::<TrialRecord>(second, number(5), Some(1)).await);
    assert_eq!(store.change::<TrialRecord>(second, TrialPatch::default(), Some(2)).await.unwrap(), moved);
    let moved = store
        .change::<TrialRecord>(first, TrialPatch { session: Some(Some(4)), ..TrialPatch::default() }, None)
        .await
        .unwrap();
    assert_eq!((moved.number, moved.session), (1, Some(4)));
    assert_stale(store.delete::<TrialRecord>(first, Some(1)).await);
    store.delete::<TrialRecord>(first, Some(2)).await.unwrap();
    assert_not_found(store.trial(first).await, "trial");
}

#[tokio::test]
async fn divergence_follows_the_present_limit_and_shows_in_the_version() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let (small, large) = (bench.trial(subject, plant, 1).await, {
        let large = NewTrial { max_abs_output: 2.5, ..new_trial(plant, 2) };
        store.create_trials(subject, vec![large], None).await.unwrap().remove(0).into_inner().id
    });
    let seen = async |id| {
        let trial = store.trial(id).await.unwrap();
        (trial.divergent, trial.version)
    };
    assert_eq!((seen(small).await, seen(large).await), ((false, 1), (true, 1)));
    let limit = async |limit| {
        let patch = StudyPatch { display_limit: Some(limit), ..StudyPatch::default() };
        store.change::<Study>(study, patch, None).await.unwrap();
    };
    // The limit itself is not passed.
    limit(Some(2.5)).await;
    assert_eq!((seen(small).await, seen(large).await), ((false, 1), (false, 2)));
    limit(Some(0.1)).await;
    assert_eq!((seen(small).await, seen(large).await), ((true, 2), (true, 3)));
    limit(None).await;
    assert_eq!((seen(small).await, seen(large).await), ((false, 3), (false, 4)));
}

#[tokio::test]
async fn filters_find_what_they_name_in_a_stable_order() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let spring = store.create_plant(study, new_plant("spring"), None).await.unwrap().into_inner().id;
    let gn = NewSubject { group: Some("gn".into()), ..new_subject("S02") };
    let other = store.create_subject(study, gn, None).await.unwrap().into_inner().id;
    let numbered = |content, plant, number, session| NewTrial { number, session, ..new_trial(plant, content) };
    let made = vec![
        numbered(1, plant, 3, Some(2)),
        numbered(2, plant, 1, Some(2)),
        numbered(3, spring, 2, Some(1)),
        numbered(4, plant, 9, None),
        NewTrial { max_abs_output: 99.0, ..numbered(5, plant, 1, Some(1)) },
    ];
    store.create_trials(subject, made, None).await.unwrap();
    store.create_trials(other, vec![numbered(6, plant, 1, Some(1))], None).await.unwrap();
    let find = async |filter: TrialFilter| -> Vec<(i64, Option<i64>)> {
        let found = store.matching_trials(study, &filter).await.unwrap();
        found.iter().map(|trial| (trial.number, trial.session)).collect()
    };
    let all = TrialFilter::default;
    assert_eq!(find(all()).await, [(9, None), (2, Some(1)), (1, Some(2)), (3, Some(2)), (1, Some(1))]);
    assert_eq!(find(TrialFilter { group: Some("gn".into()), ..all() }).await, [(1, Some(1))]);
    assert_eq!(find(TrialFilter { group: Some("no such".into()), ..all() }).await, []);
    assert_eq!(find(TrialFilter { plant: Some(spring), ..all() }).await, [(2, Some(1))]);
    assert_eq!(find(TrialFilter { session: Some(2), ..all() }).await, [(1, Some(2)), (3, Some(2))]);
    assert_eq!(
        find(TrialFilter { number_from: Some(2), number_to: Some(3), ..all() }).await,
        [(2, Some(1)), (3, Some(2))]
    );
    let with_divergent = TrialFilter { subject: Some(subject), include_divergent: true, ..all() };
    assert_eq!(find(with_divergent).await, [(9, None), (1, Some(1)), (2, Some(1)), (1, Some(2)), (3, Some(2))]);
}

#[tokio::test]
async fn the_library_holds_recordings_with_their_plants() {
    let bench = Bench::new().await;
    let (_, plant, subject) = bench.lab().await;
    let trials = vec![bench.trial(subject, plant, 1).await, bench.trial(subject, plant, 2).await];
    let references = References { trials: trials.clone(), plants: vec![plant], ..References::default() };
    let library = bench.store.library(&references).await.unwrap();
    assert_eq!(library.plants[&plant], model());
    let stored = &library.trials[&trials[1]];
    let new = new_trial(plant, 2);
    assert_eq!(
        (&stored.trial, &stored.sha256, &stored.plant, stored.divergent),
        (&new.trial, &new.sha256, &model(), false)
    );
    bench.store.delete::<TrialRecord>(trials[0], None).await.unwrap();
    assert_not_found(bench.store.library(&references).await, "trial");
    let no_plant = References { trials: vec![], plants: vec![PlantId(uuid::Uuid::nil())], ..References::default() };
    assert_not_found(bench.store.library(&no_plant).await, "plant");
}
