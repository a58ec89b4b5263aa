use super::*;
use volition::analysis::estimates::KeptEstimate;
use volition::analysis::ids::AnalysisId;
use volition::analysis::prediction_error;
use volition::jobs::{Event, Job, Status};
use volition::store::{AnalysisFilter, AnalysisRecord, Claim, Lease, RunFilter, RunProgress};

#[tokio::test]
async fn an_analysis_comes_back_as_it_was_asked_for() {
    let bench = Bench::new().await;
    let (study, plant, subject) = bench.lab().await;
    let trial = bench.trial(subject, plant, 1).await;
    let new = NewAnalysis { plants: vec![plant], ..new_analysis(vec![trial]) };
    let made = bench.store.create_analysis(new.clone(), None).await.unwrap();
    assert!(is_new(&made));
    let made = made.into_inner();
    assert_eq!(bench.store.analysis(made.id).await.unwrap(), made);
    assert_eq!(
        (made.study, made.kind, &made.request, &made.spec_sha256),
        (Some(study), ssid::Plan::KIND, &new.request, &new.spec_sha256)
    );
    assert_eq!((made.status, made.attempts, made.cancel_requested, made.version), (Status::Queued, 0, false, 1));
    assert_eq!((made.started_at, made.finished_at, made.problem, made.eta_s), (None, None, None, None));
    let nothing = AnalysisId(uuid::Uuid::nil());
    assert_not_found(bench.store.analysis(nothing).await, "analysis");
    assert_not_found(bench.store.report_json(nothing).await, "analysis");
    assert_not_found(bench.store.request_cancel(nothing).await, "analysis");
    assert_not_found(bench.store.delete::<AnalysisRecord>(nothing, None).await, "analysis");
}

#[tokio::test]
async fn what_an_analysis_names_must_exist_in_one_study() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let (other_study, other_plant, _) = bench.lab().await;
    let trial = bench.trial(subject, plant, 1).await;
    assert_not_found(store.create_analysis(new_analysis(vec![TrialId(uuid::Uuid::nil())]), None).await, "trial");
    let no_plant = NewAnalysis { plants: vec![PlantId(uuid::Uuid::nil())], ..new_analysis(vec![trial]) };
    assert_not_found(store.create_analysis(no_plant, None).await, "plant");
    let no_study = NewAnalysis { study: Some(StudyId(uuid::Uuid::nil())), ..new_analysis(Vec::new()) };
    assert_not_found(store.create_analysis(no_study, None).await, "study");
    let elsewhere = NewAnalysis { study: Some(other_study), ..new_analysis(vec![trial]) };
    assert_conflict(store.create_analysis(elsewhere, None).await, "other_study");
    let mixed = NewAnalysis { plants: vec![other_plant], ..new_analysis(vec![trial]) };
    assert_conflict(store.create_analysis(mixed, None).await, "other_study");
    // One that is wrong keeps the others out as well.
    let batch = vec![
        NewAnalysis { study: Some(study), ..new_analysis(vec![trial]) },
        NewAnalysis { study: Some(study), ..new_analysis(vec![TrialId(uuid::Uuid::nil())]) },
    ];
    assert_not_found(store.create_analyses(batch, None).await, "trial");
    assert_eq!(store.analyses(AnalysisFilter::default(), EVERYTHING).await.unwrap(), []);
}

#[tokio::test]
async fn lists_filter_by_study_trial_kind_and_status() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let (one, two) = (bench.trial(subject, plant, 1).await, bench.trial(subject, plant, 2).await);
    let of = async |new| store.create_analysis(new, None).await.unwrap().into_inner().id;
    let a = of(new_analysis(vec![one])).await;
    let b = of(new_analysis(vec![one, two])).await;
    let c = of(NewAnalysis { kind: frequency_response::Plan::KIND, ..new_analysis(vec![two]) }).await;
    let d = of(new_analysis(Vec::new())).await;
    store.request_cancel(b).await.unwrap();
    let list = async |filter: AnalysisFilter| -> Vec<AnalysisId> {
        store.analyses(filter, EVERYTHING).await.unwrap().iter().map(|row| row.id).collect()
    };
    let all = AnalysisFilter::default;
    assert_eq!(list(all()).await, [a, b, c, d]);
    assert_eq!(list(AnalysisFilter { study: Some(study), ..all() }).await, [a, b, c]);
    assert_eq!(list(AnalysisFilter { trial: Some(one), ..all() }).await, [a, b]);
    assert_eq!(list(AnalysisFilter { trial: Some(two), ..all() }).await, [b, c]);
    assert_eq!(list(AnalysisFilter { kind: Some(frequency_response::Plan::KIND), ..all() }).await, [c]);
    assert_eq!(list(AnalysisFilter { status: Some(Status::Cancelled), ..all() }).await, [b]);
    assert_eq!(list(AnalysisFilter { trial: Some(one), status: Some(Status::Queued), ..all() }).await, [a]);
    let counts = store.count_by_status().await.unwrap();
    let expected = [3, 0, 0, 0, 1];
    assert_eq!(counts, Status::ALL.into_iter().zip(expected).collect::<Vec<_>>());
}

