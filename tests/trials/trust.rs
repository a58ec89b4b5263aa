//! Whether "do not use" tells bad estimates from good ones: on the demonstration's people, whose truth is known.

use std::collections::BTreeMap;
use std::process::ExitCode;
use volition::app::demo::simulate::truth;
use volition::app::demo::{BAND_HZ, DemoArgs, TRIALS, run};
use volition::config::{CacheArgs, ListenArgs};
use volition::learning::trust_grid::TrustCounts;
use volition::simulate::SimulatedStudy;
use volition::store::{Page, Store, StoredTrust, TrialFilter, TrustFilter};
use volition::trust::Level;

const ALL: Page = Page { after: None, limit: 100 };

/// Further than this from the truth, as a share of it, an estimate is bad.
const FAR: f64 = 0.25;

const DISTANCE: &str = "norm_feedforward_plant_minus_one";
const FEEDBACK: &str = "norm_feedback";

/// An estimate beside the truth.
struct Judged {
    study: usize,
    estimator: String,
    quantity: String,
    code: String,
    level: Level,
    /// How far it is from the truth, as a share of it.
    error: f64,
}

async fn demonstration(seed: u64) -> Vec<Judged> {
    let store = Store::open(None).await.unwrap();
    let subjects = 3;
    let args = DemoArgs {
        database: None,
        force: false,
        seed,
        subjects,
        html: None,
        serve: false,
        listen: ListenArgs { listen: "127.0.0.1:0".parse().unwrap(), port: None },
        compute_threads: None,
        cache: CacheArgs::default(),
    };
    let mut out = Vec::new();
    let code = run(&args, &store, &mut out).await.unwrap();
    assert_eq!(format!("{code:?}"), format!("{:?}", ExitCode::SUCCESS));
    let simulated = SimulatedStudy::two_groups(usize::from(subjects), TRIALS[TRIALS.len() - 1], seed).unwrap();
    let band = BAND_HZ.map(|hz| 2.0 * std::f64::consts::PI * hz);
    let truth = truth(&simulated, &TRIALS, (band[0], band[1])).unwrap();
    let mut all = Vec::new();
    // Oldest first: the command alone, then with a disturbance.
    for (place, study) in store.studies(ALL).await.unwrap().into_iter().enumerate() {
        let subjects = store.subjects(study.id, None, ALL).await.unwrap();
        let code_of: BTreeMap<_, _> = subjects.into_iter().map(|subject| (subject.id, subject.code)).collect();
        let filter = TrialFilter { include_divergent: true, ..TrialFilter::default() };
        let trials = store.matching_trials(study.id, &filter).await.unwrap();
        let trials: BTreeMap<_, _> = trials.into_iter().map(|trial| (trial.id, trial)).collect();
        for StoredTrust { trial, quantity, .. } in
            store.trust_of_study(study.id, &TrustFilter::default()).await.unwrap()
        {
            let record = &trials[&trial];
            let norms = &truth[&(code_of[&record.subject].clone(), record.number)];
            let trust = quantity.trust.in_trial(record.divergent);
            let real = match trust.quantity.as_str() {
                DISTANCE => norms.norm_feedforward_plant_minus_one,
                FEEDBACK => norms.norm_feedback,
                _ => continue,
            };
            let Some(value) = quantity.value else { continue };
            let real = real.unwrap();
            all.push(Judged {
                study: place,
                estimator: quantity.estimator.unwrap().name().to_owned(),
                quantity: trust.quantity,
                code: trust.code,
                level: trust.level,
                error: (value / real - 1.0).abs(),
            });
        }
    }
    store.close().await;
    all
}

/// Of bad and of good estimates: how many there are, and how many are marked as not to be used.
#[derive(Debug, Default, PartialEq, Eq, Clone, Copy)]
struct Rates {
    bad: [usize; 2],
    good: [usize; 2],
}

fn rates<'a>(all: impl Iterator<Item = &'a Judged>) -> Rates {
    let mut rates = Rates::default();
    for own in all {
        let count = if own.error > FAR { &mut rates.bad } else { &mut rates.good };
        count[1] += 1;
        count[0] += usize::from(own.level == Level::DoNotUse);
    }
    rates
}

fn print(all: &[Judged]) {
    let mut ways: BTreeMap<(usize, &str, &str), Vec<&Judged>> = BTreeMap::new();
    for own in all {
        ways.entry((own.study, &own.estimator, &own.quantity)).or_default().push(own);
    }
    for ((study, estimator, quantity), own) in &ways {
        let Rates { bad, good } = rates(own.iter().copied());
        let levels: Vec<Level> = own.iter().map(|one| one.level).collect();
        let mut codes: BTreeMap<&str, usize> = BTreeMap::new();
        for one in own {
            *codes.entry(&one.code).or_default() += 1;
        }
        let stimuli = ["command alone", "two stimuli"][*study % 2];
        println!(
            "{stimuli}, {estimator}, {quantity}: not to be used {} of {} bad, {} of {} good; {:?} {codes:?}",
            bad[0],
            bad[1],
            good[0],
            good[1],
            TrustCounts::of(&levels)
        );
    }
    let Rates { bad, good } = rates(all.iter());
    println!("all: not to be used {} of {} bad, {} of {} good", bad[0], bad[1], good[0], good[1]);
}

#[tokio::test]
async fn what_is_not_to_be_used_is_far_from_the_truth_more_often() {
    let all = demonstration(1).await;
    print(&all);
    let of = |study: usize, estimator: &str, quantity: &str| -> Vec<&Judged> {
        let own = |one: &&Judged| one.study == study && one.estimator == estimator && one.quantity == quantity;
        all.iter().filter(own).collect()
    };
    let counts = |own: &[&Judged]| TrustCounts::of(&own.iter().map(|one| one.level).collect::<Vec<_>>());
    let expected = |read: usize, do_not_use: usize, ok: usize| TrustCounts { read, do_not_use, ok, not_identified: 0 };
    assert_eq!(counts(&of(0, "ssid", FEEDBACK)), expected(0, 36, 0));
    assert_eq!(counts(&of(0, "ssid", DISTANCE)), expected(0, 36, 0));
}
