//! Groups of a study side by side: what differs beyond its interval first; or analyses, where the address names some.

use super::compare_analyses;
use super::frame::Frame;
use super::layout::{Head, Place, card, missing, page as whole};
use super::numbers::{count, eight, p_value, with_interval};
use super::sentences::{capital, key, phrase};
use super::study::{estimator_name, estimators};
use super::svg::Drawn;
use super::trust::{chip, symbol};
use crate::analysis::Problem;
use crate::analysis::ids::{AnalysisId, StudyId};
use crate::api::{
    ApiResult, AppState, ComparisonQuery, CurveQuery, FromQuery, Params, QueryText, asked_estimator, compared, drawing,
    gather, units_of_study,
};
use crate::figure::of::learning_curves::{learning_curve, name as name_of};
use crate::figure::text::three;
use crate::learning::comparison::metric::{GroupContrast, GroupMetric, PairContrast};
use crate::learning::comparison::people::{Contrast, CurveForm};
use crate::learning::comparison::report::{ComparedGroup, ComparedPair};
use crate::learning::curves::Metric;
use crate::learning::{Estimator, StudyComparison, study_learning_curves};
use axum::extract::State;
use axum::response::Response;
use maud::{Markup, html};

/// The width of a figure in a card of half a page, in pixels.
const HALF: u32 = 560;

/// The figures under the table.
const SHOWN: [Metric; 2] = [Metric::MeanAbsError, Metric::NormFeedforwardPlantMinusOne];

/// How people's first and last values are taken, with what each is called.
const FORMS: [(CurveForm, &str, &str); 3] = [
    (CurveForm::Exponential, "exponential", "fitted exponential"),
    (CurveForm::Power, "power", "fitted power law"),
    (CurveForm::Trials, "trials", "the trials themselves"),
];

/// What is compared.
pub(super) struct CompareQuery {
    /// Analyses, where the address names some; groups of a study elsewhere.
    analyses: Vec<AnalysisId>,
    study: Option<StudyId>,
    groups: Option<Vec<String>>,
    estimator: Option<Estimator>,
    curve: CurveForm,
}

impl FromQuery for CompareQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let estimator = asked_estimator(query)?;
        let forms = FORMS.map(|(_, name, _)| name).join(", ");
        let form = |text: &str| FORMS.into_iter().find(|(_, name, _)| *name == text).map(|(form, ..)| form);
        let groups = query.one_of("groups", "group names, separated by commas", |text| {
            let names: Vec<String> = text.split(',').map(str::to_owned).collect();
            names.iter().all(|name| !name.is_empty()).then_some(names)
        })?;
        let curve = query.one_of("curve", &forms, form)?.unwrap_or_default();
        let analyses = compare_analyses::named(query)?;
        let study = query.id("study")?;
        if study.is_none() && analyses.is_empty() {
            return Err(Problem::new(
                crate::analysis::Code::Malformed,
                "what is compared?",
                "the address names nothing",
            )
            .at("query parameter study")
            .mend("Begin on the page of a study, or name analyses as a and b."));
        }
        Ok(Self { analyses, study, groups, estimator, curve })
    }
}

