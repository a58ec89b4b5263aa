//! What every page knows of its request: the theme, its own address, the length of the queue.

use crate::api::{ApiError, ApiResult, AppState};
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};

/// The name of the cookie, and of the parameter that sets it.
pub(super) const THEME: &str = "theme";

/// How the page is dressed; as the reader's system says where nothing was chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Dress {
    #[default]
    System,
    Light,
    Dark,
}

impl Dress {
    const ALL: [Self; 3] = [Self::System, Self::Light, Self::Dark];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::System => "system",
            Self::Light => "light",
            Self::Dark => "dark",
        }
    }

    /// The one that follows in the order of the button.
    pub(super) fn next(self) -> Self {
        match self {
            Self::System => Self::Dark,
            Self::Dark => Self::Light,
            Self::Light => Self::System,
        }
    }

    pub(super) fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|dress| dress.name() == name)
    }

    /// As the request's cookie says.
    pub(super) fn of(headers: &HeaderMap) -> Self {
        let cookies = headers.get_all(header::COOKIE).into_iter().filter_map(|value| value.to_str().ok());
        let pairs = cookies.flat_map(|value| value.split(';')).filter_map(|pair| pair.trim().split_once('='));
        let mut found = pairs.filter(|(name, _)| *name == THEME).filter_map(|(_, value)| Self::named(value));
        found.next().unwrap_or_default()
    }
}

/// What every page knows of its request.
#[derive(Debug, Clone)]
pub(super) struct Frame {
    pub(super) dress: Dress,
    /// Path and query as they were asked for.
    pub(super) address: String,
    /// Analyses that wait or run.
    pub(super) busy: u64,
    pub(super) headers: HeaderMap,
}

impl FromRequestParts<AppState> for Frame {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &AppState) -> ApiResult<Self> {
        let counts = state.store.count_by_status().await?;
        let busy = counts.iter().filter(|(status, _)| !status.is_final()).map(|(_, count)| count).sum();
        let address = parts.uri.path_and_query().map_or("/", |address| address.as_str()).to_owned();
        Ok(Self { dress: Dress::of(&parts.headers), address, busy, headers: parts.headers.clone() })
    }
}

impl Frame {
    /// This page with a parameter of its query set, or without it.
    pub(super) fn with(&self, name: &str, value: Option<&str>) -> String {
        with(&self.address, name, value)
    }
}

/// An address with a parameter of its query set, or without it.
pub(super) fn with(address: &str, name: &str, value: Option<&str>) -> String {
    let (path, query) = address.split_once('?').unwrap_or((address, ""));
    let is_other = |pair: &&str| !pair.is_empty() && pair.split('=').next() != Some(name);
    let mut pairs: Vec<String> = query.split('&').filter(is_other).map(str::to_owned).collect();
    // Values that come from here are words and ids.
    pairs.extend(value.map(|value| format!("{name}={value}")));
    if pairs.is_empty() { path.to_owned() } else { format!("{path}?{}", pairs.join("&")) }
}

/// Whether a path is one of the interface and not of a page.
pub(super) fn is_interface(path: &str) -> bool {
    let own = ["/v1", "/docs", "/openapi.json", "/healthz", "/readyz", "/metrics"];
    own.iter().any(|begin| path.strip_prefix(begin).is_some_and(|rest| rest.is_empty() || rest.starts_with('/')))
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    #[test]
    fn addresses_keep_their_other_parameters() {
        assert_eq!(with("/x", "a", Some("1")), "/x?a=1");
        assert_eq!(with("/x?b=2&a=1", "a", Some("3")), "/x?b=2&a=3");
        assert_eq!(with("/x?theme=dark", "theme", None), "/x");
        assert_eq!(with("/x?ab=1&a", "a", None), "/x?ab=1");
    }

    #[test]
    fn pages_and_interface_are_told_apart() {
        for path in ["/v1/studies", "/v1", "/docs/", "/openapi.json", "/metrics"] {
            assert!(is_interface(path), "{path}");
        }
        for path in ["/", "/studies/1", "/v1x", "/documents", "/analyses/1"] {
            assert!(!is_interface(path), "{path}");
        }
    }

    #[test]
    fn the_theme_comes_from_its_cookie() {
        let of = |cookie: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::COOKIE, HeaderValue::from_str(cookie).unwrap());
            Dress::of(&headers)
        };
        assert_eq!(of("a=b; theme=dark"), Dress::Dark);
        assert_eq!(of("theme=<script>"), Dress::System);
        assert_eq!(of("xtheme=dark"), Dress::System);
        let mut all = vec![Dress::System];
        for _ in 0..3 {
            all.push(all[all.len() - 1].next());
        }
        assert_eq!(all, [Dress::System, Dress::Dark, Dress::Light, Dress::System]);
    }
}
