//! A study as one document to print or to keep: no script, nothing to load, every figure inside.

use super::assets;
use super::frame::Frame;
use super::grid::Grid;
use super::layout::{Head, Place, card, page as whole, unframed};
use super::numbers::{count, eight, moment};
use super::sentences::{self, Told};
use super::study::{estimator_name, estimators};
use super::svg::Drawn;
use super::trust::{chip, counts, symbol};
use crate::analysis::ids::StudyId;
use crate::api::{
    ApiResult, AppState, CurveQuery, Gathered, Id, Params, drawing, gather, mean_controllers, units_of_study,
};
use crate::figure::of::Units;
use crate::figure::of::learning_curves::{learning_curve, title};
use crate::figure::text::three;
use crate::jobs::Status;
use crate::learning::curves::Metric;
use crate::learning::{Estimator, Remark, StudyLearningCurves, TrialSelection, study_learning_curves};
use crate::store::{Page, Plant, RunFilter, Study};
use crate::trust::{Level, RULE_VERSION};
use axum::extract::State;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse as _, Response};
use maud::{DOCTYPE, Markup, html};
use std::collections::BTreeMap;
use time::OffsetDateTime;

/// The width of a figure, in pixels: that of a page of A4 between its margins.
const WIDE: u32 = 680;

/// The quantities that are reported.
const QUANTITIES: [Metric; 3] = [Metric::MeanAbsError, Metric::NormFeedforwardPlantMinusOne, Metric::NormFeedback];

/// Plants of a study that are named.
const MOST: Page = Page { after: None, limit: 1000 };

/// Everything that the report says.
struct Reported {
    study: Study,
    plants: Vec<Plant>,
    people: usize,
    trials: usize,
    /// Least and greatest duration and sample rate.
    analyses: Vec<(Status, u64)>,
    estimator: Option<Estimator>,
    told: Vec<Told>,
    curves: StudyLearningCurves,
    figures: Vec<Drawn>,
    remarks: Vec<Remark>,
    written_at: OffsetDateTime,
}

async fn reported(state: &AppState, id: StudyId) -> ApiResult<Reported> {
    let study = state.store.study(id).await?;
    let plants = state.store.plants(id, MOST).await?;
    let estimator = estimators(&state.store, id).await?.first().map(|(first, _)| *first);
    let query = CurveQuery::by(estimator.unwrap_or_default());
    let gathered = gather(state, id, None, None, &query).await?;
    let analyses = state.store.run_progress(id, &RunFilter::default()).await?.counts;
    let units = units_of_study(state, id).await?;
    drawing(state, move || {
        let people = gathered.subjects.len();
        let trials = gathered.subjects.iter().map(|subject| subject.trials.len()).sum();
        let (told, curves, figures, remarks) = drawn(gathered, &query, estimator.is_some(), &units);
        let written_at = OffsetDateTime::now_utc();
        Reported { study, plants, people, trials, analyses, estimator, told, curves, figures, remarks, written_at }
    })
    .await
}

fn drawn(
    gathered: Gathered,
    query: &CurveQuery,
    has_norms: bool,
    units: &Units,
) -> (Vec<Told>, StudyLearningCurves, Vec<Drawn>, Vec<Remark>) {
    let options = query.options();
    let curves = study_learning_curves(&gathered.subjects, &options);
    let told = sentences::told(&curves, &gathered.subjects, &options);
    let shown = QUANTITIES.into_iter().filter(|metric| has_norms || *metric == Metric::MeanAbsError);
    let mut figures: Vec<Drawn> =
        shown.map(|metric| Drawn::new(&learning_curve(&curves, metric, units), WIDE, [None, None])).collect();
    if has_norms {
        let bode = mean_controllers(&gathered, TrialSelection::Last, &options);
        figures.push(Drawn::new(&bode, WIDE, [None, None]));
    }
    figures.retain(|figure| !figure.is_empty());
    let mut remarks = curves.remarks.clone();
    remarks.extend(gathered.remarks);
    (told, curves, figures, remarks)
}

