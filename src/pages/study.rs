//! A study: who learned what, its figures, the trust in its trials.

use super::frame::Frame;
use super::grid::Grid;
use super::layout::{Head, Place, card, missing, page as whole};
use super::numbers::{count, eight};
use super::sentences::{self, Told};
use super::svg::Drawn;
use super::trust::{self, symbol};
use crate::analysis::Problem;
use crate::analysis::ids::StudyId;
use crate::api::{
    ApiResult, AppState, CurveQuery, FromQuery, Gathered, Id, NamedPlants, Params, QueryText, asked_estimator, drawing,
    gather, kind_of, mean_controllers, more_figures, naming_excluded, of_study, plants_of_study, units_of_study,
};
use crate::figure::of::Units;
use crate::figure::of::learning_curves::{METRICS, learning_curve, name as name_of, title};
use crate::figure::of::mean_bode;
use crate::figure::text::three;
use crate::learning::curves::Metric;
use crate::learning::{Estimator, Remark, StudyLearningCurves, TrialSelection, study_learning_curves};
use crate::store::Store;
use axum::extract::State;
use axum::response::Response;
use maud::{Markup, html};
use std::collections::BTreeMap;

/// The width of a figure in a card of half a page, and of a whole one, in pixels.
const HALF: u32 = 560;
const WHOLE: u32 = 1160;

/// The figures that stand on the page; others are asked for.
const SHOWN: [Metric; 2] = [Metric::MeanAbsError, Metric::NormFeedforwardPlantMinusOne];

/// What of the study is shown.
#[derive(Debug, Clone, Default)]
pub(super) struct StudyQuery {
    estimator: Option<Estimator>,
    quantity: Option<Metric>,
    figure: Option<&'static str>,
}

fn metric(query: &mut QueryText, name: &'static str) -> Result<Option<Metric>, Problem> {
    let names = METRICS.map(name_of).join(", ");
    query.one_of(name, &names, |text| METRICS.into_iter().find(|metric| name_of(*metric) == text))
}

impl FromQuery for StudyQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok(Self {
            estimator: asked_estimator(query)?,
            quantity: metric(query, "quantity")?,
            figure: query.one_of(
                "figure",
                &more_figures().map(|(name, _)| name).collect::<Vec<_>>().join(", "),
                |text| more_figures().map(|(name, _)| name).find(|name| *name == text),
            )?,
        })
    }
}

/// What an estimator is called.
pub(super) fn estimator_name(estimator: Estimator) -> &'static str {
    match estimator {
        Estimator::Ssid => "best candidate of a pool",
        Estimator::SsidRefined => "refined candidate",
        Estimator::TwoStimulus => "two stimuli",
        Estimator::PredictionError => "prediction error",
    }
}

/// Estimators that succeeded for any trial of the study, each with how many, the one to show first: of those with the
/// most trials the one whose intervals come from the person's own noise.
pub(super) async fn estimators(store: &Store, study: StudyId) -> ApiResult<Vec<(Estimator, u64)>> {
    let counts = store.trials_by_kind(study).await?;
    let order = [Estimator::PredictionError, Estimator::TwoStimulus, Estimator::Ssid, Estimator::SsidRefined];
    let found = order.into_iter().filter_map(|estimator| {
        let kind = kind_of(estimator);
        counts.iter().find(|(name, _)| name == kind.name()).map(|(_, trials)| (estimator, *trials))
    });
    let mut found: Vec<(Estimator, u64)> = found.collect();
    found.sort_by_key(|(_, trials)| std::cmp::Reverse(*trials));
    Ok(found)
}

/// What is drawn and told.
struct Shown {
    /// Estimators with how many trials each has an answer for.
    found: Vec<(Estimator, u64)>,
    curves: StudyLearningCurves,
    told: Vec<Told>,
    grid: Grid,
    figures: Vec<Drawn>,
    bode: Option<Drawn>,
    more: Option<Drawn>,
    remarks: Vec<Remark>,
}

/// For how many trials each estimator has an answer.
fn answers(gathered: &Gathered) -> Vec<(Estimator, u64)> {
    let trials = || gathered.subjects.iter().flat_map(|subject| &subject.trials);
    let of = |estimator: Estimator| {
        let has = |trial: &&crate::learning::TrialInput| {
            let mut all = trial.identifications.iter().chain(&trial.by_other_estimators);
            all.any(|found| found.estimator == estimator)
        };
        trials().filter(has).count() as u64
    };
    Estimator::ALL.into_iter().map(|estimator| (estimator, of(estimator))).filter(|(_, trials)| *trials > 0).collect()
}

