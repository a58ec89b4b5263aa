//! Lists of trials: of a study and of a subject, filtered and sorted.

use super::cursor::{PageQuery, Paged};
use super::etag::IfNoneMatch;
use super::extract::{FromQuery, Id, QueryText, parse_id};
use super::problem::{ApiResult, unless_missing};
use super::state::AppState;
use super::studies::StudyPath;
use super::subjects::SubjectPath;
use super::trials::{MAX_NUMBER, TrialList, TrialView};
use crate::analysis::ids::{PlantId, StudyId, SubjectId};
use crate::analysis::{Code, Problem};
use crate::store::{TrialFilter, TrialKey, TrialOrder};
use axum::response::Response;
use utoipa::IntoParams;

/// Which trials, and in which order.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct TrialQuery {
    /// Only those on this plant: its name or its id.
    #[param(nullable = false)]
    plant: Option<String>,
    /// Only those of this session.
    #[param(nullable = false, minimum = 0, maximum = 1000000000)]
    session: Option<i64>,
    /// Only those with this number or a greater one.
    #[param(nullable = false, minimum = 0, maximum = 1000000000)]
    number_from: Option<i64>,
    /// Only those with this number or a smaller one.
    #[param(nullable = false, minimum = 0, maximum = 1000000000)]
    number_to: Option<i64>,
    /// Only divergent ones (`true`), or only others (`false`).
    #[param(nullable = false)]
    divergent: Option<bool>,
    /// Only excluded ones (`true`), or only others (`false`).
    #[param(nullable = false)]
    excluded: Option<bool>,
    /// In which order: `created` (the default), `number` (by session and number), `subject` (by its code, session and
    /// number), `mean_abs_error`, `rms_error` or `max_abs_output`; with a minus before it, the other way round.
    #[param(value_type = Option<String>, nullable = false, default = "created",
        pattern = "^-?(created|number|subject|mean_abs_error|rms_error|max_abs_output)$")]
    sort: TrialOrder,
}

impl FromQuery for TrialQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let names = TrialKey::ALL.map(TrialKey::name).join(", ");
        let order = |text: &str| {
            let (descending, name) = text.strip_prefix('-').map_or((false, text), |name| (true, name));
            let by = TrialKey::ALL.into_iter().find(|key| key.name() == name)?;
            Some(TrialOrder { by, descending })
        };
        let asked = Self {
            plant: query.take("plant")?,
            session: query.integer("session", 0, MAX_NUMBER)?,
            number_from: query.integer("number_from", 0, MAX_NUMBER)?,
            number_to: query.integer("number_to", 0, MAX_NUMBER)?,
            divergent: query.yes_or_no("divergent")?,
            excluded: query.yes_or_no("excluded")?,
            sort: query
                .one_of("sort", &format!("{names}, with or without a minus before it"), order)?
                .unwrap_or_default(),
        };
        if let (Some(from), Some(to)) = (asked.number_from, asked.number_to)
            && from > to
        {
            let detail = format!("number_to is {to}, and number_from is {from}");
            return Err(Problem::new(Code::Malformed, "empty range", detail).at("query parameter number_to"));
        }
        Ok(asked)
    }
}

/// Whose trials.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct WhoseQuery {
    /// Only those of this subject: its code or its id.
    #[param(nullable = false)]
    subject: Option<String>,
    /// Only those of subjects of this group.
    #[param(nullable = false)]
    group: Option<String>,
}

impl FromQuery for WhoseQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok(Self { subject: query.take("subject")?, group: query.take("group")? })
    }
}

fn no_such(noun: &str, name: &str, list: &str) -> Problem {
    Problem::new(Code::NotFound, format!("no such {noun}"), format!("the study has no {noun} '{name}'"))
        .at(format!("query parameter {noun}"))
        .mend(format!("GET {list} lists those that there are; a {noun} is named by name or id."))
}

