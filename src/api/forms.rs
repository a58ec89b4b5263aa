//! The forms in which an answer is written, and which of them a client wants.

use super::etag;
use super::extract::{FromQuery, QueryText};
use super::negotiate::{not_acceptable, preferred};
use super::problem::{ApiError, ApiResult, RequestCode};
use crate::analysis::{Code, Problem};
use crate::exchange::tables::Table;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::Response;
use serde::Serialize;
use utoipa::IntoParams;

/// A form in which an answer is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Form {
    Json,
    Csv,
    Ndjson,
    Mat,
    Npz,
    Wav,
}

impl Form {
    const ALL: [Self; 6] = [Self::Json, Self::Csv, Self::Ndjson, Self::Mat, Self::Npz, Self::Wav];

    /// Its name, which is also how a file's name ends.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Csv => "csv",
            Self::Ndjson => "ndjson",
            Self::Mat => "mat",
            Self::Npz => "npz",
            Self::Wav => "wav",
        }
    }

    /// Its media type, as it is answered.
    pub(crate) fn media_type(self) -> &'static str {
        match self {
            Self::Csv => "text/csv; charset=utf-8; header=present",
            other => other.bare_type(),
        }
    }

    /// Its media type without parameters.
    fn bare_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Csv => "text/csv",
            Self::Ndjson => "application/x-ndjson",
            Self::Mat => "application/x-matlab-data",
            Self::Npz => "application/x-npz",
            Self::Wav => "audio/wav",
        }
    }
}

/// The form that is asked for in the query.
#[derive(Debug, Clone, Copy, PartialEq, Eq, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct FormQuery {
    /// The form of the answer: `csv`, `ndjson` or `json` where it is a table, `csv`, `json`, `mat`, `npz` or `wav`
    /// where it is samples, `json` or `mat` where it is models. Without it, what `Accept` likes best.
    #[param(value_type = Option<String>, nullable = false, pattern = "^(json|csv|ndjson|mat|npz|wav)$")]
    format: Option<Form>,
}

impl FromQuery for FormQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        let names = Form::ALL.map(Form::name).join(", ");
        let parse = |text: &str| Form::ALL.into_iter().find(|form| form.name() == text);
        Ok(Self { format: query.one_of("format", &names, parse)? })
    }
}

/// Header that chooses a form.
#[derive(Debug, IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "documents a header that is read from the header map")]
pub(crate) struct AcceptForm {
    /// The media types that the client takes, with quality values as in RFC 9110.
    #[param(rename = "Accept", required = false, nullable = false, value_type = Option<String>, example = "text/csv")]
    accept: Option<String>,
}

impl FormQuery {
    /// The form of the answer, among those that are offered: the one asked for in the query, else the one that the
    /// client likes best, of equal ones the first.
    ///
    /// # Errors
    /// `malformed` for a form that is not offered, `not_acceptable` where the client takes none of them.
    pub(crate) fn choose(self, headers: &HeaderMap, offered: &[Form]) -> ApiResult<Form> {
        let names = || offered.iter().map(|form| form.name()).collect::<Vec<_>>().join(", ");
        match self.format {
            Some(asked) if offered.contains(&asked) => Ok(asked),
            Some(asked) => {
                let why = format!("this answer is not written as {}", asked.name());
                let problem = Problem::new(Code::Malformed, "no such form", why).at("query parameter format");
                Err(problem.mend(format!("Its forms are: {}.", names())).into())
            }
            None => negotiate(headers, offered).map_err(ApiError::from),
        }
    }
}

/// The offered form that the client likes best.
fn negotiate(headers: &HeaderMap, offered: &[Form]) -> Result<Form, Problem<RequestCode>> {
    let media: Vec<&str> = offered.iter().map(|form| form.bare_type()).collect();
    let best = preferred(headers, &media);
    offered.iter().copied().find(|form| Some(form.bare_type()) == best).ok_or_else(|| not_acceptable(headers, &media))
}

/// Bytes in a form, as a file of this name (without its end); 304 where the client has them already.
pub(crate) fn file(headers: &HeaderMap, form: Form, name: &str, bytes: Vec<u8>) -> Response {
    let mut response = etag::conditional_bytes(headers, form.media_type(), bytes);
    response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept"));
    let place = format!("attachment; filename=\"{name}.{}\"", form.name());
    if let Ok(place) = HeaderValue::from_str(&place) {
        response.headers_mut().insert(header::CONTENT_DISPOSITION, place);
    }
    response
}

/// The forms of a document that is a table too.
pub(crate) const DOCUMENT: &[Form] = &[Form::Json, Form::Csv, Form::Ndjson];

/// A document as it is, or as the table that it is too.
///
/// # Errors
/// `internal`, if it cannot be written.
pub(crate) fn document<T: Serialize>(
    headers: &HeaderMap,
    form: Form,
    name: &str,
    value: &T,
    table: impl FnOnce(&T) -> Table,
) -> ApiResult<Response> {
    match form {
        Form::Csv => Ok(file(headers, form, name, table(value).csv())),
        Form::Ndjson => Ok(file(headers, form, name, table(value).ndjson())),
        _ => {
            let mut response = etag::conditional(headers, value)?;
            response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept"));
            Ok(response)
        }
    }
}
