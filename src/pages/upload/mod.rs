//! Bringing recordings: files are looked at in a draft, mended there, and then stored.

mod card;
mod look;
mod settings;

use super::frame::Frame;
use super::layout::{Head, Place, card as in_card, missing, page as whole};
use super::numbers::count;
use super::problems;
use crate::analysis::ids::{DraftId, StudyId, SubjectId, TrialId};
use crate::analysis::{Analysis as _, Code, Problem, Request, prediction_error};
use crate::api::{ApiResult, AppState, FromQuery, Id, Params, QueryText, check, off_thread, sent_files};
use crate::store::{Draft, NewAnalysis};
use axum::body::Body;
use axum::extract::{Form, State};
use axum::http::HeaderMap;
use axum::response::{IntoResponse as _, Redirect, Response};
use look::{Lab, Look, look_at, to_store};
use maud::{Markup, html};
use serde_json::{Map, Value, json};
use settings::{Guess, Settings};

/// Studies that are offered.
const MOST_STUDIES: u32 = 200;

/// For whom.
pub(super) struct UploadQuery {
    study: Option<StudyId>,
    subject: Option<SubjectId>,
}

impl FromQuery for UploadQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok(Self { study: query.id("study")?, subject: query.id("subject")? })
    }
}

impl UploadQuery {
    /// The study, and the code of the subject where one was named.
    async fn place(&self, state: &AppState) -> ApiResult<Option<(StudyId, Option<String>)>> {
        match (self.subject, self.study) {
            (Some(subject), _) => {
                let subject = state.store.subject(subject).await?;
                Ok(Some((subject.study, Some(subject.code))))
            }
            (None, Some(study)) => Ok(Some((study, None))),
            (None, None) => Ok(None),
        }
    }

    fn address(&self) -> String {
        match (self.subject, self.study) {
            (Some(subject), _) => format!("/upload?subject={subject}"),
            (None, Some(study)) => format!("/upload?study={study}"),
            (None, None) => "/upload".to_owned(),
        }
    }
}

/// What is shown of a draft.
pub(super) struct DraftQuery {
    /// The file whose figures are drawn, by its place.
    show: Option<usize>,
}

impl FromQuery for DraftQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok(Self { show: query.integer("show", 0, 1_000_000)?.map(|place| place as usize) })
    }
}

/// Where files are dropped.
pub(super) async fn page(
    frame: Frame,
    State(state): State<AppState>,
    Params(query): Params<UploadQuery>,
) -> ApiResult<Response> {
    let mut head = Head::new(Place::Upload, "Upload");
    head.crumbs = vec![("Studies".into(), "/".into())];
    let Some((study, code)) = query.place(&state).await? else {
        let studies = state.store.study_overviews(MOST_STUDIES).await?;
        let todo = html! { "Three ways to make one are on " a href="/" { "the page of studies" } "." };
        let body = html! {
            @if studies.is_empty() {
                (missing("No study yet", "Recordings belong to a study.", &todo))
            } @else {
                (in_card("Which study are they of?", &html! {}, &html! {
                    ul.plain { @for one in &studies {
                        li { a href={ "/upload?study=" (one.study.id) } { (one.study.name) } " · "
                            (count(one.trials, "trial", "trials")) }
                    } }
                }))
            }
        };
        return Ok(whole(&frame, &head, &body));
    };
    let study = state.store.study(study).await?;
    head.crumbs.push((study.name.clone(), format!("/studies/{}", study.id)));
    head.lead = html! {
        "To " (study.name) @if let Some(code) = &code { ", from " (code) }
            ". Files are looked at first: nothing is stored "
        "before you say so."
    };
    Ok(whole(&frame, &head, &chooser(&query.address())))
}

/// The files' own card.
fn chooser(address: &str) -> Markup {
    in_card(
        "Recordings",
        &html! {},
        &html! {
            form method="post" action=(address) enctype="multipart/form-data" {
                label.drop data-drop {
                    b { "Drop files here, or choose them:" } " "
                    input type="file" name="files" multiple required;
                    span.muted {
                        "Tables as text (.csv, .tsv, .txt), MATLAB (.mat), NumPy (.npy, .npz), Excel (.xlsx), HDF5, "
                        "JSON; packed or not, or a folder as .zip. Columns t, r, u, y and d, or any others: which is "
                        "which can be said next."
                    }
                }
                p { button.strong type="submit" { "Look at them" } }
            }
            p.muted { "What was sent and not stored is gone after a day." }
        },
    )
}

