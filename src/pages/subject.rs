//! A subject: how it learned, and its trials.

use super::frame::Frame;
use super::layout::{Head, Place, card, missing, page as whole};
use super::numbers::{count, with_interval};
use super::study::{estimator_name, estimators};
use super::svg::Drawn;
use super::trust::{chip, symbol};
use crate::analysis::Problem;
use crate::analysis::ids::{StudyId, SubjectId};
use crate::api::{
    ApiResult, AppState, CurveQuery, FromQuery, Gathered, Id, Params, QueryText, asked_estimator, drawing, gather,
    naming_excluded, units_of_study,
};
use crate::figure::of::Units;
use crate::figure::of::learning_curves::{learning_curve_of, name as name_of};
use crate::figure::text::three;
use crate::learning::curves::{CurvePoint, Metric, PlantCurve};
use crate::learning::{Estimator, StudyLearningCurves, SubjectInput, study_learning_curves};
use crate::trust::Level;
use axum::extract::State;
use axum::response::Response;
use maud::{Markup, html};

/// The width of a figure in a card of half a page, in pixels.
const HALF: u32 = 560;

/// The quantities that are shown of each trial.
pub(super) const QUANTITIES: [Metric; 3] =
    [Metric::MeanAbsError, Metric::NormFeedforwardPlantMinusOne, Metric::NormFeedback];

/// Which estimates.
pub(super) struct SubjectQuery {
    estimator: Option<Estimator>,
}

impl FromQuery for SubjectQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok(Self { estimator: asked_estimator(query)? })
    }
}

/// The 95 % interval of a quantity of a trial.
pub(super) fn interval(point: &CurvePoint, metric: Metric) -> Option<[f64; 2]> {
    match metric {
        Metric::NormFeedback => point.intervals_95.norm_feedback,
        Metric::NormFeedforwardMinusInverse => point.intervals_95.norm_feedforward_minus_inverse,
        Metric::NormFeedforwardPlantMinusOne => point.intervals_95.norm_feedforward_plant_minus_one,
        _ => None,
    }
}

/// The page of a subject.
pub(super) async fn page(
    frame: Frame,
    State(state): State<AppState>,
    Id(id): Id<SubjectId>,
    Params(query): Params<SubjectQuery>,
) -> ApiResult<Response> {
    let subject = state.store.subject(id).await?;
    let study = state.store.study(subject.study).await?;
    let found = estimators(&state.store, study.id).await?;
    let first = found.first().map(|(estimator, _)| *estimator);
    let estimator = query.estimator.or(first).unwrap_or_default();
    // The person is seen before its group; those without one are a group too, but among everybody.
    let gathered = gather(&state, study.id, None, subject.group.clone(), &CurveQuery::by(estimator)).await?;
    let units = units_of_study(&state, study.id).await?;
    let is_own = |own: &&SubjectInput| own.subject == id.to_string();
    let trials: usize = gathered.subjects.iter().filter(is_own).map(|subject| subject.trials.len()).sum();
    let metrics: Vec<Metric> = QUANTITIES.into_iter().take(if first.is_some() { 2 } else { 1 }).collect();
    let drawn = drawing(&state, {
        let metrics = metrics.clone();
        let own = id.to_string();
        move || draw(&gathered, estimator, &own, &metrics, &units)
    });
    let (curves, figures) = drawn.await?;

    let api = format!("/v1/subjects/{id}");
    let mut head = Head::new(Place::Studies, &subject.code);
    head.crumbs = vec![("Studies".into(), "/".into()), (study.name.clone(), format!("/studies/{}", study.id))];
    head.json = Some(api.clone());
    head.lead = html! {
        (subject.group.as_deref().unwrap_or("without a group")) " · " (count(trials as u64, "trial", "trials"))
        @if first.is_some() { " · estimated by " (estimator_name(estimator)) }
    };
    head.actions = html! { a.button href={ "/upload?subject=" (id) } { "Upload" } };
    let numbers = format!("{api}/learning-curves?estimator={}", estimator.name());
    let body = html! {
        @if trials == 0 {
            (missing("No trial yet", "Nothing was recorded from this subject.", &html! {
                "Send a recording with columns t, r, u, y to " code { (api) "/trials" } "."
            }))
        } @else {
            div.pair {
                @for (metric, drawn) in metrics.iter().zip(&figures) {
                    (own_card(drawn, study.id, id, *metric, estimator, &numbers))
                }
            }
            @for group in &curves.groups {
                @for own in group.subjects.iter().filter(|own| own.subject == id.to_string()) { (table(&own.curve)) }
            }
            (attributes(&subject.attributes))
        }
    };
    Ok(whole(&frame, &head, &body))
}

/// A figure of one subject; its numbers are those of its learning curves.
fn own_card(
    drawn: &Drawn,
    study: StudyId,
    subject: SubjectId,
    metric: Metric,
    estimator: Estimator,
    numbers: &str,
) -> Markup {
    let all = format!("/v1/studies/{study}/figures/{}?estimator={}", name_of(metric), estimator.name());
    let more = html! { p.files { a href=(numbers) { "learning curves" } } };
    drawn.card(&format!("{all}&subject={subject}"), &more)
}

fn draw(
    gathered: &Gathered,
    estimator: Estimator,
    subject: &str,
    metrics: &[Metric],
    units: &Units,
) -> (StudyLearningCurves, Vec<Drawn>) {
    let options = CurveQuery::by(estimator).options();
    let curves = study_learning_curves(&gathered.subjects, &options);
    let named = |figure| naming_excluded(figure, &gathered.remarks);
    let of =
        |metric: &Metric| Drawn::new(&named(learning_curve_of(&curves, subject, *metric, units)), HALF, [None, None]);
    let figures = metrics.iter().map(of).collect();
    (curves, figures)
}

fn table(curve: &PlantCurve) -> Markup {
    let title = format!("Trials on {}", curve.plant.name);
    card(
        &title,
        &html! {},
        &html! {
            div.scroll tabindex="0" role="region" aria-label=(title) {
                table {
                    caption.hidden { (title) }
                    thead {
                        tr {
                            th scope="col" { "Trial" }
                            @for metric in QUANTITIES { th scope="col" { (symbol(metric)) } }
                        }
                    }
                    tbody {
                        @for point in &curve.points {
                            tr {
                                th scope="row" {
                                    a href={ "/trials/" (point.trial) } {
                                        @if let Some(session) = point.session { "session " (session) ", " }
                                        "trial " (point.number)
                                    }
                                }
                                @for metric in QUANTITIES { td { (quantity(point, metric)) } }
                            }
                        }
                        @for trial in &curve.left_out {
                            tr {
                                th scope="row" { a href={ "/trials/" (trial.trial) } { "trial " (trial.number) } }
                                td colspan=(QUANTITIES.len()) {
                                    (chip(Level::DoNotUse, "divergent")) " the output passed the display limit"
                                }
                            }
                        }
                    }
                }
            }
        },
    )
}

/// A value with its interval and how far it may be used.
fn quantity(point: &CurvePoint, metric: Metric) -> Markup {
    let level = point.level(metric);
    let value = point.value(metric).map(|value| with_interval(value, interval(point, metric)));
    html! {
        span.value { (value.unwrap_or_else(|| "–".to_owned())) } " "
        (chip(level, level.words()))
    }
}

/// What the lab noted about a subject.
fn attributes(attributes: &serde_json::Value) -> Markup {
    let Some(fields) = attributes.as_object().filter(|fields| !fields.is_empty()) else { return html! {} };
    card("Noted", &html! {}, &super::values::list(fields.iter().map(|(name, value)| (name.as_str(), value)), three))
}
