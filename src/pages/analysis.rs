//! An analysis: how far it is, what it found, why it failed.

use super::frame::Frame;
use super::layout::{Head, Place, card, page as whole};
use super::numbers::{ago, duration, eight, moment, with_interval};
use super::queue::{action, bar};
use super::study::estimator_name;
use super::svg::Drawn;
use super::trust::chip;
use super::{problems, values, warnings};
use crate::analysis::estimates::QuantityTrust;
use crate::analysis::ids::AnalysisId;
use crate::analysis::{Report, registry};
use crate::api::{
    ApiResult, AppState, Id, Params, check, drawing, figures_of_analysis, internal, off_thread, report_text,
};
use crate::figure::text::three;
use crate::jobs::Status;
use crate::store::{AnalysisRecord, NewAnalysis};
use crate::trust::Level;
use axum::extract::State;
use axum::response::{IntoResponse as _, Redirect, Response};
use maud::{Markup, html};
use serde_json::Value;

/// The width of a figure, in pixels.
const WHOLE: u32 = 1160;

/// Members of results that people look for, in the order in which they are read.
const FIRST: [&str; 12] = [
    "verdict",
    "metrics",
    "variance_accounted_for",
    "simulated_vaf",
    "cost",
    "band_hz",
    "accounted_for",
    "feedforward_delay_s",
    "feedback_delay_s",
    "weights",
    "flatness",
    "tests",
];

/// Quantities that are listed with their trust.
const MOST_QUANTITIES: usize = 12;

/// Requests longer than this are left to the JSON.
const MOST_REQUEST: usize = 6000;

/// The page of an analysis.
pub(super) async fn page(
    frame: Frame,
    State(state): State<AppState>,
    Id(id): Id<AnalysisId>,
    Params(()): Params<()>,
) -> ApiResult<Response> {
    let record = state.store.analysis(id).await?;
    let kind = registry::kinds().find(|about| about.kind == record.kind);
    let title = kind.map_or(record.kind.name(), |about| about.title);
    let api = format!("/v1/analyses/{id}");
    let mut head = Head::new(Place::Queue, title);
    head.crumbs = vec![("Queue".into(), "/queue".into())];
    if let Some(study) = record.study {
        let study = state.store.study(study).await?;
        head.crumbs = vec![("Studies".into(), "/".into()), (study.name, format!("/studies/{}", study.id))];
    }
    head.json = Some(api.clone());
    head.actions = action(&record);
    let is_live = !record.status.is_final();
    head.again_s = is_live.then_some(10);
    let found = match record.status {
        Status::Succeeded => Some(found(&state, &record).await?),
        _ => None,
    };
    head.lead = html! {
        code { (record.kind.name()) } " · " span.status { (record.status.name()) }
        @if let Some(found) = &found { " · " (found.subject) }
        " · asked for " time datetime=(moment(record.created_at)) { (ago(record.created_at)) }
    };
    let body = html! {
        div #live data-events=[is_live.then(|| format!("{api}/events"))] {
            @match record.status {
                Status::Queued | Status::Running => { (running(&record)) }
                Status::Failed => { (failed(&record)) }
                Status::Cancelled => { (cancelled(&record)) }
                Status::Succeeded => { @if let Some(found) = &found { (found.markup(&api)) } }
            }
            (provenance(&record, found.as_ref().map(|found| &found.report), &api))
        }
    };
    Ok(whole(&frame, &head, &body))
}

fn running(record: &AnalysisRecord) -> Markup {
    let phase = (record.status == Status::Running).then(|| record.progress.phase.to_string());
    card(
        "How far it is",
        &html! {},
        &html! {
            p.live-bar { (bar(record)) }
            p.muted.live-phase {
                @if let Some(phase) = phase { "at: " (phase) } @else { "a worker takes it when those before it are done"
                    }
            }
            p.live-said role="status" aria-live="polite" {}
            noscript { p.muted { "This page is loaded again every ten seconds." } }
        },
    )
}

fn failed(record: &AnalysisRecord) -> Markup {
    let Some(problem) = &record.problem else { return html! {} };
    let title = super::sentences::capital(&problem.title);
    card(
        &title,
        &html! {},
        &html! {
            (problems::parts(&problem.detail, problem.location.as_deref(), problem.mend.as_deref()))
            (kept(record))
        },
    )
}

fn cancelled(record: &AnalysisRecord) -> Markup {
    let when = record.finished_at.map(ago).unwrap_or_default();
    card("Cancelled", &html! {}, &html! { p { "Somebody stopped it " (when) "." } (kept(record)) })
}

/// What was found before it was stopped.
fn kept(record: &AnalysisRecord) -> Markup {
    html! {
        @if let Some(bracket) = record.bracket {
            p {
                "Kept: the best candidate so far costs " (three(bracket.incumbent)) ", and none costs less than "
                (three(bracket.bound)) " (gap " (format!("{:.1} %", 100.0 * bracket.gap())) ")."
            }
        }
    }
}

/// What a finished analysis has to show.
struct Found {
    subject: String,
    quantities: Vec<QuantityTrust>,
    report: Report,
    figures: Vec<(String, Drawn)>,
}

async fn found(state: &AppState, record: &AnalysisRecord) -> ApiResult<Found> {
    let drawable = figures_of_analysis(state, record).await?;
    let text = report_text(state, record.id).await?;
    let quantities = state.store.trust_of_analysis(record.id).await?;
    let made = drawing(state, move || {
        let report: Report = serde_json::from_str(&text)?;
        let figures = drawable.figures(&report);
        let figures =
            figures.iter().map(|figure| (figure.name.clone(), Drawn::new(figure, WHOLE, [None, None]))).collect();
        Ok::<_, serde_json::Error>(Found { subject: drawable.subject().to_owned(), quantities, report, figures })
    });
    made.await?.map_err(|error| {
        tracing::error!(%error, analysis = %record.id, "a stored report cannot be read");
        internal().into()
    })
}

