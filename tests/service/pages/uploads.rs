//! Recordings that are looked at before they are stored.

use super::start::send;
use super::{page, stands_alone};
use crate::api::harness::{SIMULATED_TIME_S, TestServer, simulated};
use reqwest::multipart::{Form, Part};
use serde_json::json;

/// Sends files as the page's form does; where it leads to.
async fn sent(server: &TestServer, address: &str, files: Vec<(&str, Vec<u8>)>) -> (u16, String, String) {
    let client = reqwest::Client::builder().redirect(reqwest::redirect::Policy::none()).build().unwrap();
    let form = files
        .into_iter()
        .fold(Form::new(), |form, (name, bytes)| form.part("files", Part::bytes(bytes).file_name(name.to_owned())));
    let answer = client.post(server.url(address)).header("accept", "text/html").multipart(form).send().await.unwrap();
    let status = answer.status().as_u16();
    let place = answer.headers().get("location").map(|place| place.to_str().unwrap().to_owned());
    (status, place.unwrap_or_default(), answer.text().await.unwrap())
}

async fn posted(server: &TestServer, path: &str, fields: &[(&str, &str)]) -> (u16, String, String) {
    let seen = send(server, path, fields).await;
    let place = seen.headers.get("location").map(|place| place.to_str().unwrap().to_owned());
    (seen.status, place.unwrap_or_default(), seen.text)
}

/// The same recording with other names of columns, and times in milliseconds.
fn renamed(seed: u64, number: u32) -> Vec<u8> {
    let csv = simulated(seed, number);
    let mut out = "Clock [ms],Target,Stick,Cursor,Note\n".to_owned();
    for (at, line) in csv.lines().skip(1).enumerate() {
        let cells: Vec<&str> = line.split(',').collect();
        let [.., r, u, y] = cells.as_slice() else { panic!("{line}") };
        out.push_str(&format!("{},{r},{u},{y},0\n", at as f64 * SIMULATED_TIME_S * 1000.0));
    }
    out.into_bytes()
}

#[tokio::test]
async fn files_are_looked_at_mended_stored_and_identified() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let address = format!("/upload?study={}", lab.study);
    page(&server, "/upload").await.has("gm and gn");
    page(&server, &address).await.has("nothing is stored before you say so");
    let with_times = |seed, number| {
        let csv = simulated(seed, number);
        let mut out = String::new();
        for (at, line) in csv.lines().enumerate() {
            let time = if at == 0 { "t".to_owned() } else { format!("{:.2}", (at - 1) as f64 * SIMULATED_TIME_S) };
            let rest: Vec<&str> = line.split(',').collect();
            out.push_str(&format!("{time},{}\n", rest[rest.len() - 3..].join(",")));
        }
        out.into_bytes()
    };
    let files = vec![
        ("S02_t3.csv", with_times(2, 3)),
        ("s01 trial 7.csv", renamed(1, 7)),
        ("notes.bin", b"\x00\x01<script>alert(1)</script>".to_vec()),
        ("s01_t9.csv", b"t,r,u,y\n".to_vec()),
    ];
    let (status, place, _) = sent(&server, &address, files).await;
    assert_eq!(status, 303);
    assert!(place.starts_with("/upload/"), "{place}");
    assert_eq!(server.census().await[3], 0, "nothing is stored before it was looked at");

    // The first is understood and its person is new; the others say what is wrong, and how they begin.
    let seen = page(&server, &place).await;
    seen.has("S02_t3.csv → S02, trial 3");
    seen.has("the study has nobody with the code S02 yet");
    seen.has("from the name “S02_t3.csv”");
    seen.has("Store 1 of 4 trials");
    seen.has("y follows from G·u through this plant to 0");
    assert!(seen.text.contains("data-figure=\"signals\"") && seen.text.contains("data-figure=\"plant_check\""));
    assert!(!seen.text.contains("<script>alert") && seen.text.contains("&lt;script&gt;alert(1)"));
    assert_eq!(seen.text.matches("class=\"refusal\"").count(), 4, "{}", seen.words());

    // Said which column is which, the second can be stored too; the wish stays in the draft.
    let fields = [
        ("0.take", "yes"),
        ("0.subject", "S02"),
        ("0.group", "gn"),
        ("1.take", "yes"),
        ("1.subject", "s01"),
        ("1.number", "7"),
        ("1.t", "Clock [ms]"),
        ("1.r", "Target"),
        ("1.u", "Stick"),
        ("1.y", "Cursor"),
        ("1.time_unit", "ms"),
        ("do", "look"),
    ];
    let (status, there, _) = posted(&server, &place, &fields).await;
    assert_eq!((status, &there), (303, &place));
    let seen = page(&server, &place).await;
    seen.has("Store 2 of 4 trials");
    seen.has("r ← Target");
    let (status, there, _) = posted(&server, &place, &[("do", "store")]).await;
    assert_eq!((status, &there), (303, &place));
    let seen = page(&server, &place).await;
    seen.has("2 trials are stored; 2 files stay below, with the reason.");
    seen.has("Store");
    let census = server.census().await;
    assert_eq!((census[2], census[3]), (2, 2));
    let subjects = server.get(&format!("/v1/studies/{}/subjects", lab.study)).await.json(200);
    let new = subjects["items"].as_array().unwrap().iter().find(|one| one["code"] == "S02").unwrap().clone();
    assert_eq!(new["group"], "gn");
    let trials = server.get(&format!("/v1/subjects/{}/trials", lab.subject)).await.json(200);
    assert_eq!(trials["items"][0]["number"], 7);

    let (status, there, _) = posted(&server, &place, &[("do", "identify")]).await;
    assert_eq!((status, there.as_str()), (303, "/queue"));
    assert_eq!(server.census().await[4], 2);
    server.work().await;

    // The same files again are recognised, and left out.
    let (_, again, _) =
        sent(&server, &address, vec![("s01_t7.csv", renamed(1, 7)), ("S02_t3.csv", with_times(2, 3))]).await;
    let fields = [
        ("0.take", "no"),
        ("0.t", "1"),
        ("0.r", "2"),
        ("0.u", "3"),
        ("0.y", "4"),
        ("0.time_unit", "ms"),
        ("do", "look"),
    ];
    posted(&server, &again, &fields).await;
    let seen = page(&server, &again).await;
    seen.has("already stored as S02 trial 3");
    seen.has("stored already: left out");
    let (status, there, _) = posted(&server, &again, &[("do", "discard")]).await;
    assert_eq!((status, &there), (303, &address));
    let (status, ..) = posted(&server, &again, &[("do", "store")]).await;
    assert_eq!(status, 404);
    assert_eq!(server.census().await[3], 2);
    server.finish().await;
}