#[tokio::test]
async fn a_run_counts_what_was_asked_for_in_the_same_way() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (study, plant, subject) = bench.lab().await;
    let trial = bench.trial(subject, plant, 1).await;
    let other_spec = "6".repeat(64);
    let of = async |new: NewAnalysis| store.create_analysis(new, None).await.unwrap().into_inner().id;
    for _ in 0..4 {
        of(new_analysis(vec![trial])).await;
    }
    of(NewAnalysis { spec_sha256: other_spec.clone(), ..new_analysis(vec![trial]) }).await;
    for seconds in [3.0, 1.5] {
        let lease = store.claim("w", 15.0).await.unwrap().unwrap().lease;
        bench.pass(seconds);
        assert!(store.succeed(&lease, &report(1.0)).await.unwrap());
    }
    let lease = store.claim("w", 15.0).await.unwrap().unwrap().lease;
    bench.pass(100.0);
    store.fail(&lease, &problem()).await.unwrap();
    store.claim("w", 15.0).await.unwrap().unwrap();
    // Afterwards: other lines would take turns with this one.
    of(NewAnalysis { kind: frequency_response::Plan::KIND, ..new_analysis(vec![trial]) }).await;
    of(new_analysis(Vec::new())).await;

    let progress = async |run: RunFilter| {
        let RunProgress { counts, latest_s } = store.run_progress(study, &run).await.unwrap();
        assert_eq!(counts.iter().map(|(status, _)| *status).collect::<Vec<_>>(), Status::ALL);
        (counts.into_iter().map(|(_, count)| count).collect::<Vec<_>>(), latest_s)
    };
    // In the order of `Status::ALL`; the latest first, and of those that succeeded only.
    assert_eq!(progress(RunFilter::default()).await, (vec![2, 1, 2, 1, 0], vec![1.5, 3.0]));
    let ssid = RunFilter { kind: Some(ssid::Plan::KIND), ..RunFilter::default() };
    assert_eq!(progress(ssid.clone()).await.0, [1, 1, 2, 1, 0]);
    let other = RunFilter { spec_sha256: Some(other_spec), ..ssid };
    assert_eq!(progress(other).await, (vec![1, 0, 0, 0, 0], vec![]));
    let nobody = StudyId(uuid::Uuid::nil());
    assert_not_found(store.run_progress(nobody, &RunFilter::default()).await, "study");
}

#[tokio::test]
async fn estimates_of_trials_are_of_single_trials_oldest_first() {
    let bench = Bench::new().await;
    let store = &bench.store;
    let (_, plant, subject) = bench.lab().await;
    let (one, two) = (bench.trial(subject, plant, 1).await, bench.trial(subject, plant, 2).await);
    let done = async |new: NewAnalysis, report: Report| {
        let id = store.create_analysis(new, None).await.unwrap().into_inner().id;
        let lease = store.claim("w", 15.0).await.unwrap().unwrap().lease;
        assert_eq!(lease.analysis, id);
        assert!(store.succeed(&lease, &report).await.unwrap());
        id
    };
    let first = done(new_analysis(vec![one]), report(1.0)).await;
    done(new_analysis(vec![one, two]), report(2.0)).await;
    done(NewAnalysis { kind: frequency_response::Plan::KIND, ..new_analysis(vec![one]) }, {
        Report { kind: frequency_response::Plan::KIND, ..report(3.0) }
    })
    .await;
    let again = done(NewAnalysis { spec_sha256: "6".repeat(64), ..new_analysis(vec![one]) }, report(4.0)).await;
    let of_two = done(new_analysis(vec![two]), report(5.0)).await;
    // Its result goes trial by trial.
    let norm = |value: f64| json!({"metrics": {}, "stable": true, "accounted_for": {"simulated_y": value}});
    let several = Report::new(
        prediction_error::Plan::KIND,
        1,
        json!({"trials": [norm(0.1), norm(0.2)]}),
        Vec::new(),
        json!({}),
        Default::default(),
        None,
    );
    let both = done(NewAnalysis { kind: prediction_error::Plan::KIND, ..new_analysis(vec![one, two]) }, several).await;
    store.create_analysis(new_analysis(vec![two]), None).await.unwrap();
    let lease = store.claim("w", 15.0).await.unwrap().unwrap().lease;
    store.fail(&lease, &problem()).await.unwrap();
    store.create_analysis(new_analysis(vec![two]), None).await.unwrap();

    let found = store.estimates_of_trials(&[two, one], None).await.unwrap().found;
    let brief: Vec<_> = found.iter().map(|own| (own.trial, own.analysis, own.estimator.as_str())).collect();
    assert_eq!(brief, [(two, of_two, "ssid"), (one, first, "ssid"), (one, again, "ssid")]);
    assert_eq!(found[2].spec_sha256, "6".repeat(64));
    // A report that cannot be read says why, as often as it is asked.
    assert!(matches!(&found[0].estimate, KeptEstimate::Refused(why) if why.contains("feedforward")), "{found:?}");
    assert_eq!(store.estimates_of_trials(&[], None).await.unwrap(), Default::default());
    // Those of several trials, each with its position among them, of the estimator that is asked for.
    let joint = store.estimates_of_trials(&[two, one], Some("prediction_error")).await.unwrap().found;
    let several: Vec<_> = joint.iter().filter(|own| own.estimator == "prediction_error").collect();
    let brief: Vec<_> = several.iter().map(|own| (own.trial, own.position, own.analysis)).collect();
    assert_eq!(brief, [(two, 1, both), (one, 0, both)]);
    assert_eq!(joint.len(), 5);
}