/// The report as a page, to be printed.
pub(super) async fn page(
    frame: Frame,
    State(state): State<AppState>,
    Id(id): Id<StudyId>,
    Params(()): Params<()>,
) -> ApiResult<Response> {
    let found = reported(&state, id).await?;
    let title = format!("Report of {}", found.study.name);
    let mut head = Head::new(Place::Studies, &title);
    head.crumbs = vec![("Studies".into(), "/".into()), (found.study.name.clone(), format!("/studies/{id}"))];
    head.json = Some(format!("/v1/studies/{id}/learning-curves"));
    head.lead =
        html! { "For paper and for files: print this page, or keep it as one file that opens without a server." };
    head.actions = html! {
        a.button.strong href={ "/studies/" (id) "/report.html" } download { "Download as one file" }
    };
    Ok(whole(&frame, &head, &html! { div.report { (body(&found)) } }))
}

/// The report as one file.
pub(super) async fn file(
    State(state): State<AppState>,
    Id(id): Id<StudyId>,
    Params(()): Params<()>,
) -> ApiResult<Response> {
    let found = reported(&state, id).await?;
    let title = format!("Report of {}", found.study.name);
    let text = html! {
        (DOCTYPE)
        html lang="en" data-theme="light" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                // Whatever a person typed, a browser that opens the file loads and runs nothing.
                meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'";
                title { (title) " · Volition" }
                style { (super::layout::written(assets::style_text())) }
            }
            body { main { h1 { (title) } div.report { (body(&found)) } } }
        }
    };
    let name = format!("attachment; filename=\"report-{}.html\"", eight(&id.to_string()));
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static("text/html; charset=utf-8")),
        (header::CONTENT_DISPOSITION, HeaderValue::from_str(&name).unwrap_or(HeaderValue::from_static("attachment"))),
    ];
    Ok(unframed((headers, text.into_string()).into_response()))
}

fn body(found: &Reported) -> Markup {
    html! {
        (card("Recorded", &html! {}, &recorded(found)))
        (card("Who learned what", &html! {}, &sentences::markup(&found.told)))
        @for figure in &found.figures { (figure.single()) }
        @for metric in QUANTITIES {
            @if found.estimator.is_some() || metric == Metric::MeanAbsError {
                (card(title(metric), &html! {}, &table(&found.curves, metric)))
            }
        }
        @if !found.remarks.is_empty() {
            (card("To be read before the numbers are used", &html! {}, &html! {
                ul.plain { @for (code, messages) in gathered_remarks(&found.remarks) {
                    li { code { (code) } ": " (messages[0])
                        @if messages.len() > 1 { " (and " (messages.len() - 1) " more of this kind)" } }
                } }
            }))
        }
        (card("How", &html! {}, &methods(found)))
        (card("References", &html! {}, &html! {
            ul.plain {
                li { "X. Zhang, "
                    i {
                        "A Subsystem Identification Approach to Modeling Human Control Behavior and Studying Human "
                        "Learning"
                    }
                    ", PhD dissertation, University of Kentucky, 2015: the norms and the learning metrics." }
                li { "L. Ljung, " i { "System Identification: Theory for the User" }
                    ", 2nd edition, 1999; U. Forssell, L. Ljung, "
                    i { "Closed-loop identification revisited" } ", Automatica 35, 1215–1241, 1999: prediction "
                    "errors." }
                li { "Knapp, Hartung, " i {
                    "Improved tests for a random effects meta-regression with a single covariate" }
                    ", Statistics in Medicine 22, 2693–2710, 2003: means over people." }
                li { "Holm, " i { "A simple sequentially rejective multiple test procedure" }
                    ", Scandinavian Journal of Statistics 6, 65–70, 1979: several tests." }
            }
        }))
    }
}

/// By code, since a large study repeats itself.
fn gathered_remarks(remarks: &[Remark]) -> BTreeMap<&str, Vec<&str>> {
    let mut by_code: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for remark in remarks {
        by_code.entry(&remark.code).or_default().push(&remark.message);
    }
    by_code
}

