//! A trial: its signals, whether it can be trusted, what was identified from it.

use super::frame::Frame;
use super::layout::{Head, Place, card, page as whole};
use super::numbers::{ago, eight, with_interval};
use super::study::estimator_name;
use super::subject::{QUANTITIES, interval};
use super::svg::{Drawn, View};
use super::trust::{chip, symbol};
use super::warnings;
use crate::analysis::ids::{AnalysisId, TrialId};
use crate::analysis::{Problem, Report};
use crate::api::{
    ApiResult, AppState, CurveQuery, FromQuery, Gathered, Id, Params, QueryText, Shown, asked_estimator,
    checked_description, checked_reason, drawing, figures_of_analysis, gather_trial, internal, report_text,
};
use crate::figure::of::plant_check::{self, plant_check};
use crate::figure::of::signals::{self, signals};
use crate::figure::text::three;
use crate::learning::curves::{CurvePoint, Metric};
use crate::learning::{Estimator, study_learning_curves};
use crate::store::{AnalysisFilter, AnalysisRecord, Page, TrialPatch, TrialRecord};
use crate::trust::Level;
use axum::extract::{Form, State};
use axum::response::{IntoResponse as _, Redirect, Response};
use maud::{Markup, html};

/// Widths of figures in pixels: beside the panel of trust, and of the whole page.
const BESIDE: u32 = 760;
const WHOLE: u32 = 1160;

/// Trials and analyses fetched at once.
const PAGE: u32 = 500;

/// What of the trial is looked at.
pub(super) struct TrialQuery {
    view: View,
    analysis: Option<AnalysisId>,
    estimator: Option<Estimator>,
}

impl FromQuery for TrialQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok(Self {
            view: [query.number("from")?, query.number("to")?],
            analysis: query.id("analysis")?,
            estimator: asked_estimator(query)?,
        })
    }
}

/// The trials of the subject before and after this one, in the order of practice.
async fn neighbours(state: &AppState, record: &TrialRecord) -> ApiResult<[Option<TrialRecord>; 2]> {
    let mut all: Vec<TrialRecord> = Vec::new();
    loop {
        let next = state.store.trials(record.subject, Page { after: all.last().map(|t| t.id.0), limit: PAGE }).await?;
        let is_last = next.len() < PAGE as usize;
        all.extend(next);
        if is_last {
            break;
        }
    }
    all.sort_by_key(|trial| (trial.session, trial.number));
    let at = all.iter().position(|trial| trial.id == record.id);
    let find = |step: isize| at.and_then(|at| all.get(at.checked_add_signed(step)?).cloned());
    Ok([find(-1), find(1)])
}

/// What an estimator says about the trial.
struct Judged {
    estimator: Estimator,
    point: CurvePoint,
    gathered: Gathered,
}

/// The first estimator with an answer, and which others have one.
async fn judged(state: &AppState, shown: &Shown, wanted: Option<Estimator>) -> ApiResult<(Judged, Vec<Estimator>)> {
    let order = [Estimator::PredictionError, Estimator::TwoStimulus, Estimator::Ssid, Estimator::SsidRefined];
    let mut found: Vec<Judged> = Vec::new();
    for estimator in order {
        let Shown { record, subject, plant, .. } = shown;
        let query = CurveQuery { include_divergent: true, ..CurveQuery::by(estimator) };
        let gathered = gather_trial(state, record.clone(), subject.clone(), plant.clone(), &query).await?;
        let curves = study_learning_curves(&gathered.subjects, &query.options());
        let points = curves.groups.into_iter().flat_map(|group| group.subjects).flat_map(|s| s.curve.points);
        if let Some(point) = points.into_iter().next() {
            found.push(Judged { estimator, point, gathered });
        }
    }
    let with_answer: Vec<Estimator> =
        found.iter().filter(|one| one.point.analysis.is_some()).map(|one| one.estimator).collect();
    let chosen = wanted.or(with_answer.first().copied()).unwrap_or_default();
    let at = found.iter().position(|one| one.estimator == chosen).unwrap_or(0);
    if found.is_empty() {
        return Err(internal().into());
    }
    Ok((found.swap_remove(at), with_answer))
}

