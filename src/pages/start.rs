//! Asking for an analysis: a form from the kind's schema, with the request as JSON beside it.

use super::frame::Frame;
use super::layout::{Head, Place, card, page as whole};
use super::problems;
use super::schema::{Field, Input, fields, rest_of_example};
use crate::analysis::ids::{StudyId, TrialId};
use crate::analysis::registry::{About, kinds};
use crate::analysis::{Code, Problem, Request};
use crate::api::{ApiError, ApiResult, AppState, FromQuery, Params, QueryText, check, off_thread};
use crate::store::{NewAnalysis, TrialFilter};
use axum::extract::{Form, State};
use axum::response::{IntoResponse as _, Redirect, Response};
use maud::{Markup, html};
use serde_json::{Map, Value, json};

/// The kind that is offered first: it needs nothing but a recording.
const FIRST: &str = "prediction_error";

/// Letters of an inserted document.
const MOST_LETTERS: usize = 1 << 20;

/// Of what, and how.
pub(super) struct StartQuery {
    kind: String,
    trial: Option<TrialId>,
    study: Option<StudyId>,
}

impl FromQuery for StartQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let known = crate::analysis::registry::names();
        let find =
            |text: &str| kinds().find(|about| about.kind.name() == text).map(|about| about.kind.name().to_owned());
        let kind = query.one_of("kind", &known, find)?;
        Ok(Self {
            kind: kind.unwrap_or_else(|| FIRST.to_owned()),
            trial: query.id("trial")?,
            study: query.id("study")?,
        })
    }
}

impl StartQuery {
    fn about(&self) -> Result<&'static About, Problem> {
        let missing =
            || Problem::new(Code::Invalid, "unknown kind of analysis", format!("there is no kind '{}'", self.kind));
        kinds().find(|about| about.kind.name() == self.kind).ok_or_else(missing)
    }

    /// This page for another kind.
    fn address(&self) -> String {
        let of = |name: &str, id: Option<String>| id.map_or_else(String::new, |id| format!("&{name}={id}"));
        let trial = of("trial", self.trial.map(|id| id.to_string()));
        format!("/analyses/new?kind={}{trial}{}", self.kind, of("study", self.study.map(|id| id.to_string())))
    }

    /// What it is computed from where the address says it.
    fn inputs(&self) -> Option<Value> {
        self.trial.map(|trial| json!({"trial": trial})).or(self.study.map(|_| json!({})))
    }
}

/// What somebody filled in, as it is shown again.
#[derive(Default)]
struct Filled {
    texts: Map<String, Value>,
    inputs: String,
    rest: String,
    request: Option<Request>,
    problem: Option<Problem>,
    /// By field.
    wrong: Vec<(String, String)>,
    is_checked: bool,
}

impl Filled {
    fn empty(query: &StartQuery, about: &About, fields: &[Field]) -> Self {
        let rest = rest_of_example(about, fields);
        let rest = if rest.is_empty() { String::new() } else { pretty(&Value::Object(rest)) };
        let example: Value = serde_json::from_str(about.example).unwrap_or_default();
        let inputs = if query.inputs().is_some() { String::new() } else { pretty(&example["inputs"]) };
        Self { rest, inputs, ..Self::default() }
    }

    fn read(query: &StartQuery, fields: &[Field], pairs: &[(String, String)]) -> Self {
        let text = |name: &str| pairs.iter().find(|(own, _)| own == name).map_or("", |(_, text)| text.as_str());
        let mut filled = Self { inputs: text("inputs").to_owned(), rest: text("rest").to_owned(), ..Self::default() };
        let mut spec = Map::new();
        for field in fields {
            let written = text(&format!("spec.{}", field.name));
            filled.texts.insert(field.name.clone(), written.into());
            match field.value(written) {
                Ok(Some(value)) => {
                    spec.insert(field.name.clone(), value);
                }
                Ok(None) => {}
                Err(why) => filled.wrong.push((field.name.clone(), why)),
            }
        }
        match object(&filled.rest) {
            Ok(rest) => spec.extend(rest),
            Err(why) => filled.wrong.push(("rest".to_owned(), why)),
        }
        let inputs = match query.inputs() {
            Some(inputs) => inputs,
            None => match object(&filled.inputs) {
                Ok(inputs) => Value::Object(inputs),
                Err(why) => {
                    filled.wrong.push(("inputs".to_owned(), why));
                    Value::Null
                }
            },
        };
        filled.request = Some(Request { kind: query.kind.clone(), inputs, spec: Value::Object(spec) });
        filled
    }
}

