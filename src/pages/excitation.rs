//! An excitation is designed: a form, and at once what it makes.

use super::frame::Frame;
use super::layout::{Head, Place, card, page as whole};
use super::numbers::count;
use super::problems;
use super::sentences::capital;
use super::svg::Drawn;
use super::trust::chip;
use super::values;
use super::warnings;
use crate::analysis::inputs::library::Library;
use crate::analysis::registry::Plan;
use crate::analysis::{Analysis as _, Code, Failure, Problem, Report, Request, excitation_quality, samples};
use crate::api::{ApiResult, AppState, FromQuery, Params, QueryText, drawing};
use crate::ctl::Ctl;
use crate::exchange::write::{Sequence, mat, npz};
use crate::figure::of::excitation::{AUTOCORRELATION, FLATNESS, SIGNAL, SPECTRUM, excitation};
use crate::figure::text::three;
use crate::trust::Level;
use axum::extract::State;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse as _, Response};
use maud::{Markup, html};
use serde_json::{Map, Value, json};

/// The width of a figure beside the form, in pixels.
const BESIDE: u32 = 780;

/// Samples that are computed while somebody waits for a page; longer signals are for the queue.
const MOST_SAMPLES: f64 = 200_000.0;

/// What a field takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Takes {
    Number,
    Whole,
    /// One of these words.
    Word(&'static [&'static str]),
}

/// A field of the form: name, what it is with its unit, what it takes, and what it is at first.
type Field = (&'static str, &'static str, Takes, &'static str);

/// A sort of excitation.
struct Sort {
    name: &'static str,
    title: &'static str,
    about: &'static str,
    fields: &'static [Field],
}

static SORTS: [Sort; 5] = [
    Sort {
        name: "prts",
        title: "ternary sequence",
        about: "A pseudorandom ternary sequence of maximum length: even multiples of its base line have no power, \
            so that a nonlinear answer shows between its lines.",
        fields: &[("order", "order n, 3ⁿ − 1 chips", Takes::Whole, "4"), ("chip_s", "chip (s)", Takes::Number, "0.2")],
    },
    Sort {
        name: "prbs",
        title: "binary sequence",
        about: "A pseudorandom binary sequence of maximum length: the least crest, with power at every line.",
        fields: &[("order", "order n, 2ⁿ − 1 chips", Takes::Whole, "7"), ("chip_s", "chip (s)", Takes::Number, "0.2")],
    },
    Sort {
        name: "multisine",
        title: "sum of sinusoids",
        about: "Sinusoids at chosen multiples of a base line: power where it is wanted, and nowhere else.",
        fields: &[
            ("base_hz", "base line (Hz)", Takes::Number, "0.05"),
            ("lines", "multiples", Takes::Word(&["odd", "primes", "all"]), "odd"),
            ("from_hz", "from (Hz)", Takes::Number, "0.05"),
            ("to_hz", "to (Hz)", Takes::Number, "2"),
            ("phases", "phases", Takes::Word(&["schroeder", "random", "crest_optimised"]), "schroeder"),
        ],
    },
    Sort {
        name: "chirp",
        title: "swept sinusoid",
        about: "A sinusoid whose frequency goes from one end of the band to the other.",
        fields: &[
            ("from_hz", "from (Hz)", Takes::Number, "0.05"),
            ("to_hz", "to (Hz)", Takes::Number, "2"),
            ("duration_s", "duration (s)", Takes::Number, "60"),
        ],
    },
    Sort {
        name: "filtered_noise",
        title: "noise through a low-pass",
        about: "White noise of which only what lies below an edge is left.",
        fields: &[("edge_hz", "edge (Hz)", Takes::Number, "2"), ("duration_s", "duration (s)", Takes::Number, "60")],
    },
];

/// The fields that every sort has.
const COMMON: [Field; 3] = [
    ("sample_time_s", "sample time (s)", Takes::Number, "0.01"),
    ("peak", "largest magnitude (unit of the signal)", Takes::Number, "1"),
    ("band_hz", "judged up to (Hz)", Takes::Number, "2"),
];

/// Limits of the device.
const LIMITS: [Field; 3] = [
    ("position", "position", Takes::Number, ""),
    ("velocity", "velocity (per s)", Takes::Number, ""),
    ("acceleration", "acceleration (per s²)", Takes::Number, ""),
];

/// What is designed.
pub(super) struct ExcitationQuery {
    sort: &'static Sort,
    texts: Map<String, Value>,
    /// In which form the samples are asked for, where they are.
    file: Option<File>,
}

/// A file for the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum File {
    Csv,
    Mat,
    Npz,
}