/// The page.
pub(super) async fn page(
    frame: Frame,
    State(state): State<AppState>,
    Params(query): Params<CompareQuery>,
) -> ApiResult<Response> {
    let Some(study) = query.study.filter(|_| query.analyses.is_empty()) else {
        return compare_analyses::page(&frame, &state, &query.analyses).await;
    };
    let study = state.store.study(study).await?;
    let found = estimators(&state.store, study.id).await?;
    let estimator = query.estimator.or(found.first().map(|(first, _)| *first)).unwrap_or_default();
    let asked = ComparisonQuery::by(query.groups.clone(), estimator, query.curve);
    let comparison = compared(&state, study.id, &asked).await?;
    let curves = CurveQuery::by(estimator);
    let mut gathered = gather(&state, study.id, None, None, &curves).await?;
    if let Some(names) = &query.groups {
        gathered.subjects.retain(|subject| subject.group.as_ref().is_some_and(|group| names.contains(group)));
    }
    let units = units_of_study(&state, study.id).await?;
    let has_norms = comparison.groups.iter().any(|group| group.spec.is_some());
    let figures = drawing(&state, move || {
        let curves = study_learning_curves(&gathered.subjects, &curves.options());
        let shown = SHOWN.into_iter().filter(|metric| has_norms || *metric == Metric::MeanAbsError);
        shown.map(|metric| (metric, Drawn::new(&learning_curve(&curves, metric, &units), HALF, [None, None]))).collect()
    });
    let figures: Vec<(Metric, Drawn)> = figures.await?;

    let api = format!("/v1/studies/{}", study.id);
    let curve = FORMS.into_iter().find(|(form, ..)| *form == query.curve).map_or("exponential", |(_, name, _)| name);
    let numbers = format!("{api}/comparison?estimator={}&curve={curve}", estimator.name());
    let mut head = Head::new(Place::Studies, "Compare groups");
    head.crumbs = vec![("Studies".into(), "/".into()), (study.name.clone(), format!("/studies/{}", study.id))];
    head.json = Some(numbers.clone());
    let people: usize = comparison.groups.iter().map(|group| group.people).sum();
    head.lead = html! {
        (count(comparison.groups.len() as u64, "group", "groups")) " of " (study.name) " · "
            (count(people as u64, "person", "people"))
        @if has_norms { " · estimated by " (estimator_name(estimator)) }
    };
    let body = html! {
        @if people == 0 {
            (missing("Nobody to compare", "The study has no trial yet.", &html!
                { a href={ "/studies/" (study.id) } { "To the study" } }))
        } @else {
            @if let Some(warning) = mixed(&comparison) { section.card.problem role="note" { p { b { (warning) } } } }
            (choices(&frame, &found, estimator, query.curve))
            (card("Quantities", &html! { p.files { a href=(numbers) { "JSON" } } }, &table(&comparison)))
            (card("What was found", &html! {}, &html! {
                ul.plain { @for finding in &comparison.findings { li { (finding) } } }
            }))
            div.pair { @for (metric, drawn) in &figures {
                (drawn.card(&format!("{api}/figures/{}?estimator={}", name_of(*metric), estimator.name()), &html! {}))
            } }
            @if !comparison.remarks.is_empty() {
                (card("To be read before the numbers are used", &html! {}, &html! {
                    ul.plain { @for remark in &comparison.remarks { li { code { (remark.code) } ": " (remark.message) }
                        } }
                }))
            }
        }
    };
    Ok(whole(&frame, &head, &body))
}

/// What makes a difference one of the method.
fn mixed(comparison: &StudyComparison) -> Option<String> {
    let mut specs: Vec<&str> =
        comparison.groups.iter().filter_map(|group| Some(group.spec.as_ref()?.spec_sha256.as_str())).collect();
    specs.sort_unstable();
    specs.dedup();
    let mut plants: Vec<&str> = comparison.groups.iter().map(|group| group.plant.name.as_str()).collect();
    plants.sort_unstable();
    plants.dedup();
    if specs.len() > 1 {
        let named: Vec<&str> = specs.iter().map(|spec| eight(spec)).collect();
        return Some(format!(
            "These were identified in different ways (specs {}): a difference may come from the method.",
            named.join(", ")
        ));
    }
    (plants.len() > 1).then(|| {
        format!(
            "These groups worked with different plants ({}): a difference may come from the plant.",
            plants.join(", ")
        )
    })
}

fn choices(frame: &Frame, found: &[(Estimator, u64)], estimator: Estimator, curve: CurveForm) -> Markup {
    html! {
        @if found.len() > 1 {
            nav.choice aria-label="Estimator" { "Estimated by: " @for (own, _) in found {
                a href=(frame.with("estimator", Some(own.name()))) aria-current=[(*own == estimator).then_some("true")]
                    {
                    (estimator_name(*own)) } " "
            } }
        }
        nav.choice aria-label="First and last values" { "First and last values from: " @for (form, name, words) in FORMS
            {
            a href=(frame.with("curve", Some(name))) aria-current=[(form == curve).then_some("true")] { (words) } " "
        } }
    }
}

/// What is compared of a quantity, in words.
fn words(contrast: Contrast) -> &'static str {
    match contrast {
        Contrast::First => "on the first trial",
        Contrast::Last => "on the last trial",
        Contrast::Change => "change",
        Contrast::Retention => "change between sessions",
    }
}

/// A row of the table: a quantity at one place, over the groups, and the differences of pairs.
struct Row<'a> {
    metric: Metric,
    contrast: Contrast,
    cells: Vec<Option<(&'a GroupMetric, &'a GroupContrast)>>,
    pairs: Vec<Option<(&'a PairContrast, Option<String>)>>,
}

impl Row<'_> {
    /// Whether the groups differ beyond the interval of their difference, as far as that may be said.
    fn differs(&self) -> bool {
        self.pairs.iter().flatten().any(|(pair, refusal)| {
            let beyond = |[low, high]: [f64; 2]| low > 0.0 || high < 0.0;
            refusal.is_none()
                && pair.difference.as_ref().is_some_and(|own| beyond(own.interval95))
                && pair.p_adjusted.is_some_and(|p| p < 0.05)
        })
    }
}

