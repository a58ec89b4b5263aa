//! What is computed, what waits, what failed, what was done lately.

use super::analysis;
use super::frame::Frame;
use super::layout::{Head, Place, card, page as whole};
use super::numbers::{ago, duration, moment};
use super::svg::Drawn;
use crate::analysis::ids::AnalysisId;
use crate::analysis::{Code, Problem};
use crate::api::{ApiResult, AppState, Params, drawing, queue_figure};
use crate::jobs::Status;
use crate::store::{AnalysisRecord, FirstTrial};
use axum::extract::{Form, State};
use axum::response::{IntoResponse as _, Redirect, Response};
use maud::{Markup, html};
use std::collections::BTreeMap;

/// Analyses of a status that are listed.
const MOST: u32 = 50;

/// The width of the figure of the last hours, in pixels.
const WHOLE: u32 = 1160;

/// The queue.
pub(super) async fn page(frame: Frame, State(state): State<AppState>, Params(()): Params<()>) -> ApiResult<Response> {
    let counts = state.store.count_by_status().await?;
    let mut head = Head::new(Place::Queue, "Queue");
    head.json = Some("/v1/analyses".to_owned());
    head.again_s = (frame.busy > 0).then_some(10);
    let total: u64 = counts.iter().map(|(_, count)| count).sum();
    head.lead = html! {
        @if total == 0 { "Nothing was ever asked for." } @else {
            @for (at, (status, n)) in counts.iter().enumerate() { @if at > 0 { " · " } (n) " " (status.name()) }
        }
    };
    let mut body = html! {};
    for (status, title) in [
        (Status::Running, "Running"),
        (Status::Queued, "Waiting"),
        (Status::Failed, "Failed"),
        (Status::Succeeded, "Done lately"),
        (Status::Cancelled, "Cancelled"),
    ] {
        let all = counts.iter().find(|(own, _)| *own == status).map_or(0, |(_, count)| *count);
        if all == 0 && status != Status::Running {
            continue;
        }
        let rows = state.store.latest_analyses(None, status, MOST).await?;
        let ids: Vec<AnalysisId> = rows.iter().map(|analysis| analysis.id).collect();
        let named = state.store.first_trials(&ids).await?;
        body = html! { (body) (part(title, status, all, &rows, &named)) };
    }
    let lately = queue_figure(&state).await?;
    let lately = drawing(&state, move || Drawn::new(&lately, WHOLE, [None, None])).await?;
    let body = html! {
        div data-live-queue[frame.busy > 0] { (body) }
        @if total > 0 && !lately.is_empty() { (lately.card("/v1/figures/queue", &html! {})) }
    };
    Ok(whole(&frame, &head, &body))
}

/// What analyses are of.
type Named = BTreeMap<AnalysisId, FirstTrial>;

fn part(title: &str, status: Status, all: u64, rows: &[AnalysisRecord], named: &Named) -> Markup {
    let more = html! {
        @if all > rows.len() as u64 { p.muted { "the latest " (rows.len()) " of " (all) } }
    };
    if rows.is_empty() {
        return card(title, &more, &html! { p { "Nothing is computed at the moment." } });
    }
    let is_done = status.is_final();
    // Boxes belong to a form of their own, since each row has one already.
    let form = format!("many-{}", status.name());
    let (verb, words) = verb(status);
    card(
        title,
        &more,
        &html! {
            @if rows.len() > 1 {
                form.inline id=(form) method="post" action="/queue" {
                    button type="submit" name="do" value=(verb) { (words) " those that are ticked" }
                }
            }
            div.scroll tabindex="0" role="region" aria-label=(title) {
                table {
                    caption.hidden { (title) }
                    thead {
                        tr {
                            @if rows.len() > 1 { th scope="col" { span.hidden { "Ticked" } } }
                            th scope="col" { "Analysis" }
                            th scope="col" { "Of" }
                            th scope="col" { @if is_done { "Ended" } @else { "Progress" } }
                            th scope="col" { "Asked for" }
                            th.number scope="col" { "Attempts" }
                            th scope="col" { "Action" }
                        }
                    }
                    tbody { @for analysis in rows {
                        (row(analysis, named.get(&analysis.id), (rows.len() > 1).then_some(form.as_str())))
                    } }
                }
            }
        },
    )
}