impl File {
    const ALL: [Self; 3] = [Self::Csv, Self::Mat, Self::Npz];

    fn name(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Mat => "mat",
            Self::Npz => "npz",
        }
    }

    fn title(self) -> &'static str {
        match self {
            Self::Csv => "CSV",
            Self::Mat => "MATLAB",
            Self::Npz => "NumPy",
        }
    }

    fn media_type(self) -> &'static str {
        match self {
            Self::Csv => "text/csv; charset=utf-8; header=present",
            Self::Mat => "application/x-matlab-data",
            Self::Npz => "application/x-npz",
        }
    }

    /// The samples of a report; every number reads back as the same double.
    fn write(self, report: &Report) -> Result<Vec<u8>, Problem> {
        let sequence = || {
            let found = samples::of(report)?;
            Ok::<_, Problem>(Sequence { sample_time_s: found.sample_time_s, columns: found.columns })
        };
        match self {
            Self::Csv => samples::csv(report).map(String::into_bytes),
            Self::Mat => Ok(mat::sequence(&sequence()?)),
            Self::Npz => Ok(npz::sequence(&sequence()?)),
        }
    }
}

impl ExcitationQuery {
    fn fields(sort: &'static Sort) -> impl Iterator<Item = &'static Field> {
        sort.fields.iter().chain(&COMMON).chain(&LIMITS)
    }

    fn text(&self, name: &str) -> &str {
        self.texts.get(name).and_then(Value::as_str).unwrap_or_default()
    }
}

impl FromQuery for ExcitationQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let names = SORTS.iter().map(|sort| sort.name).collect::<Vec<_>>().join(", ");
        let sort = query.one_of("kind", &names, |text| SORTS.iter().find(|sort| sort.name == text))?;
        let sort = sort.unwrap_or(&SORTS[0]);
        let names = File::ALL.map(File::name).join(", ");
        let file = query.one_of("format", &names, |text| File::ALL.into_iter().find(|own| own.name() == text))?;
        // A field of another sort stays in the address when the sort is changed, and is left aside.
        let mut texts = Map::new();
        for (name, _, _, first) in SORTS.iter().flat_map(Self::fields) {
            let is_own = Self::fields(sort).any(|own| own.0 == *name);
            match query.take(name)? {
                Some(text) if is_own => {
                    texts.insert((*name).to_owned(), text.trim().into());
                }
                _ if is_own && !texts.contains_key(*name) => {
                    let first = Self::fields(sort).find(|own| own.0 == *name).map_or(*first, |own| own.3);
                    texts.insert((*name).to_owned(), first.into());
                }
                _ => {}
            }
        }
        Ok(Self { sort, texts, file })
    }
}

