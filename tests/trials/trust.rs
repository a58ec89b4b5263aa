//! Whether "do not use" tells bad estimates from good ones: on the demonstration's people, whose truth is known.

use std::collections::BTreeMap;
use std::process::ExitCode;
use volition::app::demo::simulate::truth;
use volition::app::demo::{BAND_HZ, DemoArgs, TRIALS, run};
use volition::config::{CacheArgs, ListenArgs};
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

/// A way of estimating: stimuli, estimator, quantity.
type Way<'a> = (&'static str, &'a str, &'a str);

fn ways(all: &[Judged]) -> BTreeMap<Way<'_>, Vec<&Judged>> {
    let mut ways: BTreeMap<Way<'_>, Vec<&Judged>> = BTreeMap::new();
    for own in all {
        let stimuli = ["command alone", "two stimuli"][own.study % 2];
        ways.entry((stimuli, &own.estimator, &own.quantity)).or_default().push(own);
    }
    ways
}

/// As the table of `docs/trust.md` has them.
fn line((stimuli, estimator, quantity): Way<'_>, Rates { bad, good }: Rates) -> String {
    let norm = if quantity == FEEDBACK { "‖Gfb‖" } else { "‖Gff G − 1‖" };
    format!("| {stimuli} | `{estimator}` | {norm} | {} of {} | {} of {} |", bad[0], bad[1], good[0], good[1])
}

/// By the row that decides: how many bad and how many good estimates it marks.
fn by_code(all: &[Judged]) -> BTreeMap<&str, [usize; 2]> {
    let mut codes: BTreeMap<&str, [usize; 2]> = BTreeMap::new();
    for own in all.iter().filter(|own| own.level == Level::DoNotUse) {
        codes.entry(&own.code).or_default()[usize::from(own.error <= FAR)] += 1;
    }
    codes
}

/// Whether the share of one is larger than that of the other.
fn is_higher([marked, of]: [usize; 2], [other, of_others]: [usize; 2]) -> bool {
    marked * of_others > other * of
}

#[tokio::test]
async fn what_is_not_to_be_used_is_far_from_the_truth_more_often() {
    let all = demonstration(1).await;
    let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/trust.md")).unwrap();
    let lines: Vec<String> = ways(&all).into_iter().map(|(way, own)| line(way, rates(own.into_iter()))).collect();
    let codes: Vec<String> =
        by_code(&all).iter().map(|(code, [bad, good])| format!("| `{code}` | {bad} | {good} |")).collect();
    let Rates { bad, good } = rates(all.iter());
    println!(
        "{}\n{}\nall: {} of {} bad, {} of {} good",
        lines.join("\n"),
        codes.join("\n"),
        bad[0],
        bad[1],
        good[0],
        good[1]
    );
    assert!(is_higher(bad, good), "the rule does not separate: {bad:?} {good:?}");
    for estimator in ["prediction_error", "ssid", "ssid_refined"] {
        let Rates { bad, good } = rates(all.iter().filter(|own| own.estimator == estimator));
        assert!(is_higher(bad, good), "{estimator}: {bad:?} of the bad, {good:?} of the good");
    }
    // The page has these counts, so that a change of the rule is seen there.
    for line in lines.iter().chain(&codes) {
        assert!(page.contains(line), "docs/trust.md has not\n{line}\nbut\n{}\n{}", lines.join("\n"), codes.join("\n"));
    }
}
