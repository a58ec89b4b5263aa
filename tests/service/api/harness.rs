//! A server of a test's own, and a client that checks what every answer must hold.

use crate::contract::{Exchange, contract};
use axum::http::StatusCode;
use reqwest::header::{CONTENT_ENCODING, CONTENT_TYPE, HeaderMap};
use reqwest::{Body, Method, RequestBuilder};
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use volition::api::{AppState, Limits};
use volition::jobs::Status;
use volition::pages::router;
use volition::simulate::reference_signals::chirp60;
use volition::simulate::subject::SimulatedSubject;
use volition::store::{Page, Store};
use volition::worker::{Analyses, Worker, WorkerSettings};

/// A running server.
pub struct TestServer {
    pub address: SocketAddr,
    /// The store behind it, for playing the worker's part.
    pub store: Store,
    client: reqwest::Client,
    shutdown: CancellationToken,
    serving: JoinHandle<()>,
    folder: Option<tempfile::TempDir>,
}

/// An answer, wholly read.
#[derive(Debug)]
pub struct Answer {
    pub status: StatusCode,
    pub headers: HeaderMap,
    pub bytes: Vec<u8>,
}

impl TestServer {
    pub async fn start() -> Self {
        Self::start_with(Limits::default()).await
    }

    pub async fn start_with(limits: Limits) -> Self {
        Self::start_for(limits, &[]).await
    }

    /// With origins whose pages may ask.
    pub async fn start_for(limits: Limits, origins: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(Some(&folder.path().join("volition.db"))).await.unwrap();
        let shutdown = CancellationToken::new();
        let state = AppState::new(store.clone()).with_limits(limits).with_shutdown(shutdown.clone());
        let state = state.with_origins(origins.iter().map(|origin| origin.parse().unwrap()).collect());
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let stop = shutdown.clone();
        let serving = tokio::spawn(async move {
            axum::serve(listener, router(state)).with_graceful_shutdown(stop.cancelled_owned()).await.unwrap();
        });
        Self { address, store, client: reqwest::Client::new(), shutdown, serving, folder: Some(folder) }
    }

    /// Drains the server, and fails if an analysis is left queued or running.
    pub async fn finish(mut self) {
        self.client = reqwest::Client::new();
        self.shutdown.cancel();
        tokio::time::timeout(std::time::Duration::from_secs(30), &mut self.serving).await.unwrap().unwrap();
        let left: Vec<_> = self
            .store
            .count_by_status()
            .await
            .unwrap()
            .into_iter()
            .filter(|(status, count)| !status.is_final() && *count > 0)
            .collect();
        assert!(left.is_empty(), "jobs are left behind: {left:?}");
        self.store.close().await;
        let path: PathBuf = self.folder.take().unwrap().keep();
        std::fs::remove_dir_all(&path).unwrap();
        assert!(!path.exists());
    }

    /// The file of its database.
    pub fn database(&self) -> PathBuf {
        self.folder.as_ref().unwrap().path().join("volition.db")
    }

    pub fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    pub fn request(&self, method: &str, path: &str) -> RequestBuilder {
        self.client.request(Method::from_bytes(method.as_bytes()).unwrap(), self.url(path))
    }

    /// Sends a request and holds it and its answer against the OpenAPI document.
    pub async fn send(&self, request: RequestBuilder) -> Answer {
        let request = request.build().unwrap();
        let (method, path) = (request.method().to_string(), request.url().path().to_owned());
        let is_json = request.headers().get(CONTENT_TYPE).is_some_and(|media| media == "application/json");
        let is_packed = request.headers().contains_key(CONTENT_ENCODING);
        let sent = request.body().and_then(Body::as_bytes).filter(|_| is_json && !is_packed).map(<[u8]>::to_vec);
        let response = self.client.execute(request).await.unwrap();
        let (status, headers) = (response.status(), response.headers().clone());
        assert!(headers.contains_key("x-request-id"), "{status} without a request id");
        let answer = Answer { status, headers, bytes: response.bytes().await.unwrap().to_vec() };
        let media_type = answer.headers.get(CONTENT_TYPE).map_or("", |media| media.to_str().unwrap_or_default());
        let media_type = media_type.split(';').next().unwrap_or_default();
        contract().assert_exchange(&Exchange {
            method: &method,
            path: &path,
            request: sent.and_then(|bytes| serde_json::from_slice(&bytes).ok()).as_ref(),
            status: status.as_u16(),
            media_type,
            answer: Some(&answer.bytes)
                .filter(|_| media_type.ends_with("json"))
                .and_then(|bytes| serde_json::from_slice(bytes).ok())
                .as_ref(),
        });
        answer
    }