impl ExcitationQuery {
    /// A number of the form; none where nothing is written.
    fn number(&self, name: &str) -> Result<Option<f64>, Problem> {
        let text = self.text(name);
        if text.is_empty() {
            return Ok(None);
        }
        match text.replace(',', ".").parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Some(value)),
            _ => Err(Problem::new(Code::Invalid, "no number", format!("'{text}' is no number"))
                .at(format!("field {name}"))
                .mend("Write a number such as 0.2.")),
        }
    }

    fn needed(&self, name: &'static str) -> Result<f64, Problem> {
        let missing = || {
            Problem::new(Code::Invalid, "a field is empty", format!("{} is needed", name.replace('_', " ")))
                .at(format!("field {name}"))
                .mend("Write a number.")
        };
        self.number(name)?.ok_or_else(missing)
    }

    fn generator(&self) -> Result<Value, Problem> {
        let mut generator = Map::from_iter([("kind".to_owned(), json!(self.sort.name))]);
        if self.sort.name == "multisine" {
            let band = [self.needed("from_hz")?, self.needed("to_hz")?];
            generator.insert("base_hz".to_owned(), json!(self.needed("base_hz")?));
            generator.insert("harmonics".to_owned(), json!({self.text("lines"): band}));
            generator.insert("phases".to_owned(), json!(self.text("phases")));
            return Ok(generator.into());
        }
        for (name, _, takes, _) in self.sort.fields {
            let value = self.needed(name)?;
            let value = if *takes == Takes::Whole && value.fract() == 0.0 { json!(value as i64) } else { json!(value) };
            generator.insert((*name).to_owned(), value);
        }
        Ok(generator.into())
    }

    /// About how many samples it has.
    fn samples(&self) -> Result<f64, Problem> {
        let seconds = match self.sort.name {
            "prts" => (3.0_f64.powf(self.needed("order")?) - 1.0) * self.needed("chip_s")?,
            "prbs" => (2.0_f64.powf(self.needed("order")?) - 1.0) * self.needed("chip_s")?,
            "multisine" => 1.0 / self.needed("base_hz")?,
            _ => self.needed("duration_s")?,
        };
        Ok(seconds / self.needed("sample_time_s")?)
    }

    /// The request that the fields make.
    fn request(&self) -> Result<Request, Problem> {
        let mut signal = json!({"generator": self.generator()?, "sample_time_s": self.needed("sample_time_s")?});
        if let Some(peak) = self.number("peak")? {
            signal["scale"] = json!({"peak": peak});
        }
        let mut spec = Map::new();
        if let Some(upper) = self.number("band_hz")? {
            spec.insert("band_hz".to_owned(), json!([upper]));
        }
        let mut limits = Map::new();
        for (name, ..) in LIMITS {
            if let Some(limit) = self.number(name)? {
                limits.insert(name.to_owned(), json!(limit));
            }
        }
        if !limits.is_empty() {
            spec.insert("limits".to_owned(), limits.into());
        }
        spec.insert("include_samples".to_owned(), json!(true));
        let kind = excitation_quality::Plan::KIND.name().to_owned();
        Ok(Request { kind, inputs: json!({"signal": signal}), spec: spec.into() })
    }

    /// What the excitation is found to be.
    fn judged(&self) -> Result<Report, Problem> {
        let request = self.request()?;
        let samples = self.samples()?;
        if samples.is_nan() || samples > MOST_SAMPLES {
            return Err(Problem::new(
                Code::TooLarge,
                "too long for a page",
                format!("it has some {samples:.0} samples, and {MOST_SAMPLES:.0} are drawn while you wait"),
            )
            .at("field sample_time_s")
            .mend("Choose a longer sample time or a shorter signal, or start it as an analysis."));
        }
        match Plan::parse(&request)?.run(&Library::default(), &Ctl::new()) {
            Ok(report) => Ok(report),
            Err(Failure::Problem(problem)) => Err(problem),
            Err(Failure::Stopped(stopped) | Failure::Interrupted { stopped, .. }) => {
                Err(Problem::new(Code::Internal, "stopped", stopped.to_string()))
            }
        }
    }
}

/// What a design looks like.
struct Designed {
    report: Report,
    figures: Vec<Drawn>,
}

/// The page, or the samples for the device.
pub(super) async fn page(
    frame: Frame,
    State(state): State<AppState>,
    Params(query): Params<ExcitationQuery>,
) -> ApiResult<Response> {
    if let Some(file) = query.file {
        let bytes = drawing(&state, move || file.write(&query.judged()?)).await??;
        let place = format!("attachment; filename=\"excitation.{}\"", file.name());
        let headers = [
            (header::CONTENT_TYPE, HeaderValue::from_static(file.media_type())),
            (
                header::CONTENT_DISPOSITION,
                HeaderValue::from_str(&place).unwrap_or(HeaderValue::from_static("attachment")),
            ),
        ];
        return Ok((headers, bytes).into_response());
    }
    let (query, designed) = drawing(&state, move || {
        let designed = query.judged().map(|report| {
            let title = query.sort.title;
            let figures = [SIGNAL, SPECTRUM, AUTOCORRELATION, FLATNESS].into_iter();
            let figures = figures.filter_map(|name| excitation(&report, name, title).ok());
            let figures = figures.map(|figure| Drawn::with_numbers(&figure, BESIDE)).collect();
            Designed { report, figures }
        });
        (query, designed)
    })
    .await?;
    let mut head = Head::new(Place::Excitation, "Design an excitation");
    head.lead = html! { "What a person is moved by: choose, and see at once what it holds." };
    head.actions = html! {
        @if designed.is_ok() {
            @for file in [File::Npz, File::Mat, File::Csv] {
                a.button.strong[file == File::Csv] href=(frame.with("format", Some(file.name()))) download {
                    @if file == File::Csv { "Download for the device (CSV)" } @else { (file.title()) }
                }
            }
        }
    };
    let body = html! {
        div.sided.left {
            div {
                (card("Signal", &html! {}, &form(&query, designed.as_ref().err())))
                @if let Ok(request) = query.request() { (card("The same as JSON", &html! {}, &written(&request))) }
            }
            div {
                @match &designed {
                    Ok(designed) => {
                        (card("What it is", &html! {}, &found(&designed.report)))
                        @for figure in &designed.figures { (figure.plain(&html! {})) }
                    }
                    Err(problem) => {
                        section.card.problem role="alert" {
                            h2 { (capital(&problem.title)) }
                            (problems::parts(&problem.detail, problem.location.as_deref(), problem.mend.as_deref()))
                        }
                    }
                }
            }
        }
    };
    Ok(whole(&frame, &head, &body))
}

