//! The studies, what needs somebody, and what is being computed.

use super::frame::Frame;
use super::layout::{Head, Place, card, page as whole};
use super::numbers::{ago, count, moment};
use super::queue;
use crate::api::{ApiResult, AppState, Params};
use crate::jobs::Status;
use crate::store::{AnalysisRecord, StudyOverview};
use axum::extract::State;
use axum::response::Response;
use maud::{Markup, html};

/// Studies that are listed; nobody reads more.
const MOST_STUDIES: u32 = 200;
/// Failures and running analyses that are named; the queue has all.
const MOST_NAMED: u32 = 5;

/// The first page.
pub(super) async fn page(frame: Frame, State(state): State<AppState>, Params(()): Params<()>) -> ApiResult<Response> {
    let studies = state.store.study_overviews(MOST_STUDIES).await?;
    let failed = state.store.latest_analyses(None, Status::Failed, MOST_NAMED).await?;
    let running = state.store.latest_analyses(None, Status::Running, MOST_NAMED).await?;
    let mut head = Head::new(Place::Studies, "Studies");
    head.json = Some("/v1/studies".to_owned());
    head.actions = html! {
        a.button href="/studies/new" { "New study" }
        @if !studies.is_empty() { a.button.strong href="/upload" { "Upload trials" } }
    };
    let body = if studies.is_empty() { empty() } else { filled(&studies, &failed, &running, frame.busy) };
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

fn filled(studies: &[StudyOverview], failed: &[AnalysisRecord], running: &[AnalysisRecord], busy: u64) -> Markup {
    let failures: u64 = studies.iter().map(|study| study.failed).sum();
    html! {
        @if let Some(newest) = failed.first() {
            (card("Needs you", &html! {}, &html! {
                p {
                    b { (count(failures.max(failed.len() as u64), "analysis", "analyses")) " failed." } " The latest: "
                    a href={ "/analyses/" (newest.id) } {
                        (newest.kind.name()) ": "
                        (newest.problem.as_ref().map_or("no reason given", |problem| problem.title.as_str()))
                    }
                    ", " (newest.finished_at.map(ago).unwrap_or_default()) ". "
                    a href="/queue" { "All of them" }
                }
            }))
        }
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

fn dash(n: u64) -> String {
    if n == 0 { "–".to_owned() } else { n.to_string() }
}
