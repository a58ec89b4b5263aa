//! Reading bodies within limits.

use super::header_text;
use crate::analysis::{Code, Problem};
use crate::api::problem::{ApiError, ApiResult, RequestCode};
use crate::api::state::AppState;
use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, header};
use futures::StreamExt;
use std::time::Instant;

/// Bytes that are held for a body before it comes.
const FIRST_BYTES: usize = 1 << 20;

/// Bodies come at this rate at least, on the average.
const LEAST_BYTES_PER_S: f64 = 64.0 * 1024.0;

/// The media type of a body in lower case, without parameters.
pub(in crate::api) fn media_type(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(header::CONTENT_TYPE)?.to_str().ok()?;
    Some(value.split(';').next().unwrap_or_default().trim().to_ascii_lowercase())
}

pub(in crate::api) fn unsupported(headers: &HeaderMap, wanted: &str) -> Problem<RequestCode> {
    let given = match headers.get(header::CONTENT_TYPE) {
        None => "the request has no Content-Type".to_owned(),
        Some(_) => format!("the body is '{}'", header_text(headers, &header::CONTENT_TYPE)),
    };
    Problem::new(RequestCode::UnsupportedMediaType, "unsupported media type", given)
        .at("header Content-Type")
        .mend(format!("Send {wanted}."))
}

/// How the body is packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::api) enum Encoding {
    Identity,
    Gzip,
}

/// The content encoding of a body.
pub(in crate::api) fn encoding(headers: &HeaderMap) -> Result<Encoding, Problem<RequestCode>> {
    let text = header_text(headers, &header::CONTENT_ENCODING);
    match text.trim().to_ascii_lowercase().as_str() {
        "" | "identity" => Ok(Encoding::Identity),
        "gzip" | "x-gzip" => Ok(Encoding::Gzip),
        _ => Err(Problem::new(
            RequestCode::UnsupportedMediaType,
            "unsupported content encoding",
            format!("the body is packed as '{text}'"),
        )
        .at("header Content-Encoding")
        .mend("Send it as it is, or packed by gzip where the route takes that.")),
    }
}

/// The whole body, as it came over the wire.
pub(in crate::api) async fn read_body(state: &AppState, headers: &HeaderMap, body: Body) -> ApiResult<Vec<u8>> {
    let limit = state.limits.max_body_bytes;
    let too_large = |size: String| {
        ApiError::from(
            Problem::new(
                Code::TooLarge,
                "body too large",
                format!("the body has {size}, and {limit} bytes are taken at most"),
            )
            .at("body")
            .mend("Pack it with gzip where the route takes that, or send it in several requests."),
        )
        .with_header(header::CONNECTION, HeaderValue::from_static("close"))
    };
    let declared = headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
    if let Some(size) = declared
        && size > limit as u64
    {
        return Err(too_large(format!("{size} bytes")));
    }
    // What is declared is not held before it comes.
    let mut bytes = Vec::with_capacity((declared.unwrap_or(0) as usize).min(FIRST_BYTES));
    let mut stream = body.into_data_stream();
    let began = Instant::now();
    loop {
        // Whoever sends a byte now and then holds what others wait for.
        let due = bytes.len() as f64 / LEAST_BYTES_PER_S;
        if began.elapsed().as_secs_f64() > state.limits.body_stall.as_secs_f64() + due {
            let detail = format!("{} bytes came in {} s", bytes.len(), began.elapsed().as_secs());
            return Err(Problem::new(Code::DeadlineExceeded, "the body comes too slowly", detail)
                .at("body")
                .mend("Send it over a faster line, or in several requests.")
                .into());
        }
        match tokio::time::timeout(state.limits.body_stall, stream.next()).await {
            Ok(None) => return Ok(bytes),
            Ok(Some(Ok(chunk))) => {
                if bytes.len() + chunk.len() > limit {
                    return Err(too_large(format!("more than {limit} bytes")));
                }
                bytes.extend_from_slice(&chunk);
            }
            Ok(Some(Err(error))) => {
                return Err(Problem::new(
                    Code::Malformed,
                    "the body broke off",
                    format!("after {} bytes: {error}", bytes.len()),
                )
                .at("body")
                .into());
            }
            Err(_) => {
                return Err(Problem::new(
                    Code::DeadlineExceeded,
                    "the body stalled",
                    format!("nothing came for {} s after {} bytes", state.limits.body_stall.as_secs(), bytes.len()),
                )
                .at("body")
                .into());
            }
        }
    }
}