fn show(
    mut gathered: Gathered,
    estimator: Estimator,
    quantity: Metric,
    more: Option<&'static str>,
    (units, plants): (&Units, &NamedPlants),
) -> Shown {
    let options = CurveQuery::by(estimator).options();
    let curves = study_learning_curves(&gathered.subjects, &options);
    let named = |figure| naming_excluded(figure, &gathered.remarks);
    let draw = |metric, width| Drawn::new(&named(learning_curve(&curves, metric, units)), width, [None, None]);
    let has_any = gathered.subjects.iter().flat_map(|s| &s.trials).any(|t| !t.identifications.is_empty());
    let bode = has_any.then(|| named(mean_controllers(&gathered, TrialSelection::Last, &options)));
    let bode = bode.map(|figure| Drawn::new(&figure, WHOLE, [None, None]));
    // What a study has nothing for is not drawn, and its link says so by leading nowhere new.
    let more = more.and_then(|name| of_study(name, &gathered, &options, units, plants).ok());
    let mut remarks = curves.remarks.clone();
    let shown = Shown {
        found: answers(&gathered),
        told: sentences::told(&curves, &gathered.subjects, &options),
        grid: Grid::new(&curves, quantity),
        figures: SHOWN
            .into_iter()
            .filter(|metric| has_any || *metric == Metric::MeanAbsError)
            .map(|metric| draw(metric, HALF))
            .collect(),
        bode: bode.filter(|drawn| !drawn.is_empty()),
        more: more.map(|figure| Drawn::new(&figure, WHOLE, [None, None])),
        remarks: Vec::new(),
        curves,
    };
    remarks.append(&mut gathered.remarks);
    Shown { remarks, ..shown }
}

/// The page of a study.
pub(super) async fn page(
    frame: Frame,
    State(state): State<AppState>,
    Id(id): Id<StudyId>,
    Params(query): Params<StudyQuery>,
) -> ApiResult<Response> {
    let study = state.store.study(id).await?;
    let found = estimators(&state.store, id).await?;
    let first = found.first().map(|(estimator, _)| *estimator);
    let estimator = query.estimator.or(first).unwrap_or_default();
    let quantity = query.quantity.unwrap_or(match first {
        Some(_) => Metric::NormFeedforwardPlantMinusOne,
        None => Metric::MeanAbsError,
    });
    let gathered = gather(&state, id, None, None, &CurveQuery::by(estimator)).await?;
    let people = gathered.subjects.len();
    let trials: usize = gathered.subjects.iter().map(|subject| subject.trials.len()).sum();
    let units = units_of_study(&state, id).await?;
    let running = state.store.run_progress(id, &crate::store::RunFilter::default()).await?;
    let more = query.figure;
    let plants = plants_of_study(&state, id).await?;
    let shown = drawing(&state, move || show(gathered, estimator, quantity, more, (&units, &plants))).await?;

    let api = format!("/v1/studies/{id}");
    let mut head = Head::new(Place::Studies, &study.name);
    head.crumbs = vec![("Studies".to_owned(), "/".to_owned())];
    head.json = Some(api.clone());
    let groups = shown.curves.groups.len();
    head.lead = html! {
        (count(people as u64, "subject", "subjects")) " in " (count(groups as u64, "group", "groups")) " · "
        (count(trials as u64, "trial", "trials"))
        @if first.is_some() { " · estimated by " (estimator_name(estimator)) }
        @if !study.description.is_empty() { br; (study.description) }
    };
    let busy: u64 = running.counts.iter().filter(|(status, _)| !status.is_final()).map(|(_, n)| n).sum();
    head.actions = html! {
        a.button href={ "/upload?study=" (id) } { "Upload" }
        @if trials > 0 {
            a.button href={ "/compare?study=" (id) } { "Compare groups" }
            a.button href={ "/studies/" (id) "/report" } { "Report" }
            a.button.strong href={ "/analyses/new?study=" (id) } { "Start an analysis" }
        }
        @if busy > 0 { a.button href="/queue" { (count(busy, "analysis runs or waits", "analyses run or wait")) } }
    };
    let body = html! {
        @if trials == 0 {
            (no_trials(&api, id))
        } @else {
            (card("Who learned what", &html! {}, &sentences::markup(&shown.told)))
            @if first.is_none() { (nothing_identified(id, trials)) }
            (choice(&frame, &shown.found, estimator))
            (drawings(&frame, &api, &shown, estimator, more))
            (trust_grid(&frame, &shown, quantity))
            (table(&shown.curves, quantity))
        }
        (provenance(&api, &shown, estimator))
    };
    Ok(whole(&frame, &head, &body))
}

fn no_trials(api: &str, id: StudyId) -> Markup {
    let todo = html! {
        a.button.strong href={ "/upload?study=" (id) } { "Upload recordings" }
        " or send one with columns t, r, u, y: "
        code.block { "curl --data-binary @trial.csv -H 'content-type: text/csv' '" (api) "/…/trials?plant=ID'" }
        " or a folder of them: " code.block { "volition import FOLDER --database lab.db" }
    };
    missing("No trial yet", "A study without recordings has nothing to show.", &todo)
}

fn nothing_identified(study: StudyId, trials: usize) -> Markup {
    let why = format!("{} wait. What was measured is shown below.", count(trials as u64, "trial", "trials"));
    let todo =
        html! { a href={ "/analyses/new?study=" (study) } { "Identify them all from the person's own noise" } "." };
    missing("Nothing identified yet", &why, &todo)
}