    pub async fn get(&self, path: &str) -> Answer {
        self.send(self.request("GET", path)).await
    }

    pub async fn delete(&self, path: &str) -> Answer {
        self.send(self.request("DELETE", path)).await
    }

    pub async fn post(&self, path: &str, body: &Value) -> Answer {
        self.send(self.request("POST", path).json(body)).await
    }

    pub async fn patch(&self, path: &str, body: &Value) -> Answer {
        self.send(self.request("PATCH", path).json(body)).await
    }

    // ---- what most tests begin with

    pub async fn study(&self) -> String {
        self.post("/v1/studies", &json!({"name": "gm and gn", "display_limit": 5.0})).await.id(201)
    }

    pub async fn plant(&self, study: &str) -> String {
        let body = json!({"name": "gm", "model": {"num": [2.0, 4.4], "den": [1.0, 3.6, 4.0], "sample_time_s": null}});
        self.post(&format!("/v1/studies/{study}/plants"), &body).await.id(201)
    }

    pub async fn subject(&self, study: &str, code: &str) -> String {
        let body = json!({"code": code, "group": "gm"});
        self.post(&format!("/v1/studies/{study}/subjects"), &body).await.id(201)
    }

    /// A study with a plant and a subject.
    pub async fn lab(&self) -> Lab {
        let study = self.study().await;
        let plant = self.plant(&study).await;
        let subject = self.subject(&study, "s01").await;
        Lab { study, plant, subject }
    }

    pub async fn upload_csv(&self, lab: &Lab, query: &str, csv: impl Into<Body>) -> Answer {
        let path = format!("/v1/subjects/{}/trials?plant={}{query}", lab.subject, lab.plant);
        self.send(self.request("POST", &path).header(CONTENT_TYPE, "text/csv").body(csv)).await
    }

    pub async fn trial(&self, lab: &Lab, number: i64) -> String {
        let csv = recording(64, number as f64);
        self.upload_csv(lab, &format!("&number={number}&session=1"), csv).await.id(201)
    }

    /// Changes the database behind the server's back.
    pub async fn meddle(&self, sql: &'static str) {
        use sqlx::Connection as _;
        let path = self.folder.as_ref().unwrap().path().join("volition.db");
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(path);
        let mut connection = sqlx::SqliteConnection::connect_with(&options).await.unwrap();
        sqlx::query(sql).execute(&mut connection).await.unwrap();
        connection.close().await.unwrap();
    }

    /// How many studies, plants, subjects, trials and analyses there are.
    pub async fn census(&self) -> [usize; 5] {
        let page = Page { after: None, limit: 500 };
        let studies = self.store.studies(page).await.unwrap();
        let mut census = [studies.len(), 0, 0, 0, 0];
        for study in &studies {
            census[1] += self.store.plants(study.id, page).await.unwrap().len();
            let subjects = self.store.subjects(study.id, None, page).await.unwrap();
            census[2] += subjects.len();
            for subject in &subjects {
                census[3] += self.store.trials(subject.id, page).await.unwrap().len();
            }
        }
        census[4] = self.store.count_by_status().await.unwrap().iter().map(|(_, count)| *count as usize).sum();
        census
    }