/// What can be done with analyses of a status: the name of the action, and its words.
fn verb(status: Status) -> (&'static str, &'static str) {
    match status {
        Status::Queued | Status::Running => ("cancel", "Cancel"),
        _ => ("again", "Run again"),
    }
}

/// What is asked of the analyses that are ticked.
pub(super) async fn act(
    State(state): State<AppState>,
    Params(()): Params<()>,
    Form(pairs): Form<Vec<(String, String)>>,
) -> ApiResult<Response> {
    let of = |wanted: &'static str| pairs.iter().filter(move |own| own.0 == wanted).map(|own| own.1.as_str());
    let ids: Result<Vec<AnalysisId>, Problem> = of("id")
        .take(MOST as usize)
        .map(|id| {
            let bad =
                || Problem::new(Code::Malformed, "not an id", "an analysis has another form of id").at("field id");
            id.parse().map_err(|_| bad())
        })
        .collect();
    let verb = of("do").next().unwrap_or_default();
    for id in ids? {
        match verb {
            "cancel" => {
                state.store.request_cancel(id).await?;
            }
            "again" => {
                analysis::ask_again(&state, id).await?;
            }
            _ => {
                return Err(Problem::new(
                    Code::Malformed,
                    "nothing to do",
                    "the form asks for neither cancel nor again",
                )
                .at("field do")
                .into());
            }
        }
    }
    Ok(Redirect::to("/queue").into_response())
}

fn row(analysis: &AnalysisRecord, named: Option<&FirstTrial>, ticked: Option<&str>) -> Markup {
    let AnalysisRecord { id, kind, status, attempts, created_at, finished_at, problem, .. } = analysis;
    html! {
        tr data-analysis=(id) {
            @if let Some(form) = ticked {
                td { input type="checkbox" name="id" value=(id) form=(form) aria-label={ "Tick " (kind.name()) } ; }
            }
            th scope="row" { a href={ "/analyses/" (id) } { (kind.name()) } }
            td {
                @match named {
                    Some(FirstTrial { code, number, trials: 1 }) => { (code) ", trial " (number) },
                    Some(FirstTrial { code, number, trials }) => { (code) ", trial " (number) " and " (trials - 1)
                        " more" },
                    None => "data of the request",
                }
            }
            td {
                @if let Some(problem) = problem { (problem.title) ", " }
                @match finished_at {
                    Some(at) => time datetime=(moment(*at)) { (ago(*at)) },
                    None => { (bar(analysis)) },
                }
            }
            td { time datetime=(moment(*created_at)) { (ago(*created_at)) } }
            td.number { (attempts) }
            td { (action(analysis)) span.hidden { (status.name()) } }
        }
    }
}

/// Cancelling, or asking again.
pub(super) fn action(analysis: &AnalysisRecord) -> Markup {
    let (verb, words) = verb(analysis.status);
    html! {
        @if analysis.cancel_requested && !analysis.status.is_final() { "is being cancelled" } @else {
            form.inline method="post" action={ "/analyses/" (analysis.id) "/" (verb) } {
                button type="submit" aria-label={ (words) ": " (analysis.kind.name()) } { (words) }
            }
        }
    }
}

/// How far an analysis is.
pub(super) fn bar(analysis: &AnalysisRecord) -> Markup {
    let share = (100.0 * analysis.progress.fraction).clamp(0.0, 100.0);
    html! {
        @if analysis.status == Status::Queued { "waits" } @else {
            progress max="100" value=(format!("{share:.0}")) aria-label="Progress" {}
            " " span.share { (format!("{share:.0} %")) }
            @if let Some(left) = analysis.eta_s { span.left { " · " (duration(left)) " left" } }
            @if let Some(bracket) = analysis.bracket { span.gap { " · gap " (format!("{:.1} %", 100.0 * bracket.gap()))
                } }
        }
    }
}

/// An analysis in a line.
pub(super) fn line(analysis: &AnalysisRecord) -> Markup {
    html! { p.now { a href={ "/analyses/" (analysis.id) } { (analysis.kind.name()) } " " (bar(analysis)) } }
}