/// The page of a trial.
pub(super) async fn page(
    frame: Frame,
    State(state): State<AppState>,
    Id(id): Id<TrialId>,
    Params(query): Params<TrialQuery>,
) -> ApiResult<Response> {
    let shown = Shown::read(&state, id).await?;
    let [before, after] = neighbours(&state, &shown.record).await?;
    let (judged, with_answer) = judged(&state, &shown, query.estimator).await?;
    let filter = AnalysisFilter { trial: Some(id), ..AnalysisFilter::default() };
    let analyses = state.store.analyses(filter, Page { after: None, limit: PAGE }).await?;
    let wanted = query.analysis.or_else(|| judged.point.analysis.as_ref().and_then(|id| id.parse().ok()));
    let chosen = analyses.iter().find(|analysis| Some(analysis.id) == wanted).cloned();
    let trial = state.store.trial_signals(id).await?;
    let drawable = match &chosen {
        Some(record) if record.status == crate::jobs::Status::Succeeded => {
            Some((figures_of_analysis(&state, record).await?, report_text(&state, record.id).await?))
        }
        _ => None,
    };
    let (origin, model) = (shown.origin(), shown.plant.model.clone());
    let view = query.view;
    let drawn = drawing(&state, move || {
        let own = Drawn::new(&signals(&trial, &origin), BESIDE, view);
        let check = plant_check(&trial, &model, &origin);
        let finding = check.as_ref().map(|figure| figure.description.clone());
        let check = check.map(|figure| Drawn::new(&figure, BESIDE, view));
        let report = drawable.as_ref().and_then(|(_, text)| serde_json::from_str::<Report>(text).ok());
        let figures = match (&drawable, &report) {
            (Some((drawable, _)), Some(report)) => drawable.figures(report),
            _ => Vec::new(),
        };
        let figures: Vec<(String, Drawn)> =
            figures.iter().map(|figure| (figure.name.clone(), Drawn::new(figure, WHOLE, [None, None]))).collect();
        (own, check, finding, figures, report.map(|report| report.warnings).unwrap_or_default())
    });
    let (own, check, finding, figures, reported) = drawn.await?;

    let title = trial_name(&shown);
    let api = format!("/v1/trials/{id}");
    let Shown { record, subject, plant, study } = &shown;
    let mut head = Head::new(Place::Studies, &title);
    head.crumbs = vec![
        ("Studies".into(), "/".into()),
        (study.name.clone(), format!("/studies/{}", study.id)),
        (subject.code.clone(), format!("/subjects/{}", subject.id)),
    ];
    head.json = Some(api.clone());
    let seconds = record.sample_time_s * record.samples.saturating_sub(1) as f64;
    head.lead = html! {
        (subject.group.as_deref().unwrap_or("without a group")) " · " (plant.name) " · " (record.samples) " samples, "
        (three(seconds)) " s at " (three(1.0 / record.sample_time_s)) " Hz · sha256 " code { (eight(&record.sha256)) }
    };
    head.actions = html! {
        a.button.strong href={ "/analyses/new?trial=" (id) } { "Identify" }
        @for (trial, key, sign) in [(&before, "before", "‹ "), (&after, "after", "› ")] {
            @if let Some(trial) = trial {
                a.button rel=(if key == "before" { "prev" } else { "next" }) data-trial=(key)
                    href=(keeping(&trial.id.to_string(), view)) {
                    span aria-hidden="true" { (sign) } "trial " (trial.number)
                }
            }
        }
    };
    let mut warned = record.warnings.clone();
    warned.extend(reported);
    let body = html! {
        div.sided {
            div {
                (own.card(&format!("{api}/figures/{}", signals::NAME), &zoom_form(view)))
                @if let Some(check) = &check { (check.card(&format!("{api}/figures/{}", plant_check::NAME), &html! {}))
                    }
            }
            div {
                (card("Can it be trusted?", &html! {}, &panel(&frame, record, &judged, &with_answer,
                    finding.as_deref())))
                @if !warned.is_empty() { (card("Warnings", &html! {}, &warnings::list(&warned))) }
            }
        }
        @if let Some(analysis) = &chosen {
            @for (name, drawn) in &figures {
                (drawn.card(&format!("/v1/analyses/{}/figures/{name}", analysis.id), &html! {}))
            }
        }
        (list(&analyses, chosen.as_ref()))
        (remarks(record))
    };
    Ok(whole(&frame, &head, &body))
}

/// What a scientist says of the trial, to be changed.
fn remarks(record: &TrialRecord) -> Markup {
    let reason = record.excluded.as_deref().unwrap_or_default();
    card(
        "Said of this trial",
        &html! {},
        &html! {
            form.fields method="post" action={ "/trials/" (record.id) "/remarks" } {
                div.field {
                    label for="note" { "Note" }
                    textarea #note name="note" rows="2" { (record.note) }
                }
                div.field {
                    label for="excluded" { "Leave it out, because" }
                    p.muted #excluded-hint {
                        "With a reason the trial is left out of curves, means and comparisons, and named where it is; \
                         empty: it is taken in. The recording and everything computed from it stay."
                    }
                    input type="text" #excluded name="excluded" value=(reason) aria-describedby="excluded-hint";
                }
                p { button type="submit" { "Keep" } }
            }
        },
    )
}

/// Keeps what was said of a trial, and shows it.
pub(super) async fn keep_remarks(
    State(state): State<AppState>,
    Id(id): Id<TrialId>,
    Params(()): Params<()>,
    Form(pairs): Form<Vec<(String, String)>>,
) -> ApiResult<Response> {
    let text = |name: &str| pairs.iter().find(|(own, _)| own == name).map_or("", |(_, text)| text.as_str()).trim();
    let reason = text("excluded");
    let excluded = if reason.is_empty() { None } else { Some(checked_reason(reason, "field excluded")?) };
    let note = checked_description(text("note"), "field note")?;
    let patch = TrialPatch { note: Some(note), excluded: Some(excluded), ..TrialPatch::default() };
    state.store.change::<TrialRecord>(id, patch, None).await?;
    Ok(Redirect::to(&format!("/trials/{id}")).into_response())
}