/// Takes files in, to be looked at.
pub(super) async fn send(
    State(state): State<AppState>,
    Params(query): Params<UploadQuery>,
    headers: HeaderMap,
    body: Body,
) -> ApiResult<Response> {
    let Some((study, code)) = query.place(&state).await? else {
        return Err(Problem::new(Code::Invalid, "for which study?", "the address names none")
            .at("query parameter study")
            .mend("Choose the study first.")
            .into());
    };
    let files = sent_files(&state, &headers, body).await?;
    let subjects = state.store.subjects(study, None, look::MOST).await?;
    let codes: Vec<String> = subjects.into_iter().map(|subject| subject.code).collect();
    let settings: Vec<Map<String, Value>> = files
        .iter()
        .map(|(name, _)| match &code {
            // The page was asked for a person: of files that name nobody else.
            Some(code) if Guess::of(name, &codes).subject.is_none() => {
                Map::from_iter([("subject".to_owned(), code.as_str().into())])
            }
            _ => Map::new(),
        })
        .collect();
    let id = state.store.create_draft(study, files).await?;
    if code.is_some() {
        state.store.describe_draft(id, settings).await?;
    }
    Ok(Redirect::to(&format!("/upload/{id}")).into_response())
}

/// A draft that is there.
async fn kept(state: &AppState, id: DraftId) -> ApiResult<Draft> {
    match state.store.draft(id).await {
        Ok(draft) => Ok(draft),
        Err(crate::store::StoreError::NotFound { .. }) => {
            let detail =
                "files that were sent and not stored are kept for a day, and the oldest make room for new ones";
            Err(Problem::new(Code::NotFound, "these files are gone", detail).mend("Send the files again.").into())
        }
        Err(error) => Err(error.into()),
    }
}

/// What the files were read as.
pub(super) async fn draft(
    frame: Frame,
    State(state): State<AppState>,
    Id(id): Id<DraftId>,
    Params(query): Params<DraftQuery>,
) -> ApiResult<Response> {
    let draft = kept(&state, id).await?;
    shown(&frame, &state, &draft, query.show, None).await
}

async fn shown(
    frame: &Frame,
    state: &AppState,
    draft: &Draft,
    show: Option<usize>,
    problem: Option<Problem>,
) -> ApiResult<Response> {
    let (lab, files) = look_at(state, draft).await?;
    let units = crate::api::units_of_study(state, draft.study).await?;
    let mut head = Head::new(Place::Upload, "Look before storing");
    head.crumbs = vec![
        ("Studies".into(), "/".into()),
        (lab.study.name.clone(), format!("/studies/{}", lab.study.id)),
        ("Upload".into(), format!("/upload?study={}", lab.study.id)),
    ];
    let stored: Vec<TrialId> = draft.files.iter().filter_map(|file| file.trial).collect();
    let open = files.iter().filter(|look| look.is_open()).count();
    head.lead = html! {
        (count(draft.files.len() as u64, "file", "files")) " for " (lab.study.name) " · " (stored.len()) " stored, "
            (open)
        " not yet"
    };
    let body = crate::api::drawing(state, {
        let id = draft.id;
        move || written(id, &lab, &files, &stored, &units, show, problem.as_ref())
    });
    Ok(whole(frame, &head, &body.await?))
}

fn written(
    id: DraftId,
    lab: &Lab,
    files: &[Look],
    stored: &[TrialId],
    units: &crate::figure::of::Units,
    show: Option<usize>,
    problem: Option<&Problem>,
) -> Markup {
    let open = files.iter().filter(|look| look.is_open()).count();
    let ready = files.iter().filter(|look| look.will_be_stored()).count();
    let drawn = card::drawn(files, show);
    let buttons = || {
        html! {
            p.actions {
                button type="submit" name="do" value="look" { "Look again" }
                @if ready > 0 {
                    button.strong type="submit" name="do" value="store" {
                        "Store " (ready) " of " (count(open as u64, "trial", "trials"))
                    }
                }
                button type="submit" name="do" value="discard" { "Discard" }
            }
        }
    };
    html! {
        @if let Some(problem) = problem {
            section.card.problem role="alert" {
                h2 { (super::sentences::capital(&problem.title)) }
                (problems::parts(&problem.detail, problem.location.as_deref(), problem.mend.as_deref()))
            }
        }
        @if !stored.is_empty() { (after(id, lab, files, stored.len(), open)) }
        @if open > 0 {
            form.draft method="post" action={ "/upload/" (id) } {
                (buttons())
                @for (place, look) in files.iter().enumerate() {
                    @if look.is_open() { (card::file(id, place, look, lab, units, drawn.contains(&place))) }
                }
                (card::lists(lab))
                (buttons())
            }
        }
        @let beside: Vec<&str> = files.iter().filter(|look| matches!(look.outcome, look::Outcome::Beside))
            .map(|look| look.name.as_str()).collect();
        @if !beside.is_empty() {
            (in_card("Beside them", &html! {}, &html! {
                p { "Taken for what stands beside the tables of Motion-BIDS, and not stored as trials: "
                    (beside.join(", ")) "." }
            }))
        }
    }
}