fn form(query: &ExcitationQuery, problem: Option<&Problem>) -> Markup {
    let place = problem.and_then(|problem| problem.location.as_deref()).unwrap_or_default();
    let wrong = |name: &str| {
        place.split(['/', ' ']).any(|part| part == name).then(|| problem.map_or("", |own| own.detail.as_str()))
    };
    html! {
        nav.choice aria-label="Sort of excitation" { @for sort in &SORTS {
            a href={ "/excitation?kind=" (sort.name) } aria-current=[(sort.name == query.sort.name).then_some("true")]
                { (sort.title) } " "
        } }
        p.muted { (query.sort.about) }
        form.fields method="get" action="/excitation" {
            input type="hidden" name="kind" value=(query.sort.name);
            @for field in query.sort.fields.iter().chain(&COMMON) { (entry(field, query.text(field.0), wrong(field.0)))
                }
            details open[LIMITS.iter().any(|(name, ..)| !query.text(name).is_empty())] {
                summary { "Limits of the device" }
                @for field in &LIMITS { (entry(field, query.text(field.0), wrong(field.0))) }
            }
            p { button.strong type="submit" { "Show" } }
        }
    }
}

fn entry((name, title, takes, _): &Field, text: &str, wrong: Option<&str>) -> Markup {
    html! {
        div.field {
            label for=(name) { (title) }
            @match takes {
                Takes::Word(words) => {
                    select id=(name) name=(name) { @for word in *words {
                        option value=(word) selected[*word == text] { (word.replace('_', " ")) }
                    } }
                }
                Takes::Number | Takes::Whole => {
                    input type="text" inputmode="decimal" id=(name) name=(name) value=(text);
                }
            }
            @if let Some(why) = wrong { p.wrong role="alert" { (why) } }
        }
    }
}

/// The numbers of a design, and what speaks against it.
fn found(report: &Report) -> Markup {
    let result = &report.result;
    // What has no value, or lists of its own, is in the JSON of an analysis.
    let told = |value: &&Value| value.is_number() || value.is_string() || value.is_boolean();
    let mut parts: Vec<(String, &Value)> = Vec::new();
    for part in ["signal", "whole_band", "motion"] {
        for (name, value) in result.get(part).and_then(Value::as_object).into_iter().flatten() {
            let title = if part == "signal" { name.clone() } else { format!("{part} · {name}") };
            if let Some(peak) = value.get("peak").filter(told) {
                parts.push((format!("{title} · peak"), peak));
            } else if told(&value) {
                parts.push((title, value));
            }
        }
    }
    let parts: Vec<(&str, &Value)> = parts.iter().map(|(name, value)| (name.as_str(), *value)).collect();
    html! {
        (values::list(parts.into_iter(), three))
        (limits(report))
        @if report.warnings.is_empty() { p { "It carries no warning." } } @else {
            p { (count(report.warnings.len() as u64, "warning", "warnings")) " to read before it is played:" }
            (warnings::list(&report.warnings))
        }
    }
}

/// What of each limit of the device is used.
fn limits(report: &Report) -> Markup {
    let number = |value: &Value, at: &str| value.pointer(at).and_then(Value::as_f64);
    let rows = LIMITS.into_iter().filter_map(|(name, title, ..)| {
        let limit = number(&report.provenance.spec, &format!("/limits/{name}"))?;
        let peak = number(&report.result, &format!("/motion/{name}/peak"));
        Some((title, limit, peak))
    });
    let rows: Vec<(&str, f64, Option<f64>)> = rows.collect();
    html! {
        @if !rows.is_empty() {
            ul.plain { @for (title, limit, peak) in rows { li {
                @match peak {
                    Some(peak) if peak > limit => { (chip(Level::DoNotUse, "above the limit")) " " (title) " reaches "
                        (three(peak)) " of " (three(limit)) }
                    Some(peak) => { (chip(Level::Ok, "within the limit")) " " (title) " reaches " (three(peak)) " of "
                        (three(limit)) }
                    None => { (chip(Level::NotIdentified, "not known")) " " (title) ": limit " (three(limit)) }
                }
            } } }
        }
    }
}

fn written(request: &Request) -> Markup {
    let document = json!(request);
    let text = serde_json::to_string_pretty(&document).unwrap_or_default();
    html! {
        pre tabindex="0" { code { (text) } }
        p { "With plant and controller of the device, and for what it makes of the signal, start it as an analysis: "
            a href={ "/analyses/new?kind=" (request.kind) } { "the form of its kind" } "." }
    }
}