/// Links to the estimates by each estimator.
fn choice(frame: &Frame, found: &[(Estimator, u64)], shown: Estimator) -> Markup {
    html! {
        @if found.len() > 1 {
            nav.choice aria-label="Estimator" {
                "Estimated by: "
                @for (estimator, trials) in found {
                    a href=(frame.with("estimator", Some(estimator.name())))
                        aria-current=[(*estimator == shown).then_some("true")] {
                        (estimator_name(*estimator)) " (" (trials) ")"
                    }
                    " "
                }
            }
        }
    }
}

fn drawings(frame: &Frame, api: &str, shown: &Shown, estimator: Estimator, more: Option<&str>) -> Markup {
    let address = |name: &str| format!("{api}/figures/{name}?estimator={}", estimator.name());
    html! {
        div.pair {
            @for (metric, drawn) in SHOWN.into_iter().zip(&shown.figures) {
                (drawn.card(&address(name_of(metric)), &html! {}))
            }
        }
        @if let Some(bode) = &shown.bode { (bode.card(&address(mean_bode::NAME), &html! {})) }
        nav.choice aria-label="More figures" {
            "More: "
            @for (name, title) in more_figures().filter(|(name, _)| SHOWN.iter().all(|own| name_of(*own) != *name)) {
                a href={ (frame.with("figure", Some(name))) "#more" }
                    aria-current=[(more == Some(name)).then_some("true")] { (title) }
                " "
            }
        }
        @if let Some(name) = more {
            div #more {
                @match &shown.more {
                    Some(drawn) => { (drawn.card(&address(name), &html! {})) }
                    None => { (missing("Nothing to draw", "The study has nothing for this figure.", &html! {
                        a href=(frame.with("figure", None)) { "Back to the study" }
                    })) }
                }
            }
        }
    }
}

fn trust_grid(frame: &Frame, shown: &Shown, quantity: Metric) -> Markup {
    let caption = format!("{} of every trial", title(quantity));
    card(
        "Trials",
        &trust::counts(&shown.grid.levels()),
        &html! {
            nav.choice aria-label="Quantity" {
                @for metric in METRICS {
                    a href=(frame.with("quantity", Some(name_of(metric))))
                        aria-current=[(metric == quantity).then_some("true")] title=(title(metric)) { (symbol(metric)) }
                    " "
                }
            }
            p { b { (title(quantity)) } }
            (shown.grid.markup(&caption))
        },
    )
}

/// Every subject with its first and its last value.
fn table(curves: &StudyLearningCurves, quantity: Metric) -> Markup {
    let value = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), three);
    let caption = format!("{}, first and last trial of every subject", title(quantity));
    card(
        "Subjects",
        &html! {},
        &html! {
            div.scroll tabindex="0" role="region" aria-label="Subjects" {
                table {
                    caption { (caption) }
                    thead {
                        tr {
                            th scope="col" { "Subject" }
                            th scope="col" { "Group" }
                            th scope="col" { "Plant" }
                            th.number scope="col" { "Trials" }
                            th.number scope="col" { "First" }
                            th.number scope="col" { "Last" }
                        }
                    }
                    tbody {
                        @for group in &curves.groups {
                            @for subject in &group.subjects {
                                @let points = &subject.curve.points;
                                tr {
                                    th scope="row" { a href={ "/subjects/" (subject.subject) } { (subject.code) } }
                                    td { (group.group.as_deref().unwrap_or("–")) }
                                    td { (group.plant.name) }
                                    td.number { (points.len() + subject.curve.left_out_count) }
                                    td.number { (value(points.first().and_then(|point| point.value(quantity)))) }
                                    td.number { (value(points.last().and_then(|point| point.value(quantity)))) }
                                }
                            }
                        }
                    }
                }
            }
        },
    )
}

fn provenance(api: &str, shown: &Shown, estimator: Estimator) -> Markup {
    let mut specs: BTreeMap<&str, usize> = BTreeMap::new();
    for spec in shown.curves.groups.iter().filter_map(|group| group.spec.as_ref()) {
        *specs.entry(spec.spec_sha256.as_str()).or_default() += spec.trials;
    }
    card(
        "Where this comes from",
        &html! {},
        &html! {
            p {
                @if specs.is_empty() { "Measured values only." } @else {
                    "Estimator " code { (estimator.name()) } "; spec "
                    @for (at, (hash, trials)) in specs.iter().enumerate() {
                        @if at > 0 { ", " } code { (eight(hash)) } " (" (trials) " trials)"
                    }
                    ". Trials that were identified in different ways are never mixed."
                }
            }
            p {
                "The same numbers: "
                a href={ (api) "/learning-curves?estimator=" (estimator.name()) } { "learning curves" } ", "
                a href={ (api) "/comparison?estimator=" (estimator.name()) } { "comparison of the groups" } ", "
                a href={ (api) "/frequency-responses?estimator=" (estimator.name()) } { "frequency responses" } "."
            }
            @if !shown.remarks.is_empty() {
                details {
                    summary { (count(shown.remarks.len() as u64, "remark", "remarks")) }
                    ul { @for remark in &shown.remarks { li { code { (remark.code) } ": " (remark.message) } } }
                }
            }
        },
    )
}