fn recorded(found: &Reported) -> Markup {
    let done: u64 = found.analyses.iter().filter(|(status, _)| *status == Status::Succeeded).map(|(_, n)| n).sum();
    let failed: u64 = found.analyses.iter().filter(|(status, _)| *status == Status::Failed).map(|(_, n)| n).sum();
    html! {
        @if !found.study.description.is_empty() { p { (found.study.description) } }
        p {
            (count(found.people as u64, "subject", "subjects")) " in "
            (count(found.curves.groups.len() as u64, "group", "groups")) ", "
                (count(found.trials as u64, "trial", "trials")) "; "
            (count(done, "analysis", "analyses")) " finished, " (failed) " failed."
        }
        div.scroll tabindex="0" role="region" aria-label="Plants" {
            table {
                caption { "Plants" }
                thead { tr { th scope="col" { "Plant" } th scope="col" { "Model" } } }
                tbody { @for plant in &found.plants { tr { th scope="row" { (plant.name) } td
                    { code { (model(plant)) } } } } }
            }
        }
    }
}

fn model(plant: &Plant) -> String {
    serde_json::to_string(&plant.model).unwrap_or_default()
}

/// Every subject's values, trial by trial.
fn table(curves: &StudyLearningCurves, metric: Metric) -> Markup {
    let grid = Grid::new(curves, metric);
    html! {
        (counts(&grid.levels()))
        @for group in &curves.groups {
            div.scroll tabindex="0" role="region" aria-label={ (symbol(metric)) " of "
                (group.group.as_deref().unwrap_or("all")) } {
                table {
                    caption { (group.group.as_deref().unwrap_or("Without a group")) " on " (group.plant.name) ", "
                        (symbol(metric)) ", by trial" }
                    tbody { @for subject in &group.subjects {
                        tr {
                            th scope="row" { (subject.code) }
                            td { @for point in &subject.curve.points {
                                span.value { (point.number) ": " (point.value(metric).map_or_else(|| "–".to_owned(),
                                    three))
                                    @if point.level(metric) > Level::Ok { " " (point.level(metric).sign()) } }
                                " "
                            } }
                        }
                    } }
                }
            }
        }
        p.muted { (Level::Read.sign()) " " (Level::Read.words()) ", " (Level::DoNotUse.sign()) " "
            (Level::DoNotUse.words()) "." }
    }
}

fn methods(found: &Reported) -> Markup {
    let mut by_spec: BTreeMap<&str, usize> = BTreeMap::new();
    for spec in found.curves.groups.iter().filter_map(|group| group.spec.as_ref()) {
        *by_spec.entry(eight(&spec.spec_sha256)).or_default() += spec.trials;
    }
    let specs: Vec<String> = by_spec.iter().map(|(spec, trials)| format!("{spec} ({trials} trials)")).collect();
    html! {
        p {
            "The tracking error is the mean of |r − y| over a trial. "
            @match found.estimator {
                Some(estimator) => {
                    "Feedforward Gff and feedback Gfb were estimated from each trial by " b
                        { (estimator_name(estimator)) }
                    " (" code { (estimator.name()) } "; spec " (specs.join(", "))
                        "). ‖·‖ is the mean magnitude over the identified band. "
                }
                None => { "Nothing was identified yet. " }
            }
            "The change of a group is the mean over people of the last value less the first, by random effects with "
            "Knapp–Hartung intervals; p-values are adjusted after Holm. "
            @if let Some(limit) = found.study.display_limit {
                "Trials whose |y| passes the display limit of " (three(limit))
                    " are divergent, and left out of curves. "
            }
            "A value that is marked " (chip(Level::DoNotUse, Level::DoNotUse.words()))
                " says more about the method than about the "
            "person (rule of trust, version " (RULE_VERSION) "); it stays in means, which then say so."
        }
        p.muted {
            "Volition " (env!("CARGO_PKG_VERSION")) ", study " code { (found.study.id) } ", written "
            time datetime=(moment(found.written_at)) { (moment(found.written_at)) } "."
        }
    }
}