impl Found {
    fn markup(&self, api: &str) -> Markup {
        let Report { result, warnings: warned, .. } = &self.report;
        let fields: Vec<(&str, &Value)> =
            result.as_object().into_iter().flatten().map(|(name, value)| (name.as_str(), value)).collect();
        // Long lists are drawn, or in the JSON.
        fn is_told(value: &Value) -> bool {
            !matches!(value, Value::Array(items) if items.len() > 8)
        }
        let told = || fields.iter().copied().filter(|(_, value)| is_told(value));
        let mut first: Vec<(&str, &Value)> = told().filter(|(name, _)| FIRST.contains(name)).collect();
        first.sort_by_key(|(name, _)| FIRST.iter().position(|own| own == name));
        // Of kinds that have none of these, everything comes first.
        let rest: Vec<(&str, &Value)> = told().filter(|(name, _)| !FIRST.contains(name)).collect();
        let (first, rest) = if first.is_empty() { (rest, Vec::new()) } else { (first, rest) };
        html! {
            div.sided {
                div {
                    (card("What it found", &html! { p.files { a href={ (api) "/report" } { "JSON" } } },
                        &html! {
                            (values::list(first.into_iter(), three))
                            @if !rest.is_empty() {
                                details { summary { "Everything else" } (values::list(rest.into_iter(), three)) }
                            }
                        }))
                }
                div {
                    (card("Can it be trusted?", &html! {}, &html! {
                        (quantities(&self.quantities))
                        @if warned.is_empty() {
                            p { "It carries no warning." }
                        } @else {
                            p { (warned.len()) " to read before its numbers are used:" }
                            (warnings::list(warned))
                        }
                    }))
                }
            }
            @for (name, drawn) in &self.figures { (drawn.card(&format!("{api}/figures/{name}"), &html! {})) }
        }
    }
}

/// How far each quantity may be used; of several trials those that are worst first, as many as are read.
fn quantities(all: &[QuantityTrust]) -> Markup {
    let mut sorted: Vec<&QuantityTrust> = all.iter().collect();
    sorted.sort_by_key(|own| std::cmp::Reverse(own.trust.level));
    let several = all.iter().any(|own| own.position > 0);
    html! {
        @if !sorted.is_empty() {
            ul.trust { @for own in sorted.iter().take(MOST_QUANTITIES) { li {
                p {
                    (chip(own.trust.level, own.trust.level.words())) " " (own.trust.quantity.replace('_', " "))
                    @if let Some(estimator) = own.estimator { span.muted { " · " (estimator_name(estimator)) } }
                    @if several { span.muted { " · trial " (own.position + 1) } }
                    @if let Some(value) = own.value { " " b { (with_interval(value, own.interval_95)) } }
                }
                @if own.trust.level > Level::Ok { p.muted { (own.trust.because) } }
            } } }
            @if sorted.len() > MOST_QUANTITIES {
                p.muted { (sorted.len() - MOST_QUANTITIES) " more are in " code { "/trust" } "." }
            }
        }
    }
}

fn provenance(record: &AnalysisRecord, report: Option<&Report>, api: &str) -> Markup {
    let request = serde_json::to_string_pretty(&record.request).unwrap_or_default();
    let seconds = record.started_at.zip(record.finished_at).map(|(from, to)| (to - from).as_seconds_f64());
    card(
        "Where this comes from",
        &html! {},
        &html! {
            dl.values {
                div { dt { "analysis" } dd { code { (record.id) } } }
                div { dt { "spec" } dd { code { (eight(&record.spec_sha256)) } } }
                @if let Some(Report { provenance, .. }) = report {
                    div { dt { "result" } dd { code { (eight(&provenance.result_sha256)) } } }
                    div { dt { "version" } dd { (provenance.product_version) } }
                    @if let Some(seed) = provenance.seed { div { dt { "seed" } dd { (seed) } } }
                    @for (name, hash) in &provenance.inputs_sha256 {
                        div { dt { (name) } dd { code { (eight(hash)) } } }
                    }
                }
                @if let Some(seconds) = seconds { div { dt { "took" } dd { (duration(seconds)) } } }
                div { dt { "attempts" } dd { (record.attempts) } }
            }
            details {
                summary { "The request, with every default filled in" }
                @if request.len() <= MOST_REQUEST { pre tabindex="0" { code { (request) } } } @else {
                    p { "It carries data: " a href=(api) { "JSON" } }
                }
            }
        },
    )
}

/// Stops an analysis, and shows it.
pub(super) async fn cancel(
    State(state): State<AppState>,
    Id(id): Id<AnalysisId>,
    Params(()): Params<()>,
) -> ApiResult<Response> {
    state.store.request_cancel(id).await?;
    Ok(Redirect::to(&format!("/analyses/{id}")).into_response())
}

/// Asks for the same once more, and shows it.
pub(super) async fn again(
    State(state): State<AppState>,
    Id(id): Id<AnalysisId>,
    Params(()): Params<()>,
) -> ApiResult<Response> {
    let made = ask_again(&state, id).await?;
    Ok(Redirect::to(&format!("/analyses/{made}")).into_response())
}

/// Asks for the same once more; what it is called.
pub(super) async fn ask_again(state: &AppState, id: AnalysisId) -> ApiResult<AnalysisId> {
    let record = state.store.analysis(id).await?;
    let request = record.request;
    let new = off_thread(move || check(&request)).await??.new;
    let new = NewAnalysis { study: record.study, ..new };
    Ok(state.store.create_analysis(new, None).await?.into_inner().id)
}