/// A JSON object; empty text is an empty one.
fn object(text: &str) -> Result<Map<String, Value>, String> {
    if text.len() > MOST_LETTERS {
        return Err("it is too long for a form; send it over the interface".to_owned());
    }
    if text.trim().is_empty() {
        return Ok(Map::new());
    }
    match serde_json::from_str(text) {
        Ok(Value::Object(fields)) => Ok(fields),
        Ok(_) => Err("it is not an object in braces".to_owned()),
        Err(error) => Err(format!("it is no JSON: {error}")),
    }
}

fn pretty(value: &Value) -> String {
    serde_json::to_string_pretty(value).unwrap_or_default()
}

/// The form.
pub(super) async fn page(
    frame: Frame,
    State(state): State<AppState>,
    Params(query): Params<StartQuery>,
) -> ApiResult<Response> {
    let about = query.about()?;
    let fields = fields(about);
    let filled = Filled::empty(&query, about, &fields);
    show(&frame, &state, &query, about, &fields, &filled).await
}

/// Checks what was filled in; queues it where that was asked for and nothing is wrong.
pub(super) async fn send(
    frame: Frame,
    State(state): State<AppState>,
    Params(query): Params<StartQuery>,
    Form(pairs): Form<Vec<(String, String)>>,
) -> ApiResult<Response> {
    let about = query.about()?;
    let fields = fields(about);
    let mut filled = Filled::read(&query, &fields, &pairs);
    let is = |wanted: &str| pairs.iter().any(|(name, value)| name == "do" && value == wanted);
    let is_asked = is("start");
    // Only shown, while somebody writes.
    if is("show") {
        return show(&frame, &state, &query, about, &fields, &filled).await;
    }
    if let (true, Some(request)) = (filled.wrong.is_empty(), filled.request.clone()) {
        match asked(&state, &query, request, is_asked).await {
            Ok(Some(place)) => return Ok(Redirect::to(&place).into_response()),
            Ok(None) => filled.is_checked = true,
            Err(problem) => filled.problem = Some(problem),
        }
    }
    show(&frame, &state, &query, about, &fields, &filled).await
}

/// What went wrong with a request, as far as whoever wrote it can mend it.
fn told(error: &ApiError) -> Problem {
    let own = error.problem();
    let problem = Problem::new(Code::Invalid, own.title.clone(), own.detail.clone());
    Problem { location: own.location.clone(), mend: own.mend.clone(), ..problem }
}

