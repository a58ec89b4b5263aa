//! Sampled signals as files of other programs and for devices.

use super::extract::{FromQuery, QueryText, off_thread};
use super::forms::{self, Form};
use super::problem::{ApiResult, internal};
use crate::analysis::Problem;
use crate::exchange::write::{Sequence, mat, npz, wav};
use crate::excite::sequence::write;
use axum::http::{HeaderMap, HeaderName, HeaderValue};
use axum::response::Response;
use utoipa::IntoParams;

/// The forms of samples that an analysis made.
pub(super) const FORMS: &[Form] = &[Form::Csv, Form::Mat, Form::Npz, Form::Wav];

/// The header that says what a sample of 1 stands for.
const FULL_SCALE: HeaderName = HeaderName::from_static("volition-full-scale");

/// What sound needs to be told.
#[derive(Debug, Clone, Default, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct WaveQuery {
    /// The column that is written as sound; without it, the first that is no time.
    #[param(nullable = false)]
    column: Option<String>,
    /// What a sample of 1 stands for in sound, in the unit of the signal; without it, the column's largest magnitude.
    #[param(nullable = false, exclusive_minimum = 0)]
    full_scale: Option<f64>,
}

impl WaveQuery {
    /// With this column, where none is named.
    pub(super) fn or_column(self, name: &str) -> Self {
        Self { column: self.column.or_else(|| Some(name.to_owned())), ..self }
    }
}

impl FromQuery for WaveQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok(Self { column: query.take("column")?, full_scale: query.number("full_scale")? })
    }
}

/// With a time column, the signal first.
fn csv(sequence: &Sequence) -> Vec<u8> {
    let columns: Vec<(&str, &[f64])> =
        sequence.columns.iter().map(|(name, values)| (name.as_str(), values.as_slice())).collect();
    let mut text = Vec::new();
    // Writing to memory does not fail.
    let _ = write::csv(sequence.sample_time_s, &columns, &mut text);
    text
}

/// A sequence in a form.
pub(super) async fn answer(
    headers: &HeaderMap,
    form: Form,
    name: &str,
    sequence: Sequence,
    wave: WaveQuery,
) -> ApiResult<Response> {
    let (bytes, full_scale) = off_thread(move || match form {
        Form::Csv => Ok((csv(&sequence), None)),
        Form::Mat => Ok((mat::sequence(&sequence), None)),
        Form::Npz => Ok((npz::sequence(&sequence), None)),
        Form::Wav => wav::write(&sequence, wave.column.as_deref(), wave.full_scale)
            .map(|wave| (wave.bytes, Some(wave.full_scale)))
            .map_err(|problem| match &problem.location {
                Some(place) => {
                    let place = format!("query parameter {place}");
                    problem.at(place)
                }
                None => problem.at("query parameter format"),
            }),
        Form::Json | Form::Ndjson => Err(internal()),
    })
    .await??;
    let mut response = forms::file(headers, form, name, bytes);
    if let Some(value) = full_scale.and_then(|scale| HeaderValue::from_str(&format!("{scale:?}")).ok()) {
        response.headers_mut().insert(FULL_SCALE, value);
    }
    Ok(response)
}