fn trial_name(shown: &Shown) -> String {
    let session = shown.record.session.map_or_else(String::new, |session| format!("session {session}, "));
    format!("{}, {session}trial {}", shown.subject.code, shown.record.number)
}

/// Another trial, seen over the same stretch of time.
fn keeping(trial: &str, [from, to]: View) -> String {
    let part = |name: &str, value: Option<f64>| value.map(|value| format!("{name}={value}"));
    let parts: Vec<String> = [part("from", from), part("to", to)].into_iter().flatten().collect();
    if parts.is_empty() { format!("/trials/{trial}") } else { format!("/trials/{trial}?{}", parts.join("&")) }
}

/// The stretch of time as numbers: the way without script, and by keyboard.
fn zoom_form([from, to]: View) -> Markup {
    let text = |value: Option<f64>| value.map(|value| value.to_string());
    html! {
        form.zoom method="get" {
            label { "from " input type="number" step="any" name="from" value=[text(from)] inputmode="decimal"; }
            label { " to " input type="number" step="any" name="to" value=[text(to)] inputmode="decimal"; }
            " s " button type="submit" { "Show" }
            @if from.is_some() || to.is_some() { " " a href="?" { "whole trial" } }
        }
    }
}

/// A line for each quantity.
fn panel(
    frame: &Frame,
    record: &TrialRecord,
    judged: &Judged,
    with_answer: &[Estimator],
    check: Option<&str>,
) -> Markup {
    let Judged { estimator, point, gathered } = judged;
    let recording = match (record.divergent, record.warnings.is_empty()) {
        _ if record.excluded.is_some() => (Level::DoNotUse, "somebody excluded it"),
        (true, _) => (Level::DoNotUse, "the output passed the display limit"),
        (false, false) => (Level::Read, "read the warnings of its upload"),
        (false, true) => (Level::Ok, "even sample time, no gap"),
    };
    html! {
        ul.trust {
            li {
                p { (chip(recording.0, recording.0.words())) " recording" }
                p.muted { (recording.1) "; |y| up to " (three(record.max_abs_output)) ". " (check.unwrap_or_default()) }
            }
            @for metric in QUANTITIES { (line(point, metric)) }
            @if point.value(Metric::VarianceAccountedFor).is_some() {
                (line(point, Metric::VarianceAccountedFor))
            }
        }
        @if with_answer.is_empty() {
            p { "Nothing is identified from this trial yet." }
        } @else {
            nav.choice aria-label="Estimator" {
                "Estimated by: "
                @for own in with_answer {
                    a href=(frame.with("estimator", Some(own.name())))
                        aria-current=[(own == estimator).then_some("true")] { (estimator_name(*own)) }
                    " "
                }
            }
        }
        @for remark in &gathered.remarks { p.muted { (remark.message) } }
    }
}

/// A quantity with how far it may be used, why no further, and what to do about that.
fn line(point: &CurvePoint, metric: Metric) -> Markup {
    let level = point.level(metric);
    let value = point.value(metric).map(|value| with_interval(value, interval(point, metric)));
    html! {
        li {
            p { (chip(level, level.words())) " " (symbol(metric)) " " b { (value.as_deref().unwrap_or("")) } }
            @if let Some(trust) = point.trust(metric) {
                p.muted {
                    (trust.because)
                    @if !trust.advice.is_empty() { ". " b { "What to do: " } (trust.advice) }
                }
                @for reason in &trust.also { p.muted { (reason.level.sign()) " " (reason.because) } }
            }
        }
    }
}

/// Everything that was asked of the trial.
fn list(analyses: &[AnalysisRecord], chosen: Option<&AnalysisRecord>) -> Markup {
    card(
        "Analyses of this trial",
        &html! {},
        &html! {
            @if analyses.is_empty() { p { "None yet." } } @else {
                ul.plain {
                    @for analysis in analyses.iter().rev() {
                        li {
                            a href={ "/analyses/" (analysis.id) } { (analysis.kind.name()) } " · "
                                (analysis.status.name())
                            " · spec " code { (eight(&analysis.spec_sha256)) } " · " (ago(analysis.created_at))
                            @if chosen.is_some_and(|own| own.id == analysis.id) { " · shown above" }
                            @else if analysis.status == crate::jobs::Status::Succeeded {
                                " · " a href={ "?analysis=" (analysis.id) }
                                    { "show" span.hidden { " " (analysis.kind.name()) } }
                                @if let Some(chosen) = chosen {
                                    " · " a href={ "/compare?a=" (chosen.id) "&b=" (analysis.id) }
                                        { "compare" span.hidden { " " (analysis.kind.name()) } " with the one shown" }
                                }
                            }
                        }
                    }
                }
            }
        },
    )
}
