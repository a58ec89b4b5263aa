//! A study and its plant, made from a form.

use super::frame::Frame;
use super::layout::{Head, Place, card, page as whole};
use super::problems;
use super::sentences::capital;
use crate::analysis::{Code, Problem};
use crate::api::{
    ApiResult, AppState, Params, checked_description, checked_display_limit, checked_model, checked_name,
};
use crate::store::{NewPlant, NewStudy, SignalUnits, StudyReading};
use axum::extract::{Form, State};
use axum::response::{IntoResponse as _, Redirect, Response};
use maud::{Markup, html};
use serde_json::json;

/// The fields: name, title, hint, what stands there at first.
const FIELDS: [(&str, &str, &str, &str); 10] = [
    ("name", "Name of the study", "", ""),
    ("description", "What it is about", "", ""),
    (
        "display_limit",
        "Display limit (unit of y)",
        "A trial whose |y| passes this is divergent, and left out of curves. Empty: there is none.",
        "",
    ),
    ("plant", "Name of the plant", "What the people control. More plants can be added over the interface.", "plant"),
    ("num", "Numerator", "Coefficients in descending powers, such as 2, 4.4.", ""),
    ("den", "Denominator", "The same, such as 1, 3.6, 4.", ""),
    ("delay_s", "Delay (s)", "Behind the plant. Empty: none.", ""),
    ("sample_time_s", "Sample time (s)", "Of a sampled plant. Empty: it is one in continuous time.", ""),
    ("output", "Unit of command and output", "As figures write it, such as cm. Empty: unit of y.", ""),
    ("control", "Unit of the control", "Such as N. Empty: unit of u.", ""),
];

/// The form.
pub(super) async fn page(frame: Frame, Params(()): Params<()>) -> Response {
    shown(&frame, &|name| FIELDS.iter().find(|own| own.0 == name).map_or("", |own| own.3).to_owned(), None)
}

fn shown(frame: &Frame, text: &dyn Fn(&str) -> String, problem: Option<&Problem>) -> Response {
    let mut head = Head::new(Place::Studies, "New study");
    head.crumbs = vec![("Studies".into(), "/".into())];
    head.lead = html! { "A study, and the plant that its people control. Recordings come next." };
    let place = problem.and_then(|problem| problem.location.as_deref()).unwrap_or_default();
    let body = html! {
        @if let Some(problem) = problem {
            section.card.problem role="alert" {
                h2 { (capital(&problem.title)) }
                (problems::parts(&problem.detail, problem.location.as_deref(), problem.mend.as_deref()))
            }
        }
        (card("Study and plant", &html! {}, &html! {
            form.fields method="post" action="/studies/new" {
                @for (name, title, hint, _) in &FIELDS { (entry(name, title, hint, &text(name), place ==
                    format!("field {name}"))) }
                p { button.strong type="submit" { "Make it" } }
            }
        }))
    };
    whole(frame, &head, &body)
}

fn entry(name: &str, title: &str, hint: &str, text: &str, is_wrong: bool) -> Markup {
    html! {
        div.field {
            label for=(name) { (title) }
            @if !hint.is_empty() { p.muted id={ (name) "-hint" } { (hint) } }
            @if name == "description" {
                textarea id=(name) name=(name) rows="3" { (text) }
            } @else {
                input type="text" id=(name) name=(name) value=(text) required[matches!(name, "name" | "plant" | "num" |
                    "den")]
                    aria-describedby=[(!hint.is_empty()).then(|| format!("{name}-hint"))]
                    aria-invalid=[is_wrong.then_some("true")];
            }
        }
    }
}

/// What was filled in, checked.
fn read(text: &dyn Fn(&str) -> String) -> Result<(NewStudy, NewPlant), Problem> {
    let number = |name: &'static str| -> Result<Option<f64>, Problem> {
        let own = text(name);
        if own.is_empty() {
            return Ok(None);
        }
        own.parse().map(Some).map_err(|_| not_numbers(name, &own))
    };
    let numbers = |name: &'static str| -> Result<Vec<f64>, Problem> {
        let own = text(name);
        let parts = own.split([',', ' ', ';']).filter(|part| !part.is_empty());
        parts.map(|part| part.parse().map_err(|_| not_numbers(name, part))).collect()
    };
    let limit = number("display_limit")?;
    let study = NewStudy {
        name: checked_name(&text("name"), "field name")?,
        description: checked_description(&text("description"), "field description")?,
        display_limit: limit.map(|limit| checked_display_limit(limit, "field display_limit")).transpose()?,
        reading: StudyReading::default(),
    };
    let mut model = json!({"num": numbers("num")?, "den": numbers("den")?, "sample_time_s": number("sample_time_s")?});
    if let Some(delay_s) = number("delay_s")? {
        model["delay_s"] = json!(delay_s);
    }
    let unit = |name: &str| -> Result<Option<String>, Problem> {
        let own = text(name);
        if own.is_empty() { Ok(None) } else { checked_name(&own, &format!("field {name}")).map(Some) }
    };
    let plant = NewPlant {
        name: checked_name(&text("plant"), "field plant")?,
        model: checked_model(&model, "field num")?,
        units: SignalUnits { output: unit("output")?, control: unit("control")? },
    };
    Ok((study, plant))
}

fn not_numbers(name: &str, text: &str) -> Problem {
    Problem::new(Code::Invalid, "no number", format!("'{text}' is no number"))
        .at(format!("field {name}"))
        .mend("Write numbers with a decimal point; several of them with commas between.")
}

/// Makes both, and leads to the upload.
pub(super) async fn send(
    frame: Frame,
    State(state): State<AppState>,
    Params(()): Params<()>,
    Form(pairs): Form<Vec<(String, String)>>,
) -> ApiResult<Response> {
    let text =
        |name: &str| pairs.iter().find(|(own, _)| own == name).map_or("", |(_, text)| text.as_str()).trim().to_owned();
    let (study, plant) = match read(&text) {
        Ok(both) => both,
        Err(problem) => return Ok(shown(&frame, &text, Some(&problem))),
    };
    let study = state.store.create_study(study, None).await?.into_inner();
    state.store.create_plant(study.id, plant, None).await?;
    Ok(Redirect::to(&format!("/upload?study={}", study.id)).into_response())
}
