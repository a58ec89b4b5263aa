//! The studies, what needs somebody, and what is being computed.

use super::frame::Frame;
use super::layout::{Head, Place, card, page as whole};
use super::numbers::{ago, count, moment};
use super::queue;
use super::study::estimators;
use super::trust::chip;
use crate::analysis::ids::StudyId;
use crate::api::{ApiResult, AppState, Params, study_trust};
use crate::jobs::Status;
use crate::learning::Estimator;
use crate::learning::curves::Metric;
use crate::learning::trust_grid::TrustCounts;
use crate::store::{AnalysisRecord, StudyOverview};
use crate::trust::{Level, of_mean};
use axum::extract::State;
use axum::response::Response;
use maud::{Markup, html};

/// Studies that are listed; nobody reads more.
const MOST_STUDIES: u32 = 200;
/// Failures and running analyses that are named; the queue has all.
const MOST_NAMED: u32 = 5;
/// The latest studies whose trust is counted: it takes a look at each of their trials.
const MOST_JUDGED: usize = 12;
/// The quantity whose trust stands for a study.
const JUDGED: Metric = Metric::NormFeedforwardPlantMinusOne;

/// How far the distances of a study's trials from the inverse dynamics may be used, by the estimator of its page.
struct Judged {
    study: StudyId,
    name: String,
    estimator: Estimator,
    counts: TrustCounts,
}

impl Judged {
    fn of(&self) -> usize {
        self.counts.ok + self.counts.read + self.counts.do_not_use
    }

    /// Whether a mean over all of them is not to be used.
    fn is_doubtful(&self) -> bool {
        let levels =
            [(self.counts.ok, Level::Ok), (self.counts.read, Level::Read), (self.counts.do_not_use, Level::DoNotUse)];
        let all: Vec<Level> = levels.into_iter().flat_map(|(n, level)| std::iter::repeat_n(level, n)).collect();
        self.counts.do_not_use > 0 && of_mean(&all).level == Level::DoNotUse
    }
}

/// The trust in the latest studies that have anything identified.
async fn judged(state: &AppState, studies: &[StudyOverview]) -> ApiResult<Vec<Judged>> {
    let mut all = Vec::new();
    for overview in studies.iter().filter(|own| own.analysed > 0).take(MOST_JUDGED) {
        let study = overview.study.id;
        let Some((estimator, _)) = estimators(&state.store, study).await?.first().copied() else { continue };
        let counts = study_trust(state, study, JUDGED, estimator, None).await?.counts;
        all.push(Judged { study, name: overview.study.name.clone(), estimator, counts });
    }
    Ok(all)
}

/// The first page.
pub(super) async fn page(frame: Frame, State(state): State<AppState>, Params(()): Params<()>) -> ApiResult<Response> {
    let studies = state.store.study_overviews(MOST_STUDIES).await?;
    let failed = state.store.latest_analyses(None, Status::Failed, MOST_NAMED).await?;
    let running = state.store.latest_analyses(None, Status::Running, MOST_NAMED).await?;
    let judged = judged(&state, &studies).await?;
    let mut head = Head::new(Place::Studies, "Studies");
    head.json = Some("/v1/studies".to_owned());
    head.actions = html! {
        a.button href="/studies/new" { "New study" }
        @if !studies.is_empty() { a.button.strong href="/upload" { "Upload trials" } }
    };
    let body = if studies.is_empty() { empty() } else { filled(&studies, &judged, &failed, &running, frame.busy) };
    Ok(whole(&frame, &head, &body))
}

fn empty() -> Markup {
    card(
        "No study yet. Three ways to begin:",
        &html! {},
        &html! {
            ol.ways {
                li {
                    p { b { "Look at a filled one." } " Simulated people, whose truth is known, in half a minute:" }
                    code.block { "volition demo --database demo.db --serve" }
                }
                li {
                    p { b { "Bring recordings." } " " a href="/studies/new" { "Make a study" }
                        " and its plant, then drop files; or a "
                        "whole folder with an index:" }
                    code.block { "volition import FOLDER --database lab.db" }
                }
                li {
                    p { b { "Over the interface." } " It answers with the study's id, for plants, subjects and trials:"
                        }
                    code.block {
                        "curl -H 'content-type: application/json' -d '{\"name\": \"My study\"}' "
                        "http://127.0.0.1:8080/v1/studies"
                    }
                    p { a href="/docs" { "Every route" } " with its form." }
                }
            }
        },
    )
}

