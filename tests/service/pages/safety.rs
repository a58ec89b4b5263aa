//! What people typed stays text, and what pages do is asked for by pages.

use super::{look, page, stands_alone, upload};
use crate::api::harness::{Lab, TestServer};
use serde_json::json;

#[tokio::test]
async fn names_with_markup_in_every_field_stay_text() {
    let server = TestServer::start().await;
    let evil = "<script>alert(1)</script>\"'><img src=x onerror=alert(2)>";
    let body = json!({"name": evil, "description": evil, "display_limit": 5.0});
    let study = server.post("/v1/studies", &body).await.id(201);
    let model = json!({"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0], "sample_time_s": null});
    let body = json!({"name": evil, "model": model});
    let plant = server.post(&format!("/v1/studies/{study}/plants"), &body).await.id(201);
    let body = json!({"code": evil, "group": evil, "attributes": {evil: evil, "nested": {evil: [evil]}}});
    let subject = server.post(&format!("/v1/studies/{study}/subjects"), &body).await.id(201);
    let lab = Lab { study: study.clone(), plant, subject: subject.clone() };
    let trial = upload(&server, &lab, 1, 1).await;
    let trial_2 = upload(&server, &lab, 1, 20).await;
    let path = format!("/v1/studies/{study}/analyses");
    let queued = server.post(&path, &json!({"kind": "prediction_error"})).await.json(202);
    server.work().await;
    let analysis = queued["analyses"][0]["id"].as_str().unwrap();
    for path in [
        "/".to_owned(),
        "/queue".to_owned(),
        format!("/studies/{study}"),
        format!("/studies/{study}?figure=norm_feedback&quantity=norm_feedback"),
        format!("/subjects/{subject}"),
        format!("/trials/{trial}"),
        format!("/trials/{trial_2}"),
        format!("/analyses/{analysis}"),
    ] {
        let seen = page(&server, &path).await;
        for markup in ["<script>alert", "<img", "onerror=alert(2)>\""] {
            assert!(!seen.text.contains(markup), "{path}: {markup}");
        }
        // The only script is the file of this server.
        assert_eq!(seen.text.matches("<script").count(), 1, "{path}");
        if path != "/queue" {
            assert!(seen.text.contains("&lt;script&gt;alert(1)&lt;/script&gt;"), "{path} does not name it at all");
        }
    }
    // One person is no group.
    page(&server, &format!("/studies/{study}")).await.has("of 3 people who are needed, 1 has both a first and a last");
    server.finish().await;
}

#[tokio::test]
async fn a_form_of_another_site_changes_nothing() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let trial = upload(&server, &lab, 1, 1).await;
    let request = json!({"kind": "frequency_response", "inputs": {"trial": trial}, "spec": {}});
    let id = server.post("/v1/analyses", &request).await.id(202);
    for site in ["cross-site", "same-site"] {
        let seen = look(&server, "POST", &format!("/analyses/{id}/cancel"), &[("sec-fetch-site", site)]).await;
        assert_eq!(seen.status, 403);
        stands_alone(&seen);
        seen.has("Foreign form");
    }
    let foreign = [("origin", "https://lab.example")];
    assert_eq!(look(&server, "POST", &format!("/analyses/{id}/cancel"), &foreign).await.status, 421);
    assert_eq!(server.get(&format!("/v1/analyses/{id}")).await.json(200)["status"], "queued");
    server.work().await;
    server.finish().await;
}

#[tokio::test]
async fn the_theme_is_kept_in_a_cookie_and_leads_nowhere_else() {
    let server = TestServer::start().await;
    let chosen = look(&server, "GET", "/queue?theme=dark", &[]).await;
    assert_eq!((chosen.status, chosen.header("location")), (303, "/queue"));
    assert!(chosen.header("set-cookie").starts_with("theme=dark; Path=/;"), "{}", chosen.header("set-cookie"));
    let dark = look(&server, "GET", "/queue", &[("cookie", "theme=dark")]).await;
    assert!(dark.text.contains("<html lang=\"en\" data-theme=\"dark\">"));
    let system = page(&server, "/queue").await;
    assert!(system.text.contains("<html lang=\"en\">"));
    // The tag tells both apart, and an unchanged page is not sent again.
    let tag = dark.header("etag").to_owned();
    assert_ne!(tag, system.header("etag"));
    let again = look(&server, "GET", "/queue", &[("cookie", "theme=dark"), ("if-none-match", &tag)]).await;
    assert_eq!((again.status, again.text.len()), (304, 0));
    let seen = look(&server, "GET", "//lab.example/?theme=dark", &[]).await;
    assert!(
        !seen.headers.contains_key("location") || seen.header("location").starts_with("/lab"),
        "{:?}",
        seen.headers
    );
    server.finish().await;
}

#[tokio::test]
async fn files_have_names_of_their_content_and_stay_for_a_year() {
    let server = TestServer::start().await;
    let home = page(&server, "/").await;
    let mut found = 0;
    for ending in ["css", "js", "svg"] {
        let at = home.text.find(&format!(".{ending}\"")).unwrap();
        let begin = home.text[..at].rfind('"').unwrap() + 1;
        let path = &home.text[begin..at + 1 + ending.len()];
        let seen = look(&server, "GET", path, &[]).await;
        assert_eq!(seen.status, 200, "{path}");
        assert_eq!(seen.header("cache-control"), "public, max-age=31536000, immutable");
        // The name of a namespace is no address that is asked for.
        let text = seen.text.replace("http://www.w3.org/2000/svg", "");
        assert!(!text.contains("http://") && !text.contains("https://"), "{path} asks elsewhere");
        let packed = crate::api::harness::gzip(seen.text.as_bytes()).len();
        let most = if ending == "css" { 6_000 } else { 12_000 };
        assert!(packed <= most, "{path} has {packed} bytes packed");
        found += 1;
    }
    assert_eq!(found, 3);
    server.finish().await;
}
