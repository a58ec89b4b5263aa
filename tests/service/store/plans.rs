//! No list reads rows that it was not asked for: asserted of the steps by which the database finds them.

use super::files::{meddle, place};
use super::*;
use sqlx::Connection as _;

/// Steps that read a whole table, sort, or go through rows one by one, by the list that may.
const MAY: [(&str, &str); 10] = [
    // Over an index of nothing but what waits, or is under way.
    ("the next in the queue", "SCAN analyses USING INDEX analyses_queue"),
    ("what is under way", "SCAN analyses USING INDEX analyses_leased"),
    // Everything is asked for, and an index has it.
    ("analyses by status", "SCAN analyses USING COVERING INDEX"),
    ("estimates of trials", "SCAN t VIRTUAL TABLE"),
    ("estimates of trials", "USE TEMP B-TREE FOR ORDER BY"),
    ("trials of a study, to be drawn", "USE TEMP B-TREE FOR"),
    ("trials of a subject, to be drawn", "USE TEMP B-TREE FOR"),
    // Over an index that has all that is asked for.
    ("counts of a run of a study", "USE TEMP B-TREE FOR GROUP BY"),
    ("counts of a run of a kind", "USE TEMP B-TREE FOR GROUP BY"),
    ("the latest of a run of", "USE TEMP B-TREE FOR ORDER BY"),
];

fn assert_good(plans: &[(String, String, Vec<String>)]) {
    for (name, sql, steps) in plans {
        for step in steps {
            let reads_all = step.starts_with("SCAN") && !step.contains("CONSTANT ROW");
            let sorts = step.contains("TEMP B-TREE");
            let finds_for_itself = step.contains("AUTOMATIC");
            let may = MAY.iter().any(|(list, what)| name.starts_with(list) && step.starts_with(what));
            assert!(may || !(reads_all || sorts || finds_for_itself), "{name}: {step}\n{sql}\n{steps:#?}");
        }
        if name.starts_with("counts of") || name.starts_with("the latest of") {
            assert!(steps[0].contains("COVERING INDEX analyses_"), "{name}: {steps:#?}");
        }
    }
    let steps_of = |list: &str| &plans.iter().find(|(name, ..)| name == list).unwrap().2;
    // The case that took 65 s: the trial first, then its analyses, each by its id.
    let estimates = steps_of("estimates of trials");
    let place =
        |what: &str| estimates.iter().position(|step| step.contains(what)).unwrap_or_else(|| panic!("{estimates:#?}"));
    assert!(place("analysis_trials_by_trial (trial_id=?)") < place("SEARCH a"), "{estimates:#?}");
    assert!(estimates[place("SEARCH a")].contains("(id=?)"), "{estimates:#?}");
    assert!(steps_of("analyses by [study, kind, status]")[0].contains("analyses_by_study (study_id=? AND id>?)"));
    assert!(steps_of("analyses by [status]")[0].contains("analyses_by_status (status=? AND id>?)"));
    assert!(steps_of("the next in the queue").iter().any(|step| step.contains("analyses_queue")));
    assert!(steps_of("what is under way")[0].contains("analyses_leased"));
    let line = steps_of("the end of a line");
    assert!(line.iter().any(|step| step.contains("analyses_lines (study_id=? AND kind=?)")), "{line:#?}");
}

#[tokio::test]
async fn no_list_reads_what_it_is_not_asked_for() {
    let (_directory, path) = place();
    let store = Store::open(Some(&path)).await.unwrap();
    let plans = store.plans().await.unwrap();
    assert!(plans.len() >= 30, "{}", plans.len());
    assert_good(&plans);
    // With what the database knows of a full one, where nearly everything has succeeded and is of one study.
    let study = store.create_study(new_study("Tracking"), None).await.unwrap().into_inner().id;
    let plant = store.create_plant(study, new_plant("mass"), None).await.unwrap().into_inner().id;
    let subject = store.create_subject(study, new_subject("S01"), None).await.unwrap().into_inner().id;
    let mut trials = Vec::new();
    for number in 1..=30 {
        let made = store.create_trials(subject, vec![new_trial(plant, number)], None).await.unwrap().remove(0);
        trials.push(made.into_inner().id);
    }
    let new = trials.iter().map(|trial| new_analysis(vec![*trial])).collect();
    store.create_analyses(new, None).await.unwrap();
    for _ in 0..28 {
        let lease = store.claim("w", 15.0).await.unwrap().unwrap().lease;
        store.succeed(&lease, &report(0.5)).await.unwrap();
    }
    let mut meddler = meddle(&path).await;
    sqlx::raw_sql("ANALYZE").execute(&mut meddler).await.unwrap();
    meddler.close().await.unwrap();
    store.close().await;
    let store = Store::open(Some(&path)).await.unwrap();
    assert_good(&store.plans().await.unwrap());
    store.upkeep(std::time::Duration::from_secs(3600)).await.unwrap();
    assert_good(&store.plans().await.unwrap());
    store.close().await;
}