/// What was stored, and what to do with it.
fn after(id: DraftId, lab: &Lab, files: &[Look], stored: usize, open: usize) -> Markup {
    let more = if open > 0 {
        html! { "; " (count(open as u64, "file stays", "files stay")) " below, with the reason" }
    } else {
        html! {}
    };
    in_card(
        "Stored",
        &html! {},
        &html! {
            p role="status" { b { (count(stored as u64, "trial is stored", "trials are stored")) } (more) "." }
            ul.plain { @for look in files {
                @if let look::Outcome::Stored(trial) = &look.outcome { li
                    { a href={ "/trials/" (trial) } { (look.name) } } }
            } }
            form method="post" action={ "/upload/" (id) } {
                button.strong type="submit" name="do" value="identify" { "Identify them now" }
                " " a.button href={ "/studies/" (lab.study.id) } { "To the study" }
            }
        },
    )
}

/// Keeps what was filled in; then looks again, stores, identifies or discards.
pub(super) async fn act(
    frame: Frame,
    State(state): State<AppState>,
    Id(id): Id<DraftId>,
    Form(pairs): Form<Vec<(String, String)>>,
) -> ApiResult<Response> {
    let mut draft = kept(&state, id).await?;
    let asked = pairs.iter().find(|(name, _)| name == "do").map_or("look", |(_, value)| value.as_str());
    let here = Redirect::to(&format!("/upload/{id}"));
    if asked == "discard" {
        state.store.discard_draft(id).await?;
        return Ok(Redirect::to(&format!("/upload?study={}", draft.study)).into_response());
    }
    if asked == "identify" {
        identify(&state, &draft).await?;
        return Ok(Redirect::to("/queue").into_response());
    }
    for (position, file) in draft.files.iter_mut().enumerate() {
        if let Some(settings) = Settings::read(position, &pairs) {
            file.settings = settings;
        }
    }
    state.store.describe_draft(id, draft.files.iter().map(|file| file.settings.clone()).collect()).await?;
    if asked != "store" {
        return Ok(here.into_response());
    }
    let (_, files) = look_at(&state, &draft).await?;
    match state.store.store_draft(id, to_store(files)).await {
        Ok(_) => Ok(here.into_response()),
        // Somebody stored another trial of that number meanwhile, or deleted the plant: nothing is stored, and shown
        // why.
        Err(error @ crate::store::StoreError::Conflict { .. }) => {
            let error = crate::api::ApiError::from(error);
            let own = error.problem();
            let problem = Problem::new(Code::Conflict, own.title.clone(), own.detail.clone())
                .mend("Look again: nothing was stored.");
            shown(&frame, &state, &draft, None, Some(problem)).await
        }
        Err(error) => Err(error.into()),
    }
}

/// Queues an analysis of every stored trial, by the kind that needs nothing but a recording.
async fn identify(state: &AppState, draft: &Draft) -> ApiResult<()> {
    let kind = prediction_error::Plan::KIND.name().to_owned();
    let trials: Vec<TrialId> = draft.files.iter().filter_map(|file| file.trial).collect();
    let checked = off_thread(move || {
        let request =
            |trial: &TrialId| Request { kind: kind.clone(), inputs: json!({"trial": trial}), spec: json!({}) };
        trials.iter().map(|trial| check(&request(trial)).map(|checked| checked.new)).collect::<Result<Vec<_>, _>>()
    });
    let mut new: Vec<NewAnalysis> = checked.await??;
    new.iter_mut().for_each(|one| one.study = Some(draft.study));
    state.store.create_analyses(new, None).await?;
    Ok(())
}