/// What somebody has to look at: failures by their problem, and studies most of whose values are not to be used.
fn needs(failures: u64, failed: &[AnalysisRecord], judged: &[Judged]) -> Markup {
    let mut titles: Vec<String> = failed.iter().map(problem).collect();
    titles.sort();
    titles.dedup();
    let doubtful: Vec<&Judged> = judged.iter().filter(|own| own.is_doubtful()).collect();
    if failed.is_empty() && doubtful.is_empty() {
        return html! {};
    }
    card(
        "Needs you",
        &html! {},
        &html! {
            ul.trust {
                @if !failed.is_empty() {
                    li {
                        p {
                            (chip(Level::DoNotUse, &format!("{} failed",
                                count(failures.max(failed.len() as u64), "analysis", "analyses")))) " "
                            a href="/queue" { "All of them" }
                        }
                        @for title in &titles {
                            @let own: Vec<&AnalysisRecord> =
                                failed.iter().filter(|one| problem(one) == *title).collect();
                            p {
                                @for (at, analysis) in own.iter().enumerate() {
                                    @if at > 0 { ", " }
                                    a href={ "/analyses/" (analysis.id) } { (analysis.kind.name()) }
                                }
                                ": " (title)
                                @if let Some(mend) = own.first().and_then(|one| one.problem.as_ref()?.mend.as_deref()) {
                                    ". " b { "What to do: " } (mend)
                                }
                            }
                            @if let [only] = own.as_slice() { (queue::action(only)) }
                        }
                    }
                }
                @for own in &doubtful {
                    li {
                        p {
                            (chip(Level::Read, Level::Read.words())) " "
                            (own.counts.do_not_use) " of " (own.of()) " distances from the inverse in "
                            b { (own.name) } " are not to be used. "
                            a href={ "/studies/" (own.study) "?quantity=" (JUDGED.name()) "&estimator="
                                (own.estimator.name()) } { "Show them" span.hidden { " in " (own.name) } }
                        }
                    }
                }
            }
        },
    )
}

fn problem(analysis: &AnalysisRecord) -> String {
    analysis.problem.as_ref().map_or_else(|| "no reason given".to_owned(), |problem| problem.title.clone())
}

fn filled(
    studies: &[StudyOverview],
    judged: &[Judged],
    failed: &[AnalysisRecord],
    running: &[AnalysisRecord],
    busy: u64,
) -> Markup {
    let failures: u64 = studies.iter().map(|study| study.failed).sum();
    html! {
        (needs(failures, failed, judged))
        section.card {
            div.scroll tabindex="0" role="region" aria-label="Studies" {
                table {
                    caption.hidden { "Studies" }
                    thead {
                        tr {
                            th scope="col" { "Name" }
                            th.number scope="col" { "Subjects" }
                            th.number scope="col" { "Trials" }
                            th.number scope="col" { "Analysed" }
                            th scope="col" { "Distances " span.hidden { "that are " } "✓ ! ✕"
                                span.hidden { " ok, to be read, not to be used" } }
                            th.number scope="col" { "Running" }
                            th.number scope="col" { "Failed" }
                            th scope="col" { "Last change" }
                        }
                    }
                    tbody {
                        @for StudyOverview { study, subjects, trials, analysed, queued, running, failed, changed_at } in
                            studies {
                            tr {
                                th scope="row" { a href={ "/studies/" (study.id) } { (study.name) } }
                                td.number { (subjects) }
                                td.number { (trials) }
                                td.number { (analysed) "/" (trials) }
                                td { (counts(judged.iter().find(|own| own.study == study.id))) }
                                td.number { (dash(queued + running)) }
                                td.number { (dash(*failed)) }
                                td { time datetime=(moment(*changed_at)) { (ago(*changed_at)) } }
                            }
                        }
                    }
                }
            }
        }
        @if busy > 0 {
            (card("Now", &html! { a href="/queue" { "Queue" } }, &html! {
                @for analysis in running { (queue::line(analysis)) }
                p { (count(busy.saturating_sub(running.len() as u64), "analysis waits", "analyses wait")) "." }
            }))
        }
    }
}

/// How many values of a study are ok, to be read, and not to be used.
fn counts(judged: Option<&Judged>) -> Markup {
    let Some(Judged { counts, .. }) = judged else { return html! { "–" } };
    html! {
        (chip(Level::Ok, &counts.ok.to_string())) " "
        (chip(Level::Read, &counts.read.to_string())) " "
        (chip(Level::DoNotUse, &counts.do_not_use.to_string()))
    }
}

fn dash(n: u64) -> String {
    if n == 0 { "–".to_owned() } else { n.to_string() }
}