#[tokio::test]
async fn a_number_that_is_taken_stores_nothing_and_says_so() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    super::upload(&server, &lab, 1, 3).await;
    let address = format!("/upload?subject={}", lab.subject);
    let files = vec![("a_t3.csv", renamed(1, 4)), ("b_t3.csv", renamed(1, 5))];
    let (_, place, _) = sent(&server, &address, files).await;
    let both = |number: &'static str| {
        let mut fields = Vec::new();
        for (at, number) in [("0", "3"), ("1", number)] {
            for (name, text) in [
                ("take", "yes"),
                ("t", "1"),
                ("r", "2"),
                ("u", "3"),
                ("y", "4"),
                ("time_unit", "ms"),
                ("number", number),
            ] {
                fields.push((format!("{at}.{name}"), text.to_owned()));
            }
            fields.push((format!("{at}.subject"), "s01".to_owned()));
        }
        fields
    };
    let filled_in = async |fields: Vec<(String, String)>, what: &str| {
        let mut all: Vec<(&str, &str)> = fields.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect();
        all.push(("do", what));
        posted(&server, &place, &all).await
    };
    filled_in(both("8"), "look").await;
    let seen = page(&server, &place).await;
    seen.has("The number is taken");
    seen.has("Store 1 of 2 trials");
    filled_in(both("8"), "store").await;
    assert_eq!(server.census().await[3], 2);
    page(&server, &place).await.has("1 trial is stored; 1 file stays below, with the reason.");
    server.finish().await;
}

#[tokio::test]
async fn drafts_are_bounded_and_forgotten_with_their_people() {
    let server = TestServer::start().await;
    let lab = server.lab().await;
    let address = format!("/upload?study={}", lab.study);
    let (_, first, _) = sent(&server, &address, vec![("x.csv", b"t,r\n".to_vec())]).await;
    for _ in 0..50 {
        sent(&server, &address, vec![("x.csv", b"t,r\n".to_vec())]).await;
    }
    // The oldest made room.
    let gone = super::look(&server, "GET", &first, &[]).await;
    assert_eq!(gone.status, 404);
    stands_alone(&gone);
    gone.has("Send the files again.");
    let (_, last, _) = sent(&server, &address, vec![("x.csv", b"t,r\n".to_vec())]).await;
    page(&server, &last).await.has("x.csv");
    server.delete(&format!("/v1/subjects/{}", lab.subject)).await;
    assert_eq!(super::look(&server, "GET", &last, &[]).await.status, 404);
    // No form, no study, no file.
    let (status, _, text) = sent(&server, "/upload", vec![("x.csv", b"t,r\n".to_vec())]).await;
    assert_eq!(status, 422);
    assert!(text.contains("Choose the study first."));
    assert_eq!(posted(&server, &address, &[("a", "b")]).await.0, 415);
    let nobody = json!({"name": "<img src=x onerror=alert(2)>"});
    server.post("/v1/studies", &nobody).await.id(201);
    assert!(!page(&server, "/upload").await.text.contains("<img"));
    server.finish().await;
}