fn rows(comparison: &StudyComparison) -> Vec<Row<'_>> {
    let mut rows: Vec<Row<'_>> = Vec::new();
    let first = comparison.groups.first();
    let asked = first.iter().flat_map(|group| &group.metrics).flat_map(|own| {
        own.contrasts.iter().filter(|one| one.sessions.is_none()).map(|one| (own.metric, one.contrast))
    });
    for (metric, contrast) in asked {
        let of_group =
            |group: &'_ ComparedGroup| -> Option<usize> { group.metrics.iter().position(|own| own.metric == metric) };
        let cells = comparison.groups.iter().map(|group| {
            let own = &group.metrics[of_group(group)?];
            Some((own, own.contrasts.iter().find(|one| one.contrast == contrast && one.sessions.is_none())?))
        });
        let pairs = comparison.pairs.iter().map(|pair: &ComparedPair| {
            let own = pair.metrics.iter().find(|own| own.metric == metric)?;
            let one = own.contrasts.iter().find(|one| one.contrast == contrast && one.sessions.is_none())?;
            Some((one, own.trust.refusal()))
        });
        rows.push(Row { metric, contrast, cells: cells.collect(), pairs: pairs.collect() });
    }
    // What differs comes first; the order stays as it is else.
    rows.sort_by_key(|row| !row.differs());
    rows
}

fn name(group: &ComparedGroup) -> String {
    format!("{} on {}", group.group.as_deref().unwrap_or("without a group"), group.plant.name)
}

fn table(comparison: &StudyComparison) -> Markup {
    let groups = &comparison.groups;
    html! {
        p.muted {
            "Means over people with 95 % intervals (random effects, Knapp–Hartung); differences are the second group "
            "less the "
            "first, p after correction for " (comparison.families.differences)
                " tests. What differs beyond its interval "
            "stands first, in bold."
        }
        div.scroll tabindex="0" role="region" aria-label="Quantities by group" {
            table {
                caption.hidden { "Quantities by group, and their differences" }
                thead { tr {
                    th scope="col" { "Quantity" }
                    @for (at, group) in groups.iter().enumerate() { th scope="col"
                        { (key(at, groups.len())) " " (name(group)) } }
                    @for pair in &comparison.pairs {
                        th scope="col" { (name(&groups[pair.second])) " less " (name(&groups[pair.first])) }
                    }
                } }
                tbody { @for row in rows(comparison) {
                    tr data-differs[row.differs()] {
                        th scope="row" title=(capital(phrase(row.metric).trim_end_matches(',')))
                            { (symbol(row.metric)) " " (words(row.contrast)) }
                        @for cell in &row.cells { td { (mean(*cell)) } }
                        @for pair in &row.pairs { td {
                            @let written = difference(pair.as_ref());
                            @if row.differs() { b { (written) } } @else { (written) }
                        } }
                    }
                } }
            }
        }
    }
}

fn mean(cell: Option<(&GroupMetric, &GroupContrast)>) -> Markup {
    let Some((own, contrast)) = cell else { return html! { "–" } };
    let coefficient = contrast.mean.as_ref().and_then(|mean| mean.coefficients.first());
    html! {
        @match coefficient {
            Some(found) => { (with_interval(found.value, Some(found.interval95))) " (n = " (contrast.people.len()) ")" }
            None => { "no mean: " (contrast.no_mean.as_deref().unwrap_or("nobody has a value")) }
        }
        @if own.trust.mean.do_not_use > 0 {
            br; (chip(own.trust.mean.level, &format!("{} of {} not to be used", own.trust.mean.do_not_use,
                own.trust.mean.of)))
        }
    }
}

fn difference(pair: Option<&(&PairContrast, Option<String>)>) -> Markup {
    let Some((contrast, refusal)) = pair else { return html! { "–" } };
    if let Some(why) = refusal {
        return html! { "No statement: " (why) };
    }
    html! {
        @match &contrast.difference {
            Some(found) => {
                (with_interval(found.difference, Some(found.interval95)))
                @if let Some(p) = contrast.p_adjusted { ", " (p_value(p)) }
                @if let Some(hedges) = &contrast.hedges { ", g = " (three(hedges.g)) }
            }
            None => { "no difference: " (contrast.no_difference.as_deref().unwrap_or("too few people")) }
        }
    }
}