/// The subject of a study that is named by its code or its id.
async fn subject_of(state: &AppState, study: StudyId, name: &str) -> ApiResult<SubjectId> {
    let found = match parse_id::<SubjectId>(name) {
        Some(id) => unless_missing(state.store.subject(id).await)?.filter(|subject| subject.study == study),
        None => state.store.subject_named(study, name).await?,
    };
    let missing = || no_such("subject", name, &format!("/v1/studies/{study}/subjects")).into();
    found.map(|subject| subject.id).ok_or_else(missing)
}

/// The plant of a study that is named by its name or its id.
async fn plant_of(state: &AppState, study: StudyId, name: &str) -> ApiResult<PlantId> {
    let found = match parse_id::<PlantId>(name) {
        Some(id) => unless_missing(state.store.plant(id).await)?.filter(|plant| plant.study == study),
        None => state.store.plant_named(study, name).await?,
    };
    let missing = || no_such("plant", name, &format!("/v1/studies/{study}/plants")).into();
    found.map(|plant| plant.id).ok_or_else(missing)
}

async fn filter(
    state: &AppState,
    study: StudyId,
    subject: Option<SubjectId>,
    group: Option<String>,
    query: &TrialQuery,
) -> ApiResult<TrialFilter> {
    let plant = match &query.plant {
        Some(name) => Some(plant_of(state, study, name).await?),
        None => None,
    };
    Ok(TrialFilter {
        group,
        subject,
        plant,
        session: query.session,
        number_from: query.number_from,
        number_to: query.number_to,
        include_divergent: query.divergent != Some(false),
        only_divergent: query.divergent == Some(true),
        excluded: query.excluded,
    })
}

/// Lists the trials of a study.
#[utoipa::path(get, path = "/v1/studies/{study}/trials", tag = "trials", operation_id = "list_study_trials",
    params(StudyPath, WhoseQuery, TrialQuery, PageQuery, IfNoneMatch),
    responses(
        (status = 200, description = "A page of trials; as NDJSON all of them, one a line.",
            content((TrialList = "application/json"), (TrialView = "application/x-ndjson"))),
        (status = 409, description = "The trial that ended the page before was deleted: start again.")))]
pub(crate) async fn of_study(Id(study): Id<StudyId>, list: Paged<(WhoseQuery, TrialQuery)>) -> ApiResult<Response> {
    let (WhoseQuery { subject, group }, query) = list.filter.clone();
    list.state.store.study(study).await?;
    let subject = match &subject {
        Some(name) => Some(subject_of(&list.state, study, name).await?),
        None => None,
    };
    let filter = filter(&list.state, study, subject, group, &query).await?;
    answer(study, filter, query.sort, &list).await
}

/// Lists the trials of a subject.
#[utoipa::path(get, path = "/v1/subjects/{subject}/trials", tag = "trials", operation_id = "list_trials",
    params(SubjectPath, TrialQuery, PageQuery, IfNoneMatch),
    responses(
        (status = 200, description = "A page of trials; as NDJSON all of them, one a line.",
            content((TrialList = "application/json"), (TrialView = "application/x-ndjson"))),
        (status = 409, description = "The trial that ended the page before was deleted: start again.")))]
pub(crate) async fn of_subject(Id(subject): Id<SubjectId>, list: Paged<TrialQuery>) -> ApiResult<Response> {
    let study = list.state.store.subject(subject).await?.study;
    let filter = filter(&list.state, study, Some(subject), None, &list.filter).await?;
    answer(study, filter, list.filter.sort, &list).await
}

async fn answer<F>(study: StudyId, filter: TrialFilter, order: TrialOrder, list: &Paged<F>) -> ApiResult<Response> {
    let store = list.state.store.clone();
    let rows = move |page| {
        let (store, filter) = (store.clone(), filter.clone());
        async move { store.listed_trials(study, &filter, order, page).await }
    };
    list.answer(rows, |trial| trial.id.0, TrialView::from).await
}