    /// Lets a worker compute until nothing is queued or running.
    pub async fn work(&self) {
        let settings = WorkerSettings { compute_threads: 1, poll_s: 0.02, ..WorkerSettings::default() };
        let worker = Worker::new(self.store.clone(), Arc::new(Analyses::default()), settings).unwrap();
        let stop = CancellationToken::new();
        let idle = async {
            while self.count(Status::Queued).await + self.count(Status::Running).await > 0 {
                tokio::time::sleep(std::time::Duration::from_millis(10)).await;
            }
            stop.cancel();
        };
        tokio::join!(worker.run(stop.clone()), idle);
    }

    /// How many analyses are in a status.
    pub async fn count(&self, status: Status) -> u64 {
        self.store.count_by_status().await.unwrap().into_iter().find(|(s, _)| *s == status).map_or(0, |(_, n)| n)
    }
}

impl Drop for TestServer {
    fn drop(&mut self) {
        assert!(self.folder.is_none() || std::thread::panicking(), "the test did not finish() its server");
    }
}

/// Ids of a study, a plant and a subject.
pub struct Lab {
    pub study: String,
    pub plant: String,
    pub subject: String,
}

impl Answer {
    /// The JSON body of an answer with this status.
    #[track_caller]
    pub fn json(&self, status: u16) -> Value {
        assert_eq!(self.status.as_u16(), status, "{}", self.text());
        assert_eq!(self.header("content-type"), "application/json");
        serde_json::from_slice(&self.bytes).unwrap()
    }

    /// The id in the JSON body of an answer with this status.
    #[track_caller]
    pub fn id(&self, status: u16) -> String {
        self.json(status)["id"].as_str().unwrap().to_owned()
    }

    /// The problem of an answer with this status; checks what all problems have in common.
    #[track_caller]
    pub fn problem(&self, status: u16, code: &str) -> Value {
        assert_eq!(self.status.as_u16(), status, "{}", self.text());
        assert_eq!(self.header("content-type"), "application/problem+json", "{}", self.text());
        let problem: Value = serde_json::from_slice(&self.bytes).unwrap();
        assert_eq!(problem["code"], code, "{problem}");
        assert_eq!(problem["type"], format!("urn:volition:problem:{code}"));
        assert_eq!(problem["status"], status);
        assert_eq!(problem["instance"], format!("urn:uuid:{}", self.header("x-request-id")));
        assert!(!problem["title"].as_str().unwrap().is_empty() && !problem["detail"].as_str().unwrap().is_empty());
        problem
    }

    #[track_caller]
    pub fn header(&self, name: &str) -> &str {
        self.headers.get(name).unwrap_or_else(|| panic!("no header {name}: {:?}", self.headers)).to_str().unwrap()
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.bytes).into_owned()
    }
}

/// A smooth recording as CSV; `seed` makes it differ from others.
pub fn recording(samples: usize, seed: f64) -> String {
    let mut csv = "t,r,u,y\n".to_owned();
    for i in 0..samples {
        let t = i as f64 * 0.02;
        let (r, u, y) = ((3.0 * t).sin(), (2.0 * t + seed).cos() * 0.3, (3.0 * t - 0.2 - 0.01 * seed).sin() * 0.8);
        csv.push_str(&format!("{t:.2},{r},{u},{y}\n"));
    }
    csv
}

/// The sample time of simulated recordings, in seconds.
pub const SIMULATED_TIME_S: f64 = 0.05;

/// A simulated person's recording as CSV.
pub fn simulated(seed: u64, number: u32) -> String {
    let plant = volition::plants::catalogue::minimum_phase();
    let subject = SimulatedSubject::new(&plant, SIMULATED_TIME_S, seed).unwrap();
    let trial = subject.trial(number, &chirp60(SIMULATED_TIME_S), None).unwrap();
    let mut csv = Vec::new();
    volition::trial::write::csv(&trial, &mut csv).unwrap();
    String::from_utf8(csv).unwrap()
}

/// Stores a simulated person's recording; its id.
pub async fn upload_simulated(server: &TestServer, lab: &Lab, seed: u64, number: u32) -> String {
    let query = format!("&number={number}&sample_time_s={SIMULATED_TIME_S}");
    server.upload_csv(lab, &query, simulated(seed, number)).await.id(201)
}

/// Packed with gzip.
pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    use std::io::Write;
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}