/// Checks a request, and queues it where that is asked for; then the place to go to.
async fn asked(
    state: &AppState,
    query: &StartQuery,
    request: Request,
    is_asked: bool,
) -> Result<Option<String>, Problem> {
    let mut requests = vec![request.clone()];
    if let Some(study) = query.study {
        let all = state.store.matching_trials(study, &TrialFilter::default()).await;
        let all = all.map_err(|error| told(&error.into()))?;
        let most = state.limits.max_bulk_analyses;
        if all.is_empty() || all.len() > most {
            let detail = format!("{} trials match, and 1 to {most} can be asked for at once", all.len());
            return Err(Problem::new(Code::Invalid, "nothing to queue", detail));
        }
        requests = all.iter().map(|trial| Request { inputs: json!({"trial": trial.id}), ..request.clone() }).collect();
    }
    let checked =
        off_thread(move || requests.iter().map(|request| check(request).map(|c| c.new)).collect::<Result<Vec<_>, _>>());
    let mut new: Vec<NewAnalysis> = checked.await.map_err(|error| told(&error))??;
    if !is_asked {
        return Ok(None);
    }
    if query.study.is_some() {
        new.iter_mut().for_each(|one| one.study = query.study);
        state.store.create_analyses(new, None).await.map_err(|error| told(&error.into()))?;
        return Ok(Some("/queue".to_owned()));
    }
    let Some(one) = new.pop() else { return Ok(None) };
    let made = state.store.create_analysis(one, None).await.map_err(|error| told(&error.into()))?;
    Ok(Some(format!("/analyses/{}", made.into_inner().id)))
}

async fn show(
    frame: &Frame,
    state: &AppState,
    query: &StartQuery,
    about: &About,
    fields: &[Field],
    filled: &Filled,
) -> ApiResult<Response> {
    let mut head = Head::new(Place::Studies, "Start an analysis");
    head.crumbs = vec![("Studies".into(), "/".into())];
    let mut of = "data of the request".to_owned();
    if let Some(study) = query.study {
        let study = state.store.study(study).await?;
        of = format!("every trial of {} that is not divergent", study.name);
        head.crumbs.push((study.name, format!("/studies/{}", study.id)));
    }
    if let Some(trial) = query.trial {
        let trial = state.store.trial(trial).await?;
        let subject = state.store.subject(trial.subject).await?;
        of = format!("{}, trial {}", subject.code, trial.number);
        head.crumbs.push((of.clone(), format!("/trials/{}", trial.id)));
    }
    head.lead = html! { "Of " (of) "." };
    let body = html! {
        (card("What is computed", &html! {}, &choice(query, about)))
        @if let Some(problem) = &filled.problem {
            section.card.problem role="alert" {
                h2 { (super::sentences::capital(&problem.title)) }
                (problems::parts(&problem.detail, problem.location.as_deref(), problem.mend.as_deref()))
            }
        }
        @if filled.is_checked {
            section.card role="status" { h2 { "It is in order" } p { "Nothing is queued yet: press Start." } }
        }
        div.sided {
            (card("How", &html! {}, &form(query, fields, filled)))
            div #written { (card("The same as JSON", &html! {}, &written(query, filled))) }
        }
    };
    Ok(whole(frame, &head, &body))
}

fn choice(query: &StartQuery, about: &About) -> Markup {
    html! {
        form method="get" action="/analyses/new" {
            @if let Some(trial) = query.trial { input type="hidden" name="trial" value=(trial); }
            @if let Some(study) = query.study { input type="hidden" name="study" value=(study); }
            label for="kind" { "Kind " }
            select #kind name="kind" {
                @for one in kinds() {
                    option value=(one.kind.name()) selected[one.kind.name() == query.kind] { (one.title) }
                }
            }
            " " button type="submit" { "Choose" }
        }
        p.muted { (about.summary) }
    }
}

fn form(query: &StartQuery, fields: &[Field], filled: &Filled) -> Markup {
    let wrong = |name: &str| filled.wrong.iter().find(|(own, _)| own == name).map(|(_, why)| why.as_str());
    let problem = |name: &str| {
        let place = filled.problem.as_ref().and_then(|problem| problem.location.as_deref())?;
        let rest = place.strip_prefix("/spec/")?;
        (rest.split('/').next() == Some(name)).then(|| filled.problem.as_ref().map_or("", |own| own.detail.as_str()))
    };
    html! {
        form.fields method="post" action=(query.address()) data-follow {
            @if query.inputs().is_none() {
                (area("inputs", "Inputs", "What it is computed from, as JSON.", &filled.inputs, wrong("inputs")))
            }
            @for field in fields {
                @let text = filled.texts.get(&field.name).and_then(Value::as_str).unwrap_or_default();
                (entry(field, text, wrong(&field.name).or(problem(&field.name))))
            }
            (area("rest", "Everything else", "Members of the spec that have no field here, as JSON.", &filled.rest,
                wrong("rest")))
            p {
                button type="submit" name="do" value="check" { "Check" } " "
                button.strong type="submit" name="do" value="start" { "Start" }
            }
        }
    }
}