/// What the pure rules and the database look at, side by side.
fn seen(record: &AnalysisRecord) -> Job {
    Job { status: record.status, attempts: record.attempts, cancel_requested: record.cancel_requested }
}

/// Longer than any history takes, so that a lease runs out only where a history says so.
const LEASE_S: f64 = 1000.0;
/// Longer than any rescued job waits.
const PAST_EVERY_WAIT_S: f64 = 100.0;

/// Makes an event happen in the store as far as the store lets it.
async fn happen(bench: &Bench, id: AnalysisId, held: &mut Option<Claim>, event: Event) {
    let store = &bench.store;
    // The latest lease, or one that never was: the store must refuse the latter as the rules refuse the event.
    let never = Lease { analysis: id, token: "never given".into() };
    let lease = held.as_ref().map_or(never, |claim| claim.lease.clone());
    match event {
        Event::Claim => {
            if let Some(claim) = store.claim("w", LEASE_S).await.unwrap() {
                *held = Some(claim);
            }
        }
        Event::Succeed => drop(store.succeed(&lease, &report(1.0)).await.unwrap()),
        Event::Fail => drop(store.fail(&lease, &problem()).await.unwrap()),
        Event::RequestCancel => drop(store.request_cancel(id).await.unwrap()),
        Event::ConfirmCancel => drop(store.confirm_cancel(&lease).await.unwrap()),
        Event::Release => drop(store.release(&lease).await.unwrap()),
        Event::WorkerDied { max_attempts } => {
            // Whoever has not looked for long begins to watch anew, and looks several times in a lease.
            for _ in 0..5 {
                bench.pass(LEASE_S / 4.0);
                store.rescue(max_attempts).await.unwrap();
            }
        }
    }
    bench.pass(PAST_EVERY_WAIT_S);
}

/// Every sequence of four events: the store does what the rules say, and nothing where they forbid it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_store_follows_the_rules_in_every_short_history() {
    let events = [
        Event::Claim,
        Event::Succeed,
        Event::Fail,
        Event::RequestCancel,
        Event::ConfirmCancel,
        Event::Release,
        Event::WorkerDied { max_attempts: 2 },
    ];
    let bench = Bench::new().await;
    let mut histories: Vec<Vec<Event>> = vec![Vec::new()];
    for _ in 0..4 {
        let longer = |history: Vec<Event>| events.map(|event| [history.clone(), vec![event]].concat());
        histories = histories.into_iter().flat_map(longer).collect();
    }
    // Histories that begin with something illegal only repeat shorter ones; one of each is enough.
    histories.retain(|history| {
        matches!(history[0], Event::Claim | Event::RequestCancel) || history[1..] == [Event::Claim; 3]
    });
    for history in histories {
        let id = bench.queue().await;
        let (mut job, mut held) = (Job::new(), None);
        for (step, event) in history.iter().enumerate() {
            job = job.apply(*event).unwrap_or(job);
            happen(&bench, id, &mut held, *event).await;
            let record = bench.store.analysis(id).await.unwrap();
            assert_eq!(seen(&record), job, "after step {step} of {history:?}");
            assert_eq!(record.finished_at.is_some(), job.status.is_final());
            assert_eq!(record.problem.is_some(), job.status == Status::Failed);
            assert_eq!(bench.store.report_json(id).await.unwrap().is_some(), job.status == Status::Succeeded);
        }
        if !job.status.is_final() {
            bench.store.delete::<AnalysisRecord>(id, None).await.unwrap();
        }
    }
}
