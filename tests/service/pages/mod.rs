//! Pages over HTTP, as a browser asks for them.

mod browser;
mod budget;
mod documents;
mod safety;
mod shown;
mod start;
mod uploads;

use crate::api::harness::{Lab, TestServer, upload_simulated as upload};
use serde_json::json;

/// A page, wholly read.
struct Seen {
    status: u16,
    headers: reqwest::header::HeaderMap,
    text: String,
}

impl Seen {
    #[track_caller]
    fn header(&self, name: &str) -> &str {
        self.headers.get(name).unwrap_or_else(|| panic!("no header {name}: {:?}", self.headers)).to_str().unwrap()
    }

    /// Whether the page has these words, with no markup between them.
    #[track_caller]
    fn has(&self, words: &str) {
        assert!(self.words().contains(words), "{words:?} is missing in\n{}", self.words());
    }

    /// What is read, without markup.
    fn words(&self) -> String {
        let mut out = String::new();
        for part in self.text.split('<') {
            out.push_str(part.split_once('>').map_or(part, |(_, text)| text));
        }
        let out = out.replace("&lt;", "<").replace("&gt;", ">").replace("&quot;", "\"").replace("&amp;", "&");
        out.split_whitespace().collect::<Vec<_>>().join(" ")
    }
}

/// Asks for a page as a browser does, without following where it leads.
async fn look(server: &TestServer, method: &str, path: &str, more: &[(&str, &str)]) -> Seen {
    let client = reqwest::Client::builder().redirect(reqwest::redirect::Policy::none()).build().unwrap();
    let accept = "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8";
    let mut request = client.request(method.parse().unwrap(), server.url(path)).header("accept", accept);
    for (name, value) in more {
        request = request.header(*name, *value);
    }
    let answer = request.send().await.unwrap();
    let (status, headers) = (answer.status().as_u16(), answer.headers().clone());
    Seen { status, headers, text: answer.text().await.unwrap() }
}

/// A page that is there, with the headers that every page has.
async fn page(server: &TestServer, path: &str) -> Seen {
    let seen = look(server, "GET", path, &[]).await;
    assert_eq!(seen.status, 200, "{path}: {}", seen.text);
    stands_alone(&seen);
    seen
}

/// What every page holds, a refusal too.
#[track_caller]
fn stands_alone(seen: &Seen) {
    assert_eq!(seen.header("content-type"), "text/html; charset=utf-8");
    assert_eq!(
        seen.header("content-security-policy"),
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
         form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    );
    assert_eq!(seen.header("x-content-type-options"), "nosniff");
    assert!(seen.headers.contains_key("x-request-id"));
    let text = &seen.text;
    for inline in [" style=\"", "<style", " onclick", " onload", "javascript:", "<script>"] {
        assert!(!text.contains(inline), "{inline} stands in the page");
    }
    // Names of namespaces are no addresses that are asked for.
    let addresses = text.replace("xmlns=\"http://www.w3.org/2000/svg\"", "").replace("http://127.0.0.1:8080", "");
    for elsewhere in ["src=\"http", "href=\"http", "src=\"//", "href=\"//"] {
        assert!(!addresses.contains(elsewhere), "{elsewhere}");
    }
    assert_eq!(text.matches("<h1>").count(), 1);
    assert_eq!(text.matches("<main").count(), 1);
    assert!(text.contains("<html lang=\"en\"") && text.contains("href=\"#main\""));
}

/// Three people with two trials each, identified from their own noise; the ids of the trials by person.
async fn filled(server: &TestServer) -> (Lab, Vec<[String; 2]>) {
    let mut lab = server.lab().await;
    let mut trials = Vec::new();
    for (seed, code) in [(1, "s01"), (2, "s02"), (3, "s03")] {
        if code != "s01" {
            lab.subject = server.subject(&lab.study, code).await;
        }
        trials.push([upload(server, &lab, seed, 1).await, upload(server, &lab, seed, 20).await]);
    }
    let path = format!("/v1/studies/{}/analyses", lab.study);
    server.post(&path, &json!({"kind": "prediction_error", "spec": {"band_hz": [0.02, 0.5]}})).await.json(202);
    server.work().await;
    (lab, trials)
}
