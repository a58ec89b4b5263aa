//! Which media type an answer has: the one of those that can be written that the client likes best (RFC 9110, section
//! 12.5.1).

use super::extract::shortened;
use super::problem::RequestCode;
use crate::analysis::Problem;
use axum::http::{HeaderMap, header};

/// One item a line: lists that are too long for a page.
pub(super) const NDJSON: &str = "application/x-ndjson";

/// What the client accepts, as one header; empty where it says nothing.
fn accepted(headers: &HeaderMap) -> String {
    let values: Vec<&str> = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok()).collect();
    values.join(",")
}

/// How much the client likes a media type, from 0 (not at all) to 1: the quality of the most specific range that
/// matches.
fn quality(accept: &str, media: &str) -> f64 {
    let kind = media.split('/').next().unwrap_or_default();
    let mut best: Option<(u8, f64)> = None;
    for range in accept.split(',') {
        let mut parts = range.split(';').map(str::trim);
        let range = parts.next().unwrap_or_default().to_ascii_lowercase();
        let specificity = match range.split_once('/') {
            Some(_) if range == media => 2,
            Some((of, "*")) if of == kind => 1,
            Some(("*", "*")) => 0,
            _ => continue,
        };
        let q = parts.find_map(|part| part.strip_prefix("q=")?.parse::<f64>().ok()).unwrap_or(1.0);
        if best.is_none_or(|(known, _)| specificity >= known) {
            best = Some((specificity, q));
        }
    }
    best.map_or(0.0, |(_, q)| q)
}

/// The one of `offered` that the client likes best, the first of equals; the first where it says nothing. `None` where
/// it accepts none of them.
pub(super) fn preferred<'a>(headers: &HeaderMap, offered: &[&'a str]) -> Option<&'a str> {
    let accept = accepted(headers);
    if accept.trim().is_empty() {
        return offered.first().copied();
    }
    let mut best: Option<(&str, f64)> = None;
    for media in offered {
        let q = quality(&accept, media);
        if q > best.map_or(0.0, |(_, q)| q) {
            best = Some((media, q));
        }
    }
    best.map(|(media, _)| media)
}

/// That none of `offered` is accepted.
pub(super) fn not_acceptable(headers: &HeaderMap, offered: &[&str]) -> Problem<RequestCode> {
    Problem::new(
        RequestCode::NotAcceptable,
        "not acceptable",
        format!("the answer cannot be written as '{}'", shortened(&accepted(headers))),
    )
    .at("header Accept")
    .mend(format!("Accept {}, or leave the header out.", offered.join(" or ")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    #[test]
    fn the_best_acceptable_type_is_chosen() {
        let offered = ["text/csv", "application/json"];
        let choose = |accept: &str| {
            let headers = HeaderMap::from_iter([(header::ACCEPT, HeaderValue::from_str(accept).unwrap())]);
            preferred(&headers, &offered)
        };
        assert_eq!(preferred(&HeaderMap::new(), &offered), Some("text/csv"));
        for csv in
            ["", "*/*", "text/*", "text/csv", "application/json;q=0.5, text/csv", "TEXT/CSV", "text/html, */*;q=0.1"]
        {
            assert_eq!(choose(csv), Some("text/csv"), "{csv}");
        }
        for json in ["application/json", "application/*", "text/csv;q=0.2,*/*;q=0.3", "application/json, text/csv;q=0"]
        {
            assert_eq!(choose(json), Some("application/json"), "{json}");
        }
        for bad in ["text/html", "*/*;q=0", "text/csv;q=0", "image/png, application/xml", "nonsense"] {
            assert_eq!(choose(bad), None, "{bad}");
        }
    }
}