fn area(name: &str, title: &str, hint: &str, text: &str, wrong: Option<&str>) -> Markup {
    html! {
        div.field {
            label for=(name) { (title) }
            p.muted id={ (name) "-hint" } { (hint) }
            textarea id=(name) name=(name) rows="6" spellcheck="false" aria-describedby={ (name) "-hint" } { (text) }
            @if let Some(why) = wrong { p.wrong role="alert" { (why) } }
        }
    }
}

/// A name as a title: with the unit that it ends with in brackets.
fn title(name: &str) -> String {
    let units = [("_rad_s", "rad/s"), ("_hz", "Hz"), ("_db", "dB"), ("_s", "s")];
    let found = units.into_iter().find_map(|(ending, unit)| Some((name.strip_suffix(ending)?, unit)));
    match found {
        Some((rest, unit)) => format!("{} ({unit})", rest.replace('_', " ")),
        None => name.replace('_', " "),
    }
}

fn entry(field: &Field, text: &str, wrong: Option<&str>) -> Markup {
    let Field { name, input, description, default } = field;
    let id = format!("spec-{name}");
    let own = format!("spec.{name}");
    let usual = default.as_ref().map(|value| value.as_str().map_or_else(|| value.to_string(), str::to_owned));
    html! {
        div.field {
            label for=(id) { (title(name)) }
            p.muted id={ (id) "-hint" } { (description.replace('`', "")) }
            @match input {
                Input::Choice(words) => {
                    select id=(id) name=(own) aria-describedby={ (id) "-hint" } {
                        option value="" { "as usual" @if let Some(usual) = &usual { ": " (usual) } }
                        @for word in words { option value=(word) selected[word == text] { (word) } }
                    }
                }
                Input::Flag => {
                    select id=(id) name=(own) aria-describedby={ (id) "-hint" } {
                        option value="" { "as usual" @if let Some(usual) = &usual { ": " (usual) } }
                        option value="yes" selected[text == "yes"] { "yes" }
                        option value="no" selected[text == "no"] { "no" }
                    }
                }
                Input::Number { is_whole, least, most } => {
                    input type="number" id=(id) name=(own) value=(text) placeholder=[usual]
                        aria-describedby={ (id) "-hint" }
                        step=(if *is_whole { "1" } else { "any" }) min=[*least] max=[*most];
                }
                Input::Numbers | Input::Text => {
                    input type="text" id=(id) name=(own) value=(text) placeholder=[usual]
                        aria-describedby={ (id) "-hint" };
                }
            }
            @if let Some(why) = wrong { p.wrong role="alert" { (why) } }
        }
    }
}

/// The request as it is sent, and as a command.
fn written(query: &StartQuery, filled: &Filled) -> Markup {
    let Some(request) = &filled.request else {
        return html! { p { "Press Check to see the request that these fields make." } };
    };
    let (path, document) = match query.study {
        Some(study) => (format!("/v1/studies/{study}/analyses"), json!({"kind": request.kind, "spec": request.spec})),
        None => ("/v1/analyses".to_owned(), json!(request)),
    };
    let text = pretty(&document);
    // A quote within quotes ends them, stands escaped, and begins them anew.
    let quoted = document.to_string().replace('\'', "'\\''");
    html! {
        pre tabindex="0" { code { (text) } }
        p { "From a shell, on this machine:" }
        code.block { "curl -H 'content-type: application/json' -d '" (quoted) "' http://127.0.0.1:8080" (path) }
    }
}
